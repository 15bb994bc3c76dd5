"""Answers of every solver, in processes apart: one that dies or hangs costs the answers that it fails to give.

What a solver has answered is kept, a file a solver, for a board that was stopped.
"""

from __future__ import annotations

import contextlib
import json
import time
from collections.abc import Callable, Sequence
from concurrent.futures import as_completed
from hashlib import sha256
from importlib.metadata import version
from pathlib import Path
from typing import Any

import pandas as pd

from impact_xval.compliant_baselines.answers import answer, said
from impact_xval.compliant_baselines.engines.engine import Engine
from impact_xval.compliant_baselines.engines.stepping import ALOFT, Run
from impact_xval.compliant_baselines.registry import engine_free_names, get_solver, is_engine, solver_names
from impact_xval.compliant_baselines.solver import Settings
from impact_xval.experiments.config.errors import InterruptedRunError
from impact_xval.experiments.scoreboard.cases import CASES, COLUMNS, MIRRORED, USUAL, arrangements, column
from impact_xval.experiments.sweep.pool import TO_PREPARE, Slot, open_pool
from impact_xval.experiments.sweep.process import FaultError
from impact_xval.experiments.tables.folder import write_text
from impact_xval.model.collision import RESULT_STATUSES

#: Steps after which an impact is given up: ten times those of the longest.
_SETTINGS = Settings(max_steps=200_000)

#: Seconds that one case may take in all arrangements.
_LONGEST = 120.0


def entrants(names: Sequence[str] = ()) -> list[str]:
    """Name the exact laws, and the engines that are given, or all that are installed."""
    engines = filter(is_engine, solver_names(on_request=True))
    installed = (name for name in engines if get_solver(name).unavailable() is None)
    return list(dict.fromkeys([*engine_free_names(), *(names or installed)]))


def play(
    names: Sequence[str], root: Path, workers: int, progress: Callable[[int, int, str], None]
) -> pd.DataFrame:
    """Have solvers answer every case, and keep what each has answered in a folder.

    A row an answer: solver, its version and microseconds a step, case, e, arrangement, status, reason, and v1 ... v5 in
    m/s.
    """
    (root / "answers").mkdir(parents=True, exist_ok=True)
    try:
        with open_pool(None, workers) as pool:
            asked = [pool.submit(_kept, name, root / "answers") for name in names]
            for done, future in enumerate(as_completed(asked), 1):
                future.result()  # an error ends all at once
                progress(done * len(CASES), len(names) * len(CASES), "")
    except KeyboardInterrupt:
        line = "interrupted; solvers that have answered are kept; the same command continues"
        raise InterruptedRunError(line) from None
    return pd.DataFrame([row for future in asked for row in future.result()])


def _kept(slot: Slot, name: str, folder: Path) -> list[dict[str, Any]]:
    """Take what a solver has answered from its file, or have it answer; versions and cases are in the file's name."""
    asked = version("impact-xval"), get_solver(name).version(), COLUMNS, CASES, str(_SETTINGS)
    identity = sha256(json.dumps(asked).encode()).hexdigest()[:12]
    path = folder / f"{name.replace(':', '-')}-{identity}.json"
    if not path.exists():
        write_text(path, json.dumps(_played(slot, name), indent=1))
    return json.loads(path.read_text(encoding="utf-8"))


def _played(slot: Slot, name: str) -> list[dict[str, Any]]:
    """Have a solver answer every case in the process of a slot."""
    facts, rows = {"solver": name, "version": get_solver(name).version(), "microseconds": None}, []
    with contextlib.suppress(FaultError):  # then each case says so
        facts["microseconds"] = slot.call(name, _prepared, name, timeout=TO_PREPARE)
    for case, e in CASES:
        try:
            answers = slot.call(name, _answers, name, case, e, timeout=_LONGEST)
        except FaultError as fault:
            answers = [_row(USUAL, fault.status, fault.reason)]
        rows += [{**facts, "case": case, "e": e, **row} for row in answers]
    return rows


def _row(arrangement: str, status: str, reason: str = "", v: Sequence[float] = ()) -> dict[str, Any]:
    velocities = {f"v{i}": value for i, value in enumerate(v, 1)}
    return {"arrangement": arrangement, "status": status, "reason": reason, **velocities}


def _prepared(_: object, name: str) -> float | None:
    """Compile and import what a solver needs; microseconds a step of an engine, while balls touch."""
    solver, collision, n = get_solver(name), column("drop, k2/k1 = 1", 0.9), 500
    if not isinstance(solver, Engine) or solver.unavailable() is not None:
        answer(solver, [collision], _SETTINGS)
        return None
    scenes = arrangements(solver, collision, _SETTINGS)
    if isinstance(scenes, str):
        return None
    with solver.running():
        world = solver.world(scenes[USUAL])
        start = time.perf_counter()
        world.advance(n)
        return 1e6 * (time.perf_counter() - start) / n


def _answers(_: object, name: str, case: str, e: float) -> list[dict[str, Any]]:
    """Answer a case: an engine in every arrangement, others in the usual one."""
    solver = get_solver(name)
    if not isinstance(solver, Engine) or solver.unavailable() is not None:
        (o,) = answer(solver, [column(case, e)], _SETTINGS)
        return [_row(USUAL, o.status, o.reason, o.velocities if o.status in RESULT_STATUSES else ())]
    try:
        scenes = arrangements(solver, column(case, e), _SETTINGS)
        if isinstance(scenes, str):
            return [_row(USUAL, "unrepresentable", scenes)]
        runs = solver.run(list(scenes.values()), _SETTINGS.max_steps)
    except Exception as error:  # of an engine that met what it does not expect
        return [_row(USUAL, "crashed", said(error))]
    return [_of(arrangement, run) for arrangement, run in zip(scenes, runs, strict=True)]


def _of(arrangement: str, run: Run) -> dict[str, Any]:
    """Make the row of a run; balls of a mirrored one are numbered as in the others.

    One given up in a long flight, after which balls that hardly approach would meet, has the velocities of that flight.
    """
    reason = run.problem() or run.too_much_energy()
    v = run.reported if run.over or run.end == ALOFT else ()
    v = tuple(-each for each in v[::-1]) if arrangement == MIRRORED else v
    return _row(arrangement, "unconverged" if run.over and reason else run.status, reason, v)
