"""The procedure that judges the hypothesis, tried on made-up series of outcomes with known answers.

Some of the series converge, some go to another limit, and some have no limit.
"""

import numpy as np
import pandas as pd
import pytest
from numpy.random import default_rng

from impact_xval.experiments.hypothesis.judging import judge_classes, judge_points

CONTRAST = np.logspace(1, 8, 57)
FORM = (0.3, -0.1)
CLASSES = ("both lossy", "only e1 = 1", "e1 = e2 = 1")


def planted(departure, contrast=CONTRAST, **how):
    """Judge a made-up solver at 12 points; its v1 differs from the closed form by `departure(contrast, point)`."""
    usual = {"error": 1e-13, "decades": 4.0, "used": True, "grazing": False, "status": "ok", "reason": ""}
    series = []
    for i, off in enumerate(departure(contrast, i) for i in range(12)):
        one = {"contrast": contrast, "distance": abs(off), "solver": "planted", "point": i}
        lists = {"velocities": [(FORM[0] + x, FORM[1]) for x in off], "class": CLASSES[i % 3]}
        lists |= {"closed_form": [FORM] * len(off), "weights": [(1.0, 1.0)] * len(off)}
        series.append(pd.DataFrame(one | lists | usual | how))
    found = judge_points(pd.concat(series), ["solver", "point", "class"])
    return found, judge_classes(found, ["solver"]).set_index("class")


#: Options of `planted` that imitate a run of an engine. Its stiffness contrasts span three decades only, and a rate is
#: judged from two decades.
ENGINE = {"decades": 2.0, "contrast": np.logspace(0.5, 3.5, 7)}
#: For each series: the departure of v1 from the closed form, options of `planted`, the verdict, and a part of its
#: reason, or the rate, or the offset.
SERIES = {
    **{f"r {r}": (lambda x, i, r=r: (2 + i / 10) / x**r, {}, "supported", r) for r in (0.25, 0.5, 1.0, 2.0)},
    **{f"{at} off": (lambda x, i, at=at: at + 0.2 / x, {}, "refuted", at) for at in (0.3, 1e-2, 1e-4, -1e-6)},
    "oscillates, far off": (lambda x, i: 0.2 + 1e-3 * np.sin(5 * np.log(x)), {}, "refuted", 0.2),
    "slow, elsewhere": (lambda x, i: 0.05 + 0.4 * x**-0.25 + 0.3 * x**-0.5, {}, "refuted", 0.05),
    # The limit is off by 1e-12, but the last outcome of the series is still 1e-9 away. The data cannot show the offset.
    "beyond the resolution": (lambda x, i: 1e-12 + 0.1 / x, {}, "supported", ""),
    "rings, and fades": (lambda x, i: 0.3 * np.sin(np.sqrt(x) * (1 + 0.1 * i)) / x, {}, "supported", ""),
    "oscillates": (lambda x, i: 0.1 * np.sin(3 * np.log(x)), {}, "no limit", "does not settle"),
    # A few outcomes lie 0.2 away, at any contrast. The model behaves like this where it has no limit.
    "jumps": (lambda x, i: np.where(default_rng(i).random(57) < 0.15, -0.2, 0.1 / x), {}, "no limit", ""),
    "drifts": (lambda x, i: 0.5 * x**-0.05, {}, "undecided", ""),
    # D falls to zero, but more slowly than any power of the contrast. Over a finite range of contrasts this looks like
    # another limit, so the verdict is wrong. docs/hypothesis.md states this under "What is not shown".
    "drifts slower than any power": (lambda x, i: 0.5 / np.log(x), {}, "refuted", ""),
    "short": (lambda x, i: 1 / x, {"contrast": np.logspace(1, 4, 25)}, "undecided", "a rate needs 4: extend"),
    "gaps": (lambda x, i: 1 / x, {"used": np.isin(CONTRAST, CONTRAST[::18])}, "undecided", "are missing"),
    "engine": (lambda x, i: 1 / x, ENGINE | {"error": 1e-4}, "supported", ""),
    "engine elsewhere": (lambda x, i: 0.3 + 1 / x, ENGINE | {"error": 1e-4}, "refuted", ""),
    # An engine that is off by 1e-3 at any contrast and states this error refutes nothing.
    "error of an engine": (lambda x, i: 1e-3 + 0.5 / x, ENGINE | {"error": 1e-3}, "undecided", "own error"),
    "at the closed form": (lambda x, i: 0 * x, {}, "undecided", "own error"),
    # If one class of points is refuted, the whole case is refuted.
    "one class": (lambda x, i: (0.1 if i % 3 == 0 else 0.0) + 0.1 / x, {}, "refuted", ""),
}


@pytest.mark.parametrize("name", SERIES)
def test_a_verdict_is_given_where_the_series_carries_one(name):
    departure, how, verdict, says = SERIES[name]
    found, rows = planted(departure, **how)
    whole = rows.loc["all"]
    assert whole.verdict == verdict
    assert whole.within_error == (says == "own error")
    match verdict, says:
        case "supported", float(rate):
            assert whole.rate == pytest.approx(rate, abs=1e-6)
            assert whole.rate_low - 1e-6 <= rate <= whole.rate_high + 1e-6
            # The median of D is 2.55 x^-r, and neighbouring contrasts are an eighth of a decade apart.
            least = max(51.0, CONTRAST[0] ** rate)
            assert 0.99 * least <= whole.close_from**rate < 1.01 * least * 10 ** (rate / 8)
        case "refuted", float(offset):
            assert {*found.verdict, *rows.verdict} == {"refuted"}
            assert (abs(found.limit_v1 - FORM[0] - offset) <= 3 * found.limit_error).all()
            assert (found.limit_error < 0.2 * abs(offset)).all()
            assert found.offset.to_numpy() == pytest.approx(abs(offset), rel=0.05)
        case _:
            assert says in whole.reason
    # the expected rate is that of the envelope of the oscillation
    assert name != "rings, and fades" or whole.rate == pytest.approx(1, abs=0.1)
    assert name != "one class" or [*rows.verdict[[*CLASSES]]] == ["refuted", "supported", "supported"]
