"""What the commands show of a run on a terminal: what it found, its progress, a search."""

from __future__ import annotations

import math
import shlex
from dataclasses import asdict
from datetime import timedelta
from typing import TYPE_CHECKING, Any

from rich.console import Console

from impact_xval.experiments.config.axes import AXES
from impact_xval.experiments.presentation.pages import phrase, render
from impact_xval.experiments.presentation.terminal import print_line, show
from impact_xval.experiments.tables.numbers import number

if TYPE_CHECKING:  # each command has imported what it shows, and needs none of the others
    from impact_xval.experiments.measures.columns.summary import ColumnSummary
    from impact_xval.experiments.measures.summary import Summary
    from impact_xval.experiments.sweep.search import Found
    from impact_xval.experiments.sweep.status import RunStatus
    from impact_xval.experiments.tables.comparison import Comparison

#: Reasons that `show_status` prints.
_REASONS = 12


def show_summary(console: Console, summary: Summary | ColumnSummary) -> None:
    """Print what a run found."""
    from impact_xval.experiments.measures.columns.summary import ColumnSummary
    from impact_xval.experiments.presentation.columns.page import column_facts
    from impact_xval.experiments.presentation.summary_page import summary_facts

    if isinstance(summary, ColumnSummary):
        show(console, render("columns_run.md.j2", **column_facts(summary)))
        return
    show(console, render("summary_run.md.j2", **summary_facts(summary)))


def show_end(console: Console, summary: Summary | ColumnSummary, seconds: float, root: str) -> None:
    """Print what a run found, and where it is."""
    show_summary(console, summary)
    print_line(console, phrase("progress.md.j2", "ended", seconds, root))


def show_status(console: Console, root: str, status: RunStatus) -> None:
    """Print how far a run is."""
    names = sorted({name for counts in status.statuses.values() for name in counts})
    left = status.seconds_left
    page = render(
        "status.md.j2",
        root=root,
        command=shlex.join(["impact-xval", "run", "--resume", "--out", root]),
        s=status,
        share=status.cells_done / status.cells if status.cells else 1.0,
        left=None if left is None else str(timedelta(seconds=round(left))),
        names=names,
        statuses=[
            (solver, *(counts.get(name, 0) for name in names)) for solver, counts in status.statuses.items()
        ],
        most=_REASONS,
    )
    show(console, page)


def show_found(console: Console, found: Found) -> None:
    """Print what a search found."""
    from impact_xval.experiments.measures.summary import SUMMARISED

    measure = found.search.measure
    rows = [
        (
            row["cell"],
            *(f"{row[axis]:.6g}" for axis in AXES),
            number(abs(row[measure]), 6),
            _short_path(row["model_states_compared"]),
            _short_path(row["states_compared"]),
        )
        for row in found.rows
    ]
    facts = {"f": found, "rows": rows, "labels": list(AXES.values()), "measure": SUMMARISED[measure]}
    show(console, render("found.md.j2", **facts))


def show_changes(console: Console, a: str, b: str, found: Comparison) -> None:
    """Print what moved between two runs."""

    def shown(change: float) -> str:
        return "one only" if math.isinf(change) else number(change, 2)

    solvers = [
        (
            name,
            each.compared,
            each.moved,
            each.statuses,
            each.marks,
            number(each.velocity, 2),
            number(each.divergence, 2),
        )
        for name, each in found.solvers.items()
    ]
    worst = [
        (
            row.cell,
            row.solver,
            row.status_a,
            row.status_b,
            "yes" if row.mark_changed else "no",
            shown(row.velocity),
            shown(row.divergence),
        )
        for row in found.worst
    ]
    show(console, render("changes.md.j2", c=found, a=a, b=b, solvers=solvers, worst=worst))


def changes_object(found: Comparison) -> dict[str, Any]:
    """Return what moved between two runs as a JSON object; a change is null where one run alone has a number."""

    def finite(change: float) -> float | None:
        return None if math.isinf(change) else change

    return {
        "tolerance": found.tolerance,
        "moved": found.moved,
        "solvers": {name: asdict(each) for name, each in found.solvers.items()},
        "worst": [
            {
                "cell": row.cell,
                "solver": row.solver,
                "statuses": [row.status_a, row.status_b],
                "mark_changed": row.mark_changed,
                "velocity": finite(row.velocity),
                "divergence": finite(row.divergence),
            }
            for row in found.worst
        ],
        "not_compared": found.alone,
        "settings": found.settings,
        "versions": found.versions,
    }


def _short_path(states: str | None) -> str:
    """Cut a long state path in its middle."""
    names = (states or "-").split()
    cut = [*names[:4], f"({len(names) - 6} more)", *names[-2:]]
    return " ".join(names if len(names) <= 8 else cut)
