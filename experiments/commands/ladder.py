"""``impact-xval ladder``: the causes of divergence of a finished run, or of one cell."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any

import typer

from impact_xval.experiments.commands.options import Folder, whole
from impact_xval.experiments.config.errors import UserError

if TYPE_CHECKING:
    from impact_xval.experiments.tables.folder import RunFolder


#: Balls whose velocities have room beside one another.
_SHOWN = 8


def _cell(text: str) -> int:
    return whole("--cell", text, 0, 10**7)


def ladder(
    folder: Folder,
    cell: Annotated[
        int | None, typer.Option(metavar="N", parser=_cell, help="Show one cell, from 0.")
    ] = None,
) -> None:
    """Show why the engines of a finished run diverge: frozen positions, law, gravity, mapping, time step."""
    from impact_xval.experiments.tables.folder import finished

    run = finished(folder)
    if cell is None:
        _show_run(run)
    else:
        _show_cell(run, cell)


def _show_run(folder: RunFolder) -> None:
    from impact_xval.experiments.measures.ladder_summary import summarise_ladder
    from impact_xval.experiments.presentation.ladder_page import ladder_facts
    from impact_xval.experiments.presentation.pages import render
    from impact_xval.experiments.presentation.terminal import make_console, show

    found = summarise_ladder(folder, folder.config())
    show(make_console(), render("ladder_run.md.j2", ladder=ladder_facts(found)))


def _show_cell(folder: RunFolder, cell: int) -> None:
    import pyarrow.parquet as pq

    from impact_xval.experiments.config.arrangements import COLUMN_AXES
    from impact_xval.experiments.config.axes import AXES
    from impact_xval.experiments.measures.layout import laddered
    from impact_xval.experiments.presentation.pages import render
    from impact_xval.experiments.presentation.terminal import make_console, show

    if not laddered(folder.config().solvers):
        raise UserError(f"--cell = {cell}: no cell has a ladder; legal: the folder of a run with an engine")
    path = folder.table_path("ladder.parquet")
    rows = pq.read_table(path, filters=[("cell", "==", cell)]).to_pandas()
    if not len(rows):
        raise UserError(f"--cell = {cell}; legal: from 0 to {folder.manifest()['cells'] - 1}")
    ladders = [(row, _contributions(row)) for _, row in rows.iterrows()]
    axes = AXES if folder.config().column is None else COLUMN_AXES
    where = [(label, value) for name, label in axes.items() if (value := rows.iloc[0][name]) == value]
    facts = {"cell": cell, "where": where, "balls": _balls(rows.iloc[0]), "ladders": ladders}
    show(make_console(), render("ladder_cell.md.j2", **facts))


def _balls(row: Any) -> list[int]:
    """Numbers of the balls whose velocities a table of the cell shows: those of all, where there is room."""
    balls = row.get("balls", 2)
    return list(range(1, balls + 1)) if balls <= _SHOWN else []


def _contributions(row: Any) -> list[tuple[str, ...]]:
    """Rows of the table of a cell and engine; empty where the engine has no ladder."""
    import math

    from impact_xval.experiments.measures.ladder import CAUSES, CONTRIBUTIONS, cancelling
    from impact_xval.experiments.measures.ladder_rows import between
    from impact_xval.experiments.tables.numbers import percent

    if math.isnan(row.velocity_divergence):
        return []
    balls = _balls(row)

    def differences(name: str) -> tuple[str, ...]:
        return tuple(f"{row[f'{name}dv{i}']:.3e}" for i in balls)

    there = [c for c in CONTRIBUTIONS if f"{c.name}_norm" in row and not math.isnan(row[f"{c.name}_norm"])]
    pair = cancelling([row[f"{c.name}_share"] for c in there]) or ()
    lines = []
    for i, c in enumerate(there):
        name = f"{c.name}_share"
        by_order = between(row[f"{name}_low"], row[f"{name}_high"]) if c in CAUSES else ""
        shown = (percent(row[name]), by_order)
        norm = f"{row[f'{c.name}_norm']:.3e}"
        lines.append((c.label, *differences(f"{c.name}_"), norm, *(("cancels", "") if i in pair else shown)))
    return [*lines, ("sum", *differences(""), f"{row.velocity_divergence:.3e}", "100.0 %", "")]
