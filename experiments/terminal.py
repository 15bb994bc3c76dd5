"""What the commands print: progress, tables and lines, on a terminal or in a log."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import timedelta

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.table import Table as RichTable
from rich.text import Text

from experiments.divergence import COMPARABLE, divergence
from experiments.document import Table
from experiments.findings import findings, grazing_table, overall_table, status_table
from experiments.numbers import number
from experiments.search import Found
from experiments.status import RunStatus
from experiments.summary import AXES, SUMMARISED, Summary
from model.collision import Collision, Outcome

#: Reasons that `show_status` prints.
_REASONS = 12

#: Columns of a page that is not a terminal.
_WIDTH = 150


def side_by_side(
    names: list[str], collision: Collision, outcomes: list[Outcome], reference: Outcome | None
) -> RichTable:
    """Tabulate one collision by several solvers; velocities per abs(v0), impulses per m1 abs(v0)."""
    shown = RichTable(box=None, pad_edge=False)
    shown.add_column("solver")
    shown.add_column("status")
    for title in ("v1/|v0|", "v2/|v0|", "I1/(m1|v0|)", "I2/(m1|v0|)", "D"):
        shown.add_column(title, justify="right")
    shown.add_column("states")
    speed = abs(collision.v0)
    for name, outcome in zip(names, outcomes, strict=True):
        if outcome.status not in COMPARABLE:
            shown.add_row(name, outcome.status, *["-"] * 6)
            continue
        impulse = collision.m1 * speed
        away = divergence(collision, reference, outcome)["velocity_divergence"] if reference else None
        scaled = (
            outcome.v1 / speed,
            outcome.v2 / speed,
            outcome.impulse1 / impulse,
            outcome.impulse2 / impulse,
        )
        cells = [f"{value:.6f}" for value in scaled]
        shown.add_row(
            name, outcome.status, *cells, "-" if away is None else number(away), " ".join(outcome.states)
        )
    return shown


def show_summary(console: Console, summary: Summary) -> None:
    """Print what a run found."""
    for shown in (overall_table(summary), grazing_table(summary), status_table(summary)):
        print_table(console, shown)
    print_line(console, "")
    for text in findings(summary):
        print_line(console, text)


def print_table(console: Console, table: Table) -> None:
    """Print a table below its caption."""
    print_line(console, "")
    print_line(console, table.caption)
    console.print(_rich(table))


def show_status(console: Console, root: str, status: RunStatus) -> None:
    """Print how far a run is."""
    share = status.cells_done / status.cells if status.cells else 1.0
    rate = f"; {number(status.rate)} cells/s" if status.rate else ""
    left = f", about {_duration(status.seconds_left)} left" if status.seconds_left is not None else ""
    who = f" ({status.owner})" if status.owner else ""
    print_line(console, f"{root}: {status.state}{who}")
    print_line(
        console,
        f"{status.cells_done} of {status.cells} cells ({100 * share:.1f} %), "
        f"{status.parts_done} of {status.parts} parts{rate}{left}",
    )
    if status.parts_damaged:
        print_line(console, f"{status.parts_damaged} parts are damaged; --resume computes them again")
    names = sorted({name for counts in status.statuses.values() for name in counts})
    rows = [
        (solver, *(str(counts.get(name, 0)) for name in names)) for solver, counts in status.statuses.items()
    ]
    if rows:
        console.print(_rich(Table("", ("solver", *names), rows)))
    if status.reasons:
        shown = [(solver, state, reason, str(n)) for solver, state, reason, n in status.reasons[:_REASONS]]
        console.print(_rich(Table("", ("solver", "status", "reason", "cells"), shown, text_columns=3)))
        if len(status.reasons) > _REASONS:
            print_line(console, f"and {len(status.reasons) - _REASONS} reasons more")
    if status.state == "stopped":
        print_line(
            console, f"to continue: impact-xval run --out {root} --resume, with the same configuration"
        )


def show_found(console: Console, found: Found) -> None:
    """Print what a search found."""
    measure = found.search.measure
    print_line(
        console,
        f"{found.search.solver}: {found.evaluated} cells evaluated; {found.grazing} beside a jump of the model and "
        f"{found.failed} without a result do not count",
    )
    if not found.rows:
        print_line(console, "no cell counts: nothing was found")
        return
    header = ("cell", *AXES.values(), SUMMARISED[measure], "model's path", "solver's path")
    rows = [
        (
            str(row["cell"]),
            *(f"{row[axis]:.6g}" for axis in AXES),
            number(abs(row[measure]), 6),
            _short_path(row["model_states"]),
            _short_path(row["states"]),
        )
        for row in found.rows
    ]
    console.print(_rich(Table("", header, rows, text_columns=0)))
    steps = ", ".join(
        f"{number(entry['value'], 6) if entry['value'] is not None else entry['status']} at "
        f"{number(entry['step_fraction'])}"
        for entry in found.confirmed
    )
    print_line(console, f"the worst again, by step over the contact period: {steps}")


def _short_path(states: str | None) -> str:
    """Cut a long state path in its middle."""
    names = (states or "-").split()
    return (
        " ".join(names)
        if len(names) <= 8
        else " ".join([*names[:4], f"({len(names) - 6} more)", *names[-2:]])
    )


def _duration(seconds: float) -> str:
    return str(timedelta(seconds=round(seconds)))


def _rich(table: Table) -> RichTable:
    shown = RichTable(box=None, pad_edge=False)
    for position, title in enumerate(table.header):
        shown.add_column(Text(title), justify="left" if position < table.text_columns else "right")
    for row in table.rows:
        shown.add_row(*map(Text, row))
    return shown


@contextmanager
def show_progress(console: Console, unit: str = "cells") -> Iterator[Callable[[int, int, str], None]]:
    """Show progress: a bar on a terminal, a line for every tenth of the work otherwise."""
    if console.is_terminal:
        columns = (
            TextColumn(unit),
            BarColumn(),
            MofNCompleteColumn(),
            TimeElapsedColumn(),
            TimeRemainingColumn(),
        )
        with Progress(*columns, console=console) as bar:
            task = bar.add_task(unit, total=None)

            def on_bar(done: int, total: int, line: str) -> None:
                if line:
                    bar.console.print(line, markup=False, highlight=False)
                if total:
                    bar.update(task, completed=done, total=total)

            yield on_bar
        return
    start, said = time.perf_counter(), -1

    def on_log(done: int, total: int, line: str) -> None:
        nonlocal said
        if line:
            print_line(console, line)
        elif total and 10 * done // total > said:
            said = 10 * done // total
            print_line(console, f"{done} of {total} {unit} after {time.perf_counter() - start:.0f} s")

    yield on_log


def make_console() -> Console:
    """Return the console of standard output; a log gets wide lines."""
    console = Console()
    return console if console.is_terminal else Console(width=_WIDTH)


def print_line(console: Console, text: str) -> None:
    """Print a line as it is; in a log it is never broken."""
    console.print(text, markup=False, highlight=False, soft_wrap=not console.is_terminal)


def error_line(text: str) -> None:
    """Print a line on standard error."""
    Console(stderr=True).print(f"impact-xval: {text}", markup=False, highlight=False, soft_wrap=True)
