"""Figures of one collision: impulse curves of two balls with the lines l1 and l2; velocities and wave of a chain.

By every solver: of the cell or chain of a run's figures, or of any other.
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
from impact_xval.experiments.presentation.words import describe_cell, describe_chain, display_name, look_of
from impact_xval.experiments.tables.frames import Frame, Record
from impact_xval.experiments.tables.numbers import number
from impact_xval.model.arrays import Floats
from impact_xval.model.collision import Collision
from impact_xval.model.outcome import Outcome
from impact_xval.model.path import Path
from impact_xval.model.status import RESULT_STATUSES

#: Most panels in a row of the figure of the wave.
_ACROSS = 4


def draw_cell_curves(curves: Frame, config: Config) -> Iterator[Drawn]:
    """Draw the impulse curves, by all solvers, of the cell that the figures of a run show."""
    followed = curves[curves.impulses.notna()].set_index("solver").impulses
    if followed.empty:
        return
    cell, solvers = config.figure_cell, sort_by_law(followed.index)
    points = {name: np.column_stack(followed[name]) for name in solvers}
    caption = (
        f"Impulse curves of one collision ({describe_cell(cell.model_dump())}): "
        "ball-table impulse I2 over ball-ball impulse "
        "I1, both per m1 |v0|. Grey lines: compression line l1 (equal velocities, v1 = v2) and l2 "
        "(lower ball at rest, I1 = I2). Markers: where each curve ends; the right panel enlarges "
        "the ends."
    )
    yield "impulse-curves", _draw_whole_and_ends(points, cell.mass_ratio), caption


def _draw_whole_and_ends(points: Mapping[str, np.ndarray], mass_ratio: float) -> Figure:
    """Draw impulse curves by solver in two panels: whole, and enlarged where they end."""
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
    """Limit the axes to a square around a point, of twice the width `half`."""
    x, y = middle
    ax.set(xlim=(x - half, x + half), ylim=(y - half, y + half))


def _draw_curve(ax: Axes, name: str, impulse1: np.ndarray, impulse2: np.ndarray) -> None:
    """Draw an impulse curve and its end; the curve of the model is wide, so that curves on it are seen."""
    style, model = look_of(name), name == REFERENCE
    (line,) = ax.plot(impulse1, impulse2, color=style.color, linestyle=style.dash, label=display_name(name))
    line.set(linewidth=2.6 if model else 1.5, alpha=0.85 if model else None)
    ax.plot(impulse1[-1], impulse2[-1], color=style.color, marker=style.marker or "*")


def draw_compression_lines(ax: Axes, mass_ratio: float, reach: float) -> None:
    """Draw l1: -1 + (1 + 1/m2) I1 - I2/m2 = 0 and l2: I1 = I2, in units of m1 |v0| with m2 per m1."""
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
    """Label the axes of impulse curves and give them one scale."""
    ax.set_aspect("equal")
    ax.set_xlabel(r"$I_1\,/\,(m_1 |v_0|)$, ball on ball")
    ax.set_ylabel(r"$I_2\,/\,(m_1 |v_0|)$, ball on table")


def drawable_paths(collision: Collision, outcomes: Mapping[str, Outcome]) -> dict[str, Path]:
    """Return the paths that can be drawn, by solver in the order of laws; the model is last, to be drawn on top."""
    paths = {}
    for name in sorted(sort_by_law(outcomes), key=lambda name: name == REFERENCE):
        path, largest = outcomes[name].path, LARGEST * collision.units.impulse
        solved = outcomes[name].status in RESULT_STATUSES
        if solved and path is not None and np.abs(path.impulses).max() <= largest:
            paths[name] = path
    return paths


def draw_collision(collision: Collision, paths: Mapping[str, Path]) -> Figure:
    """Draw the impulse curve and the velocities of every path of a collision; there is at least one path."""
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
    """Return the caption of the figure of a collision."""
    return (
        f"One collision by {', '.join(solvers)}: {describe_ratios(collision)}, scenario {scenario}. Left: ball-table "
        "impulse I2 over ball-ball impulse I1, with the compression lines l1 (v1 = v2) and l2 (v2 = 0, I1 "
        "= I2); markers: where each curve ends. Right: velocities over the impulse of both contacts that "
        "has passed, which serves as a clock for all of them, since the model has no time."
    )


def describe_ratios(collision: Collision) -> str:
    """Describe a collision of two balls by its ratios and restitutions."""
    return describe_cell({axis: getattr(collision, axis) for axis in AXES})


def draw_chain_figures(curves: Frame, config: Config) -> Iterator[Drawn]:
    """Draw the final velocities and the forces of the chain that the figures of a run show."""
    by_solver, followed = curves.set_index("solver").velocities.dropna(), curves[curves.time.notna()]
    if len(by_solver):
        solvers = sort_by_law(by_solver.index)
        caption = (
            "Final velocities of one chain, ball by ball and solver beside solver, per |v0|, up is positive: "
        )
        caption += f"{describe_chain(config.figure_chain)}."
        yield "velocities", draw_velocities({name: by_solver[name] for name in solvers}), caption
    if len(followed):
        caption = (
            "The wave through one chain: force of each contact over time since first touch, per m1 "
            "|v0| and the unit of time (m1/k1 |v0|^(1 - p))^(1/(p + 1)), by the solvers that follow it "
            f"({describe_chain(config.figure_chain)}). Contact 1 is between balls 1 and 2; the model's time "
            "is that of positions that stay frozen, forces of engines are means over their steps. The "
            f"time axis ends where all but {number(TAIL)} of the impulses have passed, by every solver."
        )
        yield "wave", _draw_wave(followed, config), caption


def draw_velocities(drawn: Mapping[str, Sequence[float]]) -> Figure:
    """Draw the final velocities of one chain per |v0|, with solvers side by side."""
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
    """Draw the force of every contact of one chain over time, one panel per solver."""
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
            if place + across >= len(rows):  # nothing below it
                ax.set_xlabel("time / sqrt(m1/k1) (-)" if config.figure_chain.exponent == 1 else "time (-)")
                ax.tick_params(labelbottom=True)
            ax.set_title(display_name(row["solver"]))
        for ax in grid[:, 0]:
            ax.set_ylabel("contact force (-)")
        axes[0].set_xlim(0, 1.05 * max(map(end_of_wave, rows)))  # shared
        if len(rows[0]["forces"]) <= 12:
            figure.legend(*axes[0].get_legend_handles_labels(), loc="outside right center")
    return figure


def end_of_wave(row: Record) -> float:
    """Return the instant at which all but `TAIL` of the impulses of a chain has passed."""
    time, total = row["time"], np.sum(np.stack(row["forces"]), axis=0)
    return instant_of_tail(time, np.append(0, np.cumsum(np.diff(time) * 0.5 * (total[1:] + total[:-1]))))
