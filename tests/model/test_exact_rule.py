"""Cut-offs of the stiffness ratio.

The default rule is compared with outcomes without a cut-off. The stated effect of a cut-off is compared with the change
when the cut-off is switched off. Outcomes are marked beside a jump and where a cut-off matters, but never by a law
without jumps.
"""

import math

import numpy as np
import pytest

from impact_xval.model import SUPPLEMENT_CUTOFF, Collision, solve, solve_batch
from impact_xval.model.inputs import GRAZING_THRESHOLD
from impact_xval.model.marks import CUTOFF, CUTOFF_THRESHOLD, GRAZING
from impact_xval.model.pair.limits import BOUND
from tests.compliant_baselines.reference_cells import random_cells
from tests.model.chain_reference import LZB, integrate
from tests.model.oracle import solve_oracle

#: k2/k1, m2/m1, e1 and e2 of a cell whose outcome the supplement's cut-off changes by 0.19. The ringing contact between
#: the balls takes v2 through zero once more, so that the contact with the table loses energy once more. `VALUE` is v1 =
#: v2 in m/s, by two independent integrations.
CELL = 0.0015084387939204636, 0.52750555599096, 0.8331581428053493, 0.5341764334383219
VALUE = 0.21817817381416

#: Ranges of random cells: smallest e, then the decades of k2/k1 and of m2/m1 on either side of 1. "errata" is the range
#: of docs/errata.md, "default" that of the default run.
BOXES = {"errata": (0.3, (2, 1)), "wide": (0.05, (6, 2)), "default": (0.5, (3, math.log10(2)))}


def difference(one, other, mu):
    return np.hypot(one.v1 - other.v1, np.sqrt(mu) * (one.v2 - other.v2))


@pytest.mark.parametrize("box", BOXES)
@pytest.mark.parametrize("n", [4_000, pytest.param(400_000, marks=pytest.mark.nightly)])
def test_outcomes_are_those_without_a_cutoff(n, box):
    cells = random_cells(n, 1, *BOXES[box])
    exact, without = solve_batch(*cells), solve_batch(*cells, stiffness_ratio_cutoff=math.inf)
    off = np.maximum(abs(exact.v1 - without.v1), abs(exact.v2 - without.v2))
    marked = exact.marked
    assert np.array_equal(exact.statuses, without.statuses)
    assert np.mean(exact.statuses == "closed-form") > 0.3
    assert np.mean(marked) < 1e-3
    assert np.max(np.abs(exact.diagnostics["energy_residual"])) < 1e-11
    assert np.max(off[~marked]) < 1e-10
    assert np.max(off[marked], initial=0.0) < 1e-9


def test_a_ringing_contact_that_ends_another_compression_is_followed():
    c = Collision.from_ratios(*CELL)
    for cutoff in (1e7, 1e9):
        theirs = solve_oracle(c, stiffness_ratio_cutoff=cutoff)
        assert (theirs.v1, theirs.v2) == pytest.approx((VALUE, VALUE), abs=1e-10)
    assert integrate(c).velocities == pytest.approx((VALUE, VALUE), abs=1e-10)
    outcome, without = solve(c), solve(c, stiffness_ratio_cutoff=math.inf)
    assert outcome.velocities == pytest.approx((VALUE, VALUE), abs=1e-12)
    assert (outcome.status, outcome.mark) == ("closed-form", "")
    assert difference(outcome, without, c.mass_ratio) < 10 * BOUND
    assert "to 1e-12" in outcome.reason


def test_a_cutoff_whose_effect_is_not_known_marks_the_outcome():
    # An elastic contact would vibrate 1e10 times here. That is more than the solver follows, so the effect is unknown.
    outcome = solve(Collision.from_ratios(1e-20, 1.3, 1.0, 0.7), stiffness_ratio_cutoff=1e5, max_events=1_000)
    assert (outcome.status, outcome.mark) == ("closed-form", CUTOFF)


@pytest.mark.parametrize(("box", "cutoff"), [("errata", 1e3), *((box, SUPPLEMENT_CUTOFF) for box in BOXES)])
def test_the_stated_effect_of_a_cutoff_is_the_change_when_it_is_switched_off_and_marks(box, cutoff):
    cells = random_cells(20_000, 1, *BOXES[box])
    with_it = solve_batch(*cells, stiffness_ratio_cutoff=cutoff)
    change = difference(with_it, solve_batch(*cells, stiffness_ratio_cutoff=math.inf), cells[1])
    used, effect = with_it.statuses == "closed-form", with_it.diagnostics["cutoff_effect"]
    assert used.mean() > 0.2
    assert not np.any([effect[~used], change[~used]])
    assert np.max(effect) > 1e-8
    assert np.max(np.abs(effect - change)) < 1e-11
    marked = np.char.find(with_it.marks.astype(str), CUTOFF) >= 0
    assert np.max(change[~marked]) < CUTOFF_THRESHOLD + 1e-11
    assert np.min(change[marked]) > CUTOFF_THRESHOLD - 1e-11


def test_a_cutoff_has_no_effect_on_exact_limits():
    for kappa, e1, e2 in ((0.0, 0.9, 0.7), (math.inf, 0.9, 0.7), (1.0, 0.0, 0.7), (1.0, 0.9, 0.0)):
        c = Collision.from_ratios(kappa, 1.3, e1, e2)
        outcome, without = solve(c), solve(c, stiffness_ratio_cutoff=math.inf)
        assert (outcome.status, outcome.velocities) == ("closed-form", without.velocities)
    assert "cutoff_effect" not in solve_batch(1.0, 1.0, 0.9, 0.9).diagnostics


def test_a_law_without_jumps_is_marked_for_none():
    cells = random_cells(60_000, 3)
    here, there = solve_batch(*cells), solve_batch(*cells, law=LZB)
    near = np.flatnonzero(here.grazing_margin < 2e-4)
    assert len(near) > 20
    assert np.isinf(there.grazing_margin).all()
    assert not there.marked.any()
    assert np.array_equal(here.marks == GRAZING, here.grazing_margin < GRAZING_THRESHOLD)
    # a change of k2/k1 by 1e-5 beside a jump of the other law changes v1 by less than 1e-3
    some = [x[near] for x in cells]
    moved = solve_batch(some[0] * (1 + 1e-5), *some[1:], law=LZB)
    assert np.abs(moved.v1 - there.v1[near]).max() < 1e-3
