"""Answers of every solver, in processes apart: one that dies or hangs costs the answers that it fails to give.

What a solver has answered is kept, a file a solver, for a board that was stopped.
"""

from __future__ import annotations

import contextlib
import json
import time
from collections.abc import Callable, Sequence
from concurrent.futures import as_completed
from dataclasses import replace
from hashlib import sha256
from importlib.metadata import version
from pathlib import Path
from typing import Any

import pandas as pd

from impact_xval.compliant_baselines.answers import answer, said
from impact_xval.compliant_baselines.engines.engine import Engine
from impact_xval.compliant_baselines.engines.stepping import ALOFT, Run
from impact_xval.compliant_baselines.registry import (
    engine_free_names,
    get_solver,
    is_engine,
    kind_of,
    solver_names,
)
from impact_xval.compliant_baselines.solver import Settings
from impact_xval.experiments.config.errors import InterruptedRunError
from impact_xval.experiments.scoreboard.cases import (
    COLUMNS,
    MIRRORED,
    RESTITUTIONS,
    USUAL,
    Case,
    arrangements,
    cases,
)
from impact_xval.experiments.sweep.pool import TO_PREPARE, Slot, open_pool
from impact_xval.experiments.sweep.process import FaultError
from impact_xval.experiments.tables.folder import write_text
from impact_xval.model.collision import RESULT_STATUSES

#: Steps after which an impact is given up: ten times those of the longest.
_SETTINGS = Settings(max_steps=200_000)

#: Seconds that one case may take in all arrangements.
_LONGEST = 120.0

Progress = Callable[[int, int, str], None]


def entrants(names: Sequence[str] = ()) -> list[str]:
    """Name the exact laws, and the engines that are given, or all that are installed."""
    exact = engine_free_names()
    if names:
        return [*exact, *(name for name in names if name not in exact)]
    engines = (name for name in solver_names(on_request=True) if is_engine(name))
    return [*exact, *(name for name in engines if get_solver(name).unavailable() is None)]


def play(
    names: Sequence[str], root: Path, workers: int, progress: Progress
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Have solvers answer every case.

    Parameters
    ----------
    names : sequence of str
        Of solvers.
    root : Path
        Folder where what has been answered is kept, and taken from if versions and cases are those of now.
    workers : int
        Processes at a time; no answer depends on it.
    progress : callable
        Given how many cells (a case by a solver) are done, of how many, and a line.

    Returns
    -------
    solvers : DataFrame
        A row a solver: solver, kind, version, microseconds (of a step), reason (why it is not there).
    answers : DataFrame
        A row an answer: solver, case, e, arrangement, status, reason, steps, v1 ... v5 in m/s.
    """
    (root / "answers").mkdir(parents=True, exist_ok=True)
    found: dict[str, Any] = {}
    n = len(cases())
    try:
        with open_pool(None, workers) as pool:
            asked = {pool.submit(_kept, name, root / "answers"): name for name in names}
            for done, future in enumerate(as_completed(asked), 1):
                found[asked[future]] = future.result()
                progress(done * n, len(names) * n, "")
    except KeyboardInterrupt:
        line = f"interrupted; {len(found)} of {len(names)} solvers are kept; the same command continues"
        raise InterruptedRunError(line) from None
    parts = [found[name] for name in names]
    answers = pd.DataFrame([row for part in parts for row in part["answers"]])
    return pd.DataFrame([part["solver"] for part in parts]), answers


def _kept(slot: Slot, name: str, folder: Path) -> dict[str, Any]:
    """Take what a solver has answered from its file, or have it answer."""
    path = folder / f"{name.replace(':', '-')}.json"
    asked = version("impact-xval"), get_solver(name).version(), COLUMNS, RESTITUTIONS, str(_SETTINGS)
    identity = sha256(json.dumps(asked).encode()).hexdigest()
    with contextlib.suppress(FileNotFoundError, ValueError):
        kept = json.loads(path.read_text(encoding="utf-8"))
        if kept["identity"] == identity:
            return kept
    part = {"identity": identity, **_played(slot, name)}
    write_text(path, json.dumps(part, indent=1))
    return part


def _played(slot: Slot, name: str) -> dict[str, Any]:
    """Have a solver answer every case in the process of a slot."""
    solver = {"solver": name, "kind": kind_of(name), "version": get_solver(name).version()}
    try:
        microseconds, reason = slot.call(name, _prepared, name, timeout=TO_PREPARE)
    except FaultError as fault:
        microseconds, reason = None, fault.reason
    answers = []
    for case in cases():
        try:
            rows = slot.call(name, _answers, name, case, timeout=_LONGEST)
        except FaultError as fault:
            rows = [_row(USUAL, fault.status, fault.reason)]
        answers += [{"solver": name, "case": case.name, "e": case.e, **row} for row in rows]
    return {"solver": {**solver, "microseconds": microseconds, "reason": reason}, "answers": answers}


def _row(
    arrangement: str, status: str, reason: str = "", steps: int = 0, v: Sequence[float] = ()
) -> dict[str, Any]:
    velocities = {f"v{i}": value for i, value in enumerate(v, 1)}
    return {"arrangement": arrangement, "status": status, "reason": reason, "steps": steps, **velocities}


def _prepared(_: object, name: str) -> tuple[float | None, str]:
    """Compile and import what a solver needs; microseconds a step of an engine, and why it cannot run."""
    solver, basic = get_solver(name), Case("drop, k2/k1 = 1", 0.9)
    reason = solver.unavailable() or ""
    if reason or not isinstance(solver, Engine):
        answer(solver, [basic.arranged.column()], _SETTINGS)
        return None, reason
    scene = solver.scene_or_refusal(basic.arranged.column(), replace(_SETTINGS, **solver.as_set))
    if isinstance(scene, str):
        return None, ""
    with solver.running():
        world, n = solver.world(scene), 500
        start = time.perf_counter()
        world.advance(n)
        return 1e6 * (time.perf_counter() - start) / n, ""


def _answers(_: object, name: str, case: Case) -> list[dict[str, Any]]:
    """Answer a case: an engine in every arrangement, others in the usual one."""
    solver = get_solver(name)
    if not isinstance(solver, Engine) or solver.unavailable() is not None:
        (o,) = answer(solver, [case.arranged.column()], _SETTINGS)
        return [_row(USUAL, o.status, o.reason, 0, o.velocities if o.status in RESULT_STATUSES else ())]
    settings = replace(_SETTINGS, **solver.as_set)
    try:
        scenes = arrangements(solver, case, settings)
        if isinstance(scenes, str):
            return [_row(USUAL, "unrepresentable", scenes)]
        runs = solver.run(list(scenes.values()), settings.max_steps)
    except Exception as error:  # of an engine that met what it does not expect
        return [_row(USUAL, "crashed", said(error))]
    return [_of(arrangement, run) for arrangement, run in zip(scenes, runs, strict=True)]


def _of(arrangement: str, run: Run) -> dict[str, Any]:
    """Make the row of a run; balls of a mirrored one are numbered as in the others.

    One given up in a long flight, after which balls that hardly approach would meet, has the velocities of that flight.
    """
    if not run.over and run.end != ALOFT:
        return _row(arrangement, run.status, run.problem(), run.n_steps)
    reason = run.problem() or run.too_much_energy()
    status = "unconverged" if run.over and reason else run.status
    v = run.reported if run.over else tuple(run.velocities.tolist())
    v = tuple(-each for each in v[::-1]) if arrangement == MIRRORED else v
    return _row(arrangement, status, reason, run.n_steps, v)
