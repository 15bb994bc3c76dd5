"""References with frozen positions: against the model, against the free ones, against an independent integration."""

import math
from itertools import pairwise

import numpy as np
import pytest

from impact_xval.compliant_baselines.references.bistiffness import bistiffness_batch
from impact_xval.compliant_baselines.references.kelvin_voigt import dampings, kelvin_voigt_batch
from impact_xval.model import solve_batch
from tests.compliant_baselines import column_oracle as oracle
from tests.compliant_baselines.reference_cells import random_cells, random_gravity

LAWS = {
    "bistiffness": bistiffness_batch,
    **{
        name: lambda *cells, name=name, **options: kelvin_voigt_batch(*cells, damping=name, **options)
        for name in ("pair", "hunt-crossley")
    },
}


def random_wide_cells(n, seed):
    rng = np.random.default_rng(seed)
    return (
        10 ** rng.uniform(-4, 4, n),
        10 ** rng.uniform(-2, 2, n),
        rng.uniform(0.05, 1, n),
        rng.uniform(0.05, 1, n),
    )


def returns(batch):
    """Whether a contact that had no force has one again; True of paths too long to tell."""
    found = batch.n_states > 32
    for i in np.flatnonzero(~found):
        acts = [{"S1": {1, 2}, "S2": {2}, "S3": {1}, "S4": set()}[name] for name in batch.states(int(i))]
        found[i] = any(after - before for before, after in pairwise(acts))
    return found


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


@pytest.mark.parametrize(
    ("law", "drop"),
    [("bistiffness", False), ("bistiffness", True), ("pair", False), ("hunt-crossley", False)],
)
def test_frozen_is_free_where_no_contact_returns(law, drop):
    # Not so of a dashpot in a drop: its bodies overlap for a while when the force has ended, and fall.
    cells = random_cells(3000, 33)
    number = random_gravity(3000, 33) if drop else 0.0
    frozen, free = (LAWS[law](*cells, number, frozen=f) for f in (True, False))
    once = ~returns(frozen) & ~returns(free)
    assert once.sum() > 300
    assert np.hypot(frozen.v1 - free.v1, frozen.v2 - free.v2)[once].max() < 1e-12
    assert np.mean(np.hypot(frozen.v1 - free.v1, frozen.v2 - free.v2)[~once] > 1e-3) > 0.5


@pytest.mark.parametrize("drop", [False, True], ids=["impact", "drop"])
@pytest.mark.parametrize(("law", "n"), [("pair", 40), ("hunt-crossley", 25), ("bistiffness", 12)])
def test_against_an_independent_integration(law, n, drop):
    kappa, mu, e1, e2 = random_cells(n, 34)
    number = random_gravity(n, 34) if drop else np.zeros(n)
    g = number * np.sqrt(1 + 1 / mu)
    batch = LAWS[law](kappa, mu, e1, e2, number, frozen=True)
    again = 0
    for i in range(n):
        one = kappa[i], mu[i]
        if law == "bistiffness":
            answer, _ = oracle.bistiffness(*one, e1[i], e2[i], g[i], frozen=True)
        else:
            _, c1, c2 = dampings(law, *(x[i : i + 1] for x in (kappa, mu, e1, e2)))
            answer = oracle.dashpots(*one, c1[0], c2[0], g[i], product=law == "hunt-crossley", frozen=True)
            assert answer.end == batch.end[i]
            assert answer.duration == pytest.approx(batch.duration[i], abs=1e-7)
            again += len(answer.pushes) > 3
        assert (answer.v1, answer.v2) == pytest.approx((batch.v1[i], batch.v2[i]), abs=1e-9)
    assert law == "bistiffness" or again >= n // 5


def test_every_collision_ends_parted():
    cells = random_wide_cells(3000, 35)
    for law in LAWS:
        for number in (0.0, random_gravity(3000, 35)):
            batch = LAWS[law](*cells, number, frozen=True)
            assert set(batch.status) <= {"ok", "limit"}, law
            assert np.all(batch.v1 >= batch.v2 - 1e-12), law
            assert np.all(batch.v2 >= -1e-12), law
            assert np.all(batch.retained_energy <= 1 + 1e-12), law


def test_what_is_left_of_a_penetration_is_forgotten():
    # The spent dashpot of contact 1 lets go while the balls overlap; a free contact is met again with that overlap.
    cell = 0.4082560357, 1.8824229592, 0.3276377521, 0.9236459750
    _, c1, c2 = dampings("pair", *(np.array([x]) for x in cell))
    frozen, free = (kelvin_voigt_batch(*cell, frozen=f) for f in (True, False))
    for batch, is_frozen in ((frozen, True), (free, False)):
        answer = oracle.dashpots(*cell[:2], c1[0], c2[0], frozen=is_frozen)
        assert (batch.v1, batch.v2) == pytest.approx((answer.v1, answer.v2), abs=1e-10)
    assert math.hypot(frozen.v1 - free.v1, frozen.v2 - free.v2) > 1e-3
