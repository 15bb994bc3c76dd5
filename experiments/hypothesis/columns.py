"""The hypothesis in columns of N balls: does the pair of a contact that becomes infinitely stiff move as one.

If it does, the column goes where N - 1 balls go of which one is the pair, *welded*: of the mass and the momentum of
both, or, at the table, part of the table. The welded column is solved by the same solver, so that a verdict is on the
hypothesis under the solver's own law, and on nothing else.

A pair of equal velocities at first, whether it moves or rests, is told apart from one that *meets*, whose own impact
comes first: welding it takes all the energy of its relative motion, of which a restitution keeps a part.

A dashpot is mapped with the reduced mass of its own two bodies. Where a body is welded to another, the dashpots of its
other contacts were mapped with its own mass and work against that of both: `dashpots_kept` is the welded column with
them as they were, and what a Kelvin-Voigt law is predicted to go to.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from impact_xval.compliant_baselines import get_solver
from impact_xval.compliant_baselines.mapping import damping_ratio, textbook_damping_ratio
from impact_xval.compliant_baselines.solver import Settings
from impact_xval.experiments.hypothesis.config import HypothesisConfig, spaced
from impact_xval.experiments.hypothesis.judging import Judgement, judge
from impact_xval.experiments.hypothesis.predictions import dashpot_restitution
from impact_xval.experiments.hypothesis.verdicts import GRAZING, Group, gather
from impact_xval.experiments.measures.divergence import norms
from impact_xval.model.collision import RESULT_STATUSES, Collision, Outcome

Floats = NDArray[np.float64]

#: Solvers of columns that are exact for linear contacts, and fast enough where one rings a thousand times.
SOLVERS = ("state-transition", "bistiffness", "kelvin-voigt", "kelvin-voigt-textbook")

#: Error of their velocities per speed of impact (docs/columns.md, sections 6 and 7).
ERROR = 1e-9

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


@dataclass(frozen=True, slots=True)
class ColumnPoint:
    """One solver and one column.

    Attributes
    ----------
    column : Collision
        With the contact as stiff as the stiffest of the others: at a contrast of 1.
    outcomes : tuple of Outcome
        By contrast.
    welded : tuple of float
        Velocities of the welded column, of each ball of this one, in m/s.
    judgement : Judgement
        Of the distance D from them.
    missed : float
        D of the limit from the welded column whose dashpots are as they were; NaN where that is not predicted.
    """

    column: Collision
    outcomes: tuple[Outcome, ...]
    welded: tuple[float, ...]
    judgement: Judgement
    missed: float

    def distances(self) -> Floats:
        """D of each outcome from the welded column; NaN without a result."""
        return np.array([_apart(self.column, self.welded, each.velocities) for each in self.outcomes])


@dataclass(frozen=True, slots=True)
class ColumnResult:
    """One solver at one place.

    Attributes
    ----------
    solver : str
    place : Place
    contrast : ndarray, shape (n,)
    whole : Group
    classes : tuple of Group
        ``lossy`` and ``elastic``.
    """

    solver: str
    place: Place
    contrast: Floats
    whole: Group[ColumnPoint]
    classes: tuple[Group[ColumnPoint], ...]

    @property
    def differing(self) -> tuple[Group[ColumnPoint], ...]:
        """Classes whose verdict is not that of the whole."""
        return tuple(group for group in self.classes if group.verdict != self.whole.verdict)


def missed(group: Group[ColumnPoint]) -> list[float]:
    """Distances of the refuted points' limits from what is predicted of them, of those of which something is."""
    return [p.missed for p in group.judged("refuted") if not math.isnan(p.missed)]


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


