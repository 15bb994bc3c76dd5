"""What the solvers do in the limits, against closed forms that share nothing with them."""

import math
from itertools import product

import numpy as np
import pytest

from benchmarks import misses
from impact_xval.compliant_baselines import get_solver
from impact_xval.compliant_baselines.solver import Settings
from impact_xval.experiments.hypothesis.cases import BY_KEY, CASES, MARGIN, Point, closed_form, draw
from impact_xval.experiments.hypothesis.config import parse
from impact_xval.experiments.hypothesis.mechanism import (
    POINTS,
    RANGE,
    count_branches,
    end_share,
    mean_more_ends,
    observe,
)
from impact_xval.experiments.hypothesis.predictions import (
    FAMILIES,
    Contacts,
    TableContact,
    dashpot_restitution,
    hunt_crossley_restitution,
    predict,
    rigid_on_soft,
)
from impact_xval.experiments.hypothesis.run import contrasts, ratios_of
from impact_xval.experiments.hypothesis.solvers import model_batch, under_test
from impact_xval.experiments.hypothesis.verdicts import Series, examine
from impact_xval.model import Collision, solve
from tests.model.oracle import solve_oracle

CONFIG = parse({"points": 12}, "test")

#: Verdict by limit: of the model, bistiffness, the three dashpots (pair, anchored, textbook) and Hunt-Crossley.
SOLVERS = ("state-transition", *FAMILIES)
EXPECTED = {
    "zero-apart": ("supported", "supported", "supported", "refuted", "refuted", "refuted"),
    "zero-early": ("undecided", "refuted", "refuted", "refuted", "refuted", "refuted"),
    "zero-late": ("supported", "refuted", "refuted", "refuted", "refuted", "refuted"),
    "infinity": ("supported", "supported", "refuted", "supported", "refuted", "supported"),
    "plastic-ball-ball": ("supported", "supported", "refuted", "refuted", "refuted", "refuted"),
    "plastic-ball-table": ("supported", "refuted", "refuted", "refuted", "refuted", "refuted"),
}


def examined(solver, case, seed, points=12):
    one = under_test(solver, CONFIG.steps)
    x = contrasts(CONFIG, case, one)
    drawn = tuple(draw(case, points, seed))
    return examine(Series(one, case, drawn, x, one.solve(*ratios_of(case, drawn, x))), CONFIG.fit_decades)


def test_the_closed_forms_are_the_models_limits():
    """Written out here and in `model.pair.limits`; the plastic ones are the model's own."""
    for case, point in ((each, one) for each in CASES for one in draw(each, 12, 3)):
        ratio = {"k1/k2": 0.0, "k2/k1": math.inf}.get(case.variable)
        if ratio is None:
            continue
        outcome = solve(Collision.from_ratios(ratio, point.mass_ratio, point.e1, point.e2))
        assert (outcome.v1, outcome.v2) == pytest.approx(closed_form(case, point), abs=1e-13)


def test_the_design_fills_every_class_and_keeps_away_from_borders():
    for case in CASES:
        points = draw(case, 24, 9)
        assert points == draw(case, 24, 9)
        assert points != draw(case, 24, 10)
        assert len(points) == 24
        for point in points:
            if case.key.startswith("zero"):
                v11 = (point.e1 * point.mass_ratio - 1) / (1 + point.mass_ratio)
                united = v11 < 0 or point.e2 * (1 + point.e1) / (1 + point.mass_ratio) > v11
                assert abs(v11) >= MARGIN
                assert united == (case.key != "zero-apart")


@pytest.mark.parametrize("solver", SOLVERS[:5])
def test_verdicts(solver):
    for case in CASES:
        found = examined(solver, case, CONFIG.seed).whole
        assert found.verdict == found.shifted.verdict == EXPECTED[case.key][SOLVERS.index(solver)], case.key


@pytest.mark.nightly
@pytest.mark.parametrize("solver", SOLVERS)
def test_verdicts_hold_when_the_design_is_redrawn_and_the_fit_shifted(solver):
    for case, seed in product(CASES, (2, 77)):
        found = examined(solver, case, seed, points=24).whole
        assert found.verdict == found.shifted.verdict == EXPECTED[case.key][SOLVERS.index(solver)], case.key


