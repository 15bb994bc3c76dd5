"""From the outcomes of a solver to its verdict on a limit.

Within a class of points (which contacts are elastic, `cases.pair_class`) the verdict is

* `refuted` where a tenth of the points or more is: one law, one counterexample would do, a tenth is robust;
* else `supported` where half of the points or more is, and every other one either agrees with the closed form within
  the error of its limit, or is short of results; none is refuted or fails to settle;
* else `no limit` where half of the points or more have none;
* else `undecided`, with the most frequent reason.

Over the classes of a limit the worst counts, in the order refuted, no limit, undecided, supported; a class that is
undecided only because it is within the solver's own error of the closed form does not count against one that is
supported.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

import numpy as np
import pandas as pd

from impact_xval.compliant_baselines.registry import is_engine
from impact_xval.experiments.config.axes import AXES
from impact_xval.experiments.hypothesis.cases import Frame
from impact_xval.experiments.hypothesis.config import HypothesisConfig
from impact_xval.experiments.hypothesis.judging import judge
from impact_xval.model.collision import RESULT_STATUSES

#: Share of refuted points from which a class is.
REFUTING_SHARE = 0.1

#: D from which on a limit is close enough to be used, per impact.
CLOSE = 0.05

#: Error of an exact solver's velocities in columns, per speed of impact (docs/columns.md, sections 6 and 7).
COLUMN_ERROR = 1e-9

#: Resamples of a bootstrap, and its seed.
_RESAMPLES, _SEED = 2000, 2013


def judged(outcomes: Frame, config: HypothesisConfig) -> Frame:
    """Judge the series of outcomes of every solver at every point of a limit; a row each."""
    rows = []
    for (case, solver, point), series in outcomes.groupby(["case", "solver", "point"], sort=False):
        first = series.iloc[0]
        found = judge(
            series.contrast.to_numpy(),
            series[["v1", "v2"]].to_numpy(),
            series.error.to_numpy(),
            series.used.to_numpy(),
            first[["closed_form_v1", "closed_form_v2"]].to_numpy(float),
            (1.0, first.mass_ratio),
            config.engine_fit_decades if is_engine(solver) else config.fit_decades,
        )
        known = first[["class", "closed_form_v1", "closed_form_v2"]].to_dict()
        # What goes to its limit has no value here.
        known |= {name: first[name] if series[name].nunique() == 1 else np.nan for name in AXES}
        lost = series[~series.status.isin(RESULT_STATUSES)].groupby("status").reason.agg(["size", "first"])
        rows.append(
            {
                **{"case": case, "solver": solver, "point": point, **known, **_flat(asdict(found))},
                "close_from": _close_from(series),
                "grazing_left_out": int(series.grazing.sum()),
                "without_result": "; ".join(f"{n} {status}: {why}" for status, n, why in lost.itertuples()),
            }
        )
    return pd.DataFrame(rows)


def columns_judged(outcomes: Frame, config: HypothesisConfig) -> Frame:
    """Judge the series of outcomes of every solver and every column (`columns.column_outcomes`); a row each."""
    rows = []
    keys = ["arrangement", "stiff_contact", "meets", "solver", "column", "class"]
    for key, series in outcomes.groupby(keys, sort=False):
        first = series.iloc[0]
        found = judge(
            series.contrast.to_numpy(),
            np.array(series.velocities.to_list()),
            np.full(len(series), COLUMN_ERROR),
            series.used.to_numpy(),
            first.welded,
            first.weights,
            config.columns.fit_decades,
        )
        rows.append(
            dict(zip(keys, key, strict=True)) | _flat(asdict(found)) | {"close_from": _close_from(series)}
        )
    return pd.DataFrame(rows)


def _flat(judgement: dict[str, Any]) -> dict[str, Any]:
    """Give the numbers of a judgement a column each."""
    low, high = judgement.pop("window")
    limit = {f"limit_v{i}": v for i, v in enumerate(judgement.pop("limit"), 1)}
    return judgement | {"window_from": low, "window_to": high} | limit


def _close_from(series: Frame) -> float:
    """Least contrast from which on D stays within `CLOSE`, as far as the series goes; infinite if at none."""
    far = np.flatnonzero(~(series.distance.to_numpy() <= CLOSE))
    first = int(far[-1]) + 1 if far.size else 0
    return float(series.contrast.iloc[first]) if first < len(series) else np.inf


def verdicts(points: Frame, keys: Sequence[str]) -> Frame:
    """Gather judgements: a row for all points that have the same keys, then one for each of their classes.

    Beside the verdict stand how many points there are and at how many it is reached, the median of the rates of those
    that support it with its 95 % bootstrap interval, their range, the offsets of those that refute it, and the median
    contrast from which on D stays within `CLOSE`.
    """
    rows = []
    for key, group in points.groupby(list(keys), sort=False):
        known = dict(zip(keys, key, strict=True))
        classes = [
            known | {"class": name} | _class_row(some) for name, some in group.groupby("class", sort=False)
        ]
        worst = min((row["verdict"] for row in classes if not _harmless(row, classes)), key=_ORDER.index)
        reason = next(row["reason"] for row in classes if row["verdict"] == worst)
        rows += [
            known | {"class": "all"} | _class_row(group) | {"verdict": worst, "reason": reason},
            *classes,
        ]
    return pd.DataFrame(rows)


_ORDER = ("refuted", "no limit", "undecided", "supported")


def _harmless(row: dict[str, Any], classes: Sequence[dict[str, Any]]) -> bool:
    """Whether a class is merely within the solver's own error of the closed form, beside one that is supported."""
    return row["within_error"] and any(other["verdict"] == "supported" for other in classes)


