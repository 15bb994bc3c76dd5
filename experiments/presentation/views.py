"""What the commands show on a terminal: a collision by several solvers, a run, its progress, a search."""

from __future__ import annotations

from datetime import timedelta

from rich.console import Console
from rich.table import Table as RichTable

from impact_xval.experiments.config.axes import AXES
from impact_xval.experiments.measures.divergence import COMPARABLE, divergence
from impact_xval.experiments.measures.laws import LAWS_WITH_LAWS, by_law
from impact_xval.experiments.measures.summary import SUMMARISED, Summary
from impact_xval.experiments.presentation.findings import (
    findings,
    marked_table,
    overall_table,
    status_table,
)
from impact_xval.experiments.presentation.terminal import print_line, print_table, rich_table
from impact_xval.experiments.sweep.search import Found
from impact_xval.experiments.sweep.status import RunStatus
from impact_xval.experiments.tables.document import Table
from impact_xval.experiments.tables.numbers import number, percent
from impact_xval.model.collision import Collision, Outcome

#: Reasons that `show_status` prints.
_REASONS = 12


def side_by_side(
    names: list[str], collision: Collision, outcomes: list[Outcome], reference: Outcome | None
) -> RichTable:
    """Tabulate one collision by several solvers, grouped by law; velocities per abs(v0), impulses per m1 abs(v0)."""
    shown = RichTable(box=None, pad_edge=False)
    shown.add_column("law")
    shown.add_column("solver")
    shown.add_column("status")
    for title in ("v1/|v0|", "v2/|v0|", "I1/(m1|v0|)", "I2/(m1|v0|)", "D"):
        shown.add_column(title, justify="right")
    shown.add_column("states")
    speed = abs(collision.v0)
    by_name = dict(zip(names, outcomes, strict=True))
    for law, name in ((law, name) for law, group in by_law(names).items() for name in group):
        outcome = by_name[name]
        if outcome.status not in COMPARABLE:
            shown.add_row(law, name, outcome.status, *["-"] * 6)
            continue
        impulse = collision.m1 * speed
        away = None
        if reference:
            states = reference.states, outcome.states
            away = divergence(collision, reference, outcome, states)["velocity_divergence"]
        scaled = (
            outcome.v1 / speed,
            outcome.v2 / speed,
            outcome.impulse1 / impulse,
            outcome.impulse2 / impulse,
        )
        cells = [f"{value:.6f}" for value in scaled]
        shown.add_row(
            law, name, outcome.status, *cells, "-" if away is None else number(away), " ".join(outcome.states)
        )
    return shown


def show_summary(console: Console, summary: Summary) -> None:
    """Print what a run found."""
    for shown in (overall_table(summary), marked_table(summary), status_table(summary)):
        print_table(console, shown)
    print_line(console, "")
    for text in (LAWS_WITH_LAWS, *findings(summary)):
        print_line(console, text)


def show_status(console: Console, root: str, status: RunStatus) -> None:
    """Print how far a run is."""
    share = status.cells_done / status.cells if status.cells else 1.0
    rate = f"; {number(status.rate)} cells/s" if status.rate else ""
    left = f", about {_duration(status.seconds_left)} left" if status.seconds_left is not None else ""
    who = f" ({status.owner})" if status.owner else ""
    print_line(console, f"{root}: {status.state}{who}")
    print_line(
        console,
        f"{status.cells_done} of {status.cells} cells ({percent(share)}), "
        f"{status.parts_done} of {status.parts} parts{rate}{left}",
    )
    if status.parts_damaged:
        print_line(console, f"{status.parts_damaged} parts are damaged; --resume computes them again")
    names = sorted({name for counts in status.statuses.values() for name in counts})
    rows = [
        (solver, *(str(counts.get(name, 0)) for name in names)) for solver, counts in status.statuses.items()
    ]
    if rows:
        console.print(rich_table(Table("", ("solver", *names), rows)))
    if status.reasons:
        shown = [(solver, state, reason, str(n)) for solver, state, reason, n in status.reasons[:_REASONS]]
        console.print(rich_table(Table("", ("solver", "status", "reason", "cells"), shown, text_columns=3)))
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
        f"{found.search.solver}: {found.evaluated} cells evaluated; {found.marked} marked and "
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
            _short_path(row["model_states_compared"]),
            _short_path(row["states_compared"]),
        )
        for row in found.rows
    ]
    console.print(rich_table(Table("", header, rows, text_columns=0)))
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
