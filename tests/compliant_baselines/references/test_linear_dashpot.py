"""The linear dashpot, whose contact may pull.

Single contacts are compared with the closed form. Chains, and drops of two balls with gravity, are compared with a
numerical integration in time. In this integration each force is a function of the overlap and its rate only, and a
contact has no other state. `linear_dashpots.jsonl` holds outcomes of chains with many events, computed in 113 bits
(__float128) by an independent program. Between events it uses power series of order 34 in time. It finds events by the
signs of functions and slopes, and then by bisection.
"""

import json
import math
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from impact_xval.compliant_baselines import Settings, conformance, get_solver
from impact_xval.compliant_baselines.references import solve_by_law
from impact_xval.model import Collision
from impact_xval.model.collisions import Collisions
from tests.compliant_baselines.reference_cells import BATCHES, coefficients_of, in_time, make_chain

LAW = "linear-dashpot"
RESTITUTIONS = 1e-6, 0.02, 0.3, 0.7, 0.999, 1.0


@pytest.mark.parametrize("e", RESTITUTIONS)
def test_a_contact_alone_is_half_a_period_of_an_oscillator(e):
    mass, k, speed = 6 / 5, 1e3, 1.3
    # delta = v/w exp(-zeta omega t) sin(w t) until it is zero again, where w = omega sqrt(1 - zeta^2)
    duration = math.hypot(math.pi, math.log(e)) / math.sqrt(k / mass)
    for collision in (
        Collision((2, 3), (k,), (e,), (-speed, 0)),
        Collision((mass,), (k,), (e,), (-speed,), table=True),
        Collision((2, 3), (k,), (e,), (-speed, 0), gaps=(0.5,)),
    ):
        outcome = in_time(collision, LAW)
        v = [*outcome.velocities, *[0.0] * collision.table]
        assert outcome.status == "ok"
        assert (v[0] - v[1]) / speed == pytest.approx(e, rel=1e-12)
        flight = collision.gaps[0] / speed
        assert outcome.diagnostics["duration"] == pytest.approx(flight + duration, rel=1e-12)


def test_a_linear_dashpot_pushes_from_first_touch_and_pulls_before_it_ends():
    e, k = 0.3, 4.0
    (outcome,) = get_solver(LAW).solve_many(
        [Collision((1,), (k,), (e,), (-1,), table=True)], Settings(record_path=True)
    )
    c = -2 * math.log(e) / math.hypot(math.pi, math.log(e)) * math.sqrt(k)
    force = outcome.path.forces[:, 0]
    acting = outcome.path.active[:, 0]
    assert force[0] == pytest.approx(c, rel=1e-12)
    # the force is -c e at the end; the path's last sample is a little earlier
    assert force[acting].min() == pytest.approx(-c * e, rel=0.2)
    assert force.min() < -0.5 * c * e
    assert not acting[-1]
    assert force[-1] == 0


class Bodies:
    """Balls with positions and velocities. A contact has a force as long as its bodies overlap.

    The start and the end of an overlap are events of the integrator. With gravity the lowest ball is settled at first.
    Gravity ends at the first time without any overlap.
    """

    def __init__(self, chain, gravity):
        self.balls, self.table, self.g = len(chain.masses), [0.0] * chain.table, gravity
        self.m, self.k = np.array(chain.masses), np.array(chain.stiffnesses)
        self.c, self.gaps = coefficients_of(chain, LAW, 1), np.array(chain.gaps)
        sunk = self.m[-1] * gravity / self.k[-1]
        self.y, self.now = np.concatenate([np.full(self.balls, -sunk), chain.velocities]), 0.0
        depths, rates = self.depths(self.y), self.rates(self.y)
        self.overlaps = (depths > 0) | ((depths == 0) & (rates > 0))

    def depths(self, y):
        return np.diff([*y[: self.balls], *self.table]) - self.gaps

    def rates(self, y):
        return np.diff([*y[self.balls :], *self.table])

    def energy(self, y):
        kinetic, overlap = 0.5 * y[self.balls :] ** 2, np.maximum(self.depths(y), 0)
        return self.m @ (kinetic + self.g * y[: self.balls]) + 0.5 * self.k @ overlap**2

    def slope(self, _, y):
        force = self.overlaps * (self.k * self.depths(y) + self.c * self.rates(y))
        above_and_below = [0.0, *force, 0.0][: self.balls + 1]
        return np.concatenate([y[self.balls :], np.diff(above_and_below) / self.m - self.g])

    def crossing(self, i):
        """Return a function of time and state that falls through zero when the overlap of contact i begins or ends."""
        sign = 1 if self.overlaps[i] else -1

        def depth(_, y):
            return sign * self.depths(y)[i] + 1e-15

        depth.__dict__.update(terminal=True, direction=-1)  # the attributes that `solve_ivp` reads
        return depth

    def move(self, until):
        """Integrate to the time `until`; return the velocities then, and the largest gain of energy in a step."""
        gained = 0.0
        while self.now < until:
            if not self.overlaps.any() and self.depths(self.y).max() <= 1e-12:
                self.g = 0.0
            events = [self.crossing(i) for i in range(len(self.k))]
            run = solve_ivp(
                self.slope,
                (self.now, until),
                self.y,
                "DOP853",
                events=events,
                rtol=1e-12,
                atol=1e-15,
                max_step=0.1,
            )
            assert run.success
            gained = max(gained, np.diff([self.energy(y) for y in run.y.T]).max())
            self.y, self.now = run.y[:, -1], run.t[-1]
            self.overlaps = self.overlaps ^ [bool(times.size) for times in run.t_events]
        return self.y[self.balls :], gained


