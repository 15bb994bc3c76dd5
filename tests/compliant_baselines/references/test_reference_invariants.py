"""What holds for every reference: Theorem 5, energy, one answer singly and in bulk, a consistent record."""

import math

import numpy as np
import pytest

from impact_xval.compliant_baselines import get_solver
from impact_xval.compliant_baselines.contact.restitution_laws import damping_ratio
from impact_xval.compliant_baselines.contract.solver import Settings
from impact_xval.compliant_baselines.references.bistiffness import bistiffness_batch
from impact_xval.compliant_baselines.references.kelvin_voigt import kelvin_voigt_batch
from impact_xval.model import Collision
from tests.compliant_baselines.reference_cells import random_cells

BATCHES = {
    "bistiffness": bistiffness_batch,
    "kelvin-voigt": kelvin_voigt_batch,
    "kelvin-voigt-anchored": lambda *a: kelvin_voigt_batch(*a, damping="anchored"),
    "kelvin-voigt-textbook": lambda *a: kelvin_voigt_batch(*a, damping="textbook"),
    "hunt-crossley": lambda *a: kelvin_voigt_batch(*a, damping="hunt-crossley"),
}
CELLS = [tuple(map(float, cell)) for cell in zip(*random_cells(25, 21), strict=True)]
SCENARIOS = [Settings(), Settings(scenario="drop", gravity=0.05), Settings(scenario="drop", gravity=0.3)]


def gravity_number(c, settings):
    g = settings.gravity if settings.scenario == "drop" else 0.0
    return g / (-c.v0 * math.sqrt(c.k1 * (1 / c.m1 + 1 / c.m2)))


@pytest.mark.parametrize("name", BATCHES)
@pytest.mark.parametrize("settings", SCENARIOS, ids=["impact", "drop", "low drop"])
def test_single_and_batch_are_one_mathematics(name, settings):
    for cell in CELLS:
        c = Collision.from_ratios(*cell)
        one = get_solver(name).solve(c, settings)
        cells = BATCHES[name](*cell, gravity_number(c, settings))
        # gravity goes through a product and a quotient on its way to a number: an ulp or two, amplified
        assert one.v1 == pytest.approx(float(cells.v1), abs=1e-11)
        assert one.v2 == pytest.approx(float(cells.v2), abs=1e-11)
        assert one.impulse1 == pytest.approx(float(cells.impulse1), abs=1e-10)
        assert one.impulse2 == pytest.approx(float(cells.impulse2), abs=1e-10)
        assert one.states[-32:] == cells.states(())
        assert (len(one.states), one.n_events) == (cells.n_states, cells.n_events)


@pytest.mark.parametrize("name", BATCHES)
@pytest.mark.parametrize("drop", [False, True], ids=["impact", "drop"])
@pytest.mark.parametrize("scale", ["stiffness", "mass", "velocity"])
def test_theorem_5(name, drop, scale):
    for kappa, mu, e1, e2 in CELLS[:10]:
        c = Collision.from_ratios(kappa, mu, e1, e2)
        s = {"stiffness": (1, 7, 1), "mass": (3, 1, 1), "velocity": (1, 1, 5)}[scale]
        other = Collision(s[0], s[0] * mu, s[1], s[1] * kappa, e1, e2, -float(s[2]))
        # with gravity, g/(|v0| omega1) is a fifth number: scaled along
        g = 0.05 * s[2] * math.sqrt(s[1] / s[0])
        scenario = "drop" if drop else "impact"
        solver = get_solver(name)
        a = solver.solve(c, Settings(scenario=scenario, gravity=0.05))
        b = solver.solve(other, Settings(scenario=scenario, gravity=g))
        assert b.v1 / s[2] == pytest.approx(a.v1, abs=1e-11)
        assert b.v2 / s[2] == pytest.approx(a.v2, abs=1e-11)
        assert b.impulse2 / (s[0] * s[2]) == pytest.approx(a.impulse2, abs=1e-10)
        assert b.states == a.states


@pytest.mark.parametrize("name", BATCHES)
def test_energy_never_grows_and_the_balls_part(name):
    cells = random_cells(20_000, 8, lowest_e=0.02)
    batch = BATCHES[name](*cells)
    assert set(batch.status) <= {"ok", "limit"}
    assert np.all(batch.retained_energy <= 1 + 1e-13)
    assert np.all(batch.v1 >= batch.v2 - 1e-15)
    assert np.all(batch.v2 >= -1e-15)
    np.testing.assert_allclose(batch.impulse1, 1 + batch.v1, atol=1e-14)


@pytest.mark.parametrize("name", BATCHES)
def test_elastic_collisions_keep_their_energy(name):
    kappa, mu, _, _ = random_cells(5000, 9)
    np.testing.assert_allclose(BATCHES[name](kappa, mu, 1.0, 1.0).retained_energy, 1, atol=2e-13)


@pytest.mark.parametrize("name", BATCHES)
@pytest.mark.parametrize("settings", SCENARIOS, ids=["impact", "drop", "low drop"])
def test_energy_falls_along_the_path(name, settings):
    for cell in CELLS:
        c = Collision.from_ratios(*cell)
        outcome = get_solver(name).solve(c, Settings(settings.scenario, settings.gravity, record_path=True))
        path, g = outcome.path, settings.gravity if settings.scenario == "drop" else 0.0
        falls = outcome.diagnostics.get("first_flight", np.inf)  # the bodies fall until then
        flown = np.diff(np.minimum(path.time, falls))
        # Heights from the path itself; in each short piece the velocity is nearly a parabola.
        x = [np.concatenate([[0], np.cumsum(0.5 * flown * (v[1:] + v[:-1]))]) for v in (path.v1, path.v2)]
        energy = 0.5 * path.v1**2 + 0.5 * c.m2 * path.v2**2 + path.energy1 + path.energy2
        energy = energy + g * (x[0] + c.m2 * x[1])
        slip = 1e-12 if g == 0 else 2e-3
        assert np.diff(energy).max() < slip
        momentum = path.impulse1 - c.m1 * (path.v1 - c.v0 + g * np.minimum(path.time, falls))
        assert np.abs(momentum).max() < 1e-12


