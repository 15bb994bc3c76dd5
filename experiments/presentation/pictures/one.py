"""One collision by several solvers: impulse curves, and velocities over the impulse that has passed."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure

from impact_xval.experiments.config.axes import AXES
from impact_xval.experiments.config.experiment import REFERENCE
from impact_xval.experiments.measures.hausdorff import LARGEST
from impact_xval.experiments.measures.laws import in_order_of_laws
from impact_xval.experiments.presentation.looks import look
from impact_xval.experiments.presentation.pictures.curves import compression_lines, impulse_labels
from impact_xval.experiments.presentation.style import drawing
from impact_xval.experiments.presentation.words import one_vote
from impact_xval.experiments.tables.numbers import number
from impact_xval.model.collision import RESULT_STATUSES, Collision, Outcome, Path


@dataclass(frozen=True, slots=True)
class Drawn:
    """A path, per abs(v0) and m1 abs(v0): arrays of shape (n,)."""

    impulse1: np.ndarray
    impulse2: np.ndarray
    v1: np.ndarray
    v2: np.ndarray


def drawn_paths(collision: Collision, outcomes: Mapping[str, Outcome]) -> dict[str, Drawn]:
    """Return the paths that can be drawn, by solver, in the order of laws, the model last so that it is on top."""
    found = {}
    for name in sorted(in_order_of_laws(outcomes), key=lambda name: name == REFERENCE):
        outcome = outcomes[name]
        if outcome.status in RESULT_STATUSES and outcome.path is not None:
            path = _scaled(collision, outcome.path)
            if max(np.abs(path.impulse1).max(), np.abs(path.impulse2).max()) <= LARGEST:
                found[name] = path
    return found


def _scaled(collision: Collision, path: Path) -> Drawn:
    unit = collision.units
    impulses = path.impulse1 / unit.impulse, path.impulse2 / unit.impulse
    return Drawn(*impulses, path.v1 / unit.velocity, path.v2 / unit.velocity)


def draw_collision(collision: Collision, paths: Mapping[str, Drawn]) -> Figure:
    """Draw the impulse curve and the velocities of every path.

    Parameters
    ----------
    collision : Collision
    paths : mapping of str to Drawn
        By solver, at least one.
    """
    with drawing(8.6, 4.2) as figure:
        grid = figure.add_gridspec(2, 2, width_ratios=(1.25, 1))
        curve = figure.add_subplot(grid[:, 0])
        upper = figure.add_subplot(grid[0, 1])
        lower = figure.add_subplot(grid[1, 1], sharex=upper)
        for position, (name, path) in enumerate(paths.items()):
            style = look(name, position)
            line = {"color": style.color, "linestyle": style.dash, "label": name, "linewidth": 1.5}
            curve.plot(path.impulse1, path.impulse2, **line)
            curve.plot(path.impulse1[-1], path.impulse2[-1], color=style.color, marker=style.marker or "*")
            passed = path.impulse1 + path.impulse2
            upper.plot(passed, path.v1, **line)
            lower.plot(passed, path.v2, **line)
        reach = 1.05 * max(max(path.impulse1.max(), path.impulse2.max()) for path in paths.values())
        compression_lines(curve, collision.mass_ratio, reach)
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
        "has passed, which serves as a clock for all of them, since the model has no time. "
        f"{one_vote(solvers)}"
    ).strip()


def at(collision: Collision) -> str:
    """Name a collision of two balls by its ratios and restitutions."""
    values = (collision.stiffness_ratio, collision.mass_ratio, collision.e1, collision.e2)
    return ", ".join(f"{label} = {number(value)}" for label, value in zip(AXES.values(), values, strict=True))
