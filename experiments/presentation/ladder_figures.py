"""Figures of the ladders: what the mean D is made of, over k2/k1 and over the restitutions, and how large each is."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from impact_xval.experiments.measures.ladder_summary import LadderSummary
from impact_xval.experiments.measures.rungs import CAUSES, RUNGS, Rung
from impact_xval.experiments.presentation.style import drawing
from impact_xval.experiments.tables.numbers import number

#: Norms below this are drawn at this height on logarithmic axes.
_FLOOR = 1e-7

#: Where in a bar the whisker of each cause stands.
_WHISKERS = (-0.24, -0.08, 0.08, 0.24)

_MEANING = (
    "Each cause is a difference of (v1, v2) made by one change on the way from the model to the engine; drawn is the "
    "mean of its component along the whole difference, in the kinetic norm. The components of a cell sum to its D, so "
    "that the bars, those below zero subtracted, sum to the mean D (black line). Below zero: a cause that takes the "
    "engine back towards the model. Whiskers: frozen positions, dissipation law and gravity can be changed in six "
    "orders; a bar is the mean over them, and its whisker reaches from where it ends by the order that gives least to "
    "where by the one that gives most. D = sqrt((m1 dv1^2 + m2 dv2^2)/(m1 v0^2)), dimensionless; marked "
    "cells (beside a jump) are left out."
)


def draw_ladders(ladder: LadderSummary) -> Iterator[tuple[str, Figure, str]]:
    """Draw every figure of the ladders: name, figure, caption; none where no engine has a result."""
    if not ladder.solvers:
        return
    yield "ladder-by-stiffness", *_stacks(ladder, [("stiffness_ratio", "stiffness ratio k2/k1 (-)")])
    restitutions = [("e1", "e1, ball on ball (-)"), ("e2", "e2, ball on table (-)")]
    yield "ladder-by-restitution", *_stacks(ladder, restitutions)
    yield "ladder-norms", *_norms(ladder)


def present(ladder: LadderSummary) -> list[Rung]:
    """Return the rungs that some cell has, in their order."""
    there = set(ladder.statistics.rung)
    return [rung for rung in RUNGS if rung.name in there]


def _columns(ladder: LadderSummary, solver: str, axis: str, column: str) -> tuple[np.ndarray, Any]:
    """Values of an axis, and a table of a statistic by value (index) and rung (columns)."""
    table = ladder.statistics
    here = table[(table.solver == solver) & (table.axis == axis)]
    wide = here.pivot(index="value", columns="rung", values=column)
    return wide.index.to_numpy(dtype=float), wide


def _places(ax: Any, values: np.ndarray) -> np.ndarray:
    """Set evenly spaced places for the values of an axis, labelled with at most eight of them."""
    step = max(1, -(-len(values) // 8))
    ax.set_xticks(range(0, len(values), step), [number(value, 2) for value in values[::step]])
    ax.tick_params(axis="x", labelsize=8)
    return np.arange(len(values), dtype=float)


def _stacks(ladder: LadderSummary, axes: Sequence[tuple[str, str]]) -> tuple[Figure, str]:
    rungs, solvers = present(ladder), ladder.solvers
    with drawing(max(6.4, 3.6 * len(solvers)), 0.9 + 2.5 * len(axes)) as figure:
        panels = figure.subplots(len(axes), len(solvers), sharey=True, squeeze=False)
        for row, (axis, label) in zip(panels, axes, strict=True):
            for ax, solver in zip(row, solvers, strict=True):
                values, share = _columns(ladder, solver, axis, "share")
                total = _columns(ladder, solver, axis, "total")[1].max(axis=1).to_numpy()
                x = _places(ax, values)
                above, below = np.zeros(len(x)), np.zeros(len(x))
                for rung in rungs:
                    part = total * share.get(rung.name, 0 * share.iloc[:, 0]).fillna(0).to_numpy()
                    bottom = np.where(part >= 0, above, below)
                    ax.bar(x, part, 0.8, bottom=bottom, color=rung.color, edgecolor="white", linewidth=0.4)
                    if rung in CAUSES and rung.name in share:
                        ends = [
                            bottom + total * _columns(ladder, solver, axis, end)[1][rung.name]
                            for end in ("low", "high")
                        ]
                        # side by side: those of neighbours would lie on each other
                        beside = x + _WHISKERS[CAUSES.index(rung)]
                        ax.vlines(beside, *ends, color="black", linewidth=2.4)
                        ax.vlines(beside, *ends, color=rung.color, linewidth=1.2)
                    above += np.maximum(part, 0)
                    below += np.minimum(part, 0)
                ax.plot(x, total, color="black", marker="_", markersize=9, linewidth=1)
                ax.axhline(0, color="0.3", linewidth=0.8)
                ax.set_xlabel(label)
                ax.set_title(solver)
            row[0].set_ylabel("component of mean D (-)")
        handles = [Patch(color=rung.color, label=rung.label) for rung in rungs]
        figure.legend(handles=handles, loc="outside lower center", ncols=min(len(handles), 4))
    over = " and ".join(label.partition(" (")[0] for _, label in axes)
    return figure, f"What the mean velocity divergence D of each engine is made of, over {over}. {_MEANING}"


def _norms(ladder: LadderSummary) -> tuple[Figure, str]:
    rungs, solvers = present(ladder), ladder.solvers
    with drawing(max(6.4, 3.6 * len(solvers)), 3.9) as figure:
        panels = figure.subplots(1, len(solvers), sharey=True, squeeze=False)[0]
        for ax, solver in zip(panels, solvers, strict=True):
            values, median = _columns(ladder, solver, "stiffness_ratio", "median")
            high = _columns(ladder, solver, "stiffness_ratio", "p95")[1]
            x = _places(ax, values)
            for rung in rungs:
                if rung.name in median:
                    ax.plot(x, median[rung.name].clip(lower=_FLOOR), color=rung.color, marker="o")
                    ax.plot(
                        x, high[rung.name].clip(lower=_FLOOR), color=rung.color, linewidth=0.9, linestyle=":"
                    )
            ax.set_yscale("log")
            ax.set_xlabel("stiffness ratio k2/k1 (-)")
            ax.set_title(solver)
        panels[0].set_ylabel("kinetic norm of the cause (-)")
        handles = [Patch(color=rung.color, label=rung.label) for rung in rungs]
        figure.legend(handles=handles, loc="outside lower center", ncols=min(len(handles), 4))
    return figure, (
        "How large each cause of divergence is by itself, whatever its direction: kinetic norm of its difference of "
        "(v1, v2), per |v0|, over the stiffness ratio k2/k1. Line with markers: median over mass ratios and "
        "restitutions; dotted: 95th percentile. Causes may oppose each other, so norms do not add up to D. Values "
        f"below {number(_FLOOR)} are drawn there; marked cells (beside a jump) are left out."
    )
