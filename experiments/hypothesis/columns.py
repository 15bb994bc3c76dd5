"""The hypothesis in columns of N balls: does the pair of a contact that becomes infinitely stiff move as one.

If it does, the column goes where N - 1 balls go of which one is the pair, *welded*: of the mass and the momentum of
both, or, at the table, part of the table. The welded column is solved by the same solver, so that a verdict is on the
hypothesis under the solver's own law, and on nothing else.

A pair of equal velocities at first, whether it moves or rests, is told apart from one that *meets*, whose own impact
comes first: welding it takes all the energy of its relative motion, of which a restitution keeps a part.

A dashpot is mapped with the reduced mass of its own two bodies. Where a body is welded to another, the dashpots of its
other contacts were mapped with its own mass and work against that of both: a lossy Kelvin-Voigt column goes elsewhere.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from impact_xval.compliant_baselines import get_solver
from impact_xval.compliant_baselines.solver import Settings
from impact_xval.experiments.hypothesis.cases import GRAZING, Frame
from impact_xval.experiments.hypothesis.config import HypothesisConfig, spaced
from impact_xval.model.collision import RESULT_STATUSES, Collision

Floats = NDArray[np.float64]

#: Solvers of columns that are exact for linear contacts, and fast enough where one rings a thousand times.
SOLVERS = ("state-transition", "bistiffness", "kelvin-voigt", "kelvin-voigt-textbook")

#: Masses and stiffnesses are drawn between these, logarithmically; restitutions of lossy contacts uniformly.
SPREAD, RESTITUTION = (0.3, 3.0), (0.5, 0.99)

#: Every so many points all contacts are elastic.
ELASTIC = 3


@dataclass(frozen=True, slots=True)
class Place:
    """Where the contact is that becomes infinitely stiff.

    Attributes
    ----------
    arrangement : str
        ``chain``, ``cradle`` (two strike), ``drop`` or ``stack``, as in `config.arrangements`.
    where : str
        ``top``, ``middle``, ``bottom`` or ``table``.
    """

    arrangement: Literal["chain", "cradle", "drop", "stack"]
    where: Literal["top", "middle", "bottom", "table"]

    @property
    def table(self) -> bool:
        """Whether the column is on a table."""
        return self.arrangement in ("drop", "stack")

    def striking(self, balls: int) -> int:
        """Return the number of balls that move at first."""
        return {"stack": balls, "cradle": 2}.get(self.arrangement, 1)

    def contact(self, balls: int) -> int:
        """Return the index of the contact, from 0."""
        contacts = balls - 1 + self.table
        middle = 1 if self.arrangement == "cradle" else contacts // 2
        return {"top": 0, "middle": middle}.get(self.where, contacts - 1)

    @property
    def meets(self) -> bool:
        """Whether its bodies approach each other at first."""
        struck = {"chain": "top", "cradle": "middle", "drop": "top", "stack": "table"}
        return struck[self.arrangement] == self.where


PLACES = (
    *(Place(name, where) for name in ("chain", "cradle") for where in ("top", "middle", "bottom")),
    *(Place(name, where) for name in ("drop", "stack") for where in ("top", "middle", "table")),
)


def draw(place: Place, points: int, balls: tuple[int, int], seed: int) -> list[Collision]:
    """Draw columns whose contact at a place is as stiff as the stiffest of the others.

    Parameters
    ----------
    place : Place
    points : int
    balls : tuple of int
        Least and largest number of balls.
    seed : int
    """
    rng = np.random.default_rng((seed, PLACES.index(place)))
    low, high = map(math.log, SPREAD)
    columns = []
    for i in range(points):
        n = int(rng.integers(balls[0], balls[1] + 1))
        contacts, moving, stiff = n - 1 + place.table, place.striking(n), place.contact(n)
        masses, k = (np.exp(rng.uniform(low, high, size)) for size in (n, contacts))
        e = rng.uniform(*RESTITUTION, contacts) if (i + 1) % ELASTIC else np.ones(contacts)
        k[stiff] = np.delete(k, stiff).max()
        masses, k, e = (tuple(each.tolist()) for each in (masses, k, e))
        columns.append(Collision(masses, k, e, (-1.0,) * moving + (0.0,) * (n - moving), place.table))
    return columns


def stiffened(column: Collision, contact: int, contrast: float) -> Collision:
    """Return a column with a contact so many times stiffer."""
    stiffnesses = list(column.stiffnesses)
    stiffnesses[contact] *= contrast
    return replace(column, stiffnesses=tuple(stiffnesses))


def welded(column: Collision, contact: int) -> Collision:
    """Return the column with the bodies of a contact as one; of a table contact, the ball as part of the table."""
    masses, velocities = list(column.masses), list(column.velocities)
    at_table = contact == len(masses) - 1
    pair = slice(contact, contact + 2)
    mass = sum(masses[pair])
    momentum = sum(m * v for m, v in zip(masses[pair], velocities[pair], strict=True))
    masses[pair] = [] if at_table else [mass]
    velocities[pair] = [] if at_table else [momentum / mass]
    others = [i for i in range(len(column.stiffnesses)) if i != contact]
    stiffnesses, restitutions = ([v[i] for i in others] for v in (column.stiffnesses, column.restitutions))
    return Collision(tuple(masses), tuple(stiffnesses), tuple(restitutions), tuple(velocities), column.table)


def of_each_ball(velocities: Sequence[float], contact: int, balls: int) -> tuple[float, ...]:
    """Give the velocities of a welded column to the balls of the whole one."""
    if contact == balls - 1:
        return (*velocities, 0.0)
    return (*velocities[: contact + 1], *velocities[contact:])


def column_outcomes(config: HypothesisConfig) -> Frame:
    """Solve the columns of a test by its exact solvers; a row a place, solver, column and contrast.

    Velocities are in m/s, the incoming ones being 1; `welded` are those of the welded column, a number a ball, and
    `weights` the balls' masses per twice the kinetic energy at first.
    """
    design = config.columns
    contrast = spaced(design.contrast, design.per_decade)
    rows = []
    for place in PLACES:
        columns = draw(place, design.points, design.balls, config.seed)
        for solver in columns_solvers(config):
            rows += solved(solver, place, columns, contrast)
    return pd.DataFrame(rows)


def columns_solvers(config: HypothesisConfig) -> list[str]:
    """Return the solvers of a test that are judged in columns."""
    return [name for name in SOLVERS if name in config.solvers]


def solved(solver: str, place: Place, columns: Sequence[Collision], contrast: Floats) -> list[dict[str, Any]]:
    """Solve columns drawn at a place (`draw`) at rising contrasts; the rows of `column_outcomes`."""
    at = [place.contact(len(column.masses)) for column in columns]
    series = [
        stiffened(column, contact, x) for column, contact in zip(columns, at, strict=True) for x in contrast
    ]
    forms = [welded(column, contact) for column, contact in zip(columns, at, strict=True)]
    outcomes = list(get_solver(solver).solve_many([*series, *forms], Settings(mark=False)))
    rows = []
    for i, (column, contact) in enumerate(zip(columns, at, strict=True)):
        m, v0 = np.array(column.masses), np.array(column.velocities)
        weights = m / (m @ v0**2)
        form = np.array(of_each_ball(outcomes[len(series) + i].velocities, contact, len(m)))
        known = {
            **{"arrangement": place.arrangement, "stiff_contact": place.where, "meets": place.meets},
            **{
                "solver": solver,
                "column": i,
                "class": "elastic" if min(column.restitutions) == 1 else "lossy",
            },
            **{name: getattr(column, name) for name in ("masses", "stiffnesses", "restitutions")},
            **{"incoming": column.velocities, "weights": weights, "welded": form},
        }
        for x, outcome in zip(contrast, outcomes[i * len(contrast) :], strict=False):
            margin = math.inf if outcome.grazing_margin is None else outcome.grazing_margin * math.sqrt(x)
            rows.append(
                {
                    **known,
                    "contrast": x,
                    "velocities": outcome.velocities,
                    "distance": float(np.sqrt(weights @ (np.array(outcome.velocities) - form) ** 2)),
                    "status": outcome.status,
                    "reason": outcome.reason,
                    "used": outcome.status in RESULT_STATUSES and margin >= GRAZING,
                }
            )
    return rows
