"""Columns of the tables a run writes, with their units."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import pyarrow as pa

_TYPES = {
    "int": pa.int64(),
    "float": pa.float64(),
    "text": pa.string(),
    "bool": pa.bool_(),
    "list": pa.list_(pa.float64()),
}


def _columns(text: str) -> dict[str, tuple[str, str, str]]:
    """Read a list of columns: name, type, unit ("-" is dimensionless) and meaning, two spaces between them."""
    rows = (re.split(r"\s{2,}", line.strip(), maxsplit=3) for line in text.strip().splitlines())
    return {name: (kind, unit, " ".join(meaning.split())) for name, kind, unit, meaning in rows}


_PARAMETERS = _columns(
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
_WHO = _columns(
    """
    solver  text   -    name of the solver
    status  text   -    ok, limit, or why there is no result
    marked  text   -    which jump of the solver's exact law or of the model is so near, or which \
                        cut-off, that the row counts in no statistic; null if none
    reason  text   -    one sentence where the status is not ok
    differences  text  -  what an engine says it uses instead of what it was asked for; null if nothing
    """
)
_OUTCOME = _columns(
    """
    v1               float  m/s  velocity of B1 when the collision is over
    v2               float  m/s  velocity of B2 when the collision is over
    impulse1         float  N s  total impulse, ball on ball
    impulse2         float  N s  total impulse, ball on table
    states           text   -    state sequence, separated by spaces; an engine's without states held too \
                                 briefly
    states_compared  text   -    state sequence without states held too briefly, for any solver
    n_states         int    -    length of the state sequence
    n_events         int    -    number of events
    grazing_margin   float  -    nearness to a jump of the model, per amplitude of the rate; small is near
    retained_energy  float  -    kinetic energy after over before
    step             float  s    time step
    n_steps          int    -    number of time steps
    duration         float  s    from first touch to the end of the collision
    gravity_number   float  -    g/(|v0| omega1), omega1 = sqrt(k1 (1/m1 + 1/m2)); 0 without gravity
    """
)
_CERTIFICATE = _columns(
    """
    v1_limit        float  -    velocity of B1 per |v0|, extrapolated to a step of 0; engines only
    v2_limit        float  -    velocity of B2 per |v0|, extrapolated to a step of 0; engines only
    limit_error     float  -    estimated error of v1_limit and v2_limit as those of the contacts asked \
                                for (naive mapping: of its own)
    regularisation  float  -    the part of limit_error that no step removes: the engine's own doing
    order           float  -    order in the step with which the velocities approach the limit, fitted
    finest_step     float  s    the shortest time step that went into the limit
    """
)
_MEASURES = _columns(
    """
    velocity_divergence   float  -    D = sqrt((m1 dv1^2 + m2 dv2^2)/(m1 v0^2))
    dv1                   float  -    solver minus model, per |v0|
    dv2                   float  -    solver minus model, per |v0|
    dimpulse1             float  -    solver minus model, per m1 |v0|
    dimpulse2             float  -    solver minus model, per m1 |v0|
    dretained_energy      float  -    difference of the retained energy fractions, solver minus model
    states_equal          bool   -    whether states_compared and model_states_compared are equal
    states_part_at        int    -    position, from 1, of the first state that differs; null if equal
    states_edit_distance  int    -    insertions, deletions and substitutions between the two
    curve_distance        float  -    symmetric Hausdorff distance of the impulse curves, per m1 |v0|
    """
)
_MODEL = _columns(
    """
    model_states           text   -    state sequence of the state-transition model
    model_states_compared  text   -    states_compared of the state-transition model
    model_status           text   -    status of the state-transition model
    model_grazing_margin   float  -    grazing margin of the state-transition model
    """
)

#: What a reader of the files finds documented beside each column: type, unit and meaning.
COLUMNS = _PARAMETERS | _WHO | _OUTCOME | _CERTIFICATE | _MEASURES | _MODEL
PARAMETERS, MEASURES, CERTIFICATE = tuple(_PARAMETERS), tuple(_MEASURES), tuple(_CERTIFICATE)
CELLS = (*_PARAMETERS, *_WHO, *_OUTCOME, *_CERTIFICATE)
DIVERGENCE = (*_PARAMETERS, *_WHO, *_MEASURES, "states", "states_compared", *_MODEL)


def schema(names: Iterable[str], known: Mapping[str, tuple[str, str, str]] = COLUMNS) -> pa.Schema:
    """Arrow schema of a table; unit and meaning of each column are in its metadata."""
    fields = []
    for name in names:
        kind, unit, meaning = known[name]
        fields.append(pa.field(name, _TYPES[kind], metadata={"unit": unit, "meaning": meaning}))
    return pa.schema(fields)


#: Everything known of one cell and solver: what a part holds, and the two tables are cut from.
ROW_SCHEMA = schema(COLUMNS)
CELLS_SCHEMA = schema(CELLS)
DIVERGENCE_SCHEMA = schema(DIVERGENCE)

_LINE_PARAMETERS = _columns(
    """
    cell             int    -      number of the column in the experiment, from 0
    arrangement      text   -      chain, cradle, drop or stack
    balls            int    -      number of balls, N
    strike           int    -      number of balls that strike the others; of a cradle only
    e                float  -      restitution of every contact
    exponent         float  -      p of the contacts, F = k delta^p
    mass_taper       float  -      mass of every next ball over that of the last one
    stiffness_taper  float  -      stiffness of every next contact over that of the last one
    gap              float  m      of every contact but the struck one at first
    m1               float  kg     mass of ball 1, at the top
    k1               float  N/m^p  stiffness of contact 1
    v0               float  m/s    velocity of what strikes at first touch; up is positive
    """
)
_LINE_OUTCOME = _columns(
    """
    velocities         list   m/s  velocities of the balls when the collision is over, ball 1 first
    n_states           int    -    length of the sequence of sets of contacts that act
    n_events           int    -    number of events
    grazing_margin     float  -    nearness to a jump of the model, per amplitude of the rate; small is near
    retained_energy    float  -    kinetic energy after over before
    retained_momentum  float  -    momentum after over before; 1 without a table
    step               float  s    time step
    n_steps            int    -    number of time steps
    duration           float  s    from first touch to the end of the collision
    velocity_error     float  -    error of a reference's velocities, per |v0|, as it states it; null if exact
    """
)
_LINE_CERTIFICATE = _columns(
    """
    velocities_limit  list   -  velocities per |v0|, extrapolated to a step of 0; engines only
    limit_error       float  -  estimated error of velocities_limit as those of the contacts asked for (naive \
                                mapping: of its own)
    order             float  -  order in the step with which the velocities approach the limit, fitted
    finest_step       float  s  the shortest time step that went into the limit
    """
)
_LINE_MEASURES = _columns(
    """
    velocity_divergence  float  -  D = sqrt(sum m_i dv_i^2/sum m_i v_i0^2)
    largest_dv           float  -  largest |dv_i| from the model, per |v0|
    dretained_energy     float  -  difference of the retained energy fractions, solver minus model
    limit_distance       float  -  largest |dv_i| of an engine's limit dt -> 0 from the exact solver of the law \
                                   it was asked for, per |v0|; null without that solver, and with the naive mapping
    """
)
_LINE_MODEL = {name: _MODEL[name] for name in ("model_status", "model_grazing_margin")}

#: As `COLUMNS`, of a run of columns of N balls.
LINE_COLUMNS = _LINE_PARAMETERS | _WHO | _LINE_OUTCOME | _LINE_CERTIFICATE | _LINE_MEASURES | _LINE_MODEL
LINE_PARAMETERS, LINE_MEASURES = tuple(_LINE_PARAMETERS), tuple(_LINE_MEASURES)


@dataclass(frozen=True, slots=True)
class Layout:
    """What the tables of a run hold.

    Attributes
    ----------
    rows : Schema
        Of a part: everything known of one cell and solver.
    cells, divergence : Schema
        Of the two tables that are cut from parts.
    """

    rows: pa.Schema
    cells: pa.Schema
    divergence: pa.Schema


#: Names of the finished tables.
TABLES = (
    *("cells.parquet", "divergence.parquet", "divergence.csv"),
    *("curves.parquet", "ladder.parquet", "ladder.csv"),
)

#: Of collisions of two balls, and of columns of N balls.
COLLISIONS = Layout(ROW_SCHEMA, CELLS_SCHEMA, DIVERGENCE_SCHEMA)
LINES = Layout(
    schema(LINE_COLUMNS, LINE_COLUMNS),
    schema((*_LINE_PARAMETERS, *_WHO, *_LINE_OUTCOME, *_LINE_CERTIFICATE), LINE_COLUMNS),
    schema((*_LINE_PARAMETERS, *_WHO, *_LINE_MEASURES, "limit_error", *_LINE_MODEL), LINE_COLUMNS),
)
