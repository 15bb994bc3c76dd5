"""From the outcomes of a solver to its verdict on a limit.

Within a class of points (which contacts are elastic, `cases.pair_class`) the verdict is

* `refuted` where a tenth of the points or more is: one law, one counterexample would do, a tenth is robust;
* else `supported` where half of the points or more is, and every other one either agrees with the closed form within
  the error of its limit, or is short of results; none is refuted or fails to settle;
* else `undecided`, with the most frequent reason.

Over the classes of a limit the worst counts: `refuted` before `undecided` before `supported`; a class that is undecided
only because it is within the solver's own error of the closed form does not count against one that is supported. The
classes that differ are named beside it.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Generic, Protocol, TypeVar

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from impact_xval.compliant_baselines.registry import law_of
from impact_xval.experiments.hypothesis.cases import Case, Point, closed_form, distance, pair_class
from impact_xval.experiments.hypothesis.judging import Judgement, Verdict, judge
from impact_xval.experiments.hypothesis.predictions import Prediction, predict
from impact_xval.experiments.hypothesis.solvers import SolverUnderTest
from impact_xval.model.collision import RESULT_STATUSES

Floats = NDArray[np.float64]

#: Grazing margin below which an outcome lies beside a jump. In the limits of k2/k1 the stiff contact's ringing, which
#: is what grazes, shrinks as the root of the contrast, and the margin with it: there it is multiplied by that root.
GRAZING = 1e-3

#: Share of refuted points from which a class is.
REFUTING_SHARE = 0.1

#: Distance D of a limit from the closed form that is told apart from lesser ones: one per cent of the impact.
FAR = 0.01

#: Resamples of a bootstrap, and its seed.
_RESAMPLES, _SEED = 2000, 2013


@dataclass(frozen=True, slots=True, eq=False)
class Series:
    """Outcomes of a solver at all points of a limit.

    Attributes
    ----------
    solver : SolverUnderTest
    case : Case
    points : tuple of Point
    contrast : ndarray, shape (m,)
    outcomes : DataFrame
        Of n points and m contrasts, the contrast varying fastest (`solvers.outcomes_of`).
    """

    solver: SolverUnderTest
    case: Case
    points: tuple[Point, ...]
    contrast: Floats
    outcomes: pd.DataFrame

    def rows(self, name: str) -> NDArray:
        """Return a column of the outcomes by point and contrast, shape (n, m)."""
        return self.outcomes[name].to_numpy().reshape(len(self.points), self.contrast.size)

    def usable(self) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Which outcomes are results away from a jump, and which are grazing; shape (n, m) each."""
        scale = 1.0 if self.case.plastic else np.sqrt(self.contrast)
        done = np.isin(self.rows("status"), RESULT_STATUSES)
        grazing = done & (self.rows("grazing_margin") * scale < GRAZING)
        return done & ~grazing, grazing

    def without_result(self, i: int) -> str:
        """Say how many outcomes of a point are no results, by status, and why the first is none; empty if all are."""
        m = self.contrast.size
        by_status = self.outcomes.iloc[i * m : (i + 1) * m].groupby("status", sort=False)
        return "; ".join(
            f"{len(same)} of {m} {status}: {same.reason.iloc[0]}"
            for status, same in by_status
            if status not in RESULT_STATUSES
        )

    def distances(self) -> Floats:
        """Distance of every outcome from the closed form, shape (n, m); NaN without a result."""
        forms = np.array([closed_form(self.case, point) for point in self.points])
        mass_ratio = np.array([[point.mass_ratio] for point in self.points])
        return distance(mass_ratio, self.rows("v1") - forms[:, :1], self.rows("v2") - forms[:, 1:])


@dataclass(frozen=True, slots=True)
class PointResult:
    """One solver at one point of one limit.

    Attributes
    ----------
    point : Point
    judgement, shifted : Judgement
        On the last decades of contrast, and on those a decade before.
    prediction : Prediction or None
    closed_form : tuple of float
    grazing : int
        Outcomes left out because they lie beside a grazing jump.
    without_result : str
        How many outcomes have no result, by status, and why the first of them has none; empty if all have one.
    """

    point: Point
    judgement: Judgement
    shifted: Judgement
    prediction: Prediction | None
    closed_form: tuple[float, float]
    grazing: int
    without_result: str

    @property
    def missed(self) -> float:
        """Distance of the extrapolated limit from the prediction; NaN without either."""
        if self.prediction is None:
            return math.nan
        v1, v2 = self.judgement.limit
        dv1, dv2 = v1 - self.prediction.v1, v2 - self.prediction.v2
        return math.hypot(dv1, math.sqrt(self.point.mass_ratio) * dv2)


class Judged(Protocol):
    """What has a judgement."""

    @property
    def judgement(self) -> Judgement:
        """Of one series."""
        ...


P = TypeVar("P", bound=Judged)