def dashpots_kept(column: Collision, contact: int, solver: str) -> Collision | None:
    """Return the welded column with the dashpots the whole one is given by a Kelvin-Voigt solver; None without any.

    Restitutions beside the pair are those with which that solver maps the same dashpots against the mass of the pair. A
    textbook damping ratio from 1 on is that of no restitution: None too.
    """
    if not solver.startswith("kelvin-voigt"):
        return None
    one, restitutions = welded(column, contact), []
    for i, e in enumerate(column.restitutions):
        if i == contact:
            continue
        mapped, against = _reduced_mass(column, i), _reduced_mass(one, i - (i > contact))
        if solver.endswith("textbook"):
            zeta = textbook_damping_ratio(e) * math.sqrt(mapped / against)
            if zeta >= 1:
                return None
            restitutions.append(math.exp(-math.pi * zeta / math.sqrt((1 - zeta) * (1 + zeta))))
        else:
            restitutions.append(dashpot_restitution(damping_ratio(e), mapped, against))
    return replace(one, restitutions=tuple(restitutions))


def _apart(column: Collision, some: Sequence[float], others: Sequence[float]) -> float:
    """D of final velocities of a column from others."""
    difference = np.subtract(others, some)
    return float(norms(np.array(column.masses), difference, np.array(column.velocities)))


def _reduced_mass(column: Collision, contact: int) -> float:
    pair = column.masses[contact : contact + 2]
    return 1 / sum(1 / m for m in pair)


def of_each_ball(velocities: Sequence[float], contact: int, balls: int) -> tuple[float, ...]:
    """Give the velocities of a welded column to the balls of the whole one."""
    if contact == balls - 1:
        return (*velocities, 0.0)
    return (*velocities[: contact + 1], *velocities[contact:])


def examine_columns(config: HypothesisConfig) -> Iterator[ColumnResult]:
    """Judge every exact solver of an experiment at every place, one after the other."""
    design = config.columns
    contrast = spaced(design.contrast, design.per_decade)
    for place in PLACES:
        columns = draw(place, design.points, design.balls, config.seed)
        for name in columns_solvers(config):
            yield examine_place(name, place, columns, contrast, design.fit_decades)


def columns_solvers(config: HypothesisConfig) -> list[str]:
    """Return the solvers of an experiment that are judged in columns."""
    return [name for name in SOLVERS if name in config.solvers]


def examine_place(
    solver: str, place: Place, columns: Sequence[Collision], contrast: Floats, decades: float
) -> ColumnResult:
    """Judge a solver at a place, by columns drawn there (`draw`), at rising contrasts, over so many decades."""
    points = [_examined(solver, place, column, contrast, decades) for column in columns]
    elastic = [all(e == 1 for e in column.restitutions) for column in columns]
    whole, *classes = gather(["elastic" if each else "lossy" for each in elastic], points)
    return ColumnResult(solver, place, contrast, whole, tuple(classes))


def _examined(solver: str, place: Place, column: Collision, contrast: Floats, decades: float) -> ColumnPoint:
    balls = len(column.masses)
    contact = place.contact(balls)
    kept = None if place.meets else dashpots_kept(column, contact, solver)
    series = [stiffened(column, contact, x) for x in contrast]
    forms = [welded(column, contact), *([kept] if kept else [])]
    outcomes = get_solver(solver).solve_many([*series, *forms], Settings())
    form, *others = (of_each_ball(each.velocities, contact, balls) for each in outcomes[contrast.size :])
    outcomes = tuple(outcomes[: contrast.size])
    margins = np.array([math.inf if o.grazing_margin is None else o.grazing_margin for o in outcomes])
    usable = np.isin([o.status for o in outcomes], RESULT_STATUSES) & (margins * np.sqrt(contrast) >= GRAZING)
    energy = math.fsum(m * v**2 for m, v in zip(column.masses, column.velocities, strict=True))
    judgement = judge(
        contrast,
        np.array([o.velocities for o in outcomes]),
        np.full(contrast.size, ERROR),
        usable,
        form,
        [m / energy for m in column.masses],
        decades,
    )
    missed = _apart(column, others[0], judgement.limit) if others else math.nan
    return ColumnPoint(column, outcomes, form, judgement, missed)