def test_energies_are_finite_where_the_square_of_the_velocity_is_not():
    """A drop so slow that v0^2 underflows: the table's contact carries the lower ball's weight to begin with."""
    c = Collision(1.0, 1.5, 1e8, 1e8, 0.9, 0.7, -1e-300)
    path = get_solver("kelvin-voigt").solve(c, Settings("drop", 9.81, record_path=True)).path
    assert path.energy2[0] == pytest.approx((c.m2 * 9.81) ** 2 / (2 * c.k2), rel=1e-12)
    assert np.isfinite([path.energy1, path.energy2]).all()


@pytest.mark.parametrize(("m1", "v0"), [(1e300, -1e-170), (1e-300, -1e160)])
def test_energies_scale_where_the_square_of_the_velocity_leaves_double_precision(m1, v0):
    energies = []
    for mass, speed in ((1.0, -1.0), (m1, v0)):
        c = Collision(mass, 1.5 * mass, mass, 2 * mass, 0.9, 0.7, speed)
        path = get_solver("kelvin-voigt").solve(c, Settings(record_path=True)).path
        energies.append(np.array([path.energy1, path.energy2]) / (mass * abs(speed)) / abs(speed))
    assert energies[0].max() > 0.1
    np.testing.assert_allclose(energies[1], energies[0], rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("name", BATCHES)
def test_the_record_is_consistent(name):
    for cell in CELLS:
        c = Collision.from_ratios(*cell)
        outcome = get_solver(name).solve(c, Settings(record_path=True))
        path = outcome.path
        assert np.all(np.diff(path.time) >= -1e-15 * path.time[-1])
        assert outcome.n_events == sum(e.kind != "limit" for e in outcome.events)
        times = [e.time for e in outcome.events]
        assert times == sorted(times)
        states = [f"S{s}" for s, before in zip(path.state, [0, *path.state], strict=False) if s != before]
        assert tuple(states if states[-1] == "S4" else [*states, "S4"]) == outcome.states
        last = path.v1[-1], path.v2[-1], path.impulse1[-1], path.impulse2[-1]
        assert last == pytest.approx((outcome.v1, outcome.v2, outcome.impulse1, outcome.impulse2), abs=1e-12)


@pytest.mark.parametrize("name", ["bistiffness", "kelvin-voigt"])
def test_velocities_do_not_jump(name):
    """v1 changes by no more than the largest force does meanwhile: the energy is at most that of the impact."""
    for cell in CELLS:
        c = Collision.from_ratios(*cell)
        outcome = get_solver(name).solve(c, Settings(record_path=True))
        if outcome.status == "limit":  # a closed form took over
            continue
        if name == "bistiffness":
            n = sum((e.kind, e.contact) == ("end-of-compression", 1) for e in outcome.events)
            factor = c.e1**-n  # of the root of the stiffness
        else:  # the dashpot's share, at a rate of at most |v1| + |v2|
            factor = 1 + 2 * damping_ratio(c.e1) * math.sqrt(c.reduced_mass) * (1 + 1 / math.sqrt(c.m2))
        path = outcome.path
        jumps = np.abs(np.diff(path.v1))
        assert np.all(jumps <= factor * np.diff(path.time) * (1 + 1e-9) + 1e-14)  # m1 = k1 = |v0| = 1


@pytest.mark.parametrize("name", ["bistiffness", "kelvin-voigt", "hunt-crossley"])
@pytest.mark.parametrize("ratio", [1e-9, 1e-6, 1e6, 1e9])
def test_extremes_end(name, ratio):
    batch = BATCHES[name](ratio, [0.01, 1.0, 100.0], 0.8, 0.6)
    assert set(batch.status) <= {"ok", "limit"}
    if ratio > 1:
        # k2/k1 to infinity: v2 = 0, and v1 = e1 where a contact keeps its restitution whatever the mass
        np.testing.assert_allclose(batch.v2, 0, atol=0.02)
    if name == "bistiffness" and ratio == 1e9:
        np.testing.assert_allclose(batch.v1, 0.8, atol=0.01)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("ratio", "number"),
    [
        (1e-15, 0.1),
        (1e300, 0),
        *(pytest.param(*far, marks=pytest.mark.nightly) for far in ((1e-300, 0), (1e-15, 0), (1e15, 0.1))),
    ],
)
def test_beyond_double_precision_a_cell_ends_with_a_status(ratio, number):
    for batch in BATCHES.values():
        cells = batch(ratio, [1e-3, 1.0, 1e3], [1.0, 0.999, 1e-3], 0.5, number)
        assert set(cells.status) <= {"ok", "limit", "timeout"}
        np.testing.assert_array_equal(np.isnan(cells.v1), cells.status == "timeout")


def test_gravity_goes_away_at_first_order():
    numbers = 10.0 ** -np.arange(3, 8)
    for batch in (bistiffness_batch, kelvin_voigt_batch):
        v1 = batch(1.0, 2 / math.sqrt(3), 0.9, 0.7, numbers).v1
        difference = np.abs(v1 - batch(1.0, 2 / math.sqrt(3), 0.9, 0.7).v1)
        slopes = np.diff(np.log10(difference)) / np.diff(np.log10(numbers))
        np.testing.assert_allclose(slopes[1:], 1, atol=0.02)
