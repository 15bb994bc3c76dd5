"""The board: what each entrant answered to each case, how far that is from the laws, and how far it moves."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import pandas as pd

from impact_xval.experiments.config.configuration import REFERENCE
from impact_xval.experiments.measures.aggregates import Frame
from impact_xval.experiments.measures.columns.measuring import column_divergence
from impact_xval.experiments.scoreboard.cases import STEPS, USUAL, Case, cases
from impact_xval.experiments.scoreboard.playing import EXACT, LAWS, Answer, Entrant, Part
from impact_xval.model.columns.column import Column

#: What the columns of the board hold. D is sqrt(sum m_i dv_i^2 / sum m_i v_i0^2), energies are over that before.
MEANINGS = {
    "solver": "practice (an engine with settings), or exact law",
    "engine": f"where it comes from; {EXACT}: a law",
    "version": "of the engine's package, or of this project",
    "law": "exact solver of what it is asked for; empty: nothing of a contact reaches it",
    "case": "what is asked",
    "e": "coefficient of restitution of all contacts",
    "status": "of the usual arrangement; without a velocity there is no measure",
    "reason": "of the status",
    "step": "s; none of a law",
    **{f"v{i}": "final velocity of this ball over that of impact, up is positive" for i in range(1, 6)},
    "divergence": "D from the model",
    "law_divergence": "D from the exact solver of what it is asked for",
    "nearest": "exact laws nearest to it; several where they agree",
    "nearest_divergence": "D from them",
    "energy": "kinetic energy that is left",
    "energy_error": "of it, beyond what its law leaves",
    "momentum_error": "change of momentum over sum m_i abs(v_i0); none on a table",
    "spread": "largest D of its answers with a gap, an overlap, another order or elsewhere from the usual one",
    "spread_by": "arrangement that makes the spread",
    "step_spread": "largest D of its answers at half and at twice the step from the usual one",
    "arrangements": "other arrangements that it answered",
    "seconds_per_step": "wall time of a step",
}

#: Laws whose D from an answer differs by less agree on it.
_EQUAL = 1e-9


def board_of(parts: Sequence[Part]) -> Frame:
    """Measure all answers.

    Parameters
    ----------
    parts : sequence of Part
        The exact laws among them.

    Returns
    -------
    DataFrame
        One row an entrant and a case, with the columns of `MEANINGS`.
    """
    exact = {
        (answer.name, answer.case, answer.e): answer.velocities
        for part in parts
        for answer in part.answers
        if answer.name in LAWS and answer.velocities
    }
    rows = []
    for part in parts:
        by_case: dict[tuple[str, str, float], dict[str, Answer]] = {}
        for answer in part.answers:
            by_case.setdefault((answer.name, answer.case, answer.e), {})[answer.arrangement] = answer
        for entrant in part.entrants:
            for case in cases():
                answers = by_case[entrant.name, case.name, case.e]
                laws = {law: v for law in LAWS if (v := exact.get((law, case.name, case.e)))}
                rows.append(_row(entrant, case, answers, laws))
    return pd.DataFrame(rows, columns=list(MEANINGS))


def _row(
    entrant: Entrant, case: Case, answers: Mapping[str, Answer], laws: Mapping[str, Sequence[float]]
) -> dict[str, Any]:
    usual, column = answers[USUAL], case.column
    row: dict[str, Any] = {
        "solver": entrant.name,
        "engine": entrant.engine,
        "version": entrant.version,
        "law": entrant.law,
        "case": case.name,
        "e": case.e,
        "status": usual.status,
        "reason": usual.reason,
        "step": usual.step or math.nan,
        "seconds_per_step": usual.seconds / usual.steps if usual.steps else math.nan,
    }
    if not usual.velocities:
        return row
    speed, mine = abs(column.velocities[0]), usual.velocities
    distances = {law: column_divergence(column, v, mine) for law, v in laws.items()}
    nearest = min(distances.values())
    energy = _energy(column, mine)
    row |= {f"v{i}": v / speed for i, v in enumerate(mine, 1)}
    row |= {
        "divergence": distances.get(REFERENCE, math.nan),
        "law_divergence": distances.get(entrant.law, math.nan),
        "nearest": ", ".join(law for law, d in distances.items() if d <= nearest + _EQUAL),
        "nearest_divergence": nearest,
        "energy": energy,
        "energy_error": energy - _energy(column, laws[entrant.law]) if entrant.law in laws else math.nan,
        "momentum_error": math.nan if column.table else _momentum_error(column, mine),
    }
    return row if entrant.engine == EXACT else row | _spread(column, answers)


def _spread(column: Column, answers: Mapping[str, Answer]) -> dict[str, Any]:
    usual = answers[USUAL].velocities
    moved = {
        name: column_divergence(column, usual, answer.velocities)
        for name, answer in answers.items()
        if name != USUAL and answer.velocities
    }
    found: dict[str, Any] = {"arrangements": len(moved)}
    alike = {name: d for name, d in moved.items() if name not in STEPS}
    if alike:
        found["spread_by"] = max(alike, key=lambda name: alike[name])
        found["spread"] = alike[found["spread_by"]]
    return found | {"step_spread": max((moved[name] for name in STEPS if name in moved), default=math.nan)}


def _energy(column: Column, velocities: Sequence[float]) -> float:
    """Kinetic energy over that before."""
    return _sum(column, (v * v for v in velocities)) / _sum(column, (v * v for v in column.velocities))


def _momentum_error(column: Column, velocities: Sequence[float]) -> float:
    change = (after - before for after, before in zip(velocities, column.velocities, strict=True))
    return _sum(column, change) / _sum(column, map(abs, column.velocities))


def _sum(column: Column, values: Iterable[float]) -> float:
    return math.fsum(m * value for m, value in zip(column.masses, values, strict=True))


def answers_frame(parts: Iterable[Part]) -> Frame:
    """Give every answer of every entrant in every arrangement, velocities per speed of impact, one row each."""
    speeds = {(case.name, case.e): abs(case.column.velocities[0]) for case in cases()}
    rows = [
        {
            "solver": answer.name,
            "case": answer.case,
            "e": answer.e,
            "arrangement": answer.arrangement,
            "status": answer.status,
            "reason": answer.reason,
            **{f"v{i}": v / speeds[answer.case, answer.e] for i, v in enumerate(answer.velocities, 1)},
            "step": answer.step or math.nan,
            "steps": answer.steps,
        }
        for part in parts
        for answer in part.answers
    ]
    names = ["solver", "case", "e", "arrangement", "status", "reason", *VELOCITIES, "step", "steps"]
    return pd.DataFrame(rows, columns=names)


#: Columns of velocities: of the longest case.
VELOCITIES = [name for name in MEANINGS if name[0] == "v" and name[1:].isdigit()]
