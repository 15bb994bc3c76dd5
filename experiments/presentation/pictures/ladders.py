"""Figures of the ladders: what the mean D is made of, over k2/k1 and over the restitutions, and how large each is."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from impact_xval.experiments.measures.ladder import CAUSES, Contribution
from impact_xval.experiments.measures.ladder_summary import LadderSummary
from impact_xval.experiments.presentation.style import drawing
from impact_xval.experiments.presentation.words import named
from impact_xval.experiments.tables.numbers import number

#: What is drawn over which axes, of two balls and of columns; and how an axis is labelled.
_STACKS = {
    "ladder-by-stiffness": ("stiffness_ratio",),
    "ladder-by-restitution": ("e1", "e2"),
    "ladder-by-balls": ("balls",),
    "ladder-by-column": ("arrangement", "e"),
}
_NORMS = ("stiffness_ratio", "balls")
_LABELS = {
    "stiffness_ratio": "stiffness ratio k2/k1 (-)",
    "e1": "e1, ball on ball (-)",
    "e2": "e2, ball on table (-)",
    "balls": "number of balls N",
    "arrangement": "arrangement",
    "e": "e of every contact (-)",
}

#: Norms below this are drawn at this height on logarithmic axes.
_FLOOR = 1e-7

#: Where in a bar the whisker of each cause stands: side by side, those of neighbours would lie on each other.
_WHISKERS = (-0.24, -0.08, 0.08, 0.24)


def draw_ladders(ladder: LadderSummary) -> Iterator[tuple[str, Figure, str]]:
    """Draw every figure of the ladders: name, figure, caption; none where no engine has a result."""
    for name, axes in _STACKS.items():
        labels = {axis: _LABELS[axis] for axis in axes if axis in ladder.axes}
        if labels:
            yield name, _stacks(ladder, labels), _stacks_caption(" and ".join(labels.values()), ladder.orders)
    for axis in _NORMS:
        if axis in ladder.axes:
            yield (
                "ladder-norms",
                _norms(ladder, axis),
                (
                    "How large each cause of divergence is by itself, whatever its direction: kinetic norm "
                    f"of its difference of velocities, per |v0|, over {_LABELS[axis]}. Line with markers: "
                    "median over all other axes; dotted: 95th percentile. Causes may oppose each other, so "
                    f"norms do not add up to D. Values below {number(_FLOOR)} are drawn there; marked cells "
                    "(beside a jump) are left out."
                ),
            )


def _stacks_caption(over: str, orders: str) -> str:
    causes = "dissipation law and gravity" if orders == "six" else "and dissipation law"
    return (
        f"What the mean velocity divergence D of each engine consists of, over {over}. Line: mean D; bars "
        f"below zero: causes that take the engine back towards the model; whiskers: the range over {orders} "
        "orders of the causes. Each cause is a difference of velocities made by one change on the way from "
        "the model to the engine; drawn is the mean of its component along the whole difference, in the "
        f"kinetic norm. The components of a cell sum to its D. Frozen positions, {causes} can be changed in "
        f"{orders} orders; a bar is the mean over them, and its whisker reaches from where it ends by the "
        "order that gives least to where by the one that gives most. D = sqrt(sum m_i dv_i^2/sum m_i "
        "v_i0^2), dimensionless; marked cells (beside a jump) are left out."
    )


def _columns(ladder: LadderSummary, solver: str, axis: str, column: str) -> tuple[np.ndarray, Any]:
    """Values of an axis, and a table of a statistic by value (index) and contribution (columns)."""
    table = ladder.statistics
    here = table[(table.solver == solver) & (table.axis == axis)]
    wide = here.pivot(index="value", columns="contribution", values=column)
    return wide.index.to_numpy(), wide


def _places(ax: Any, values: np.ndarray) -> np.ndarray:
    """Set evenly spaced places for the values of an axis, labelled with at most eight of them."""
    step = max(1, -(-len(values) // 8))
    labels = [value if isinstance(value, str) else number(value, 2) for value in values[::step]]
    ax.set_xticks(range(0, len(values), step), labels)
    ax.tick_params(axis="x", labelsize=8)
    return np.arange(len(values), dtype=float)


def _legend(figure: Figure, contributions: Sequence[Contribution]) -> None:
    handles = [Patch(color=c.color, label=c.label) for c in contributions]
    figure.legend(handles=handles, loc="outside lower center", ncols=min(len(handles), 4))


def _stacks(ladder: LadderSummary, axes: dict[str, str]) -> Figure:
    solvers = ladder.solvers
    with drawing(max(6.4, 3.6 * len(solvers)), 0.9 + 2.5 * len(axes)) as figure:
        panels = figure.subplots(len(axes), len(solvers), sharey=True, squeeze=False)
        for row, (axis, label) in zip(panels, axes.items(), strict=True):
            for ax, solver in zip(row, solvers, strict=True):
                _stack(ax, ladder, solver, axis)
                ax.set_xlabel(label)
                ax.set_title(named(solver))
            row[0].set_ylabel("component of mean D (-)")
        _legend(figure, ladder.present)
    return figure


def _stack(ax: Any, ladder: LadderSummary, solver: str, axis: str) -> None:
    """Draw the bars of one engine, those of positive shares above zero, and the mean D."""
    values, share = _columns(ladder, solver, axis, "share")
    low, high = (_columns(ladder, solver, axis, end)[1] for end in ("low", "high"))
    total = _columns(ladder, solver, axis, "total")[1].max(axis=1).to_numpy()
    x = _places(ax, values)
    above, below = np.zeros(len(x)), np.zeros(len(x))
    for c in ladder.present:
        if c.name not in share:
            continue
        part = total * share[c.name].fillna(0).to_numpy()
        bottom = np.where(part >= 0, above, below)
        ax.bar(x, part, 0.8, bottom=bottom, color=c.color, edgecolor="white", linewidth=0.4)
        if c in CAUSES:
            ends = [bottom + total * end[c.name] for end in (low, high)]
            beside = x + _WHISKERS[CAUSES.index(c)]
            ax.vlines(beside, *ends, color="black", linewidth=2.4)
            ax.vlines(beside, *ends, color=c.color, linewidth=1.2)
        above += np.maximum(part, 0)
        below += np.minimum(part, 0)
    between = "none" if isinstance(values[0], str) else "-"
    ax.plot(x, total, color="black", marker="_", markersize=9, linewidth=1, linestyle=between)
    ax.axhline(0, color="0.3", linewidth=0.8)


def _norms(ladder: LadderSummary, axis: str) -> Figure:
    solvers = ladder.solvers
    with drawing(max(6.4, 3.6 * len(solvers)), 3.9) as figure:
        panels = figure.subplots(1, len(solvers), sharey=True, squeeze=False)[0]
        for ax, solver in zip(panels, solvers, strict=True):
            values, median = _columns(ladder, solver, axis, "median")
            high = _columns(ladder, solver, axis, "p95")[1]
            x = _places(ax, values)
            for c in ladder.present:
                if c.name in median:
                    ax.plot(x, median[c.name].clip(lower=_FLOOR), color=c.color, marker="o")
                    dotted = {"linewidth": 0.9, "linestyle": ":"}
                    ax.plot(x, high[c.name].clip(lower=_FLOOR), color=c.color, **dotted)
            ax.set_yscale("log")
            ax.set_xlabel(_LABELS[axis])
            ax.set_title(named(solver))
        panels[0].set_ylabel("kinetic norm of the cause (-)")
        _legend(figure, ladder.present)
    return figure
