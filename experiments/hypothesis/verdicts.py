"""From the outcomes of a solver to its verdict on a limit.

Within a class of points (which contacts are elastic, `cases.pair_class`) the verdict is

* `refuted` where a tenth of the points or more is: one law, one counterexample would do, a tenth is robust;
* else `supported` where half of the points or more is, and every other one either agrees with the closed form within
  the error of its limit, or is short of results; none is refuted or fails to settle;
* else `no limit` where half of the points or more have none; else `undecided`.

Over the classes of a limit the worst counts; one that is undecided only because it is within the solver's own error of
the closed form does not count against one that is supported.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd

from impact_xval.experiments.hypothesis.cases import Frame
from impact_xval.experiments.hypothesis.judging import judge
from impact_xval.model.collision import RESULT_STATUSES

#: Share of refuted points from which a class is.
REFUTING_SHARE = 0.1

#: D from which on a limit is close enough to be used, per impact.
CLOSE = 0.05

#: Resamples of a bootstrap, and its seed.
_RESAMPLES, _SEED = 2000, 2013

#: The worst first.
_ORDER = ("refuted", "no limit", "undecided", "supported")


def judged(outcomes: Frame, keys: Sequence[str]) -> Frame:
    """Judge every series of outcomes, of pairs or of columns: those with the same `keys`; a row each."""
    rows = []
    for key, series in outcomes.groupby(list(keys), sort=False):
        lost = series[~series.status.isin(RESULT_STATUSES)]
        why = [f"{len(some)} {status}: {some.reason.iloc[0]}" for status, some in lost.groupby("status")]
        # The last outcome that is not close; the one after it is the first of those that stay so.
        far = np.flatnonzero(np.r_[True, ~(series.distance <= CLOSE)])[-1]
        near = [*series.contrast, np.inf][far]
        more = {"close_from": near, "grazing_left_out": int(series.grazing.sum())}
        rows.append(
            dict(zip(keys, key, strict=True)) | judge(series) | more | {"without_result": "; ".join(why)}
        )
    return pd.DataFrame(rows)


def verdicts(points: Frame, keys: Sequence[str]) -> Frame:
    """Gather judgements: a row for all points that have the same keys, then one for each of their classes.

    Rates are those of points that support, the median with its 95 % bootstrap interval; offsets of those that refute.
    """
    rows = []
    for key, group in points.groupby(list(keys), sort=False):
        classes = [{"class": name} | _gathered(some) for name, some in group.groupby("class", sort=False)]
        supported = any(row["verdict"] == "supported" for row in classes)
        counting = [row for row in classes if not (row["within_error"] and supported)]
        worst = min(counting, key=lambda row: _ORDER.index(row["verdict"]))
        whole = {"class": "all"} | _gathered(group)
        whole |= {name: worst[name] for name in ("verdict", "reason")}
        rows += [dict(zip(keys, key, strict=True)) | row for row in (whole, *classes)]
    return pd.DataFrame(rows)


def _gathered(points: Frame) -> dict[str, Any]:
    """Return a row of verdicts, by the rule of a class."""
    supported, refuted = (points[points.verdict == verdict] for verdict in ("supported", "refuted"))
    undecided = points[~points.verdict.isin(["supported", "refuted"])]
    n, astray, reason = len(points), undecided[~undecided.settles], ""
    harmless = astray.empty and (undecided.consistent | ~np.isfinite(undecided.offset)).all()
    if len(refuted) >= max(1, REFUTING_SHARE * n):
        verdict = "refuted"
    elif 2 * len(supported) >= n and refuted.empty and harmless:
        verdict = "supported"
    else:
        verdict = "no limit" if 2 * (points.verdict == "no limit").sum() >= n else "undecided"
        worst = undecided if astray.empty else astray
        reason = (
            f"{len(worst)} of {n} points: {worst.reason.iloc[0]}" if len(worst) else "one point is refuted"
        )
    quiet = (points.verdict == "supported") | (points.consistent & points.settles)
    low, high = _interval(supported.rate.to_numpy())
    return {
        "verdict": verdict,
        "within_error": bool(verdict == "undecided" and quiet.all()),
        "points": n,
        "n_supported": len(supported),
        "n_refuted": len(refuted),
        "n_undecided": len(undecided),
        **{"rate": supported.rate.median(), "rate_low": low, "rate_high": high},
        **{"least_rate": supported.rate.min(), "largest_rate": supported.rate.max()},
        **{"offset_least": refuted.offset.min(), "offset_median": refuted.offset.median()},
        **{"offset_largest": refuted.offset.max(), "limit_error_largest": refuted.limit_error.max()},
        "close_from": points.close_from.median(),
        "reason": reason,
    }


def _interval(rates: np.ndarray) -> tuple[float, float]:
    """95 % bootstrap interval of the median; one rate is legal, which scipy.stats.bootstrap refuses."""
    if not rates.size:
        return np.nan, np.nan
    draws = np.random.default_rng(_SEED).choice(rates, (_RESAMPLES, rates.size))
    low, high = np.quantile(np.median(draws, axis=1), [0.025, 0.975])
    return float(low), float(high)
