"""Keys of the TOML file of an experiment, each with its default, its legal values and its meaning.

The documentation site lists them. The pydantic models in `experiment` define the keys and their legal values. Every key
of these models needs a line in `MEANINGS`.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import get_args

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from impact_xval.experiments.config.axes import LEGAL
from impact_xval.experiments.config.experiment import Config

#: Meaning of each key: one sentence that says what the value of the key decides. The name of a key in a table begins
#: with the name of the table.
MEANINGS = {
    "name": "Name of the experiment; the run goes to the folder runs/NAME.",
    "scenario": "A `drop` has gravity, and the lower ball rests settled on the table. An `impact` has no gravity.",
    "gravity": "Acceleration of gravity in a `drop`.",
    "m1": "Mass of the first ball: the upper ball, or the first ball of a chain.",
    "k1": "Stiffness of the first contact: ball on ball of two balls on a table.",
    "v0": "Velocity of the balls that fall or strike, just before the collision.",
    "solvers": "Solvers that compute every cell; the model `state-transition` is always one of them.",
    "step_fraction": "Time step of engines, as a part of the shortest contact period.",
    "max_steps": "Number of time steps after which a collision that is not over counts as `timeout`.",
    "shortest_state": "States shorter than this part of a period join the state before when state paths are compared.",
    "mapping": "How engines get their parameters: `calibrated` asks for the contact that is meant, `naive` writes "
    "what the names of the parameters suggest.",
    "stiffness_ratio_cutoff": "Ratio of stiffnesses beyond which the model takes the stiffer contact for rigid; "
    "`exact` does so only where the outcome stays the same.",
    "grazing_threshold": "Outcomes of the model with a grazing margin below this number are marked as beside a jump.",
    "measures": "Whether measures are computed in addition to velocities: `all` of them, or none.",
    "cell_timeout": "Time that a solver has for a chunk of cells before the chunk is split, down to one cell.",
    "chunk_size": "Number of cells that a worker takes at a time; without it the run chooses the number.",
    "workers": "Number of processes that compute; without it one for each core.",
    "grid.stiffness_ratio": "Values of k2/k1 on the grid.",
    "grid.k1": "Values of k1 on the grid; they replace `k1` of the experiment.",
    "grid.k2": "Values of k2, the stiffness of ball on table; they replace `stiffness_ratio`.",
    "grid.mass_ratio": "Values of m2/m1 on the grid.",
    "grid.m1": "Values of m1 on the grid; they replace `m1` of the experiment.",
    "grid.m2": "Values of m2, the mass of the lower ball; they replace `mass_ratio`.",
    "grid.e1": "Restitutions of ball on ball.",
    "grid.e2": "Restitutions of ball on table.",
    "grid.e": "Restitutions of both contacts, always equal; they replace `e1` and `e2`.",
    "sample.stiffness_ratio": "Range of k2/k1 from which cells are drawn.",
    "sample.mass_ratio": "Range of m2/m1 from which cells are drawn.",
    "sample.e1": "Range of the restitution of ball on ball.",
    "sample.e2": "Range of the restitution of ball on table.",
    "sample.n": "Number of cells that are drawn from a Sobol sequence; best a power of two.",
    "sample.seed": "Seed of the sequence; the same seed draws the same cells.",
    "cells": "File with one row for each cell, and the columns stiffness_ratio, mass_ratio, e1 and e2.",
    "chain.arrangement": "Setup of the balls: one ball strikes a `row`, several strike a `cradle`, one falls on a "
    "`pile`, a `stack` falls as a whole.",
    "chain.balls": "Numbers of balls of a chain.",
    "chain.strike": "Numbers of balls that strike in a cradle; without it one.",
    "chain.exponent": "Exponents p of the contact force k δ^p.",
    "chain.mass_taper": "Mass of each ball over the mass of the ball before it.",
    "chain.stiffness_taper": "Stiffness of each contact over the stiffness of the contact before it.",
    "chain.gap": "Gaps that are open at first between balls, except at the contact that is struck.",
    "chain.e": "Restitutions, the same for every contact of a chain.",
    "graph.name": "Contact graphs by name: `bernoulli`, `corner`, `bridge`, `rack`.",
    "graph.stiffness_ratio": "Values of k2/k1, in graphs that have two stiffnesses.",
    "graph.angle": "Angles between contacts; without it each graph has its own.",
    "graph.mass_ratio": "Values of m2/m1, in graphs that have two masses.",
    "graph.balls": "Numbers of balls of a rack.",
    "graph.e": "Restitutions, the same for every contact of a graph.",
    "convergence.enabled": "Whether engines also run at shorter steps, to estimate their limit at a step of zero.",
    "convergence.tolerance": "Error of the limit, per speed of impact, above which the step is halved again.",
    "convergence.halvings": "Largest number of times that the step is halved.",
    "figure_cell.stiffness_ratio": "k2/k1 of the collision whose impulse curves are drawn.",
    "figure_cell.mass_ratio": "m2/m1 of this collision.",
    "figure_cell.e1": "Restitution of ball on ball in this collision.",
    "figure_cell.e2": "Restitution of ball on table in this collision.",
    "figure_chain.arrangement": "Arrangement of the chain that is drawn, as in `chain.arrangement`.",
    "figure_chain.balls": "Number of balls of this chain.",
    "figure_chain.strike": "Number of balls that strike, in a cradle; without it one.",
    "figure_chain.e": "Restitution of every contact of this chain.",
    "figure_chain.exponent": "Exponent p of the contact force k δ^p in this chain.",
    "figure_chain.gap": "Gap between the balls of this chain, except at the contact that is struck.",
    "figure_chain.m": "Mass of its first ball.",
    "figure_chain.mass_taper": "Mass of each ball over the mass of the ball before it.",
    "figure_chain.k": "Stiffness of its first contact.",
    "figure_chain.stiffness_taper": "Stiffness of each contact over the stiffness of the contact before it.",
    "figure_chain.v0": "Velocity of the balls that strike or fall.",
}


@dataclass(frozen=True)
class Key:
    """Name, default, legal values and meaning of a key of an experiment."""

    #: Name as `table.key`, or `key` for a key above all tables of the file.
    name: str
    #: Value of the key if the key is missing in the file; None if the key has no default.
    default: object
    #: The legal values in words.
    legal: str
    meaning: str


def experiment_keys(model: type[BaseModel] = Config, before: str = "") -> Iterator[Key]:
    """Yield every key of a model in the order of its fields, including the keys of its tables.

    Raises
    ------
    KeyError
        If a key has no entry in `MEANINGS`, or if its legal values are given neither by a description nor by an entry
        in `LEGAL`.
    """
    for field_name, field in model.model_fields.items():
        table, name = _table_of(field), before + field_name
        if table is not None:
            yield from experiment_keys(table, f"{name}.")
        else:
            legal = field.description or LEGAL[field_name].text
            yield Key(name, field.get_default(call_default_factory=True), legal, MEANINGS[name])


def _table_of(field: FieldInfo) -> type[BaseModel] | None:
    """Return the pydantic model of the table that a field holds; None if the field holds no table.

    The table may be optional.
    """
    for kind in (field.annotation, *get_args(field.annotation)):
        if isinstance(kind, type) and issubclass(kind, BaseModel):
            return kind
    return None
