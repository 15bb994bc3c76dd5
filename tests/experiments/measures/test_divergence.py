import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from impact_xval.compliant_baselines import get_solver
from impact_xval.compliant_baselines.solver import Convergence, Settings
from impact_xval.experiments.measures.divergence import (
    divergence,
    edit_distance,
    first_difference,
    measures_of,
    results_of,
)
from impact_xval.experiments.measures.hausdorff import distances
from impact_xval.experiments.tables.schema import MEASURES, Counts, expand_columns, names_of
from impact_xval.model import Collision, Outcome


def test_measures_by_hand():
    c = Collision.two_balls(m1=2.0, m2=8.0, k1=1.0, k2=1.0, e1=0.9, e2=0.7, v0=-5.0)
    model = Outcome("a", (3.0, 0.5), (16.0, 20.0), ("S1", "S2", "S4"))
    other = Outcome("b", (2.0, 1.0), (14.0, 22.0), ("S1", "S3", "S1", "S4"))
    speed = np.array([5.0])
    results = [results_of([each], speed, 2, 2, np.zeros(1)) for each in (model, other)]
    measures = divergence(np.array([c.masses]), np.array([c.velocities]), speed, *results)
    found = {name: values[0] for name, values in measures.items()}
    assert set(found) == set(names_of(expand_columns(MEASURES, Counts(2, 2))))
    assert found["dv1"] == pytest.approx(-1 / 5)
    assert found["dv2"] == pytest.approx(0.5 / 5)
    assert found["largest_dv"] == pytest.approx(1 / 5)
    # m1 dv1^2 + m2 dv2^2 = 2 + 2 = 4 J, divided by m1 v0^2 = 50 J
    assert found["velocity_divergence"] == pytest.approx(math.sqrt(4 / 50))
    assert found["dimpulse1"] == pytest.approx(-2 / 10)
    assert found["dimpulse2"] == pytest.approx(2 / 10)
    # twice the energy is m1 v0^2 = 50 before, and 2*9 + 8/4 = 20 and 2*4 + 8*1 = 16 after the collision
    assert found["dretained_energy"] == pytest.approx(16 / 50 - 20 / 50)
    assert found["states_equal"] is False
    assert found["states_differ_at"] == 2
    assert found["states_edit_distance"] == 2
    assert math.isnan(found["impulse_curve_distance"])


def test_a_pair_keeps_its_momentum_and_what_e_leaves_of_its_energy():
    pair = Collision((1.0, 3.0), (1e6,), (0.5,), (-2.0, 0.0))
    outcomes = {
        name: get_solver(name).solve(pair) for name in ("state-transition", "bistiffness", "kelvin-voigt")
    }
    for measures in measures_of(pair, outcomes).values():
        assert measures["retained_momentum"] == pytest.approx(1, abs=1e-12)
        assert measures["retained_energy"] == pytest.approx(0.25 + 0.75 * 0.25, abs=1e-12)
        assert measures["velocity_divergence"] == pytest.approx(0, abs=1e-12)


def test_the_limit_of_an_engine_is_held_against_its_law_without_the_model_too():
    chain, how = Collision((1, 1, 1), (1e8, 1e8), (0.9, 0.9), (-2, 0, 0)), Settings(convergence=Convergence())
    outcomes = {name: get_solver(name).solve(chain, how) for name in ("kelvin-voigt", "mujoco")}
    found = measures_of(chain, outcomes)["mujoco"]
    assert 0 < found["limit_distance"] < 3 * found["limit_error"] < 3e-3
    assert found["limit_error"] == outcomes["mujoco"].diagnostics["limit_error"] / 2
    assert math.isnan(found["velocity_divergence"])


def test_where_state_paths_part_and_by_how_many_edits():
    for a, b, position, edits in (
        ("", "", None, 0),
        ("13124", "13124", None, 0),
        ("1", "14", 2, 1),
        ("12124", "124", 3, 2),
        ("124", "", 1, 3),
        ("1314", "1214", 2, 1),
        ("1234", "2341", 1, 2),
    ):
        assert first_difference(a, b) == first_difference(b, a) == position, (a, b)
        assert edit_distance(a, b) == edit_distance(b, a) == edits, (a, b)


def hausdorff(a, b):
    ends = [np.array([0, len(points)]) for points in (a, b)]
    return distances(np.array(a, float), np.array(b, float), *ends)[0]


def test_hausdorff_by_hand():
    for a, b, expected in (
        ([(0, 0)], [(3, 4)], 5),
        ([(0, 0), (1, 0)], [(0, 1), (1, 1)], 1),
        ([(0, 0), (1, 0)], [(0, 0), (0.5, 0), (1, 0)], 0),
        ([(0, 0), (1, 0)], [(0, 0), (1, 0), (3, 0)], 2),
        # the point of the chord farthest from the corner's two legs is its middle, between vertices
        ([(0, 0), (2, 2)], [(0, 0), (2, 0), (2, 2)], math.sqrt(2)),
        # The middle of the chord is at a distance of 1 from the legs. Only the corner itself is farther away.
        ([(-1, 0), (1, 0)], [(-1, 0), (-1, 1), (1, 1), (1, 0)], 1),
        ([(0, 0), (0, 0), (1, 0)], [(0, 0), (1, 0), (1, 0)], 0),
    ):
        assert hausdorff(a, b) == pytest.approx(expected, abs=2e-9), (a, b)
        assert hausdorff(b, a) == pytest.approx(expected, abs=2e-9), (a, b)


def _dense(points, spacing):
    longest = max(np.hypot(*np.diff(points, axis=0).T), default=0.0)
    count = (len(points) - 1) * max(1, math.ceil(longest / spacing))
    at = np.linspace(0, len(points) - 1, count + 1)
    return np.column_stack([np.interp(at, np.arange(len(points)), x) for x in points.T])


def _brute(a, b, spacing):
    """Return the Hausdorff distance of densely sampled curves, which is exact to within `spacing`."""
    first, second = _dense(a, spacing), _dense(b, spacing)
    return max(cKDTree(second).query(first)[0].max(), cKDTree(first).query(second)[0].max())


@settings(max_examples=60)
@given(seed=st.integers(0, 2**32 - 1), monotone=st.booleans(), n=st.integers(1, 30), m=st.integers(1, 30))
def test_hausdorff_against_brute_force(seed, monotone, n, m):
    random = np.random.default_rng(seed)
    curves = [random.exponential(0.1, (size, 2)) * (random.random((size, 2)) < 0.7) for size in (n, m)]
    if not monotone:
        curves = [curve * random.choice([-1, 1], curve.shape) for curve in curves]
    a, b = (curve.cumsum(axis=0) for curve in curves)
    spacing = 1e-3
    assert hausdorff(a, b) == pytest.approx(_brute(a, b, spacing), abs=1.01 * spacing)
