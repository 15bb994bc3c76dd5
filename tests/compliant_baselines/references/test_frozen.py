"""References with frozen positions against the model; against an integration: test_reference_oracle.py."""

import math

import numpy as np
import pytest

from impact_xval.compliant_baselines.references.bistiffness import bistiffness_batch
from impact_xval.compliant_baselines.references.kelvin_voigt import dampings, kelvin_voigt_batch
from impact_xval.model import solve_batch
from tests.compliant_baselines import column_oracle as oracle
from tests.compliant_baselines.reference_cells import random_cells


def random_wide_cells(n, seed):
    rng = np.random.default_rng(seed)
    return (
        10 ** rng.uniform(-4, 4, n),
        10 ** rng.uniform(-2, 2, n),
        rng.uniform(0.05, 1, n),
        rng.uniform(0.05, 1, n),
    )


@pytest.mark.parametrize(
    "cells", [random_cells(5000, 31), random_wide_cells(5000, 32)], ids=["usual", "wide"]
)
def test_frozen_bistiffness_is_the_model(cells):
    model, frozen = (
        solve_batch(*cells, stiffness_ratio_cutoff=math.inf),
        bistiffness_batch(*cells, frozen=True),
    )
    free = bistiffness_batch(*cells)
    regular = model.grazing_margin >= 1e-5
    assert regular.mean() > 0.97
    off = np.hypot(frozen.v1 - model.v1, frozen.v2 - model.v2)
    assert off[regular].max() < 1e-9
    # which the free one is not
    assert np.mean(np.hypot(free.v1 - model.v1, free.v2 - model.v2) > 1e-3) > 0.2


def test_what_is_left_of_a_penetration_is_forgotten():
    # The spent dashpot of contact 1 lets go while the balls overlap; a free contact is met again with that overlap.
    cell = 0.4082560357, 1.8824229592, 0.3276377521, 0.9236459750
    _, c1, c2 = dampings("pair", *(np.array([x]) for x in cell))
    frozen, free = (kelvin_voigt_batch(*cell, frozen=f) for f in (True, False))
    for batch, is_frozen in ((frozen, True), (free, False)):
        answer = oracle.dashpots(*cell[:2], c1[0], c2[0], frozen=is_frozen)
        assert (batch.v1, batch.v2) == pytest.approx((answer.v1, answer.v2), abs=1e-10)
    assert math.hypot(frozen.v1 - free.v1, frozen.v2 - free.v2) > 1e-3
