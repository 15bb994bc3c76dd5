"""The charts of the explorer, which move: their axes, once, and what is in them, for each cell anew."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

from bokeh.models import ColumnDataSource, FixedTicker, Range1d
from bokeh.plotting import figure

from impact_xval.experiments.cells.compared import Compared, impulse_curves
from impact_xval.experiments.config.experiment import REFERENCE
from impact_xval.experiments.measures.laws import in_order_of_laws
from impact_xval.experiments.presentation.looks import look
from impact_xval.experiments.sweep.curves import needed
from impact_xval.model.collision import RESULT_STATUSES, Collision, Path

#: Ink, faint ink and lines of a grid, on a light and on a dark page.
_INKS = {"light": ("#1a1a1a", "#5a5a5a", "#e2e2e2"), "dark": ("#ececec", "#b4b4b4", "#3d3d3d")}
#: Of `style.look`, on the canvas of a browser.
_MARKERS = {"o": "circle", "s": "square", "^": "triangle", "D": "diamond", "v": "inverted_triangle"}
_DASHES = {"-": [], "--": [7, 4], "-.": [8, 3, 2, 3], ":": [2, 3]}
#: Most points of an impulse curve: more are not seen in a chart of this size.
_POINTS = 600
#: Share of the impulses of a column that may pass beyond the end of the time axis.
_TAIL = 1e-3


class Line(NamedTuple):
    """How a solver is drawn in a browser."""

    color: str
    dash: list[int]
    width: int
    marker: str


def line_of(solver: str, scheme: str, position: int = 0) -> Line:
    """Return the line of a solver: the model's is wide, so that what lies on it is seen, and black or white.

    Parameters
    ----------
    solver : str
    scheme : {"light", "dark"}
        Of the page.
    position : int
        As for `style.look`.
    """
    drawn = look(solver, position)
    color = _INKS["dark"][0] if scheme == "dark" and drawn.color == "#000000" else drawn.color
    dash = _DASHES[drawn.dash] if isinstance(drawn.dash, str) else list(drawn.dash[1])
    return Line(color, dash, 4 if solver == REFERENCE else 2, _MARKERS.get(drawn.marker, "star"))


def lines_of(solvers: Iterable[str], scheme: str) -> dict[str, Line]:
    """Return the line of each solver."""
    return {name: line_of(name, scheme, position) for position, name in enumerate(solvers)}


def compression_lines(scheme: str) -> dict[str, Line]:
    """Return the lines l1 and l2 by their names."""
    faint = _INKS[scheme][1]
    return {
        "l1: compression of ball on ball ends": Line(faint, [6, 3], 1, ""),
        "l2: compression of ball on table ends": Line(faint, [2, 2], 1, ""),
    }


class Charts:
    """Four charts: impulse curves and where they end, of two balls; velocities and forces, of a column.

    Attributes
    ----------
    curves, ends, velocities, forces : figure
    """

    def __init__(self) -> None:
        self._sources: dict[str, ColumnDataSource] = {}
        impulses = "I1 / (m1 |v0|), ball on ball (-)", "I2 / (m1 |v0|), ball on table (-)"
        self.curves = _chart("curves", "Impulse curves", *impulses)
        self.ends = _chart("ends", "Where the curves end", *impulses)
        self.velocities = _chart(
            "velocities", "Final velocities, up is positive", "ball, 1 on top or first", "velocity / |v0| (-)"
        )
        self.forces = _chart(
            "forces",
            "Forces of the model, faint at the first contact, strong at the last",
            "time / sqrt(m/k) (-)",
            "force / (|v0| sqrt(m k)) (-)",
        )
        for chart, lines, points in (
            (self.curves, ("curves", "compression"), "ends"),
            (self.ends, ("curves", "compression"), "ends"),
            (self.velocities, ("velocities",), "balls"),
            (self.forces, ("forces",), None),
        ):
            for name in lines:
                look = {"color": "color", "line_dash": "dash", "line_width": "width"}
                chart.multi_line("x", "y", source=self._source(name, _lines({}, {})), **look)
            if points is not None:
                source = self._source(points, _points({}, {}))
                chart.scatter("x", "y", color="color", marker="marker", size=8, source=source)
        self.velocities.xaxis.ticker = FixedTicker(ticks=[], name="balls_ticks", syncable=False)
        self.paint("light")

    @property
    def all(self) -> tuple[Any, ...]:
        """All charts."""
        return self.curves, self.ends, self.velocities, self.forces

    def paint(self, scheme: str) -> None:
        """Paint axes and letters for a light or a dark page."""
        ink, faint, grid = _INKS[scheme]
        for chart in self.all:
            chart.title.text_color = ink
            for axis in chart.axis:
                axis.axis_label_text_color = axis.major_label_text_color = ink
                axis.axis_line_color = axis.major_tick_line_color = axis.minor_tick_line_color = faint
            chart.grid.grid_line_color = grid

    def _source(self, name: str, data: dict[str, Any]) -> ColumnDataSource:
        """Return a source of data that the page fills in, and the server is not told of."""
        if name not in self._sources:
            self._sources[name] = ColumnDataSource(data, name=f"{name}_data", syncable=False)
        return self._sources[name]


class Drawn(NamedTuple):
    """What is in the charts of a cell: plain values, which a page takes as one message.

    Attributes
    ----------
    data : dict
        Columns of each source of data, by the name of what is drawn.
    frames : dict
        Low and high end of both axes of a chart.
    ticks : list of int
        Balls that are numbered.
    """

    data: dict[str, dict[str, Any]]
    frames: dict[str, tuple[float, float, float, float]]
    ticks: list[int]


def drawn(compared: Compared, scheme: str) -> Drawn:
    """Draw a cell by all solvers that have a result, for a light or a dark page."""
    results = [name for name, each in compared.outcomes.items() if each.status in RESULT_STATUSES]
    lines = lines_of(in_order_of_laws(results), scheme)
    if compared.is_column:
        return _column(compared, compared.problem, lines, scheme)
    return _curves(compared, compared.problem, lines, scheme)


def _curves(compared: Compared, collision: Collision, lines: Mapping[str, Line], scheme: str) -> Drawn:
    curves = impulse_curves(collision, compared.outcomes, _POINTS)
    if not curves:
        return Drawn({"curves": _lines({}, {}), "ends": _points({}, {})}, {}, [])
    ends = {name: (float(x[-1]), float(y[-1])) for name, (x, y) in curves.items()}
    reach = 1.05 * max(float(max(*x, *y)) for x, y in curves.values())
    mu = collision.mass_ratio
    foot, top = mu / (1 + mu), (reach + mu) / (1 + mu)
    l1, l2 = ([foot, top], [0, reach]), ([0, reach], [0, reach])
    compression = compression_lines(scheme)
    xs, ys = zip(*ends.values(), strict=True)
    half = max(0.02, 0.75 * max(max(xs) - min(xs), max(ys) - min(ys)))
    x, y = (min(xs) + max(xs)) / 2, (min(ys) + max(ys)) / 2
    return Drawn(
        {
            "curves": _lines(curves, lines),
            "ends": _points({name: ([x], [y]) for name, (x, y) in ends.items()}, lines),
            "compression": _lines(dict(zip(compression, (l1, l2), strict=True)), compression),
        },
        {
            "curves": (-0.02 * reach, reach, -0.02 * reach, reach),
            "ends": (x - half, x + half, y - half, y + half),
        },
        [],
    )


def _column(compared: Compared, column: Collision, lines: Mapping[str, Line], scheme: str) -> Drawn:
    speed = max(map(abs, column.velocities))
    balls = list(range(1, 1 + len(column.masses)))
    velocities = {name: (balls, [v / speed for v in compared.velocities[name]]) for name in lines}
    values = [y for _, ys in velocities.values() for y in ys] or [0.0]
    margin = 0.06 * max(max(values) - min(values), 0.1)
    forces, times, largest = _forces(compared.outcomes[REFERENCE].path, column, speed, scheme)
    return Drawn(
        {"velocities": _lines(velocities, lines), "balls": _points(velocities, lines), "forces": forces},
        {
            "velocities": (0.5, len(balls) + 0.5, min(values) - margin, max(values) + margin),
            "forces": (0.0, 1.02 * times, 0.0, 1.05 * largest),
        },
        balls[:: max(1, len(balls) // 10)],
    )


def _forces(
    path: Path | None, column: Collision, speed: float, scheme: str
) -> tuple[dict[str, Any], float, float]:
    """Return the forces of every contact over time, and where both axes end."""
    if path is None:
        return _lines({}, {}), 1.0, 1.0
    kept = needed(path.time, path.forces)
    m, k = column.masses[0], column.stiffnesses[0]
    time, forces = path.time[kept] * (k / m) ** 0.5, path.forces[kept] / (speed * (m * k) ** 0.5)
    contacts = range(forces.shape[1])
    lines = {i: Line(_mixed((i + 1) / len(contacts), scheme), [], 2, "") for i in contacts}
    passed = path.impulses[kept].sum(axis=1)
    end = time[min(int((passed < (1 - _TAIL) * passed[-1]).sum()), len(time) - 1)]
    drawn = _lines({i: (time, forces[:, i]) for i in contacts}, lines)
    return drawn, float(end) or 1.0, float(forces.max()) or 1.0


def _chart(name: str, title: str, across: str, up: str) -> Any:
    chart = figure(
        name=name,
        title=title,
        x_axis_label=across,
        y_axis_label=up,
        height=420,
        sizing_mode="stretch_width",
        tools="pan,wheel_zoom,box_zoom,reset,save",
        x_range=Range1d(start=0, end=1, syncable=False),
        y_range=Range1d(start=0, end=1, syncable=False),
        background_fill_color=None,
        border_fill_color=None,
        outline_line_color=None,
        toolbar_location="above",
    )
    chart.toolbar.logo = None
    chart.toolbar.active_drag = None  # a finger on the chart scrolls the page
    chart.axis.axis_label_text_font_style = "normal"
    return chart


def _lines(drawn: Mapping[Any, tuple[Any, Any]], lines: Mapping[Any, Line]) -> dict[str, Any]:
    """Return x and y of each line, and how it is drawn."""
    return {
        "x": [[float(value) for value in x] for x, _ in drawn.values()],
        "y": [[float(value) for value in y] for _, y in drawn.values()],
        "color": [lines[name].color for name in drawn],
        "dash": [lines[name].dash for name in drawn],
        "width": [lines[name].width for name in drawn],
    }


def _points(drawn: Mapping[str, tuple[Any, Any]], lines: Mapping[str, Line]) -> dict[str, Any]:
    """Return the points of all, one after the other, and how they are drawn."""
    each = [lines[name] for name, (x, _) in drawn.items() for _ in x]
    return {
        "x": [value for x, _ in drawn.values() for value in x],
        "y": [value for _, y in drawn.values() for value in y],
        "color": [line.color for line in each],
        "marker": [line.marker for line in each],
    }


def _mixed(share: float, scheme: str) -> str:
    """Return a blue between faint and full, for one contact among many."""
    faint, full = ((190, 215, 235), (0, 60, 115)) if scheme == "light" else ((60, 95, 130), (170, 220, 255))
    return "#" + "".join(f"{round(a + share * (b - a)):02x}" for a, b in zip(faint, full, strict=True))
