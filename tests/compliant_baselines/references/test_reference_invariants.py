"""What holds for every reference: Theorem 5, energy, one answer singly and in bulk, a consistent record."""

import itertools
import math

import numpy as np
import pytest

from impact_xval.compliant_baselines import get_solver
from impact_xval.compliant_baselines.solver import Settings
from impact_xval.model import Collision
from tests.compliant_baselines.reference_cells import BATCHES, random_cells, random_gravity

CELLS = [tuple(map(float, cell)) for cell in zip(*random_cells(25, 21), strict=True)]
SCENARIOS = [Settings(), Settings(scenario="drop", gravity=0.05), Settings(scenario="drop", gravity=0.3)]


@pytest.mark.parametrize("name", BATCHES)
def test_order_and_company_change_no_bit(name):
    collisions = [Collision.from_ratios(*cell) for cell in CELLS]
    collisions[3] = Collision((1.0, 0.5, 2.0), (1.0, 4.0), (0.9, 0.8), (-1.0, 0.0, 0.0))
    collisions[7] = Collision((1.0, 2.0), (1.0, 3.0), (0.9, 0.8), (-1.0, 0.3), table=True)
    for settings in SCENARIOS:
        many = get_solver(name).solve_many(collisions, settings)
        back = get_solver(name).solve_many(collisions[::-1], settings)
        for collision, one, other in zip(collisions, many, reversed(list(back)), strict=True):
            (alone,) = get_solver(name).solve_many([collision], settings)
            assert repr(one) == repr(other) == repr(alone)


@pytest.mark.parametrize("name", BATCHES)
def test_company_in_another_share_changes_no_bit(name):
    """600 cells are two shares, followed side by side."""
    cells = random_cells(600, 22)
    many, last = BATCHES[name](*cells), BATCHES[name](*(each[-1:] for each in cells))
    assert (many.v1[-1], many.v2[-1]) == (last.v1[0], last.v2[0])


@pytest.mark.parametrize("frozen", [False, True], ids=["free", "frozen"])
@pytest.mark.parametrize("name", BATCHES)
def test_energy_never_grows_and_the_balls_part(name, frozen):
    cells = random_cells(20_000, 8, lowest_e=0.02)
    batch = BATCHES[name](*cells, frozen=frozen)
    assert set(batch.statuses) <= {"ok", "limit"}
    assert np.all(batch.v1**2 + cells[1] * batch.v2**2 <= 1 + 1e-13)
    assert np.all(batch.v1 >= batch.v2 - 1e-15)
    assert np.all(batch.v2 >= -1e-15)
    np.testing.assert_allclose(batch.impulse1, 1 + batch.v1, atol=1e-14)


def test_elastic_collisions_keep_their_energy():
    kappa, mu, _, _ = random_cells(5000, 9)
    for batch in BATCHES.values():
        found = batch(kappa, mu, 1.0, 1.0)
        np.testing.assert_allclose(found.v1**2 + mu * found.v2**2, 1, atol=2e-13)


@pytest.mark.parametrize("name", BATCHES)
def test_a_path_keeps_momentum_gives_back_no_more_energy_than_it_took_and_ends_in_the_outcome(name):
    for settings, cell in itertools.product(SCENARIOS, CELLS):
        c = Collision.from_ratios(*cell)
        outcome = get_solver(name).solve(c, Settings(settings.scenario, settings.gravity, record_path=True))
        path, g = outcome.path, settings.gravity if settings.scenario == "drop" else 0.0
        falls = outcome.diagnostics.get("first_flight", np.inf)  # the bodies fall until then
        momentum = path.impulse1 - c.m1 * (path.v1 - c.v0 + g * np.minimum(path.time, falls))
        assert np.abs(momentum).max() < 1e-12, (settings, cell)
        taken = []  # by each contact of the energy of its bodies; in a short piece the rate is nearly a line
        for rate, impulse in ((path.v2 - path.v1, path.impulse1), (-path.v2, path.impulse2)):
            assert np.all(np.diff(impulse) >= -1e-12), (settings, cell)
            taken.append(np.cumsum(0.5 * (rate[1:] + rate[:-1]) * np.diff(impulse)))
            assert g > 0 or taken[-1].min() >= -2e-3, cell  # a settled one holds the weight's energy
        if g == 0:
            lost = 0.5 * (1 - outcome.retained_energy(c))
            assert taken[0][-1] + taken[1][-1] == pytest.approx(lost, abs=2e-3), cell
            assert np.all(np.diff(path.time) >= -1e-15 * path.time[-1])
            last = path.v1[-1], path.v2[-1], path.impulse1[-1], path.impulse2[-1]
            expected = outcome.v1, outcome.v2, outcome.impulse1, outcome.impulse2
            assert last == pytest.approx(expected, abs=1e-12), cell


