"""Views of a run on a terminal: its progress, its findings, one cell, and its changes from another run.

The functions here need the folder or the `Summary` of a run. The commands `run`, `show` and `compare` call them.
"""

from __future__ import annotations

import math
import re
import shlex
from collections.abc import Sequence
from dataclasses import asdict

from rich.console import Console

from impact_xval.experiments.config.arrangements import CHAIN_AXES
from impact_xval.experiments.config.axes import AXES
from impact_xval.experiments.config.errors import UserError
from impact_xval.experiments.config.experiment import Config
from impact_xval.experiments.config.graphs import GRAPH_AXES
from impact_xval.experiments.measures.ladder import CONTRIBUTIONS, cancelling_pair, format_share_range
from impact_xval.experiments.measures.summary import Summary
from impact_xval.experiments.presentation.document import Block, Table
from impact_xval.experiments.presentation.findings import ROUNDING, region_table, summary_blocks
from impact_xval.experiments.presentation.terminal import print_blocks, print_line
from impact_xval.experiments.presentation.words import (
    NO_RESULT,
    WHAT_NO_RESULT_IS,
    describe_cell,
    describe_scenario,
    describe_si_values,
    name_solver_in,
)
from impact_xval.experiments.sweep.status import RunStatus
from impact_xval.experiments.tables.comparison import RunComparison
from impact_xval.experiments.tables.folder import RunFolder
from impact_xval.experiments.tables.frames import Record
from impact_xval.experiments.tables.numbers import number, percent
from impact_xval.experiments.tables.parquet import read_table
from impact_xval.model.status import RESULT_STATUSES

#: Names for the columns with the difference between engine and model, which a ladder splits into contributions.
_DIFFERENCE = re.compile(r"velocity_divergence|dv\d+")
#: Largest number of reasons that `show_status` prints.
_REASONS = 12
#: Largest number of balls whose velocities fit into one row.
_SHOWN = 8


def show_summary(console: Console, summary: Summary) -> None:
    """Print the findings of a run, and the causes of divergence by region."""
    print_blocks(console, [*summary_blocks(summary), region_table(summary.ladder)])


def show_end(console: Console, summary: Summary, seconds: float, root: str) -> None:
    """Print the findings of a run, the seconds that it took, and where its files are."""
    print_blocks(console, summary_blocks(summary))
    # The folder comes last, where a script can take it from.
    print_line(
        console, f"Finished after {seconds:.0f} s. The page to read is report.html; all files are in {root}"
    )


def show_status(console: Console, root: str, status: RunStatus) -> None:
    """Print the state of a run: how many of its cells are done, and their statuses and reasons."""
    names = sorted({name for counts in status.statuses.values() for name in counts})
    counts = [(solver, *(n.get(name, 0) for name in names)) for solver, n in status.statuses.items()]
    share = percent(status.cells_done / status.cells if status.cells else 1.0)
    blocks: list[Block] = [
        f"{root}: {status.state}",
        f"{status.cells_done} of {status.cells} cells ({share}), {status.parts_done} of {status.parts} parts",
    ]
    if status.parts_damaged:
        parts = "part" if status.parts_damaged == 1 else "parts"
        blocks.append(f"{status.parts_damaged} damaged {parts} will be computed again by the next run")
    blocks.append(Table(["solver", *names], counts))
    blocks.append(Table(["solver", "status", "reason", "cells"], status.reasons[:_REASONS], text=3))
    if len(status.reasons) > _REASONS:
        blocks.append(f"{len(status.reasons) - _REASONS} more reasons are not shown")
    if status.state == "stopped":
        blocks.append(f"to continue: {shlex.join(['impact-xval', 'run', '--out', root])}")
    print_blocks(console, blocks)


