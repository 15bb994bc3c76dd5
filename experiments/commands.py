"""What the commands of ``impact-xval`` do, and what they print."""

from __future__ import annotations

import json
import math
import re
import shlex
import time
from dataclasses import asdict
from pathlib import Path
from typing import Any

import typer

from compliant_baselines import get_solver, solver_names
from experiments import sweep
from experiments.config import REFERENCE, Config, from_canonical, load_config, parse_config, solvers_problem
from experiments.errors import InterruptedRunError, UserError
from experiments.grid import collision_of
from experiments.solving import answer, settings_of
from experiments.status import status_of
from experiments.store import RunFolder
from experiments.summary import Summary
from experiments.terminal import (
    error_line,
    make_console,
    print_line,
    print_table,
    show_found,
    show_progress,
    show_status,
    show_summary,
    side_by_side,
)
from model.collision import Collision, Outcome

#: What decides an impact, and keys of a configuration that the options of ``solve`` spell otherwise.
_RATIOS = ("stiffness_ratio", "mass_ratio", "e1", "e2")
_OPTIONS = {"stiffness_ratio_cutoff": "--cutoff"}


def run(
    path: Path | None, out: Path | None, workers: int | None, resume: bool, scheduler: str | None = None
) -> None:
    """Run an experiment and write everything a run writes."""
    start = time.perf_counter()
    config = load_config(path) if path is not None else parse_config({}, "built-in experiment")
    root = out if out is not None else Path("runs") / _slug(config.name)
    console = make_console()
    try:
        with show_progress(console) as progress:
            folder = sweep.run_sweep(
                config, root, workers=workers, scheduler=scheduler, resume=resume, progress=_noticed(progress)
            )
    except InterruptedRunError as stopped:
        words = [
            "impact-xval",
            "run",
            *([str(path)] if path is not None else []),
            "--out",
            str(root),
            "--resume",
        ]
        words += ["--scheduler", scheduler] if scheduler is not None else []
        error_line(f"{stopped}; finished parts are kept; to continue: {shlex.join(words)}")
        raise typer.Exit(1) from None
    summary = _write_all(folder)
    show_summary(console, summary)
    print_line(console, f"{time.perf_counter() - start:.0f} s; everything is in {folder.root}")


def search(
    path: Path | None,
    out: Path | None,
    solver: str | None,
    workers: int | None,
    resume: bool,
    scheduler: str | None,
) -> None:
    """Search a box for the worst divergence and show it."""
    from experiments.search import search_worst

    config = load_config(path) if path is not None else parse_config({}, "built-in search")
    config = _with_search_solver(config, solver)
    root = out if out is not None else Path("runs") / f"{_slug(config.name)}-search"
    console = make_console()
    try:
        with show_progress(console) as progress:
            found = search_worst(
                config, root, workers=workers, scheduler=scheduler, resume=resume, progress=_noticed(progress)
            )
    except InterruptedRunError as stopped:
        words = ["impact-xval", "search", *([str(path)] if path is not None else []), "--out", str(root)]
        words += ["--solver", solver] if solver is not None else []
        words += ["--scheduler", scheduler] if scheduler is not None else []
        error_line(
            f"{stopped}; finished generations are kept; to continue: {shlex.join([*words, '--resume'])}"
        )
        raise typer.Exit(1) from None
    show_found(console, found)
    print_line(console, f"evaluations.parquet, worst.csv and search.png are in {root}")


def _with_search_solver(config: Config, solver: str | None) -> Config:
    table = config.search.model_dump() if config.search is not None else {}
    if solver is not None:
        table["solver"] = solver
    return from_canonical(config.canonical() | {"search": table}, "--solver")


def status(root: Path, *, as_json: bool) -> None:
    """Print how far a run is."""
    found = status_of(root)
    if as_json:
        print(json.dumps(asdict(found), indent=2, allow_nan=False))
        return
    show_status(make_console(), str(root), found)


def calibrate(names: list[str] | None, root: Path) -> None:
    """Calibrate engines contact by contact and write what came of it."""
    from experiments.calibrate import MAPPINGS, calibrate_engine, calibration_of, engines_of, requests_of
    from experiments.calibration_page import findings, open_page, summary_table, write_page

    start = time.perf_counter()
    engines = engines_of(names)
    open_page(root)
    console = make_console()
    requests = [request for mapping in MAPPINGS for request in requests_of(mapping)]
    rows: list[dict[str, Any]] = []
    with show_progress(console, "contacts") as progress:
        progress(0, 0, _compile_notice())
        for engine in engines:
            for first in range(0, len(requests), 64):
                rows += calibrate_engine(engine, requests[first : first + 64])
                progress(len(rows), len(requests) * len(engines), "")
    calibration = calibration_of(rows, engines)
    write_page(root, calibration)
    print_table(console, summary_table(calibration))
    for text in findings(calibration):
        print_line(console, text)
    print_line(console, f"{time.perf_counter() - start:.0f} s; everything is in {root}")


def table(root: Path) -> None:
    """Write the summary again and show it."""
    from experiments.report import write_tables

    folder = finished(root)
    summary, _ = write_tables(folder)
    console = make_console()
    show_summary(console, summary)
    print_line(console, f"summary.md, summary.csv and summary.tex are in {folder.root}")


def figures(root: Path) -> None:
    """Draw the figures again."""
    from experiments.figures import write_figures

    folder = finished(root)
    console = make_console()
    for path, caption in write_figures(folder):
        print_line(console, f"{path}: {caption}")


def report(root: Path) -> None:
    """Write the report again."""
    from experiments.report import write_report

    print_line(make_console(), f"{write_report(finished(root))}")


