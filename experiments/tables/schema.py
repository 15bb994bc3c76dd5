"""Columns of the tables a run writes, with their units: a row is a cell and a solver, of two balls or of N."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

_TYPES = {"int": pa.int64(), "float": pa.float64(), "text": pa.string(), "bool": pa.bool_()}
_TYPES |= {"floats": pa.list_(pa.float64()), "lists": pa.list_(pa.list_(pa.float64()))}

#: Type, unit ("-" is dimensionless) and meaning of a column.
Column = tuple[str, str, str]


def columns(text: str) -> dict[str, Column]:
    """Read a list of columns: name, type, unit and meaning, two spaces between them."""
    lines = (line.strip() for line in text.splitlines() if line.strip())
    rows = (re.split(r"\s{2,}", line, maxsplit=3) for line in lines)
    return {name: (kind, unit, " ".join(meaning.split())) for name, kind, unit, meaning in rows}


#: Of cells of two balls on a table.
PAIR = columns(
    """
    cell             int    -    number of the cell in the grid, from 0
    stiffness_ratio  float  -    k2/k1
    mass_ratio       float  -    m2/m1
    e1               float  -    restitution, ball on ball
    e2               float  -    restitution, ball on table
    m1               float  kg   mass of the upper ball B1
    m2               float  kg   mass of the lower ball B2
    k1               float  N/m  stiffness, ball on ball
    k2               float  N/m  stiffness, ball on table
    v0               float  m/s  velocity of B1 at first touch; up is positive
    """
)
#: Of chains of N balls.
LINE = columns(
    """
    cell             int    -      number of the chain in the experiment, from 0
    arrangement      text   -      row, cradle, pile or stack
    balls            int    -      number of balls, N
    strike           int    -      number of balls that strike the others; of a cradle only
    exponent         float  -      p of the contacts, F = k delta^p
    mass_taper       float  -      mass of every next ball over that of the last one
    stiffness_taper  float  -      stiffness of every next contact over that of the last one
    gap              float  m      of every contact but the struck one at first
    e                float  -      restitution of every contact
    m1               float  kg     mass of ball 1, at the top
    k1               float  N/m^p  stiffness of contact 1
    v0               float  m/s    velocity of what strikes at first touch; up is positive
    """
)
WHO = columns(
    """
    solver       text  -  name of the solver
    status       text  -  ok, limit, or why there is no result
    marked       text  -  which jump of the solver's exact law or of the model is so near, or which \
                          cut-off, that the row counts in no statistic; null if none
    reason       text  -  one sentence where the status is not ok
    differences  text  -  what an engine says it uses instead of what it was asked for; null if nothing
    """
)
#: A column whose name ends in # is one of every ball, in @ of every contact.
OUTCOME = columns(
    """
    v#                 float  m/s  velocity of ball # when the collision is over
    impulse@           float  N s  total impulse of contact @
    states             text   -    state sequence, separated by spaces; an engine's without states held too \
                                   briefly
    states_compared    text   -    state sequence without states held too briefly, for any solver
    n_states           int    -    length of the state sequence
    n_events           int    -    number of events
    grazing_margin     float  -    smallest compression rate at a turning point, per amplitude of that rate, up \
                                   to 0.05; a jump of the model is at 0; infinite: none is near
    retained_energy    float  -    kinetic energy after over before
    retained_momentum  float  -    sum of m_i v_i after over that before, up is positive: negative if falling \
                                   balls leave a table upwards (before: m1 v0 < 0); 1 without a table
    step               float  s    time step
    n_steps            int    -    number of time steps
    duration           float  s    from first touch to the end of the collision
    velocity_error     float  -    error of a reference's velocities, per |v0|, as it states it; null if exact
    gravity_number     float  -    g/(|v0| omega1), omega1 = sqrt(k1 (1/m1 + 1/m2)); 0 without gravity
    """
)
CERTIFICATE = columns(
    """
    v#_limit        float  -  velocity of ball # per |v0|, extrapolated to a step of 0; engines only
    limit_error     float  -  estimated error of these velocities as those of the contacts asked for (naive \
                              mapping: of its own)
    limit_distance  float  -  their largest distance from the exact solver of the law the engine was asked \
                              for; null without that solver, and with the naive mapping
    regularisation  float  -  the part of limit_error that no step removes: the engine's own doing
    order           float  -  order in the step with which the velocities approach the limit, fitted
    finest_step     float  s  the shortest time step that went into the limit
    """
)
MEASURES = columns(
    """
    velocity_divergence   float  -  D = sqrt(sum m_i dv_i^2/sum m_i v_i0^2)
    dv#                   float  -  solver minus model, per |v0|
    dimpulse@             float  -  solver minus model, per m1 |v0|
    largest_dv            float  -  largest |dv_i|
    dretained_energy      float  -  difference of the retained energy fractions, solver minus model
    states_equal          bool   -  whether states_compared and model_states_compared are equal
    states_differ_at      int    -  position, from 1, of the first state that differs; null if equal
    states_edit_distance  int    -  insertions, deletions and substitutions between the two
    impulse_curve_distance  float  -  symmetric Hausdorff distance of the impulse curves, per m1 |v0|
    """
)
MODEL = columns(
    """
    model_states           text   -  state sequence of the state-transition model
    model_states_compared  text   -  states_compared of the state-transition model
    model_status           text   -  status of the state-transition model
    model_grazing_margin   float  -  grazing margin of the state-transition model
    """
)
#: Measured of two balls on a table alone.
OF_TWO = re.compile(r"(model_)?states(_\w+)?|impulse_curve_distance|gravity_number")


@dataclass(frozen=True, eq=False)
class Cut:
    """A table of a run, made of its parts: some columns, by their names there, of the rows that are kept.

    With `text` it is written as CSV too.
    """

    columns: dict[str, Column]
    source: tuple[str, ...]
    keep: pc.Expression | None = None
    text: bool = True

    @cached_property
    def schema(self) -> pa.Schema:
        """Of the table."""
        return schema(self.columns)

    def of(self, rows: pa.Table) -> pa.Table:
        """Cut the table of some rows of parts; a run without engines has no columns of ladders."""
        if not set(self.source) <= set(rows.column_names):
            return self.schema.empty_table()
        kept = rows if self.keep is None else rows.filter(self.keep)
        return pa.table([kept[name] for name in self.source], schema=self.schema)


@dataclass(frozen=True, slots=True, eq=False)
class Layout:
    """What the parts and tables of an experiment hold."""

    #: Whether cells are two balls on a table.
    pair: bool
    #: Most of a cell.
    balls: int
    contacts: int
    #: Of a part: everything known of one cell and solver.
    rows: pa.Schema
    #: By name, without suffix.
    tables: dict[str, Cut]


def expanded(columns: Mapping[str, Column], balls: int, contacts: int) -> dict[str, Column]:
    """Give columns of every ball and contact their numbers."""
    found = {}
    for name, (kind, unit, meaning) in columns.items():
        count = balls if "#" in name else contacts
        numbers = map(str, range(1, 1 + count)) if re.search("[#@]", name) else ("",)
        for i in numbers:
            found[re.sub("[#@]", i, name)] = kind, unit, re.sub("[#@]", i, meaning)
    return found


def schema(columns: Mapping[str, Column]) -> pa.Schema:
    """Arrow schema of a table; unit and meaning of each column are in its metadata."""
    return pa.schema(
        [
            pa.field(name, _TYPES[kind], metadata={"unit": unit, "meaning": meaning})
            for name, (kind, unit, meaning) in columns.items()
        ]
    )


def to_table(columns: Mapping[str, Any], n: int, schema: pa.Schema) -> pa.Table:
    """Make a table of arrays, shape (n,): NaN, None and an empty text are nulls, and so is a missing column."""
    return pa.table([_array(columns.get(field.name), n, field.type) for field in schema], schema=schema)


def _array(values: Any, n: int, kind: pa.DataType) -> pa.Array:
    if values is None:
        return pa.nulls(n, kind)
    if pa.types.is_string(kind):
        return pa.array([text or None for text in values], kind)
    return pa.array(np.asarray(values), kind, from_pandas=True)
