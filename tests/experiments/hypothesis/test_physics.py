"""What the solvers do in the limits, against closed forms that share nothing with them, and what the docs print."""

import math
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from impact_xval.compliant_baselines import get_solver
from impact_xval.compliant_baselines.mapping import damping_ratio, restitution
from impact_xval.compliant_baselines.solver import Settings
from impact_xval.experiments.hypothesis.cases import CASES, MARGIN, design, distance, draw
from impact_xval.experiments.hypothesis.config import parse
from impact_xval.experiments.hypothesis.page import over_places, reached, span
from impact_xval.experiments.hypothesis.run import run_hypothesis
from impact_xval.model import Collision, solve, solve_batch
from tests.model.oracle import solve_oracle
from tests.model.test_limits import ball_ball_rigid

#: Verdict by limit of the model, bistiffness, the three dashpots (pair, anchored, textbook) and Hunt-Crossley.
SOLVERS = ("state-transition", "bistiffness", "kelvin-voigt", "kelvin-voigt-anchored")
SOLVERS += ("kelvin-voigt-textbook", "hunt-crossley")
FEW = {"points": 3, "balls": [4, 4]}
EXPECTED = {
    "zero-apart": ("supported", "supported", "supported", "refuted", "refuted", "refuted"),
    "zero-early": ("no limit", "refuted", "refuted", "refuted", "refuted", "refuted"),
    "zero-late": ("supported", "refuted", "refuted", "refuted", "refuted", "refuted"),
    "infinity": ("supported", "supported", "refuted", "supported", "refuted", "supported"),
    "plastic-ball-ball": ("supported", "supported", "refuted", "refuted", "refuted", "refuted"),
    "plastic-ball-table": ("supported", "refuted", "refuted", "refuted", "refuted", "refuted"),
}


def examined(root, **changes):
    """Test the hypothesis by exact solvers, in this process; holds the verdicts, and gives them and all results."""
    results = run_hypothesis(parse({"solvers": list(SOLVERS)} | changes, "test"), root, isolate=False)
    wholes = results.verdicts[results.verdicts["class"] == "all"].set_index(["case", "solver"])
    verdicts = {case: tuple(wholes.verdict[case, solver] for solver in SOLVERS) for case in EXPECTED}
    assert verdicts == EXPECTED
    return wholes, results


@pytest.mark.nightly
@pytest.mark.parametrize("seed", [2, 77])
def test_verdicts_hold_when_the_design_is_redrawn(seed, tmp_path):
    examined(tmp_path, seed=seed, columns=FEW)


@pytest.mark.nightly
def test_the_tables_of_the_docs_are_those_of_the_built_in_test(tmp_path):
    wholes, results = examined(tmp_path)
    rows = []
    for case in EXPECTED:
        cells = []
        for row in (wholes.loc[case, solver] for solver in SOLVERS):
            far = f", {span((row.offset_least, row.offset_largest))}" if row.verdict == "refuted" else ""
            points = "" if reached(row) == "24 of 24" else f", {reached(row).removesuffix(' of 24')}"
            cells.append(f"{row.verdict}{points}{far}")
        rows.append(f"| `{case}` | {' | '.join(cells)} |")
    columns = {}
    for solver, place, *counts, rates, away in over_places(results):
        assert all(count.endswith(" of 24" if place == "meet" else " of 48") for count in counts)
        said = zip(counts, (rates, away), strict=True)
        columns.setdefault(solver, []).append(
            "; ".join(f"{n.split()[0]}, {far}" for n, far in said if far != "-")
        )
    rows += [f"| `{solver}` | {' | '.join(cells)} |" for solver, cells in columns.items()]
    page = (Path(__file__).parents[3] / "docs" / "hypothesis.md").read_text(encoding="utf-8")
    assert not [row for row in rows if row not in page]


def test_points_are_of_their_regime_and_closed_forms_are_those_of_the_supplement():
    drawn = design(24, 9)
    assert drawn.equals(design(24, 9))
    assert not {*draw(CASES[0], 24, 9)} & {*draw(CASES[0], 24, 10)}
    for row in drawn.itertuples():
        found = (row.closed_form_v1, row.closed_form_v2)
        if row.case.startswith("zero"):
            v1, v2, states = ball_ball_rigid(row.mass_ratio, row.e1, row.e2)
            early = row.e1 * row.mass_ratio < 1
            assert row.case == f"zero-{'apart' if len(states) == 3 else 'early' if early else 'late'}"
            assert abs(row.e1 * row.mass_ratio - 1) >= MARGIN * (1 + row.mass_ratio)
            assert found == pytest.approx((v1, v2), abs=1e-13)
        elif row.case == "infinity":
            assert found == pytest.approx((row.e1, 0), abs=1e-13)


