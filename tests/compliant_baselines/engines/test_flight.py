"""Free flight is no part of an outcome: references and engines, in the cells where it used to be."""

import re

import numpy as np
import pytest

from impact_xval.compliant_baselines import get_solver
from impact_xval.compliant_baselines.contract.solver import Convergence, Settings
from impact_xval.compliant_baselines.references.bistiffness import bistiffness_batch
from impact_xval.compliant_baselines.references.jumps import jumps
from impact_xval.compliant_baselines.references.kelvin_voigt import kelvin_voigt_batch
from impact_xval.model.collision import Collision

DROP = Settings(scenario="drop", convergence=Convergence())

#: k2/k1, m2/m1, e1, e2: the balls part with B2 faster by 1e-4 |v0| or so.
PARTING = [(0.108279, 0.523806, 0.627179, 0.902340), (1.177487, 1.213507, 0.910308, 0.448331)]


def collision(kappa, mu, e1, e2, k1=1e8):
    return Collision(1.0, mu, k1, k1 * kappa, e1, e2, -1.0)


def default_box(n, seed):
    rng = np.random.default_rng(seed)
    return 10 ** rng.uniform(-3, 3, n), 2 ** rng.uniform(-1, 1, n), *rng.uniform(0.5, 1, (2, n))


def test_an_engines_limit_is_the_exact_contacts(engine):
    for cell in PARTING:
        exact = get_solver("kelvin-voigt").solve(collision(*cell), DROP)
        limit = engine.solve(collision(*cell), DROP).diagnostics
        error = 3 * limit["limit_error"]
        assert (limit["v1_limit"], limit["v2_limit"]) == pytest.approx((exact.v1, exact.v2), abs=error), cell


@pytest.mark.parametrize("name", ["kelvin-voigt", "mujoco", "pybullet"])
def test_velocities_stay_in_flight(name):
    outcome = get_solver(name).solve(collision(*PARTING[0]), Settings(scenario="drop", record_path=True))
    path, start = outcome.path, outcome.diagnostics["first_flight"]
    flying = (path.time >= start) & (path.state == 4) & (path.time < path.time[-1])
    flight = path.time < path.time[flying][0] + 5e-4  # the first one, before the balls meet again
    for v in (path.v1, path.v2):
        assert np.ptp(v[flying & flight]) < 1e-15
    # and the impulses are those of contacts: gravity has acted until then
    m2, g = PARTING[0][1], 9.81
    assert outcome.impulse1 == pytest.approx(outcome.v1 + 1 + g * start, rel=1e-12)
    assert outcome.impulse2 == pytest.approx(outcome.impulse1 + m2 * (outcome.v2 + g * start), rel=1e-12)


def test_a_flight_of_any_length_ends_alike():
    # B2 is faster by ever less: the balls meet ever later, and the outcome tends to that in which they never do.
    kappa = PARTING[0][0] * (1 + np.linspace(-2e-3, 2e-3, 401))
    mu, e1, e2 = PARTING[0][1:]
    number = 9.81 / np.sqrt(1e8 * (1 + 1 / mu))
    batch = kelvin_voigt_batch(kappa, mu, e1, e2, number)
    assert len(np.unique(batch.n_states)) > 1  # they meet again in some only
    assert np.abs(np.diff(batch.v1)).max() < 1e-4
    assert np.abs(np.diff(batch.v2)).max() < 1e-4


def test_no_unmarked_cell_of_the_default_box_jumps():
    cells = default_box(4000, 11)
    number = 9.81 / np.sqrt(1e8 * (1 + 1 / cells[1]))
    rng = np.random.default_rng(12)
    for batch in (kelvin_voigt_batch, bistiffness_batch):
        marked = jumps(batch, *cells, number)[0] > 1
        assert np.mean(marked) < 5e-3
        base = batch(*cells, number)
        for _ in range(3):  # in stiffnesses, by other amounts than those that are tried
            a, b = 1 + 1e-3 * rng.uniform(-1, 1, (2, 4000))
            other = batch(cells[0] * a, *cells[1:], number * b)
            away = np.maximum(abs(other.v1 - base.v1), abs(other.v2 - base.v2))
            assert np.max(away[~marked]) < 0.02


