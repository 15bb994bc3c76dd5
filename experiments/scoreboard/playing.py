"""Collection of the answers of all solvers to the cases of the scoreboard.

A case is a collision, and an answer is the outcome that a solver computes for it.

Each solver answers in a separate process. If a solver crashes or hangs, only its answers are lost. The command
`impact-xval scoreboard` calls this module.
"""

from __future__ import annotations

import contextlib
import json
from collections.abc import Callable, Sequence
from concurrent.futures import as_completed
from hashlib import sha256
from importlib.metadata import version
from pathlib import Path
from typing import Protocol, TypeVar, TypeVarTuple

import pandas as pd

from impact_xval.compliant_baselines.registry import exact_law_names, get_solver, is_engine, solver_names
from impact_xval.experiments.config.errors import InterruptedRunError
from impact_xval.experiments.scoreboard.cases import (
    CASE_SETUPS,
    CASES,
    SETTINGS,
    USUAL,
    answer_case,
    warm_up_and_time,
)
from impact_xval.experiments.scoreboard.environments import Environment
from impact_xval.experiments.sweep.pool import TO_PREPARE, Slot, open_pool
from impact_xval.experiments.sweep.process import FaultError
from impact_xval.experiments.tables.folder import new_folder, write_text
from impact_xval.experiments.tables.frames import Record

#: Columns of the table of answers that `collect_answers` returns.
_COLUMNS = ["solver", "version", "microseconds", "case", "e", "arrangement", "status", "reason"]
_COLUMNS += [f"v{ball}" for ball in range(1, 6)]
#: Longest time in s that a solver may take to solve one case in all arrangements.
_LONGEST = 120.0


_Answer = TypeVar("_Answer")
_Arguments = TypeVarTuple("_Arguments")


class _Call(Protocol):
    """Type of a function such as `Worker.call`, which calls another function in the worker process of a solver."""

    def __call__(
        self, function: Callable[[None, *_Arguments], _Answer], *arguments: *_Arguments, timeout: float
    ) -> _Answer: ...


def list_entrants(names: Sequence[str] = ()) -> list[str]:
    """Return the names of the solvers of a scoreboard: all exact laws, then the engines.

    The engines are the engines in `names`, or all installed engines if `names` is empty.
    """
    engines = filter(is_engine, solver_names(on_request=True))
    installed = (name for name in engines if get_solver(name).unavailable() is None)
    return list(dict.fromkeys([*exact_law_names(), *(names or installed)]))


def list_stored(
    names: Sequence[str], root: Path, elsewhere: Sequence[tuple[str, Environment]] = ()
) -> list[str]:
    """Return the solvers whose answers `collect_answers` would read from the folder `root`, without running them.

    A solver in another environment is written with its requirement, such as ``pymunk (pymunk==7.2)``.
    """
    folder = root / "answers"
    stored = [name for name in names if _answers_path(folder, name, get_solver(name).version()).exists()]
    for name, where in elsewhere:
        if _answers_path(folder, name, where.version, where.folder.name).exists():
            stored.append(f"{name} ({where.requirement})")
    return stored


def collect_answers(
    names: Sequence[str],
    root: Path,
    workers: int,
    progress: Callable[..., None],
    elsewhere: Sequence[tuple[str, Environment]] = (),
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Return the answers of solvers to every case of the scoreboard.

    The answers are also stored in the folder `root`, so that an interrupted command can continue.

    Parameters
    ----------
    names
        Solvers of this installation.
    elsewhere
        Solvers that run in another Python environment, each with its environment.

    Returns
    -------
    here, there : DataFrame
        Answers of the solvers here, and answers of the solvers in other environments, one row per answer. Columns:
        solver, version, microseconds (wall time of one time step), case, e, arrangement, status, reason, and the final
        velocities v1 ... v5 in m/s.
    """
    in_environments = [*((name, None) for name in names), *elsewhere]
    interpreters = [environment.python for _, environment in elsewhere]
    if not (root / "answers").is_dir():
        new_folder(root)
        (root / "answers").mkdir()
    try:
        with open_pool(None, workers, interpreters=interpreters) as pool:
            futures = [
                pool.submit(_answer_all_cases, name, root / "answers", where)
                for name, where in in_environments
            ]
            for done, future in enumerate(as_completed(futures), 1):
                future.result()  # `result` raises the error of a solver that failed, which ends the command
                progress(done * len(CASES), len(futures) * len(CASES), "")
    except KeyboardInterrupt:
        raise InterruptedRunError("interrupted; answers are kept; the same command continues") from None
    answers = [future.result() for future in futures]
    here, there = (
        pd.DataFrame([row for rows in part for row in rows], columns=_COLUMNS)
        for part in (answers[: len(names)], answers[len(names) :])
    )
    return here, there


def _answer_all_cases(
    slot: Slot[None], name: str, folder: Path, where: Environment | None = None
) -> list[Record]:
    """Return the answers of a solver to every case, from the solver's file if it exists, or else from its process.

    If an environment is given, the solver runs in it, in a process that ends after the last case.
    """

    def call(
        function: Callable[[None, *_Arguments], _Answer], *arguments: *_Arguments, timeout: float
    ) -> _Answer:
        return slot.call(name, function, *arguments, timeout=timeout)

    if where is None:
        return _answer_or_read(call, name, folder, get_solver(name).version())
    worker = slot.worker_of(where.python)
    try:
        return _answer_or_read(worker.call, name, folder, where.version, where.folder.name)
    finally:
        worker.end()


def _answer_or_read(call: _Call, name: str, folder: Path, installed: str, *environment: str) -> list[Record]:
    """Return the answers of a solver from its file; if there is no file, run the solver and write the file."""
    facts: Record = {"solver": name, "version": installed, "microseconds": None}
    path = _answers_path(folder, name, installed, *environment)
    rows: list[Record] = []
    if path.exists():
        return json.loads(path.read_text(encoding="utf-8"))
    with contextlib.suppress(FaultError):  # the answer to each case will report this fault too
        facts["microseconds"] = call(warm_up_and_time, name, timeout=TO_PREPARE)
    for case, e in CASES:
        try:
            answers = call(answer_case, name, case, e, timeout=_LONGEST)
        except FaultError as fault:
            answers = [(USUAL, fault.status, fault.reason, ())]
        for arrangement, status, reason, v in answers:
            row = {"case": case, "e": e, "arrangement": arrangement, "status": status, "reason": reason}
            rows.append(facts | row | {f"v{i}": velocity for i, velocity in enumerate(v, 1)})
    write_text(path, json.dumps(rows, indent=1))
    return rows


def _answers_path(folder: Path, name: str, installed: str, *environment: str) -> Path:
    """Return the path of the file with a solver's answers.

    Its name contains a hash of the versions, the cases and the settings. The hash does not depend on the code of the
    solver, so a solver whose code changes has to state another version, or its old answers are read.
    """
    identifying = version("impact-xval"), installed, CASE_SETUPS, list(CASES), str(SETTINGS), *environment
    identity = sha256(json.dumps(identifying).encode()).hexdigest()[:12]
    return folder / f"{name.replace(':', '-')}-{identity}.json"