@pytest.mark.slow
@pytest.mark.parametrize("name", BATCHES)
@pytest.mark.parametrize(
    ("ratio", "number"), [(1e-15, 0.1), (1e300, 0), pytest.param(1e15, 0.1, marks=pytest.mark.nightly)]
)
def test_beyond_double_precision_a_cell_ends_with_a_status(name, ratio, number):
    cells = BATCHES[name](ratio, [1e-3, 1.0, 1e3], [1.0, 0.999, 1e-3], 0.5, number)
    assert set(cells.statuses) <= {"ok", "limit", "timeout", "unrepresentable"}
    np.testing.assert_array_equal(np.isnan(cells.v1), ~np.isin(cells.statuses, ("ok", "limit")))


def test_gravity_goes_away_at_first_order():
    numbers = 10.0 ** -np.arange(3, 8)
    for batch in (BATCHES["bistiffness"], BATCHES["kelvin-voigt"]):
        v1 = batch(1.0, 2 / math.sqrt(3), 0.9, 0.7, numbers).v1
        difference = np.abs(v1 - batch(1.0, 2 / math.sqrt(3), 0.9, 0.7).v1)
        slopes = np.diff(np.log10(difference)) / np.diff(np.log10(numbers))
        np.testing.assert_allclose(slopes[1:], 1, atol=0.02)


def test_a_path_that_ends_in_a_limit_is_finite():
    # Stiffness of unloading k1/e1^2: a polynomial over the limit's duration would leave double precision.
    for e1 in (1e-17, 1e-70):
        collision = Collision.from_ratios(1.0, 0.2859933150104282, e1, 1.0)
        outcome = get_solver("bistiffness").solve(collision, Settings(record_path=True))
        assert outcome.status == "limit"
        assert outcome.path is not None
        for name in ("time", "impulse1", "impulse2", "v1", "v2"):
            assert np.isfinite(getattr(outcome.path, name)).all(), name
        assert outcome.path.v1[-1] == outcome.v1


@pytest.mark.parametrize("drop", [False, True], ids=["impact", "drop"])
def test_elastic_both_references_are_the_same_system(drop):
    kappa, mu, _, _ = random_cells(3000, 2)
    number = random_gravity(3000, 2) if drop else 0.0
    mine = BATCHES["bistiffness"](kappa, mu, 1.0, 1.0, number)
    other = BATCHES["kelvin-voigt"](kappa, mu, 1.0, 1.0, number)
    # An elastic B1 that B2 does not throw off never comes to rest: neither reference ends.
    ended = (mine.statuses == "ok") & (other.statuses == "ok")
    np.testing.assert_array_equal(mine.statuses == "timeout", other.statuses == "timeout")
    assert np.count_nonzero(ended) > 2900
    # Long drops amplify rounding by their many contacts.
    calm = ended & (mine.diagnostics["n_steps"] < 60)
    for name in ("v1", "v2"):
        atol = 1e-11 if drop else 1e-12  # the fall of a ball that hardly leaves the other amplifies rounding
        np.testing.assert_allclose(getattr(mine, name)[calm], getattr(other, name)[calm], rtol=0, atol=atol)
    np.testing.assert_array_equal(mine.n_states[calm], other.n_states[calm])


def test_in_time_the_pair_is_apart_when_its_velocities_are_equal():
    """B1 flies with v11, B2 swings on the table: v2 = v11 at cos(theta) = v11/v21 (k2/k1 -> 0), m2 = k2 = 1."""
    mu, e1, x = 0.5, 0.9, 1e5
    v11, v21 = (e1 * mu - 1) / (1 + mu), -(1 + e1) / (1 + mu)
    theta = math.acos(v11 / v21)
    asked = Collision.from_ratios(1 / x, mu, e1, 0.7)
    path = get_solver("bistiffness").solve(asked, Settings(record_path=True)).path
    middle = [0.5 * (a + b) for a, b in itertools.pairwise(path.v1 - path.v2)]
    gap = np.concatenate([[0.0], np.cumsum(np.diff(path.time) * middle)]) / math.sqrt(mu * x)
    parted = np.flatnonzero((path.v1 - path.v2)[1:] * (path.v1 - path.v2)[:-1] < 0)
    at = parted[np.argmax(gap[parted])]
    assert gap[at] == pytest.approx(v11 * theta - v21 * math.sin(theta), rel=0.02)