#: B1 comes down on B2 again, or B2 is at rest just before: the exact law leaves B1 at 0.0004 or near 0.95.
BESIDE_A_JUMP = (0.0019638078578694557, 1.4209566336503359, 0.9792807125092937, 0.8738534904062736)


@pytest.mark.parametrize("name", ["kelvin-voigt", "mujoco"])
def test_an_outcome_beside_a_jump_is_marked(name):
    c = collision(*BESIDE_A_JUMP, k1=1e5)
    outcome = get_solver(name).solve(c, Settings(scenario="drop"))
    says = r"a change of -?0.001 in e2 moves the exact outcome of kelvin-voigt by 0.95"
    assert re.match(says, outcome.marked)
    assert get_solver(name).solve(c, Settings(scenario="drop", mark=False)).marked == ""
    assert get_solver(name).solve(collision(*PARTING[0]), Settings(scenario="drop")).marked == ""


@pytest.mark.slow
def test_a_flight_in_doubt_is_not_taken_for_known():
    # At h, h/2 and h/4 PyBullet's balls meet before B2 has left the table, in the limit after it: 2e-3 |v0| apart.
    c = collision(1e-3, 2 / np.sqrt(3), 1.0, 0.5)
    exact = get_solver("kelvin-voigt").solve(c, DROP)
    outcome = get_solver("pybullet").solve_many([c], DROP)[0]
    limit = outcome.diagnostics
    assert limit["finest_step"] < limit["step"] / 4
    assert abs(limit["v1_limit"] - exact.v1) < 3 * limit["limit_error"]
    assert outcome.status == "unconverged"  # and says so, where the differences alone see nothing


def test_a_limit_with_another_flight_than_the_exact_law_is_marked():
    # MuJoCo's least impedance lets B2 leave the table 9 microseconds before the balls meet; exactly, they meet first.
    c = collision(0.00553308751813229, 0.8101045963654292, 0.5562510847276028, 0.5158582821238982)
    outcome = get_solver("mujoco").solve(c, DROP)
    assert outcome.marked == "gravity ends in a first flight of the engine, and exact kelvin-voigt has none"
    assert get_solver("mujoco").solve(c, Settings(scenario="impact", convergence=Convergence())).marked == ""


@pytest.mark.parametrize(
    "cell", [(133.76074, 1.594772, 0.809319, 0.948431), (196.805898, 0.660243, 0.921792, 0.961987)]
)
def test_a_limit_at_rest_that_the_exact_law_leaves_is_marked(cell):
    # Soft contacts, so that gravity is strong: PyBullet's lower ball stays on the table at every step that is run.
    c = collision(*cell, k1=1e4)
    exact = get_solver("kelvin-voigt").solve(c, DROP)
    outcome = get_solver("pybullet").solve(c, DROP)
    limit = outcome.diagnostics
    assert limit["v2_limit"] == 0 < exact.v2
    # which no difference between steps tells
    assert abs(limit["v1_limit"] - exact.v1) > 3 * limit["limit_error"]
    says = "by the engine the lower ball comes to rest on the table, and by exact kelvin-voigt it leaves"
    assert outcome.marked == says


@pytest.mark.parametrize("name", ["kelvin-voigt", "mujoco"])
def test_impulses_go_with_the_velocities_reported(name):
    # B2 is at rest on the table, where it was still moving at 0.3 |v0|
    c = collision(0.001183583076108943, 1.2714452248113788, 0.6537076529015653, 0.822997371502013, k1=1e6)
    outcome = get_solver(name).solve(c, Settings(scenario="drop"))
    assert outcome.v2 == 0 < outcome.diagnostics["rest_speed"]
    assert outcome.impulse2 - outcome.impulse1 == pytest.approx(9.81 * c.m2 * outcome.diagnostics["duration"])
    if name == "kelvin-voigt":
        number = 9.81 / np.sqrt(1e6 * (1 + 1 / c.m2))
        batch = kelvin_voigt_batch(c.stiffness_ratio, c.mass_ratio, c.e1, c.e2, number)
        assert batch.impulse2 == pytest.approx(outcome.impulse2)