@pytest.mark.parametrize(
    "chain",
    [
        Collision(
            (1, 0.6, 1.7), (1, 3, 0.7), (0.4, 0.8, 0.6), (-1, 0.1, -0.2), table=True, gaps=(0, 0.2, 0.4)
        ),
        Collision((2, 0.5, 1), (1, 0.2, 2), (0.05, 0.3, 0.9), (-1, -1, -1), table=True, gaps=(0, 0, 0)),
        Collision((1, 1, 1), (1, 1), (0.01, 0.01), (-1, 0, 0.3), gaps=(0.1, 0)),
    ],
)
def test_chains_with_gaps_move_as_their_forces_say(chain):
    outcome = in_time(chain, LAW)
    velocities, gained = Bodies(chain, 0.0).move(outcome.diagnostics["duration"] + 1)
    assert outcome.velocities == pytest.approx(velocities, abs=1e-10, rel=0)
    assert gained < 1e-12


@pytest.mark.parametrize("gravity", [0.02, 0.1])
@pytest.mark.parametrize("cell", [(1.0, 1.2, 0.9, 0.7), (0.2, 0.4, 0.3, 0.5), (10.0, 2.0, 0.6, 0.95)])
def test_drops_move_as_their_forces_say(cell, gravity):
    batch = BATCHES[LAW](*cell, gravity / math.sqrt(1 + 1 / cell[1]))
    assert np.isnan(batch.diagnostics["rest_speed"])
    chain = Collision.from_ratios(*cell)
    velocities, gained = Bodies(chain, gravity).move(float(batch.diagnostics["duration"]) + 1)
    assert (float(batch.v1), float(batch.v2)) == pytest.approx(velocities, abs=1e-10, rel=0)
    assert gained < 1e-12


def test_every_chain_opens_however_strong_its_dashpots_are():
    rng = np.random.default_rng(3)
    for _ in range(200):
        balls, table = int(rng.integers(2, 7)), bool(rng.integers(2))
        contacts = balls - 1 + table
        chain = Collision(
            10 ** rng.uniform(-2, 2, balls),
            10 ** rng.uniform(-3, 3, contacts),
            10 ** rng.uniform(-12, 0, contacts),
            [-1.0, *rng.uniform(-1, 0, balls - 1)],
            table=table,
        )
        outcome = in_time(chain, LAW)
        assert outcome.status == "ok", chain
        masses, v = np.array(chain.masses), np.array(outcome.velocities)
        assert masses @ v**2 <= masses @ np.square(chain.velocities) * (1 + 1e-12)
        assert (np.diff(v) <= 1e-12).all()
        assert not chain.table or v[-1] >= -1e-12


def test_what_is_refused_names_the_legal_range():
    (outcome,) = get_solver(LAW).solve_many([make_chain(-1, 0, e=0.0)], Settings())
    assert outcome.status == "unrepresentable"
    assert outcome.reason.startswith("a restitution is 0: ")
    assert "legal: 0 < e <= 1" in outcome.reason
    assert "\n" not in outcome.reason


def test_the_linear_dashpot_keeps_the_contract_though_its_impulses_fall():
    assert conformance.problems(get_solver(LAW), LAW) == {}


ROWS = [json.loads(row) for row in Path(__file__).with_name("linear_dashpots.jsonl").read_text().splitlines()]


@pytest.mark.parametrize("frozen", [False, True])
def test_chains_end_as_in_113_bits(frozen):
    rows = [row for row in ROWS if row["frozen"] is frozen]
    assert len(rows) >= 30
    for row in rows:
        numbers = ("masses", "stiffnesses", "restitutions", "velocities", "gaps")
        values = {name: np.array([row[name]]) for name in numbers}
        outcomes = solve_by_law(Collisions(**values, table=row["table"]), LAW, frozen=frozen)
        assert outcomes.velocities[0] == pytest.approx(row["end"], abs=1e-11, rel=0), row
