"""The work of solvers in sandboxes: what crashes or hangs its process is an answer with a status, for itself alone.

Collisions are solved together, in at most `cell_timeout`, and in halves where that fails (`sandbox.in_halves`).
"""

from __future__ import annotations

import functools
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

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
from impact_xval.experiments.sweep.sandbox import FaultError, Sandbox, in_halves
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


def ask(sandbox: Sandbox, function: Ask, ratios: Floats, timeout: float) -> Answers:
    """Ask for collisions, and for fewer of them where that fails.

    Parameters
    ----------
    sandbox : Sandbox
    function : callable
        Of a `Subject`.
    ratios : ndarray, shape (4, n)
        k2/k1, m2/m1, e1, e2.
    timeout : float
        Seconds that they may take together, at all their steps; more, and they are asked for in halves.

    Returns
    -------
    Answers
        Of all n.
    """

    def call(place: slice) -> Answers:
        return sandbox.call(_ask, function, ratios[:, place], timeout=timeout)

    def failure(_: slice, fault: FaultError) -> Answers:
        return Answers.failure(fault.status, fault.reason)

    return Answers.join(in_halves(call, ratios.shape[1], failure))


def follow(
    sandbox: Sandbox, solver: str, case: str, contrast: float, timeout: float
) -> tuple[Mechanism, Motion | None]:
    """Follow the motion of a solver in a case (`mechanism.observe`)."""

    def call(_: slice) -> tuple[Mechanism, Motion | None]:
        return sandbox.call(_observe, solver, case, contrast, timeout=timeout)

    def failure(_: slice, fault: FaultError) -> tuple[Mechanism, Motion | None]:
        return Mechanism(solver, case, contrast, fault.status, fault.reason), None

    return in_halves(call, 1, failure)[0]


def _prepare(job: Job) -> None:
    """Have every solver do once what it will be asked for, so that all is imported and compiled."""
    case, contrast = _EASY
    ratios = np.array(POINTS[case].ratios(BY_KEY[case], contrast))
    for one in job.subjects:
        if one.kind != "exact":
            one.ask(*ratios[:, None])
        observe(one.name, case, contrast, job.resolve)


def _ask(job: Job, function: Ask, ratios: Floats) -> Answers:
    return function(*ratios)


def _observe(job: Job, solver: str, case: str, contrast: float) -> tuple[Mechanism, Motion | None]:
    return observe(solver, case, contrast, job.resolve)
