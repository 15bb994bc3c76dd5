"""The bistiffness reference against the model, against Kelvin-Voigt, and against itself."""

import math

import numpy as np
import pytest

from impact_xval.compliant_baselines import get_solver
from impact_xval.compliant_baselines.solver import Settings
from impact_xval.model import Collision
from tests.compliant_baselines.reference_cells import BATCHES, random_cells, random_gravity

MU = 2 / math.sqrt(3)


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
