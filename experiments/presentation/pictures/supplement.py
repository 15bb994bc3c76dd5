"""The three figures of the paper's supplement, drawn again: exact impulse curves and the numbers printed there.

The figures need only the model. The command `figures` calls this module.

The supplement of Jia, Mason and Erdmann (IJRR 32(1), 2013) draws the impulse I2 over the impulse I1, per m1 abs(v0),
with the lines l1 (v1 = v2) and l2 (v2 = 0), at which compression ends. The figures use the parameters (44) of the
paper, which docs/theory.md lists. docs/errata.md says how exact the printed digits of the supplement are.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from impact_xval.experiments.presentation.pictures.curves import (
    draw_compression_lines,
    label_impulse_axes,
    zoom_in,
)
from impact_xval.experiments.presentation.style import Drawn, styled_figure
from impact_xval.experiments.tables.numbers import number
from impact_xval.model import Collision, Outcome, solve

#: Colours of the states along a curve, and the colour of printed numbers. S4 has no colour, because it has no length.
_STATES = {1: "#000000", 2: "#0072B2", 3: "#D55E00"}
_PRINTED = "#AA3377"

#: For each figure: the section of the supplement, and the difference between the printed and the exact velocities, per
#: |v0|. The difference is empty if no velocities are printed.
_FIGURES = {"1": ("3.1", "6e-4"), "2": ("3.2", "5e-3"), "3": ("3.4", "")}


@dataclass(frozen=True, slots=True)
class Panel:
    """One panel of the supplement's figures, with the printed stiffness ratio, final velocities and states.

    `corners` are points (I1, I2) of the curve that the text of the supplement states. `detail` is half the width of the
    window that enlarges the end of the curve; 0 means that there is no window.
    """

    name: str
    ratio: str
    collision: Collision
    velocities: tuple[str, ...]
    states: str
    corners: tuple[tuple[float, float], ...] = ()
    detail: float = 0.0

    def printed_end(self) -> list[tuple[float, float]]:
        """Return the final point (I1, I2) that follows from the printed velocities; empty without printed velocities.

        I1 = 1 + v1 and I2 = I1 + m2 v2, per m1 abs(v0).
        """
        if not self.velocities:
            return []
        v1, v2 = map(float, self.velocities)
        return [(1 + v1, 1 + v1 + self.collision.mass_ratio * v2)]


def _panels() -> tuple[Panel, ...]:
    """Return the six panels of the supplement."""
    # These are the parameters (44) of the main paper. They were inferred from the supplement, at the stiffness ratios
    # of its figures 1(b) and 2(b).
    m2, e1, e2, of = 2 / math.sqrt(3), 0.9, 0.7, Collision.from_ratios
    foot = m2 / (1 + m2)
    corners = ((foot, 0.0), ((1 + e1) * foot, 0.0), ((1 + e1) * foot, e1 * m2))
    of_1b, of_2b = "S1 S3, six times, S1 S2 S4", "ten, the first eight S1 S2 by turns"
    to_l1, to_l2 = "S1 S2 by turns, ever nearer to l1", "S1 S3 by turns, ever nearer to l2"
    return (
        Panel("1a", "\N{INFINITY}", of(math.inf, m2, e1, e2), ("0.9", "0"), "S1 S4", ((1.0, 1.0),)),
        Panel("1b", "40", of(40.0, m2, e1, e2), ("0.88922", "0.00022"), of_1b, detail=0.004),
        Panel("2a", "0", of(0.0, m2, e1, e2), ("0.45203", "0.45203"), "S1 S2 S1 S4", corners),
        Panel("2b", "1/40", of(1 / 40, m2, e1, e2), ("0.4573", "0.44281"), of_2b, detail=0.03),
        Panel("3a", "7/2", of(7 / 2, m2, 0.2, e2), (), to_l1),
        Panel("3b", "2/9", of(2 / 9, 1 / math.sqrt(3), e1, 0.2), (), to_l2),
    )


def draw_supplement_figures() -> Iterator[Drawn]:
    """Draw the three figures of the supplement, each with two panels."""
    for row, (section, apart) in _FIGURES.items():
        panels = [panel for panel in _panels() if panel.name.startswith(row)]
        yield f"supplement-{row}", _draw_panels(panels), _caption(row, section, apart, panels)


def _caption(row: str, section: str, apart: str, panels: list[Panel]) -> str:
    """Return the caption of one figure of the supplement."""
    cells = " ".join(
        f"({panel.name[1]}) k2/k1 = {panel.ratio}, m2/m1 = {number(panel.collision.mass_ratio, 6)}, e1 = "
        f"{number(panel.collision.e1)}, e2 = {number(panel.collision.e2)}."
        for panel in panels
    )
    if not apart:
        said = (
            f"The supplement (section {section}) prints no velocities here. It says that S1 and S2 alternate in (a), "
            "and S1 and S3 in (b), while the curve converges to a line. The exact sequences of states at its stiffness "
            "ratios are below the panels (docs/errata.md)."
        )
    else:
        said = (
            f"Circles are the velocities printed in the supplement (section {section}), as I1 = 1 + v1/|v0| and I2 = "
            "I1 + (m2/m1) v2/|v0|. Dots are the ends of the exact curves. The velocities printed for (b) were computed "
            f"with finite steps of impulse, and differ from the exact velocities by {apart} |v0| (docs/errata.md). The "
            "window enlarges both ends."
        )
    return (
        f"Figure {row} of the supplement of Jia, Mason and Erdmann (2013), drawn again: impulse I2 between ball and "
        "table over impulse I1 between the balls, both per m1 |v0|, by the exact model. Colours are states: S1 (both "
        "contacts active), S2 (ball on table), S3 (ball on ball). Compression ends at the lines l1 (v1 = v2) and l2 "
        f"(v2 = 0, I1 = I2). {cells} {said}"
    )


def _draw_panels(panels: list[Panel]) -> Figure:
    """Draw panels side by side, with the printed and the exact numbers below each panel."""
    with styled_figure(7.2, 4.9) as figure:
        upper, lower = figure.subplots(2, len(panels), height_ratios=(6, 1))
        for ax, below, panel in zip(upper, lower, panels, strict=True):
            outcome = solve(panel.collision, path=True)
            _draw_curve(ax, panel, outcome)
            below.axis("off")
            _write_numbers(below, panel, outcome)
    return figure


def _draw_curve(ax: Axes, panel: Panel, outcome: Outcome) -> None:
    """Draw the exact curve of a panel, with one colour per state, and the printed points."""
    path = outcome.path
    assert path is not None
    i1, i2, end = path.impulse1, path.impulse2, panel.printed_end()
    printed = [*panel.corners, *end]
    reach = 1.06 * max(i1.max(), i2.max(), *(max(point) for point in printed))
    axes = [ax]
    if panel.detail:
        window = ax.inset_axes((0.56, 0.07, 0.4, 0.4))
        middle = np.mean([(outcome.impulse1, outcome.impulse2), *end], axis=0)
        zoom_in(window, middle, panel.detail)
        window.tick_params(labelsize=6, length=2)
        window.locator_params(nbins=3)
        ax.indicate_inset_zoom(window, edgecolor="0.4")
        axes.append(window)
    for window_or_whole in axes:
        for state, color in _STATES.items():
            is_state = path.state == state
            if is_state.any():
                is_state[1:] |= is_state[:-1]  # extend the segment to the point where the next state begins
                window_or_whole.plot(
                    *(np.where(is_state, i, np.nan) for i in (i1, i2)), color=color, label=f"S{state}"
                )
        window_or_whole.plot(
            outcome.impulse1, outcome.impulse2, "o", color="black", markersize=4, label="exact end"
        )
        if printed:
            (marks,) = window_or_whole.plot(
                *np.transpose(printed), "o", color=_PRINTED, label="printed", fillstyle="none"
            )
            marks.set(markersize=9, markeredgewidth=1.3)
        draw_compression_lines(window_or_whole, panel.collision.mass_ratio, reach)
    ax.set(xlim=(-0.04 * reach, reach), ylim=(-0.04 * reach, reach))
    label_impulse_axes(ax)
    ax.set_title(f"({panel.name[1]}) k2/k1 = {panel.ratio}")
    ax.legend(loc="upper left", fontsize=8)


def _write_numbers(ax: Axes, panel: Panel, outcome: Outcome) -> None:
    """Write the exact numbers below the printed numbers."""
    rows = [
        ("", "v1/|v0|", "v2/|v0|", "states"),
        ("printed", *(panel.velocities or ("none", "none")), panel.states),
        ("exact", f"{outcome.v1:.6f}", f"{outcome.v2:.6f}", " ".join(outcome.states)),
    ]
    for line, row in enumerate(rows):
        color = _PRINTED if line == 1 else "black"
        for place, text in zip((-0.12, 0.06, 0.25, 0.44), row, strict=True):
            at = place, 1.1 - 0.4 * line
            ax.text(*at, text, transform=ax.transAxes, fontsize=7.5, color=color, va="top")
