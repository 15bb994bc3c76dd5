"""Impulse curves in the plane of the two impulses, with the compression lines l1 and l2."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from impact_xval.experiments.config.experiment import REFERENCE
from impact_xval.experiments.measures.aggregates import Frame
from impact_xval.experiments.presentation.looks import look
from impact_xval.experiments.presentation.style import drawing
from impact_xval.experiments.presentation.words import named

#: Colours of the states along a curve, from the palette of `style`; S4 has no extent.
STATE_LOOKS = {1: ("S1", "#000000"), 2: ("S2", "#0072B2"), 3: ("S3", "#D55E00")}


def draw_cell_curves(cell: Frame, solvers: Sequence[str]) -> Figure:
    """Draw the curves of one collision by every solver, and how far each is from l1 and l2.

    Parameters
    ----------
    cell : DataFrame
        The stored curves of that collision.
    solvers : sequence of str
        In the order of the configuration.
    """
    drawn = [name for name in solvers if name in set(cell.solver)]
    with drawing(9.2, 4.2) as figure:
        whole, detail = figure.subplots(1, 2)
        mass_ratio = float(cell.mass_ratio.iloc[0])
        reach = float(cell[["impulse1", "impulse2"]].to_numpy().max())
        for position, name in enumerate(drawn):
            rows, style = cell[cell.solver == name], look(name, position)
            model = name == REFERENCE
            line = {
                "linestyle": style.dash,
                "linewidth": 2.6 if model else 1.5,
                "alpha": 0.85 if model else 1,
            }
            end = rows[["impulse1", "impulse2"]].iloc[-1]
            for ax in (whole, detail):
                ax.plot(rows.impulse1, rows.impulse2, color=style.color, label=named(name), **line)
                ax.plot(*end, color=style.color, marker=style.marker or "*")
        for ax in (whole, detail):
            compression_lines(ax, mass_ratio, 1.05 * reach)
            impulse_labels(ax)
        whole.legend(loc="upper left")
        ends = cell.groupby("solver")[["impulse1", "impulse2"]].last()
        _frame(detail, ends)
        detail.set_title("where the curves end")
        whole.set_title("whole curves")
    return figure


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
    ax.set_xlabel(r"$I_1\,/\,(m_1 |v_0|)$, ball on ball")
    ax.set_ylabel(r"$I_2\,/\,(m_1 |v_0|)$, ball on table")
    ax.set_aspect("equal", adjustable="box")


def _frame(ax: Any, ends: Frame) -> None:
    """Show a square around the ends of the curves."""
    low, high = ends.min().to_numpy(), ends.max().to_numpy()
    half = max(0.02, 0.75 * float((high - low).max()))
    centre = (low + high) / 2
    ax.set_xlim(centre[0] - half, centre[0] + half)
    ax.set_ylim(centre[1] - half, centre[1] + half)


def segments(state: np.ndarray) -> list[tuple[int, int, int]]:
    """Split a curve where its state changes: (state, start, end) of each segment, ends exclusive."""
    borders = [0, *(np.flatnonzero(np.diff(state)) + 1).tolist(), len(state)]
    return [
        (int(state[start]), start, min(end + 1, len(state))) for start, end in itertools.pairwise(borders)
    ]
