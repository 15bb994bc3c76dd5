"""Trust maps: where in the plane of k2/k1 and m2/m1 an engine stays near the model, and what is to blame elsewhere.

A field of the plane holds the cells of all restitutions. It counts as within a level where its median cell is, or, more
strictly, where all of its cells are. To blame is the contribution of the ladder (docs/ladder.md) with the largest sum
of components over the cells of the field that are beyond the lowest level.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import pandas as pd
import pyarrow.compute as pc
import pyarrow.parquet as pq
from matplotlib.colors import BoundaryNorm, ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from impact_xval.compliant_baselines.registry import is_engine
from impact_xval.experiments.config.experiment import Config
from impact_xval.experiments.measures.aggregates import Frame, axis_levels
from impact_xval.experiments.measures.ladder import CONTRIBUTIONS
from impact_xval.experiments.measures.laws import in_order_of_laws
from impact_xval.experiments.presentation.style import LEFT_OUT, Drawn, drawing, label_places
from impact_xval.experiments.presentation.words import named
from impact_xval.experiments.tables.folder import RunFolder
from impact_xval.experiments.tables.numbers import number, percent
from impact_xval.experiments.tables.parquet import column, selected

#: D that is trusted, from the strictest on.
LEVELS = (0.01, 0.05, 0.2)

#: Of the fields of every level, and of those beyond the last: told apart by those who see no red or no green.
_COLORS = ("#08519C", "#6BAED6", "#FEE391", "#A63603")

#: Of fields with no cell beyond the lowest level.
_WITHIN = "0.9"

#: Sides of the plane: up, and across.
_PLANE = ["mass_ratio", "stiffness_ratio"]


def trust_of(folder: RunFolder, config: Config) -> Frame | None:
    """Compute the trust in the engines of a run of two balls over its plane, from its ladders.

    None without a plane or a result of an engine; else a row a field that has a cell, by engine, mass ratio and
    stiffness ratio: ``cells``, the number of those that are compared; ``typical`` and ``strict``, the position in
    `LEVELS` of the level that the median cell, or every cell, stays within, 3 beyond all of them; ``blamed``, the name
    of the contribution, NaN where nothing is.
    """
    path = folder.table_path("ladder.parquet")
    levels = {axis: axis_levels(config, axis, column(path, axis)) for axis in _PLANE}
    there = set(pq.read_schema(path).names)
    shares = {f"{c.name}_share": c.name for c in CONTRIBUTIONS if f"{c.name}_share" in there}
    columns = ["solver", "status", *_PLANE, "velocity_divergence", *shares]
    rows = selected(path, columns, (pc.field("status") == "ok") & pc.field("marked").is_null()).to_pandas()
    rows = rows[rows.solver.map(is_engine).astype(bool)]
    if rows.empty or min(len(each.values) for each in levels.values()) < 2:
        return None
    for axis, each in levels.items():
        rows[axis] = np.array(each.values)[each.codes(rows[axis].to_numpy())]
    keys = [rows[name] for name in ("solver", *_PLANE)]
    d = rows.velocity_divergence
    components = rows[list(shares)].rename(columns=shares).fillna(0.0).mul(d, axis=0)
    sums = components.where(d > LEVELS[0]).groupby(keys, observed=True).sum(min_count=1).dropna(how="all")
    by_field = d.groupby(keys, observed=True)
    return pd.DataFrame(
        {
            "cells": by_field.size(),
            "typical": by_field.median().map(_level),
            "strict": by_field.max().map(_level),
            "blamed": sums.idxmax(axis=1) if len(sums) else None,
        }
    )


def _level(d: float) -> int:
    """Position in `LEVELS` of the first that is not below a D."""
    return int(np.searchsorted(LEVELS, d))


def draw_trust(trust: Frame | None) -> Iterator[Drawn]:
    """Draw a trust map; nothing where there is none."""
    if trust is not None:
        engines = in_order_of_laws(trust.index.unique("solver"))
        yield "trust-map", _figure(trust, engines), _caption(trust, engines)


def _caption(trust: Frame, engines: Sequence[str]) -> str:
    first, second, third = (number(100 * level) for level in LEVELS)
    said = ""
    for name in engines:
        fields = trust.loc[name]
        said += f" {named(name)}: the median cell is within {second} % in {percent((fields.typical <= 1).mean())} "
        labels = [c.label for c in CONTRIBUTIONS if c.name in set(fields.blamed.mode())]
        said += (
            f"of the fields; the largest cause is most often: {labels[0]}." if labels else "of the fields."
        )
    return (
        "Where engines end as the model does, over stiffness ratio k2/k1 and mass ratio m2/m1. A field "
        f"holds the cells of all restitutions, {trust.cells.max()} at most. Left: the velocity divergence D "
        f"that its median cell stays within, {first} %, {second} %, {third} % or more; middle: that every cell of it "
        "stays within. Right: the cause with the largest part of D, summed over those of its cells that are beyond "
        f"{first} % (docs/ladder.md); grey: no cell is. White: nothing to compare.{said} {LEFT_OUT}"
    )


def _figure(trust: Frame, engines: Sequence[str]) -> Figure:
    shown = [c for c in CONTRIBUTIONS if (trust.blamed == c.name).any()]
    places = {c.name: place for place, c in enumerate(shown, start=1)}
    up, across = (sorted(trust.index.unique(axis)) for axis in _PLANE)
    plane = {"index": up, "columns": across}
    with drawing(7.4, 1.4 + 1.45 * len(engines)) as figure:
        axes = figure.subplots(len(engines), 3, sharex=True, sharey=True, squeeze=False)
        titles = (
            "median cell is within",
            "every cell is within",
            f"largest cause beyond {100 * LEVELS[0]:g} %",
        )
        for ax, title in zip(axes[0], titles, strict=True):
            ax.set_title(title, fontsize=8.5)
        for row, name in zip(axes, engines, strict=True):
            fields = trust.loc[name]
            for ax, of_fields in zip(row, (fields.typical, fields.strict), strict=False):
                _show(ax, of_fields.unstack().reindex(**plane), _COLORS)
            blamed = fields.blamed.map(places).fillna(0)
            _show(row[2], blamed.unstack().reindex(**plane), [_WITHIN, *(c.color for c in shown)])
            row[0].set_ylabel(f"{named(name)}\nm2/m1 (-)")
        label_places(axes[0, 0].xaxis, across, 5)
        label_places(axes[0, 0].yaxis, up, 6)
        for ax in axes[-1]:
            ax.set_xlabel("k2/k1 (-)")
        names = [*(f"D up to {100 * level:g} %" for level in LEVELS), f"D above {100 * LEVELS[-1]:g} %"]
        levels = [Patch(color=color, label=name) for color, name in zip(_COLORS, names, strict=True)]
        figure.legend(handles=levels, loc="outside lower left", ncols=2, fontsize=8)
        if shown:
            causes = [Patch(color=c.color, label=c.label) for c in shown]
            figure.legend(handles=causes, loc="outside lower right", ncols=2, fontsize=8)
    return figure


def _show(ax: Any, image: Frame, colors: Sequence[str]) -> None:
    norm = BoundaryNorm(np.arange(len(colors) + 1) - 0.5, len(colors))
    look = {"cmap": ListedColormap(colors), "norm": norm, "interpolation": "nearest"}
    ax.imshow(image.to_numpy(float), origin="lower", aspect="auto", **look)
    ax.grid(False)
