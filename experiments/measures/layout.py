"""What the parts and tables of an experiment hold."""

from __future__ import annotations

from collections.abc import Mapping

import pyarrow.compute as pc

from impact_xval.compliant_baselines.registry import is_engine, law_of
from impact_xval.experiments.config.experiment import REFERENCE, Config
from impact_xval.experiments.measures.corners import corner_names
from impact_xval.experiments.measures.ladder import CAUSES, contributions_of
from impact_xval.experiments.tables import schema as known
from impact_xval.experiments.tables.schema import Column, Cut, Layout, columns, expanded, schema


def layout_of(config: Config) -> Layout:
    """Lay out the tables of an experiment."""
    line = config.chain
    pair, balls = line is None, 2 if line is None else int(max(line.axes("pile")["balls"]))
    contacts = balls if line is None or {"pile", "stack"} & set(line.arrangement) else balls - 1
    parameters = known.PAIR if pair else known.LINE

    def block(*some: Mapping[str, Column]) -> dict[str, Column]:
        every = {name: column for each in some for name, column in each.items()}
        here = {name: column for name, column in every.items() if pair or not known.OF_TWO.fullmatch(name)}
        return expanded(here, balls, contacts)

    cells = block(parameters, known.WHO, known.OUTCOME, known.CERTIFICATE)
    paths = {name: known.OUTCOME[name] for name in ("states", "states_compared")}
    divergence = block(parameters, known.WHO, known.MEASURES, paths, known.CERTIFICATE, known.MODEL)
    ladder = block(ladder_columns(gravity=pair))
    in_part = {f"ladder_{name}": column for name, column in ladder.items()}
    of_cell = (*parameters, *(["gravity_number"] if pair else []), "solver")
    tables = {
        "cells": Cut(cells, tuple(cells), text=False),
        "divergence": Cut(divergence, tuple(divergence), pc.field("solver") != REFERENCE),
        "ladder": Cut(
            {name: cells[name] for name in of_cell} | ladder,
            (*of_cell, *in_part),
            pc.field("ladder_status").is_valid(),
        ),
    }
    rows = schema(cells | divergence | (in_part if laddered(config) else {}))
    return Layout(pair, balls, contacts, rows, tables)


def laddered(config: Config) -> list[str]:
    """List the engines that were asked for the law of an exact solver; others have no ladder."""
    engines = [name for name in config.solvers if is_engine(name) and law_of(name) is not None]
    return engines if config.measures == "all" else []


def ladder_columns(*, gravity: bool) -> dict[str, Column]:
    """Columns of a ladder beside the parameters; without gravity there are fewer causes and orders of them."""
    orders = "six" if gravity else "two"
    text = """
    status                 text   -  ok; unconverged: the engine's result is; or that of the outcome without which \
                                     there is none
    reason                 text   -  which outcome that is, and why; or why mapping and time step are one contribution
    marked                 text   -  which jump of an outcome is so near that the row counts in no statistic; null if \
                                     none
    model_grazing_margin   float  -  grazing margin of the state-transition model
    velocity_divergence    float  -  D, the kinetic norm of the difference of velocities
    dv#                    float  -  engine minus model, velocity of ball # per |v0|; the sum of those of the \
                                     contributions
    """
    for c in contributions_of(gravity=gravity):
        difference = f"{c.label}: {c.after} minus {c.before}"
        if c in CAUSES:
            mean = f"mean over the {orders} orders of the causes (Shapley value)"
            difference = f"{c.label}, {mean}: {c.before} -> {c.after}"
        text += f"""
        {c.name}_dv#    float  -  {difference}; velocity of ball # per |v0|
        {c.name}_norm   float  -  kinetic norm of {c.name}'s difference of velocities
        {c.name}_share  float  -  component along the whole difference over D; shares of a row sum to 1
        """
        if c in CAUSES:
            text += f"""
            {c.name}_share_low   float  -  least share by the {orders} orders of the causes
            {c.name}_share_high  float  -  largest share by the {orders} orders of the causes
            """
    text += f"""
    limit_error              float  -  estimated error of the engine's limit dt -> 0
    dominant                 text   -  the contribution with the largest share
    dominant_by_every_order  bool   -  whether it has the largest by each of the {orders} orders
    sentence                 text   -  the row in words
    """
    for name in corner_names(gravity=gravity).values():
        corner = name.replace("_", ", ")
        text += f"""
        {name}_v#     float  -  corner {corner}: final velocity of ball # per |v0|
        {name}_along  float  -  component of its difference from the model along dv, as in shares
        """
    return columns(text)
