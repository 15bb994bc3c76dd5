"""What people look at after a run: the summary in three formats, and one self-contained HTML page."""

from __future__ import annotations

import base64
import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

import pandas as pd
from jinja2 import Environment, PackageLoader, StrictUndefined

from impact_xval.experiments.measures.ladder_summary import LadderSummary
from impact_xval.experiments.measures.summary import Summary, summarise
from impact_xval.experiments.presentation.figures import CAPTIONS, write_figures
from impact_xval.experiments.presentation.findings import build_document
from impact_xval.experiments.presentation.ladder_document import csv_rows
from impact_xval.experiments.sweep.designs import cells_of_run
from impact_xval.experiments.sweep.examination import traps_note
from impact_xval.experiments.tables.document import (
    Block,
    Heading,
    to_latex,
    to_markdown,
)
from impact_xval.experiments.tables.numbers import number
from impact_xval.experiments.tables.store import RunFolder, write_text
from impact_xval.experiments.tables.streams import column, replacing


def write_tables(folder: RunFolder) -> tuple[Summary, list[Block]]:
    """Write ``summary.md``, ``summary.csv`` and ``summary.tex`` of a finished run.

    Returns
    -------
    summary : Summary
    document : list of Block
        The text that was written.
    """
    summary, document = _summarised(folder)
    write_text(folder.root / "summary.md", to_markdown(document))
    write_text(folder.root / "summary.tex", to_latex(document))
    statistics = pd.concat([summary.statistics, *csv_rows(summary.ladder)], ignore_index=True)
    with replacing(folder.root / "summary.csv") as temporary:
        statistics.to_csv(temporary, index=False, lineterminator="\n")
    return summary, document


def write_report(folder: RunFolder, written: tuple[Summary, list[Block]] | None = None) -> Path:
    """Write ``report.html`` of a finished run; its figures are drawn if they are not there.

    Parameters
    ----------
    folder : RunFolder
    written : (Summary, list of Block), optional
        What `write_tables` returned, if it has just been written; by default it is computed again.

    Returns
    -------
    Path
        The page.
    """
    summary, document = _summarised(folder) if written is None else written
    environment = Environment(
        loader=PackageLoader("impact_xval.experiments.presentation"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=False,
    )
    sections = [i for i, block in enumerate(document) if isinstance(block, Heading) and block.level == 2]
    page = environment.get_template("report.html.j2").render(
        title=f"impact-xval: {summary.config.name}",
        blocks=[{"kind": type(block).__name__.lower(), **asdict(block)} for block in document],
        figures=_figures(folder, summary.ladder),
        figures_after=sections[1] if len(sections) > 1 else len(document),
        config=summary.config,
        gravity_number=_gravity_number(folder),
        traps=traps_note(summary.config, cells_of_run(folder, summary.config)),
        provenance=_provenance(folder.manifest()),
    )
    path = folder.root / "report.html"
    write_text(path, page)
    return path


def _summarised(folder: RunFolder) -> tuple[Summary, list[Block]]:
    summary = summarise(folder)
    return summary, build_document(summary)


def _gravity_number(folder: RunFolder) -> str:
    """Say from where to where it goes over the cells."""
    values = column(folder.root / "cells.parquet", "gravity_number")
    least, most = number(values.min(), 2), number(values.max(), 2)
    return least if least == most else f"{least} to {most}"


def _figures(folder: RunFolder, ladder: LadderSummary) -> list[dict[str, str]]:
    captions = folder.root / "figures" / CAPTIONS
    if captions.is_file():
        known: dict[str, str] = json.loads(captions.read_text(encoding="utf-8"))
        drawn = [(folder.root / "figures" / f"{name}.png", caption) for name, caption in known.items()]
    else:
        drawn = write_figures(folder, ladder)
    return [
        {"caption": caption, "data": base64.b64encode(path.read_bytes()).decode("ascii")}
        for path, caption in drawn
        if path.is_file()
    ]


def _provenance(manifest: dict[str, Any]) -> list[tuple[str, str]]:
    sessions = manifest.get("sessions", [])
    entries = [("cells", str(manifest.get("cells"))), ("identity", str(manifest.get("identity")))]
    entries += [(f"version of {name}", str(value)) for name, value in manifest.get("versions", {}).items()]
    entries += [(f"library {name}", str(value)) for name, value in manifest.get("libraries", {}).items()]
    entries += [(str(key), str(value)) for key, value in manifest.get("machine", {}).items()]
    entries.append(("seeds", str(manifest.get("seeds"))))
    entries += [
        (
            f"session {position}",
            f"finished {session['finished']}, {session['wall_time_s']} s on {session['workers']} workers, "
            f"{session['parts_computed']} parts computed, {session['parts_reused']} reused",
        )
        for position, session in enumerate(sessions, start=1)
    ]
    return entries
