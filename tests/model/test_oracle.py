"""`solve` and `solve_batch` against the oracle, and the oracle against itself."""

import math

import numpy as np
import pytest

from impact_xval.compliant_baselines import (
    Settings,
    SolverError,
    get_solver,
    solver_names,
)
from impact_xval.model import (
    SUPPLEMENT_CUTOFF,
    Collision,
    solve,
    solve_batch,
)
from impact_xval.model.oracle import NODES, first_fall, series, solve_oracle, straight_first_step

#: Solver and oracle may part beside a jump of the model: where a rate turned around this near zero (per |v0|).
GRAZING = 1e-7

TOLERANCE = 1e-8

MASS_RATIO = 2 / math.sqrt(3)


def random_cells(n, seed):
    rng = np.random.default_rng(seed)
    return np.array(
        [
            10 ** rng.uniform(-2, 2, n),
            10 ** rng.uniform(-1, 1, n),
            rng.uniform(0.3, 1, n),
            rng.uniform(0.3, 1, n),
        ]
    )


#: Cut-offs of the model and of the oracle: the same, or none and one at which the oracle has converged.
CUTOFFS = [(SUPPLEMENT_CUTOFF, SUPPLEMENT_CUTOFF), ("exact", 1e8)]


def compare(cells, cutoff, of_oracle):
    """Assert agreement wherever the margin promises it; how many cells are beside a jump, and how many are limits."""
    batch = solve_batch(*cells, stiffness_ratio_cutoff=cutoff)
    grazing = limits = 0
    for i, cell in enumerate(cells.T.tolist()):
        collision = Collision.from_ratios(*cell)
        ours = solve(collision, stiffness_ratio_cutoff=cutoff)
        theirs = solve_oracle(collision, stiffness_ratio_cutoff=of_oracle)
        assert theirs.status in ("ok", "limit"), cell
        if ours.grazing_margin < GRAZING:
            grazing += 1
            continue
        limits += theirs.status == "limit"
        assert ours.status == batch.status[i] == theirs.status, cell
        for v1, v2 in ((ours.v1, ours.v2), (batch.v1[i], batch.v2[i])):
            assert v1 == pytest.approx(theirs.v1, abs=TOLERANCE, rel=0), cell
            assert v2 == pytest.approx(theirs.v2, abs=TOLERANCE, rel=0), cell
        if theirs.status == "ok":
            assert ours.states == theirs.states, cell
            assert ours.n_events == theirs.n_events, cell
    return grazing, limits


@pytest.mark.parametrize("cutoffs", CUTOFFS)
def test_sixty_random_cells(cutoffs):
    grazing, _ = compare(random_cells(60, seed=31), *cutoffs)
    assert grazing <= 1


@pytest.mark.parametrize("cutoffs", CUTOFFS)
@pytest.mark.parametrize(("e1", "e2"), [(1.0, 1.0), (1.0, 0.6), (0.6, 1.0)])
def test_elastic_contacts(e1, e2, cutoffs):
    ratios, masses = np.meshgrid([0.02, 0.7, 30.0], [0.3, 1.7])
    ones = np.ones(ratios.size)
    grazing, _ = compare(np.array([ratios.ravel(), masses.ravel(), e1 * ones, e2 * ones]), *cutoffs)
    assert grazing == 0


@pytest.mark.nightly
def test_two_thousand_random_cells():
    grazing, limits = compare(random_cells(2000, seed=7), *CUTOFFS[0])
    assert grazing <= 20
    assert limits > 300  # the closed form beyond the cut-off is compared too


@pytest.mark.nightly
def test_batch_is_solve_to_the_last_bits_on_a_hundred_thousand_cells():
    cells = random_cells(100_000, seed=8)
    batch = solve_batch(*cells)
    single = [solve(Collision.from_ratios(*cell)) for cell in cells.T.tolist()]
    for name in ("v1", "v2"):
        np.testing.assert_allclose(
            getattr(batch, name), [getattr(o, name) for o in single], rtol=0, atol=8e-16
        )
    np.testing.assert_array_equal(batch.status, [o.status for o in single])
    np.testing.assert_array_equal(batch.n_events, [o.n_events for o in single])
    np.testing.assert_array_equal(batch.n_states, [len(o.states) for o in single])
    np.testing.assert_allclose(
        batch.grazing_margin, [o.grazing_margin for o in single], rtol=1e-12, atol=1e-15
    )


@pytest.mark.parametrize(
    ("stiffness_ratio", "v1", "v2", "states"),
    [
        (40, 0.88981120733190, 0.00016910787873, "S1 S3 S1 S2 S4"),
        (1, 0.61394941925041, 0.20971952034697, "S1 S2 S1 S3 S4"),
        (1 / 40, 0.46187997174429, 0.43939196930137, "S1 S2 S1 S2 S1 S2 S1 S3 S4"),
    ],
)
def test_parameters_44_of_the_paper(stiffness_ratio, v1, v2, states):
    outcome = solve_oracle(Collision.from_ratios(stiffness_ratio, MASS_RATIO, 0.9, 0.7))
    assert outcome.v1 == pytest.approx(v1, abs=5e-11)
    assert outcome.v2 == pytest.approx(v2, abs=5e-11)
    assert outcome.states == tuple(states.split())
    assert outcome.diagnostics["energy_residual"] == pytest.approx(0, abs=1e-11)


