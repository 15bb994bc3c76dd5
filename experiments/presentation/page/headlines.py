"""Pieces of the page of a run: three numbers, the matrix of D between all solvers, the cells that open."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from markupsafe import Markup

from impact_xval.experiments.config.axes import AXES
from impact_xval.experiments.config.experiment import REFERENCE
from impact_xval.experiments.measures.summary import Summary
from impact_xval.experiments.presentation.page.html import render_markup
from impact_xval.experiments.presentation.page.tiles import Tiles
from impact_xval.experiments.presentation.pages import phrase
from impact_xval.experiments.tables.numbers import number

_WORDS = "headlines.md.j2"


def subjects(found: Sequence[dict[str, Any]], closest: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Choose of whom the sentences tell: the engines; without any, every solver that was compared."""
    engines = {pair["solver"] for pair in closest}
    return [s for s in found if s["solver"] in engines] or list(found)


def numbers(facts: dict[str, Any], unit: str) -> Markup:
    """Write up to three numbers: how far, how near to what was asked for, and why.

    Parameters
    ----------
    facts : dict
        ``subjects``, ``closest`` and ``ladder`` of the page.
    unit : str
        What is counted: cells or columns.
    """
    shown = [(number(s["d"]["median"]), phrase(_WORDS, "far_words", s, unit)) for s in facts["subjects"][:1]]
    shown += [(number(pair["median"]), phrase(_WORDS, "asked_words", pair)) for pair in facts["closest"][:1]]
    shown += [
        (share.partition(" (")[0], phrase(_WORDS, "cause_words", engine, label))
        for engine in facts["ladder"]["engines"][:1]
        if engine["total"] > 0
        for share, label in engine["parts"][:1]
    ]
    return render_markup("numbers.html.j2", numbers=shown)


def matrix(summary: Summary) -> Markup:
    """Lay out the median D between every two solvers."""
    names = [REFERENCE, *summary.solvers]
    known = {
        **{(REFERENCE, name): summary.get(name, "velocity_divergence") for name in summary.solvers},
        **{(row.solver, row.other): row for _, row in summary.between.iterrows()},
    }
    medians = [float(row["median"]) for row in known.values() if row["n"]]
    highest = max(medians, default=0.0) or 1.0

    def cell(a: str, b: str) -> dict[str, Any] | None:
        row = known.get((a, b), known.get((b, a)))
        if row is None or not row["n"]:
            return None
        return {
            "median": number(row["median"]),
            "most": number(row["max"]),
            "n": int(row["n"]),
            "share": 0.5 * float(row["median"]) / highest,
        }

    caption = phrase(_WORDS, "matrix_caption", summary.solvers)
    rows = [[None if a == b else cell(a, b) for b in names] for a in names]
    return render_markup("matrix.html.j2", names=names, rows=rows, caption=caption)


def cells_piece(tiles: Tiles, packed: str, drawn: list[Any]) -> Markup:
    """Lay out the map, the cell that is open, and the list of those that open.

    Parameters
    ----------
    tiles : Tiles
    packed : str
        What is shown of the cells (`cells.packed_cells`).
    drawn : list
        The charts (`charts.charts`).
    """
    along = [AXES[axis] for axis in tiles.up]
    rest = [label for axis, label in AXES.items() if axis not in (*tiles.up, "stiffness_ratio")]
    compared = [name for name, medians in tiles.medians.items() if any(d is not None for d in medians)]
    shown = tiles.medians[compared[-1]] if compared else [None] * len(tiles.cells)
    rows = [
        (
            cell,
            (tiles.across_labels[across], *tiles.up_labels[above].split(" · ")),
            [number(math.nan if (d := tiles.medians[name][place]) is None else d) for name in compared],
        )
        for place, (cell, across, above) in enumerate(
            zip(tiles.cells, tiles.across, tiles.above, strict=True)
        )
    ]
    return render_markup(
        "cells.html.j2",
        compared=compared,
        labels=["k2/k1", *along],
        caption=phrase(_WORDS, "cells_caption", tiles, along, rest),
        rows=rows,
        first=tiles.cells[max(range(len(shown)), key=lambda place: shown[place] or 0.0)],
        data=packed,
        charts=drawn,
    )
