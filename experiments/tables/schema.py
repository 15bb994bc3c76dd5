"""Columns of the tables that a run writes, with their units and meanings.

A row of a table holds the result of one solver in one cell. `measures.layout` chooses the columns of each table.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from impact_xval.experiments.config.experiment import CellKind

#: Name of the type of a column's values. ``floats`` is a list of numbers, ``lists`` a list of such lists.
ColumnType = Literal["int", "float", "text", "bool", "floats", "lists"]

_ARROW_TYPES: dict[ColumnType, pa.DataType] = {
    "int": pa.int64(),
    "float": pa.float64(),
    "text": pa.string(),
    "bool": pa.bool_(),
    "floats": pa.list_(pa.float64()),
    "lists": pa.list_(pa.list_(pa.float64())),
}

#: Placeholder in the name and the meaning of a column that a table has once for every ball or contact. The number of
#: the ball or contact is put in its place.
_NUMBER = "{i}"

#: Kinds of cells whose tables have a column: only pairs, balls in a line (pairs and chains), only graphs, or all kinds.
_PAIRS: tuple[CellKind, ...] = ("pair",)
_LINES: tuple[CellKind, ...] = ("pair", "chain")
_GRAPHS: tuple[CellKind, ...] = ("graph",)
_ALL: tuple[CellKind, ...] = ("pair", "chain", "graph")


@dataclass(frozen=True, slots=True)
class Counts:
    """Number of balls and contacts in the tables of an experiment, and the directions of velocities.

    A column by ball stands for one column per ball. In a contact graph it stands for one column per ball and direction,
    because velocities in a graph have two components, x and z (up).
    """

    balls: int
    contacts: int
    directions: tuple[str, ...] = ("",)

    @property
    def components(self) -> tuple[str, ...]:
        """Names of the components of velocity, ball after ball: 1, 2, ... or, in graphs, 1x, 1z, 2x, ..."""
        return tuple(f"{ball}{x}" for ball in range(1, 1 + self.balls) for x in self.directions)


@dataclass(frozen=True, slots=True)
class Column:
    """Column of a table, or a template of several columns.

    A column by ball or by contact is a template: a table has such a column for every ball or contact.
    `expand_columns` returns these columns.
    """

    #: Name in the table. In a template ``{i}`` stands in place of the number of the ball or contact.
    name: str
    type: ColumnType
    #: Unit of the values; "-" for values without a dimension.
    unit: str
    #: Meaning of the values, in words for a reader of the table. In a template ``{i}`` stands in place of the number.
    meaning: str
    #: Whether the table has the column once, or once for every ball or contact.
    per: Literal["row", "ball", "contact"] = "row"
    #: Kinds of cells whose tables have the column.
    kinds: tuple[CellKind, ...] = _ALL

    def expand(self, counts: Counts) -> tuple[Column, ...]:
        """Return the columns for which this column stands, numbered from 1.

        If the column is no template, it stands only for itself.
        """
        match self.per:
            case "row":
                return (self,)
            case "ball":
                return tuple(map(self._numbered, counts.components))
            case "contact":
                return tuple(self._numbered(str(i)) for i in range(1, 1 + counts.contacts))

    def _numbered(self, i: str) -> Column:
        number = i.rstrip("xz")
        in_words = number if number == i else f"{number} along {i[-1]}"
        return replace(
            self,
            name=self.name.replace(_NUMBER, i),
            meaning=self.meaning.replace(_NUMBER, in_words),
            per="row",
        )

    def field(self) -> pa.Field:
        """Return the column as a field of an Arrow schema, with its unit and meaning as metadata."""
        metadata: dict[str | bytes, str | bytes] = {"unit": self.unit, "meaning": self.meaning}
        return pa.field(self.name, _ARROW_TYPES[self.type], metadata=metadata)


Columns = tuple[Column, ...]

#: Columns with the parameters of a pair, two balls on a table.
PAIR_PARAMETERS: Columns = (
    Column("cell", "int", "-", "number of the cell in the grid, from 0"),
    Column("stiffness_ratio", "float", "-", "k2/k1"),
    Column("mass_ratio", "float", "-", "m2/m1"),
    Column("e1", "float", "-", "restitution, ball on ball"),
    Column("e2", "float", "-", "restitution, ball on table"),
    Column("m1", "float", "kg", "mass of the upper ball B1"),
    Column("m2", "float", "kg", "mass of the lower ball B2"),
    Column("k1", "float", "N/m", "stiffness, ball on ball"),
    Column("k2", "float", "N/m", "stiffness, ball on table"),
    Column("v0", "float", "m/s", "velocity of B1 at first touch; up is positive"),
)
#: Columns with the parameters of a chain, N balls in a line.
CHAIN_PARAMETERS: Columns = (
    Column("cell", "int", "-", "number of the chain in the experiment, from 0"),
    Column("arrangement", "text", "-", "row, cradle, pile or stack"),
    Column("balls", "int", "-", "number of balls, N"),
    Column(
        "strike",
        "int",
        "-",
        "number of balls that strike the others; null unless the arrangement is a cradle",
    ),
    Column("exponent", "float", "-", "exponent p of the contact force F = k delta^p at the depth delta"),
    Column("mass_taper", "float", "-", "mass of each ball over the mass of the ball above it"),
    Column(
        "stiffness_taper",
        "float",
        "-",
        "stiffness of each contact over the stiffness of the contact above it",
    ),
    Column("gap", "float", "m", "gap at first of every contact except the struck contact"),
    Column("e", "float", "-", "restitution of every contact"),
    Column("m1", "float", "kg", "mass of ball 1, at the top"),
    Column("k1", "float", "N/m^p", "stiffness of contact 1"),
    Column("v0", "float", "m/s", "velocity of the balls that strike, at first touch; up is positive"),
)
#: Columns with the parameters of a contact graph. A parameter is null in the rows of graphs that do not have it.
GRAPH_PARAMETERS: Columns = (
    Column("cell", "int", "-", "number of the graph in the experiment, from 0"),
    Column("graph", "text", "-", "bernoulli, corner, bridge or rack"),
    Column(
        "stiffness_ratio",
        "float",
        "-",
        "k2/k1; in a bridge k of contacts with the table over k between balls",
    ),
    Column(
        "angle",
        "float",
        "degrees",
        "angle between the fall and each line of centres; in a corner, between the normals of the walls",
    ),
    Column("mass_ratio", "float", "-", "m2/m1; null unless the graph is a bridge"),
    Column("balls", "int", "-", "number of balls of a rack, without the ball that strikes it"),
    Column("e", "float", "-", "restitution of every contact"),
    Column("m1", "float", "kg", "mass of ball 1"),
    Column("k1", "float", "N/m", "stiffness of contact 1"),
    Column("v0", "float", "m/s", "|v0| is the speed of ball 1 at first touch; in a corner its speed along x"),
)
#: Columns that name the solver of a row and say whether it has a result.
SOLVER_AND_STATUS: Columns = (
    Column("solver", "text", "-", "name of the solver"),
    Column("status", "text", "-", "ok, closed-form, or why there is no result"),
    Column(
        "marked",
        "text",
        "-",
        "why no statistic counts the row: which jump of the model or of the solver's exact law is near, or which "
        "cut-off decides; null if nothing does",
    ),
    Column("reason", "text", "-", "why the status is what it is, in one sentence; null if the status is ok"),
    Column(
        "differences",
        "text",
        "-",
        "settings that an engine uses, as it says, instead of those it was asked for; null if there are none",
    ),
)
#: Column with the distance between an outcome in a symmetric scene and the mirror image of this outcome.
ASYMMETRY = Column(
    "asymmetry",
    "float",
    "-",
    "largest difference between a body's velocity and the mirrored velocity of the body's mirror image, per |v0|; null "
    "where the scene is not symmetric",
    kinds=_GRAPHS,
)
#: Columns with the outcome of the collision.
OUTCOME: Columns = (
    Column("v{i}", "float", "m/s", "velocity of ball {i} when the collision is over", per="ball"),
    Column("impulse{i}", "float", "N s", "total impulse of contact {i}", per="contact"),
    Column(
        "states",
        "text",
        "-",
        "sequence of states, separated by spaces; engines leave out states that last too briefly",
        kinds=_PAIRS,
    ),
    Column(
        "states_compared",
        "text",
        "-",
        "sequence of states that is compared: states that last too briefly are left out for every solver",
        kinds=_PAIRS,
    ),
    Column("n_states", "int", "-", "number of states in the sequence", kinds=_LINES),
    Column(
        "n_events", "int", "-", "number of events, such as the end of a contact's compression", kinds=_LINES
    ),
    Column(
        "grazing_margin",
        "float",
        "-",
        "smallest rate of compression at a turning point over the amplitude of that rate, if at most 0.05, else "
        "infinite; the model's outcome jumps where it is 0",
        kinds=_LINES,
    ),
    Column(
        "retained_energy", "float", "-", "kinetic energy after the collision over the kinetic energy before"
    ),
    Column(
        "retained_momentum",
        "float",
        "-",
        "sum of m_i v_i after the collision over the same sum before; negative if balls that fell on a table leave it "
        "upwards, 1 without a table",
        kinds=_LINES,
    ),
    Column(
        "retained_momentum",
        "float",
        "-",
        "component of the momentum after along the momentum before, over the momentum before; null if a fixed "
        "body takes part",
        kinds=_GRAPHS,
    ),
    ASYMMETRY,
    Column("step", "float", "s", "time step"),
    Column("n_steps", "int", "-", "number of time steps"),
    Column("duration", "float", "s", "time from first touch to the end of the collision"),
    Column(
        "velocity_error",
        "float",
        "-",
        "error that an exact solver states for its velocities, per |v0|; null if there is none but rounding",
    ),
    Column(
        "gravity_number",
        "float",
        "-",
        "g/(|v0| omega1), omega1 = sqrt(k1 (1/m1 + 1/m2)); 0 without gravity",
        kinds=_PAIRS,
    ),
)
#: Columns with the limit of an engine's velocities at a time step of zero, and the error of the limit.
LIMIT: Columns = (
    Column(
        "v{i}_limit",
        "float",
        "-",
        "velocity of ball {i} per |v0|, extrapolated to a time step of 0; engines only",
        per="ball",
    ),
    Column(
        "limit_error",
        "float",
        "-",
        "estimated error of these limits, per |v0|, as a solution with the contacts asked for (naive mapping: "
        "with the engine's own contacts)",
    ),
    Column(
        "limit_distance",
        "float",
        "-",
        "largest distance of these limits, per |v0|, from the exact solver of the law the engine was asked for; null "
        "without that solver, and with the naive mapping",
    ),
    Column(
        "regularisation",
        "float",
        "-",
        "the part of limit_error that no time step removes, because the engine softens its contacts by itself",
    ),
    Column(
        "order",
        "float",
        "-",
        "fitted order: the power of the time step with which velocities approach the limit",
    ),
    Column("finest_step", "float", "s", "shortest time step that was used to find the limit"),
)
#: Columns with the measures of a solver's divergence from the model.
MEASURES: Columns = (
    Column(
        "velocity_divergence",
        "float",
        "-",
        "D = sqrt(sum m_i dv_i^2/sum m_i v_i0^2), v_i0 before the collision",
    ),
    Column("dv{i}", "float", "-", "velocity of ball {i}, solver minus model, per |v0|", per="ball"),
    Column(
        "dimpulse{i}", "float", "-", "impulse of contact {i}, solver minus model, per m1 |v0|", per="contact"
    ),
    Column("largest_dv", "float", "-", "largest |dv_i|"),
    Column(
        "dretained_energy",
        "float",
        "-",
        "retained energy, solver minus model",
    ),
    Column(
        "states_equal",
        "bool",
        "-",
        "whether states_compared and model_states_compared are equal",
        kinds=_PAIRS,
    ),
    Column(
        "states_differ_at",
        "int",
        "-",
        "position, from 1, of the first state that differs between the two; null if they are equal",
        kinds=_PAIRS,
    ),
    Column(
        "states_edit_distance",
        "int",
        "-",
        "least number of insertions, deletions and substitutions that turn one sequence into the other",
        kinds=_PAIRS,
    ),
    Column(
        "impulse_curve_distance",
        "float",
        "-",
        "symmetric Hausdorff distance between the two impulse curves, per m1 |v0|",
        kinds=_PAIRS,
    ),
)
#: Columns with the model's results in the cell to which the row belongs.
MODEL: Columns = (
    Column("model_states", "text", "-", "sequence of states of the state-transition model", kinds=_PAIRS),
    Column(
        "model_states_compared",
        "text",
        "-",
        "states_compared of the state-transition model",
        kinds=_PAIRS,
    ),
    Column("model_status", "text", "-", "status of the state-transition model"),
    Column(
        "model_grazing_margin", "float", "-", "grazing margin of the state-transition model", kinds=_LINES
    ),
)


@dataclass(frozen=True, eq=False)
class TableSpec:
    """Description of a table of a run: its columns, and which columns and rows of the parts it is made from.

    A part is a file with the rows of one chunk of cells.
    """

    columns: Columns
    #: For each column, the name of the column in the parts that holds its values.
    source: tuple[str, ...]
    #: Condition that a row of a part fulfils if the table has this row; None if the table has all rows.
    keep: pc.Expression | None = None
    #: Whether the table is written as a CSV file too.
    csv: bool = True

    @cached_property
    def schema(self) -> pa.Schema:
        """Arrow schema of the table."""
        return arrow_schema(self.columns)

    def select(self, rows: pa.Table) -> pa.Table:
        """Return the table that is made from some rows of parts.

        The table is empty if the parts lack one of its columns. For example, the table ``ladder`` is about engines, and
        is empty in a run without engines.
        """
        if not set(self.source) <= set(rows.column_names):
            return self.schema.empty_table()
        kept = rows if self.keep is None else rows.filter(self.keep)
        return pa.table([kept[name] for name in self.source], schema=self.schema)


@dataclass(frozen=True, slots=True, eq=False)
class Layout:
    """Columns of the tables of an experiment, and of the parts from which the tables are put together."""

    #: Kind of all cells of the experiment: pairs, chains or graphs.
    kind: CellKind
    #: Largest number of balls, and of contacts, that a cell has.
    counts: Counts
    #: Arrow schema of a part, with the columns of all tables. A row holds the result of one solver in one cell.
    part_schema: pa.Schema
    #: Tables by the names of their files without suffix.
    tables: dict[str, TableSpec]

    @property
    def pair(self) -> bool:
        """Whether cells are pairs."""
        return self.kind == "pair"


def expand_columns(columns: Iterable[Column], counts: Counts) -> Columns:
    """Return columns, with each column by ball or by contact replaced by the columns for which it stands."""
    return tuple(single for column in columns for single in column.expand(counts))


def names_of(columns: Iterable[Column]) -> tuple[str, ...]:
    """Return the names of columns."""
    return tuple(column.name for column in columns)


def pick(columns: Iterable[Column], names: Iterable[str]) -> Columns:
    """Return the columns that have the given names, in the order of the names."""
    by_name = {column.name: column for column in columns}
    return tuple(by_name[name] for name in names)


def union(*groups: Iterable[Column]) -> Columns:
    """Return the columns of several groups in sequence. If columns have the same name, only the first is kept."""
    by_name: dict[str, Column] = {}
    for group in groups:
        for column in group:
            by_name.setdefault(column.name, column)
    return tuple(by_name.values())


def arrow_schema(columns: Iterable[Column]) -> pa.Schema:
    """Return the Arrow schema of a table with the given columns."""
    return pa.schema([column.field() for column in columns])


def to_table(columns: Mapping[str, np.ndarray], n: int, schema: pa.Schema) -> pa.Table:
    """Return a table with the given schema, whose columns are arrays of shape (n,) by name.

    NaN, None and an empty text become nulls; a column without an array holds nulls only.
    """
    return pa.table([_to_arrow(columns.get(field.name), n, field.type) for field in schema], schema=schema)


def _to_arrow(values: np.ndarray | None, n: int, type_: pa.DataType) -> pa.Array:
    if values is None:
        return pa.nulls(n, type_)
    if pa.types.is_string(type_):
        return pa.array([text or None for text in values], type_)
    return pa.array(np.asarray(values), type_, from_pandas=True)
