"""The hypothesis in chains of N balls: does the pair of a contact that becomes infinitely stiff move as one.

If it does, the chain goes where N - 1 balls go of which one is the pair, *welded*: of the mass and the momentum of
both, or, at the table, part of the table. The welded chain is solved by the same solver, so that a verdict is on the
hypothesis under the solver's own law, and on nothing else.
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

#: Solvers of chains that are exact for linear contacts, and fast enough if a contact rings a thousand times.
SOLVERS = ("state-transition", "bistiffness", "kelvin-voigt", "kelvin-voigt-textbook")

#: Range of masses and stiffnesses, drawn logarithmically; range of restitutions of lossy contacts, drawn uniformly.
SPREAD, RESTITUTION = (0.3, 3.0), (0.5, 0.99)

#: In every third chain all contacts are elastic.
ELASTIC = 3

#: Error of an exact solver's velocities in chains, per speed of impact (docs/chains.md, sections 6 and 7).
ERROR = 1e-9

#: Arrangements, and the position in each of the contact that becomes infinitely stiff.
PLACES: tuple[tuple[Arrangement, str], ...] = (
    *((name, where) for name in ("row", "cradle") for where in ("top", "middle", "bottom")),
    *((name, where) for name in ("pile", "stack") for where in ("top", "middle", "table")),
)


def draw_chains(
    place: tuple[Arrangement, str], points: int, balls: tuple[int, int], seed: int
) -> list[tuple[Collision, int]]:
    """Draw chains, and return each with the index of its stiff contact.

    The number of balls is drawn from `balls` (least, largest). The contact at `place` is as stiff as the stiffest of
    all others. Two balls strike in a cradle, and its middle contact is the one that they strike.
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
    """Return a chain with one contact `contrast` times stiffer."""
    stiffnesses = (k * contrast if i == contact else k for i, k in enumerate(chain.stiffnesses))
    return dataclasses.replace(chain, stiffnesses=tuple(stiffnesses))


def weld_contact(chain: Collision, contact: int) -> Collision:
    """Return the chain without a contact: its two bodies are one, or its ball is part of the table."""
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
    """Return the velocities of the balls of a chain from those of its welded chain.

    The lower body of the welded contact, and every ball below it, stands one place higher in the welded chain. Where
    the table is that lower body, ball N has its velocity, 0.
    """
    of_welded = (*velocities, 0.0)
    above = of_welded[: contact + 1]
    below = of_welded[contact : len(velocities)]
    return above + below


def solve_chains(config: HypothesisConfig) -> Frame:
    """Solve the chains of a test by its exact solvers; return one row per place, solver, chain and contrast."""
    design = config.chains
    contrasts = spaced_contrasts(design.contrast, design.per_decade)
    problems = [
        ({"arrangement": place[0], "stiff_contact": place[1], "solver": solver, "chain": i}, *chain)
        for place in PLACES
        for solver in filter(config.solvers.__contains__, SOLVERS)
        for i, chain in enumerate(draw_chains(place, design.points, design.balls, config.seed))
    ]
    with ThreadPoolExecutor(available_cores()) as threads:  # kernels hold no lock of Python
        rows_by_problem = threads.map(
            lambda problem: list(_solve_at_contrasts(contrasts, *problem)), problems
        )
        rows = [row for rows_of_problem in rows_by_problem for row in rows_of_problem]
    outcomes: Frame = pd.DataFrame(rows).assign(error=ERROR, decades=design.fit_decades)
    return mark_usable(outcomes, np.sqrt(outcomes.contrast))


def _solve_at_contrasts(
    contrasts: Sequence[float], keys: Record, chain: Collision, contact: int
) -> Iterator[Record]:
    """Yield the outcomes of a chain at rising contrasts of a contact; the closed form is that of the welded chain.

    `keys` tell the chain and its solver in every row. Velocities are in m/s, the incoming ones being 1; `weights` are
    the masses per twice the kinetic energy at first.
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
