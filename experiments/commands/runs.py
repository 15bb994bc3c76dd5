"""Commands that make a run, and those that show a run's folder."""

from __future__ import annotations

import contextlib
import math
import re
import shlex
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from impact_xval.experiments.commands.options import (
    Folder,
    JsonObject,
    Resume,
    Scheduler,
    Workers,
    config_file,
    folder_to_write,
    number,
    path,
)
from impact_xval.experiments.commands.supervision import last_word
from impact_xval.experiments.config.errors import InterruptedRunError, UserError

if TYPE_CHECKING:
    from impact_xval.experiments.config.experiment import Config
    from impact_xval.experiments.presentation.terminal import MedianRows
    from impact_xval.experiments.sweep.run import Progress
    from impact_xval.experiments.tables.store import RunFolder


def run(
    config: Annotated[Path | None, config_file("The experiment; without it, the built-in grid.")] = None,
    out: Annotated[Path | None, folder_to_write("by default runs/NAME")] = None,
    workers: Workers = None,
    quick: Annotated[
        bool, typer.Option("--quick", help="A first taste: 40 cells of the built-in grid, in seconds.")
    ] = False,
    resume: Resume = False,
    scheduler: Scheduler = None,
) -> None:
    """Run an experiment over its cells: tables, summary, figures and a report in one folder.

    A folder that holds a run is continued; without a file, by the experiment that was begun there.
    """
    start = time.perf_counter()
    if quick and config is not None:
        raise UserError(f"--quick with {config}: it is for the built-in grid; legal: one of both")
    kept = _kept(out) if config is None and out is not None and out.is_dir() else None
    if quick and kept is not None and kept.identity() != _quick().identity():
        raise UserError(f"--quick with --out {out}: holds another run; legal: --out {out}")
    experiment = kept or (_quick() if quick else _experiment(config, "built-in experiment"))
    # Imported when the configuration is known to be legal: what solves takes a second.
    from impact_xval.experiments.presentation.terminal import make_console
    from impact_xval.experiments.sweep.run import run_sweep
    from impact_xval.experiments.sweep.status import Medians

    root = out if out is not None else Path("runs") / _slug(experiment.name)
    what = "--quick" if quick else config
    words = ["run", what, "--out", root, "--resume", *_option("--scheduler", scheduler)]
    console = make_console()
    medians = Medians(experiment.solvers)
    summaries = []

    def presented(folder: RunFolder) -> None:
        # Imported when the cells are done: matplotlib takes a second that the first cells would have to wait for.
        from impact_xval.experiments.presentation.report import present

        summaries.append(present(folder))

    with _writing(root, words, console, medians.rows, _size(experiment)) as progress:
        folder = run_sweep(
            experiment,
            root,
            workers=workers,
            scheduler=scheduler,
            progress=progress,
            on_rows=medians.add,
            present=presented,
        )
    from impact_xval.experiments.presentation.views import show_end

    show_end(console, summaries[-1], time.perf_counter() - start, str(folder.root))


def status(
    folder: Annotated[
        Path,
        typer.Argument(metavar="DIR", parser=path("DIR"), help="Folder of a run, finished or not."),
    ],
    json: JsonObject = False,
) -> None:
    """Say what a run has done, what failed and why, and how fast it goes; also while it runs."""
    from dataclasses import asdict
    from json import dumps

    from impact_xval.experiments.presentation.terminal import make_console
    from impact_xval.experiments.presentation.views import show_status
    from impact_xval.experiments.sweep.status import status_of

    found = status_of(folder)
    if json:
        typer.echo(dumps(asdict(found), indent=2, allow_nan=False))
    else:
        show_status(make_console(), str(folder), found)


def table(folder: Folder) -> None:
    """Write the summary of a finished run again, and show it."""
    from impact_xval.experiments.presentation.report import write_tables
    from impact_xval.experiments.presentation.terminal import at_work, make_console, print_line
    from impact_xval.experiments.presentation.views import show_summary
    from impact_xval.experiments.tables.folders import finished

    with at_work("writing the summary"):
        summary = write_tables(finished(folder))
    console = make_console()
    show_summary(console, summary)
    print_line(console, f"summary.md, summary.csv and summary.tex are in {folder}")


def figures(
    folder: Annotated[
        Path | None, typer.Argument(metavar="[DIR]", parser=path("DIR"), help="Folder of a finished run.")
    ] = None,
    supplement: Annotated[
        bool, typer.Option("--supplement", help="Draw the figures of the model's supplement; needs no run.")
    ] = False,
    out: Annotated[Path | None, folder_to_write("with --supplement, by default supplement")] = None,
) -> None:
    """Draw the figures of a finished run again, or the six panels of the model's supplement."""
    from impact_xval.experiments.presentation.terminal import at_work, make_console, print_line
    from impact_xval.experiments.tables.folders import finished, new_folder

    if (folder is not None) == supplement:
        given = f"{folder} with --supplement" if supplement else "DIR missing"
        raise UserError(f"{given}; legal: the folder of a run, or --supplement")
    if out is not None and not supplement:
        raise UserError(f"--out {out}: figures of a run are in its folder; legal: with --supplement")
    console = make_console()
    with at_work("drawing the figures"):
        if folder is not None:
            from impact_xval.experiments.presentation.figures import write_figures

            there = write_figures(finished(folder))
        else:
            from impact_xval.experiments.presentation.pictures.supplement import write_supplement_figures

            root = out or Path("supplement")
            new_folder(root)
            there = write_supplement_figures(root)
    for drawn, caption in there:
        print_line(console, f"{drawn}: {caption}")


