"""``impact-xval ladder``: the causes of divergence of a finished run, of one cell, or by another law."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Annotated, Any

import typer

from impact_xval.experiments.commands.options import Folder, whole
from impact_xval.experiments.config.errors import UserError

if TYPE_CHECKING:
    from impact_xval.experiments.tables.store import RunFolder


def _cell(text: str) -> int:
    return whole("--cell", text, 0, 10**7)


def ladder(
    folder: Folder,
    law: Annotated[
        str,
        typer.Option(
            metavar="NAME",
            help="What if: the dissipation law on the way; kelvin-voigt, kelvin-voigt-anchored, "
            "kelvin-voigt-textbook or hunt-crossley.",
        ),
    ] = "kelvin-voigt",
    cell: Annotated[
        int | None, typer.Option(metavar="N", parser=_cell, help="Show one cell, from 0.")
    ] = None,
) -> None:
    """Show why the engines of a finished run diverge: frozen positions, law, gravity, mapping, time step.

    Another law than kelvin-voigt splits the contribution of the dissipation law into what that law would leave and
    what the choice of the dashpot adds, and writes ladder-NAME.parquet and .csv into the folder.
    """
    from impact_xval.compliant_baselines.contract.registry import KELVIN_VOIGT
    from impact_xval.experiments.measures.corners import LAWS
    from impact_xval.experiments.presentation.terminal import make_console, print_line
    from impact_xval.experiments.sweep.executors import available_cores, open_executor
    from impact_xval.experiments.sweep.ladders import CELLS, ready, write_ladder
    from impact_xval.experiments.tables.folders import finished_collisions
    from impact_xval.experiments.tables.schema import CELLS_SCHEMA

    if law not in LAWS:
        raise UserError(f"--law = {law!r}; legal: {', '.join(LAWS)}")
    run = finished_collisions(folder)
    stem = "ladder" if law == KELVIN_VOIGT else f"ladder-{law}"
    if law != KELVIN_VOIGT:
        run.table_path("cells.parquet", CELLS_SCHEMA)  # what it is made from has to be whole
        workers = min(available_cores(), -(-run.manifest()["cells"] // CELLS))
        with open_executor(None, ready, workers) as executor:
            say = partial(print_line, make_console())
            write_ladder(run.root, executor, law=law, name=f"{stem}.parquet", say=say)
    if cell is None:
        _show_run(run, law, stem)
    else:
        _show_cell(run, law, stem, cell)
    if law != KELVIN_VOIGT:
        print_line(make_console(), f"{stem}.parquet and {stem}.csv are in {run.root}")


def _show_run(folder: RunFolder, law: str, stem: str) -> None:
    from impact_xval.compliant_baselines.contract.registry import KELVIN_VOIGT
    from impact_xval.experiments.measures.ladder_summary import (
        LadderSummary,
        ladder_statistics,
        summarise_ladder,
    )
    from impact_xval.experiments.presentation.ladder_page import ladder_facts
    from impact_xval.experiments.presentation.pages import render
    from impact_xval.experiments.presentation.terminal import make_console, show

    config = folder.config()
    found = summarise_ladder(folder, config)
    if law != KELVIN_VOIGT:
        found = LadderSummary(ladder_statistics(folder.root / f"{stem}.parquet", config), found.alternatives)
    show(make_console(), render("ladder_run.md.j2", ladder=ladder_facts(found)))


def _show_cell(folder: RunFolder, law: str, stem: str, cell: int) -> None:
    import pyarrow.parquet as pq

    from impact_xval.compliant_baselines.contract.registry import KELVIN_VOIGT, kind_of
    from impact_xval.experiments.measures.ladder_table import LADDER, LADDER_SCHEMA
    from impact_xval.experiments.presentation.pages import render
    from impact_xval.experiments.presentation.terminal import make_console, show

    path = folder.root / f"{stem}.parquet"
    path = folder.table_path(LADDER, LADDER_SCHEMA) if law == KELVIN_VOIGT else path
    rows = pq.read_table(path, filters=[("cell", "==", cell)]).to_pandas()
    if not len(rows):
        if all(kind_of(name) != "engine" for name in folder.config().solvers):
            raise UserError(
                f"--cell = {cell}: no cell has a ladder; legal: the folder of a run with an engine"
            )
        raise UserError(f"--cell = {cell}; legal: from 0 to {folder.manifest()['cells'] - 1}")
    ladders = [(row, _contributions(row)) for _, row in rows.iterrows()]
    show(make_console(), render("ladder_cell.md.j2", cell=cell, first=rows.iloc[0], ladders=ladders))


def _contributions(row: Any) -> list[tuple[str, ...]]:
    """Rows of the table of a cell and engine; empty where the engine has no ladder."""
    import math

    from impact_xval.experiments.measures.ladder import CAUSES, CONTRIBUTIONS, cancelling
    from impact_xval.experiments.measures.ladder_table import between
    from impact_xval.experiments.tables.numbers import percent

    if math.isnan(row.velocity_divergence):
        return []
    there = [c for c in CONTRIBUTIONS if f"{c.name}_norm" in row and not math.isnan(row[f"{c.name}_norm"])]
    pair = cancelling([row[f"{c.name}_share"] for c in there]) or ()
    lines = []
    for i, c in enumerate(there):
        name = f"{c.name}_share"
        by_order = between(row[f"{name}_low"], row[f"{name}_high"]) if c in CAUSES else ""
        shown = (percent(row[name]), by_order)
        numbers = (f"{row[f'{c.name}_{part}']:.3e}" for part in ("dv1", "dv2", "norm"))
        lines.append((c.label, *numbers, *(("cancels", "") if i in pair else shown)))
    total = (f"{value:.3e}" for value in (row.dv1, row.dv2, row.velocity_divergence))
    return [*lines, ("sum", *total, "100.0 %", "")]
