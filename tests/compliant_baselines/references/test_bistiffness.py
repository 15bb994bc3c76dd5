"""The bistiffness reference against the model, against Kelvin-Voigt, and against itself."""

import math

import numpy as np
import pytest

from impact_xval.compliant_baselines import get_solver
from impact_xval.compliant_baselines.contract.solver import Settings
from impact_xval.compliant_baselines.references.bistiffness import bistiffness_batch
from impact_xval.compliant_baselines.references.kelvin_voigt import kelvin_voigt_batch
from impact_xval.model import Collision, solve
from tests.compliant_baselines.reference_cells import random_cells, random_gravity

MU = 2 / math.sqrt(3)
CELLS = list(zip(*random_cells(150, 11), strict=True))


def both(kappa, mu, e1, e2):
    c = Collision.from_ratios(kappa, mu, e1, e2)
    return get_solver("bistiffness").solve(c), solve(c, stiffness_ratio_cutoff=math.inf, path=True)


def test_equals_the_model_where_no_contact_returns():
    compared = 0
    for cell in CELLS:
        reference, model = both(*cell)
        if any(e.kind == "return" for e in (*reference.events, *model.events)):
            continue
        compared += 1
        assert reference.v1 == pytest.approx(model.v1, abs=1e-10)
        assert reference.v2 == pytest.approx(model.v2, abs=1e-10)
        assert reference.states == model.states
    assert compared >= 20


def test_equals_the_model_up_to_the_first_return():
    compared = 0
    for cell in CELLS:
        reference, model = both(*cell)
        for mine, other in zip(reference.events, model.events, strict=False):
            if "return" in (mine.kind, other.kind) or mine.kind == "limit":
                break
            assert (mine.kind, mine.contact) == (other.kind, other.contact)
            for name in ("time", "impulse1", "impulse2", "v1", "v2"):
                assert getattr(mine, name) == pytest.approx(getattr(other, name), abs=1e-8)
            compared += 1
    assert compared > 300


@pytest.mark.parametrize("ratio", [4, 5, 10, 40, 100])
def test_elastic_collisions_without_return_are_the_model_s(ratio):
    reference, model = both(ratio, MU, 1, 1)
    assert (reference.v1, reference.v2) == (
        pytest.approx(model.v1, abs=1e-12),
        pytest.approx(model.v2, abs=1e-12),
    )


def test_elastic_collisions_with_a_return_are_not():
    reference, model = both(1, MU, 1, 1)
    assert (model.v1, model.v2) == (pytest.approx(0.945115, abs=6e-7), pytest.approx(0.304065, abs=6e-7))
    assert (reference.v1, reference.v2) == (
        pytest.approx(0.954509, abs=6e-7),
        pytest.approx(0.277489, abs=6e-7),
    )


@pytest.mark.parametrize("drop", [False, True], ids=["impact", "drop"])
def test_elastic_both_references_are_the_same_system(drop):
    kappa, mu, _, _ = random_cells(3000, 2)
    number = random_gravity(3000, 2) if drop else 0.0
    mine = bistiffness_batch(kappa, mu, 1.0, 1.0, number)
    other = kelvin_voigt_batch(kappa, mu, 1.0, 1.0, number)
    # An elastic B1 that B2 does not throw off never comes to rest: neither reference ends.
    ended = (mine.status == "ok") & (other.status == "ok")
    np.testing.assert_array_equal(mine.status == "timeout", other.status == "timeout")
    assert np.count_nonzero(ended) > 2900
    # Long drops amplify rounding by their many contacts.
    calm = ended & (mine.n_steps < 60)
    for name in ("v1", "v2"):
        atol = (
            1e-11 if drop else 1e-12
        )  # the way down of a ball that hardly leaves the other amplifies rounding
        np.testing.assert_allclose(getattr(mine, name)[calm], getattr(other, name)[calm], rtol=0, atol=atol)
    np.testing.assert_array_equal(mine.sequence[calm], other.sequence[calm])


