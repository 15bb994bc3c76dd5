"""Figures of the ladders: what the mean D is made of, over k2/k1 and over the restitutions."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from impact_xval.experiments.measures.aggregates import Frame
from impact_xval.experiments.measures.ladder import CAUSES
from impact_xval.experiments.measures.ladder_summary import LadderSummary
from impact_xval.experiments.presentation.style import LEFT_OUT, Drawn, drawing, label_places
from impact_xval.experiments.presentation.words import named

#: What is drawn over which axes, of two balls and of columns; and how an axis is labelled.
_STACKS = {
    "ladder-by-stiffness": ("stiffness_ratio",),
    "ladder-by-restitution": ("e1", "e2"),
    "ladder-by-balls": ("balls",),
    "ladder-by-column": ("arrangement", "e"),
}
_LABELS = {
    "stiffness_ratio": "stiffness ratio k2/k1 (-)",
    "e1": "e1, ball on ball (-)",
    "e2": "e2, ball on table (-)",
    "balls": "number of balls N",
    "arrangement": "arrangement",
    "e": "e of every contact (-)",
}

#: Where in a bar the whisker of each cause stands: side by side, those of neighbours would lie on each other.
_WHISKERS = (-0.24, -0.08, 0.08, 0.24)


def draw_ladders(ladder: LadderSummary) -> Iterator[Drawn]:
    """Draw every figure of the ladders; none where no engine has a result."""
    for name, axes in _STACKS.items():
        there = [axis for axis in axes if axis in ladder.axes]
        if there:
            over = " and ".join(_LABELS[axis] for axis in there)
            yield name, _panels(ladder, there), _caption(over, ladder)


def _caption(over: str, ladder: LadderSummary) -> str:
    causes = "dissipation law and gravity" if ladder.orders == "six" else "and dissipation law"
    return (
        f"What the mean velocity divergence D of each engine consists of, over {over}. Line: mean D; bars "
        "below zero: causes that take the engine back towards the model; whiskers: the range over "
        f"{ladder.orders} orders of causes. Each cause is a difference of velocities made by one change on the "
        "way from the model to the engine; drawn is the mean of its component along the whole difference, in the "
        f"kinetic norm. The components of a cell sum to its D. Frozen positions, {causes} can be changed in "
        f"{ladder.orders} orders; a bar is the mean over them, and its whisker reaches from where it ends by the "
        "order that gives least to where by the one that gives most. D = sqrt(sum m_i dv_i^2/sum m_i "
        f"v_i0^2), dimensionless. {LEFT_OUT}"
    )


def _panels(ladder: LadderSummary, axes: Sequence[str]) -> Figure:
    """Draw a panel an axis and engine."""
    solvers = ladder.solvers
    with drawing(max(6.4, 3.6 * len(solvers)), 0.9 + 2.6 * len(axes)) as figure:
        panels = figure.subplots(len(axes), len(solvers), sharey=True, squeeze=False)
        for row, axis in zip(panels, axes, strict=True):
            for ax, solver in zip(row, solvers, strict=True):
                table = ladder.statistics
                some = table[(table.solver == solver) & (table.axis == axis)]
                wide = some.pivot(index="value", columns="contribution")
                label_places(ax.xaxis, wide.index.tolist(), 8)
                ax.tick_params(axis="x", labelsize=8)
                _stack(ax, ladder, wide)
                ax.set(xlabel=_LABELS[axis], title=named(solver))
            row[0].set_ylabel("component of mean D (-)")
        handles = [Patch(color=c.color, label=c.label) for c in ladder.present]
        figure.legend(handles=handles, loc="outside lower center", ncols=min(len(handles), 4))
    return figure


def _stack(ax: Any, ladder: LadderSummary, wide: Frame) -> None:
    """Draw the bars of one engine, those of positive shares above zero, and the mean D."""
    total = wide.total.max(axis=1).to_numpy()
    x, above, below = np.arange(len(wide)), np.zeros(len(wide)), np.zeros(len(wide))
    for c in ladder.present:
        if c.name not in wide.share:
            continue
        part = total * wide.share[c.name].fillna(0).to_numpy()
        bottom = np.where(part >= 0, above, below)
        ax.bar(x, part, 0.8, bottom=bottom, color=c.color, edgecolor="white", linewidth=0.4)
        if c in CAUSES:
            ends = [bottom + total * end[c.name] for end in (wide.low, wide.high)]
            beside = x + _WHISKERS[CAUSES.index(c)]
            ax.vlines(beside, *ends, color="black", linewidth=2.4)
            ax.vlines(beside, *ends, color=c.color, linewidth=1.2)
        above += np.maximum(part, 0)
        below += np.minimum(part, 0)
    between = "none" if isinstance(wide.index[0], str) else "-"
    ax.plot(x, total, color="black", marker="_", markersize=9, linewidth=1, linestyle=between)
    ax.axhline(0, color="0.3", linewidth=0.8)
