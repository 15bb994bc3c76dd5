"""Commands ``run``, ``show``, ``report`` and ``compare``: they make a run of an experiment, and show its results."""

from __future__ import annotations

import contextlib
import importlib
import math
import re
import shlex
import threading
import time
from collections.abc import Generator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from impact_xval.experiments.commands.options import (
    Json,
    Workers,
    argument,
    flag_option,
    option,
    parse_number,
    parse_path,
    parse_shard,
    print_json,
    whole_number_parser,
    word_parser,
)
from impact_xval.experiments.config.errors import InterruptedRunError, UserError

if TYPE_CHECKING:
    from rich.console import Console

    from impact_xval.experiments.config.experiment import Config
    from impact_xval.experiments.measures.summary import Summary
    from impact_xval.experiments.sweep.run import Apart, Progress
    from impact_xval.experiments.tables.folder import RunFolder


def run_command(
    config: Path | None = argument(
        "[FILE.toml]", "File of the experiment; by default the built-in grid.", parse_path, None
    ),
    out: Path | None = option("DIR", "Folder to write; by default runs/NAME.", parse_path),
    workers: Workers = None,
    scheduler: str | None = option("ADDRESS", "Compute on the Dask cluster with this scheduler."),
    shard: str = option(
        "I/N", "Compute every N-th part from the I-th; all N commands share a folder.", default="1/1"
    ),
    quick: bool = flag_option("--quick", "Compute only 40 cells of the built-in grid, in a minute."),
) -> None:
    """Run an experiment: tables, figures, a page.

    Everything is written into one folder; report.html there is the page to read.
    The same command continues a run that was stopped. With --out DIR alone, the experiment in DIR is continued.

    Example: impact-xval run my.toml --out my-run
    """
    start = time.perf_counter()
    part = parse_shard(shard)
    experiment = _experiment(config, out, quick)
    # These modules are imported only when the configuration is known to be legal, because the imports take a second.
    from impact_xval.experiments.presentation.terminal import make_console
    from impact_xval.experiments.sweep.run import present_once, run_sweep

    # Some characters could make the name lead out of the folder "runs", or make it a hidden file. They are replaced.
    root = out or Path("runs") / (re.sub(r"[^A-Za-z0-9._-]+", "-", experiment.name).strip("-.") or "run")
    words: list[str | Path] = [
        "run",
        *(["--quick"] if quick else []),
        *([config] if config else []),
        "--out",
        root,
    ]
    words += ["--scheduler", scheduler] if scheduler else []
    words += ["--shard", shard] if part != (1, 1) else []
    console = make_console()

    def present(folder: RunFolder, apart: Apart) -> Summary:
        from impact_xval.experiments.presentation.report import present_run

        progress(0, 0, "drawing figures and the page")
        return present_run(folder, apart)

    def import_ahead() -> None:
        # An error is ignored here: the module is imported again when it is needed, and then the error is reported.
        with contextlib.suppress(Exception):
            importlib.import_module("impact_xval.experiments.presentation.report")

    with writing_folder(words, console, experiment.size()) as progress:
        # The report is imported in a thread while cells are solved, because importing matplotlib takes a second.
        threading.Thread(target=import_ahead).start()
        result = run_sweep(
            experiment,
            root,
            workers=workers,
            scheduler=scheduler,
            shard=part,
            progress=progress,
            to_be_presented=True,
        )
        summary = present_once(result, present)
    # The summary is None if other shards still have parts to compute, or if another shard has written the page.
    if summary is not None:
        from impact_xval.experiments.presentation.terminal import error_line
        from impact_xval.experiments.presentation.views import show_end

        show_end(console, summary, time.perf_counter() - start, str(root))
        statistics = summary.statistics
        is_overall = (statistics.measure == "velocity_divergence") & (statistics.axis == "all")
        if len(experiment.solvers) > 1 and not statistics.n[is_overall].any():
            show = shlex.join(["impact-xval", "show", str(root)])
            error_line(f"no cell could be compared; {show} says why, solver by solver")
            raise typer.Exit(1)


