"""What the commands of ``impact-xval`` do, and what they print."""

from __future__ import annotations

import json
import re
import shlex
import time
from dataclasses import asdict
from pathlib import Path
from typing import Any

import typer

from impact_xval.experiments.config.configuration import (
    Config,
    from_canonical,
    load_config,
    parse_config,
)
from impact_xval.experiments.config.errors import InterruptedRunError
from impact_xval.experiments.measures.summary import Summary
from impact_xval.experiments.presentation.terminal import (
    error_line,
    make_console,
    print_line,
    print_table,
    show_progress,
)
from impact_xval.experiments.presentation.views import show_found, show_status, show_summary
from impact_xval.experiments.sweep import run as sweep
from impact_xval.experiments.sweep.status import status_of
from impact_xval.experiments.tables.folders import finished, new_folder
from impact_xval.experiments.tables.store import RunFolder


def run(
    path: Path | None, out: Path | None, workers: int | None, resume: bool, scheduler: str | None = None
) -> None:
    """Run an experiment and write everything a run writes.

    Raises
    ------
    UserError
        If the configuration is illegal, or the folder or the cluster cannot be used.
    typer.Exit
        With code 1, if the run was stopped; what is finished is kept.
    """
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
    """Search a box for the worst divergence and show it.

    Raises
    ------
    UserError
        If the configuration or the solver is illegal, or the folder or the cluster cannot be used.
    typer.Exit
        With code 1, if the search was stopped; finished generations are kept.
    """
    from impact_xval.experiments.presentation.search_figure import write_figure
    from impact_xval.experiments.sweep.search import search_worst

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
    write_figure(RunFolder(root), config, found)
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
    from impact_xval.experiments.commands.calibrate import (
        MAPPINGS,
        calibrate_engine,
        calibration_of,
        engines_of,
        requests_of,
    )
    from impact_xval.experiments.commands.calibration_page import findings, summary_table, write_page

    start = time.perf_counter()
    engines = engines_of(names)
    new_folder(root)
    console = make_console()
    requests = [request for mapping in MAPPINGS for request in requests_of(mapping)]
    rows: list[dict[str, Any]] = []
    with show_progress(console, "contacts") as progress:
        progress(0, 0, compile_notice())
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
    from impact_xval.experiments.presentation.report import write_tables

    folder = finished(root)
    summary = write_tables(folder)
    console = make_console()
    show_summary(console, summary)
    print_line(console, f"summary.md, summary.csv and summary.tex are in {folder.root}")


def figures(root: Path) -> None:
    """Draw the figures again."""
    from impact_xval.experiments.presentation.figures import write_figures

    folder = finished(root)
    console = make_console()
    for path, caption in write_figures(folder):
        print_line(console, f"{path}: {caption}")


def report(root: Path) -> None:
    """Write the report again."""
    from impact_xval.experiments.presentation.report import write_report

    print_line(make_console(), f"{write_report(finished(root))}")


def _noticed(progress: sweep.Progress) -> sweep.Progress:
    """Add the notice of compilation to the first report: by then the input is known to be legal."""
    notices = [compile_notice()]

    def report(done: int, total: int, line: str) -> None:
        if notices:
            progress(0, 0, notices.pop())
        progress(done, total, line)

    return report


def compile_notice() -> str:
    """Say that kernels are about to be compiled; nothing where they have been."""
    from impact_xval.model.compiled import is_compiled
    from impact_xval.model.diagram import collide

    return "" if is_compiled(collide) else "compiling the kernels, once for each installation: some 20 s"


def _write_all(folder: RunFolder) -> Summary:
    from impact_xval.experiments.presentation.figures import write_figures
    from impact_xval.experiments.presentation.report import write_report, write_tables

    summary = write_tables(folder)
    write_figures(folder, summary.ladder)
    write_report(folder, summary)
    return summary


def _slug(name: str) -> str:
    """Make a folder name of an experiment's name: it can neither leave the folder nor hide."""
    return re.sub(r"[^A-Za-z0-9._-]+", "-", name).strip("-.") or "run"