def export_scene(
    root: Path | None,
    cell: str | None,
    values: dict[str, str | None],
    solvers: list[str] | None,
    out: Path | None,
) -> None:
    """Write one cell, of a run or by its ratios, as files that an engine runs alone."""
    from experiments import export

    given = {key: value for key, value in values.items() if value is not None}
    if root is not None:
        if cell is None or given:
            raise UserError(f"{root}: a cell of a run is named by --cell N, and by nothing else")
        export.export_cell(finished(root), cell, solvers, out)
        return
    missing = [f"--{key.replace('_', '-')}" for key in _RATIOS if key not in given]
    if cell is not None or missing:
        wanted = ", ".join(missing) or "the folder of a run"
        raise UserError(f"{wanted} missing; legal: DIR --cell N, or the ratios of a collision")
    names = export.names_of(solvers)
    config = _one_cell(given)
    collision = collision_of(config, config.figure_cell)
    export.export(collision, settings_of(config), names, out or Path("scenes") / "collision")


def finished(root: Path) -> RunFolder:
    """Return the folder of a run that is complete.

    Raises
    ------
    UserError
        If it is not.
    """
    if not root.is_dir():
        raise UserError(f"{root}: no such folder; legal: the folder of a run")
    folder = RunFolder(root)
    if folder.manifest().get("state") != "complete":
        raise UserError(
            f"{root}: the run is not finished; continue it with impact-xval run --out {root} --resume"
        )
    return folder


def solve(values: dict[str, str], solvers: list[str] | None, *, as_json: bool) -> None:
    """Solve one collision by several solvers and print the outcomes."""
    config = _one_cell(values)
    names = solvers or list(solver_names())
    problem = solvers_problem(names)
    if problem:
        raise UserError(f"--solver {problem}")
    collision = collision_of(config, config.figure_cell)
    settings = settings_of(config)
    notice = _compile_notice()
    if notice:
        error_line(notice)
    outcomes = [answer(get_solver(name), [collision], settings)[0] for name in names]
    if as_json:
        objects = [outcome_object(n, collision, outcome) for n, outcome in zip(names, outcomes, strict=True)]
        print(json.dumps(objects, indent=2, allow_nan=False))
        return
    reference = next((o for n, o in zip(names, outcomes, strict=True) if n == REFERENCE), None)
    console = make_console()
    console.print(side_by_side(names, collision, outcomes, reference))
    for name, outcome in zip(names, outcomes, strict=True):
        if outcome.reason:
            print_line(console, f"{name}: {outcome.status}: {outcome.reason}")


def _noticed(progress: sweep.Progress) -> sweep.Progress:
    """Add the notice of compilation to the first report: by then the input is known to be legal."""
    notices = [_compile_notice()]

    def report(done: int, total: int, line: str) -> None:
        if notices:
            progress(0, 0, notices.pop())
        progress(done, total, line)

    return report


def _compile_notice() -> str:
    """Say that kernels are about to be compiled; nothing where they have been."""
    from model.automaton import collide
    from model.compiled import is_compiled

    return "" if is_compiled(collide) else "compiling the kernels, once for each installation: some 20 s"


def outcome_object(name: str, collision: Collision, outcome: Outcome) -> dict[str, Any]:
    """Return the JSON object of an outcome: velocities per abs(v0), impulses per m1 abs(v0)."""
    speed = abs(collision.v0)
    impulse = collision.m1 * speed
    margin = outcome.grazing_margin
    return {
        "solver": name,
        "v1": _finite(outcome.v1 / speed),
        "v2": _finite(outcome.v2 / speed),
        "impulse1": _finite(outcome.impulse1 / impulse),
        "impulse2": _finite(outcome.impulse2 / impulse),
        "states": list(outcome.states),
        "status": outcome.status,
        "reason": outcome.reason,
        "grazing_margin": None if margin is None else _finite(margin),
        "diagnostics": {key: _finite(value) for key, value in outcome.diagnostics.items()},
    }


def whole(option: str, text: str | None, low: int, high: int) -> int | None:
    """Read a whole number.

    Raises
    ------
    UserError
        If it is none, or out of range.
    """
    if text is None:
        return None
    try:
        value = int(text)
    except ValueError:
        value = low - 1
    if not low <= value <= high:
        raise UserError(f"{option} = {text!r}; legal: a whole number from {low} to {high}")
    return value


def _finite(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


def _one_cell(values: dict[str, str]) -> Config:
    """Make a configuration of the options of ``solve``; errors name the options."""
    data: dict[str, Any] = {key: _number_or_text(text) for key, text in values.items()}
    cell = {key: data.pop(key) for key in _RATIOS}
    data |= {"name": "solve", "figure_cell": cell, "grid": {key: [1.0] for key in cell}}

    def option(location: Any) -> str:
        key: str = location[-1] if location else ""
        return _OPTIONS.get(key, "--" + key.replace("_", "-")) if key else "--stiffness-ratio, --mass-ratio"

    return parse_config(data, where="", name=option)


def _number_or_text(text: str) -> float | str:
    try:
        return float(text)
    except ValueError:
        return text


def _write_all(folder: RunFolder) -> Summary:
    from experiments.figures import write_figures
    from experiments.report import write_report, write_tables

    summary, _ = write_tables(folder)
    write_figures(folder)
    write_report(folder)
    return summary


def _slug(name: str) -> str:
    """Make a folder name of an experiment's name: it can neither leave the folder nor hide."""
    return re.sub(r"[^A-Za-z0-9._-]+", "-", name).strip("-.") or "run"
