"""Columns of the parts and tables of an experiment."""

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

#: Put before the name of a column of the table of ladders, in the parts.
LADDER_PREFIX = "ladder_"

_PARAMETERS: Mapping[CellKind, Columns] = {
    "pair": schema.PAIR_PARAMETERS,
    "chain": schema.CHAIN_PARAMETERS,
    "graph": schema.GRAPH_PARAMETERS,
}


def layout_of(config: Config) -> Layout:
    """Lay out the parts and tables of an experiment."""
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
    """Return the largest numbers of balls and of contacts that a cell of an experiment has.

    Contacts of graphs have no columns: an outcome of a graph has no impulses.
    """
    if config.graph is not None:
        return Counts(config.graph.most_bodies(), 0, ("x", "z"))
    if config.chain is None:
        return Counts(2, 2)
    balls = int(max(config.chain.axes("pile")["balls"]))
    on_table = {"pile", "stack"} & set(config.chain.arrangement)
    return Counts(balls, balls if on_table else balls - 1)


def engines_with_ladders(config: Config) -> list[str]:
    """List the engines that have ladders: those that were asked for the law of an exact solver. Graphs have none."""
    engines = [name for name in config.solvers if is_engine(name) and law_name_of(name) is not None]
    return engines if config.measures == "all" and config.kind != "graph" else []


def ladder_columns(*, gravity: bool) -> Columns:
    """Return the columns of a ladder beside the parameters.

    Without gravity there are fewer causes, and fewer orders of them.
    """
    orders = "six" if gravity else "two"
    columns = [
        Column(
            "status",
            "text",
            "-",
            "ok; unconverged: the engine's result is; or that of the outcome without which there is none",
        ),
        Column(
            "reason",
            "text",
            "-",
            "which outcome that is, and why; or why mapping and time step are one contribution",
        ),
        Column(
            "marked",
            "text",
            "-",
            "which jump of an outcome is so near that the row counts in no statistic; null if none",
        ),
        Column("model_grazing_margin", "float", "-", "grazing margin of the state-transition model"),
        Column("velocity_divergence", "float", "-", "D, the kinetic norm of the difference of velocities"),
        Column(
            "dv{i}",
            "float",
            "-",
            "engine minus model, velocity of ball {i} per |v0|; the sum of those of the contributions",
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
            f"whether it has the largest by each of the {orders} orders",
        ),
        Column("sentence", "text", "-", "the row in words"),
    ]
    for name in corner_names(gravity=gravity).values():
        columns += _corner_columns(name)
    return tuple(columns)


def _contribution_columns(contribution: Contribution, orders: str) -> Iterator[Column]:
    """Yield the columns of a contribution; `orders` is the number of orders of the causes, in words."""
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
        "component along the whole difference over D; shares of a row sum to 1",
    )
    if contribution.is_cause:
        by_order = f"share by the {orders} orders of the causes"
        yield Column(f"{name}_share_low", "float", "-", f"least {by_order}")
        yield Column(f"{name}_share_high", "float", "-", f"largest {by_order}")


def _corner_columns(name: str) -> Iterator[Column]:
    """Yield the columns of a corner."""
    corner = name.replace("_", ", ")
    yield Column(
        f"{name}_v{{i}}", "float", "-", f"corner {corner}: final velocity of ball {{i}} per |v0|", per="ball"
    )
    yield Column(
        f"{name}_along",
        "float",
        "-",
        "component of its difference from the model along dv, as in shares",
    )
