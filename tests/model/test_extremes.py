"""Far corners of the parameters: k2/k1 over 24 decades, m2/m1 over 12, restitution to within 1e-12 of 0 and 1."""

import math

import numpy as np
import pytest

from impact_xval.model import Collision, solve, solve_batch


def extreme_cells(n, seed):
    rng = np.random.default_rng(seed)

    def restitution():
        e = rng.uniform(0, 1, n)
        kind = rng.uniform(0, 1, n)
        e[kind < 0.03] = 0
        e[(kind > 0.03) & (kind < 0.06)] = 1
        tiny = (kind > 0.06) & (kind < 0.10)
        e[tiny] = 10 ** rng.uniform(-12, 0, tiny.sum())
        nearly = (kind > 0.10) & (kind < 0.13)
        e[nearly] = 1 - 10 ** rng.uniform(-12, -1, nearly.sum())
        return e

    return 10 ** rng.uniform(-12, 12, n), 10 ** rng.uniform(-6, 6, n), restitution(), restitution()


@pytest.mark.slow
@pytest.mark.parametrize("cutoff", [1e5, "exact", math.inf])
def test_no_corner_fails(cutoff):
    """Every cell is answered or says why not; the balls part; energy never grows and its balance closes."""
    cells = extreme_cells(20_000, seed=1)
    batch = solve_batch(*cells, stiffness_ratio_cutoff=cutoff, max_events=20_000)
    done = batch.status != "unconverged"
    # Given up are only collisions all but elastic at one contact, which take more events than were allowed.
    assert np.all(batch.n_events[~done] > 20_000)
    assert np.all(np.maximum(cells[2], cells[3])[~done] > 0.99)
    assert np.mean(done) > 0.97
    assert np.all(np.isfinite(batch.v1[done]))
    assert np.all((batch.v1 >= batch.v2)[done])
    assert np.all(batch.v2[done] >= 0)
    energy = batch.v1**2 + cells[1] * batch.v2**2
    assert np.max(energy[done]) <= 1 + 1e-11
    # The balance closes to rounding; where the cut-off was used, to what it drops.
    ok = done & (batch.status == "ok")
    assert np.max(np.abs(batch.energy_residual[ok])) < 1e-10
    assert np.min(batch.energy_residual[done]) > -1e-10
    assert np.max(batch.energy_residual[done]) < (1e-4 if cutoff == 1e5 else 1e-10)


def test_elastic_collision_with_thousands_of_state_changes():
    """Both contacts elastic, the ball-ball one 1e8 times stiffer: energy is kept through every one of them."""
    batch = solve_batch(1e-8, 1.3, 1.0, 1.0, stiffness_ratio_cutoff=math.inf)
    assert batch.n_events > 3000
    assert batch.v1**2 + 1.3 * batch.v2**2 == pytest.approx(1, abs=1e-11)


@pytest.mark.parametrize("mass_ratio", [1e20, 1e100, 1e149])
def test_a_very_heavy_lower_ball_is_hit_and_then_hits_the_table(mass_ratio):
    """One impact after the other: I1 = 1 + e1, which is all of B2's momentum, and I2 = (1 + e2) I1."""
    outcome = solve(Collision.from_ratios(40.0, mass_ratio, 0.9, 0.7))
    assert (outcome.impulse1, outcome.impulse2) == pytest.approx((1.9, 1.7 * 1.9), rel=1e-9)


@pytest.mark.parametrize("mass_ratio", [1e-151, 1e151, 1e200, 1e308])
def test_what_double_precision_cannot_tell_is_refused_and_not_answered_wrongly(mass_ratio):
    outcome, batch = (
        solve(Collision.from_ratios(40.0, mass_ratio, 0.9, 0.7)),
        solve_batch(40.0, mass_ratio, 0.9, 0.7),
    )
    assert outcome.status == batch.status == "unrepresentable"
    assert f"m2/m1 = {mass_ratio:g}" in outcome.reason
    assert np.isnan([batch.v1, batch.v2, batch.energy_residual]).all()