def test_velocities_do_not_depend_on_where_a_contact_counts_as_rigid():
    kappa, mu, e1, e2 = random_cells(4000, 4)
    kept = bistiffness_batch(kappa, mu, e1, e2)
    limited = kept.status == "limit"
    assert 0.1 < np.mean(limited) < 0.4
    errors = []
    for ratio in (1e6, 1e8, 1e20):
        other = bistiffness_batch(kappa, mu, e1, e2, rigid_ratio=ratio)
        assert set(other.status) <= {"ok", "limit"}
        errors.append(max(np.abs(other.v1 - kept.v1).max(), np.abs(other.v2 - kept.v2).max()))
    # at least first order in the inverse of the ratio
    assert 30 < errors[0] / errors[1] < 10_000
    assert errors[2] < 1e-12


def test_contacts_that_bounce_rigid_together_end_at_rest():
    # B2 hammered between B1 and the table
    batch = bistiffness_batch(0.0238100735, 1.8035984528, 0.2385805087, 0.0274028867, max_steps=20_000)
    assert (batch.status, batch.end, batch.v1, batch.v2) == ("limit", "free", 0.0, 0.0)


def test_a_contact_returns_where_its_bodies_parted():
    c = Collision.from_ratios(1 / 40, MU, 0.9, 0.7)
    outcome = get_solver("bistiffness").solve(c, Settings(record_path=True))
    path = outcome.path
    parted, returned = (next(e for e in outcome.events if e.kind == k and e.contact == 1) for k in
                        ("end-of-restitution", "return"))  # fmt: skip
    between = (path.time >= parted.time) & (path.time <= returned.time)
    t, rate = path.time[between], (path.v1 - path.v2)[between]
    gap = np.concatenate([[0.0], np.cumsum(np.diff(t) * 0.5 * (rate[1:] + rate[:-1]))])
    assert gap.max() > 1  # far apart in between
    assert abs(gap[-1]) < 0.02 * gap.max()  # the trapezium rule on nine points a segment
    assert returned.v1 < returned.v2


def test_an_end_of_compression_loses_what_the_law_says():
    c = Collision.from_ratios(5, MU, 0.9, 0.7)
    outcome = get_solver("bistiffness").solve(c, Settings(record_path=True))
    path = outcome.path
    at = next(e for e in outcome.events if e.kind == "end-of-compression" and e.contact == 2).time
    before, after = (path.energy2[path.time == at][i] for i in (0, -1))
    assert after / before == pytest.approx(0.49, rel=1e-9)


@pytest.mark.parametrize("bad", [1.0, 0.0, math.nan])
def test_illegal_rigid_ratio(bad):
    with pytest.raises(ValueError, match="rigid_ratio"):
        bistiffness_batch(1.0, 1.0, 0.5, 0.5, rigid_ratio=bad)


@pytest.mark.parametrize("e1", [1e-17, 1e-30, 1e-70])
def test_a_path_that_ends_in_a_limit_is_finite(e1):
    # Stiffness of unloading k1/e1^2: a polynomial over the limit's duration would leave double precision.
    collision = Collision.from_ratios(1.0, 0.2859933150104282, e1, 1.0)
    (outcome,) = get_solver("bistiffness").solve_many([collision], Settings(record_path=True))
    assert outcome.status == "limit"
    assert outcome.path is not None
    for name in ("time", "impulse1", "impulse2", "v1", "v2", "energy1", "energy2"):
        assert np.isfinite(getattr(outcome.path, name)).all(), name
    assert outcome.path.v1[-1] == outcome.v1


@pytest.mark.parametrize(
    ("changed", "says"), [({"e2": 0.0}, "e2 = 0: no finite stiffness"), ({"k1": 0.0}, "k1 = 0.0 N/m: a")]
)
def test_what_it_refuses_it_refuses_for_a_reason_of_its_own(changed, says):
    c = Collision(
        **({"m1": 1.0, "m2": 1.0, "k1": 1e5, "k2": 1e5, "e1": 0.8, "e2": 0.6, "v0": -1.0} | changed)
    )
    (outcome,) = get_solver("bistiffness").solve_many([c], Settings())
    assert outcome.status == "unrepresentable"
    assert outcome.reason.startswith(says)
    assert "damp" not in outcome.reason
    assert "dashpot" not in outcome.reason
    (engine,) = get_solver("kelvin-voigt").solve_many([c], Settings())
    assert "dashpot" in engine.reason