def test_outcome_is_in_the_units_of_the_collision():
    outcome = solve_oracle(Collision(m1=2, m2=2 * MASS_RATIO, k1=3, k2=3, e1=0.9, e2=0.7, v0=-5))
    assert outcome.v1 == pytest.approx(5 * 0.61394941925041, abs=1e-9)
    assert outcome.impulse1 == pytest.approx(2 * (outcome.v1 + 5), rel=1e-14)
    assert outcome.impulse2 == pytest.approx(outcome.impulse1 + 2 * MASS_RATIO * outcome.v2, rel=1e-14)


@pytest.mark.parametrize(("stiffness_ratio", "mass_ratio"), [(0.05, 0.3), (1.0, 1.0), (60.0, 4.0)])
def test_series_leaves_a_residual_of_the_next_order(stiffness_ratio, mass_ratio):
    """The residual of (15), (dI2/dI1)^2 E1 - (k2/k1) E2, is of relative order I1^3."""
    scale = 1 / (1 + 1 / mass_ratio + stiffness_ratio / mass_ratio)
    steps = scale * np.array([0.02, 0.04, 0.08])
    residuals = []
    for I1 in steps.tolist():
        _, E1, E2 = series(stiffness_ratio, mass_ratio, I1)
        h = 1e-4 * I1
        after, before = (series(stiffness_ratio, mass_ratio, x)[0] for x in (I1 + h, I1 - h))
        slope = (after - before) / (2 * h)
        residuals.append(abs(slope * slope * E1 / (stiffness_ratio * E2) - 1))
    orders = np.diff(np.log2(residuals))
    np.testing.assert_allclose(orders, 3, atol=0.35)


def test_outcome_does_not_depend_on_where_the_series_is_left(monkeypatch):
    collision = Collision.from_ratios(1, MASS_RATIO, 0.9, 0.7)
    nominal = solve_oracle(collision)
    monkeypatch.setattr("impact_xval.model.oracle.SERIES_STEP", 1e-4)
    earlier = solve_oracle(collision)
    assert earlier.v1 == pytest.approx(nominal.v1, abs=1e-11)
    assert earlier.v2 == pytest.approx(nominal.v2, abs=1e-11)


@pytest.mark.parametrize("stiffness_ratio", [0.2, 1.0, 10.0])
def test_shift_by_the_finite_first_step_vanishes_with_it(stiffness_ratio):
    """E2 after the straight first step is off by its own order, I1^3, so the force sqrt(2 k2 E2) is by I1^(3/2)."""
    collision = Collision.from_ratios(stiffness_ratio, MASS_RATIO, 0.9, 0.7)
    exact = solve_oracle(collision)
    steps = np.array([1e-2, 1e-3, 1e-4])
    shifts = []
    for step in steps.tolist():
        outcome = solve_oracle(collision, first_step=step)
        assert outcome.states == exact.states
        shifts.append(math.hypot(outcome.v1 - exact.v1, outcome.v2 - exact.v2))
    slopes = np.diff(np.log(shifts)) / np.diff(np.log(steps))
    assert shifts[0] > 1e-6
    np.testing.assert_allclose(slopes, 1.5, atol=0.05)


def test_a_pair_of_roots_inside_a_step_is_found():
    dip = (NODES - 0.4) * (NODES - 0.4001)
    later = 0.5 - NODES
    fraction, which = first_fall(np.array([later, dip]), False)
    assert (fraction, which) == (pytest.approx(0.4, abs=1e-9), 1)


def test_what_triggered_the_last_event_is_not_found_again():
    rising = NODES - 1e-17
    assert first_fall(rising[None], True)[1] == -1
    assert first_fall(-rising[None], True) == (pytest.approx(0, abs=1e-15), 0)


def test_finite_first_step_has_the_limit_the_supplement_quotes():
    impulse2, _, _ = straight_first_step(1e12, MASS_RATIO, 1e-2)
    assert impulse2 == pytest.approx(1e-2, rel=1e-8)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"stiffness_ratio": 0}, "k2/k1 = 0"),
        ({"stiffness_ratio": math.inf}, "k2/k1 = inf"),
        ({"stiffness_ratio": 1e6}, "beyond the cut-off"),
        ({"e1": 0}, "e1 = 0"),
        ({"e2": 0}, "e2 = 0"),
    ],
)
def test_limits_are_refused_by_name(change, message):
    cell = {"stiffness_ratio": 1, "mass_ratio": 1, "e1": 0.5, "e2": 0.5} | change
    collision = Collision.from_ratios(**cell)
    with pytest.raises(ValueError, match=message):
        solve_oracle(collision)
    with pytest.raises(SolverError, match=message) as caught:
        get_solver("oracle").solve(collision, Settings(stiffness_ratio_cutoff=SUPPLEMENT_CUTOFF))
    assert caught.value.status == "unrepresentable"


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"stiffness_ratio_cutoff": 1}, "stiffness_ratio_cutoff = 1; legal"),
        ({"first_step": 0.0}, "first_step = 0.0; legal"),
        ({"first_step": 0.5}, "first_step = 0.5; legal"),
    ],
)
def test_illegal_options(options, message):
    with pytest.raises(ValueError, match=message):
        solve_oracle(Collision.from_ratios(1, 1, 0.5, 0.5), **options)


def test_too_many_steps_are_a_status():
    outcome = solve_oracle(Collision.from_ratios(1, 1, 0.5, 0.5), max_steps=5)
    assert outcome.status == "unconverged"
    assert math.isnan(outcome.v1)


def test_is_a_solver_on_request_only():
    assert "oracle" not in solver_names()
    assert "oracle" in solver_names(on_request=True)
    collision = Collision.from_ratios(40, MASS_RATIO, 0.9, 0.7)
    (outcome,) = get_solver("oracle").solve_many([collision], Settings())
    assert outcome.solver == "oracle"
    assert outcome.states == solve(collision).states