def _class_row(points: Frame) -> dict[str, Any]:
    verdict, reason = class_verdict(points)
    supported, refuted = points[points.verdict == "supported"], points[points.verdict == "refuted"]
    quiet = (points.verdict == "supported") | (points.consistent & points.settles)
    low, high = _interval(supported.rate.to_numpy())
    return {
        "verdict": verdict,
        "within_error": bool(verdict == "undecided" and quiet.all()),
        "points": len(points),
        "n_supported": len(supported),
        "n_refuted": len(refuted),
        "n_undecided": len(points) - len(supported) - len(refuted),
        **{"rate": supported.rate.median(), "rate_low": low, "rate_high": high},
        **{"least_rate": supported.rate.min(), "largest_rate": supported.rate.max()},
        "offset_least": refuted.offset.min(),
        "offset_median": refuted.offset.median(),
        "offset_largest": refuted.offset.max(),
        "limit_error_largest": refuted.limit_error.max(),
        "close_from": points.close_from.median(),
        "reason": reason,
    }


def class_verdict(points: Frame) -> tuple[str, str]:
    """Verdict of a class, and the reason if it is undecided; the rule is in the module."""
    n, by = len(points), points.verdict.value_counts()
    supported, refuted = int(by.get("supported", 0)), int(by.get("refuted", 0))
    if refuted >= max(1, REFUTING_SHARE * n):
        return "refuted", ""
    undecided = points[points.verdict.isin(["undecided", "no limit"])]
    astray = undecided[~undecided.settles]
    harmless = (undecided.consistent | ~np.isfinite(undecided.offset)).all()
    if 2 * supported >= n and not refuted and astray.empty and harmless:
        return "supported", ""
    worst = undecided if astray.empty else astray
    if worst.empty:
        return "undecided", "one point alone is refuted"
    verdict = "no limit" if 2 * int(by.get("no limit", 0)) >= n else "undecided"
    return verdict, f"{worst.reason.iloc[0]} ({len(worst)} of {n} points so)"


def _interval(rates: np.ndarray) -> tuple[float, float]:
    """95 % bootstrap interval of the median; one rate is legal, which scipy.stats.bootstrap refuses."""
    if not rates.size:
        return np.nan, np.nan
    draws = np.random.default_rng(_SEED).choice(rates, (_RESAMPLES, rates.size))
    low, high = np.quantile(np.median(draws, axis=1), [0.025, 0.975])
    return float(low), float(high)
