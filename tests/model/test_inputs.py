import math

import numpy as np
import pytest

from impact_xval.model import Collision, solve_batch
from impact_xval.model.inputs import Legal, broadcast_inputs


def test_arrays_are_broadcast_and_flat_in_the_order_given():
    extra = Legal("wind", -1.0, 1.0, "from -1 to 1")
    shape, arrays = broadcast_inputs([[1], [2]], 3, [0.1, 0.2, 0.3], 1, (extra, -1))
    assert shape == (2, 3)
    np.testing.assert_array_equal(
        arrays, [[1, 1, 1, 2, 2, 2], [3] * 6, [0.1, 0.2, 0.3] * 2, [1] * 6, [-1] * 6]
    )


def test_limits_are_legal():
    _, (kappa, mu, *_) = broadcast_inputs([0, math.inf], [5e-324, 1e308], 0, 1)
    assert kappa.tolist() == [0, math.inf]
    assert mu.tolist() == [5e-324, 1e308]
    assert broadcast_inputs([], 1, 1, 1)[0] == (0,)


@pytest.mark.parametrize(
    ("given", "says"),
    [
        (([1, -1, -2], 1, 1, 1), r"stiffness_ratio = -1\.0; legal: from 0 to inf \(k2/k1\)"),
        ((math.nan, 1, 1, 1), r"stiffness_ratio = nan; legal: from 0 to inf"),
        ((1, 0, 1, 1), r"mass_ratio = 0\.0; legal: a finite number > 0 \(m2/m1\)"),
        ((1, math.inf, 1, 1), r"mass_ratio = inf; legal: a finite number > 0"),
        ((1, 1, 1.5, 1), r"e1 = 1\.5; legal: from 0 to 1"),
        ((1, 1, 1, [0.5, math.nan]), r"e2 = nan; legal: from 0 to 1"),
        (("much", 1, 1, 1), r"stiffness_ratio = 'much': not an array of numbers; legal: from 0"),
    ],
)
def test_what_is_illegal_is_named_as_by_a_single_collision(given, says):
    with pytest.raises(ValueError, match=says):
        broadcast_inputs(*given)
    with pytest.raises(ValueError, match=says):
        solve_batch(*given)
    if given[0] == 1 and np.ndim(given[3]) == 0:
        with pytest.raises(ValueError, match=says):
            Collision.from_ratios(*given)
