"""Impulse curves, with the compression lines l1 and l2: of the cell of a run's figures, or of any one collision."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from impact_xval.experiments.config.axes import AXES
from impact_xval.experiments.config.experiment import REFERENCE, Config
from impact_xval.experiments.measures.aggregates import Frame
from impact_xval.experiments.measures.hausdorff import LARGEST
from impact_xval.experiments.measures.laws import in_order_of_laws
from impact_xval.experiments.presentation.looks import look
from impact_xval.experiments.presentation.style import Drawn, drawing
from impact_xval.experiments.presentation.words import named
from impact_xval.experiments.tables.numbers import number
from impact_xval.model.collision import RESULT_STATUSES, Collision, Outcome, Path


def draw_cell_curves(curves: Frame, config: Config) -> Iterator[Drawn]:
    """Draw the curves of the cell of a run's figures by every solver, if there are any."""
    followed = curves[curves.impulses.notna()].set_index("solver").impulses
    if followed.empty:
        return
    cell, solvers = config.figure_cell, in_order_of_laws(followed.index)
    points = {name: np.column_stack(followed[name]) for name in solvers}
    values = ", ".join(f"{label} = {number(getattr(cell, axis))}" for axis, label in AXES.items())
    said = (
        f"Impulse curves of one collision ({values}): ball-table impulse I2 over ball-ball impulse "
        "I1, both per m1 |v0|. Grey lines: compression line l1 (equal velocities, v1 = v2) and l2 "
        "(lower ball at rest, I1 = I2). Markers: where each curve ends; the right panel enlarges "
        "the ends."
    )
    yield "impulse-curves", _whole_and_ends(points, cell.mass_ratio), said


def _whole_and_ends(points: Mapping[str, np.ndarray], mass_ratio: float) -> Figure:
    with drawing(9.2, 4.2) as figure:
        whole, detail = figure.subplots(1, 2)
        for ax, title in ((whole, "whole curves"), (detail, "where the curves end")):
            for name, curve in points.items():
                _curve(ax, name, *curve.T)
            compression_lines(ax, mass_ratio, 1.05 * max(curve.max() for curve in points.values()))
            impulse_labels(ax)
            ax.set_title(title)
        whole.legend(loc="upper left")
        ends = np.array([curve[-1] for curve in points.values()])
        low, high = ends.min(axis=0), ends.max(axis=0)
        enlarge(detail, (low + high) / 2, max(0.02, 0.75 * float((high - low).max())))
    return figure


def enlarge(ax: Any, middle: Any, half: float) -> None:
    """Show what is around a point, up to half a width away."""
    x, y = middle
    ax.set(xlim=(x - half, x + half), ylim=(y - half, y + half))


def _curve(ax: Any, name: str, impulse1: np.ndarray, impulse2: np.ndarray) -> None:
    """Draw an impulse curve and where it ends; that of the model is wide, so that others are seen on it."""
    style, model = look(name), name == REFERENCE
    width = {"linewidth": 2.6, "alpha": 0.85} if model else {"linewidth": 1.5}
    ax.plot(impulse1, impulse2, color=style.color, linestyle=style.dash, label=named(name), **width)
    ax.plot(impulse1[-1], impulse2[-1], color=style.color, marker=style.marker or "*")


def compression_lines(ax: Any, mass_ratio: float, reach: float) -> None:
    """Draw l1: -1 + (1 + 1/m2) I1 - I2/m2 = 0 and l2: I1 = I2, in units of m1 |v0| with m2 per m1."""
    foot = mass_ratio / (1 + mass_ratio)
    top = (reach + mass_ratio) / (1 + mass_ratio)
    lines = ((foot, top, (6, 3), r"$\ell_1$", (-14, -6)), (0, reach, (2, 2), r"$\ell_2$", (2, -12)))
    for start, end, dash, name, beside in lines:
        ax.plot([start, end], [0, reach], color="0.55", linewidth=1.1, linestyle=(0, dash), zorder=1)
        where = {"xytext": beside, "textcoords": "offset points", "annotation_clip": True}
        ax.annotate(name, (end, reach), color="0.35", **where)


def impulse_labels(ax: Any) -> None:
    """Label the axes of an impulse curve, of one scale."""
    names = {
        "xlabel": r"$I_1\,/\,(m_1 |v_0|)$, ball on ball",
        "ylabel": r"$I_2\,/\,(m_1 |v_0|)$, ball on table",
    }
    ax.set(aspect="equal", **names)


def drawn_paths(collision: Collision, outcomes: Mapping[str, Outcome]) -> dict[str, Path]:
    """Return the paths that can be drawn, by solver, in the order of laws, the model last so that it is on top."""
    found = {}
    for name in sorted(in_order_of_laws(outcomes), key=lambda name: name == REFERENCE):
        path, largest = outcomes[name].path, LARGEST * collision.units.impulse
        solved = outcomes[name].status in RESULT_STATUSES
        if solved and path is not None and np.abs(path.impulses).max() <= largest:
            found[name] = path
    return found


def draw_collision(collision: Collision, paths: Mapping[str, Path]) -> Figure:
    """Draw the impulse curve and the velocities of every path of a collision, of which there is one at least."""
    unit = collision.units
    with drawing(8.6, 4.2) as figure:
        grid = figure.add_gridspec(2, 2, width_ratios=(1.25, 1))
        curve = figure.add_subplot(grid[:, 0])
        upper = figure.add_subplot(grid[0, 1])
        lower = figure.add_subplot(grid[1, 1], sharex=upper)
        for name, path in paths.items():
            style, impulses = look(name), path.impulses / unit.impulse
            _curve(curve, name, *impulses.T)
            line = {"color": style.color, "linestyle": style.dash, "label": named(name), "linewidth": 1.5}
            for ax, velocity in zip((upper, lower), path.velocities.T, strict=True):
                ax.plot(impulses.sum(axis=1), velocity / unit.velocity, **line)
        reach = max(path.impulses.max() for path in paths.values()) / unit.impulse
        compression_lines(curve, collision.mass_ratio, 1.05 * reach)
        impulse_labels(curve)
        curve.legend(loc="upper left", fontsize=8)
        for ax, label in ((upper, "$v_1\\,/\\,|v_0|$"), (lower, "$v_2\\,/\\,|v_0|$")):
            ax.axhline(0, color="0.45", linewidth=0.8, zorder=1)
            ax.set_ylabel(label)
        upper.tick_params(labelbottom=False)
        lower.set_xlabel(r"$(I_1 + I_2)\,/\,(m_1 |v_0|)$")
    return figure


def caption(collision: Collision, solvers: Iterable[str], scenario: str) -> str:
    """Say what is drawn of a collision."""
    return (
        f"One collision by {', '.join(solvers)}: {at(collision)}, scenario {scenario}. Left: ball-table "
        "impulse I2 over ball-ball impulse I1, with the compression lines l1 (v1 = v2) and l2 (v2 = 0, I1 "
        "= I2); markers: where each curve ends. Right: velocities over the impulse of both contacts that "
        "has passed, which serves as a clock for all of them, since the model has no time."
    )


def at(collision: Collision) -> str:
    """Name a collision of two balls by its ratios and restitutions."""
    values = (collision.stiffness_ratio, collision.mass_ratio, collision.e1, collision.e2)
    return ", ".join(f"{label} = {number(value)}" for label, value in zip(AXES.values(), values, strict=True))
