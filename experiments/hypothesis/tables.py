"""The tables of a run: as data frames, and as blocks of a page."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
import pandas as pd

from impact_xval.compliant_baselines.contract.registry import law_of
from impact_xval.experiments.hypothesis.cases import CASES, pair_class
from impact_xval.experiments.hypothesis.maps import LEVELS, contrast_needed, share_within
from impact_xval.experiments.hypothesis.run import Results
from impact_xval.experiments.hypothesis.verdicts import (
    FAR,
    REFUTING_SHARE,
    CaseResult,
    Group,
)
from impact_xval.experiments.measures.laws import with_votes
from impact_xval.experiments.tables.document import Table
from impact_xval.experiments.tables.numbers import number, percent

#: Mass ratios of the table of contrasts that are needed.
MASSES = (0.2, 0.5, 1.0, 2.0, 5.0)


def short(value: float, digits: int = 3) -> str:
    """Write a number; a dash for none, a word for infinity."""
    if math.isnan(value):
        return "-"
    if 1e4 <= value < math.inf and math.isclose(value, 10 ** round(math.log10(value)), rel_tol=1e-9):
        return f"1e{round(math.log10(value))}"
    return "never" if math.isinf(value) else number(value, digits)


def rate_text(group: Group) -> str:
    """Write a rate with its interval."""
    if math.isnan(group.rate):
        return "-"
    return f"{group.rate:.2f} ({group.rate_low:.2f} to {group.rate_high:.2f})"


def points_text(verdict: str, counts: Mapping[str, int]) -> str:
    """Write at how many points a verdict was reached; of an undecided one, how many refute the hypothesis."""
    n = sum(counts.values())
    k = counts.get("refuted" if verdict == "undecided" else verdict, 0)
    return f"{'refuted at ' if verdict == 'undecided' else ''}{k} of {n} points, {percent(k / n)}"


def group_points(group: Group) -> str:
    """Write at how many points the verdict of a group was reached; of a refutation, by how much."""
    text = points_text(group.verdict, group.counts)
    if group.verdict != "refuted":
        return text
    least, most = short(group.offset[0], 2), short(group.offset[2], 2)
    size = least if least == most else f"{least} to {most}"
    return f"{text}, by D = {size}, above {FAR:g} at {group.far} of {sum(group.counts.values())}"


def said(group: Group, *, shifted: bool = False) -> str:
    """Write the verdict of a group, or that of the fits a decade before, with its points."""
    if shifted:
        return f"{group.shifted} ({points_text(group.shifted, group.shifted_counts)})"
    return f"{group.verdict} ({group_points(group)})"


def verdict_text(result: CaseResult) -> str:
    """Write a verdict in a few words, with the classes that differ."""
    whole = result.whole
    text = said(whole) + (f", rate {whole.rate:.2f}" if whole.verdict == "supported" else "")
    others = [
        f"; {'within error' if group.agrees else group.verdict} for {group.name} ({group_points(group)})"
        for group in result.differing
    ]
    return text + "".join(others)


def overview_table(results: Results) -> Table:
    """One row a solver, one column a limit: the verdicts."""
    rows = []
    for name in results.solvers:
        found = [results.verdict(name, case.key) for case in CASES]
        rows.append([law_of(name), name, *(verdict_text(one) if one else "-" for one in found)])
    caption = (
        "Verdict on the hypothesis by law, solver and limit. Supported: the distance from the closed form falls to "
        "nothing at the rate stated (as contrast to the minus rate). Refuted: it goes to another limit. In brackets: "
        "the points at which that verdict was reached (of an undecided one: those that refute), the distances D "
        f"of the refuted points' limits from the closed form, and at how many D exceeds {FAR:g}. A class counts "
        f"as refuted from {percent(REFUTING_SHARE)} of its points, however small D is. "
        "After a semicolon: classes with another verdict"
    )
    return Table(
        with_votes(caption, results.solvers),
        ["law", "solver", *(case.key for case in CASES)],
        rows,
        text_columns=2 + len(CASES),
    )


def class_frame(results: Results) -> pd.DataFrame:
    """One row a solver, limit and class (``all`` first)."""
    rows = []
    for result in results.verdicts:
        for group in (result.whole, *result.classes):
            members = [p for p in result.points if group.name in ("all", pair_class(result.case, p.point))]
            missed = [
                p.missed for p in members if p.judgement.verdict == "refuted" and math.isfinite(p.missed)
            ]
            again = results.redrawn.get((result.solver, result.case.key, group.name))
            rows.append(
                {
                    "case": result.case.key,
                    "law": result.law,
                    "solver": result.solver,
                    "class": group.name,
                    "verdict": group.verdict,
                    **_shares(group.counts),
                    "within_solver_error": group.agrees,
                    "verdict_a_decade_before": group.shifted if result.shiftable else "",
                    **_shares(group.shifted_counts if result.shiftable else {}, "_a_decade_before"),
                    "verdict_redrawn": again.verdict if again else "",
                    **_shares(again.counts if again else {}, "_redrawn"),
                    "points": len(members),
                    **{
                        f"n_{word}": group.counts.get(word, 0)
                        for word in ("supported", "refuted", "undecided")
                    },
                    "rate": group.rate,
                    "rate_low": group.rate_low,
                    "rate_high": group.rate_high,
                    "least_rate": group.least_rate,
                    "largest_rate": group.largest_rate,
                    "decades": result.decades,
                    f"n_offset_above_{FAR:g}": group.far,
                    "offset_least": group.offset[0],
                    "offset_median": group.offset[1],
                    "offset_largest": group.offset[2],
                    "limit_error_largest": group.limit_error,
                    "prediction": next((p.prediction.form for p in members if p.prediction), ""),
                    "missed_prediction_largest": max(missed, default=math.nan),
                    "reason": group.reason,
                }
            )
    return pd.DataFrame(rows)


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
            rows.append(
                {
                    "case": result.case.key,
                    "solver": result.solver,
                    "class": pair_class(result.case, p.point),
                    "mass_ratio": p.point.mass_ratio,
                    "e1": p.point.e1,
                    "e2": p.point.e2,
                    "stiffness_ratio": p.point.stiffness_ratio,
                    "verdict": j.verdict,
                    "verdict_a_decade_before": p.shifted.verdict if result.shiftable else "",
                    "rate": j.rate,
                    "rate_low": j.rate_low,
                    "rate_high": j.rate_high,
                    "window_from": j.window[0],
                    "window_to": j.window[1],
                    "last_distance": j.last,
                    "closed_form_v1": p.closed_form[0],
                    "closed_form_v2": p.closed_form[1],
                    "limit_v1": j.limit[0],
                    "limit_v2": j.limit[1],
                    "limit_error": j.limit_error,
                    "offset": j.offset,
                    "predicted_v1": p.prediction.v1 if p.prediction else math.nan,
                    "predicted_v2": p.prediction.v2 if p.prediction else math.nan,
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
        frames.append(
            pd.DataFrame(
                {
                    "case": series.case.key,
                    "solver": series.subject.name,
                    **{
                        name: np.repeat([getattr(point, name) for point in series.points], m)
                        for name in ("mass_ratio", "e1", "e2", "stiffness_ratio")
                    },
                    "contrast": np.tile(series.contrast, n),
                    "v1": series.answers.v1,
                    "v2": series.answers.v2,
                    "error": series.answers.error,
                    "distance": series.distances().ravel(),
                    "status": series.answers.status,
                    "reason": series.answers.reason,
                    "used": usable.ravel(),
                    "grazing": grazing.ravel(),
                }
            )
        )
    return pd.concat(frames, ignore_index=True)


def mechanism_frame(results: Results) -> pd.DataFrame:
    """One row a solver, limit and contrast: the relative motion of the stiff pair."""
    names = type(results.mechanisms[0]).__slots__
    return pd.DataFrame([{name: getattr(one, name) for name in names} for one in results.mechanisms])


def map_frame(results: Results) -> pd.DataFrame:
    """One row a cell of a map."""
    frames = []
    for one in results.maps:
        kappa, masses = np.meshgrid(one.stiffness_ratio, one.mass_ratio, indexing="ij")
        columns = {"solver": one.solver, "e1": one.e1, "e2": one.e2, "stiffness_ratio": kappa.ravel()}
        columns |= {
            "mass_ratio": masses.ravel(),
            "error": one.error.ravel(),
            "uncertainty": one.uncertainty.ravel(),
            "status": one.status.ravel(),
            "reason": one.reason.ravel(),
        }
        frames.append(pd.DataFrame(columns))
    return pd.concat(frames, ignore_index=True)


def need_frame(results: Results) -> pd.DataFrame:
    """One row a map, side and mass ratio: the contrast from which the hypothesis is good to each level."""
    rows = []
    for one in results.maps:
        for soft_table in (True, False):
            for mass in MASSES:
                rows.append(
                    {
                        "solver": one.solver,
                        "e1": one.e1,
                        "e2": one.e2,
                        "side": "k2 < k1" if soft_table else "k2 > k1",
                        "mass_ratio": mass,
                        **{
                            f"contrast_{100 * level:.0f}pct": contrast_needed(
                                one, mass, level, soft_table=soft_table
                            )
                            for level in LEVELS
                        },
                        **{
                            f"share_{100 * level:.0f}pct": share_within(one, level, soft_table=soft_table)
                            for level in LEVELS
                        },
                    }
                )
    return pd.DataFrame(rows)
