"""Figures of one collision by several solvers: impulse curves of two balls; velocities and forces of a chain.

The figures need outcomes with paths, or the table of curves of a run. The figures of a run and the option ``--plot`` of
`solve` call this module.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from impact_xval.compliant_baselines.registry import sort_by_law
from impact_xval.experiments.config.axes import AXES
from impact_xval.experiments.config.experiment import REFERENCE, Config
from impact_xval.experiments.measures.hausdorff import LARGEST
from impact_xval.experiments.presentation.pictures.history import TAIL, instant_of_tail
from impact_xval.experiments.presentation.style import Drawn, draw_legend_beside, styled_figure
from impact_xval.experiments.presentation.words import (
    capitalise_first,
    describe_cell,
    describe_chain,
    describe_direction,
    display_name,
    look_of,
)
from impact_xval.experiments.tables.frames import Frame, Record
from impact_xval.experiments.tables.numbers import number
from impact_xval.model.arrays import Floats
from impact_xval.model.collision import Collision
from impact_xval.model.outcome import Outcome
from impact_xval.model.path import Path
from impact_xval.model.status import RESULT_STATUSES

#: Largest number of panels in a row of the figure of forces.
_ACROSS = 4


def draw_cell_curves(curves: Frame, config: Config) -> Iterator[Drawn]:
    """Draw the impulse curves of the one cell that the figures of a run show, by all solvers."""
    followed = curves[curves.impulses.notna()].set_index("solver").impulses
    if followed.empty:
        return
    cell, solvers = config.figure_cell, sort_by_law(followed.index)
    points = {name: np.column_stack(followed[name]) for name in solvers}
    caption = (
        f"Impulse curves of one collision ({describe_cell(cell.model_dump())}): "
        "impulse I2 between ball and table over impulse I1 between the balls, both per m1 |v0|. Compression ends at "
        "the grey lines: l1 for the balls (equal velocities, v1 = v2), and l2 for the lower ball and the table (lower "
        "ball at rest, I1 = I2). Markers show where each curve ends. The right panel enlarges these ends. The key "
        "figure_cell of the experiment chooses the collision, which need not be a cell of the run."
    )
    yield "impulse-curves", _draw_whole_and_ends(points, cell.mass_ratio), caption


def _draw_whole_and_ends(points: Mapping[str, np.ndarray], mass_ratio: float) -> Figure:
    """Draw impulse curves in two panels: whole on the left, and enlarged at their ends on the right."""
    with styled_figure(9.2, 4.2) as figure:
        whole, detail = figure.subplots(1, 2)
        for ax, title in ((whole, "whole curves"), (detail, "where the curves end")):
            for name, curve in points.items():
                _draw_curve(ax, name, *curve.T)
            draw_compression_lines(ax, mass_ratio, 1.05 * max(curve.max() for curve in points.values()))
            label_impulse_axes(ax)
            ax.set_title(title)
        whole.legend(loc="upper left")
        ends = np.array([curve[-1] for curve in points.values()])
        low, high = ends.min(axis=0), ends.max(axis=0)
        zoom_in(detail, (low + high) / 2, max(0.02, 0.75 * float((high - low).max())))
    return figure


def zoom_in(ax: Axes, middle: Floats, half: float) -> None:
    """Limit the axes to a square around a point. The side of the square is twice `half`."""
    x, y = middle
    ax.set(xlim=(x - half, x + half), ylim=(y - half, y + half))


def _draw_curve(ax: Axes, name: str, impulse1: np.ndarray, impulse2: np.ndarray) -> None:
    """Draw an impulse curve and a marker at its end.

    The curve of the model is wide, so that other curves on top of it are visible.
    """
    style, model = look_of(name), name == REFERENCE
    (line,) = ax.plot(impulse1, impulse2, color=style.color, linestyle=style.dash, label=display_name(name))
    line.set(linewidth=2.6 if model else 1.5, alpha=0.85 if model else None)
    ax.plot(impulse1[-1], impulse2[-1], color=style.color, marker=style.marker or "*")


def draw_compression_lines(ax: Axes, mass_ratio: float, reach: float) -> None:
    """Draw the lines at which the compression of a contact ends.

    Impulses are per m1 |v0|, and m2 is per m1. Line l1 (v1 = v2) is -1 + (1 + 1/m2) I1 - I2/m2 = 0. Line l2 (v2 = 0) is
    I1 = I2.
    """
    foot = mass_ratio / (1 + mass_ratio)
    top = (reach + mass_ratio) / (1 + mass_ratio)
    lines = ((foot, top, (6, 3), r"$\ell_1$", (-14, -6)), (0, reach, (2, 2), r"$\ell_2$", (2, -12)))
    for start, end, dash, name, beside in lines:
        ax.plot([start, end], [0, reach], color="0.55", linewidth=1.1, linestyle=(0, dash), zorder=1)
        ax.annotate(
            name,
            (end, reach),
            xytext=beside,
            textcoords="offset points",
            annotation_clip=True,
            color="0.35",
        )


def label_impulse_axes(ax: Axes) -> None:
    """Label the axes of impulse curves, and give both axes the same scale."""
    ax.set_aspect("equal")
    ax.set_xlabel(r"$I_1\,/\,(m_1 |v_0|)$, ball on ball")
    ax.set_ylabel(r"$I_2\,/\,(m_1 |v_0|)$, ball on table")


def drawable_paths(collision: Collision, outcomes: Mapping[str, Outcome]) -> dict[str, Path]:
    """Return the paths that can be drawn, by solver.

    Solvers are sorted by contact law. The model is last, so that it is drawn on top.
    """
    paths = {}
    for name in sorted(sort_by_law(outcomes), key=lambda name: name == REFERENCE):
        path, largest = outcomes[name].path, LARGEST * collision.units.impulse
        solved = outcomes[name].status in RESULT_STATUSES
        if solved and path is not None and np.abs(path.impulses).max() <= largest:
            paths[name] = path
    return paths


def draw_collision(collision: Collision, paths: Mapping[str, Path]) -> Figure:
    """Draw the impulse curve and the velocities of every path of a collision. At least one path is needed."""
    unit = collision.units
    with styled_figure(8.6, 4.2) as figure:
        grid = figure.subplot_mosaic([["curve", "v1"], ["curve", "v2"]], width_ratios=(1.25, 1))
        curve, upper, lower = grid.values()
        lower.sharex(upper)
        for name, path in paths.items():
            style, impulses = look_of(name), path.impulses / unit.impulse
            _draw_curve(curve, name, *impulses.T)
            for ax, velocity in zip((upper, lower), path.velocities.T, strict=True):
                (line,) = ax.plot(impulses.sum(axis=1), velocity / unit.velocity, label=display_name(name))
                line.set(color=style.color, linestyle=style.dash, linewidth=1.5)
        reach = max(path.impulses.max() for path in paths.values()) / unit.impulse
        draw_compression_lines(curve, collision.mass_ratio, 1.05 * reach)
        label_impulse_axes(curve)
        curve.legend(loc="upper left", fontsize=8)
        for ax, label in ((upper, "$v_1\\,/\\,|v_0|$"), (lower, "$v_2\\,/\\,|v_0|$")):
            ax.axhline(0, color="0.45", linewidth=0.8, zorder=1)
            ax.set_ylabel(label)
        upper.tick_params(labelbottom=False)
        lower.set_xlabel(r"$(I_1 + I_2)\,/\,(m_1 |v_0|)$")
    return figure


def collision_caption(collision: Collision, solvers: Iterable[str], scenario: str) -> str:
    """Return the caption of the figure that `draw_collision` draws."""
    return (
        f"One collision by {', '.join(solvers)}: {describe_ratios(collision)}, scenario {scenario}. Left: impulse I2 "
        "between ball and table over impulse I1 between the balls. Compression ends at the lines l1 (v1 = v2) and l2 "
        "(v2 = 0, I1 = I2). Markers show where each curve ends. Right: velocities over the sum of both impulses so "
        "far. This sum takes the place of time, because the model has no time."
    )


def describe_ratios(collision: Collision) -> str:
    """Return the ratios and restitutions of a collision of two balls as text."""
    return describe_cell({axis: getattr(collision, axis) for axis in AXES})


def draw_chain_figures(curves: Frame, config: Config) -> Iterator[Drawn]:
    """Draw the final velocities and the contact forces of the one chain that the figures of a run show."""
    by_solver, followed = curves.set_index("solver").velocities.dropna(), curves[curves.time.notna()]
    if len(by_solver):
        solvers = sort_by_law(by_solver.index)
        direction = capitalise_first(describe_direction(table=config.figure_chain.collision().table))
        caption = (
            "Final velocities of the balls of one chain, per |v0|, with the solvers side by side. "
            f"{direction}. The chain: {describe_chain(config.figure_chain)}."
        )
        yield "velocities", draw_velocities({name: by_solver[name] for name in solvers}), caption
    if len(followed):
        caption = (
            "Wave of forces through one chain: the force of each contact over time since first touch, by all solvers "
            f"that record it ({describe_chain(config.figure_chain)}). Contact 1 is between balls 1 and 2. The unit of "
            "time is (m1/k1 |v0|^(1 - p))^(1/(p + 1)), and the unit of force is m1 |v0| over the unit of time. The "
            "model's time is computed as if balls did not move during the collision (frozen positions). Forces of "
            "engines are means over their time steps. The time axis ends when every solver has passed all but a "
            f"fraction of {number(TAIL)} of its impulses."
        )
        yield "wave", _draw_wave(followed, config), caption


def draw_velocities(drawn: Mapping[str, Sequence[float]]) -> Figure:
    """Draw the final velocities of one chain, per |v0|, with the solvers side by side."""
    balls = np.arange(1, 1 + len(next(iter(drawn.values()))))
    with styled_figure(max(5.0, min(12.0, 1.0 + 0.9 * len(balls))) + 1.6, 3.2) as figure:
        ax = figure.subplots()
        ax.axhline(0, color="black", linewidth=0.8)
        width = 0.8 / len(drawn)
        for position, (name, velocities) in enumerate(drawn.items()):
            place = balls + width * (position + 0.5 - 0.5 * len(drawn))
            ax.bar(place, velocities, width, color=look_of(name).color, label=display_name(name))
        step = max(1, len(balls) // 20)
        ax.set(xticks=balls[::step], xlabel="ball, 1 at the top", ylabel="final velocity / |v0| (-)")
        ax.grid(axis="x", visible=False)
        draw_legend_beside(ax)
    return figure


def _draw_wave(curves: Frame, config: Config) -> Figure:
    """Draw the force of every contact of one chain over time, with one panel per solver."""
    rows = curves.to_dict("records")
    across = len(rows) if len(rows) <= _ACROSS else -(-len(rows) // 2)
    down = -(-len(rows) // across)
    with styled_figure(3.0 * across + 1.2, 0.5 + 2.7 * down) as figure:
        grid = figure.subplots(down, across, sharey=True, sharex=True, squeeze=False)
        axes = grid.ravel()[: len(rows)]
        for ax in grid.ravel()[len(rows) :]:
            ax.set_visible(False)
        for place, (ax, row) in enumerate(zip(axes, rows, strict=True)):
            for contact, forces in enumerate(row["forces"], start=1):
                shade = colormaps["viridis"](0.92 * (contact - 1) / max(1, len(row["forces"]) - 1))
                ax.plot(row["time"], forces, color=shade, label=f"contact {contact}", linewidth=1.2)
            if place + across >= len(rows):  # there is no panel below this panel
                ax.set_xlabel("time / sqrt(m1/k1) (-)" if config.figure_chain.exponent == 1 else "time (-)")
                ax.tick_params(labelbottom=True)
            ax.set_title(display_name(row["solver"]))
        for ax in grid[:, 0]:
            ax.set_ylabel("contact force (-)")
        axes[0].set_xlim(0, 1.05 * max(map(end_of_wave, rows)))  # all panels share this axis
        if len(rows[0]["forces"]) <= 12:
            figure.legend(*axes[0].get_legend_handles_labels(), loc="outside right center")
    return figure


def end_of_wave(row: Record) -> float:
    """Return the instant from which on only the fraction `TAIL` of the impulses of a chain has still to pass."""
    time, total = row["time"], np.sum(np.stack(row["forces"]), axis=0)
    return instant_of_tail(time, np.append(0, np.cumsum(np.diff(time) * 0.5 * (total[1:] + total[:-1]))))