@dataclass(frozen=True, slots=True)
class Group(Generic[P]):
    """The points of a class, or of all classes, together.

    Attributes
    ----------
    name : str
        Of the class; ``all`` for all.
    members : tuple of PointResult, or of others that are judged
    verdict : str
    reason : str
        If undecided.
    shifted : Group or None
        The same points judged a decade before, if the contrasts leave room for it.
    """

    name: str
    members: tuple[P, ...]
    verdict: Verdict
    reason: str
    shifted: Group[P] | None = None

    @property
    def counts(self) -> Counter[str]:
        """Points by verdict."""
        return Counter(m.judgement.verdict for m in self.members)

    @property
    def points(self) -> int:
        """How many points there are."""
        return len(self.members)

    @property
    def agrees(self) -> bool:
        """Undecided, with nothing refuted or unsettled: the closed form lies within the error of every limit."""
        judgements = [m.judgement for m in self.members]
        fine = all(j.verdict == "supported" or (j.consistent and j.settles) for j in judgements)
        return self.verdict == "undecided" and fine

    def judged(self, verdict: Verdict) -> list[P]:
        """Return the points of a verdict."""
        return [m for m in self.members if m.judgement.verdict == verdict]

    @property
    def rates(self) -> list[float]:
        """Rates at the supported points."""
        return [m.judgement.rate for m in self.judged("supported")]

    @property
    def rate(self) -> float:
        """Median of `rates`; NaN without any."""
        return float(np.median(self.rates or [math.nan]))

    @property
    def rate_interval(self) -> tuple[float, float]:
        """95 % bootstrap interval of `rate`; one rate is legal, which scipy.stats.bootstrap refuses."""
        rates = self.rates or [math.nan]
        draws = np.random.default_rng(_SEED).choice(rates, (_RESAMPLES, len(rates)))
        low, high = map(float, np.quantile(np.median(draws, axis=1), [0.025, 0.975]))
        return low, high

    @property
    def offsets(self) -> list[float]:
        """Distances of the limits from the closed form at the refuted points."""
        return [m.judgement.offset for m in self.judged("refuted")]

    @property
    def far(self) -> int:
        """Refuted points whose limit lies further than `FAR` from the closed form."""
        return sum(offset > FAR for offset in self.offsets)

    @property
    def word(self) -> str:
        """The verdict in a word or two."""
        return "within error" if self.agrees else self.verdict


@dataclass(frozen=True, slots=True, eq=False)
class CaseResult:
    """One solver at one limit.

    Attributes
    ----------
    solver : str
    kind : str
        `exact`, `stepped` or `single`.
    case : Case
    whole : Group
    classes : tuple of Group
    decades : float
        Of the fits.
    """

    solver: str
    kind: str
    case: Case
    whole: Group[PointResult]
    classes: tuple[Group[PointResult], ...]
    decades: float

    @property
    def law(self) -> str:
        """The law the solver has or was given."""
        return law_of(self.solver) or "-"

    @property
    def differing(self) -> tuple[Group, ...]:
        """Classes whose verdict is not that of the whole."""
        return tuple(group for group in self.classes if group.verdict != self.whole.verdict)


def examine(series: Series, decades: float) -> CaseResult:
    """Judge every point of a series, on its last decades and on those a decade before, and gather the verdicts."""
    usable, grazing = series.usable()
    x = series.contrast
    results = []
    for i, point in enumerate(series.points):
        v1, v2, error = (series.rows(name)[i] for name in ("v1", "v2", "error"))
        velocities, masses = np.column_stack([v1, v2]), (1.0, point.mass_ratio)
        form = closed_form(series.case, point)
        judgement = judge(x, velocities, error, usable[i], form, masses, decades)
        # The window may end before the last contrast, where rounding is reached: a decade before *its* end, if that
        # leaves enough.
        end = judgement.window[1] / 10
        enough = np.log10(end / x[0]) >= decades - 1e-6
        before = x <= (end if enough else x[-1] / 10) * (1 + 1e-6)
        shifted = judge(x, velocities, error, usable[i] & before, form, masses, decades)
        prediction = predict(series.case, point, series.solver.family)
        beside, lost = int(grazing[i].sum()), series.without_result(i)
        results.append(PointResult(point, judgement, shifted, prediction, form, beside, lost))
    names = [pair_class(series.case, point) for point in series.points]
    groups = gather(names, results)
    if np.log10(x[-1] / x[0]) >= decades + 1 - 1e-6:
        earlier = gather(names, [replace(result, judgement=result.shifted) for result in results])
        groups = [replace(now, shifted=then) for now, then in zip(groups, earlier, strict=True)]
    whole, *classes = groups
    return CaseResult(series.solver.name, series.solver.kind, series.case, whole, tuple(classes), decades)


def gather(names: Sequence[str], results: Sequence[P]) -> list[Group[P]]:
    """Give the verdict over all points, and then that of every class; the name of its class for each point."""
    classes: dict[str, list[P]] = {}
    for name, result in zip(names, results, strict=True):
        classes.setdefault(name, []).append(result)
    groups = [
        Group(name, tuple(members), *class_verdict([m.judgement for m in members]))
        for name, members in classes.items()
    ]
    verdict = _worst(groups)
    reason = next((group.reason for group in groups if group.verdict == verdict), "")
    return [Group("all", tuple(results), verdict, reason), *groups]


def class_verdict(judgements: Sequence[Judgement]) -> tuple[Verdict, str]:
    """Verdict of a class, and the reason if undecided; the rule is in the module."""
    n = len(judgements)
    by = Counter(j.verdict for j in judgements)
    if by["refuted"] >= max(1, REFUTING_SHARE * n):
        return "refuted", ""
    open_ones = [j for j in judgements if j.verdict == "undecided"]
    astray = [j for j in open_ones if not j.settles]
    harmless = all(j.consistent or not math.isfinite(j.offset) for j in open_ones)
    if 2 * by["supported"] >= n and not by["refuted"] and not astray and harmless:
        return "supported", ""
    worst = astray or open_ones
    if not worst:
        return "undecided", "one point alone is refuted"
    return "undecided", f"{worst[0].reason} ({len(worst)} of {n} points so)"


def _worst(groups: Sequence[Group[P]]) -> Verdict:
    """Verdict over classes; one that agrees within the solver's error does not count against support."""
    verdicts = {group.verdict for group in groups}
    if "refuted" in verdicts:
        return "refuted"
    unexplained = any(group.verdict == "undecided" and not group.agrees for group in groups)
    return "undecided" if unexplained or "supported" not in verdicts else "supported"
