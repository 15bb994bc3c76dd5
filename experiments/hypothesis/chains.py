"""Test in chains of N balls, which shows whether two bodies move as one if their contact becomes infinitely stiff.

The test compares a chain with its *welded* chain of N - 1 balls. In the welded chain the two bodies are one body with
the mass and the momentum of both. If one of the two bodies is the table, the other is a ball, which becomes part of the
table. The same solver solves both chains. The verdict therefore depends on the hypothesis alone, and not on the
solver's law. `run` calls this module for a test of the hypothesis, and `own` for a collision that a user gives.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pandas as pd

from impact_xval.compliant_baselines import get_solver
from impact_xval.compliant_baselines.solver import Settings
from impact_xval.experiments.config.arrangements import Arrangement, ChainSetup
from impact_xval.experiments.hypothesis.config import HypothesisConfig, spaced_contrasts
from impact_xval.experiments.hypothesis.judging import kinetic_distance, mark_usable
from impact_xval.experiments.sweep.pool import available_cores
from impact_xval.experiments.tables.frames import Frame, Record
from impact_xval.model.collision import Collision

#: Solvers of chains that a test uses. They are exact for linear contacts, and fast enough for a stiff contact that
#: opens and closes a thousand times.
SOLVERS = ("state-transition", "bistiffness", "kelvin-voigt", "kelvin-voigt-textbook")

#: Range of masses and stiffnesses, whose logarithms are drawn uniformly. Range of the restitutions of lossy contacts,
#: which are drawn uniformly.
SPREAD, RESTITUTION = (0.3, 3.0), (0.5, 0.99)

#: One chain in this number of chains has elastic contacts only.
ELASTIC = 3

#: Error of an exact solver's velocities in chains, per speed of impact (docs/chains.md, sections 6 and 7).
ERROR = 1e-9

#: Arrangements of chains. For each arrangement, the positions of the contact that becomes infinitely stiff.
PLACES: tuple[tuple[Arrangement, str], ...] = (
    *((name, where) for name in ("row", "cradle") for where in ("top", "middle", "bottom")),
    *((name, where) for name in ("pile", "stack") for where in ("top", "middle", "table")),
)


def draw_chains(
    place: tuple[Arrangement, str], points: int, balls: tuple[int, int], seed: int
) -> list[tuple[Collision, int]]:
    """Draw random chains; return each chain with the index of its stiff contact.

    The stiff contact is the one that a test makes stiffer and stiffer. In the chains that are returned, it is only as
    stiff as the stiffest of all other contacts. `points` is the number of chains, and `balls` the least and the largest
    number of balls in a chain. `place` is the arrangement and the position of the stiff contact. In a cradle two balls
    strike, and the middle contact is the contact between the second of these balls and the third ball of the chain.
    """
    arrangement, where = place
    rng = np.random.default_rng((seed, PLACES.index(place)))
    low, high = map(math.log, SPREAD)
    chains: list[tuple[Collision, int]] = []
    for i in range(points):
        n = int(rng.integers(balls[0], balls[1] + 1))
        strike = 2 if arrangement == "cradle" else None
        chain = ChainSetup(arrangement=arrangement, balls=n, strike=strike).collision()
        contacts = len(chain.stiffnesses)
        stiff = {"top": 0, "middle": 1 if strike else contacts // 2}.get(where, contacts - 1)
        masses, k = (np.exp(rng.uniform(low, high, size)) for size in (n, contacts))
        e = rng.uniform(*RESTITUTION, contacts) if (i + 1) % ELASTIC else np.ones(contacts)
        k[stiff] = np.delete(k, stiff).max()
        masses, k, e = (tuple(each.tolist()) for each in (masses, k, e))
        chains.append((Collision(masses, k, e, chain.velocities, chain.table), stiff))
    return chains


def stiffen_contact(chain: Collision, contact: int, contrast: float) -> Collision:
    """Return the chain with the stiffness of the contact of index `contact` multiplied by `contrast`."""
    stiffnesses = (k * contrast if i == contact else k for i, k in enumerate(chain.stiffnesses))
    return dataclasses.replace(chain, stiffnesses=tuple(stiffnesses))


def weld_contact(chain: Collision, contact: int) -> Collision:
    """Return the welded chain, in which the two bodies of a contact are one body.

    If the contact is between a ball and the table, the ball becomes a part of the table.
    """
    upper, is_table_contact = contact, contact == len(chain.masses) - 1
    if is_table_contact:
        masses, velocities = chain.masses[:upper], chain.velocities[:upper]
    else:
        m1, m2 = chain.masses[upper : upper + 2]
        v1, v2 = chain.velocities[upper : upper + 2]
        velocity = (m1 * v1 + m2 * v2) / (m1 + m2)
        masses = (*chain.masses[:upper], m1 + m2, *chain.masses[upper + 2 :])
        velocities = (*chain.velocities[:upper], velocity, *chain.velocities[upper + 2 :])
    stiffnesses = chain.stiffnesses[:contact] + chain.stiffnesses[contact + 1 :]
    restitutions = chain.restitutions[:contact] + chain.restitutions[contact + 1 :]
    return Collision(masses, stiffnesses, restitutions, velocities, chain.table)


def velocities_of_balls(velocities: Sequence[float], contact: int) -> tuple[float, ...]:
    """Return the velocities of all balls of a chain, given the velocities of the balls of its welded chain.

    In the welded chain, the two balls of a contact are one body, and every ball below them is one place higher. Both
    balls get the velocity of this body. If the welded contact is between ball N and the table, ball N gets the velocity
    of the table, which is 0.
    """
    of_welded = (*velocities, 0.0)
    above = of_welded[: contact + 1]
    below = of_welded[contact : len(velocities)]
    return above + below


def solve_chains(config: HypothesisConfig) -> Frame:
    """Solve the chains of a test by exact solvers, at rising contrasts.

    Return a table of outcomes, with one row for each position of the stiff contact, solver, chain and contrast.
    """
    design = config.chains
    contrasts = spaced_contrasts(design.contrast, design.per_decade)
    problems = [
        ({"arrangement": place[0], "stiff_contact": place[1], "solver": solver, "chain": i}, *chain)
        for place in PLACES
        for solver in filter(config.solvers.__contains__, SOLVERS)
        for i, chain in enumerate(draw_chains(place, design.points, design.balls, config.seed))
    ]
    with ThreadPoolExecutor(
        available_cores()
    ) as threads:  # compiled kernels release the global interpreter lock
        rows_by_problem = threads.map(
            lambda problem: list(_solve_at_contrasts(contrasts, *problem)), problems
        )
        rows = [row for rows_of_problem in rows_by_problem for row in rows_of_problem]
    outcomes: Frame = pd.DataFrame(rows).assign(error=ERROR, decades=design.fit_decades)
    return mark_usable(outcomes, np.sqrt(outcomes.contrast))


def _solve_at_contrasts(
    contrasts: Sequence[float], keys: Record, chain: Collision, contact: int
) -> Iterator[Record]:
    """Yield the outcomes of a chain whose stiff contact has rising contrasts, one row per contrast.

    The closed form in a row is the outcome of the welded chain, in which the two bodies of the stiff contact are one
    body. `keys` identify the chain and its solver, and are part of every row. Velocities are in m/s, and the incoming
    balls have 1 m/s. `weights` in a row are the masses, divided by twice the kinetic energy before the collision.
    """
    chains = [*(stiffen_contact(chain, contact, x) for x in contrasts), weld_contact(chain, contact)]
    *outcomes, as_one = get_solver(keys["solver"]).solve_many(chains, Settings(mark=False))
    weights = np.array(chain.masses) / np.dot(chain.masses, np.square(chain.velocities))
    form = velocities_of_balls(as_one.velocities, contact)
    shared = keys | {name: getattr(chain, name) for name in ("masses", "stiffnesses", "restitutions")}
    shared |= {"incoming": chain.velocities, "weights": weights, "closed_form": form}
    shared |= {"meets": chain.compression_rates[contact] > 0}
    shared |= {"class": "elastic" if min(chain.restitutions) == 1 else "lossy"}
    for x, outcome in zip(contrasts, outcomes, strict=True):
        of_outcome = {
            name: getattr(outcome, name) for name in ("velocities", "status", "reason", "grazing_margin")
        }
        distance = kinetic_distance(weights, np.subtract(outcome.velocities, form))
        yield shared | of_outcome | {"contrast": x, "distance": distance}