@pytest.mark.parametrize("solver", FAMILIES[:4])
def test_the_refuted_limits_are_those_predicted_without_a_simulation(solver):
    for case in (BY_KEY["zero-early"], BY_KEY["zero-late"], BY_KEY["infinity"]):
        for result in examined(solver, case, 11).whole.members:
            if result.judgement.verdict == "refuted":
                assert result.missed < 2e-3, case.key
                assert result.missed < 0.2 * result.judgement.offset, case.key


def test_three_single_impacts_in_sequence():
    """k2/k1 -> 0 and v11 >= 0: bistiffness reaches it at first order."""
    point = Point(2 / math.sqrt(3), 0.9, 0.7)
    mu = point.mass_ratio
    v1, v2 = -1.0, 0.0  # 1: balls; 2: table; 3: balls
    for _ in range(2):
        impulse = mu / (1 + mu) * 1.9 * (v2 - v1)
        v1, v2 = v1 + impulse, v2 - impulse / mu
        v2 = -0.7 * v2 if v2 < 0 else v2
    predicted = predict(BY_KEY["zero-late"], point, "bistiffness")
    assert (predicted.v1, predicted.v2) == pytest.approx((v1, v2), abs=1e-14)
    off = []
    for x in (1e4, 1e5):
        o = get_solver("bistiffness").solve(Collision.from_ratios(1 / x, mu, 0.9, 0.7))
        off.append(math.hypot(o.v1 - v1, o.v2 - v2))
    assert off[0] / off[1] == pytest.approx(10, rel=0.01)


def test_hard_contact_conserves_energy_when_everything_is_elastic():
    for mu in (0.25, 0.5, 0.9):
        v11, v21 = (mu - 1) / (1 + mu), -2 / (1 + mu)
        v1, v2 = rigid_on_soft(mu, 1.0, v11, v21, TableContact(0.0, 1.0))
        assert v1 * v1 + mu * v2 * v2 == pytest.approx(1, abs=1e-12)
        assert v1 >= v2 >= 0


def test_hard_contact_of_a_plastic_pair_is_one_body():
    mu, e2 = 0.5, 0.7
    v = -1 / (1 + mu)
    v1, v2 = rigid_on_soft(mu, 0.0, v, v, TableContact(0.0, e2))
    assert v1 == v2 == pytest.approx(-e2 * v, abs=1e-9)


def test_what_a_law_restores():
    for e in (0.3, 0.7, 0.95):
        a = Contacts("hunt-crossley", 2.0, e, e)
        assert a.ball_ball(5.0, 1.0) == pytest.approx(e, abs=1e-10)  # at |v0|, against any mass
        assert a.ball_ball(5.0, 0.1) > e  # slower is more elastic
        pair = Contacts("kelvin-voigt", 2.0, e, e)
        assert pair.ball_ball(2 / 3, 1.0) == pytest.approx(e, abs=1e-12)
        assert pair.ball_ball(1.0, 1.0) > e
        assert Contacts("kelvin-voigt-anchored", 2.0, e, e).ball_ball(1.0, 1.0) == pytest.approx(e, abs=1e-12)
    assert hunt_crossley_restitution(0.0, 1.0) == 1
    assert dashpot_restitution(0.2, 1.0, 4.0) > dashpot_restitution(0.2, 1.0, 1.0)


def test_the_model_has_no_limit_where_the_ringing_decides():
    """Shares of a second end of compression against the closed form, and one outcome of each kind by the oracle."""
    for mu in (0.25, 0.6):
        found = count_branches(Point(mu, 1.0, 0.7), seed=4)
        assert found.elsewhere == 0
        assert abs(found.measured - end_share(mu, 2)) < 2 * found.uncertainty
        assert found.measured > 3 * found.uncertainty
    assert end_share(1.0, 2) == 0
    once = 0.7 / math.sqrt(1.3)
    for x, v in ((1000, once), (1500, 0.7 * once)):
        c = Collision.from_ratios(1 / x, 0.3, 1.0, 0.7)
        assert solve_oracle(c, stiffness_ratio_cutoff=math.inf).v1 == pytest.approx(v, abs=5e-3)
        assert solve(c, stiffness_ratio_cutoff=math.inf).v1 == pytest.approx(v, abs=5e-3)


