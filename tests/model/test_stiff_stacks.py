"""Rounding causes no events in stacks with one very stiff contact, in tall stacks, and where others hit ringing bodies.

Bodies ring if they vibrate against each other. `stiff_stacks.jsonl` and the velocities after gaps come from an
independent event-driven integration in 113 bits (__float128; a power series of order 46 in time, roots by bisection),
which uses nothing of the kernel. A relative change of its inputs by 1e-15 changes no outcome by more than 1e-13.
"""

import json
from pathlib import Path

import numpy as np
import pytest

from impact_xval.model import Collision, solve
from tests.compliant_baselines.reference_cells import in_time, make_chain

STACKS = [json.loads(row) for row in Path(__file__).with_name("stiff_stacks.jsonl").read_text().splitlines()]
SOLVERS = {"model": solve, "bistiffness": lambda chain: in_time(chain, "bistiffness")}


@pytest.mark.parametrize("law", SOLVERS)
def test_a_stiff_contact_ahead_of_the_wave_changes_no_digit(law):
    for stack in STACKS:
        chain = Collision(
            *(stack[name] for name in ("masses", "stiffnesses", "restitutions", "velocities")), table=True
        )
        outcome = SOLVERS[law](chain)
        assert outcome.velocities == pytest.approx([float(v) for v in stack[law]], abs=1e-12)
        assert outcome.n_events < 10 * stack[f"events_{law}"]


@pytest.mark.parametrize("balls", [22, 60])
@pytest.mark.parametrize("table", [True, False])
def test_a_tall_elastic_pile_ends_and_keeps_its_energy(balls, table):
    chain = make_chain(-1.0, *[-1.0 if table else 0.0] * (balls - 1), table=table)
    for law in SOLVERS:
        outcome = SOLVERS[law](chain)
        assert outcome.status == "ok"
        assert outcome.retained_energy(chain) == pytest.approx(1, abs=1e-12)
        assert np.all(np.diff(outcome.velocities) <= 1e-12)


@pytest.mark.parametrize(
    ("masses", "stiffnesses", "gap", "expected"),
    [
        ((1, 1, 1), (1, 1, 1e-7), 5, (1.34837396898036, 0.94058929957129, 0.94058929957129)),
        ((10, 1, 1), (30, 1, 1e-8), 4.5, (1.6419664863816,) * 3),
    ],
)
def test_bodies_that_ring_are_not_one_before_another_arrives(masses, stiffnesses, gap, expected):
    chain = Collision(masses, stiffnesses, (0.8, 0.3, 0.9), (-2, -1, -1), table=True, gaps=(gap, 0, 0))
    assert in_time(chain, "bistiffness").velocities == pytest.approx(expected, abs=1e-12)
