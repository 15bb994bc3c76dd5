"""The tables of a run, as data frames."""

from __future__ import annotations

import math
from dataclasses import asdict
from typing import Any

import numpy as np
import pandas as pd

from impact_xval.experiments.hypothesis.cases import pair_class
from impact_xval.experiments.hypothesis.columns import missed
from impact_xval.experiments.hypothesis.maps import LEVELS, contrast_needed, share_within, side_of
from impact_xval.experiments.hypothesis.run import Results
from impact_xval.experiments.hypothesis.verdicts import FAR, CaseResult, Group

#: Mass ratios of the table of contrasts that are needed.
MASSES = (0.2, 0.5, 1.0, 2.0, 5.0)


def class_frame(results: Results) -> pd.DataFrame:
    """One row a solver, limit and class (``all`` first)."""
    return pd.DataFrame(
        [
            _class_row(result, group)
            for result in results.verdicts
            for group in (result.whole, *result.classes)
        ]
    )


def _class_row(result: CaseResult, group: Group) -> dict[str, Any]:
    refuted = group.judged("refuted")
    least, median, largest = np.quantile(group.offsets or [math.nan], [0, 0.5, 1])
    return {
        "case": result.case.key,
        "law": result.law,
        "solver": result.solver,
        "class": group.name,
        "verdict": group.verdict,
        **_shares(group),
        "within_solver_error": group.agrees,
        "verdict_a_decade_before": group.shifted.verdict if group.shifted else "",
        **_shares(group.shifted, "_a_decade_before"),
        "points": group.points,
        **{f"n_{word}": group.counts[word] for word in ("supported", "refuted", "undecided")},
        "rate": group.rate,
        **dict(zip(("rate_low", "rate_high"), group.rate_interval, strict=True)),
        "least_rate": min(group.rates, default=math.nan),
        "largest_rate": max(group.rates, default=math.nan),
        "decades": result.decades,
        f"n_offset_above_{FAR:g}": group.far,
        "offset_least": least,
        "offset_median": median,
        "offset_largest": largest,
        "limit_error_largest": max((p.judgement.limit_error for p in refuted), default=math.nan),
        "prediction": next((p.prediction.form for p in group.members if p.prediction), ""),
        "missed_prediction_largest": max(
            (p.missed for p in refuted if math.isfinite(p.missed)), default=math.nan
        ),
        "reason": group.reason,
    }


def _shares(group: Group | None, suffix: str = "") -> dict[str, float]:
    """Shares of the points that support and that refute; NaN without points."""
    return {
        f"share_{word}{suffix}": group.counts[word] / group.points if group else math.nan
        for word in ("supported", "refuted")
    }


def point_frame(results: Results) -> pd.DataFrame:
    """One row a solver, limit and point of the design."""
    rows = []
    for result in results.verdicts:
        for p in result.whole.members:
            j = p.judgement
            predicted = (p.prediction.v1, p.prediction.v2) if p.prediction else (math.nan, math.nan)
            rows.append(
                {
                    "case": result.case.key,
                    "solver": result.solver,
                    "class": pair_class(result.case, p.point),
                    **asdict(p.point),
                    "verdict": j.verdict,
                    "verdict_a_decade_before": p.shifted.verdict if result.whole.shifted else "",
                    "rate": j.rate,
                    "rate_low": j.rate_low,
                    "rate_high": j.rate_high,
                    **dict(zip(("window_from", "window_to"), j.window, strict=True)),
                    "last_distance": j.last,
                    **dict(zip(("closed_form_v1", "closed_form_v2"), p.closed_form, strict=True)),
                    **dict(zip(("limit_v1", "limit_v2"), j.limit, strict=True)),
                    "limit_error": j.limit_error,
                    "offset": j.offset,
                    **dict(zip(("predicted_v1", "predicted_v2"), predicted, strict=True)),
                    "missed_prediction": p.missed,
                    "grazing_left_out": p.grazing,
                    "reason": j.reason,
                    "without_result": p.without_result,
                }
            )
    return pd.DataFrame(rows)


