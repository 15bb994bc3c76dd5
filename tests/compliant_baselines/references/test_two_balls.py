"""Two balls on a table by the references.

Random pairs are compared with an independent integration (`chain_reference`). Other tests compare with closed forms and
known numbers, and check energy, momentum, paths, and that the order of collisions does not matter.
"""

import itertools
import math

import numpy as np
import pytest
from scipy.integrate import cumulative_trapezoid

from impact_xval.compliant_baselines import get_solver
from impact_xval.compliant_baselines.restitution import hunt_crossley_coefficients
from impact_xval.compliant_baselines.solver import Settings
from impact_xval.model import Collision
from tests.compliant_baselines.reference_cells import BATCHES, dampings, end_of, random_cells, random_gravity
from tests.compliant_baselines.test_mapping import theory_restitution
from tests.model.chain_reference import integrate

#: Pairs with more steps than this are not compared, because the integration would take minutes.
LONGEST = 1500
MU = 2 / math.sqrt(3)
LAWS = [("kelvin-voigt", 12), ("hunt-crossley", 8), ("linear-dashpot", 8), ("bistiffness", 6)]
MANY = [("kelvin-voigt", 500), ("hunt-crossley", 500), ("linear-dashpot", 500), ("bistiffness", 12)]
#: Contact law, number of random pairs of balls, seed of the random numbers, and whether positions are frozen. Frozen
#: positions do not change during the collision.
RANDOM = [(*law, seed, frozen) for law in LAWS for seed, frozen in ((7, False), (34, True))]
RANDOM += [pytest.param(*law, 20240, False, marks=pytest.mark.nightly) for law in MANY]


def compare(law, cells, number, frozen=False):
    """Assert that pairs agree with the integration in velocities, end and duration.

    Return how many pairs were left out, and in how many of the others contacts carried force again.
    """
    g = number * np.sqrt(1 + 1 / cells[1])
    left_out = again = 0
    batch = BATCHES[law](*cells, number, frozen=frozen)
    dashpots = dampings(law, *cells).T
    assert set(batch.statuses) <= {"ok", "closed-form"}
    for i, cell in enumerate(np.transpose(cells).tolist()):
        if batch.diagnostics["n_steps"][i] > LONGEST and not frozen:
            left_out += 1
            continue
        chain = Collision.from_ratios(*cell)
        # At a coarse resolution the integration can miss two events where a force grazes zero. A real difference
        # remains with steps 25 times shorter.
        for resolution in (0.15,) if frozen else (0.15, 0.006):
            answer = integrate(chain, law, dashpots[i], gravity=g[i], frozen=frozen, resolution=resolution)
            off = np.abs(np.subtract(answer.velocities, (batch.v1[i], batch.v2[i]))).max()
            if off < 1e-9:
                break
        assert off < 1e-9, i
        again += len(answer.states) > 3
        if answer.limit:  # if two bodies were united, a closed form gives the rest
            continue
        assert answer.end == end_of(batch)[i]
        # The reference recognises that both balls come to rest earlier than the integration does, which waits until the
        # energy is small.
        if answer.end == "stuck" and not frozen:
            assert batch.diagnostics["duration"][i] < answer.duration + 1e-7
        else:
            # After a flight of thousands of time units, the integration's own duration changes by 3e-11 with the
            # resolution.
            assert answer.duration == pytest.approx(batch.diagnostics["duration"][i], rel=5e-11, abs=1e-7)
    return left_out, again


@pytest.mark.parametrize(("law", "n", "seed", "frozen"), RANDOM)
def test_random_cells_are_those_of_the_integration(law, n, seed, frozen):
    for number in (np.zeros(n), random_gravity(n, seed)):
        left_out, again = compare(law, random_cells(n, seed), number, frozen)
        assert left_out <= max(1, n / 50)
        assert law == "bistiffness" or not frozen or again >= n // 5


def test_the_lower_ball_comes_to_rest_while_its_dashpot_carries_nothing():
    cell, number = np.array([[1.036], [5.21], [0.8159], [0.308]]), np.array([0.01818])
    assert end_of(BATCHES["kelvin-voigt"](*cell, number)) == ["rest"]
    compare("kelvin-voigt", cell, number)


def test_known_numbers():
    for ratio, v1, v2 in (
        (1, 0.65159996, 0.31646952),
        (40, 0.92582208, 0.02569387),
        (1 / 40, 0.63441945, 0.10156776),
    ):
        outcome = get_solver("kelvin-voigt").solve(Collision.from_ratios(ratio, MU, 0.9, 0.7))
        assert (outcome.v1, outcome.v2) == pytest.approx((v1, v2), abs=6e-9)
    elastic = BATCHES["kelvin-voigt"](1.0, MU, 1.0, 1.0)
    assert (elastic.v1, elastic.v2) == pytest.approx((0.954509, 0.277489), abs=6e-7)


