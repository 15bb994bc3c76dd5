"""What the divergence of the engines is made of, for its templates: the facts of sentences, and the rows of tables."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from impact_xval.experiments.measures.aggregates import Frame
from impact_xval.experiments.measures.ladder import CANCEL, CAUSES, CONTRIBUTIONS, cancelling
from impact_xval.experiments.measures.ladder_summary import LadderSummary
from impact_xval.experiments.tables.numbers import number, percent

#: Longest table along an axis.
_ROWS = 40

_LABELS = {c.name: c.label for c in CONTRIBUTIONS}


def spread(values: Sequence[float]) -> Sequence[float]:
    """Those values of an axis that a table shows: all, or evenly chosen ones of many."""
    return values[:: -(-len(values) // _ROWS)] if values else values


def ladder_facts(ladder: LadderSummary) -> dict[str, Any]:
    """Collect what the macros of ``ladder.md.j2`` show; lists are empty where no engine has a result."""
    present = ladder.present
    regions = {"all": ("all", np.nan), **ladder.regions}
    return {
        "engines": [_found(ladder, solver) for solver in ladder.solvers],
        "present": [
            {"label": c.label, "before": c.before, "after": c.after, "is_cause": c in CAUSES} for c in present
        ],
        "labels": [c.label for c in present],
        "cancel": CANCEL,
        "orders": ladder.orders,
        "joined": any(c.name == "engine" for c in present),
        "shares": [
            (solver, label, int(region.n.max()), *_shares(region, present))
            for solver in ladder.solvers
            for label, where in regions.items()
            if len(region := ladder.region(solver, *where))
        ],
        "norms": [
            (
                solver,
                _LABELS[name],
                int(row.n),
                *(number(row[cut]) for cut in ("mean", "median", "p95", "max")),
                percent(row.dominant),
            )
            for solver in ladder.solvers
            for name, row in ladder.region(solver).iterrows()
        ],
        "axes": [_along(ladder, axis, present) for axis in ladder.axes],
    }


def _found(ladder: LadderSummary, solver: str) -> dict[str, Any]:
    """Which cause carries most of an engine's divergence, and how well that is known."""
    whole = ladder.region(solver)
    first = whole.iloc[0]
    if first.total == 0:  # it ends where the model does
        return {"solver": solver, "total": 0.0}
    bands = [(ladder.region(solver, *where), label) for label, where in ladder.regions.items()]
    largest = [
        (region, str(region.share.idxmax()), label) for region, label in bands if region.share.notna().any()
    ]
    acting = whole[whole["max"] > 0]  # gravity is nowhere in an impact
    return {
        "solver": solver,
        "total": first.total,
        "parts": [
            (share_text(whole, name), _LABELS[name])
            for name in acting.share.abs().sort_values(ascending=False, kind="stable").index
        ],
        "bands": [(_LABELS[name], share_text(region, name), label) for region, name, label in largest],
        "agreed": first.agreed,
        "detour": float((whole["mean"] * whole.n).sum() / whole.n.max() / first.total),
        "doubt": first.doubt,
    }


def share_text(region: Frame, name: str) -> str:
    """Write the share of a contribution to a region with its range; of two large causes that cancel, that they do."""
    if name not in region.index:
        return "-"
    row = region.loc[name]
    pair = cancelling(region.share)
    if pair is not None and name in region.index[list(pair)]:
        return f"cancels (norm {number(row['mean'])})"
    share, low, high = percent(row.share), percent(row.low), percent(row.high)
    return share if low == high else f"{share} ({low.removesuffix(' %')} to {high.removesuffix(' %')})"


def _shares(region: Frame, present: Sequence[Any]) -> list[str]:
    """Mean D of a region, and the share of every contribution."""
    return [number(region.total.iloc[0]), *(share_text(region, c.name) for c in present)]


def _along(ladder: LadderSummary, axis: str, present: Sequence[Any]) -> dict[str, Any]:
    """Tabulate the shares along one axis of the grid."""
    values = sorted(set(ladder.statistics[ladder.statistics.axis == axis].value))
    shown = spread(values)
    return {
        "label": ladder.axes[axis],
        "shown": len(shown),
        "total": len(values),
        "shares": [
            (solver, value if isinstance(value, str) else number(value), *_shares(region, present))
            for solver in ladder.solvers
            for value in shown
            if len(region := ladder.region(solver, axis, value))
        ],
    }