def rows_of_cell(folder: RunFolder, cell: int) -> list[Record]:
    """Return the rows of a cell of a finished run, one per solver, with outcome, measures and contributions."""
    paths = (folder.table_path(f"{name}.parquet") for name in ("cells", "divergence", "ladder"))
    rows, measures, ladder = (read_table(path, filters=[("cell", "==", cell)]).to_pandas() for path in paths)
    # The table of ladders has a difference even for rows without a result, which have no D. So its columns get other
    # names.
    ladder = ladder.rename(columns=lambda name: f"ladder_{name}" if _DIFFERENCE.fullmatch(name) else name)
    for table in (measures, ladder):
        new = ["cell", "solver", *table.columns.difference(rows.columns, sort=False)]
        rows = rows.merge(table[new], how="left", on=["cell", "solver"])
    if rows.empty:
        raise UserError(f"--cell = {cell}; legal: from 0 to {folder.manifest()['cells'] - 1}")
    plain = rows.astype(object).where(rows.notna(), None)
    return [{str(name): value for name, value in row.items()} for row in plain.to_dict("records")]


def show_cell(console: Console, cell: int, rows: list[Record], config: Config) -> None:
    """Print a cell: the outcome of each solver, and the causes of each engine's divergence D from the model.

    `config` is the experiment of the run.
    """
    axes = GRAPH_AXES if "graph" in rows[0] else CHAIN_AXES if "arrangement" in rows[0] else AXES
    balls = _shown_components(rows)
    speed = abs(rows[0]["v0"])
    outcomes = [
        (
            row["solver"],
            row["status"],
            *(_format_velocity(row, f"v{i}", speed) for i in balls),
            number(row["velocity_divergence"]),
            row.get("states") or "-",
        )
        for row in rows
    ]
    header = ["solver", "status", *(f"v{i}/|v0|" for i in balls), "D", "states"]
    setup = describe_cell(rows[0], axes)
    if axes is AXES:
        setup += f"; {describe_si_values(rows[0])}"
    setup += f"; {describe_scenario(config)}"
    if axes is GRAPH_AXES:
        setup += f". v1x is the velocity of body 1 along x, v1z upwards. |v0| = {number(speed)} m/s"
    blocks: list[Block] = [f"cell {cell}: {setup}", Table(header, outcomes, text=2)]
    if any(NO_RESULT in "".join(outcome) for outcome in outcomes):
        blocks.append(WHAT_NO_RESULT_IS)
    blocks += [f"{row['solver']}: {row['status']}: {row['reason']}" for row in rows if row["reason"]]
    blocks += [f"{row['solver']}: marked: {row['marked']}" for row in rows if row["marked"]]
    causes = ["cause", *(f"dv{i}/|v0|" for i in balls), "size (like D)", "share", "range over orders"]
    for row in rows:
        if row.get("sentence"):
            blocks.append(
                Table(causes, _contribution_rows(row, balls), name_solver_in(row["solver"], row["sentence"]))
            )
    print_blocks(console, blocks)


def _shown_components(rows: list[Record]) -> list[str]:
    """List the balls, or the components of velocity of a graph, that a table of a cell shows.

    The list is empty if the balls or components do not fit into one row. A component of a graph is in the list if at
    least one solver has a number for it.
    """
    if "graph" not in rows[0]:
        balls = rows[0].get("balls") or 2
        return [str(i) for i in range(1, 1 + balls)] if balls <= _SHOWN else []
    names = [name[1:] for name in rows[0] if re.fullmatch(r"v[1-9]\d*[xz]", name)]
    known = [name for name in names if any(row[f"v{name}"] is not None for row in rows)]
    return known if len(known) <= 2 * _SHOWN else []


def _format_velocity(row: Record, name: str, speed: float) -> str:
    """Return a velocity per |v0| as text; a dash if there is no number.

    If the row has no result, the mark `NO_RESULT` follows the number.
    """
    if row[name] is None:
        return "-"
    return f"{row[name] / speed:.6f}" + (NO_RESULT if row["status"] not in RESULT_STATUSES else "")


