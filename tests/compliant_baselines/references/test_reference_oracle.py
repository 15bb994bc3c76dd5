"""The references against an independent integration (`column_oracle`)."""

import numpy as np
import pytest

from impact_xval.compliant_baselines.references.bistiffness import bistiffness_batch
from impact_xval.compliant_baselines.references.kelvin_voigt import dampings, kelvin_voigt_batch
from tests.compliant_baselines import column_oracle as oracle
from tests.compliant_baselines.reference_cells import random_cells, random_gravity

#: Segments beyond which a cell is left to the other tests: the oracle would take minutes.
LONGEST = 1500


def worst(law, n, seed, drop):
    """Largest difference of a velocity from the oracle, and the number of cells left out."""
    kappa, mu, e1, e2 = random_cells(n, seed)
    number = random_gravity(n, seed) if drop else np.zeros(n)
    g = number * np.sqrt(1 + 1 / mu)
    difference, left_out = 0.0, 0
    if law == "bistiffness":
        batch = bistiffness_batch(kappa, mu, e1, e2, number)
    else:
        batch = kelvin_voigt_batch(kappa, mu, e1, e2, number, damping=law)
        _, c1, c2 = dampings(law, kappa, mu, e1, e2)
    assert set(batch.status) <= {"ok", "limit"}
    for i in range(n):
        if batch.n_steps[i] > LONGEST:
            left_out += 1
            continue
        for finer in (1, 25):
            # The oracle can step over a pair of events where a force grazes zero. What remains at steps 25 times
            # shorter is a difference.
            if law == "bistiffness":
                answer, _ = oracle.bistiffness(kappa[i], mu[i], e1[i], e2[i], g[i], finer=finer)
            else:
                product = law == "hunt-crossley"
                answer = oracle.dashpots(kappa[i], mu[i], c1[i], c2[i], g[i], product=product, finer=finer)
            off = max(abs(answer.v1 - batch.v1[i]), abs(answer.v2 - batch.v2[i]))
            if off < 1e-9:
                break
        if law != "bistiffness":
            assert answer.end == batch.end[i]
            if answer.end == "stuck":  # certain before the energy has fallen so far
                assert batch.duration[i] < answer.duration + 1e-7
            else:
                assert answer.duration == pytest.approx(batch.duration[i], abs=1e-7)
        difference = max(difference, off)
    return difference, left_out


@pytest.mark.parametrize("drop", [False, True], ids=["impact", "drop"])
@pytest.mark.parametrize(("law", "n"), [("pair", 40), ("hunt-crossley", 25), ("bistiffness", 12)])
def test_a_few_random_cells(law, n, drop):
    difference, left_out = worst(law, n, 7, drop)
    assert difference < 1e-9
    assert left_out <= 1


@pytest.mark.nightly
@pytest.mark.parametrize("drop", [False, True], ids=["impact", "drop"])
@pytest.mark.parametrize("law", ["pair", "hunt-crossley", "bistiffness"])
def test_five_hundred_random_cells(law, drop):
    difference, left_out = worst(law, 500, 20240, drop)
    assert difference < 1e-9
    assert left_out <= 10


def test_the_oracle_itself_sees_a_wrong_damping():
    kappa, mu, e1, e2 = random_cells(1, 3)
    _, c1, c2 = dampings("pair", kappa, mu, e1, e2)
    right = oracle.dashpots(kappa[0], mu[0], c1[0], c2[0])
    wrong = oracle.dashpots(kappa[0], mu[0], c1[0] * (1 + 1e-6), c2[0])
    assert abs(right.v1 - wrong.v1) > 1e-8
