"""What the solvers do in the limits, against closed forms that share nothing with them, and what the docs print."""

import math
import re
from pathlib import Path

import numpy as np
import pytest

from impact_xval.compliant_baselines.mapping import damping_ratio, restitution
from impact_xval.experiments.hypothesis.config import HypothesisConfig
from impact_xval.experiments.hypothesis.judging import distance
from impact_xval.experiments.hypothesis.page import over_places, span
from impact_xval.experiments.hypothesis.run import CASES, MARGIN, design, draw, results, stages
from tests.model.test_limits import ball_ball_rigid

DOCS = (Path(__file__).parents[3] / "docs" / "hypothesis.md").read_text(encoding="utf-8")

#: The solvers of the table of the docs, and their verdicts there, by limit.
SOLVERS = ("state-transition", "bistiffness", "kelvin-voigt", "kelvin-voigt-anchored")
SOLVERS += ("kelvin-voigt-textbook", "hunt-crossley")
EXPECTED = {
    limit: [cell.split(",")[0] for cell in cells.split(" | ")]
    for limit, cells in re.findall(r"^\| `(\S+)` \| (.*) \|$", DOCS, re.M)[: len(CASES)]
}
FEW = {"points": 3, "balls": [4, 4]}


def examined(root, **changes):
    """Test the hypothesis by exact solvers, in this process; holds the verdicts, and gives them and all results."""
    config = HypothesisConfig(solvers=[*SOLVERS], **changes)
    for _, solve in stages(config, root):
        solve(isolate=False)
    found = results(config, root)
    wholes = found.verdicts[found.verdicts["class"] == "all"].set_index(["case", "solver"])
    assert {case.key: [wholes.verdict[case.key, name] for name in SOLVERS] for case in CASES} == EXPECTED
    return wholes, found


@pytest.mark.nightly
@pytest.mark.parametrize("seed", [2, 77])
def test_verdicts_hold_when_the_design_is_redrawn(seed, tmp_path):
    examined(tmp_path, seed=seed, columns=FEW)


@pytest.mark.nightly
def test_the_tables_of_the_docs_are_those_of_the_built_in_test(tmp_path):
    wholes, found = examined(tmp_path)
    rows = []
    for case in EXPECTED:
        cells = []
        for row in (wholes.loc[case, solver] for solver in SOLVERS):
            n = getattr(row, f"n_{row.verdict}", row.n_undecided)
            far = f", {span((row.offset_least, row.offset_largest))}" if row.verdict == "refuted" else ""
            cells.append(f"{row.verdict}{'' if n == row.points == 24 else f', {n}'}{far}")
        rows.append(f"| `{case}` | {' | '.join(cells)} |")
    columns = {}
    for solver, place, *counts, rates, away in over_places(found):
        assert all(count.endswith(" of 24" if place == "meet" else " of 48") for count in counts)
        said = zip(counts, (rates, away), strict=True)
        columns.setdefault(solver, []).append(
            "; ".join(f"{n.split()[0]}, {far}" for n, far in said if far != "-")
        )
    rows += [f"| `{solver}` | {' | '.join(cells)} |" for solver, cells in columns.items()]
    assert not [row for row in rows if row not in DOCS]


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
