"""What moves on the page, by Bokeh: the map whose tiles open, and the impulse curves of the cell that is open."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from bokeh.core.types import ID
from bokeh.embed import json_item
from bokeh.models import (
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

from impact_xval.experiments.config.axes import AXES
from impact_xval.experiments.config.experiment import REFERENCE
from impact_xval.experiments.presentation.html import render
from impact_xval.experiments.presentation.looks import look
from impact_xval.experiments.presentation.page.tiles import LABELS, Tiles
from impact_xval.experiments.presentation.words import named
from impact_xval.experiments.tables.numbers import listed

#: D below this has the colour of this: about the rounding of the solvers.
_FLOOR = 1e-4

#: Labels of an axis at most.
_LABELS = 60

#: Sides of the map: place, and what it says there.
_SIDES = (("across", "column"), ("above", "row"))

#: How Bokeh draws the dashes of `style`.
_DASHES = {"-": "solid", "--": "dashed", "-.": "dashdot", ":": "dotted"}


def cells_piece(tiles: Tiles, packed: str, solvers: Sequence[str], numbers: int) -> Markup:
    """Lay out the map and the cell that is open.

    Parameters
    ----------
    tiles : Tiles
        Of a run in which a solver was compared.
    packed : str
        What is shown of the cells (`opened.packed_cells`).
    solvers : sequence of str
        All of the run, the model among them.
    numbers : int
        How many cells the run has.
    """
    rest = [LABELS[axis] for axis in tiles.rest]
    plots = {"map": _map(tiles)} | ({"curves": curves_chart(solvers)} if tiles.along in AXES else {})
    return render(
        "cells.html.j2",
        compared=[(name, named(name)) for name in tiles.medians],
        shown=len(tiles.places),
        n_cells=tiles.n_cells,
        rest=listed(rest) if rest else "the cells in it",
        rows=listed(LABELS[axis] for axis in tiles.up),
        last=numbers - 1,
        first=tiles.places.cell[tiles.medians.iloc[:, -1].idxmax()],
        data=packed,
        curves="curves" in plots,
        charts=[json_item(plot, ID(name)) for name, plot in plots.items()],
    )


def scripts() -> Markup:
    """Return what moves the page: the script of Bokeh, which is in its package, and the page's own."""
    return render("moving.html.j2", bokeh=bokeh_script())


def bokeh_script() -> Markup:
    """Return the script of Bokeh: a page that has it asks for nothing."""
    return Markup(Resources(mode="inline", components=["bokeh"], log_level="error").render_js())


def _map(tiles: Tiles) -> Any:
    """Draw one tile a cell, or the median of several, coloured by the D of one solver."""
    places, floored = tiles.places, tiles.medians.clip(lower=_FLOOR)
    medians = {f"d {name}": floored[name].tolist() for name in floored}
    sides = places.to_dict("list")
    source = ColumnDataSource({**sides, "shown": [*medians.values()][-1], **medians}, name="tiles")
    highest = max(10 * _FLOOR, float(floored.max(axis=None)))
    mapper = LogColorMapper(palette="Viridis256", low=_FLOOR, high=highest, nan_color="#dddddd")
    columns, rows = (dict(zip(places[at], places[says], strict=True)) for at, says in _SIDES)
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


def curves_chart(solvers: Sequence[str]) -> Any:
    """Draw empty impulse curves; the page fills ``curve SOLVER``, ``end SOLVER``, ``line l1`` and ``line l2``."""
    plot = _chart("curves", "I1/(m1 |v0|), ball on ball (-)", "I2/(m1 |v0|), ball on table (-)")
    for line, dash in (("l1: v1 = v2", "dashed"), ("l2: v2 = 0", "dotted")):
        source = ColumnDataSource({"x": [], "y": []}, name=f"line {line[:2]}")
        plot.line("x", "y", source=source, color="#808080", line_dash=dash, legend_label=line)
    return _with_solvers(plot, solvers, "curve", "end")


def velocities_chart(solvers: Sequence[str]) -> Any:
    """Draw empty final velocities of the balls of a column; the page fills ``balls SOLVER``."""
    plot = _chart("velocities", "ball, 1 on top or first", "final velocity / |v0|, up is positive (-)")
    plot.xaxis.ticker.mantissas = [1, 2, 5]
    plot.xaxis.ticker.min_interval = 1
    plot.xaxis.minor_tick_line_color = None
    return _with_solvers(plot, solvers, "balls", "balls")


def _chart(name: str, across: str, up: str) -> Any:
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
    # Within the chart it would cover a line.
    plot.add_layout(Legend(location="top_left", ncols=2, spacing=12, label_text_font_size="11px"), "below")
    return plot


def _with_solvers(plot: Any, solvers: Sequence[str], lines: str, points: str) -> Any:
    """Add a line and points for each solver; their sources have these names, with that of the solver."""
    for position, name in enumerate(solvers):
        style = look(name, position)
        dash = _DASHES.get(style.dash, "solid") if isinstance(style.dash, str) else list(style.dash[1])
        named_alike = {
            each: ColumnDataSource({"x": [], "y": []}, name=f"{each} {name}") for each in (lines, points)
        }
        how = {"color": style.color, "legend_label": named(name)}
        width = 3 if name == REFERENCE else 2
        plot.line("x", "y", source=named_alike[lines], line_dash=dash, line_width=width, **how)
        plot.scatter("x", "y", source=named_alike[points], size=9, **how)
    return plot
