"""Figures of the causes of divergence (docs/ladder.md): the shares of the causes over axes, and trust maps.

The figures need the `LadderSummary` and the table of ladders of a finished run. A ladder splits the difference between
an engine and the model into causes. `figures` calls this module.

A trust map shows where in the plane of k2/k1 and m2/m1 an engine stays near the model, and which cause is the largest
elsewhere. A field is one pair of these two ratios, and holds the cells with all restitutions. The map distinguishes a
few levels of D. The typical level of a field is the lowest level that is not exceeded in its median cell. The strict
level is the lowest level that is not exceeded in any of its cells. The blamed cause of a field explains the cells of
the field that are beyond the lowest level: it has the largest sum of components over these cells.
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

#: Figures, each with the axes over which it is drawn. The first two figures are for two balls, the other two for
#: chains.
_STACKS = {
    "ladder-by-stiffness": ("stiffness_ratio",),
    "ladder-by-restitution": ("e1", "e2"),
    "ladder-by-balls": ("balls",),
    "ladder-by-chain": ("arrangement", "e"),
}
#: Labels of the axes, by name.
_LABELS = {
    "stiffness_ratio": "stiffness ratio k2/k1 (-)",
    "e1": "e1, ball on ball (-)",
    "e2": "e2, ball on table (-)",
    "balls": "number of balls N",
    "arrangement": "arrangement",
    "e": "e of every contact (-)",
}

#: Horizontal position of the whisker of each cause, relative to the middle of its bar, so that whiskers do not overlap.
_WHISKERS = (-0.24, -0.08, 0.08, 0.24)

#: Levels of D that a trust map distinguishes, the lowest first.
LEVELS = (0.01, 0.05, 0.2)

#: Colours of fields: one colour for each level, and one for fields beyond the last level. Colour-blind readers can tell
#: the colours apart.
_COLORS = ("#08519C", "#6BAED6", "#FEE391", "#A63603")

#: Colour of fields that have no cell beyond the lowest level, in the panel of causes.
_WITHIN = "0.9"

#: Vertical and horizontal axis of the plane of a trust map.
_PLANE = ["mass_ratio", "stiffness_ratio"]


def draw_ladders(ladder: LadderSummary) -> Iterator[Drawn]:
    """Draw all figures of the shares of causes; draw no figure if no engine has a result."""
    for name, axes in _STACKS.items():
        known_axes = [axis for axis in axes if axis in ladder.axes]
        if known_axes:
            over = " and ".join(_LABELS[axis] for axis in known_axes)
            yield name, _draw_panels(ladder, known_axes), _ladder_caption(over, ladder)


def _ladder_caption(over: str, ladder: LadderSummary) -> str:
    """Return the caption of a figure that shows the shares of causes over one or two axes."""
    causes = "dissipation law and gravity" if ladder.orders == "six" else "and dissipation law"
    return (
        f"Causes of the mean velocity divergence D between each engine and the model, over {over}. Each cause is a "
        "coloured bar, and the black line is the mean D. A bar below zero is a cause that brings the engine nearer to "
        "the model. Each cause is one change on the way from the model to the engine. The height of a bar is the part "
        "of D that this cause makes, as a mean over cells. In each cell this part is the change of velocities by the "
        "cause, projected on the whole difference of velocities in the kinetic norm. "
        f"The parts in a cell sum to its D. The changes of frozen positions, {causes} can be made in "
        f"{ladder.orders} orders, and a bar is the mean over these orders. Its whisker shows the smallest and the "
        f"largest result of an order. D = sqrt(sum m_i dv_i^2/sum m_i v_i0^2) has no unit. {LEFT_OUT}"
    )


def _draw_panels(ladder: LadderSummary, axes: Sequence[str]) -> Figure:
    """Draw the shares of causes with one panel per axis and engine."""
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
    """Draw the mean D of one engine and a bar for each contribution, upwards if positive and downwards if negative."""
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
    """Return the trust maps of the engines of a run of two balls, one row per field that has a compared cell.

    The index is the engine, the mass ratio and the stiffness ratio. Columns:

    * ``cells``: number of compared cells
    * ``typical``: position in `LEVELS` of the lowest level that is not exceeded in the median cell; 3 if all levels are
      exceeded
    * ``strict``: position in `LEVELS` of the lowest level that is not exceeded in any cell; 3 if all levels are
      exceeded
    * ``blamed``: name of the contribution that explains the cells beyond the lowest level; NaN without such cells

    The result is None if no engine has a result, or if k2/k1 or m2/m1 has a single value.
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
    """Draw the trust maps; draw nothing if there are no trust maps."""
    if trust is not None:
        engines = sort_by_law(trust.index.unique("solver"))
        yield "trust-map", _draw_trust_map(trust, engines), _trust_caption(trust, engines)


def _trust_caption(trust: Frame, engines: Sequence[str]) -> str:
    """Return the caption of the trust maps, with the share of trusted fields of each engine."""
    first, second, third = map(number, LEVELS)
    said = ""
    for name in engines:
        fields = trust.loc[name]
        within = percent((fields.typical <= 1).mean())
        said += f" {display_name(name)}: the median D is at most {second} in {within} of the fields"
        labels = [c.label for c in CONTRIBUTIONS if c.name in set(fields.blamed.mode())]
        said += (
            f". The cause with the largest part of D in the most fields is {labels[0]}." if labels else "."
        )
    return (
        "Trust maps: how far each engine is from the model, over stiffness ratio k2/k1 and mass ratio m2/m1. A field "
        f"of a map holds the cells of all restitutions (at most {trust.cells.max()}). Left: whether the median D of "
        f"the field is at most {first}, {second} or {third}, or above. Middle: the same for the largest D. "
        f"Right: the cause with the largest part of D, summed over the cells with D above {first} (docs/ladder.md). "
        f"The field is grey if no D is above {first}. White fields have nothing to compare.{said} In "
        "the mean D of all cells another cause may be the largest, because cells with a large D count more there. "
        f"{LEFT_OUT}"
    )


def _draw_trust_map(trust: Frame, engines: Sequence[str]) -> Figure:
    """Draw the trust maps: two panels of levels and one panel of causes in each row, and one row per engine."""
    shown = [c for c in CONTRIBUTIONS if (trust.blamed == c.name).any()]
    places = {c.name: place for place, c in enumerate(shown, start=1)}
    up, across = (sorted(trust.index.unique(axis)) for axis in _PLANE)
    titles = ("median D", "largest D", f"largest cause of D above {LEVELS[0]:g}")
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
        names = [*(f"D up to {level:g}" for level in LEVELS), f"D above {LEVELS[-1]:g}"]
        levels = [Patch(color=color, label=name) for color, name in zip(_COLORS, names, strict=True)]
        figure.legend(handles=levels, loc="outside lower left", ncols=2, fontsize=8)
        if shown:
            figure.legend(handles=_legend_patches(shown), loc="outside lower right", ncols=2, fontsize=8)
    return figure


def _legend_patches(shown: Sequence[Contribution]) -> list[Patch]:
    """Return the entries of a legend of contributions."""
    return [Patch(color=c.color, label=c.label) for c in shown]
