"""The state paths in bulk against those of single collisions, told in names."""

import numpy as np
import pytest

from impact_xval.compliant_baselines.contract.state_transition import model_paths
from impact_xval.model import Collision, solve


def named(code, n):
    return tuple(f"S{1 + (int(code) >> 2 * (n - 1 - i) & 3)}" for i in range(n))


@pytest.mark.parametrize("cutoff", [1e5, 30.0, "exact"])
def test_paths_are_those_of_single_collisions(cutoff):
    rng = np.random.default_rng(4)
    kappa, mu = 10 ** rng.uniform(-3, 3, 400), 10 ** rng.uniform(-2, 2, 400)
    e1, e2 = rng.uniform(0, 1, (2, 400))
    kappa[:3], e1[3:6], e2[6:9] = [0, np.inf, 1], 0, 1
    sequence, n_states = model_paths(kappa, mu, e1, e2, cutoff)
    longest = 0
    for i, row in enumerate(zip(kappa, mu, e1, e2, strict=True)):
        states = solve(Collision.from_ratios(*map(float, row)), stiffness_ratio_cutoff=cutoff).states
        assert n_states[i] == len(states)
        assert named(sequence[i], min(len(states), 32)) == states[-32:]
        longest = max(longest, len(states))
    assert longest > 4


def test_of_a_path_beyond_32_states_the_last_are_kept():
    """As of a light ball between a heavy one and a soft table, all but elastic."""
    row = 1e-3, 0.1, 0.99, 0.99
    states = solve(Collision.from_ratios(*row), stiffness_ratio_cutoff=np.inf).states
    assert len(states) > 32
    (code,), (n,) = model_paths(*(np.array([x]) for x in row), np.inf)
    assert n == len(states)
    assert named(code, 32) == states[-32:]


def test_a_path_that_is_too_long_to_follow_has_none():
    row = (np.array([x]) for x in (1e-12, 1.0, 1.0, 1.0))
    _, n_states = model_paths(*row, np.inf)
    assert n_states.tolist() == [0]
