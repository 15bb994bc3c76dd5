"""The folder of a test: tables, figures, the page, and what they were made with."""

from __future__ import annotations

import base64
import platform
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from importlib.metadata import version
from pathlib import Path
from typing import Any

import pandas as pd
from jinja2 import Environment, PackageLoader, StrictUndefined

from impact_xval.compliant_baselines import get_solver
from impact_xval.experiments.hypothesis.figures import Picture, write_figures
from impact_xval.experiments.hypothesis.page import Part, build_page
from impact_xval.experiments.hypothesis.run import Results
from impact_xval.experiments.hypothesis.tables import (
    class_frame,
    map_frame,
    mechanism_frame,
    need_frame,
    outcome_frame,
    point_frame,
)
from impact_xval.experiments.sweep.executors import available_cores
from impact_xval.experiments.tables.document import (
    Block,
    Heading,
    Table,
    escape_markdown,
    to_latex,
    to_markdown,
)
from impact_xval.experiments.tables.store import write_json, write_text
from impact_xval.experiments.tables.streams import replacing

PAGE = "hypothesis.md"


def write_all(results: Results, root: Path, seconds: float) -> Path:
    """Write everything into a folder; give the path of the page."""
    versions = {"impact-xval": version("impact-xval"), "Python": platform.python_version()}
    versions |= {
        name: get_solver(name).version() for name in results.solvers if name not in ("state-transition",)
    }
    frames = {
        "verdicts": class_frame(results),
        "points": point_frame(results),
        "mechanism": mechanism_frame(results),
        "contrast-needed": need_frame(results),
    }
    for name, frame in frames.items():
        with replacing(root / f"{name}.csv") as temporary:
            frame.to_csv(temporary, index=False, lineterminator="\n")
    for name, frame in (("outcomes", outcome_frame(results)), ("maps", map_frame(results))):
        _write_parquet(root / f"{name}.parquet", frame)
    pictures = write_figures(results, root / "figures")
    parts = build_page(results, pictures, versions)
    tables: list[Block] = [part for part in parts if isinstance(part, Table)]
    write_text(
        root / "tables.tex", to_latex([Heading("Hypothesis: tables", level=1), *(_long(t) for t in tables)])
    )
    write_text(root / "tables.md", to_markdown([Heading("Hypothesis: tables", level=1), *tables]))
    write_text(root / PAGE, markdown(parts))
    write_text(root / "report.html", html(parts, root / "figures"))
    write_json(
        root / "manifest.json",
        {
            "format": "impact-xval hypothesis, format 1",
            "configuration": results.config.model_dump(mode="json"),
            "versions": versions,
            "unavailable": results.unavailable,
            "machine": {
                "system": platform.system(),
                "processor": platform.processor() or platform.machine(),
                "cores": available_cores(),
            },
            "seconds": {
                **{key: round(value, 1) for key, value in results.seconds.items()},
                "total": round(seconds, 1),
            },
        },
    )
    return root / PAGE


def _long(block: Block) -> Block:
    """Show a table in full in LaTeX too: this file is made for copying from."""
    return (
        Table(block.caption, block.header, block.rows, block.text_columns)
        if isinstance(block, Table)
        else block
    )


def _write_parquet(path: Path, frame: pd.DataFrame) -> None:
    with replacing(path) as temporary:
        frame.to_parquet(temporary, index=False, compression="zstd")


def markdown(parts: Sequence[Part]) -> str:
    """Write the page as Markdown; figures are linked, and numbered in order."""
    texts, figure = [], 0
    for part in parts:
        if isinstance(part, Picture):
            figure += 1
            caption = escape_markdown(part.caption)
            texts.append(f"![Figure {figure}](figures/{part.name}.png)\n\n**Figure {figure}.** {caption}\n")
        else:
            texts.append(to_markdown([part]))
    return "\n".join(texts)


def html(parts: Sequence[Part], figures: Path) -> str:
    """Write the page as one self-contained HTML file."""
    blocks: list[Mapping[str, Any]] = []
    number = 0
    for part in parts:
        kind = type(part).__name__.lower()
        entry: dict[str, Any] = {"kind": kind, **asdict(part)}
        if isinstance(part, Picture):
            number += 1
            data = base64.b64encode((figures / f"{part.name}.png").read_bytes()).decode("ascii")
            entry |= {"number": number, "data": data}
        blocks.append(entry)
    environment = Environment(
        loader=PackageLoader("impact_xval.experiments.presentation"),
        autoescape=True,
        undefined=StrictUndefined,
    )
    return environment.get_template("hypothesis.html.j2").render(blocks=blocks)