def outcome_frame(results: Results) -> pd.DataFrame:
    """One row a solver, limit, point and contrast."""
    frames = []
    for series in results.series:
        n, m = len(series.points), series.contrast.size
        usable, grazing = series.usable()
        points = pd.DataFrame([asdict(point) for point in series.points])
        columns = {
            "case": series.case.key,
            "solver": series.solver.name,
            **{name: np.repeat(column.to_numpy(), m) for name, column in points.items()},
            "contrast": np.tile(series.contrast, n),
            **series.outcomes[["v1", "v2", "error"]],
            "distance": series.distances().ravel(),
            **series.outcomes[["status", "reason"]],
            "used": usable.ravel(),
            "grazing": grazing.ravel(),
        }
        frames.append(pd.DataFrame(columns))
    return pd.concat(frames, ignore_index=True)


def column_class_frame(results: Results) -> pd.DataFrame:
    """One row a place in a column, solver and class (``all`` first)."""
    return pd.DataFrame(
        [
            {
                "arrangement": result.place.arrangement,
                "stiff_contact": result.place.where,
                "meets": result.place.meets,
                "solver": result.solver,
                "class": group.name,
                "verdict": group.verdict,
                "points": group.points,
                **{f"n_{word}": group.counts[word] for word in ("supported", "refuted", "undecided")},
                "rate": group.rate,
                "least_rate": min(group.rates, default=math.nan),
                "largest_rate": max(group.rates, default=math.nan),
                "offset_least": min(group.offsets, default=math.nan),
                "offset_largest": max(group.offsets, default=math.nan),
                "missed_prediction_largest": max(missed(group), default=math.nan),
                "reason": group.reason,
            }
            for result in results.columns
            for group in (result.whole, *result.classes)
        ]
    )


def column_outcome_frame(results: Results) -> pd.DataFrame:
    """One row a place in a column, solver, point and contrast; lists by ball and by contact."""
    return pd.DataFrame(
        [
            {
                "arrangement": result.place.arrangement,
                "stiff_contact": result.place.where,
                "solver": result.solver,
                "point": number,
                "contrast": contrast,
                **{f: getattr(p.column, f) for f in ("masses", "stiffnesses", "restitutions", "velocities")},
                "final_velocities": outcome.velocities,
                "welded_velocities": p.welded,
                "distance": distance,
                "status": outcome.status,
                "reason": outcome.reason,
                "verdict": p.judgement.verdict,
                "rate": p.judgement.rate,
                "offset": p.judgement.offset,
                "missed_prediction": p.missed,
            }
            for result in results.columns
            for number, p in enumerate(result.whole.members)
            for contrast, outcome, distance in zip(result.contrast, p.outcomes, p.distances(), strict=True)
        ]
    )


def mechanism_frame(results: Results) -> pd.DataFrame:
    """One row a solver, limit and contrast: the relative motion of the stiff pair."""
    return pd.DataFrame([asdict(one) for one in results.mechanisms])


def need_frame(results: Results) -> pd.DataFrame:
    """One row a map, side and mass ratio: the contrast from which the hypothesis is good to each level."""
    rows = []
    maps: Any = results.maps.groupby(["solver", "e1", "e2"], sort=False)
    for (solver, e1, e2), one in maps:
        for soft, side in ((True, "k2 < k1"), (False, "k2 > k1")):
            errors = side_of(one, soft_table=soft)
            shares = {f"share_{100 * x:.0f}pct": share_within(errors, x) for x in LEVELS}
            for mass in MASSES:
                needed = {f"contrast_{100 * x:.0f}pct": contrast_needed(errors, mass, x) for x in LEVELS}
                key = {"solver": solver, "e1": e1, "e2": e2, "side": side, "mass_ratio": mass}
                rows.append(key | needed | shares)
    return pd.DataFrame(rows)
