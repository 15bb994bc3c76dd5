"""Rigid laws compared with the model at various stiffness ratios, as stated in docs/graphs.md, section 9."""

import math

import numpy as np
import pytest

from benchmarks.graph_laws import RATIOS, RIGID_LAWS, distance, least_error, model_outcomes, rigid_outcome

#: Velocities at k2/k1 = 4 and e = 1. The first ones are from an independent program, which uses closed forms between
#: events. The second ones follow from Newton's law by hand.
AT_FOUR = [
    (-0.12505621385901, 0.17606397047155),
    (-0.27697231803848, -0.47973012713277),
    (0.40202853189749, -0.69633384333878),
]
NEWTON = [(0.0, 0.2), (-0.2 * math.sqrt(3), -0.6), (0.2 * math.sqrt(3), -0.6)]


def test_d_agrees_with_velocities_of_an_independent_program():
    by_hand = math.sqrt(np.square(np.subtract(AT_FOUR, NEWTON)).sum())
    (found,) = distance(model_outcomes([4.0], 1.0), rigid_outcome("Newton", 1.0))
    assert math.isclose(found, by_hand, rel_tol=1e-10)


@pytest.mark.parametrize("e", [1.0, 0.7])
def test_laws_of_all_contacts_at_once_are_exact_at_equal_stiffnesses_and_mirrored_elsewhere(e):
    below, at, above = model_outcomes([0.2, 1.0, 5.0], e)
    for law in ("Newton", "Poisson", "generalised reflection"):
        answer = rigid_outcome(law, e)
        assert distance(at, answer) < 1e-12
        assert math.isclose(distance(below, answer), distance(above, answer), rel_tol=1e-9)


@pytest.mark.parametrize("e", [1.0, 0.7])
def test_single_impacts_are_the_limit_where_the_first_contact_is_much_stiffer(e):
    outcomes = model_outcomes([1e-2, 1e-3, 1e-4], e)
    falling = distance(outcomes, rigid_outcome("single impacts, contact 1 first", e))
    assert np.allclose(falling[1:] / falling[:-1], 0.1, rtol=0.05)
    assert falling[0] < 0.011


@pytest.mark.parametrize(("e", "least", "nearest"), [(1.0, 0.366, 0.1885), (0.7, 0.266, 0.1269)])
def test_no_law_without_stiffness_can_follow(e, least, nearest):
    outcomes = model_outcomes(RATIOS, e)
    assert least_error(outcomes) == pytest.approx(least, abs=5e-4)
    assert 2 * least_error(outcomes) == pytest.approx(float(distance(outcomes[0], outcomes[-1])), rel=1e-12)
    by_law = [distance(outcomes, rigid_outcome(law, e)) for law in RIGID_LAWS]
    assert all(over.max() >= least for over in by_law if over.max() > 0)
    assert np.min(by_law, axis=0).max() == pytest.approx(nearest, abs=5e-4)
