"""Why an engine diverges from the model in a column of N balls: `measures.ladder` with two switches.

There is no gravity. Between the model and the law that the engine was asked for lie the model's law with positions
(bistiffness) and the engine's law with frozen ones. The outcomes are those of the references, exact where contacts are
linear, whether or not a run lists them as solvers; the model's is the run's own row. A ladder is marked where the
bistiffness law grazes, as the model is, and where rounding decides on a corner.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import product
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from impact_xval.compliant_baselines import marks, references
from impact_xval.compliant_baselines.registry import KELVIN_VOIGT
from impact_xval.experiments.config.arrangements import COLUMN_LEGAL, Arranged
from impact_xval.experiments.config.experiment import REFERENCE
from impact_xval.experiments.measures import corners
from impact_xval.experiments.measures.corners import (
    FREE,
    FROZEN,
    MODEL,
    WEIGHTLESS,
    Corners,
    Floats,
    Index,
    corner_names,
)
from impact_xval.experiments.measures.ladder import Split, contributions_of, split
from impact_xval.experiments.measures.ladder_table import (
    UNCONVERGED,
    Field,
    Ladders,
    engines_of,
    in_groups,
    laws_of,
    schema_of,
    shared_columns,
)
from impact_xval.experiments.tables.schema import LINE_COLUMNS
from impact_xval.model.collision import RESULT_STATUSES, Collision, Collisions, Outcome
from impact_xval.model.inputs import GRAZING_THRESHOLD

_PARAMETERS = ("cell", "arrangement", *COLUMN_LEGAL, "solver")
_READ = (
    *_PARAMETERS,
    *("status", "marked", "reason", "m1", "k1", "v0", "velocities", "grazing_margin"),
    *("velocities_limit", "limit_error"),
)

#: Pieces of segments after which a corner is given up, a second of ten balls.
_MAX_STEPS = 100_000


def _column_ladder_schema() -> pa.Schema:
    """Return the Arrow schema of a table of ladders of columns; unit and meaning of each are in its metadata."""

    def differences(name: str, meaning: str) -> list[Field]:
        return [(f"{name}dv", "list", meaning.format("velocities by ball"))]

    kept = [
        field
        for name in corner_names(gravity=False).values()
        for field in (
            (
                f"{name}_v",
                "list",
                f"corner {name.replace('_', ', ')}: final velocities per |v0|, ball 1 first",
            ),
            (f"{name}_along", "float", "component of its difference from the model along dv, as in shares"),
        )
    ]
    parameters = [(name, LINE_COLUMNS[name][0], LINE_COLUMNS[name][2]) for name in _PARAMETERS]
    return schema_of(parameters, contributions_of(gravity=False), differences, kept, "two")


_SCHEMA = _column_ladder_schema()


def column_ladder_rows(cells: pa.Table) -> pa.Table:
    """Make the ladders of whole columns.

    Parameters
    ----------
    cells : Table
        Rows of the table of cells of a run of columns, sorted by cell; every cell with its row of the model.

    Returns
    -------
    Table
        One row for each row of an engine, in order.
    """
    engines, model = engines_of(cells), cells.filter(pc.field("solver") == REFERENCE)
    if not len(engines):
        return _SCHEMA.empty_table()
    alike = list(zip(laws_of(engines), engines["balls"].to_pylist(), strict=True))
    return in_groups(alike, lambda rows, key: _ladders(engines.take(rows), model, key[0]))


def _ladders(engines: pa.Table, model: pa.Table, obeyed: str) -> pa.Table:
    """Make the ladders of engines that were asked for one law, in columns of as many balls."""
    numbers_of_cells, at = np.unique(engines["cell"].to_numpy(), return_inverse=True)
    model = model.take(np.searchsorted(model["cell"].to_numpy(), numbers_of_cells))
    engine, reference = (
        _velocities(engines, (*RESULT_STATUSES, UNCONVERGED)),
        _velocities(model, RESULT_STATUSES),
    )
    solved = np.isin(np.arange(len(model)), at[~np.isnan(engine).any(axis=1)])
    arranged = [_arranged(row) for row in model.select([*_PARAMETERS[1:-1], "m1", "k1", "v0"]).to_pylist()]
    of_cells, marks = column_corners(np.where(solved[:, None], reference, np.nan), arranged, obeyed)
    here = of_cells.take(at)
    weights = np.array([_weights(each.column()) for each in arranged])[at]
    ladders = split(weights, here, _velocities(engines, RESULT_STATUSES, limit=True), engine)
    found, numbers = shared_columns(engines, model, at, here, ladders, marks)
    found |= {name: engines[name] for name in _PARAMETERS} | {"dv": numbers(ladders.total)}
    for c, vector in zip(ladders.contributions, ladders.vectors, strict=True):
        found[f"{c.name}_dv"] = numbers(vector)
    for index, name in corner_names(gravity=False).items():
        found[f"{name}_v"] = numbers(here.velocities[index])
        found[f"{name}_along"] = numbers(_along(weights, here, index, ladders))
    return pa.table({name: found[name] for name in _SCHEMA.names}, schema=_SCHEMA)


def column_corners(
    model: Floats, columns: Sequence[Arranged], obeyed: str = KELVIN_VOIGT
) -> tuple[Corners, list[str]]:
    r"""Compute the corners of columns of N balls.

    Parameters
    ----------
    model : ndarray, shape (n, N)
        Final velocities of the state-transition model per \|v0\|; NaN without a result, and nothing is computed.
    columns : sequence of Arranged, length n
    obeyed : str
        What the engine was asked for.

    Returns
    -------
    corners : Corners
    marks : list of str
        Of each column: empty, or which corner grazes or is decided by rounding.

    Raises
    ------
    ValueError
        For an unknown law.
    """
    laws = corners.laws_of(obeyed)
    velocities = np.full((2, len(laws), 1, *model.shape), np.nan)
    velocities[MODEL] = model
    reasons, marks = [], []
    for i, arranged in enumerate(columns):
        reason = mark = ""
        for index, outcome in () if np.isnan(model[i]).any() else _solved(arranged, laws):
            if outcome.status not in RESULT_STATUSES:
                reason = f"{corners.called(index, laws)}: {outcome.status}"
                break
            velocities[index][i] = np.array(outcome.velocities) / abs(arranged.v0)
            if outcome.grazing_margin is not None and outcome.grazing_margin < GRAZING_THRESHOLD:
                mark = f"ladder: {corners.called(index, laws)} grazes by {outcome.grazing_margin:.2g}"
            elif outcome.marked:
                mark = f"ladder: {corners.called(index, laws)}: {outcome.marked}"
        reasons.append(reason)
        marks.append(mark)
    return Corners(velocities, np.array(reasons, dtype="U80")), marks


def _solved(arranged: Arranged, laws: Sequence[str]) -> Iterator[tuple[Index, Outcome]]:
    """Solve the corners of a column one by one, but for the model."""
    column, weightless = Collisions.of([arranged.column()]), np.zeros(1)
    for positions, law in product((FREE, FROZEN), range(len(laws))):
        index = positions, law, WEIGHTLESS
        if index != MODEL:
            solve = references.law_at(laws[law], frozen=positions == FROZEN, max_steps=_MAX_STEPS)
            found = solve(column, weightless)
            yield index, found.with_marks(marks.marks_of(solve, laws[law], column, found, weightless))[0]


def _arranged(row: dict[str, Any]) -> Arranged:
    """Set the column of a row up."""
    facts = {**row, "m": row["m1"], "k": row["k1"]}
    return Arranged.model_validate({name: facts[name] for name in Arranged.model_fields})


def _weights(column: Collision) -> list[float]:
    """Masses over that of the balls that move at first."""
    moving = [m / column.masses[0] for m, v in zip(column.masses, column.velocities, strict=True) if v]
    return [m / column.masses[0] / sum(moving) for m in column.masses]


def _velocities(table: pa.Table, statuses: Sequence[str], *, limit: bool = False) -> Floats:
    """Velocities per abs(v0), or limits, shape (n, N); NaN where there are none or the status is none of these."""
    rows = table.select(["status", "balls", "v0", "velocities_limit" if limit else "velocities"])
    return np.array(
        [
            np.divide(v, 1.0 if limit else abs(v0))
            if v is not None and status in statuses
            else [np.nan] * balls
            for status, balls, v0, v in zip(
                *(rows[name].to_pylist() for name in rows.schema.names), strict=True
            )
        ]
    )


def _along(weights: Floats, here: Corners, index: Index, ladders: Split) -> Floats:
    """Component of a corner, less the model, along the whole difference."""
    product_ = (weights * (here.velocities[index] - here.model) * ladders.total).sum(axis=1)
    d = ladders.divergence
    return np.divide(product_, d, out=np.zeros_like(d), where=d > 0)


LINE_LADDERS = Ladders(_PARAMETERS, _READ, _SCHEMA, column_ladder_rows)
