"""Maps of where the hypothesis is good enough, and the closed forms they are measured from."""

import math

import numpy as np
import pandas as pd
import pytest

from impact_xval.experiments.hypothesis.cases import (
    BY_KEY,
    Point,
    after_first_impact,
    closed_form,
    nearer_limit,
)
from impact_xval.experiments.hypothesis.maps import (
    contrast_needed,
    error_map,
    map_ratios,
    share_within,
    side_of,
)
from impact_xval.experiments.hypothesis.solvers import outcomes_of
from impact_xval.model import solve_batch

#: Away from e1 = 1, where the model has no limit, and from the borders of the regimes, which it reaches slowly.
MASSES, RESTITUTIONS = (0.2, 0.5, 1.6, 3.0, 8.0), ((0.9, 0.7), (0.5, 0.9), (0.8, 0.2))


def test_the_closed_form_is_where_the_model_goes():
    """At a finite ratio, its cut-off off: no closed form is asked."""
    kappa, mu = (a.ravel()[:, None] for a in np.meshgrid([1e-9, 1e9], MASSES))
    e1, e2 = np.transpose(RESTITUTIONS)
    kappa, mu, e1, e2 = np.broadcast_arrays(kappa, mu, e1, e2)
    model = solve_batch(kappa, mu, e1, e2, stiffness_ratio_cutoff=math.inf)
    assert {*model.statuses.ravel()} <= {"ok", "limit"}
    v1, v2 = nearer_limit(kappa, mu, e1, e2)
    assert model.v1 == pytest.approx(v1, abs=1e-7)
    assert model.v2 == pytest.approx(v2, abs=1e-7)


def test_the_closed_form_keeps_what_an_elastic_column_keeps():
    mu = np.geomspace(0.01, 100, 41)
    for kappa in (0.0, math.inf):
        v1, v2 = nearer_limit(kappa, mu, 1.0, 1.0)
        assert v1**2 + mu * v2**2 == pytest.approx(1, abs=1e-14)
        assert np.all((v1 >= v2) & (v2 >= 0))


def test_the_closed_form_has_the_value_that_is_printed():
    assert nearer_limit(0.0, 2 / math.sqrt(3), 0.9, 0.7)[0] == pytest.approx(0.45203, abs=1e-5)


def test_the_regimes_meet_at_their_borders():
    e1 = np.array([0.3, 0.9, 1.0])
    for border in (1 / e1, (1 + 0.7 * (1 + e1)) / e1):
        below, above = (np.array(nearer_limit(0.0, border * (1 + d), e1, 0.7)) for d in (-1e-12, 1e-12))
        assert below == pytest.approx(above, abs=1e-10)


def test_the_sides_and_the_regimes_are_told_apart_cell_by_cell():
    """One regime each, written out from the supplement: apart, early, late, and rigid table."""
    kappa, mu = np.array([0.5, 0.5, 0.5, 2.0]), np.array([8.0, 0.5, 1.2, 1.2])
    v1, v2 = nearer_limit(kappa, mu, 0.9, 0.7)
    v11, v21 = after_first_impact(8.0, 0.9)
    assert (v11, v21) == pytest.approx((6.2 / 9, -1.9 / 9))
    early = 0.7 * math.sqrt(1 + 0.5 * 0.81) / 1.5
    late = math.sqrt(0.08**2 + 1.2 * 0.49 * 1.9**2) / 2.2**1.5
    assert v1 == pytest.approx([6.2 / 9, early, late, 0.9], abs=1e-14)
    assert v2 == pytest.approx([0.7 * 1.9 / 9, early, late, 0.0], abs=1e-14)
    for i, key in enumerate(("zero-apart", "zero-early", "zero-late", "infinity")):
        form = closed_form(BY_KEY[key], Point(float(mu[i]), 0.9, 0.7))
        assert form == pytest.approx((v1[i], v2[i]), abs=1e-14)


#: A map of two mass ratios: the error falls with the contrast, but for a hump at k2/k1 = 100 of the second.
KAPPA = np.array([1e-3, 1e-2, 1e-1, 1e1, 1e2, 1e3])
ERROR = np.array([[0.001, 0.3], [0.01, 0.3], [0.1, 0.3], [0.1, 0.1], [0.01, 0.5], [math.nan, 0.01]])


def a_map(error=ERROR):
    k, m = map_ratios(KAPPA, np.array([0.5, 2.0]), 0.9, 0.7)[:2]
    return pd.DataFrame({"stiffness_ratio": k, "mass_ratio": m, "error": error.ravel()})


def side(error=ERROR, *, soft_table):
    return side_of(a_map(error), soft_table=soft_table)


def test_contrast_needed_holds_to_the_end_of_the_map():
    for mass, level, soft_table, contrast in (
        (0.5, 0.1, True, 1e1),
        (0.5, 0.05, True, 1e2),
        (0.6, 0.005, True, 1e3),
        (0.5, 0.0001, True, math.inf),
        (2.0, 0.05, True, math.inf),
        (1.9, 0.05, False, 1e3),
        (2.0, 0.2, False, 1e3),  # good at 10, not at 100: only what holds to the end counts
        (0.5, 0.2, False, math.inf),  # the last cell has no result: nothing is known of it
    ):
        found = contrast_needed(side(soft_table=soft_table), mass, level)
        assert found == pytest.approx(contrast), (mass, level, soft_table)


def test_share_within_counts_the_cells_with_a_result():
    assert share_within(side(soft_table=True), 0.1) == 3 / 6
    assert share_within(side(soft_table=False), 0.1) == 4 / 5
    assert share_within(side(soft_table=False), 1e-9) == 0
    assert math.isnan(share_within(side(np.full((6, 2), math.nan), soft_table=True), 0.1))


def test_a_map_measures_the_distance_and_says_why_where_there_is_none():
    kappa, masses = np.array([0.1, 10.0]), np.array([0.5, 3.0])
    ratios = map_ratios(kappa, masses, 0.9, 0.7)
    k, mu = ratios[:2]
    assert k.tolist() == [0.1, 0.1, 10, 10]
    assert mu.tolist() == [0.5, 3, 0.5, 3]
    v1, v2 = nearer_limit(k, mu, 0.9, 0.7)
    status = np.array(["ok", "limit", "crashed", "ok"])
    reason = np.array(["", "", "its process died: SIGSEGV", ""])
    found = error_map("planted", ratios, outcomes_of(v1 + 0.3, v2 + 0.4, status=status, reason=reason))
    expected = np.sqrt(0.09 + masses * 0.16)
    assert found.error.tolist() == pytest.approx([*expected, math.nan, expected[1]], nan_ok=True)
    assert (found.status[2], found.reason[2]) == ("crashed", "its process died: SIGSEGV")
