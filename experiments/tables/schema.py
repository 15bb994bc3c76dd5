"""Columns of the tables that a run writes, with their units; a row is a cell and a solver."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from impact_xval.experiments.config.experiment import CellKind

#: Type of the values of a column.
ColumnType = Literal["int", "float", "text", "bool", "floats", "lists"]

_ARROW_TYPES: dict[ColumnType, pa.DataType] = {
    "int": pa.int64(),
    "float": pa.float64(),
    "text": pa.string(),
    "bool": pa.bool_(),
    "floats": pa.list_(pa.float64()),
    "lists": pa.list_(pa.list_(pa.float64())),
}

#: Stands for the number of a ball or contact in the name and meaning of a column by ball or by contact.
_NUMBER = "{i}"

#: A column may be in the tables of these kinds of cells only.
_PAIRS: tuple[CellKind, ...] = ("pair",)
_LINES: tuple[CellKind, ...] = ("pair", "chain")
_GRAPHS: tuple[CellKind, ...] = ("graph",)
_ALL: tuple[CellKind, ...] = ("pair", "chain", "graph")


@dataclass(frozen=True, slots=True)
class Counts:
    """How many columns those by ball and by contact stand for.

    A column by ball is one by ball and direction in a graph: its velocities have two components, x and z (up).
    """

    balls: int
    contacts: int
    directions: tuple[str, ...] = ("",)

    @property
    def components(self) -> tuple[str, ...]:
        """Names of the components of velocity, ball after ball: 1, 2, ... or 1x, 1z, 2x, ..."""
        return tuple(f"{ball}{x}" for ball in range(1, 1 + self.balls) for x in self.directions)


@dataclass(frozen=True, slots=True)
class Column:
    """Column of a table.

    A column by ball or by contact stands for as many columns as a cell has balls or contacts: `expand_columns` gives
    them.
    """

    #: Name in the table; of a column by ball or by contact with ``{i}`` in place of the number.
    name: str
    type: ColumnType
    #: Unit of the values; "-" is dimensionless.
    unit: str
    #: Sentence for a reader; with ``{i}`` as in the name.
    meaning: str
    #: Whether the table has the column once, or once for every ball or contact.
    per: Literal["row", "ball", "contact"] = "row"
    #: Kinds of cells whose tables have the column.
    kinds: tuple[CellKind, ...] = _ALL

    def expand(self, counts: Counts) -> tuple[Column, ...]:
        """Return the columns that this one stands for, numbered from 1, in cells of so many balls and contacts."""
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
        """Return the field of an Arrow schema; unit and meaning are its metadata."""
        metadata: dict[str | bytes, str | bytes] = {"unit": self.unit, "meaning": self.meaning}
        return pa.field(self.name, _ARROW_TYPES[self.type], metadata=metadata)


Columns = tuple[Column, ...]

#: Parameters of a pair.
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
#: Parameters of a chain.
CHAIN_PARAMETERS: Columns = (
    Column("cell", "int", "-", "number of the chain in the experiment, from 0"),
    Column("arrangement", "text", "-", "row, cradle, pile or stack"),
    Column("balls", "int", "-", "number of balls, N"),
    Column("strike", "int", "-", "number of balls that strike the others; of a cradle only"),
    Column("exponent", "float", "-", "p of the contacts, F = k delta^p"),
    Column("mass_taper", "float", "-", "mass of every next ball over that of the last one"),
    Column("stiffness_taper", "float", "-", "stiffness of every next contact over that of the last one"),
    Column("gap", "float", "m", "of every contact but the struck one at first"),
    Column("e", "float", "-", "restitution of every contact"),
    Column("m1", "float", "kg", "mass of ball 1, at the top"),
    Column("k1", "float", "N/m^p", "stiffness of contact 1"),
    Column("v0", "float", "m/s", "velocity of what strikes at first touch; up is positive"),
)
#: Parameters of a contact graph; those that a graph does not have are null.
GRAPH_PARAMETERS: Columns = (
    Column("cell", "int", "-", "number of the graph in the experiment, from 0"),
    Column("graph", "text", "-", "bernoulli, corner, bridge or rack"),
    Column("stiffness_ratio", "float", "-", "k2/k1; of a bridge that of the table over that between balls"),
    Column(
        "angle", "float", "degrees", "between the fall and each line of centres, or between normals of walls"
    ),
    Column("mass_ratio", "float", "-", "m2/m1, of a bridge"),
    Column("balls", "int", "-", "balls of a rack, without the one that strikes it"),
    Column("e", "float", "-", "restitution of every contact"),
    Column("m1", "float", "kg", "mass of ball 1"),
    Column("k1", "float", "N/m", "stiffness of contact 1"),
    Column(
        "v0", "float", "m/s", "its size is the speed of ball 1 at first touch; in a corner the speed along x"
    ),
)
#: Solver of a row, and whether it has a result.
SOLVER_AND_STATUS: Columns = (
    Column("solver", "text", "-", "name of the solver"),
    Column("status", "text", "-", "ok, closed-form, or why there is no result"),
    Column(
        "marked",
        "text",
        "-",
        "which jump of the solver's exact law or of the model is so near, or which cut-off, that the row "
        "counts in no statistic; null if none",
    ),
    Column("reason", "text", "-", "one sentence where the status is not ok"),
    Column(
        "differences",
        "text",
        "-",
        "what an engine says it uses instead of what it was asked for; null if nothing",
    ),
)
#: How far an outcome is from its own mirror image.
ASYMMETRY = Column(
    "asymmetry",
    "float",
    "-",
    "largest difference between a velocity and the mirrored one of the body's mirror image, per |v0|; null where the "
    "scene is not symmetric",
    kinds=_GRAPHS,
)
#: Outcome of the collision.
OUTCOME: Columns = (
    Column("v{i}", "float", "m/s", "velocity of ball {i} when the collision is over", per="ball"),
    Column("impulse{i}", "float", "N s", "total impulse of contact {i}", per="contact"),
    Column(
        "states",
        "text",
        "-",
        "state sequence, separated by spaces; an engine's without states held too briefly",
        kinds=_PAIRS,
    ),
    Column(
        "states_compared",
        "text",
        "-",
        "state sequence without states held too briefly, for any solver",
        kinds=_PAIRS,
    ),
    Column("n_states", "int", "-", "length of the state sequence", kinds=_LINES),
    Column("n_events", "int", "-", "number of events", kinds=_LINES),
    Column(
        "grazing_margin",
        "float",
        "-",
        "smallest compression rate at a turning point, per amplitude of that rate, up to 0.05; a jump of "
        "the model is at 0; infinite: none is near",
        kinds=_LINES,
    ),
    Column("retained_energy", "float", "-", "kinetic energy after over before"),
    Column(
        "retained_momentum",
        "float",
        "-",
        "sum of m_i v_i after over that before, up is positive: negative if falling balls leave a table "
        "upwards (before: m1 v0 < 0); 1 without a table",
        kinds=_LINES,
    ),
    Column(
        "retained_momentum",
        "float",
        "-",
        "component along the momentum before of that after, over it; null where a fixed body takes momentum",
        kinds=_GRAPHS,
    ),
    ASYMMETRY,
    Column("step", "float", "s", "time step"),
    Column("n_steps", "int", "-", "number of time steps"),
    Column("duration", "float", "s", "from first touch to the end of the collision"),
    Column(
        "velocity_error",
        "float",
        "-",
        "error of a reference's velocities, per |v0|, as it states it; null if exact",
    ),
    Column(
        "gravity_number",
        "float",
        "-",
        "g/(|v0| omega1), omega1 = sqrt(k1 (1/m1 + 1/m2)); 0 without gravity",
        kinds=_PAIRS,
    ),
)
#: Limit of an engine's velocities at a time step of zero, and its error.
LIMIT: Columns = (
    Column(
        "v{i}_limit",
        "float",
        "-",
        "velocity of ball {i} per |v0|, extrapolated to a step of 0; engines only",
        per="ball",
    ),
    Column(
        "limit_error",
        "float",
        "-",
        "estimated error of these velocities as those of the contacts asked for (naive mapping: of its own)",
    ),
    Column(
        "limit_distance",
        "float",
        "-",
        "their largest distance from the exact solver of the law the engine was asked for; null without "
        "that solver, and with the naive mapping",
    ),
    Column(
        "regularisation",
        "float",
        "-",
        "the part of limit_error that no step removes: the engine's own doing",
    ),
    Column("order", "float", "-", "order in the step with which the velocities approach the limit, fitted"),
    Column("finest_step", "float", "s", "the shortest time step that went into the limit"),
)
#: Measures of the divergence of a solver from the model.
MEASURES: Columns = (
    Column("velocity_divergence", "float", "-", "D = sqrt(sum m_i dv_i^2/sum m_i v_i0^2)"),
    Column("dv{i}", "float", "-", "solver minus model, per |v0|", per="ball"),
    Column("dimpulse{i}", "float", "-", "solver minus model, per m1 |v0|", per="contact"),
    Column("largest_dv", "float", "-", "largest |dv_i|"),
    Column(
        "dretained_energy",
        "float",
        "-",
        "difference of the retained energy fractions, solver minus model",
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
        "position, from 1, of the first state that differs; null if equal",
        kinds=_PAIRS,
    ),
    Column(
        "states_edit_distance",
        "int",
        "-",
        "insertions, deletions and substitutions between the two",
        kinds=_PAIRS,
    ),
    Column(
        "impulse_curve_distance",
        "float",
        "-",
        "symmetric Hausdorff distance of the impulse curves, per m1 |v0|",
        kinds=_PAIRS,
    ),
)
#: Results of the model in the same cell.
MODEL: Columns = (
    Column("model_states", "text", "-", "state sequence of the state-transition model", kinds=_PAIRS),
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
    """A table of a run: its columns, and which columns and rows of the parts it is made of."""

    columns: Columns
    #: For each column the name of the column of a part that holds its values.
    source: tuple[str, ...]
    #: Condition for the rows of a part that the table has; None: all of them.
    keep: pc.Expression | None = None
    #: Whether the table is written as CSV too.
    csv: bool = True

    @cached_property
    def schema(self) -> pa.Schema:
        """Arrow schema of the table."""
        return arrow_schema(self.columns)

    def select(self, rows: pa.Table) -> pa.Table:
        """Select the rows of the table from rows of parts.

        The table is empty where parts lack a column of it: in a run without engines they have no ladders.
        """
        if not set(self.source) <= set(rows.column_names):
            return self.schema.empty_table()
        kept = rows if self.keep is None else rows.filter(self.keep)
        return pa.table([kept[name] for name in self.source], schema=self.schema)


@dataclass(frozen=True, slots=True, eq=False)
class Layout:
    """Columns of the parts and tables of an experiment."""

    #: What every cell is.
    kind: CellKind
    #: Largest numbers of balls and contacts of a cell.
    counts: Counts
    #: Schema of a part, with all columns of all tables: a row is a cell and a solver.
    part_schema: pa.Schema
    #: Tables by their names, without suffix.
    tables: dict[str, TableSpec]

    @property
    def pair(self) -> bool:
        """Whether cells are pairs."""
        return self.kind == "pair"


def expand_columns(columns: Iterable[Column], counts: Counts) -> Columns:
    """Return columns with each column by ball or by contact replaced by the columns that it stands for."""
    return tuple(single for column in columns for single in column.expand(counts))


def names_of(columns: Iterable[Column]) -> tuple[str, ...]:
    """Return the names of columns."""
    return tuple(column.name for column in columns)


def pick(columns: Iterable[Column], names: Iterable[str]) -> Columns:
    """Return the columns of these names, in the order of the names."""
    by_name = {column.name: column for column in columns}
    return tuple(by_name[name] for name in names)


def union(*groups: Iterable[Column]) -> Columns:
    """Return the columns of several groups, each name once, where it comes first."""
    by_name: dict[str, Column] = {}
    for group in groups:
        for column in group:
            by_name.setdefault(column.name, column)
    return tuple(by_name.values())


def arrow_schema(columns: Iterable[Column]) -> pa.Schema:
    """Return the Arrow schema of a table of these columns."""
    return pa.schema([column.field() for column in columns])


def to_table(columns: Mapping[str, np.ndarray], n: int, schema: pa.Schema) -> pa.Table:
    """Make a table from arrays by name, shape (n,).

    NaN, None and an empty text become nulls; a column without an array holds nulls only.
    """
    return pa.table([_to_arrow(columns.get(field.name), n, field.type) for field in schema], schema=schema)


def _to_arrow(values: np.ndarray | None, n: int, type_: pa.DataType) -> pa.Array:
    if values is None:
        return pa.nulls(n, type_)
    if pa.types.is_string(type_):
        return pa.array([text or None for text in values], type_)
    return pa.array(np.asarray(values), type_, from_pandas=True)
