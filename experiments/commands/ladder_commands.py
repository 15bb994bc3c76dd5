"""What ``impact-xval ladder`` does: the causes of divergence of a finished run, of one cell, or by another law."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pyarrow.parquet as pq

from impact_xval.compliant_baselines.contract.registry import KELVIN_VOIGT
from impact_xval.experiments.config.axes import AXES
from impact_xval.experiments.config.errors import UserError
from impact_xval.experiments.measures.corners import LAWS
from impact_xval.experiments.measures.ladder import CAUSES, CONTRIBUTIONS, Contribution, cancelling
from impact_xval.experiments.measures.ladder_summary import LadderSummary, ladder_statistics, summarise_ladder
from impact_xval.experiments.measures.ladder_table import LADDER, LADDER_SCHEMA, between, write_ladder
from impact_xval.experiments.presentation.ladder_page import ladder_facts
from impact_xval.experiments.presentation.pages import render
from impact_xval.experiments.presentation.terminal import make_console, print_line, show
from impact_xval.experiments.tables.folders import finished
from impact_xval.experiments.tables.numbers import number, percent
from impact_xval.experiments.tables.schema import CELLS_SCHEMA
from impact_xval.experiments.tables.store import RunFolder


def ladder(root: Path, law: str, cell: int | None) -> None:
    """Show the ladders of a finished run."""
    if law not in LAWS:
        raise UserError(f"--law = {law!r}; legal: {', '.join(LAWS)}")
    folder = finished(root)
    stem = "ladder" if law == KELVIN_VOIGT else f"ladder-{law}"
    if law != KELVIN_VOIGT:
        folder.table_path("cells.parquet", CELLS_SCHEMA)  # what it is made from has to be whole
        write_ladder(folder.root, law, stem)
    if cell is None:
        _show_run(folder, law, stem)
    else:
        _show_cell(folder, law, stem, cell)
    if law != KELVIN_VOIGT:
        print_line(make_console(), f"{stem}.parquet and {stem}.csv are in {folder.root}")


def _show_run(folder: RunFolder, law: str, stem: str) -> None:
    config = folder.config()
    if law == KELVIN_VOIGT:
        found = summarise_ladder(folder, config)
    else:
        statistics = ladder_statistics(folder.root / f"{stem}.parquet", config)
        found = LadderSummary(statistics, summarise_ladder(folder, config).alternatives)
    show(make_console(), render("ladder-terminal.md.j2", ladder=ladder_facts(found)))


def _show_cell(folder: RunFolder, law: str, stem: str, cell: int) -> None:
    path = folder.root / f"{stem}.parquet"
    path = folder.table_path(LADDER, LADDER_SCHEMA) if law == KELVIN_VOIGT else path
    rows = pq.read_table(path, filters=[("cell", "==", cell)]).to_pylist()
    if not rows:
        last = folder.manifest()["cells"] - 1
        raise UserError(f"--cell = {cell}; legal: a cell with a row of an engine, from 0 to {last}")
    where = ", ".join(f"{label} = {number(rows[0][axis])}" for axis, label in AXES.items())
    engines = [row | {"rows": _contributions(row)} for row in rows]
    show(make_console(), render("ladder-cell.md.j2", cell=cell, where=where, engines=engines))


def _contributions(row: dict[str, Any]) -> list[tuple[str, ...]]:
    """Table of a row of an engine, a line a contribution; empty without a result."""
    if row["velocity_divergence"] is None:
        return []
    there = [c for c in CONTRIBUTIONS if row.get(f"{c.name}_norm") is not None]
    pair = cancelling([row[f"{c.name}_share"] for c in there]) or ()
    lines = [
        (
            c.label,
            *(f"{row[f'{c.name}_{part}']:.3e}" for part in ("dv1", "dv2", "norm")),
            *(("cancels", "") if i in pair else _share(row, c)),
        )
        for i, c in enumerate(there)
    ]
    total = (f"{row[name]:.3e}" for name in ("dv1", "dv2", "velocity_divergence"))
    return [*lines, ("sum", *total, "100.0 %", "")]


def _share(row: dict[str, Any], c: Contribution) -> tuple[str, str]:
    """Share of a contribution, and the range of it over the orders of the causes."""
    range_ = between(row[f"{c.name}_share_low"], row[f"{c.name}_share_high"]) if c in CAUSES else ""
    return percent(row[f"{c.name}_share"]), range_
