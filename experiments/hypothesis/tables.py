"""The tables of a run, as data frames."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

import numpy as np
import pandas as pd

from impact_xval.experiments.hypothesis.cases import pair_class
from impact_xval.experiments.hypothesis.maps import LEVELS, contrast_needed, share_within
from impact_xval.experiments.hypothesis.run import Results
from impact_xval.experiments.hypothesis.verdicts import FAR, CaseResult, Group

#: Mass ratios of the table of contrasts that are needed.
MASSES = (0.2, 0.5, 1.0, 2.0, 5.0)


def class_frame(results: Results) -> pd.DataFrame:
    """One row a solver, limit and class (``all`` first)."""
    return pd.DataFrame(
        [
            _class_row(result, group, results.redrawn.get((result.solver, result.case.key, group.name)))
            for result in results.verdicts
            for group in (result.whole, *result.classes)
        ]
    )


def _class_row(result: CaseResult, group: Group, again: Group | None) -> dict[str, Any]:
    members = [p for p in result.points if group.name in ("all", pair_class(result.case, p.point))]
    missed = [p.missed for p in members if p.judgement.verdict == "refuted" and math.isfinite(p.missed)]
    before = group.shifted_counts if result.shiftable else {}
    return {
        "case": result.case.key,
        "law": result.law,
        "solver": result.solver,
        "class": group.name,
        "verdict": group.verdict,
        **_shares(group.counts),
        "within_solver_error": group.agrees,
        "verdict_a_decade_before": group.shifted if result.shiftable else "",
        **_shares(before, "_a_decade_before"),
        "verdict_redrawn": again.verdict if again else "",
        **_shares(again.counts if again else {}, "_redrawn"),
        "points": len(members),
        **{f"n_{word}": group.counts.get(word, 0) for word in ("supported", "refuted", "undecided")},
        "rate": group.rate,
        "rate_low": group.rate_low,
        "rate_high": group.rate_high,
        "least_rate": group.least_rate,
        "largest_rate": group.largest_rate,
        "decades": result.decades,
        f"n_offset_above_{FAR:g}": group.far,
        **dict(zip(("offset_least", "offset_median", "offset_largest"), group.offset, strict=True)),
        "limit_error_largest": group.limit_error,
        "prediction": next((p.prediction.form for p in members if p.prediction), ""),
        "missed_prediction_largest": max(missed, default=math.nan),
        "reason": group.reason,
    }


def _shares(counts: Mapping[str, int], suffix: str = "") -> dict[str, float]:
    """Shares of the points that support and that refute; NaN without points."""
    n = sum(counts.values())
    return {
        f"share_{word}{suffix}": counts.get(word, 0) / n if n else math.nan
        for word in ("supported", "refuted")
    }


def point_frame(results: Results) -> pd.DataFrame:
    """One row a solver, limit and point of the design."""
    rows = []
    for result in results.verdicts:
        for p in result.points:
            j = p.judgement
            predicted = (p.prediction.v1, p.prediction.v2) if p.prediction else (math.nan, math.nan)
            rows.append(
                {
                    "case": result.case.key,
                    "solver": result.solver,
                    "class": pair_class(result.case, p.point),
                    **asdict(p.point),
                    "verdict": j.verdict,
                    "verdict_a_decade_before": p.shifted.verdict if result.shiftable else "",
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
            "v1": series.outcomes.v1,
            "v2": series.outcomes.v2,
            "error": series.outcomes.error,
            "distance": series.distances().ravel(),
            "status": series.outcomes.status,
            "reason": series.outcomes.reason,
            "used": usable.ravel(),
            "grazing": grazing.ravel(),
        }
        frames.append(pd.DataFrame(columns))
    return pd.concat(frames, ignore_index=True)


def mechanism_frame(results: Results) -> pd.DataFrame:
    """One row a solver, limit and contrast: the relative motion of the stiff pair."""
    return pd.DataFrame([asdict(one) for one in results.mechanisms])


def map_frame(results: Results) -> pd.DataFrame:
    """One row a cell of a map."""
    frames = []
    for one in results.maps:
        kappa, masses = np.meshgrid(one.stiffness_ratio, one.mass_ratio, indexing="ij")
        columns = {"solver": one.solver, "e1": one.e1, "e2": one.e2}
        columns |= {"stiffness_ratio": kappa.ravel(), "mass_ratio": masses.ravel()}
        columns |= {name: getattr(one, name).ravel() for name in ("error", "uncertainty", "status", "reason")}
        frames.append(pd.DataFrame(columns))
    return pd.concat(frames, ignore_index=True)


def need_frame(results: Results) -> pd.DataFrame:
    """One row a map, side and mass ratio: the contrast from which the hypothesis is good to each level."""
    rows = []
    for one in results.maps:
        for soft, side in ((True, "k2 < k1"), (False, "k2 > k1")):
            shares = {f"share_{100 * x:.0f}pct": share_within(one, x, soft_table=soft) for x in LEVELS}
            for mass in MASSES:
                needed = {
                    f"contrast_{100 * x:.0f}pct": contrast_needed(one, mass, x, soft_table=soft)
                    for x in LEVELS
                }
                key = {"solver": one.solver, "e1": one.e1, "e2": one.e2, "side": side, "mass_ratio": mass}
                rows.append(key | needed | shares)
    return pd.DataFrame(rows)
