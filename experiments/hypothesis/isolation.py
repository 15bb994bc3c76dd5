"""The work of solvers in sandboxes: what crashes or hangs its process is an answer with a status, for itself alone.

Collisions are asked for together. Where the process dies of them, or is silent for longer than `cell_timeout`, they
are halved until one is left, which is asked for once more in a new process: one death may have been anybody's (a full
memory, an operator). The second is the solver's: status ``crashed`` or ``timeout``, with the reason.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from impact_xval.experiments.hypothesis.cases import BY_KEY
from impact_xval.experiments.hypothesis.mechanism import (
    POINTS,
    Mechanism,
    Motion,
    observe,
)
from impact_xval.experiments.hypothesis.subjects import Answers, Ask, Subject
from impact_xval.experiments.sweep.executors import DirectExecutor, SandboxExecutor, local_executor
from impact_xval.experiments.sweep.sandbox import Beat, FaultError, Sandbox
from impact_xval.experiments.sweep.solving import Resolve

Floats = NDArray[np.float64]

#: Case and contrast of a collision that any solver does at once.
_EASY = "infinity", 10.0


@dataclass(frozen=True, slots=True)
class Job:
    """What every process of a test is told once.

    Attributes
    ----------
    subjects : tuple of Subject
    resolve : callable
        Finds a solver by its name.
    """

    subjects: tuple[Subject, ...]
    resolve: Resolve


@contextmanager
def open_executor(job: Job, workers: int, *, isolate: bool) -> Iterator[SandboxExecutor | DirectExecutor]:
    """Give the executor of a test: processes of this machine, or, not isolated, this process at once."""
    if not isolate:
        yield DirectExecutor(job)
        return
    with local_executor(functools.partial(Sandbox, job, _prepare), workers) as executor:
        yield executor


def ask(sandbox: Sandbox, function: Ask, ratios: Floats, patience: float) -> Answers:
    """Ask for collisions, and for fewer of them where that fails.

    Parameters
    ----------
    sandbox : Sandbox
    function : callable
        Of a `Subject`.
    ratios : ndarray, shape (4, n)
        k2/k1, m2/m1, e1, e2.
    patience : float
        Seconds that they may take together, at all their steps; more, and they are asked for in halves.

    Returns
    -------
    Answers
        Of all n.
    """
    n = ratios.shape[1]
    try:
        if n > 1:
            return sandbox.call(_ask, function, ratios, patience=patience)
        return _call(sandbox, _ask, function, ratios, patience=patience)
    except FaultError as fault:
        if n == 1:
            return Answers.failure(fault.status, fault.reason)
    halves = ratios[:, : n // 2], ratios[:, n // 2 :]
    return Answers.join([ask(sandbox, function, half, patience) for half in halves])


def follow(
    sandbox: Sandbox, solver: str, case: str, contrast: float, patience: float
) -> tuple[Mechanism, Motion | None]:
    """Follow the motion of a solver in a case (`mechanism.observe`)."""
    try:
        return _call(sandbox, _observe, solver, case, contrast, patience=patience)
    except FaultError as fault:
        return Mechanism(solver, case, contrast, fault.status, fault.reason), None


def _call(sandbox: Sandbox, function: Callable[..., Any], *arguments: Any, patience: float) -> Any:
    """Call in a sandbox, and once more after a fault."""
    try:
        return sandbox.call(function, *arguments, patience=patience)
    except FaultError:
        return sandbox.call(function, *arguments, patience=patience)


def _prepare(job: Job, *, beat: Beat) -> None:
    """Have every solver do once what it will be asked for, so that all is imported and compiled."""
    case, contrast = _EASY
    ratios = np.array(POINTS[case].ratios(BY_KEY[case], contrast))
    for one in job.subjects:
        beat(one.name)
        if one.kind != "exact":
            one.ask(*ratios[:, None])
        observe(one.name, case, contrast, job.resolve)


def _ask(job: Job, function: Ask, ratios: Floats, *, beat: Beat) -> Answers:
    return function(*ratios)


def _observe(
    job: Job, solver: str, case: str, contrast: float, *, beat: Beat
) -> tuple[Mechanism, Motion | None]:
    return observe(solver, case, contrast, job.resolve)