def test_hunt_crossley_is_its_first_term_as_restitution_goes_to_one():
    loss = 10.0 ** np.arange(-9, -2)
    a = hunt_crossley_coefficients(1 - loss)
    # to first order a = 3 (1 - e)/2
    np.testing.assert_allclose(a / (1.5 * loss), 1 + loss, atol=1e-6, rtol=0.5e-1 * loss.max())
    assert hunt_crossley_coefficients(np.array([1.0]))[0] == 0


def test_a_pair_alone_that_may_not_pull_has_another_restitution_by_the_damping_of_textbooks():
    zeta = -math.log(0.6) / math.hypot(math.pi, math.log(0.6))
    expected = theory_restitution(zeta)
    # A B2 that is a million million times as heavy stays at rest, so that only contact 1 matters.
    assert BATCHES["kelvin-voigt-textbook"](1.0, 1e12, 0.6, 1.0).v1 == pytest.approx(expected, abs=1e-6)


def test_anchored_is_exact_where_the_lower_ball_is_pressed_on_the_table():
    # With a light B2 on a hard support B1 acts on the table directly. The damping made for the pair's reduced mass is
    # wrong then.
    assert BATCHES["kelvin-voigt-anchored"](1e5, 1.0, 0.6, 0.6).v1 == pytest.approx(0.6, abs=0.01)
    assert BATCHES["kelvin-voigt"](1e5, 1.0, 0.6, 0.6).v1 > 0.68


def test_batch_says_unrepresentable_and_timeout_in_the_cell():
    batch = BATCHES["kelvin-voigt"]([1, 0, np.inf, 1, 1e9], 1.0, [0.5, 0.5, 0.5, 0, 1], 0.5, max_steps=50)
    assert list(batch.statuses) == ["ok", *3 * ["unrepresentable"], "timeout"]
    assert list(np.isnan(batch.v1)) == [False, True, True, True, True]


CELLS = [tuple(map(float, cell)) for cell in zip(*random_cells(25, 21), strict=True)]
SCENARIOS = [Settings(), Settings(scenario="drop", gravity=0.05), Settings(scenario="drop", gravity=0.3)]


@pytest.mark.parametrize("name", BATCHES)
def test_order_and_company_change_no_bit(name):
    """Results are bitwise the same alone, in any order and among others; 600 cells are solved as two blocks."""
    collisions = [Collision.from_ratios(*cell) for cell in np.transpose(random_cells(600, 22)).tolist()]
    collisions[3] = Collision((1.0, 0.5, 2.0), (1.0, 4.0), (0.9, 0.8), (-1.0, 0.0, 0.0))
    collisions[7] = Collision((1.0, 2.0), (1.0, 3.0), (0.9, 0.8), (-1.0, 0.3), table=True)
    for settings in SCENARIOS:
        many = get_solver(name).solve_many(collisions, settings)
        back = get_solver(name).solve_many(collisions[::-1], settings)
        for i in [*range(25), 599]:
            (alone,) = get_solver(name).solve_many([collisions[i]], settings)
            assert repr(many[i]) == repr(back[599 - i]) == repr(alone)


@pytest.mark.parametrize("frozen", [False, True], ids=["free", "frozen"])
@pytest.mark.parametrize("name", BATCHES)
def test_energy_never_grows_and_the_balls_part(name, frozen):
    kappa, mu, e1, e2 = random_cells(20_000, 8, lowest_e=0.02)
    e1[:5000] = e2[:5000] = 1  # elastic collisions keep their energy
    batch = BATCHES[name](kappa, mu, e1, e2, frozen=frozen)
    energy = batch.v1**2 + mu * batch.v2**2
    assert set(batch.statuses) <= {"ok", "closed-form"}
    np.testing.assert_allclose(energy[:5000], 1, atol=2e-13)
    assert np.all(energy[5000:] <= 1 + 1e-13)
    assert np.all(batch.v1 >= batch.v2 - 1e-15)
    assert np.all(batch.v2 >= -1e-15)
    np.testing.assert_allclose(batch.impulse1, 1 + batch.v1, atol=1e-14)


