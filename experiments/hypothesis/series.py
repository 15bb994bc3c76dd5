"""The series of a solver towards a limit: contrasts, outcomes and what they say."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from impact_xval.experiments.hypothesis.cases import Case, Point, closed_form
from impact_xval.experiments.hypothesis.judging import judge
from impact_xval.experiments.hypothesis.predictions import predict
from impact_xval.experiments.hypothesis.subjects import Answers, Subject
from impact_xval.experiments.hypothesis.verdicts import CaseResult, PointResult, gather
from impact_xval.model.collision import RESULT_STATUSES

Floats = NDArray[np.float64]

#: Grazing margin below which an outcome lies beside a jump. In the limits of k2/k1 the stiff contact's ringing, which
#: is what grazes, shrinks as the root of the contrast, and the margin with it: there it is multiplied by that root.
GRAZING = 1e-3


@dataclass(frozen=True, slots=True, eq=False)
class Series:
    """Outcomes of a subject at all points of a limit.

    Attributes
    ----------
    subject : Subject
    case : Case
    points : tuple of Point
    contrast : ndarray, shape (m,)
    answers : Answers
        Of n m outcomes, the contrast varying fastest.
    """

    subject: Subject
    case: Case
    points: tuple[Point, ...]
    contrast: Floats
    answers: Answers

    def rows(self, name: str) -> NDArray:
        """Return a column of the answers by point and contrast, shape (n, m)."""
        return getattr(self.answers, name).reshape(len(self.points), self.contrast.size)

    def usable(self) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Which outcomes are results away from a jump, and which are grazing; shape (n, m) each."""
        scale = 1.0 if self.case.plastic else np.sqrt(self.contrast)
        done = np.isin(self.rows("status"), RESULT_STATUSES)
        grazing = done & (self.rows("grazing_margin") * scale < GRAZING)
        return done & ~grazing, grazing

    def without_result(self, i: int) -> str:
        """Say how many outcomes of a point are no results, by status, and why the first is none; empty if all are."""
        row, reasons = self.rows("status")[i], self.rows("reason")[i]
        found = []
        for status in dict.fromkeys(row[~np.isin(row, RESULT_STATUSES)]):
            which = np.flatnonzero(row == status)
            found.append(f"{which.size} of {row.size} {status}: {reasons[which[0]]}")
        return "; ".join(found)

    def distances(self) -> Floats:
        """Distance of every outcome from the closed form, shape (n, m); NaN without a result."""
        forms = np.array([closed_form(self.case, point) for point in self.points])
        mass = np.array([[point.mass_ratio] for point in self.points])
        dv1, dv2 = self.rows("v1") - forms[:, :1], self.rows("v2") - forms[:, 1:]
        return np.sqrt(np.square(dv1) + mass * np.square(dv2))


def ratios_of(case: Case, points: Sequence[Point], contrast: Floats) -> Floats:
    """Return k2/k1, m2/m1, e1, e2 of every point and contrast, shape (4, n m)."""
    return np.array([point.ratios(case, float(x)) for point in points for x in contrast]).reshape(-1, 4).T


def examine(series: Series, decades: float) -> CaseResult:
    """Judge every point of a series, on its last decades and on those a decade before, and gather the verdicts."""
    usable, grazing = series.usable()
    x = series.contrast
    v1, v2, error = (series.rows(name) for name in ("v1", "v2", "error"))
    shiftable = bool(np.log10(x[-1] / x[0]) >= decades + 1 - 1e-6)
    results = []
    for i, point in enumerate(series.points):
        form = closed_form(series.case, point)

        def judged(which: NDArray[np.bool_], i: int = i, point: Point = point, form=form):
            return judge(x, v1[i], v2[i], error[i], which, form, point.mass_ratio, decades)

        judgement = judged(usable[i])
        # The window may end before the last contrast, where rounding is reached: a decade before *its* end, if that
        # leaves enough.
        end = judgement.window[1] / 10
        enough = np.log10(end / x[0]) >= decades - 1e-6
        before = x <= (end if enough else x[-1] / 10) * (1 + 1e-6)
        results.append(
            PointResult(
                point,
                judgement,
                judged(usable[i] & before),
                predict(series.case, point, series.subject.family),
                form,
                int(grazing[i].sum()),
                series.without_result(i),
            )
        )
    return gather(series.subject.name, series.subject.kind, series.case, results, decades, shiftable)
