"""The law of Liu, Zhao and Brogliato, as integrated, against known numbers and against the model."""

import math

import pytest

from impact_xval.model import Collision, solve
from tests.compliant_baselines.impulse_law_oracle import integrate

MU = 2 / math.sqrt(3)


@pytest.mark.parametrize(("ratio", "v1", "v2"), [(1, 0.61485, 0.20654), (0.2, 0.58053, 0.27214)])
def test_known_numbers(ratio, v1, v2):
    answer = integrate(ratio, MU, 0.9, 0.7, original_stiffness=True)
    assert (answer.v1, answer.v2) == (pytest.approx(v1, abs=5e-6), pytest.approx(v2, abs=5e-6))
    assert max(answer.compressions) > 1


def test_is_the_model_until_a_contact_compresses_again():
    answer = integrate(5, MU, 0.9, 0.7, original_stiffness=True)
    model = solve(Collision.from_ratios(5, MU, 0.9, 0.7))
    assert answer.compressions == (1, 1)
    assert (answer.v1, answer.v2) == (pytest.approx(model.v1, abs=1e-11), pytest.approx(model.v2, abs=1e-11))


@pytest.mark.parametrize("ratio", [0.2, 1, 40])
def test_with_the_present_stiffness_it_is_the_model(ratio):
    answer = integrate(ratio, MU, 0.9, 0.7, original_stiffness=False)
    model = solve(Collision.from_ratios(ratio, MU, 0.9, 0.7))
    assert max(answer.compressions) > 1
    assert (answer.v1, answer.v2) == (pytest.approx(model.v1, abs=1e-10), pytest.approx(model.v2, abs=1e-10))
    assert answer.states == model.states