@pytest.mark.parametrize("name", BATCHES)
def test_a_path_keeps_momentum_gives_back_no_more_energy_than_it_took_and_ends_in_the_outcome(name):
    for settings, cell in itertools.product(SCENARIOS, CELLS):
        c = Collision.from_ratios(*cell)
        outcome = get_solver(name).solve(c, Settings(settings.scenario, settings.gravity, record_path=True))
        path, g = outcome.path, settings.gravity if settings.scenario == "drop" else 0.0
        falls = outcome.diagnostics.get("first_flight", np.inf)  # gravity acts until the first flight
        momentum = path.impulse1 - c.m1 * (path.v1 - c.v0 + g * np.minimum(path.time, falls))
        assert np.abs(momentum).max() < 1e-12, (settings, cell)
        # energy that each contact took from its bodies; within a short piece its rate is nearly a straight line
        taken = []
        for rate, impulse in ((path.v2 - path.v1, path.impulse1), (-path.v2, path.impulse2)):
            assert name == "linear-dashpot" or np.all(np.diff(impulse) >= -1e-12), (
                settings,
                cell,
            )  # contacts of the linear dashpot may pull
            taken.append(cumulative_trapezoid(rate, impulse))
            # a settled contact holds energy because of the weight
            assert g > 0 or taken[-1].min() >= -2e-3, cell
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
    assert set(cells.statuses) <= {"ok", "closed-form", "timeout", "unrepresentable"}
    np.testing.assert_array_equal(np.isnan(cells.v1), ~np.isin(cells.statuses, ("ok", "closed-form")))


def test_gravity_goes_away_at_first_order():
    numbers = 10.0 ** -np.arange(3, 8)
    for batch in (BATCHES["bistiffness"], BATCHES["kelvin-voigt"]):
        away = np.abs(batch(1.0, MU, 0.9, 0.7, numbers).v1 - batch(1.0, MU, 0.9, 0.7).v1)
        slopes = np.diff(np.log10(away)) / np.diff(np.log10(numbers))
        np.testing.assert_allclose(slopes[1:], 1, atol=0.02)


def test_a_path_that_ends_in_a_limit_is_finite():
    # The stiffness of unloading is k1/e1^2. A polynomial over the whole duration of the closed form would overflow.
    for e1 in (1e-17, 1e-70):
        collision = Collision.from_ratios(1.0, 0.2859933150104282, e1, 1.0)
        outcome = get_solver("bistiffness").solve(collision, Settings(record_path=True))
        assert outcome.status == "closed-form"
        for name in ("time", "impulse1", "impulse2", "v1", "v2"):
            assert np.isfinite(getattr(outcome.path, name)).all(), name
        assert outcome.path.v1[-1] == outcome.v1


@pytest.mark.parametrize("drop", [False, True], ids=["impact", "drop"])
def test_elastic_pairs_have_the_same_outcome_by_both_references(drop):
    kappa, mu, _, _ = random_cells(3000, 2)
    number = random_gravity(3000, 2) if drop else 0.0
    mine = BATCHES["bistiffness"](kappa, mu, 1.0, 1.0, number)
    other = BATCHES["kelvin-voigt"](kappa, mu, 1.0, 1.0, number)
    # If an elastic B1 is not thrown off by B2, it never comes to rest, and neither reference ends.
    ended = (mine.statuses == "ok") & (other.statuses == "ok")
    np.testing.assert_array_equal(mine.statuses == "timeout", other.statuses == "timeout")
    assert np.count_nonzero(ended) > 2900
    # A long drop has many contacts, which amplify rounding errors.
    calm = ended & (mine.diagnostics["n_steps"] < 60)
    for name in ("v1", "v2"):
        atol = 1e-11 if drop else 1e-12  # the fall of a ball that hardly leaves the other amplifies rounding
        np.testing.assert_allclose(getattr(mine, name)[calm], getattr(other, name)[calm], rtol=0, atol=atol)
    np.testing.assert_array_equal(mine.n_states[calm], other.n_states[calm])


def test_the_balls_are_apart_when_their_velocities_become_equal():
    """When the velocities become equal, the gap between the balls is that of the limit k2/k1 -> 0, to 2 %.

    B1 flies with the constant velocity v11. B2 swings on the table and reaches v2 = v11 at cos(theta) = v11/v21, in
    units of m2 = k2 = 1.
    """
    mu, e1, x = 0.5, 0.9, 1e5
    v11, v21 = (e1 * mu - 1) / (1 + mu), -(1 + e1) / (1 + mu)
    theta = math.acos(v11 / v21)
    asked = Collision.from_ratios(1 / x, mu, e1, 0.7)
    path = get_solver("bistiffness").solve(asked, Settings(record_path=True)).path
    rate = path.v1 - path.v2
    gap = cumulative_trapezoid(rate, path.time, initial=0) / math.sqrt(mu * x)
    parted = np.flatnonzero(rate[1:] * rate[:-1] < 0)
    at = parted[np.argmax(gap[parted])]
    assert gap[at] == pytest.approx(v11 * theta - v21 * math.sin(theta), rel=0.02)