def show_command(
    folder: Path = argument("DIR", "Folder of the run.", parse_path),
    cell: int | None = option(
        "N", "Show one cell: outcomes and why they differ.", whole_number_parser(0, 10**7)
    ),
    json: Json = False,
) -> None:
    """Show the progress and the results of a run.

    For a finished run: median divergences, and why engines diverge. With --cell: one cell by every solver, and why they
    diverge there.

    Example: impact-xval show runs/default --cell 17
    """
    from dataclasses import asdict

    from impact_xval.experiments.presentation import views
    from impact_xval.experiments.presentation.terminal import make_console
    from impact_xval.experiments.sweep.status import status_of
    from impact_xval.experiments.tables.folder import finished_run, run_folder

    console = make_console()
    if cell is not None:
        run = finished_run(folder)
        rows = views.rows_of_cell(run, cell)
        if json:
            print_json(rows)
        else:
            views.show_cell(console, cell, rows, run.config())
        return
    status = status_of(folder)
    if json:
        print_json(asdict(status))
        return
    views.show_status(console, str(folder), status)
    if status.state == "complete":
        from impact_xval.experiments.measures.summary import summarise

        views.show_summary(console, summarise(run_folder(folder)))


def report_command(
    folder: Path = argument("DIR", "Folder of a finished run; with --supplement a new folder.", parse_path),
    only: str | None = option(
        "WHAT",
        "Write only the 'page', the 'tables' or the 'figures'.",
        word_parser("page", "tables", "figures"),
    ),
    latex: bool = flag_option("--latex", "Also write the table of divergence as summary.tex."),
    supplement: bool = flag_option(
        "--supplement", "Draw the six panels of the model's supplement into a new folder."
    ),
) -> None:
    """Write the page of a finished run again.

    The summary and the figures are written too. With --only, one of the three is written.

    Example: impact-xval report runs/default --only figures
    """
    from impact_xval.experiments.measures.summary import summarise
    from impact_xval.experiments.presentation import report as reports
    from impact_xval.experiments.presentation.terminal import make_console, print_line, report_waiting
    from impact_xval.experiments.tables.folder import check_writable, finished_run, new_folder

    console = make_console()
    if supplement:
        from impact_xval.experiments.presentation.pictures.supplement import draw_supplement_figures
        from impact_xval.experiments.presentation.style import save_figures

        new_folder(folder, "")
        with report_waiting("drawing the figures"):
            for name, caption in save_figures(draw_supplement_figures(), folder).items():
                print_line(console, f"{folder / name}.svg: {caption}")
        return
    run = finished_run(folder)
    check_writable(folder)
    with report_waiting("writing the report"):
        summary = summarise(run)
        if only in (None, "tables"):
            reports.write_tables(run, summary)
            print_line(console, f"summary.csv is in {folder}")
        if only in (None, "figures"):
            for name, caption in reports.write_figures(run, summary).items():
                print_line(console, f"{run.root / 'figures' / name}.svg: {caption}")
        if only in (None, "page"):
            print_line(console, str(reports.write_report(run, summary)))
        if latex:
            print_line(console, str(reports.write_latex(run, summary)))


