"""The procedure tells planted solvers apart: one that converges, one that goes elsewhere, one that does neither."""

import math

import numpy as np
import pytest

from impact_xval.experiments.hypothesis.cases import BY_KEY, CASES, closed_form, draw
from impact_xval.experiments.hypothesis.judging import judge
from impact_xval.experiments.hypothesis.run import ratios_of
from impact_xval.experiments.hypothesis.solvers import SolverUnderTest, outcomes_of
from impact_xval.experiments.hypothesis.verdicts import Series, examine

CASE = BY_KEY["zero-late"]
POINTS = tuple(draw(CASE, 12, 5))
CONTRAST = np.logspace(1, 8, 57)


def planted(departure, kind="exact", error=1e-13, case=CASE, points=POINTS, contrast=CONTRAST, decades=4.0):
    """Examine a solver whose v1 is off the closed form by `departure(contrast, index of the point)`."""

    def solve(kappa, mu, e1, e2):
        n = kappa.size // len(points)
        forms = np.repeat([closed_form(case, point) for point in points], n, axis=0)
        off = np.concatenate([departure(contrast, i) for i in range(len(points))])
        return outcomes_of(forms[:, 0] + off, forms[:, 1], error)

    solver = SolverUnderTest("planted", kind, solve, "none")
    outcomes = solve(*ratios_of(case, points, contrast))
    return examine(Series(solver, case, points, contrast, outcomes), decades)


@pytest.mark.parametrize("rate", [0.25, 0.5, 1.0, 2.0])
@pytest.mark.parametrize("case", CASES, ids=lambda case: case.key)
def test_a_solver_that_converges_is_supported_at_its_rate(case, rate):
    found = planted(lambda x, i: (2 + 0.1 * i) * x**-rate, case=case, points=tuple(draw(case, 12, 5)))
    assert found.whole.verdict == found.whole.shifted.verdict == "supported"
    assert found.whole.rate == pytest.approx(rate, abs=1e-6)
    low, high = found.whole.rate_interval
    assert low - 1e-6 <= rate <= high + 1e-6


def test_ringing_that_fades_is_supported_at_the_rate_of_its_envelope():
    found = planted(lambda x, i: 0.3 * np.sin(np.sqrt(x) * (1 + 0.1 * i)) / x)
    assert found.whole.verdict == "supported"
    assert found.whole.rate == pytest.approx(1, abs=0.1)


@pytest.mark.parametrize("offset", [0.3, 1e-2, 1e-4, -1e-6])
def test_a_solver_that_converges_to_something_else_is_refuted_with_its_limit(offset):
    found = planted(lambda x, i: offset + 0.2 * x**-1.0)
    assert found.whole.verdict == "refuted"
    for result in found.whole.members:
        j = result.judgement
        assert j.limit[0] - result.closed_form[0] == pytest.approx(offset, abs=3 * j.limit_error)
        assert j.limit_error < 0.2 * abs(offset)
        assert j.offset == pytest.approx(abs(offset), rel=0.05)


def jumping(x, i):
    """As the model where it has no limit: a few outcomes elsewhere, at any contrast."""
    return np.where(np.random.default_rng(i).random(x.size) < 0.15, -0.2, 0.1 / x)


#: What an engine is judged by: two decades, and an error of its own.
STEPPED = {"kind": "stepped", "contrast": np.logspace(0.5, 3.5, 7), "decades": 2.0}
#: Departure from the closed form, how it is examined, the verdict, and what its reason says.
SERIES = {
    # Off by 1e-12 where the last distance is 1e-9: nothing in the data can tell.
    "beyond the resolution": (lambda x, i: 1e-12 + 0.1 / x, {}, "supported", ""),
    "oscillates": (lambda x, i: 0.1 * np.sin(3 * np.log(x)), {}, "undecided", "does not settle"),
    "two branches": (jumping, {}, "undecided", ""),
    "drifts": (lambda x, i: 0.5 * x**-0.05, {}, "undecided", ""),
    # What no finite range of contrasts can exclude; docs/hypothesis.md names it under what is not shown.
    "drifts slower than any power": (lambda x, i: 0.5 / np.log(x), {}, "refuted", ""),
    "short": (lambda x, i: 1 / x, {"contrast": np.logspace(1, 4, 25)}, "undecided", "a rate needs 4: extend"),
    "engine": (lambda x, i: 1 / x, STEPPED | {"error": 1e-4}, "supported", ""),
    "engine elsewhere": (lambda x, i: 0.3 + 1 / x, STEPPED | {"error": 1e-4}, "refuted", ""),
    # An engine that is 1e-3 off whatever the contrast, and says so, refutes nothing.
    "error of an engine": (lambda x, i: 1e-3 + 0.5 / x, STEPPED | {"error": 1e-3}, "undecided", "own error"),
}


@pytest.mark.parametrize("name", SERIES)
def test_a_verdict_is_given_where_the_series_carries_one(name):
    departure, how, verdict, reason = SERIES[name]
    found = planted(departure, **how).whole
    assert found.verdict == verdict
    assert reason in found.reason
    assert found.agrees == (name == "error of an engine")


def test_oscillation_far_from_the_closed_form_but_small_is_a_refutation():
    found = planted(lambda x, i: 0.2 + 1e-3 * np.sin(5 * np.log(x)))
    assert found.whole.verdict == "refuted"
    for j in (result.judgement for result in found.whole.members):
        assert abs(j.offset - 0.2) < 3 * j.limit_error < 0.02


def test_slow_approach_to_something_else_carries_an_error_that_covers_it():
    offset = 0.05
    found = planted(lambda x, i: offset + 0.4 * x**-0.25 + 0.3 * x**-0.5)
    for result in found.whole.members:
        j = result.judgement
        assert j.verdict == "refuted"
        assert abs(j.limit[0] - result.closed_form[0] - offset) < 3 * j.limit_error


def test_missing_results_are_undecided():
    x = CONTRAST
    usable = np.zeros(x.size, bool)
    usable[[0, 20, 40, -1]] = True
    j = judge(x, np.column_stack([1 / x, 0 * x]), np.full(x.size, 1e-13), usable, (0.0, 0.0), (1.0, 1.0), 4)
    assert j.verdict == "undecided"
    assert "results are missing" in j.reason


def test_grazing_outcomes_are_left_out_and_counted():
    margin = np.full(CONTRAST.size, math.inf)
    margin[-1] = 1e-9
    v1, v2 = closed_form(CASE, POINTS[0])
    off = 0.1 / CONTRAST
    off[-1] = 0.5
    outcomes = outcomes_of(v1 + off, v2, grazing_margin=margin)
    solver = SolverUnderTest("planted", "exact", lambda *_: outcomes, "none")
    found = examine(Series(solver, CASE, POINTS[:1], CONTRAST, outcomes), 4.0)
    assert found.whole.members[0].grazing == 1
    assert found.whole.verdict == "supported"


def test_one_refuted_class_refutes_the_whole_and_the_others_are_named():
    elastic = [i for i, point in enumerate(POINTS) if point.e1 == 1]
    found = planted(lambda x, i: (0.0 if i in elastic else 0.1) + 0.1 / x)
    assert found.whole.verdict == "refuted"
    assert {g.name for g in found.differing} == {"only e1 = 1", "e1 = e2 = 1"}
    assert all(g.verdict == "supported" for g in found.differing)
