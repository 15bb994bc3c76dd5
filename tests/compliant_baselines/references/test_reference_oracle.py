"""The references, free and with frozen positions, against an independent integration (`column_reference`)."""

import math

import numpy as np
import pytest

from impact_xval.model import Collision, solve_batch
from tests.compliant_baselines.reference_cells import BATCHES, dampings, end_of, random_cells, random_gravity
from tests.model.column_reference import integrate

#: Segments beyond which a cell is left to the other tests: the integration would take minutes.
LONGEST = 1500
LAWS = [("kelvin-voigt", 40), ("hunt-crossley", 25), ("bistiffness", 12)]


def compare(law, n, seed, drop, frozen=False):
    """Assert agreement; the number of cells left out, and of those in which contacts carried force again."""
    kappa, mu, e1, e2 = random_cells(n, seed)
    number = random_gravity(n, seed) if drop else np.zeros(n)
    g = number * np.sqrt(1 + 1 / mu)
    left_out = again = 0
    batch = BATCHES[law](kappa, mu, e1, e2, number, frozen=frozen)
    dashpots = dampings(law, kappa, mu, e1, e2).T
    assert set(batch.statuses) <= {"ok", "limit"}
    for i in range(n):
        if batch.diagnostics["n_steps"][i] > LONGEST and not frozen:
            left_out += 1
            continue
        column = Collision.from_ratios(*(float(each[i]) for each in (kappa, mu, e1, e2)))
        # The integration can step over a pair of events where a force grazes zero. What remains at steps 25 times
        # shorter is a difference.
        for resolution in (0.15,) if frozen else (0.15, 0.006):
            answer = integrate(column, law, dashpots[i], gravity=g[i], frozen=frozen, resolution=resolution)
            off = np.abs(np.subtract(answer.velocities, (batch.v1[i], batch.v2[i]))).max()
            if off < 1e-9:
                break
        assert off < 1e-9, i
        again += len(answer.states) > 3
        if answer.limit:  # bodies that became one have an end by a closed form
            continue
        assert answer.end == end_of(batch)[i]
        if answer.end == "stuck" and not frozen:  # certain before the energy has fallen so far
            assert batch.diagnostics["duration"][i] < answer.duration + 1e-7
        else:
            assert answer.duration == pytest.approx(batch.diagnostics["duration"][i], abs=1e-7)
    return left_out, again


@pytest.mark.parametrize("frozen", [False, True], ids=["free", "frozen"])
@pytest.mark.parametrize(("law", "n"), LAWS)
def test_random_cells_are_those_of_the_integration(law, n, frozen):
    for drop in (False, True):
        left_out, again = compare(law, n, 34 if frozen else 7, drop, frozen)
        assert left_out <= 1
        assert law == "bistiffness" or not frozen or again >= n // 5


@pytest.mark.nightly
@pytest.mark.parametrize("drop", [False, True], ids=["impact", "drop"])
@pytest.mark.parametrize(("law", "n"), [("kelvin-voigt", 500), ("hunt-crossley", 500)])
def test_more_random_cells_are_those_of_the_integration(law, n, drop):
    assert compare(law, n, 20240, drop)[0] <= n / 50


@pytest.mark.parametrize(
    "cells", [random_cells(5000, 31), random_cells(5000, 32, 0.05, (4, 2))], ids=["usual", "wide"]
)
def test_frozen_bistiffness_is_the_model(cells):
    model, frozen = (
        solve_batch(*cells, stiffness_ratio_cutoff=math.inf),
        BATCHES["bistiffness"](*cells, frozen=True),
    )
    free = BATCHES["bistiffness"](*cells)
    regular = model.grazing_margin >= 1e-5
    assert regular.mean() > 0.97
    off = np.hypot(frozen.v1 - model.v1, frozen.v2 - model.v2)
    assert off[regular].max() < 1e-9
    # which the free one is not
    assert np.mean(np.hypot(free.v1 - model.v1, free.v2 - model.v2) > 1e-3) > 0.2


@pytest.mark.parametrize("law", [law for law, _ in LAWS])
def test_frozen_is_free_where_no_contact_returns(law):
    frozen, free = (BATCHES[law](*random_cells(3000, 33), frozen=f) for f in (True, False))
    once = (frozen.n_states <= 3) & (free.n_states <= 3)  # with more, a contact that had ended acts again
    apart = np.hypot(frozen.v1 - free.v1, frozen.v2 - free.v2)
    assert once.sum() > 300
    assert apart[once].max() < 1e-12
    assert np.mean(apart[~once] > 1e-3) > 0.5


def test_the_lower_ball_comes_to_rest_while_its_dashpot_carries_nothing():
    cell, number = (1.036, 5.21, 0.8159, 0.308), 0.01818
    batch = BATCHES["kelvin-voigt"](*cell, number)
    (b,) = dampings("kelvin-voigt", *([x] for x in cell)).T
    answer = integrate(
        Collision.from_ratios(*cell), "kelvin-voigt", b, gravity=number * math.sqrt(1 + 1 / cell[1])
    )
    assert (answer.end, end_of(batch)) == ("rest", "rest")
    assert (batch.v1, batch.v2) == pytest.approx(answer.velocities, abs=1e-9)
    assert batch.diagnostics["duration"] == pytest.approx(answer.duration, abs=1e-7)
