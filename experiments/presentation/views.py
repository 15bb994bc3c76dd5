"""What the commands show of a run on a terminal: what it found, its progress."""

from __future__ import annotations

import math
import shlex
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from rich.console import Console

from impact_xval.experiments.presentation.pages import phrase, render
from impact_xval.experiments.presentation.terminal import print_line, show
from impact_xval.experiments.tables.numbers import number

if TYPE_CHECKING:  # each command has imported what it shows, and needs none of the others
    from impact_xval.experiments.measures.summary import Summary
    from impact_xval.experiments.sweep.status import RunStatus
    from impact_xval.experiments.tables.comparison import Comparison

#: Reasons that `show_status` prints.
_REASONS = 12


def show_summary(console: Console, summary: Summary) -> None:
    """Print what a run found."""
    from impact_xval.experiments.presentation.columns.page import column_facts
    from impact_xval.experiments.presentation.summary_page import summary_facts

    if summary.config.column is not None:
        show(console, render("columns_run.md.j2", **column_facts(summary)))
        return
    show(console, render("summary_run.md.j2", **summary_facts(summary)))


def show_end(console: Console, summary: Summary, seconds: float, root: str) -> None:
    """Print what a run found, and where it is."""
    show_summary(console, summary)
    print_line(console, phrase("progress.md.j2", "ended", seconds, root))


def show_status(console: Console, root: str, status: RunStatus) -> None:
    """Print how far a run is."""
    names = sorted({name for counts in status.statuses.values() for name in counts})
    page = render(
        "status.md.j2",
        root=root,
        command=shlex.join(["impact-xval", "run", "--out", root]),
        s=status,
        share=status.cells_done / status.cells if status.cells else 1.0,
        names=names,
        statuses=[
            (solver, *(counts.get(name, 0) for name in names)) for solver, counts in status.statuses.items()
        ],
        most=_REASONS,
    )
    show(console, page)


def show_changes(console: Console, a: str, b: str, found: Comparison) -> None:
    """Print what moved between two runs."""

    def shown(change: float) -> str:
        return "one only" if math.isinf(change) else number(change, 2)

    solvers = [
        (name, each.compared, each.moved, each.statuses, number(each.velocity, 2), number(each.divergence, 2))
        for name, each in found.solvers.items()
    ]
    worst = [
        (row.cell, row.solver, row.status_a, row.status_b, shown(row.velocity), shown(row.divergence))
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
                "velocity": finite(row.velocity),
                "divergence": finite(row.divergence),
            }
            for row in found.worst
        ],
        "not_compared": found.alone,
        "settings": found.settings,
        "versions": found.versions,
    }