def test_the_lighter_b2_the_more_ends_of_compression_it_makes():
    """Shares of every number of ends; below m2/m1 = 0.121 the closed form itself is never reached."""
    for mu in (0.25, 0.125, 0.08, 0.05, 0.03):
        shares_are_those_of_the_closed_form(mu)
    assert mean_more_ends(0.121) > 1 > mean_more_ends(0.1215)


def shares_are_those_of_the_closed_form(mu):
    e2, count = 0.7, 1000
    x = np.exp(np.random.default_rng(4).uniform(*np.log(RANGE), count))
    v1 = model_batch(1 / x, *(np.full(count, value) for value in (mu, 1.0, e2))).v1
    ends = 1 + np.log(v1 * math.sqrt(1 + mu) / e2) / math.log(e2)
    assert np.abs(ends - np.round(ends)).max() < 0.01
    shares = [end_share(mu, n) for n in range(1, 6)]
    assert sum(shares) == pytest.approx(1, abs=1e-12)
    assert np.dot(shares, range(5)) == pytest.approx(mean_more_ends(mu), abs=1e-12)
    for n, share in enumerate(shares, start=1):
        assert np.mean(np.round(ends) == n) == pytest.approx(share, abs=0.045 if share else 0)


def test_an_outcome_after_a_third_end_is_not_counted_as_one_after_two():
    for e2 in (0.3, 0.7):
        found = count_branches(Point(0.08, 1.0, e2), seed=4)
        assert abs(found.measured - found.predicted) < 2 * found.uncertainty
        assert found.elsewhere == pytest.approx(end_share(0.08, 3), abs=2 * found.uncertainty)


def test_the_gap_when_velocities_are_equal_is_the_closed_form():
    """B1 flies with v11, B2 swings on the table: v2 = v11 at cos(theta) = v11/v21 (k2/k1 -> 0)."""
    point = POINTS["zero-early"]
    mu, e1 = point.mass_ratio, point.e1
    v11, v21 = (e1 * mu - 1) / (1 + mu), -(1 + e1) / (1 + mu)
    theta = math.acos(v11 / v21)
    gap = v11 * theta - v21 * math.sin(theta)  # per |v0| sqrt(m2/k2)
    found, _ = observe("bistiffness", "zero-early", 1e5)
    assert found.joined_at == pytest.approx(theta / math.pi, rel=0.02)
    # `separation` is per largest compression of the table contact, which the later impacts set: undo it.
    path = (
        get_solver("bistiffness")
        .solve(Collision.from_ratios(1e-5, mu, e1, point.e2), Settings(record_path=True))
        .path
    )
    step = np.diff(path.time, prepend=0)
    x2 = np.cumsum(step * 0.5 * (path.v2 + np.concatenate([path.v2[:1], path.v2[:-1]])))
    deepest = -x2.min() / math.sqrt(mu * 1e5)
    assert found.gap_then * deepest == pytest.approx(gap, rel=0.02)


def test_in_time_the_pair_parts_and_in_the_model_it_does_not():
    for case in ("zero-early", "zero-late"):
        model, _ = observe("state-transition", case, 1e4)
        law, _ = observe("bistiffness", case, 1e4)
        assert model.largest_rate < 0.02  # it may open and return, at speeds that vanish with the contrast
        assert math.isnan(model.again_speed) or model.again_speed < 1e-6
        assert law.opens
        assert law.again_speed > 0.5
        assert law.gap_then > 0.5
    for name in ("state-transition", "bistiffness", "kelvin-voigt"):
        found, _ = observe(name, "infinity", 1e4)
        assert not found.opens
        assert found.largest_rate < 1e-3


def test_bistiffness_misses_a_plastic_limit_in_few_cells_and_agrees_in_most():
    """One cell in eight, of a limit whose verdict is `refuted`."""
    beyond, within = misses.shares(misses.distances("bistiffness", BY_KEY["plastic-ball-table"], 1000, 2))
    assert 0.10 < beyond < 0.17
    assert 0.77 < within < 0.86
    beyond, within = misses.shares(misses.distances("kelvin-voigt", BY_KEY["plastic-ball-table"], 100, 2))
    assert (beyond, within) == (1, 0)
