"""The table of ladders: one row a cell and engine, made from rows of the finished table of cells."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from impact_xval.compliant_baselines.registry import is_engine, law_of
from impact_xval.experiments.config.axes import AXES
from impact_xval.experiments.config.experiment import REFERENCE
from impact_xval.experiments.measures.corners import Corners, corner_marks, corner_names, corners
from impact_xval.experiments.measures.ladder import (
    CAUSES,
    ENGINE,
    NOTHING,
    Contribution,
    Floats,
    Split,
    cancelling,
    contributions_of,
    split,
    weights_of_two,
)
from impact_xval.experiments.tables.schema import COLUMNS
from impact_xval.model.collision import RESULT_STATUSES

LADDER = "ladder.parquet"

#: Status of an engine's result that changes with its step: it has a ladder, which no statistic counts.
UNCONVERGED = "unconverged"

#: Why the last two contributions are one.
NO_LIMIT = "no certified limit dt -> 0 for this cell"

#: Least width of a range, and least share beside the largest, that a sentence mentions.
_WIDE, _MENTIONED = 0.005, 0.02

_PARAMETERS = ("cell", *AXES, "gravity_number", "solver")

_READ = (
    *_PARAMETERS,
    *("status", "marked", "reason", "v0", "v1", "v2", "grazing_margin"),
    *("v1_limit", "v2_limit", "limit_error"),
)


@dataclass(frozen=True, slots=True)
class Ladders:
    """How the ladders of one kind of cells are made.

    Attributes
    ----------
    parameters : tuple of str
        Columns of the table of cells that are those of a table of ladders too.
    read : tuple of str
        Columns of the table of cells that a ladder is made from.
    schema : Schema
        Of a table of ladders.
    rows : callable
        Makes the ladders of whole cells, as `ladder_rows`.
    """

    parameters: tuple[str, ...]
    read: tuple[str, ...]
    schema: pa.Schema
    rows: Callable[[pa.Table], pa.Table]

    def failed(self, cells: pa.Table, status: str, reason: str) -> pa.Table:
        """Make the rows of cells whose ladder could not be made; status and reason of every row."""
        engines, schema = engines_of(cells), self.schema
        known = {name: engines[name] for name in (*self.parameters, "marked", "limit_error")}
        known |= {
            name: pa.array([text] * len(engines)) for name, text in (("status", status), ("reason", reason))
        }
        columns = [known.get(field.name, pa.nulls(len(engines), field.type)) for field in schema]
        return pa.table(columns, schema=schema)


Field = tuple[str, str, str]


def _ladder_schema() -> pa.Schema:
    """Return the schema of ladders of two balls; unit and meaning of each column are in its metadata."""

    def differences(name: str, meaning: str) -> list[Field]:
        return [(f"{name}dv{i}", "float", meaning.format(f"v{i}")) for i in (1, 2)]

    corners_ = [
        (f"{name}_v{i}", "float", f"corner {name.replace('_', ', ')}: final velocity of B{i} per |v0|")
        for name in corner_names().values()
        for i in (1, 2)
    ]
    parameters = [(name, COLUMNS[name][0], COLUMNS[name][2]) for name in _PARAMETERS]
    return schema_of(parameters, contributions_of(), differences, corners_, "six")


def schema_of(
    parameters: Sequence[Field],
    contributions: Sequence[Contribution],
    differences: Callable[[str, str], Iterable[Field]],
    corners: Iterable[Field],
    orders: str,
) -> pa.Schema:
    """Return the schema of a table of ladders.

    Parameters
    ----------
    parameters : sequence of (name, type, meaning)
    contributions : sequence of Contribution
    differences : callable
        Gives the columns of a difference of velocities, for what their names begin with and their meaning.
    corners : iterable of (name, type, meaning)
        What is kept of the corners.
    orders : str
        How many orders of the causes there are.
    """
    types = {
        "int": pa.int64(),
        "float": pa.float64(),
        "text": pa.string(),
        "bool": pa.bool_(),
        "list": pa.list_(pa.float64()),
    }
    fields = [
        *parameters,
        (
            "status",
            "text",
            "ok; unconverged: the engine's result is; or that of the outcome without which there is no ladder",
        ),
        (
            "reason",
            "text",
            "which outcome that is, and why; or why mapping and time step are one contribution",
        ),
        ("marked", "text", COLUMNS["marked"][2]),
        ("model_grazing_margin", "float", "grazing margin of the state-transition model"),
        ("velocity_divergence", "float", "D, the kinetic norm of the difference of velocities"),
        *differences("", "engine minus model, {} per |v0|; the sum of those of the contributions"),
        *(field for c in contributions for field in _fields(c, differences, orders)),
        ("limit_error", "float", "estimated error of the engine's limit dt -> 0"),
        ("dominant", "text", "the contribution with the largest share"),
        ("dominant_by_every_order", "bool", f"whether it has the largest by each of the {orders} orders"),
        ("sentence", "text", "the row in words"),
        *corners,
    ]
    return pa.schema(
        [
            pa.field(name, types[kind], metadata={"unit": "-", "meaning": meaning})
            for name, kind, meaning in fields
        ]
    )


def _fields(c: Contribution, differences: Callable[[str, str], Iterable[Field]], orders: str) -> list[Field]:
    """Columns of one contribution: name, type and meaning."""
    cause = c in CAUSES
    difference = (
        f"{c.label}, mean over the {orders} orders of the causes (Shapley value): {c.before} -> {c.after}"
        if cause
        else f"{c.label}: {c.after} minus {c.before}"
    )
    meanings = {
        "norm": f"kinetic norm of {c.name}'s difference of velocities",
        "share": "component along the whole difference over D; shares of a row sum to 1",
    }
    if cause:
        meanings["share_low"] = f"least share by the {orders} orders of the causes"
        meanings["share_high"] = f"largest share by the {orders} orders of the causes"
    return [
        *differences(f"{c.name}_", f"{difference}; {{}} per |v0|"),
        *((f"{c.name}_{key}", "float", meaning) for key, meaning in meanings.items()),
    ]


LADDER_SCHEMA = _ladder_schema()


def ladder_rows(cells: pa.Table) -> pa.Table:
    """Make the ladders of whole cells.

    Parameters
    ----------
    cells : Table
        Rows of the table of cells, sorted by cell; every cell with its row of the model.

    Returns
    -------
    Table
        One row for each row of an engine, in order.
    """
    engines, model = engines_of(cells), cells.filter(pc.field("solver") == REFERENCE)
    if not len(engines):
        return LADDER_SCHEMA.empty_table()
    return in_groups(laws_of(engines), lambda rows, obeyed: _ladders(engines.take(rows), model, obeyed))


def in_groups(keys: Sequence[Hashable], make: Callable[[NDArray[np.intp], Any], pa.Table]) -> pa.Table:
    """Make a table for the rows of every key, and put their rows in order.

    Parameters
    ----------
    keys : sequence
        Of the rows, at least one.
    make : callable
        Makes the table of rows, for their places and their key.
    """
    places = {key: np.flatnonzero([each == key for each in keys]) for key in dict.fromkeys(keys)}
    tables = [make(rows, key) for key, rows in places.items()]
    if len(tables) == 1:
        return tables[0]
    return pa.concat_tables(tables).take(np.argsort(np.concatenate(list(places.values()))))


def engines_of(cells: pa.Table) -> pa.Table:
    """Return the rows of engines that were asked for the law of an exact solver; others have no ladder."""
    names = cells["solver"].unique().to_pylist()
    laddered = [name for name in names if is_engine(name) and law_of(name) is not None]
    return cells.filter(pc.field("solver").isin(pa.array(laddered, pa.string())))


def laws_of(engines: pa.Table) -> list[str]:
    """Name the law that the engine of each row was asked for."""
    names = engines["solver"].to_pylist()
    laws = {name: law_of(name) or "" for name in set(names)}
    return [laws[name] for name in names]


def _ladders(engines: pa.Table, model: pa.Table, obeyed: str) -> pa.Table:
    """Make the ladders of engines that were asked for one law."""
    # The references know nothing of engines: one answer a cell.
    at = np.searchsorted(model["cell"].to_numpy(), engines["cell"].to_numpy())
    kappa, mu, e1, e2 = (_numbers(model, name) for name in AXES)
    reference, number = _velocities(model, RESULT_STATUSES), _numbers(model, "gravity_number")
    of_cells = corners(reference, (kappa, mu, e1, e2), number, obeyed)
    here, marks = of_cells.take(at), np.full(len(model), "", dtype="U120")
    there = of_cells.reason == ""
    if np.any(there):
        marks[there] = corner_marks([x[there] for x in (kappa, mu, e1, e2)], number[there], obeyed)
    engine = _velocities(engines, (*RESULT_STATUSES, UNCONVERGED))
    limit = np.column_stack([_numbers(engines, "v1_limit"), _numbers(engines, "v2_limit")])
    # A limit that did not converge is none.
    limit[engines["status"].to_numpy(zero_copy_only=False) == UNCONVERGED] = np.nan
    ladders = split(weights_of_two(mu[at]), here, limit, engine)
    columns, numbers = shared_columns(engines, model, at, here, ladders, marks.tolist())
    columns |= {name: engines[name] for name in _PARAMETERS}
    for i in range(2):
        columns[f"dv{i + 1}"] = numbers(ladders.total[:, i])
        for c, vector in zip(ladders.contributions, ladders.vectors, strict=True):
            columns[f"{c.name}_dv{i + 1}"] = numbers(vector[:, i])
        for index, corner in corner_names().items():
            columns[f"{corner}_v{i + 1}"] = numbers(here.velocities[index][:, i])
    return pa.table({name: columns[name] for name in LADDER_SCHEMA.names}, schema=LADDER_SCHEMA)


def _numbers(table: pa.Table, name: str) -> Floats:
    return table[name].to_numpy(zero_copy_only=False).astype(float)


def _velocities(table: pa.Table, statuses: Sequence[str]) -> Floats:
    """v1 and v2 per abs(v0), shape (n, 2); NaN where the status is none of these."""
    there = np.isin(table["status"].to_numpy(zero_copy_only=False), statuses)
    v = (
        np.column_stack([_numbers(table, "v1"), _numbers(table, "v2")])
        / np.abs(_numbers(table, "v0"))[:, None]
    )
    return np.where(there[:, None], v, np.nan)


def _statuses(
    engines: pa.Table, model: pa.Table, at: Any, unanswered: Any, ladders: Split
) -> tuple[list[str], list[str | None]]:
    """Status and reason of every row: the first outcome that is missing, or why two contributions are one."""
    statuses: list[str] = []
    reasons: list[str | None] = []
    names, found = engines["solver"].to_pylist(), engines["status"].to_pylist()
    why, models = engines["reason"].to_pylist(), model["status"].to_pylist()
    joined = ~np.isnan(ladders.norms[ladders.contributions.index(ENGINE)])
    for i, place in enumerate(at.tolist()):
        if found[i] not in RESULT_STATUSES:
            status, reason = found[i], f"{names[i]}: {why[i] or found[i]}"
        elif models[place] not in RESULT_STATUSES:
            status, reason = models[place], f"{REFERENCE}: {models[place]}"
        elif unanswered[i]:
            status, reason = str(unanswered[i]).rpartition(" ")[2], str(unanswered[i])
        else:
            status, reason = "ok", NO_LIMIT if joined[i] else None
        statuses.append(status)
        reasons.append(reason)
    return statuses, reasons


def shared_columns(
    engines: pa.Table, model: pa.Table, at: Any, here: Corners, ladders: Split, marks: list[str]
) -> tuple[dict[str, Any], Callable[[Floats], pa.Array]]:
    """Put the columns together that all ladders have.

    Parameters
    ----------
    engines, model : Table
        Rows of the table of cells.
    at : ndarray of int, shape (n,)
        The row of the model of each row of an engine.
    here : Corners
    ladders : Split
        Of the rows of engines.
    marks : list of str
        Of the rows of the model: which corner jumps beside the cell; empty where none does.

    Returns
    -------
    columns : dict
    numbers : callable
        Makes a column of numbers, shape (n,) or, of lists, (n, N): null where there is no ladder.
    """
    status, reason = _statuses(engines, model, at, here.reason, ladders)
    ok = ~np.isnan(ladders.divergence) & np.isin(status, ("ok", UNCONVERGED))

    def numbers(values: Floats) -> pa.Array:
        if values.ndim == 2:
            known = ok & ~np.isnan(values).any(axis=1)
            return pa.array(
                [row if there else None for row, there in zip(values.tolist(), known, strict=True)]
            )
        return pa.array(values, pa.float64(), mask=~ok | np.isnan(values))

    names = [c.name for c in ladders.contributions]
    first = np.where(ok, ladders.dominant(), -1)
    columns: dict[str, Any] = {
        "limit_error": engines["limit_error"],
        "status": status,
        "reason": reason,
        "marked": [
            "; ".join(each for each in (mark, marks[place]) if each) or None
            for mark, place in zip(engines["marked"].to_pylist(), at.tolist(), strict=True)
        ],
        "model_grazing_margin": pa.array(
            _numbers(model, "grazing_margin")[at], pa.float64(), from_pandas=True
        ),
        "velocity_divergence": numbers(ladders.divergence),
        "dominant": [names[i] if i >= 0 else None for i in first.tolist()],
        "dominant_by_every_order": pa.array(ladders.agreed(), mask=first < 0),
        "sentence": _sentences(engines["solver"].to_pylist(), ladders, ok),
    }
    shares, (low, high) = ladders.shares, ladders.ranges
    for i, name in enumerate(names):
        columns[f"{name}_norm"] = numbers(ladders.norms[i])
        columns[f"{name}_share"] = numbers(shares[i])
        columns[f"{name}_share_low"] = numbers(low[i])
        columns[f"{name}_share_high"] = numbers(high[i])
    return columns, numbers


class Part(NamedTuple):
    """A contribution in a sentence: its phrase, share and norm, and its least and largest share by the orders."""

    phrase: str
    share: float
    norm: float
    low: float
    high: float

    @property
    def percent(self) -> str:
        """The share, with its range where that can be seen."""
        text = f"{100 * self.share:.3g} %"
        return f"{text}, by order {between(self.low, self.high)}" if self.high - self.low >= _WIDE else text


def between(low: float, high: float) -> str:
    """Write a range of shares, in per cent."""
    return f"{100 * low:.3g} to {100 * high:.3g} %"


def _sentences(solvers: list[str], ladders: Split, ok: Any) -> list[str | None]:
    phrases = [c.phrase for c in ladders.contributions]
    shares, (low, high) = ladders.shares, ladders.ranges
    sentences: list[str | None] = []
    agreed = ladders.agreed()
    for i, name in enumerate(solvers):
        columns = (values[:, i].tolist() for values in (shares, ladders.norms, low, high))
        found = [Part(*row) for row in zip(phrases, *columns, strict=True) if not np.isnan(row[2])]
        sentences.append(
            sentence(name, float(ladders.divergence[i]), found, bool(agreed[i])) if ok[i] else None
        )
    return sentences


def sentence(solver: str, divergence: float, parts: Sequence[Part], agreed: bool = True) -> str:
    """Write in words which contribution carries most of a divergence.

    Parameters
    ----------
    solver : str
        Name of the engine.
    divergence : float
        D.
    parts : sequence of Part
        Every contribution there is.
    agreed : bool
        Whether the largest is the same by every order.
    """
    if divergence < NOTHING:
        return f"{solver} ends where the model does (D = {divergence:.1g}): there is nothing to split."
    pair = cancelling([part.share for part in parts])
    if pair is not None:
        one, two = (f"{parts[i].phrase} (norm {parts[i].norm:.3g})" for i in pair)
        return f"{solver} ends D = {divergence:.3g} from the model, where two large causes cancel: {one} and {two}."
    first, *others = sorted(parts, key=lambda part: -part.share)
    sure = first.low if np.isfinite(first.low) else first.share
    how_much = "most of it" if sure > 0.5 else "the largest part of it"
    how_much += "" if agreed else " (another by another order)"
    text = (
        f"{solver} ends D = {divergence:.3g} from the model, {how_much} by {first.phrase} "
        f"({first.percent}, norm {first.norm:.3g})"
    )
    other = max(others, key=lambda part: abs(part.share))
    if other.share <= -_MENTIONED:
        return f"{text}, taken back in part by {other.phrase} ({other.percent}, norm {other.norm:.3g})."
    if other.share >= _MENTIONED:
        return f"{text}, then by {other.phrase} ({other.percent})."
    return f"{text}."


COLLISION_LADDERS = Ladders(_PARAMETERS, _READ, LADDER_SCHEMA, ladder_rows)
