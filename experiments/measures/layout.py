"""The columns of an experiment's tables, and of the files from which the tables are put together.

Such a file is called a part. It holds the rows of one chunk of cells. The finished tables are put together from all
parts.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace

import pyarrow.compute as pc

from impact_xval.compliant_baselines.registry import is_engine, law_name_of
from impact_xval.experiments.config.experiment import REFERENCE, CellKind, Config
from impact_xval.experiments.measures.corners import corner_names
from impact_xval.experiments.measures.ladder import Contribution, contributions_of
from impact_xval.experiments.tables import schema
from impact_xval.experiments.tables.schema import Column, Columns, Counts, Layout, TableSpec

#: Prefix of the columns of the table ``ladder`` in the parts. A part is a file that holds rows of all tables, so that
#: columns of different tables need different names.
LADDER_PREFIX = "ladder_"

_PARAMETERS: Mapping[CellKind, Columns] = {
    "pair": schema.PAIR_PARAMETERS,
    "chain": schema.CHAIN_PARAMETERS,
    "graph": schema.GRAPH_PARAMETERS,
}


def layout_of(config: Config) -> Layout:
    """Return the columns of every table of an experiment, and of the part files from which the tables are made."""
    kind, counts = config.kind, _largest_counts(config)
    pair = kind == "pair"
    parameters = _PARAMETERS[kind]

    def block(*groups: Columns) -> Columns:
        columns = schema.union([c for group in groups for c in group if kind in c.kinds])
        return schema.expand_columns(columns, counts)

    cells = block(parameters, schema.SOLVER_AND_STATUS, schema.OUTCOME, schema.LIMIT)
    divergence = block(
        parameters,
        schema.SOLVER_AND_STATUS,
        schema.MEASURES,
        schema.pick(schema.OUTCOME, ("states", "states_compared", "asymmetry")),
        schema.LIMIT,
        schema.MODEL,
    )
    of_cell = schema.pick(
        cells, (*schema.names_of(parameters), *(["gravity_number"] if pair else []), "solver")
    )
    ladder = block(ladder_columns(gravity=pair))
    ladder_in_part = tuple(replace(column, name=LADDER_PREFIX + column.name) for column in ladder)
    tables = {
        "cells": TableSpec(cells, schema.names_of(cells), csv=False),
        "divergence": TableSpec(divergence, schema.names_of(divergence), pc.field("solver") != REFERENCE),
        "ladder": TableSpec(
            of_cell + ladder,
            schema.names_of(of_cell + ladder_in_part),
            pc.field(LADDER_PREFIX + "status").is_valid(),
        ),
    }
    part = schema.union(cells, divergence, ladder_in_part if engines_with_ladders(config) else ())
    return Layout(kind, counts, part_schema=schema.arrow_schema(part), tables=tables)


def _largest_counts(config: Config) -> Counts:
    """Return the largest number of balls, and of contacts, that a cell of an experiment has.

    For contact graphs the number of contacts is 0. Contacts need no columns there, because outcomes of graphs have no
    impulses.
    """
    if config.graph is not None:
        return Counts(config.graph.most_bodies(), 0, ("x", "z"))
    if config.chain is None:
        return Counts(2, 2)
    balls = int(max(config.chain.axes("pile")["balls"]))
    on_table = {"pile", "stack"} & set(config.chain.arrangement)
    return Counts(balls, balls if on_table else balls - 1)


def engines_with_ladders(config: Config) -> list[str]:
    """Return the engines of an experiment whose divergence is split into contributions (docs/ladder.md).

    An engine is returned if an exact solver solves the law that the engine was asked for. No engine is returned for
    contact graphs, or if the experiment does not compute all measures.
    """
    engines = [name for name in config.solvers if is_engine(name) and law_name_of(name) is not None]
    return engines if config.measures == "all" and config.kind != "graph" else []


def ladder_columns(*, gravity: bool) -> Columns:
    """Return the columns of the table ``ladder`` that follow the parameters of a cell.

    Without `gravity` there are two causes instead of three. These can be taken in two orders instead of six.
    """
    orders = "six" if gravity else "two"
    columns = [
        Column(
            "status",
            "text",
            "-",
            "ok; unconverged where the engine's result is; else the status of the missing outcome (see reason)",
        ),
        Column(
            "reason",
            "text",
            "-",
            "which outcome is missing, and why; or why mapping and time step are one contribution",
        ),
        Column(
            "marked",
            "text",
            "-",
            "which jump of an outcome is so near that no statistic counts the row; null if none",
        ),
        Column("model_grazing_margin", "float", "-", "grazing margin of the state-transition model"),
        Column("velocity_divergence", "float", "-", "D, the kinetic norm of the difference of velocities"),
        Column(
            "dv{i}",
            "float",
            "-",
            "engine minus model, velocity of ball {i} per |v0|; the contributions to it sum to it",
            per="ball",
        ),
    ]
    for contribution in contributions_of(gravity=gravity):
        columns += _contribution_columns(contribution, orders)
    columns += [
        Column("limit_error", "float", "-", "estimated error of the engine's limit dt -> 0"),
        Column("dominant", "text", "-", "the contribution with the largest share"),
        Column(
            "dominant_by_every_order",
            "bool",
            "-",
            f"whether the same contribution has the largest share by each of the {orders} orders of the causes",
        ),
        Column("sentence", "text", "-", "what the row shows, in one sentence"),
    ]
    for name in corner_names(gravity=gravity).values():
        columns += _corner_columns(name)
    return tuple(columns)


def _contribution_columns(contribution: Contribution, orders: str) -> Iterator[Column]:
    """Yield the columns of one contribution to a divergence.

    `orders` is a word such as "six": the number of orders in which the causes can be taken.
    """
    name, before, after = contribution.name, contribution.before, contribution.after
    if contribution.is_cause:
        mean = f"mean over the {orders} orders of the causes (Shapley value)"
        difference = f"{contribution.label}, {mean}: {before} -> {after}"
    else:
        difference = f"{contribution.label}: {after} minus {before}"
    yield Column(
        f"{name}_dv{{i}}", "float", "-", f"{difference}; velocity of ball {{i}} per |v0|", per="ball"
    )
    yield Column(f"{name}_norm", "float", "-", f"kinetic norm of {name}'s difference of velocities")
    yield Column(
        f"{name}_share",
        "float",
        "-",
        "component along the whole difference, divided by D; the shares of a row sum to 1",
    )
    if contribution.is_cause:
        by_order = f"share among the {orders} orders of the causes"
        yield Column(f"{name}_share_low", "float", "-", f"least {by_order}")
        yield Column(f"{name}_share_high", "float", "-", f"largest {by_order}")


def _corner_columns(name: str) -> Iterator[Column]:
    """Yield the columns of one corner.

    Each cause is a switch. A corner is the exact solution for one combination of the switches (`corners`).
    """
    corner = name.replace("_", ", ")
    yield Column(
        f"{name}_v{{i}}", "float", "-", f"corner {corner}: final velocity of ball {{i}} per |v0|", per="ball"
    )
    yield Column(
        f"{name}_along",
        "float",
        "-",
        f"corner {corner}: component of its difference from the model along dv, the engine's difference from the model",
    )
