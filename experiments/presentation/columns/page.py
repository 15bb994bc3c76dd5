"""What a run of columns found, for its templates: the facts of sentences, and the rows of tables."""

from __future__ import annotations

from typing import Any

from impact_xval.compliant_baselines.registry import law_of
from impact_xval.experiments.config.arrangements import COLUMN_AXES
from impact_xval.experiments.measures.summary import SUMMARISED_OF_COLUMNS as SUMMARISED
from impact_xval.experiments.measures.summary import Summary
from impact_xval.experiments.presentation.ladder_page import ladder_facts, spread
from impact_xval.experiments.tables.numbers import number, percent

_CUTS = ("median", "p95", "max")
_REASONS = 10


def column_facts(summary: Summary) -> dict[str, Any]:
    """Collect what ``columns.md.j2`` and the templates that share its macros show.

    Returns
    -------
    dict
        Facts by name, and all of them once more as ``facts``, to be handed to macros.
    """
    statuses = summary.statuses
    facts = {
        "config": summary.config,
        "solvers": summary.solvers,
        "n_cells": summary.n_cells,
        "n_marked": summary.n_marked,
        "marked_beyond": summary.marked_beyond,
        "found": [
            _found(summary, name) for name in summary.solvers if summary.get(name, "velocity_divergence").n
        ],
        "engines": (engines := _engines(summary)),
        "engine_rows": _engine_rows(engines),
        "overall": [
            (law_of(name) or "-", name, label, str(row.n), *(number(row[cut]) for cut in _CUTS))
            for name in summary.solvers
            for measure, label in SUMMARISED.items()
            if (row := summary.get(name, measure)).n
        ],
        "short": [_short(summary, name) for name in summary.solvers],
        "by_balls": [
            (law_of(name) or "-", name, *(_median(summary, name, "balls", n) for n in _balls(summary)))
            for name in summary.solvers
        ],
        "balls": [f"N = {n}" for n in _balls(summary)],
        "ladder": ladder_facts(summary.ladder),
        "axes": [_along(summary, axis, values) for axis, values in summary.axes.items()],
        "worst": _worst(summary),
        "status_names": list(statuses),
        "statuses": [(name, *map(str, row)) for name, row in statuses.iterrows()],
        "reasons": summary.reasons.head(_REASONS).astype(str).to_numpy().tolist(),
        "n_reasons": len(summary.reasons),
    }
    return facts | {"facts": facts}


def _balls(summary: Summary) -> list[int]:
    """Numbers of balls, those that a table has room for."""
    return [int(n) for n in spread(summary.levels["balls"].values)]


def _median(summary: Summary, name: str, axis: str, value: Any) -> str:
    return number(summary.get(name, "velocity_divergence", axis, value)["median"])


def _found(summary: Summary, name: str) -> dict[str, Any]:
    """How far a solver is from the model."""
    worst = summary.worst[summary.worst.solver == name].iloc[0]
    balls = _balls(summary)
    return {
        "solver": name,
        "d": summary.get(name, "velocity_divergence"),
        "where": _where(summary, worst),
        "few": (balls[0], _median(summary, name, "balls", balls[0])),
        "many": (balls[-1], _median(summary, name, "balls", balls[-1])),
    }


def _where(summary: Summary, row: Any) -> str:
    """Name a column by its balls and the values of those axes that have several."""
    strike = f", {row.strike:g} striking" if row.arrangement == "cradle" else ""
    axes = [axis for axis in summary.axes if axis not in ("arrangement", "balls", "strike")]
    return f"the {row.arrangement} of {row.balls} balls{strike}" + "".join(
        f", {COLUMN_AXES[axis]} = {number(row[axis])}" for axis in axes
    )


def _short(summary: Summary, name: str) -> tuple[str, ...]:
    """How far a solver is from the model, in a row for a terminal; not compared: one of the two has no result."""
    row, marked = (summary.get(name, "velocity_divergence", cells=cells) for cells in ("regular", "marked"))
    not_compared = summary.n_cells - row.n - marked.n
    by_balls = (_median(summary, name, "balls", n) for n in _balls(summary))
    return (
        law_of(name) or "-",
        name,
        str(row.n),
        *(number(row[cut]) for cut in _CUTS),
        *by_balls,
        str(not_compared),
    )


def _along(summary: Summary, axis: str, values: list[Any]) -> dict[str, Any]:
    """D along one axis, a row a value."""

    def cuts(name: str, value: Any) -> str:
        row = summary.get(name, "velocity_divergence", axis, value)
        return " / ".join(number(row[cut], 2) for cut in _CUTS) if row.n else "-"

    shown = values if axis == "arrangement" else spread(values)
    return {
        "label": COLUMN_AXES[axis],
        "shown": len(shown),
        "total": len(values),
        "rows": [
            (
                value if isinstance(value, str) else number(value),
                *(cuts(name, value) for name in summary.solvers),
            )
            for value in shown
        ],
    }


def _worst(summary: Summary) -> list[tuple[str, ...]]:
    order = summary.worst.solver.map(summary.solvers.index)
    rows = summary.worst.loc[order.sort_values(kind="stable").index]
    return [
        (
            row.solver,
            row.arrangement,
            str(row.cell),
            *(number(row[axis]) for axis in COLUMN_AXES if axis != "arrangement"),
            number(row.velocity_divergence),
            number(row.largest_dv),
        )
        for _, row in rows.iterrows()
    ]


def _engines(summary: Summary) -> list[dict[str, Any]]:
    """Engines beside the exact solver of their law, by the limits dt -> 0 of columns that are not marked."""
    if not len(summary.estimates):
        return []
    held = summary.estimates[summary.estimates.held > 0].set_index("solver")
    return [
        {
            "solver": name,
            "law": row.asked,
            "n": row.held,
            "median": row.asked_median,
            "max": row.asked_max,
            "error": row.error_median,
            "within": row.within,
            "within3": row.honest,
        }
        for name, row in held.reindex([name for name in summary.solvers if name in held.index]).iterrows()
    ]


def _engine_rows(engines: list[dict[str, Any]]) -> list[tuple[str, ...]]:
    """Make the table of engines beside the exact solver of their law."""
    return [
        (
            row["solver"],
            row["law"],
            str(row["n"]),
            *(number(row[key], 2) for key in ("median", "max", "error")),
            percent(row["within"]),
            percent(row["within3"]),
        )
        for row in engines
    ]
