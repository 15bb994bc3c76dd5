"""The default rule against the outcome without a cut-off; what a cut-off changes is stated and marked."""

import math

import numpy as np
import pytest

from impact_xval.model import SUPPLEMENT_CUTOFF, Collision, solve, solve_batch
from impact_xval.model.inputs import GRAZING_THRESHOLD
from impact_xval.model.pair.grazing import CUTOFF, CUTOFF_THRESHOLD, GRAZING
from impact_xval.model.pair.limits import BOUND
from tests.model.column_reference import integrate
from tests.model.oracle import solve_oracle

#: The supplement's cut-off changes the outcome of this cell by 0.19: a ringing ball-ball contact takes v2 through zero
#: once more, and the ball-table contact loses energy once more. The value is that of two integrations.
CELL = 0.0015084387939204636, 0.52750555599096, 0.8331581428053493, 0.5341764334383219
VALUE = 0.21817817381416

#: Of k2/k1 and m2/m1 the decades, of e the least: the box of docs/errata.md, a wide one and that of the default run.
BOXES = {
    "errata": ((-2, 2), (-1, 1), 0.3),
    "wide": ((-6, 6), (-2, 2), 0.05),
    "default": ((-3, 3), (math.log10(0.5), math.log10(2)), 0.5),
}


def random_cells(box, n, seed):
    rng = np.random.default_rng(seed)
    kappa, mu, least = BOXES[box]
    return 10 ** rng.uniform(*kappa, n), 10 ** rng.uniform(*mu, n), *rng.uniform(least, 1, (2, n))


def compare(box, n, seed):
    """Largest difference from the outcome without a cut-off, outside marked cells and in them."""
    cells = random_cells(box, n, seed)
    exact, without = solve_batch(*cells), solve_batch(*cells, stiffness_ratio_cutoff=math.inf)
    off = np.maximum(abs(exact.v1 - without.v1), abs(exact.v2 - without.v2))
    marked = exact.marked != ""
    assert np.array_equal(exact.statuses, without.statuses)
    assert np.mean(exact.statuses == "limit") > 0.3
    assert np.mean(marked) < 1e-3
    assert np.max(np.abs(exact.diagnostics["energy_residual"])) < 1e-11
    return np.max(off[~marked]), np.max(off[marked], initial=0.0)


@pytest.mark.parametrize("n", [4_000, pytest.param(400_000, marks=pytest.mark.nightly)])
def test_outcomes_are_those_without_a_cutoff(n):
    for box in BOXES:
        outside, inside = compare(box, n, seed=1)
        assert outside < 1e-10, box
        assert inside < 1e-9, box


def test_a_ringing_contact_that_ends_another_compression_is_followed():
    for cutoff in (1e7, 1e9):
        theirs = solve_oracle(Collision.from_ratios(*CELL), stiffness_ratio_cutoff=cutoff)
        assert (theirs.v1, theirs.v2) == pytest.approx((VALUE, VALUE), abs=1e-10)
    in_time = integrate(Collision.from_ratios(*CELL))
    assert in_time.velocities == pytest.approx((VALUE, VALUE), abs=1e-10)
    outcome, batch = solve(Collision.from_ratios(*CELL)), solve_batch(*CELL)
    for answer in (outcome, batch):
        assert (answer.v1, answer.v2) == pytest.approx((VALUE, VALUE), abs=1e-12)
        assert answer.marked == ""
    assert (outcome.status, batch.statuses) == ("limit", "limit")
    stated = solve(Collision.from_ratios(*CELL), cutoff_effect=True).diagnostics["cutoff_effect"]
    assert stated < 10 * BOUND
    assert "to 1e-12" in outcome.reason


def test_an_outcome_is_marked_exactly_where_it_depends_on_its_cutoff():
    for box in BOXES:
        cells = random_cells(box, 20_000, seed=3)
        cut = solve_batch(*cells, stiffness_ratio_cutoff=SUPPLEMENT_CUTOFF)
        without = solve_batch(*cells, stiffness_ratio_cutoff=math.inf)
        off = np.hypot(cut.v1 - without.v1, np.sqrt(cells[1]) * (cut.v2 - without.v2))
        marked = np.char.find(cut.marked.astype(str), CUTOFF) >= 0
        assert np.max(off[~marked]) < CUTOFF_THRESHOLD + 1e-11, box
        assert np.min(off[marked]) > CUTOFF_THRESHOLD - 1e-11, box


def test_a_cutoff_whose_effect_is_not_known_marks_the_outcome():
    # 1e10 vibrations of an elastic contact are more than are followed.
    outcome = solve(Collision.from_ratios(1e-20, 1.3, 1.0, 0.7), stiffness_ratio_cutoff=1e5, max_events=1_000)
    assert outcome.status == "limit"
    assert outcome.marked == CUTOFF


def test_beside_a_jump_an_outcome_is_marked():
    cells = random_cells("errata", 400_000, seed=4)
    batch = solve_batch(*cells)
    marked = batch.marked == GRAZING
    assert np.array_equal(marked, batch.grazing_margin < GRAZING_THRESHOLD)
    assert marked.any()
    for i in np.flatnonzero(marked)[:5]:
        outcome = solve(Collision.from_ratios(*(float(a[i]) for a in cells)))
        assert outcome.marked == GRAZING


def test_the_stated_effect_of_a_cutoff_is_the_change_when_it_is_switched_off():
    cells = random_cells("errata", 10_000, 1)
    without = solve_batch(*cells, stiffness_ratio_cutoff=math.inf)
    for cutoff in (1e3, 1e5):
        with_it = solve_batch(*cells, stiffness_ratio_cutoff=cutoff, cutoff_effect=True)
        change = np.hypot(with_it.v1 - without.v1, np.sqrt(cells[1]) * (with_it.v2 - without.v2))
        used = with_it.statuses == "limit"
        assert used.mean() > 0.2
        assert np.all(with_it.diagnostics["cutoff_effect"][~used] == 0)
        assert np.all(change[~used] == 0)
        assert np.max(with_it.diagnostics["cutoff_effect"]) > 1e-8
        assert np.max(np.abs(with_it.diagnostics["cutoff_effect"] - change)) < 1e-11


def test_a_cutoff_has_no_effect_on_exact_limits():
    for kappa, e1, e2 in ((0.0, 0.9, 0.7), (math.inf, 0.9, 0.7), (1.0, 0.0, 0.7), (1.0, 0.9, 0.0)):
        outcome = solve(Collision.from_ratios(kappa, 1.3, e1, e2), cutoff_effect=True)
        assert (outcome.status, outcome.diagnostics["cutoff_effect"]) == ("limit", 0.0)
    assert "cutoff_effect" not in solve_batch(1.0, 1.0, 0.9, 0.9).diagnostics