def _contribution_rows(row: Record, balls: Sequence[str]) -> list[tuple[str, ...]]:
    """Return the rows of the table of causes of one cell and engine; empty if the causes are not known."""
    contributions = [c for c in CONTRIBUTIONS if row.get(f"{c.name}_norm") is not None]
    pair = cancelling_pair([row[f"{c.name}_share"] for c in contributions]) or ()
    lines = []
    for i, c in enumerate(contributions):
        name = f"{c.name}_share"
        by_order = format_share_range(row[f"{name}_low"], row[f"{name}_high"]) if c.is_cause else ""
        shown = ("cancelled", "") if i in pair else (percent(row[name]), by_order)
        changes = (_format_change(row[f"{c.name}_dv{j}"]) for j in balls)
        lines.append((c.label, *changes, _format_change(row[f"{c.name}_norm"]), *shown))
    total = (_format_change(row[f"ladder_dv{j}"]) for j in balls)
    size = _format_change(row["ladder_velocity_divergence"])
    return [*lines, ("sum", *total, size, "100.0 %", "")] if lines else []


def _format_change(value: float) -> str:
    """Return a change of a velocity per |v0|, or its size, as text; 0 if rounding alone can make it."""
    return "0" if abs(value) <= ROUNDING else f"{value:.3e}"


def show_changes(console: Console, a: str, b: str, comparison: RunComparison) -> None:
    """Print what changed between two runs."""

    def shown(change: float) -> str:
        """Return the change of a number between two runs as text."""
        return "one only" if math.isinf(change) else number(change, 2)

    solvers = [
        (
            name,
            *(changes.compared, changes.moved, changes.statuses),
            *(number(change, 2) for change in (changes.velocity, changes.divergence)),
        )
        for name, changes in comparison.solvers.items()
    ]
    worst = [
        (row.cell, row.solver, row.status_a, row.status_b, shown(row.velocity), shown(row.divergence))
        for row in comparison.worst
    ]
    limit = number(comparison.tolerance)
    rows = "row" if comparison.moved == 1 else "rows"
    moved = f"{comparison.moved} {rows} changed by more than {limit}, or changed the status."
    blocks: list[Block] = [moved if comparison.moved else f"Nothing changed by more than {limit}."]
    for name, (before, after) in [*comparison.versions.items(), *comparison.settings.items()]:
        blocks.append(f"{name} is {before} in the first run, {after} in the second.")
    if comparison.alone:
        blocks.append(f"Not compared, because only one run has it: {', '.join(comparison.alone)}.")
    if cells := comparison.cells_alone:
        count = "1 cell" if len(cells) == 1 else f"{len(cells)} cells"
        blocks.append(f"Not compared, because only one run has it: {count}, first cell {cells[0]}.")
    by_solver = ("solver", "cells", "changed", "other status", "largest dv/|v0|", "largest dD")
    blocks.append(Table(by_solver, solvers, f"Changes from {a} to {b}"))
    by_row = ("cell", "solver", "first status", "second status", "dv/|v0|", "dD")
    caption = 'The largest changes. "one only" means that only one run has a number'
    print_blocks(console, [*blocks, Table(by_row, worst, caption, text=4)])


def changes_to_json(comparison: RunComparison) -> dict[str, object]:
    """Return the changes between two runs as values for JSON. A change is infinite if only one run has a number."""
    return {
        "tolerance": comparison.tolerance,
        "moved": comparison.moved,
        "solvers": {name: asdict(changes) for name, changes in comparison.solvers.items()},
        "worst": [
            {
                "cell": row.cell,
                "solver": row.solver,
                "statuses": [row.status_a, row.status_b],
                "velocity": row.velocity,
                "divergence": row.divergence,
            }
            for row in comparison.worst
        ],
        "not_compared": comparison.alone,
        "cells_not_compared": comparison.cells_alone,
        "settings": comparison.settings,
        "versions": comparison.versions,
    }
