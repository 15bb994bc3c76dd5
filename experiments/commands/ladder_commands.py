"""What ``impact-xval ladder`` does: the causes of divergence of a finished run, of one cell, or by another law."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq

from impact_xval.compliant_baselines.contract.registry import KELVIN_VOIGT
from impact_xval.experiments.config.errors import UserError
from impact_xval.experiments.measures.ladder import cancelling
from impact_xval.experiments.measures.ladder_summary import LadderSummary, ladder_statistics, summarise_ladder
from impact_xval.experiments.measures.ladder_table import (
    LADDER,
    LADDER_SCHEMA,
    between,
    write_ladder,
)
from impact_xval.experiments.measures.rungs import (
    CAUSES,
    LAWS,
    RUNGS,
    Rung,
)
from impact_xval.experiments.presentation.ladder_document import (
    alternatives_table,
    axis_share_table,
    ladder_findings,
    norm_table,
    share_table,
)
from impact_xval.experiments.presentation.terminal import make_console, print_line, print_table
from impact_xval.experiments.tables.document import Table
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
    console = make_console()
    if not found.solvers:
        print_line(console, "no engine of this run has a result: there is nothing to split")
        return
    tables = [share_table(found), norm_table(found), axis_share_table(found, "stiffness_ratio")]
    if len(found.alternatives):
        tables.append(alternatives_table(found))
    for table in tables:
        print_table(console, table)
    print_line(console, "")
    for text in ladder_findings(found):
        print_line(console, text)


def _show_cell(folder: RunFolder, law: str, stem: str, cell: int) -> None:
    path = folder.root / f"{stem}.parquet"
    path = folder.table_path(LADDER, LADDER_SCHEMA) if law == KELVIN_VOIGT else path
    rows = pq.read_table(path, filters=[("cell", "==", cell)]).to_pandas()
    if not len(rows):
        last = folder.manifest()["cells"] - 1
        raise UserError(f"--cell = {cell}; legal: a cell with a row of an engine, from 0 to {last}")
    first, console = rows.iloc[0], make_console()
    names = {"k2/k1": "stiffness_ratio", "m2/m1": "mass_ratio", "e1": "e1", "e2": "e2"}
    print_line(console, f"cell {cell}: " + ", ".join(f"{k} = {number(first[v])}" for k, v in names.items()))
    for _, row in rows.iterrows():
        if np.isnan(row.velocity_divergence):
            print_line(console, "")
            print_line(console, f"{row.solver}: {row.status}: {row.reason}")
            continue
        there = [r for r in RUNGS if f"{r.name}_norm" in row and not np.isnan(row[f"{r.name}_norm"])]
        pair = cancelling([row[f"{rung.name}_share"] for rung in there]) or ()
        lines = [
            (
                rung.label,
                *(_exact(row[f"{rung.name}_{part}"]) for part in ("dv1", "dv2", "norm")),
                *(("cancels", "") if i in pair else _share(row, rung)),
            )
            for i, rung in enumerate(there)
        ]
        lines.append(
            ("sum", _exact(row.dv1), _exact(row.dv2), _exact(row.velocity_divergence), "100.0 %", "")
        )
        header = ("cause", "dv1/|v0|", "dv2/|v0|", "kinetic norm", "share", "by order")
        print_table(console, Table(row.sentence, header, lines))
        if isinstance(row.reason, str):
            print_line(console, f"({row.reason})")


def _share(row: Any, rung: Rung) -> tuple[str, str]:
    """Share of a rung, and the range of it over the orders of the causes."""
    range_ = between(row[f"{rung.name}_share_low"], row[f"{rung.name}_share_high"]) if rung in CAUSES else ""
    return percent(row[f"{rung.name}_share"]), range_


def _exact(value: float) -> str:
    return f"{value:.3e}"