def compare_command(
    run_a: Path = argument("A", "A finished run.", parse_path),
    run_b: Path = argument("B", "Another finished run of the same cells.", parse_path),
    tolerance: float = option(
        "T",
        "Largest change of a velocity per |v0|, or of D, to ignore; 0: identical bits.",
        parse_number,
        1e-9,
    ),
    json: Json = False,
) -> None:
    """Show what changed between two runs.

    Changes are listed by solver and cell, for example after an upgrade of an engine, or in CI. The exit code is 3 if a
    status, a velocity or D changed, or if only one of the runs has a solver or a cell.

    Example: impact-xval compare before after --tolerance 1e-6
    """
    from impact_xval.experiments.presentation import views
    from impact_xval.experiments.presentation.terminal import make_console, report_waiting
    from impact_xval.experiments.tables.comparison import compare_runs
    from impact_xval.experiments.tables.folder import finished_run

    if not 0 <= tolerance < math.inf:
        raise UserError(f"--tolerance = {tolerance!r}; legal: a finite number >= 0 (of |v0|)")
    with report_waiting("comparing the runs"):
        comparison = compare_runs(finished_run(run_a), finished_run(run_b), tolerance)
    if json:
        print_json(views.changes_to_json(comparison))
    else:
        views.show_changes(make_console(), str(run_a), str(run_b), comparison)
    if comparison.moved or comparison.alone or comparison.cells_alone:
        raise typer.Exit(3)


def _experiment(file: Path | None, root: Path | None, quick: bool) -> Config:
    """Return the experiment of a command.

    It is the experiment in the given file. Without a file it is the experiment of the run in the folder `root`, or the
    built-in experiment if there is no run.

    With `quick`, the built-in experiment is replaced by 40 cells of its grid.
    """
    from impact_xval.experiments.config.experiment import load_config, parse_config
    from impact_xval.experiments.tables.folder import CONFIGURATION, check_continues

    if file is not None:
        if quick:
            raise UserError(f"--quick with {file}: it is for the built-in grid; legal: one of both")
        check_holds_something(file, "run")
        return load_config(file)
    built_in = parse_config({}, "built-in experiment")
    if quick:  # five stiffness ratios, and the ends of the other axes
        steps = {"stiffness_ratio": 3, "mass_ratio": 2, "e1": 3, "e2": 3}
        axes = {name: values[:: steps[name]] for name, values in built_in.grid.axes().items()}
        built_in = parse_config({"name": "quick", "grid": axes}, "built-in experiment")
    if root is None or not (root / CONFIGURATION).exists():
        return built_in
    check_continues(root)
    kept = load_config(root / CONFIGURATION)
    if quick and kept.identity() != built_in.identity():
        raise UserError(f"--quick with --out {root}, which has another run; legal: one of both")
    return kept


def check_holds_something(file: Path, command: str) -> None:
    """Raise a UserError if a TOML file has no keys.

    With such a file the built-in experiment or test would run by mistake.
    """
    from impact_xval.experiments.config.errors import read_toml

    if not read_toml(file):
        without = f"the built-in design needs no file: impact-xval {command}"
        raise UserError(f"{file}: empty; legal: a TOML file with a key or more; {without}")


@contextlib.contextmanager
def writing_folder(words: Sequence[str | Path], console: Console, before: str) -> Generator[Progress]:
    """Show the progress of the `with` block, which writes into a folder; yield the function that reports progress.

    If the block is interrupted, the message of the error names the command that continues the work.

    Parameters
    ----------
    words : sequence of str or Path
        Words of the command that continues the work, without ``impact-xval``.
    console : Console
    before : str
        Line that is printed with the first report of progress. By then the input is known to be legal.
    """
    from impact_xval.experiments.presentation.terminal import COMPILING, show_progress
    from impact_xval.model.compiled import is_compiled
    from impact_xval.model.pair.kernel import collide_all

    notices = [before, "" if is_compiled(collide_all) else COMPILING]
    try:
        with show_progress(console) as progress:

            def report(done: int, total: int, line: str) -> None:
                while notices:
                    progress(0, 0, notices.pop(0))
                progress(done, total, line)

            yield report
    # Ctrl-C can come just before and just after the run itself, which raises an `InterruptedRunError`.
    except (InterruptedRunError, KeyboardInterrupt) as stopped:
        command = shlex.join(["impact-xval", *map(str, words)])
        line = f"{str(stopped) or 'interrupted'}; finished parts are kept; to continue: {command}"
        raise InterruptedRunError(line) from None