def predicted(case, solver, mu, e1, e2):
    """Where a refuted law goes instead, from the law alone; None where that has no closed form.

    A dashpot of ratio zeta for a mass M has zeta sqrt(M/m) against m (Schwager and Poeschel, Granular Matter 9:465,
    2007). Infinite, it joins its bodies at first touch.
    """

    def against(e, mapped, mass):
        return restitution(damping_ratio(e) * math.sqrt(mapped / mass))

    match case, solver:
        case "zero-late", "bistiffness" | "kelvin-voigt":  # three single impacts: balls, table, balls
            v = np.array([-1.0, 0.0])
            for _ in range(2):
                impulse = mu / (1 + mu) * (1 + e1) * (v[1] - v[0])
                v += impulse, -impulse / mu
                v[1] = -e2 * v[1] if v[1] < 0 else v[1]
            return tuple(v)
        case "infinity" | "plastic-ball-table", "kelvin-voigt":  # B1 meets a wall
            return against(e1, mu / (1 + mu), 1.0), 0.0
        case "plastic-ball-ball", "kelvin-voigt":  # one body meets the table
            return (against(e2, mu, 1 + mu) / (1 + mu),) * 2
    return None


def test_verdicts_and_that_refuted_limits_are_those_predicted_without_a_simulation(tmp_path):
    found = examined(tmp_path, points=6, columns=FEW)[1].points
    tried = set()
    for row in found[found.verdict == "refuted"].itertuples():
        form = predicted(row.case, row.solver, row.mass_ratio, row.e1, row.e2)
        if form is not None:
            missed = distance((1, row.mass_ratio), np.subtract((row.limit_v1, row.limit_v2), form))
            assert missed < min(2e-3, 0.2 * row.offset), row
            tried.add((row.case, row.solver))
    assert len(tried) == 5


@pytest.mark.parametrize("mu", [0.6, 0.25, 0.08, 0.03])
def test_the_model_has_no_limit_where_the_ringing_decides(mu):
    """Every number n of ends of compression occurs in the share 1 - |n - 1 - r| of the contrasts (docs/errata.md)."""
    e2, count, q = 0.7, 1000, math.sqrt((3 - mu) / (mu * (1 + mu)))
    r = (math.sqrt(q * q - 1) - math.acos(1 / q)) / math.pi
    x = np.exp(np.random.default_rng(4).uniform(*np.log([1e4, 1e6]), count))
    v1 = solve_batch(1 / x, mu, 1.0, e2, stiffness_ratio_cutoff=math.inf, max_events=300_000).v1
    ends = 1 + np.log(v1 * math.sqrt(1 + mu) / e2) / math.log(e2)
    assert np.abs(ends - np.round(ends)).max() < 0.01
    shares = [max(0.0, 1 - abs(n - r)) for n in range(5)]
    assert sum(shares) == pytest.approx(1, abs=1e-12)
    for n, share in enumerate(shares, start=1):
        assert np.mean(np.round(ends) == n) == pytest.approx(share, abs=0.045 if share else 0)


def test_both_outcomes_of_a_ringing_pair_are_those_of_the_oracle():
    once = 0.7 / math.sqrt(1.3)
    for x, v in ((1000, once), (1500, 0.7 * once)):
        c = Collision.from_ratios(1 / x, 0.3, 1.0, 0.7)
        for solver in (solve_oracle, solve):
            assert solver(c, stiffness_ratio_cutoff=math.inf).v1 == pytest.approx(v, abs=5e-3)


def test_in_time_the_pair_is_apart_when_its_velocities_are_equal():
    """B1 flies with v11, B2 swings on the table: v2 = v11 at cos(theta) = v11/v21 (k2/k1 -> 0), m2 = k2 = 1."""
    mu, e1, x = 0.5, 0.9, 1e5
    v11, v21 = (e1 * mu - 1) / (1 + mu), -(1 + e1) / (1 + mu)
    theta = math.acos(v11 / v21)
    asked = Collision.from_ratios(1 / x, mu, e1, 0.7)
    path = get_solver("bistiffness").solve(asked, Settings(record_path=True)).path
    middle = [0.5 * (a + b) for a, b in pairwise(path.v1 - path.v2)]
    gap = np.concatenate([[0.0], np.cumsum(np.diff(path.time) * middle)]) / math.sqrt(mu * x)
    parted = np.flatnonzero((path.v1 - path.v2)[1:] * (path.v1 - path.v2)[:-1] < 0)
    at = parted[np.argmax(gap[parted])]
    assert gap[at] == pytest.approx(v11 * theta - v21 * math.sin(theta), rel=0.02)
