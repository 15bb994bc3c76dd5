"""What people look at after a run: the summary in three formats, and one self-contained HTML page."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd
from markupsafe import Markup

from impact_xval.experiments.measures.ladder_summary import csv_rows
from impact_xval.experiments.measures.summary import Summary, load_divergence, summarise
from impact_xval.experiments.presentation.apart import Wait, process_apart
from impact_xval.experiments.presentation.columns.page import column_facts
from impact_xval.experiments.presentation.figures import CAPTIONS, draw_divergences, write_figures
from impact_xval.experiments.presentation.page.cells import packed_cells
from impact_xval.experiments.presentation.page.charts import charts, scripts
from impact_xval.experiments.presentation.page.headlines import cells_piece, matrix, numbers, subjects
from impact_xval.experiments.presentation.page.html import html_of, render_markup
from impact_xval.experiments.presentation.page.tiles import Tiles, tiles_of
from impact_xval.experiments.presentation.pages import latex_of, render
from impact_xval.experiments.presentation.summary_page import summary_facts
from impact_xval.experiments.sweep.examination import failed_note, traps_note
from impact_xval.experiments.sweep.process import FaultError
from impact_xval.experiments.tables.folder import RunFolder, cells_of_run, write_text
from impact_xval.experiments.tables.numbers import number
from impact_xval.experiments.tables.parquet import column, replacing


def write_tables(folder: RunFolder) -> Summary:
    """Write ``summary.md``, ``summary.csv`` and ``summary.tex`` of a finished run."""
    summary = summarise(folder)
    if summary.config.column is not None:
        page, statistics = render("columns.md.j2", **column_facts(summary)), summary.statistics
    else:
        page = render("summary.md.j2", **summary_facts(summary))
        statistics = pd.concat([summary.statistics, *csv_rows(summary.ladder)], ignore_index=True)
    write_text(folder.root / "summary.md", page)
    write_text(folder.root / "summary.tex", latex_of(page))
    with replacing(folder.root / "summary.csv") as temporary:
        statistics.to_csv(temporary, index=False, lineterminator="\n")
    return summary


def present(folder: RunFolder) -> Summary:
    """Write all that people look at of a finished run, with a process of its own for what does not need the summary."""
    if folder.config().column is not None:
        summary = write_tables(folder)
        write_figures(folder, summary)
        write_report(folder, summary)
        return summary
    with process_apart(folder) as begin:
        divergences, apart = begin(draw_divergences), Apart(begin(_opened), begin(_traps))
        summary = write_tables(folder)
        write_figures(folder, summary, divergences)
        write_report(folder, summary, apart)
    return summary


@dataclass(frozen=True, slots=True)
class Apart:
    """Waits for what another process finds out for the page: the cells that open, and the traps of the engines."""

    opened: Wait
    traps: Wait


def write_report(folder: RunFolder, summary: Summary | None = None, apart: Apart | None = None) -> Path:
    """Write ``report.html`` of a finished run; its figures are drawn if they are not there.

    Parameters
    ----------
    folder : RunFolder
    summary : Summary, optional
        That of the run, where it is known; by default it is computed.
    apart : Apart, optional
        What another process is at; by default one is started. Of columns there is none.

    Returns
    -------
    Path
        The page.
    """
    of_columns = folder.config().column is not None
    if apart is None and not of_columns:
        with process_apart(folder) as begin:
            return write_report(folder, summary, Apart(begin(_opened), begin(_traps)))
    summary = summarise(folder) if summary is None else summary
    figures = folder.root / "figures"
    if not (figures / CAPTIONS).is_file():
        write_figures(folder, summary)
    captions: dict[str, str] = json.loads((figures / CAPTIONS).read_text(encoding="utf-8"))
    drawn = {name: text for name, text in captions.items() if (figures / f"{name}.png").is_file()}
    facts = {
        "figures": drawn,
        "provenance": _provenance(folder.manifest()),
        "differences": _differences(folder),
    }
    if of_columns:
        page, pieces = _page_of_columns(summary, facts)
    else:
        assert apart is not None
        page, pieces = _page_of_collisions(folder, summary, facts, apart)
    path = folder.root / "report.html"
    title = f"impact-xval: {summary.config.name}"
    write_text(path, html_of(page, title, figures, pieces, scripts()))
    return path


def _differences(folder: RunFolder) -> list[tuple[str, int, str]]:
    """Solvers that use other numbers than they were asked for, in how many cells, and what they say of the first."""
    names = ["solver", "differences"]
    rows = pd.read_parquet(folder.root / "cells.parquet", columns=names).dropna()
    return [(str(name), len(each), each.iloc[0]) for name, each in rows.groupby("solver").differences]


def _page_of_columns(summary: Summary, facts: dict[str, Any]) -> tuple[str, dict[str, Markup]]:
    found = column_facts(summary)["facts"]
    closest = [row | {"limit": True} for row in found["engines"]]
    found = {**found, "closest": closest, "subjects": subjects(found["found"], closest)}
    page = render("report_columns.md.j2", **found, facts=found, **facts)
    return page, {"numbers": numbers(found, "columns")}


def _page_of_collisions(
    folder: RunFolder, summary: Summary, facts: dict[str, Any], apart: Apart
) -> tuple[str, dict[str, Markup]]:
    """Write the page as Markdown, and what stands in the place of its pictures that are none."""
    found = summary_facts(summary)["facts"]
    found = {**found, "subjects": subjects(found["solvers_found"], found["closest"])}
    facts |= {"gravity_number": _gravity_number(folder), "traps": _noted(apart.traps)}
    page = render("report.md.j2", **found, facts=found, **facts)
    try:
        tiles, packed = apart.opened()
        cells = Markup("")
        if tiles.cells:
            cells = cells_piece(tiles, packed, charts(tiles, summary.config.solvers))
    except FaultError as fault:
        cells = render_markup("no_cells.html.j2", reason=fault.reason)
    sketch = render_markup("sketch.html.j2")
    return page, {
        "sketch": sketch,
        "numbers": numbers(found, "cells"),
        "matrix": matrix(summary),
        "cells": cells,
    }


def _opened(folder: RunFolder) -> tuple[Tiles, str]:
    """Lay out the map whose tiles open, and collect what they open, in a process of its own: engines are imported."""
    tiles = tiles_of(load_divergence(folder, folder.config()))
    return tiles, packed_cells(folder, tiles.cells)


def _traps(folder: RunFolder) -> dict[str, Any]:
    """Examine scenes of a run, in a process of its own: engines are imported, and may crash."""
    config = folder.config()
    return traps_note(config, cells_of_run(folder, config))


def _noted(traps: Wait) -> dict[str, Any]:
    try:
        return traps()
    except FaultError as fault:
        return failed_note(fault.reason)


def _gravity_number(folder: RunFolder) -> str:
    """Write from where to where it goes over the cells."""
    values = column(folder.root / "cells.parquet", "gravity_number")
    least, most = number(values.min(), 2), number(values.max(), 2)
    return least if least == most else f"{least} to {most}"


def _provenance(manifest: dict[str, Any]) -> list[tuple[str, Any]]:
    return [
        ("cells", manifest.get("cells")),
        ("identity", manifest.get("identity")),
        *((f"version of {name}", value) for name, value in manifest.get("versions", {}).items()),
        *((f"library {name}", value) for name, value in manifest.get("libraries", {}).items()),
        *manifest.get("machine", {}).items(),
        ("seeds", manifest.get("seeds")),
        *((f"session {i}", session) for i, session in enumerate(manifest.get("sessions", []), start=1)),
    ]
