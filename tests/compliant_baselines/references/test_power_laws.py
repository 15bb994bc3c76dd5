"""Contacts with power laws that are hard for step control: nearly elastic, far apart, or ever stiffer.

`power_laws.jsonl` holds outcomes of an independent event-driven integration in 113 bits (__float128; a power series of
order 26 in time, truncated at 1e-26, roots by bisection). It takes from the kernel only the damping coefficients. It
unites two bodies if the contact between them is pressed, rings, and has become 1e22 times as stiff at the same force.
"""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from impact_xval.compliant_baselines import Settings, get_solver
from impact_xval.model import Collision
from impact_xval.model.status import RESULT_STATUSES
from tests.compliant_baselines.reference_cells import in_time

ROWS = [json.loads(row) for row in Path(__file__).with_name("power_laws.jsonl").read_text().splitlines()]
FIELDS = "masses", "stiffnesses", "restitutions", "velocities", "table", "gaps", "exponent"


def cells(kind, law):
    """Return collisions of a kind ("nearly-elastic" or "stiffened") and law, and final velocities in 113 bits."""
    rows = [row for row in ROWS if (row["kind"], row["law"]) == (kind, law)]
    return [Collision(**{name: row[name] for name in FIELDS}) for row in rows], [row["end"] for row in rows]


@pytest.mark.parametrize("law", ["bistiffness", "kelvin-voigt", "hunt-crossley", "compression-dashpot"])
def test_nearly_elastic_contacts_far_apart_are_as_exact_as_they_say(law):
    collisions, ends = cells("nearly-elastic", law)
    assert len(collisions) >= 40
    outcomes = get_solver(law).solve_many(collisions, Settings())
    stated = np.array([outcome.diagnostics["velocity_error"] for outcome in outcomes])
    away = [np.abs(np.subtract(o.velocities, end)).max() for o, end in zip(outcomes, ends, strict=True)]
    assert not any(outcome.marked for outcome in outcomes)
    assert np.all(away <= np.maximum(1e-9, 3 * stated)), np.max(away)
    assert np.mean(stated < 1e-7) >= 0.95


#: With weak dashpots a force ends almost at depth 0, where the function that is watched for this event is nearly flat.
WEAK = Collision((1, 0.1, 0.01), (1, 0.01, 1e-4), (0.999999,) * 3, (-1, 0, 0), table=True, exponent=1.5)
#: Final velocities of `WEAK`, integrated in 113 bits.
WEAK_END = 0.955343613579812, 0.926115013146612, 0.392059285080179


def test_the_force_of_a_weak_dashpot_ends_where_it_does():
    outcome = get_solver("kelvin-voigt").solve(WEAK, Settings())
    assert outcome.velocities == pytest.approx(WEAK_END, abs=1e-9, rel=0)


def test_chains_with_gaps_whose_contacts_stiffen_without_end_are_over():
    collisions, ends = cells("stiffened", "bistiffness")
    assert len(collisions) >= 50
    for collision, end in zip(collisions, ends, strict=True):
        outcome = in_time(collision, "bistiffness", exponent=collision.exponent, max_steps=20_000)
        assert outcome.status in RESULT_STATUSES, (collision, outcome.reason)
        assert outcome.velocities == pytest.approx(end, abs=1e-11, rel=0), collision


def lossy_chain(rng):
    balls, table = int(rng.integers(3, 7)), bool(rng.integers(3) == 0)
    contacts = balls - 1 + table
    v = -rng.uniform(0, 1, balls) if rng.integers(2) else -np.eye(balls)[0]
    return Collision(
        10 ** rng.uniform(-1, 1, balls),
        10 ** rng.uniform(-2, 2, contacts),
        10 ** rng.uniform(-3, -0.3, contacts),
        [-1.0, *v[1:]],
        table=table,
        gaps=10 ** rng.uniform(-4, 0, contacts) * rng.integers(2, size=contacts),
    )


@pytest.mark.parametrize("count", [100, pytest.param(4000, marks=pytest.mark.nightly)])
def test_random_lossy_chains_with_gaps_are_over(count):
    rng = np.random.default_rng(101)
    for i in range(count):
        chain = replace(lossy_chain(rng), exponent=(1.5, 2.0, 2.5, 3.0)[i % 4])
        outcome = in_time(chain, "bistiffness", exponent=chain.exponent, max_steps=50_000)
        assert outcome.status in RESULT_STATUSES, (chain, outcome.reason)
        masses, v = np.array(chain.masses), np.array(outcome.velocities)
        assert (np.diff(v) <= 1e-11).all(), chain
        assert masses @ v**2 <= masses @ np.square(chain.velocities) * (1 + 1e-12), chain
        if not chain.table:
            assert masses @ v == pytest.approx(masses @ chain.velocities, abs=1e-11 * masses.sum()), chain
