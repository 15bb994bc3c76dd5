"""Far corners of the parameters: k2/k1 over 24 decades, m2/m1 over 12, restitution to within 1e-12 of 0 and 1."""

import math

import numpy as np
import pytest

from model import solve_batch


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
@pytest.mark.parametrize("cutoff", [1e5, math.inf])
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