def report(folder: Folder) -> None:
    """Write the report of a finished run again."""
    from impact_xval.experiments.presentation.report import write_report
    from impact_xval.experiments.presentation.terminal import at_work, make_console, print_line
    from impact_xval.experiments.tables.folders import finished

    with at_work("writing the report"):
        page = write_report(finished(folder))
    print_line(make_console(), str(page))


def compare_runs(
    run_a: Annotated[Path, typer.Argument(metavar="RUN_A", parser=path("RUN_A"), help="A finished run.")],
    run_b: Annotated[
        Path, typer.Argument(metavar="RUN_B", parser=path("RUN_B"), help="A finished run of the same cells.")
    ],
    tolerance: Annotated[
        str,
        typer.Option(
            metavar="X", help="Largest change of a velocity per |v0|, and of D, that is none; 0: no bit."
        ),
    ] = "1e-9",
    json: JsonObject = False,
) -> None:
    """Show what moved between two runs, by solver and cell: after an upgrade of an engine, or in CI.

    Exit code 0 if nothing moved, 1 if something did: a status, a velocity or D.
    """
    from json import dumps

    from impact_xval.experiments.presentation.terminal import at_work, make_console
    from impact_xval.experiments.presentation.views import changes_object, show_changes
    from impact_xval.experiments.tables.comparison import compare
    from impact_xval.experiments.tables.folders import finished

    allowed = number("--tolerance", tolerance)
    if not 0 <= allowed < math.inf:
        raise UserError(f"--tolerance = {tolerance!r:.60}; legal: a finite number >= 0 (of |v0|)")
    with at_work("comparing the runs"):
        found = compare(finished(run_a), finished(run_b), allowed)
    if json:
        typer.echo(dumps(changes_object(found), indent=2, allow_nan=False))
    else:
        show_changes(make_console(), str(run_a), str(run_b), found)
    if found.moved:
        raise typer.Exit(1)


#: What is said before.
COMPILING = "compiling the kernels, once for each installation: half a minute or more"


def compile_notice() -> str:
    """Say that kernels are about to be compiled; nothing where they have been."""
    from impact_xval.model.compiled import is_compiled
    from impact_xval.model.pair.kernel import collide_all

    return "" if is_compiled(collide_all) else COMPILING


def _experiment(path: Path | None, built_in: str) -> Config:
    from impact_xval.experiments.config.experiment import load_config, parse_config

    return load_config(path) if path is not None else parse_config({}, built_in)


def _quick() -> Config:
    """Return the built-in experiment on a few of its cells: five stiffness ratios, and the ends of the other axes."""
    from impact_xval.experiments.config.experiment import parse_config

    steps = {"stiffness_ratio": 3, "mass_ratio": 2, "e1": 3, "e2": 3}
    axes = {name: values[:: steps[name]] for name, values in parse_config({}).grid.axes().items()}
    return parse_config({"name": "quick", "grid": axes}, "built-in experiment")


def _size(experiment: Config) -> str:
    """Say how many cells the axes of an experiment make, and which of them took their defaults; "" without axes."""
    from impact_xval.experiments.presentation.pages import phrase

    if experiment.sample is not None or experiment.cells is not None:
        return ""
    table = experiment.column or experiment.grid
    axes = [(name, length, name in table.model_fields_set) for name, length in table.lengths().items()]
    what = "cells" if experiment.column is None else "columns"
    return phrase("progress.md.j2", "size", table.count(), what, axes)


def _kept(root: Path) -> Config | None:
    """Read the configuration of the run in a folder, if there is one that says what it is of."""
    from impact_xval.experiments.tables.store import DamagedManifestError, RunFolder

    try:
        return RunFolder(root).kept_config()
    except DamagedManifestError:
        return None


def _option(name: str, value: str | None) -> list[str]:
    return [] if value is None else [name, value]


def _slug(name: str) -> str:
    """Make a folder name of an experiment's name: it can neither leave the folder nor hide."""
    return re.sub(r"[^A-Za-z0-9._-]+", "-", name).strip("-.") or "run"


@contextlib.contextmanager
def _writing(
    root: Path,
    words: list[Any],
    console: Any,
    medians: MedianRows,
    before: str,
) -> Iterator[Progress]:
    """Show the progress of what writes a folder; one line and exit code 1 where it is stopped.

    Parameters
    ----------
    root : Path
        The folder; where the input is wrong, no empty folder is left above it that was not there.
    words : list
        Of the command that continues it; None is left out.
    console : Console
    medians : callable
        As for `terminal.show_progress`.
    before : str
        What is said before anything is computed.
    """
    from impact_xval.compliant_baselines.answers import visible
    from impact_xval.experiments.presentation.terminal import show_progress

    new = [folder for folder in root.parents if not folder.exists()]
    try:
        with show_progress(console, medians=medians) as progress:
            yield _noticed(progress, before)
    except UserError:
        for folder in new:
            with contextlib.suppress(OSError):
                folder.rmdir()
        raise
    except InterruptedRunError as stopped:
        command = shlex.join(["impact-xval", *(str(word) for word in words if word is not None)])
        last_word(visible(f"{stopped}; finished parts are kept; to continue: {command}"))
        raise typer.Exit(1) from None


def _noticed(progress: Callable[[int, int, str], None], before: str) -> Progress:
    """Add a line and the notice of compilation to the first report: by then the input is known to be legal."""
    notices = [before, compile_notice()]

    def report(done: int, total: int, line: str) -> None:
        while notices:
            progress(0, 0, notices.pop(0))
        progress(done, total, line)

    return report
