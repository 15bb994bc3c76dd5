"""What a run found, for its templates: the facts of sentences, and the rows of tables."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Any

from impact_xval.compliant_baselines.registry import is_naive, law_of
from impact_xval.experiments.config.axes import AXES
from impact_xval.experiments.config.experiment import REFERENCE
from impact_xval.experiments.measures.aggregates import FULL_PATHS, OWN_LAW, Frame
from impact_xval.experiments.measures.summary import HONEST, SUMMARISED, Summary
from impact_xval.experiments.presentation.ladder_page import ladder_facts, spread
from impact_xval.experiments.tables.numbers import number, percent
from impact_xval.model.collision import RESULT_STATUSES

_CUTS = ("median", "p95", "max")
_SHARES = ("states_equal", FULL_PATHS, OWN_LAW)
_REASONS = 10


@lru_cache(maxsize=1)  # the summary, the report and the terminal ask one after the other
def summary_facts(summary: Summary) -> dict[str, Any]:
    """Collect what ``summary.md.j2`` and the templates that share its macros show.

    Returns
    -------
    dict
        Facts by name, and all of them once more as ``facts``, to be handed to macros.
    """
    statuses = summary.statuses
    facts = {
        "config": summary.config,
        "solvers": summary.solvers,
        "labels": list(AXES.values()),
        "measures": list(SUMMARISED.values()),
        "n_cells": summary.n_cells,
        "n_marked": summary.n_marked,
        "marked_beyond": summary.marked_beyond,
        "compared": [name for name in summary.solvers if _divergence(summary, name).n],
        "unsolved": unsolved(summary),
        "solvers_found": [_found(summary, name) for name in summary.solvers if _divergence(summary, name).n],
        "closest": _closest(summary),
        "ladder": ladder_facts(summary.ladder),
        **estimate_facts(summary.estimates),
        "overall": [
            (law_of(name) or "-", name, label, int(row.n), *(number(row[cut]) for cut in _CUTS))
            for name in summary.solvers
            for measure, label in SUMMARISED.items()
            for row in (summary.get(name, measure),)
        ],
        "short": [_short(summary, name) for name in summary.solvers],
        "most": _most(summary),
        "axes": [_along(summary, axis) for axis in AXES],
        "worst": _worst(summary),
        "laws": [_own_law(summary, name) for name in summary.solvers],
        "paths": _paths(summary),
        "marked": [_marked(summary, name) for name in summary.solvers],
        "status_names": list(statuses),
        "statuses": [(name, *row) for name, row in statuses.iterrows()],
        "reasons": summary.reasons.head(_REASONS).to_numpy().tolist(),
        "n_reasons": len(summary.reasons),
    }
    return facts | {"facts": facts}


def unsolved(summary: Summary) -> list[tuple[str, int, str, str]]:
    """Tell of every solver without a result in some cells how many, of which status, and the most frequent reason."""
    found = []
    for name in (REFERENCE, *summary.solvers):
        some = summary.reasons[
            (summary.reasons.solver == name) & ~summary.reasons.status.isin(RESULT_STATUSES)
        ]
        if len(some):
            counts = some.groupby("status", sort=False).n.sum().items()
            said = ", ".join(f"{n} {status}" for status, n in counts)
            found.append((name, int(some.n.sum()), said, some.reason.iloc[0]))
    return found


def _divergence(summary: Summary, name: str, *where: Any, **which: Any) -> Frame:
    return summary.get(name, "velocity_divergence", *where, **which)


def _found(summary: Summary, name: str) -> dict[str, Any]:
    """How far a solver is from the model."""
    worst = summary.worst[summary.worst.solver == name].iloc[0]
    medians = [
        (value, median)
        for value in summary.levels["stiffness_ratio"].values
        if not math.isnan(median := _divergence(summary, name, "stiffness_ratio", value)["median"])
    ]
    return {
        "solver": name,
        "law": law_of(name) or "-",
        "d": _divergence(summary, name),
        **{
            key: summary.get(name, share)
            for key, share in zip(("equal", "full", "own"), _SHARES, strict=True)
        },
        "worst": worst,
        "where": ", ".join(f"{label} = {number(worst[axis])}" for axis, label in AXES.items()),
        "low": min(medians, key=lambda pair: pair[1]),
        "high": max(medians, key=lambda pair: pair[1]),
    }


def _short(summary: Summary, name: str) -> tuple[str, ...]:
    """How far a solver is from the model, in a row for a terminal."""
    row, statuses = _divergence(summary, name), summary.statuses.loc[name]
    unsolved = int(statuses.sum() - sum(statuses.get(status, 0) for status in RESULT_STATUSES))
    cuts = (number(row[cut]) for cut in _CUTS)
    paths = percent(summary.get(name, "states_equal")["mean"])
    return law_of(name) or "-", name, str(int(row.n)), *cuts, paths, str(unsolved)


def _most(summary: Summary) -> dict[str, list[str]]:
    """Where solvers diverge most from the model: solvers by place."""
    places: dict[str, list[str]] = {}
    for name in summary.solvers:
        if _divergence(summary, name).n:
            places.setdefault(_found(summary, name)["where"], []).append(name)
    return places


def _closest(summary: Summary) -> list[dict[str, Any]]:
    """How far each engine is from the exact solver of the law it was asked for, at the step of the run."""
    return [
        {
            "solver": name,
            "law": law,
            "naive": summary.config.mapping == "naive" or is_naive(name),
            "median": row.median,
            "max": row.max,
            "n": row.n,
            "model": _divergence(summary, name)["median"],
            "limit": False,
        }
        for row in summary.between.itertuples()
        for name, law in ((row.solver, row.other), (row.other, row.solver))
        if law_of(name) == law
    ]


def estimate_facts(estimates: Frame) -> dict[str, Any]:
    """Collect what ``estimates.md.j2`` shows."""
    rows = estimates.to_dict("records")
    return {"honest": number(HONEST), "estimates": rows, "estimate_rows": [_estimate(row) for row in rows]}


def _estimate(row: dict[str, Any]) -> tuple[str, ...]:
    """Make a row of the table of convergence estimates."""
    return (
        row["solver"],
        row["asked"] or "-",
        f"{row['converged']} of {row['n']}",
        number(row["order"], 2),
        *(
            " / ".join(number(row[f"{kind}_{cut}"], 2) for cut in _CUTS)
            for kind in ("step", "error", "asked")
        ),
        number(row["regularisation"], 2),
        percent(row["honest"]),
    )


def _along(summary: Summary, axis: str) -> dict[str, Any]:
    """Tables along one axis: D, a row a value; every measure, a row a value and solver."""
    levels = summary.levels[axis]
    values = spread(levels.values)

    def cuts(name: str, measure: str, value: float) -> str:
        row = summary.get(name, measure, axis, value)
        return " / ".join(number(row[cut], 2) for cut in _CUTS) if row.n else "-"

    return {
        "label": AXES[axis],
        "shown": len(values),
        "total": len(levels.values),
        "binned": levels.edges is not None,
        "divergence": [
            (number(value), *(cuts(name, "velocity_divergence", value) for name in summary.solvers))
            for value in values
        ],
        "measures": [
            (
                number(value),
                name,
                *(cuts(name, measure, value) for measure in SUMMARISED),
                percent(summary.get(name, FULL_PATHS, axis, value)["mean"]),
            )
            for value in values
            for name in summary.solvers
        ],
    }


def _worst(summary: Summary) -> list[tuple[str, ...]]:
    """Tabulate the cells with the largest D, state paths by their digits: S1 S3 S4 is 134."""
    order = summary.worst.solver.map(summary.solvers.index)
    paths = ("model_states_compared", "states_compared")
    return [
        (
            row["solver"],
            *((row[key] or "-").replace("S", "").replace(" ", "") for key in paths),
            row["cell"],
            *(number(row[key]) for key in (*AXES, "velocity_divergence", "dv1", "dv2")),
        )
        for _, row in summary.worst.loc[order.sort_values(kind="stable").index].iterrows()
    ]


def _own_law(summary: Summary, name: str) -> tuple[str, ...]:
    """How often the state path is the model's, and how often that of the exact solver of the same law."""
    shares = [summary.get(name, share) for share in _SHARES]
    law = (shares[-1].n and law_of(name)) or "-"
    return name, law, *(f"{percent(row['mean'])} of {row.n}" if row.n else "-" for row in shares)


def _paths(summary: Summary) -> list[tuple[str, ...]]:
    """Shares of equal state paths by k2/k1."""
    regions: list[tuple[str, tuple[Any, ...]]] = [
        (number(value), ("stiffness_ratio", value))
        for value in spread(summary.levels["stiffness_ratio"].values)
    ]
    return [
        (label, *(percent(summary.get(name, FULL_PATHS, *where)["mean"]) for name in summary.solvers))
        for label, where in [*regions, ("all", ())]
    ]


def _marked(summary: Summary, name: str) -> tuple[str, ...]:
    row = _divergence(summary, name, cells="marked")
    equal = summary.get(name, "states_equal", cells="marked")
    return (
        law_of(name) or "-",
        name,
        str(int(row.n)),
        *(number(row[cut]) for cut in _CUTS),
        percent(equal["mean"]),
    )
