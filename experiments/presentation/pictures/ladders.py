"""Figures of the ladders (docs/ladder.md): what the mean D is made of, over axes, and trust maps.

Trust maps show where in the plane of k2/k1 and m2/m1 an engine stays near the model, and what is to blame elsewhere. A
field of the plane holds the cells of all restitutions. It counts as within a level where its median cell is, or, more
strictly, where all of its cells are. To blame is the contribution with the largest sum of components over the cells of
the field that are beyond the lowest level.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
import pandas as pd
import pyarrow.compute as pc
import pyarrow.parquet as pq
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from impact_xval.compliant_baselines.registry import is_engine, sort_by_law
from impact_xval.experiments.config.experiment import Config
from impact_xval.experiments.measures.aggregates import axis_levels
from impact_xval.experiments.measures.ladder import CAUSES, CONTRIBUTIONS, Contribution
from impact_xval.experiments.measures.summary import LadderSummary
from impact_xval.experiments.presentation.style import LEFT_OUT, Drawn, label_axis_values, styled_figure
from impact_xval.experiments.presentation.words import display_name
from impact_xval.experiments.tables.folder import RunFolder
from impact_xval.experiments.tables.frames import Frame
from impact_xval.experiments.tables.numbers import number, percent
from impact_xval.experiments.tables.parquet import read_column, read_selected

#: Figures and the axes that they are drawn over, for two balls and for chains; labels of the axes.
_STACKS = {
    "ladder-by-stiffness": ("stiffness_ratio",),
    "ladder-by-restitution": ("e1", "e2"),
    "ladder-by-balls": ("balls",),
    "ladder-by-chain": ("arrangement", "e"),
}
_LABELS = {
    "stiffness_ratio": "stiffness ratio k2/k1 (-)",
    "e1": "e1, ball on ball (-)",
    "e2": "e2, ball on table (-)",
    "balls": "number of balls N",
    "arrangement": "arrangement",
    "e": "e of every contact (-)",
}

#: Position of the whisker of each cause in a bar, side by side so that they do not overlap.
_WHISKERS = (-0.24, -0.08, 0.08, 0.24)

#: Levels of D that count as trusted, the strictest first.
LEVELS = (0.01, 0.05, 0.2)

#: Colours of the fields of each level and of fields beyond the last, safe for the colour-blind.
_COLORS = ("#08519C", "#6BAED6", "#FEE391", "#A63603")

#: Colour of fields without a cell beyond the lowest level.
_WITHIN = "0.9"

#: Axes of the plane: vertical, horizontal.
_PLANE = ["mass_ratio", "stiffness_ratio"]


def draw_ladders(ladder: LadderSummary) -> Iterator[Drawn]:
    """Draw every figure of the ladders; none if no engine has a result."""
    for name, axes in _STACKS.items():
        known_axes = [axis for axis in axes if axis in ladder.axes]
        if known_axes:
            over = " and ".join(_LABELS[axis] for axis in known_axes)
            yield name, _draw_panels(ladder, known_axes), _ladder_caption(over, ladder)


def _ladder_caption(over: str, ladder: LadderSummary) -> str:
    causes = "dissipation law and gravity" if ladder.orders == "six" else "and dissipation law"
    return (
        f"What the mean velocity divergence D of each engine consists of, over {over}. Line: mean D; bars "
        "below zero: causes that take the engine back towards the model; whiskers: the range over "
        f"{ladder.orders} orders of causes. Each cause is a difference of velocities made by one change on the "
        "way from the model to the engine; drawn is the mean of its component along the whole difference, in the "
        f"kinetic norm. The components of a cell sum to its D. Frozen positions, {causes} can be changed in "
        f"{ladder.orders} orders; a bar is the mean over them, and its whisker reaches from where it ends by the "
        "order that gives least to where by the one that gives most. D = sqrt(sum m_i dv_i^2/sum m_i "
        f"v_i0^2), dimensionless. {LEFT_OUT}"
    )


def _draw_panels(ladder: LadderSummary, axes: Sequence[str]) -> Figure:
    """Draw one panel per axis and engine."""
    solvers = ladder.solvers
    with styled_figure(max(6.4, 3.6 * len(solvers)), 0.9 + 2.6 * len(axes)) as figure:
        panels = figure.subplots(len(axes), len(solvers), sharey=True, squeeze=False)
        for row, axis in zip(panels, axes, strict=True):
            for ax, solver in zip(row, solvers, strict=True):
                table = ladder.statistics
                rows = table[(table.solver == solver) & (table.axis == axis)]
                wide = rows.pivot(index="value", columns="contribution")
                label_axis_values(ax.xaxis, wide.index.tolist(), 8)
                ax.tick_params(axis="x", labelsize=8)
                _draw_bars(ax, ladder, wide)
                ax.set(xlabel=_LABELS[axis], title=display_name(solver))
            row[0].set_ylabel("component of mean D (-)")
        handles = _legend_patches(ladder.present)
        figure.legend(handles=handles, loc="outside lower center", ncols=min(len(handles), 4))
    return figure


def _draw_bars(ax: Axes, ladder: LadderSummary, wide: Frame) -> None:
    """Draw the mean D of one engine and the bars of its contributions, positive ones above zero."""
    total = wide.total.max(axis=1).to_numpy()
    x, above, below = np.arange(len(wide)), np.zeros(len(wide)), np.zeros(len(wide))
    for c in ladder.present:
        if c.name not in wide.share:
            continue
        part = total * wide.share[c.name].fillna(0).to_numpy()
        bottom = np.where(part >= 0, above, below)
        ax.bar(x, part, 0.8, bottom=bottom, color=c.color, edgecolor="white", linewidth=0.4)
        if c.is_cause:
            ends = [bottom + total * end[c.name] for end in (wide.low, wide.high)]
            beside = x + _WHISKERS[CAUSES.index(c)]
            ax.vlines(beside, *ends, color="black", linewidth=2.4)
            ax.vlines(beside, *ends, color=c.color, linewidth=1.2)
        above += np.maximum(part, 0)
        below += np.minimum(part, 0)
    between = "none" if isinstance(wide.index[0], str) else "-"
    ax.plot(x, total, color="black", marker="_", markersize=9, linewidth=1, linestyle=between)
    ax.axhline(0, color="0.3", linewidth=0.8)


def make_trust_maps(folder: RunFolder, config: Config) -> Frame | None:
    """Compute the trust in the engines of a run of two balls over its plane, from its ladders.

    None without a plane or a result of an engine; else a row a field that has a cell, by engine, mass ratio and
    stiffness ratio: ``cells``, the number of those that are compared; ``typical`` and ``strict``, the position in
    `LEVELS` of the level that the median cell, or every cell, stays within, 3 beyond all of them; ``blamed``, the name
    of the contribution, NaN where nothing is.
    """
    path = folder.table_path("ladder.parquet")
    levels = {axis: axis_levels(config, axis, read_column(path, axis)) for axis in _PLANE}
    there = set(pq.read_schema(path).names)
    shares = {f"{c.name}_share": c.name for c in CONTRIBUTIONS if f"{c.name}_share" in there}
    columns = ["solver", "status", *_PLANE, "velocity_divergence", *shares]
    rows = read_selected(
        path, columns, (pc.field("status") == "ok") & pc.field("marked").is_null()
    ).to_pandas()
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
    largest = pd.DataFrame({"typical": by_field.median(), "strict": by_field.max()})
    within = largest.apply(lambda each: np.searchsorted(LEVELS, each))
    return within.assign(cells=by_field.size(), blamed=sums.idxmax(axis=1) if len(sums) else None)


def draw_trust(trust: Frame | None) -> Iterator[Drawn]:
    """Draw a trust map; nothing without one."""
    if trust is not None:
        engines = sort_by_law(trust.index.unique("solver"))
        yield "trust-map", _draw_trust_map(trust, engines), _trust_caption(trust, engines)


def _trust_caption(trust: Frame, engines: Sequence[str]) -> str:
    first, second, third = (number(100 * level) for level in LEVELS)
    said = ""
    for name in engines:
        fields = trust.loc[name]
        within = percent((fields.typical <= 1).mean())
        said += f" {display_name(name)}: the median cell is within {second} % in {within} "
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


def _draw_trust_map(trust: Frame, engines: Sequence[str]) -> Figure:
    """Draw two panels of levels and one of causes, one row per engine."""
    shown = [c for c in CONTRIBUTIONS if (trust.blamed == c.name).any()]
    places = {c.name: place for place, c in enumerate(shown, start=1)}
    up, across = (sorted(trust.index.unique(axis)) for axis in _PLANE)
    titles = ("median cell is within", "every cell is within", f"largest cause beyond {100 * LEVELS[0]:g} %")
    with styled_figure(7.4, 1.4 + 1.45 * len(engines)) as figure:
        axes = figure.subplots(len(engines), 3, sharex=True, sharey=True, squeeze=False)
        for ax, title in zip(axes[0], titles, strict=True):
            ax.set_title(title, fontsize=8.5)
        for row, name in zip(axes, engines, strict=True):
            fields, causes = trust.loc[name], [_WITHIN, *(c.color for c in shown)]
            blamed = fields.blamed.map(places).fillna(0)
            panels = ((fields.typical, _COLORS), (fields.strict, _COLORS), (blamed, causes))
            for ax, (values, colors) in zip(row, panels, strict=True):
                image = values.unstack().reindex(index=up, columns=across).to_numpy(float)
                ax.imshow(
                    image,
                    cmap=ListedColormap(colors),
                    vmin=-0.5,
                    vmax=len(colors) - 0.5,
                    origin="lower",
                    aspect="auto",
                    interpolation="nearest",
                )
                ax.grid(False)
            row[0].set_ylabel(f"{display_name(name)}\nm2/m1 (-)")
        label_axis_values(axes[0, 0].xaxis, across, 5)
        label_axis_values(axes[0, 0].yaxis, up, 6)
        for ax in axes[-1]:
            ax.set_xlabel("k2/k1 (-)")
        names = [*(f"D up to {100 * level:g} %" for level in LEVELS), f"D above {100 * LEVELS[-1]:g} %"]
        levels = [Patch(color=color, label=name) for color, name in zip(_COLORS, names, strict=True)]
        figure.legend(handles=levels, loc="outside lower left", ncols=2, fontsize=8)
        if shown:
            figure.legend(handles=_legend_patches(shown), loc="outside lower right", ncols=2, fontsize=8)
    return figure


def _legend_patches(shown: Sequence[Contribution]) -> list[Patch]:
    """Make the entries of a legend of contributions."""
    return [Patch(color=c.color, label=c.label) for c in shown]
