"""Interactive charts of the page, drawn by Bokeh: a map of the cells, and the impulse curves of the open cell.

The map needs the table of divergence of a finished run. It shows D over k2/k1 for two balls, or over the number of
balls for chains, and over other axes. A click on a tile of the map opens a cell. The page of a run and `explore` call
this module.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from bokeh.core.types import ID
from bokeh.embed import json_item
from bokeh.models import (
    BasicTicker,
    ColorBar,
    ColumnDataSource,
    FixedTicker,
    HoverTool,
    Legend,
    LogColorMapper,
    TapTool,
)
from bokeh.plotting import figure
from bokeh.resources import Resources
from markupsafe import Markup

from impact_xval.experiments.config.arrangements import CHAIN_AXES
from impact_xval.experiments.config.axes import AXES
from impact_xval.experiments.config.experiment import REFERENCE, CellKind
from impact_xval.experiments.config.graphs import GRAPH_AXES
from impact_xval.experiments.measures.aggregates import DivergenceTable, levels_of
from impact_xval.experiments.presentation.html import render_template
from impact_xval.experiments.presentation.words import (
    NO_RESULT,
    WHAT_NO_RESULT_IS,
    display_name,
    format_axis_value,
    look_of,
)
from impact_xval.experiments.tables.frames import Frame
from impact_xval.experiments.tables.numbers import join_words
from impact_xval.experiments.tables.parquet import read_column

#: Largest number of tiles of a map. A browser draws this number without delay, and a page has room for it.
TILES = 1000

#: An axis with at most this number of values is never put into bins.
_FEW = 24

#: Labels of the axes of pairs, chains and graphs, by name.
LABELS = AXES | CHAIN_AXES | GRAPH_AXES

#: Label for graphs on an axis that these graphs do not have.
_ABSENT = "-"

#: Smallest D on the scale of colours; smaller D have the same colour.
_FLOOR = 1e-4

#: Largest number of labels along an axis of a chart.
_LABELS = 60


@dataclass(frozen=True, slots=True)
class Tiles:
    """Tiles of a map, with one axis of the run along the map and one or more axes up its side.

    Tiles without a cell are left out. `places` has one row per tile: its position ``across`` and ``above``, the labels
    of its ``column`` and ``row``, and the ``cell`` that it opens. A tile opens the unmarked cell with the largest D by
    any solver. If all its cells are marked, it opens a marked cell. `medians` has one row per tile and one column per
    compared solver: the median D of the unmarked cells, or NaN if no cell of the tile was compared.
    """

    along: str
    up: tuple[str, ...]
    places: Frame
    medians: Frame


def make_tiles(table: DivergenceTable) -> Tiles:
    """Return the map of the compared cells of a run.

    Axes are put up the side of the map in the order of the tables, as long as there is room. If all axes have room, a
    tile is one cell of the grid. For chains only those axes are used that have several values, and a value in every
    cell.
    """
    rows = table.rows.assign(d=table.measure("velocity_divergence"))
    rows["cell"] = read_column(table.path, "cell").astype(np.int64)
    rows["rank"] = rows.d.where(table.regular, -1.0)  # marked cells come last
    for axis, levels in table.levels.items():
        rows[axis] = rows[axis].cat.reorder_categories(sorted(levels.values))
    along, *up = table.levels
    if "graph" in table.levels:
        several = [axis for axis, levels in table.levels.items() if len(levels.values) > 1]
        along, *up = several if len(several) > 1 else [*several, "graph", "e"][:2]
        for axis in (along, *up):
            if rows[axis].isna().any():
                rows[axis] = rows[axis].cat.add_categories([_ABSENT]).fillna(_ABSENT)

    def count(*axes: str) -> int:
        return math.prod(len(rows[axis].cat.categories) for axis in axes)

    if along == "balls":
        up = [axis for axis in up if count(axis) > 1 and rows[axis].notna().all()] or ["arrangement"]
    while len(up) > 1 and count(along, *up) > TILES:
        up.pop()
    axes = [along, *up]
    for axis in axes if count(*axes) > TILES else ():
        if count(axis) > _FEW:
            x = read_column(table.path, axis)
            bins = levels_of(x)
            rows[axis] = pd.Categorical.from_codes(bins.codes(x), bins.values)
    rows["tile"] = rows.groupby(axes, observed=True).ngroup()  # numbered in the order of the axes
    largest = rows.sort_values(["tile", "rank"], ascending=[True, False], kind="stable")
    places = largest.drop_duplicates("tile").reset_index(drop=True)
    labels: Frame = places[axes].map(format_axis_value)
    tiles = pd.DataFrame(
        {
            "across": places[along].cat.codes,
            "above": places.groupby(up, observed=True).ngroup(),
            "column": labels[along],
            "row": [" · ".join(row) for row in labels[up].to_numpy()],
            "cell": places.cell,
        }
    )
    medians = rows[table.regular].groupby(["tile", "solver"], observed=True).d.median().unstack()
    return Tiles(along, tuple(up), tiles, medians.reindex(tiles.index))


def cells_piece(tiles: Tiles, n_cells: int, packed: str, solvers: Sequence[str], kind: CellKind) -> Markup:
    """Return the HTML with the map of a run and with the cell that is open.

    At least one solver was compared with the model. `packed` has the compressed contents of the cells that a reader can
    open, as `opened.pack_cells` returns them.
    """
    plots = {"map": _draw_map(tiles)} | ({"curves": curves_chart(solvers)} if kind == "pair" else {})
    return render_template(
        "cells.html.j2",
        compared=[(name, display_name(name)) for name in tiles.medians],
        shown=len(tiles.places),
        n_cells=n_cells,
        rows=join_words(LABELS[axis] for axis in tiles.up),
        bokeh=bokeh_script(),
        first=tiles.places.cell[tiles.medians.iloc[:, -1].idxmax()],
        data=packed,
        no_result=NO_RESULT,
        what_no_result_is=WHAT_NO_RESULT_IS,
        curves="curves" in plots,
        planar=kind == "graph",
        charts=[json_item(plot, ID(name)) for name, plot in plots.items()],
    )


def bokeh_script() -> Markup:
    """Return the script of Bokeh as HTML, so that a page with this script loads nothing from elsewhere."""
    return Markup(Resources(mode="inline", components=["bokeh"], log_level="error").render_js())


def _draw_map(tiles: Tiles) -> figure:
    """Return the chart of the map: one tile per cell or group of cells, coloured by the median D of one solver."""
    places, floored = tiles.places, tiles.medians.clip(lower=_FLOOR)
    medians = floored.add_prefix("d ").to_dict("list")
    shown = {"shown": [*medians.values()][-1]}
    source = ColumnDataSource(places.to_dict("list") | shown | medians, name="tiles")
    highest = max(10 * _FLOOR, float(floored.max(axis=None)))
    mapper = LogColorMapper(palette="Viridis256", low=_FLOOR, high=highest, nan_color="#dddddd")
    columns = dict(zip(places.across, places.column, strict=True))
    rows = dict(zip(places.above, places.row, strict=True))
    up = " · ".join(LABELS[axis] for axis in tiles.up)
    tips = [(LABELS[tiles.along], "@column"), (up, "@row"), ("D", "@shown{0.0000}"), ("opens cell", "@cell")]
    plot = figure(
        height=min(1000, 110 + (11 if len(rows) > 30 else 22) * len(rows)),
        sizing_mode="stretch_width",
        tools=[TapTool(), HoverTool(tooltips=tips)],
        toolbar_location=None,
        x_axis_label=f"{LABELS[tiles.along]} (-)",
        y_axis_label=up,
        name="map",
    )
    plot.rect(
        "across",
        "above",
        width=0.96,
        height=0.92,
        source=source,
        fill_color={"field": "shown", "transform": mapper},
        line_color=None,
        nonselection_fill_alpha=1.0,
        line_width=3,
        selection_line_color="#d00000",
    )
    for axis, labels in ((plot.xaxis, columns), (plot.yaxis, rows)):
        axis.ticker = FixedTicker(ticks=sorted(labels)[:: -(-len(labels) // _LABELS)])
        axis.major_label_overrides = labels
    plot.xaxis.major_label_orientation = "vertical"
    plot.yaxis.major_label_text_font_size = "10px"
    plot.grid.visible = False
    plot.add_layout(ColorBar(color_mapper=mapper, title="D", width=10), "right")
    return plot


def curves_chart(solvers: Sequence[str]) -> figure:
    """Return an empty chart of impulse curves.

    The page fills its data sources ``curve SOLVER``, ``end SOLVER``, ``line l1`` and ``line l2``.
    """
    plot = _empty_chart("curves", "I1/(m1 |v0|), ball on ball (-)", "I2/(m1 |v0|), ball on table (-)")
    for line, dash in (("l1: v1 = v2", "dashed"), ("l2: v2 = 0", "dotted")):
        source = ColumnDataSource({"x": [], "y": []}, name=f"line {line[:2]}")
        plot.line("x", "y", source=source, color="#808080", line_dash=dash, legend_label=line)
    return _with_solvers(plot, solvers, "curve", "end")


def velocities_chart(solvers: Sequence[str]) -> figure:
    """Return an empty chart of final velocities of a chain, whose data sources ``balls SOLVER`` the page fills."""
    plot = _empty_chart("velocities", "ball, 1 on top or first", "final velocity / |v0|, up is positive (-)")
    ticker = plot.xaxis[0].ticker
    assert isinstance(ticker, BasicTicker)
    ticker.mantissas = [1, 2, 5]
    ticker.min_interval = 1
    plot.xaxis.minor_tick_line_color = None
    return _with_solvers(plot, solvers, "balls", "balls")


def _empty_chart(name: str, across: str, up: str) -> figure:
    """Return a chart without curves, which a reader can move and zoom, with a legend below."""
    plot = figure(
        height=420,
        sizing_mode="stretch_width",
        tools="pan,wheel_zoom,box_zoom,reset",
        active_drag=None,  # a finger on the chart scrolls the page
        active_scroll=None,
        x_axis_label=across,
        y_axis_label=up,
        name=name,
    )
    plot.toolbar.logo = None
    # Inside the chart the legend would cover a curve.
    plot.add_layout(Legend(location="top_left", ncols=2, spacing=12, label_text_font_size="11px"), "below")
    return plot


def _with_solvers(plot: figure, solvers: Sequence[str], lines: str, points: str) -> figure:
    """Add an empty line and empty points for each solver to a chart, and return the chart.

    The names of the data sources are `lines` and `points`, each followed by the name of the solver.
    """
    for name in solvers:
        style = look_of(name)
        dash = style.dash if isinstance(style.dash, str) else list(style.dash[1])
        sources = {
            kind: ColumnDataSource({"x": [], "y": []}, name=f"{kind} {name}") for kind in (lines, points)
        }
        color, label = style.color, display_name(name)
        width = 3 if name == REFERENCE else 2
        plot.line(
            "x",
            "y",
            source=sources[lines],
            line_dash=dash,
            line_width=width,
            color=color,
            legend_label=label,
        )
        plot.scatter("x", "y", source=sources[points], size=9, color=color, legend_label=label)
    return plot
