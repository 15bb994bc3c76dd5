"""Writers of the report of a run: statistics as CSV and LaTeX, figures, and one self-contained HTML page.

The functions here need the folder of a finished run. The commands `run` and `report` call them.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from functools import partial
from pathlib import Path

import pandas as pd

from impact_xval.experiments.config.errors import is_table
from impact_xval.experiments.measures.summary import Summary, ladder_statistics_for_csv, summarise
from impact_xval.experiments.presentation.findings import overall_table
from impact_xval.experiments.presentation.html import render_page
from impact_xval.experiments.presentation.page.page import pack_opening_cells, run_blocks
from impact_xval.experiments.presentation.pictures.figures import write_figures
from impact_xval.experiments.presentation.style import CAPTIONS
from impact_xval.experiments.sweep.process import FaultError
from impact_xval.experiments.sweep.run import Apart
from impact_xval.experiments.tables.folder import RunFolder, write_text
from impact_xval.experiments.tables.parquet import replacing


def present_run(folder: RunFolder, apart: Apart) -> Summary:
    """Write tables, figures and the page of a finished run, and return its summary.

    `apart` calls a function in another process. It is used to collect the contents of the cells that a reader can open
    on the page.
    """
    collected = apart(pack_opening_cells, folder)

    def cells() -> str:
        try:
            return collected.result()
        except FaultError:  # the other process was killed
            return pack_opening_cells(None, folder)

    summary = summarise(folder)
    write_tables(folder, summary)
    write_figures(folder, summary)
    write_report(folder, summary, cells)
    return summary


def write_tables(folder: RunFolder, summary: Summary) -> None:
    """Write the statistics of a finished run as ``summary.csv``."""
    ladders = [] if summary.config.kind != "pair" else ladder_statistics_for_csv(summary.ladder)
    with replacing(folder.root / "summary.csv") as temporary:
        statistics = pd.concat([summary.statistics, *ladders], ignore_index=True)
        statistics.to_csv(temporary, index=False, lineterminator="\n")


def write_latex(folder: RunFolder, summary: Summary) -> Path:
    """Write the table of divergence by solver as ``summary.tex`` for LaTeX documents, and return its path."""
    table, path = overall_table(summary), folder.root / "summary.tex"
    frame = pd.DataFrame(table.rows, columns=list(table.header))
    aligned = "l" * table.text + "r" * (len(table.header) - table.text)
    styled = frame.style.hide(axis="index")
    styled.format(escape="latex")
    styled.format(_write_in_latex, subset=list(table.header[table.text :]))
    styled.format_index(escape="latex", axis="columns")
    write_text(path, styled.to_latex(column_format=aligned, hrules=True))
    return path


def _write_in_latex(entry: object) -> str:
    """Write an entry such as ``7.77e-15`` or ``27.4 %`` for LaTeX."""
    significand, _, exponent = str(entry).partition("e")
    return rf"${significand} \times 10^{{{int(exponent)}}}$" if exponent else significand.replace("%", r"\%")


def write_report(folder: RunFolder, summary: Summary, cells: Callable[[], str] | None = None) -> Path:
    """Write ``report.html`` of a finished run, and return the path of the file. Missing figures are drawn first.

    `cells` is a function that returns the compressed contents of the cells that a reader can open on the page; by
    default it is `pack_opening_cells`. The function is not called if the page has no such cells.
    """
    figures = folder.root / "figures"
    captions = _read_captions(figures / CAPTIONS)
    if not captions or not all((figures / f"{name}.svg").is_file() for name in captions):
        captions = write_figures(folder, summary)
    blocks = run_blocks(folder, summary, captions, cells or partial(pack_opening_cells, None, folder))
    path = folder.root / "report.html"
    write_text(path, render_page(f"impact-xval: {summary.config.name}", blocks, figures))
    return path


def _read_captions(path: Path) -> dict[str, str]:
    """Return the captions of the figures by the names of the figures; empty if the file is missing or damaged."""
    try:
        captions: object = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return {}
    if not is_table(captions):
        return {}
    texts = {name: caption for name, caption in captions.items() if isinstance(caption, str)}
    return texts if len(texts) == len(captions) else {}
