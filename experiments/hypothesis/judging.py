"""Verdicts on a limiting case, from the outcomes of a solver.

A series is the outcomes of one solver at one point, at rising contrasts x. Velocities are vectors w whose length is the
kinetic norm; for two balls w = (v1, sqrt(m2/m1) v2). The rule asks whether a series gets to the closed form, at what
rate, and where it goes if not:

1. The *window* is the last `decades` of the usable outcomes. It ends where the distance D from the closed form sinks
   under `FLOOR_ERRORS` errors of the solver for good.
2. **Rate**: slope of ln D over ln x by Theil and Sen. Contacts that ring let D dip to nothing at single contrasts; a
   median of slopes does not notice these dips.
3. **Limit**: w = L + A x^-s by least squares, s from `EXPONENTS`. Its error is the largest of: what the same fit gives
   without the last decade (or half of a short window), with a second term in x^-2s, or with any s that leaves no more
   than twice the least residual; that residual; and the solver's own error.
4. The series **settles** if the diameter of its last decade is below that of its first by at least `LEAST_RATE` a
   decade, or below what the solver resolves, or below a tenth of its distance from the closed form. In the last case
   the limit is the mean of that decade, with that diameter as its error.
5. It **jumps** where, in the later half of the window, D exceeds both the line of the rate and the D before by `JUMP`.

Points are grouped in classes by which of their contacts are elastic (`run.pair_class`). The verdict on a class is

* `refuted` if at least a tenth of the points are refuted: for one law a single counterexample would do, a tenth is
  robust;
* else `supported` if at least half of the points are, none is refuted or fails to settle, and every other point either
  agrees with the closed form within the error of its limit or is short of results;
* else `no limit` if at least half of the points have none; else `undecided`.

Over the classes of a limiting case the worst verdict counts. A class that is undecided only because it is within the
solver's own error of the closed form does not count beside one that is supported.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.distance import pdist
from scipy.stats import theilslopes

from impact_xval.experiments.tables.frames import Frame, Record
from impact_xval.model.arrays import Floats
from impact_xval.model.status import RESULT_STATUSES

#: Least rate of an approach: over four decades such a distance falls by 2.5.
LEAST_RATE = 0.1

#: Least factor by which the median distance falls from the first decade of a window to the last. A series that falls
#: by less may level out just beyond the window.
LEAST_FALL = 2.5

#: D below this many errors of the solver is hidden by them.
FLOOR_ERRORS = 3.0

#: Factor by which a jump exceeds its neighbours.
JUMP = 30.0

#: Exponents s that are tried for the limit.
EXPONENTS = np.arange(0.1, 3.01, 0.05)

#: Share of refuted points that refutes their class.
REFUTING_SHARE = 0.1

#: A margin in decades: contrasts are rounded.
_SLACK = 1e-6

#: Grazing margin below which an outcome lies beside a jump. In the limiting cases of k2/k1 the ringing of the stiff
#: contact is what grazes. It shrinks as the root of the contrast, and so does the margin, which is multiplied by that
#: root there.
GRAZING = 1e-3

#: D up to which a limiting case is close enough to be used, per impact.
CLOSE = 0.05

#: Resamples of a bootstrap, and its seed.
_RESAMPLES, _SEED = 2000, 2013

#: Verdicts, the worst first.
_ORDER = ("refuted", "no limit", "undecided", "supported")


@dataclass(frozen=True, slots=True)
class Verdict:
    """Verdict on one series: the columns of ``points.csv`` that judge it, in their order.

    Velocities and distances are per abs(v0) for pairs, and in m/s with incoming balls of 1 m/s for chains. Numbers are
    NaN where the series does not tell them.
    """

    verdict: str = "undecided"
    #: Why the series is neither supported nor refuted; else empty.
    reason: str = ""
    #: Whether the closed form is within three errors of the limit.
    consistent: bool = False
    settles: bool = True
    #: r of D ~ x^-r, with its 95 % interval.
    rate: float = math.nan
    rate_low: float = math.nan
    rate_high: float = math.nan
    #: Median of D over the last decade.
    last: float = math.nan
    limit_error: float = math.nan
    #: D of the limit.
    offset: float = math.nan
    #: Velocities of the balls in the limit; columns ``limit_v1``, ``limit_v2``, ...
    limit: tuple[float, ...] = ()

    def columns(self) -> Record:
        """Return the columns by name, one for each ball in place of `limit`."""
        values = asdict(self)
        limit = values.pop("limit")
        return values | {f"limit_v{ball}": v for ball, v in enumerate(limit, 1)}


@dataclass(frozen=True, slots=True)
class ClassVerdict:
    """Verdict on a class of points: the columns of ``verdicts.csv`` after its keys, in their order."""

    verdict: str
    #: Whether the class is undecided only because it is within the solver's own error of the closed form.
    within_error: bool
    #: Number of points, and of those with each verdict; points with no limit count as undecided.
    points: int
    n_supported: int
    n_refuted: int
    n_undecided: int
    #: Median rate of the supported points, with its 95 % bootstrap interval.
    rate: float
    rate_low: float
    rate_high: float
    #: Range of the rates of the supported points.
    least_rate: float
    largest_rate: float
    #: Range of the distances of the refuted points from the closed form.
    offset_least: float
    offset_largest: float
    #: Median contrast from which D stays within `CLOSE`.
    close_from: float
    reason: str


class Approach(NamedTuple):
    """Outcomes of one solver at one point, at n rising contrasts, and the closed form that they should approach."""

    contrast: Floats
    #: Which outcomes can be used, shape (n,).
    used: NDArray[np.bool_]
    #: Velocities of N balls, shape (n, N).
    velocities: Floats
    #: The solver's error of each outcome, as a distance D.
    error: Floats
    #: Velocities of the closed form, shape (N,).
    closed_form: Floats
    #: Masses in the unit of D, shape (N,).
    weights: Floats
    #: Decades of contrast that a verdict needs.
    decades: float


class Series(NamedTuple):
    """Usable outcomes at rising contrasts, one element or row per outcome."""

    #: log10 of the contrast.
    x: Floats
    #: Velocities as vectors whose length is the kinetic norm, shape (n, N).
    w: Floats
    #: Distance from the closed form.
    D: Floats
    #: The solver's error, as a distance D.
    error: Floats
    #: Whether D exceeds `FLOOR_ERRORS` errors.
    clear: NDArray[np.bool_]

    def part(self, low: float, high: float = np.inf) -> Series:
        """Return the outcomes between two x, both included."""
        inside = (low - _SLACK <= self.x) & (self.x <= high + _SLACK)
        return Series(self.x[inside], self.w[inside], self.D[inside], self.error[inside], self.clear[inside])

    def first_and_last_decade(self) -> tuple[Series, Series]:
        """Return the outcomes of the first decade, and of the last."""
        return self.part(self.x[0], self.x[0] + 1), self.part(self.x[-1] - 1)


class SeriesLimit(NamedTuple):
    """Limit of a series."""

    #: The limit as a vector w, shape (N,), and its error.
    w: Floats
    error: float
    #: Whether the last decade is about as wide as the first, and wider than the solver's error.
    restless: bool
    #: Whether the series settles: it is not restless, or it circles a place that is far from the closed form.
    settles: bool


class RateLine(NamedTuple):
    """Line log10 D = `at_zero` - `rate` x through a window, with a 95 % interval of its rate; NaN without a line."""

    rate: float = math.nan
    low: float = math.nan
    high: float = math.nan
    at_zero: float = math.nan


def kinetic_distance(weights: ArrayLike, differences: ArrayLike) -> Floats:
    """Return D of differences of velocities, shape (..., N): their kinetic norm with `weights` as masses."""
    return np.sqrt((np.asarray(weights) * np.square(differences)).sum(axis=-1))


def mark_usable(outcomes: Frame, root: Floats | float) -> Frame:
    """Add the columns `used` and `grazing` to outcomes.

    An outcome is used if it has a result, hence a distance, and lies beside no jump: its grazing margin times `root`
    is at least `GRAZING`.
    """
    has_result = outcomes.distance.notna()
    grazing = has_result & (outcomes.grazing_margin.fillna(np.inf) * root < GRAZING)
    return outcomes.assign(used=has_result & ~grazing, grazing=grazing)


def judge_approach(approach: Approach) -> Verdict:
    """Judge the outcomes of one solver at one point."""
    scale = np.sqrt(approach.weights)
    closed_form = approach.closed_form * scale
    window = _choose_window(_usable_series(approach, closed_form, scale), approach.decades)
    unknown = Verdict(limit=(math.nan,) * len(scale))
    if isinstance(window, str):
        return replace(unknown, reason=window)
    limit = _find_limit(window, approach.decades)
    offset = float(kinetic_distance(1.0, limit.w - closed_form))
    last = np.median(window.first_and_last_decade()[1].D)
    verdict = replace(
        unknown,
        consistent=bool(not limit.restless and offset <= 3 * limit.error),
        settles=limit.settles,
        last=last,
        limit_error=limit.error,
        offset=offset,
    )
    if not limit.settles:
        return _judge_unsettled(window, verdict)
    verdict = replace(verdict, limit=tuple(limit.w / scale))
    if _is_refuted(window, verdict):
        return replace(verdict, verdict="refuted")
    line = fit_rate(window)
    verdict = replace(verdict, rate=line.rate, rate_low=line.low, rate_high=line.high)
    return decide(window, line, verdict)


def _usable_series(approach: Approach, closed_form: Floats, scale: Floats) -> Series:
    """Return the usable outcomes as vectors w; the closed form is such a vector too."""
    w = approach.velocities[approach.used] * scale
    D = kinetic_distance(1.0, w - closed_form)
    # An estimate of an error can vanish by chance: the largest of three neighbours counts.
    error = np.pad(approach.error[approach.used], 1, constant_values=-np.inf)
    error = np.maximum(np.maximum(error[:-2], error[1:-1]), error[2:])
    return Series(np.log10(approach.contrast[approach.used]), w, D, error, FLOOR_ERRORS * error < D)


def _choose_window(series: Series, decades: float) -> Series | str:
    """Return the window of a series, or the reason why it has none."""
    x = series.x
    span = np.ptp(x) if x.size else 0.0
    if span < decades - _SLACK:
        return f"outcomes span {span:.2g} decades of contrast, a rate needs {decades:g}: extend the range"
    end = x[series.clear].max(initial=x[0] + decades)
    window = series.part(end - decades, end)
    n, reach = window.x.size, np.ptp(window.x)
    if reach < decades - _SLACK or n < 2 * decades + 1:
        return f"{n} outcomes over {reach:.2g} decades are too few: results are missing in between"
    return window


def _find_limit(window: Series, decades: float) -> SeriesLimit:
    """Find the limit of a series, and whether the series settles there."""
    first, last = window.first_and_last_decade()
    first_diameter, last_diameter = (pdist(decade.w).max(initial=0.0) for decade in (first, last))
    is_resolved = last_diameter > FLOOR_ERRORS * last.error.max()
    restless = bool(is_resolved and last_diameter > first_diameter * 10 ** (-LEAST_RATE * (decades - 1)))
    circles_far_off = restless and last_diameter < 0.1 * last.D.min()
    if circles_far_off:
        return SeriesLimit(last.w.mean(axis=0), last_diameter, restless, settles=True)
    limit, error = _extrapolate(window)
    return SeriesLimit(limit, error, restless, settles=not restless)


def _judge_unsettled(window: Series, verdict: Verdict) -> Verdict:
    """Judge a series that does not settle; one that still falls from contrast to contrast is undecided."""
    last = window.first_and_last_decade()[1]
    reason = f"it does not settle: in the last decade D runs from {last.D.min():.3g} to {last.D.max():.3g}"
    falls = np.all(np.diff(window.D) < 0)
    return replace(verdict, verdict="undecided" if falls else "no limit", reason=reason)


def _is_refuted(window: Series, verdict: Verdict) -> bool:
    """Return whether a series that settles goes to another value than the closed form."""
    last = window.first_and_last_decade()[1]
    is_clear_of_error = verdict.offset > max(3 * verdict.limit_error, 0.2 * verdict.last)
    return bool(is_clear_of_error and last.D.min() > 0.5 * verdict.offset)


def fit_rate(window: Series) -> RateLine:
    """Fit the rate of an approach to the distances that exceed the solver's error."""
    if np.count_nonzero(window.clear) < 3:
        return RateLine()
    log_D = np.log10(window.D[window.clear])
    line = np.array(theilslopes(log_D, window.x[window.clear], alpha=0.95), dtype=float)
    slope, intercept, low_slope, high_slope = line.tolist()
    return RateLine(-slope, -high_slope, -low_slope, intercept)


def decide(window: Series, line: RateLine, verdict: Verdict) -> Verdict:
    """Decide on a series that settles and is not refuted: supported, undecided, or no limit if it jumps."""
    jumps = _count_jumps(window, line)
    if jumps:
        reason = (
            f"it jumps: {jumps} of {window.x.size} outcomes lie {JUMP:g} times further off than the others"
        )
        return replace(verdict, verdict="no limit", reason=reason, settles=False, consistent=False)
    first, last = window.first_and_last_decade()
    if not window.clear[-1]:
        reason = f"it is within the solver's own error ({last.error.max():.1g}) of the closed form too soon"
        return replace(verdict, reason=reason)
    if not line.low > LEAST_RATE:  # also if there is no line
        reason = f"the rate {line.rate:.2g} ({line.low:.2g} to {line.high:.2g}) cannot be told from none"
        return replace(verdict, reason=reason)
    fall = np.median(first.D) / verdict.last
    if fall < LEAST_FALL:
        reason = f"the distance falls by {fall:.2g} from the fit's first decade to its last: extend the range"
        return replace(verdict, reason=reason)
    return replace(verdict, verdict="supported")


def _count_jumps(window: Series, line: RateLine) -> int:
    """Count the jumps in the later half of a window: D exceeds the line and the D before by `JUMP`."""
    x, log_D = window.x[window.clear], np.log10(window.D[window.clear])
    above_line = log_D - line.at_zero + line.rate * x
    above_before = np.diff(log_D, prepend=log_D[:1])
    is_jump = np.minimum(above_line, above_before) > np.log10(JUMP)
    is_late = x >= 0.5 * (window.x[0] + window.x[-1])
    return int(np.count_nonzero(is_jump & is_late))


def _fit_limits(x: Floats, w: Floats) -> tuple[Floats, Floats]:
    """Return the limits L (k, N) of w = L + A x^-s for every s of `EXPONENTS`, and their rms residuals (k,)."""
    base = 10.0 ** (-np.outer(EXPONENTS, x - x[0]))
    mean, centre = base.mean(axis=1, keepdims=True), w.mean(axis=0)
    slope = ((base - mean) @ (w - centre)) / np.square(base - mean).sum(axis=1, keepdims=True)
    limits = centre - slope * mean
    residual = w[None] - limits[:, None] - base[:, :, None] * slope[:, None]
    return limits, np.sqrt(np.square(residual).sum(axis=(1, 2)) / x.size)


def _extrapolate(window: Series) -> tuple[Floats, float]:
    """Extrapolate a window; return its limit w and the error of the limit, as point 3 of the module says."""
    x, w = window.x, window.w
    last = window.first_and_last_decade()[1]
    limits, residuals = _fit_limits(x, w)
    best = int(np.argmin(residuals))
    limit, least = limits[best], float(residuals[best])
    shorter = x <= x[-1] - min(1.0, 0.5 * (x[-1] - x[0])) + _SLACK
    shorter_limits, shorter_residuals = _fit_limits(x[shorter], w[shorter])
    without_last_decade = shorter_limits[int(np.argmin(shorter_residuals))]
    base = 10.0 ** (-EXPONENTS[best] * (x - x[0]))
    two_terms = np.linalg.lstsq(np.column_stack([np.ones_like(x), base, base**2]), w, rcond=None)[0][0]
    alternatives = [without_last_decade, two_terms, *limits[residuals <= 2 * least + 1e-15]]
    spread = kinetic_distance(1.0, np.array(alternatives) - limit).max()
    error = max(least, last.error.max(), float(spread))
    no_exponent_fits = best in (0, len(EXPONENTS) - 1) and least > 1e-12
    if no_exponent_fits:
        error = max(error, float(kinetic_distance(1.0, last.w - last.w.mean(axis=0)).max()))
    return limit, error


def judge_points(outcomes: Frame, keys: Sequence[str]) -> Frame:
    """Judge every series of outcomes, of pairs or of chains: one row for the outcomes that share `keys`.

    The columns are the keys, those of `Verdict`, and three on the outcomes: `close_from`, the contrast from which D
    stays within `CLOSE`; `grazing_left_out`, how many lie beside a jump; and `without_result`, how many have no result.
    """
    rows = []
    table = {name: outcomes[name].to_numpy() for name in outcomes}
    for key, places in outcomes.groupby(list(keys), sort=False).indices.items():
        series = {name: values[places] for name, values in table.items()}
        rows.append(
            dict(zip(keys, key, strict=True))
            | judge_approach(_approach_of(series)).columns()
            | {
                "close_from": _close_from(series["contrast"], series["distance"]),
                "grazing_left_out": series["grazing"].sum(),
                "without_result": _count_missing(series["status"], series["reason"]),
            }
        )
    return pd.DataFrame(rows)


def _approach_of(series: Mapping[str, np.ndarray]) -> Approach:
    """Make an `Approach` of the columns of outcomes of one solver at one point."""
    return Approach(
        contrast=series["contrast"],
        used=series["used"].astype(bool),
        velocities=np.array(list(series["velocities"])),
        error=series["error"],
        closed_form=np.array(series["closed_form"][0]),
        weights=np.array(series["weights"][0]),
        decades=series["decades"][0],
    )


def _close_from(contrast: Floats, distances: Floats) -> float:
    """Return the contrast from which D stays within `CLOSE`; infinite if the last outcome is not close."""
    # A place before the first outcome stands for "not close", so that the first may be the answer.
    last_far_place = np.flatnonzero(np.r_[True, ~(distances <= CLOSE)])[-1]
    return [*contrast, np.inf][last_far_place]


def _count_missing(statuses: Sequence[str], reasons: Sequence[str]) -> str:
    """Count the outcomes without a result by status, with the first reason of each status; empty if there are none."""
    counts = Counter(status for status in statuses if status not in RESULT_STATUSES)
    first_reasons = dict(zip(statuses[::-1], reasons[::-1], strict=True))
    return "; ".join(f"{n} {status}: {first_reasons[status]}" for status, n in sorted(counts.items()))


def judge_classes(points: Frame, keys: Sequence[str]) -> Frame:
    """Judge the classes of points: for each value of `keys` a row of class ``all``, then one row for each class.

    The columns are the keys, `class` and those of `ClassVerdict`.
    """
    rows = []
    for key, group in points.groupby(list(keys), sort=False):
        classes = {"all": _judge_class(group)}
        classes |= {name: _judge_class(members) for name, members in group.groupby("class", sort=False)}
        worst = _worst_class([verdict for name, verdict in classes.items() if name != "all"])
        classes["all"] = replace(classes["all"], verdict=worst.verdict, reason=worst.reason)
        shared = dict(zip(keys, key, strict=True))
        rows += [shared | {"class": name} | asdict(verdict) for name, verdict in classes.items()]
    return pd.DataFrame(rows)


def _worst_class(classes: Sequence[ClassVerdict]) -> ClassVerdict:
    """Return the worst verdict; beside a supported class, those within the solver's own error do not count."""
    is_supported = any(verdict.verdict == "supported" for verdict in classes)
    counting = [verdict for verdict in classes if not (verdict.within_error and is_supported)]
    return min(counting, key=lambda verdict: _ORDER.index(verdict.verdict))


def _judge_class(points: Frame) -> ClassVerdict:
    """Judge a class of points by the rule that the module states."""
    supported, refuted = (points[points.verdict == verdict] for verdict in ("supported", "refuted"))
    undecided = points[~points.verdict.isin(["supported", "refuted"])]
    unsettled = undecided[~undecided.settles]
    n, reason = len(points), ""
    is_harmless = undecided.consistent | ~np.isfinite(undecided.offset)
    if len(refuted) >= max(1, REFUTING_SHARE * n):
        verdict = "refuted"
    elif 2 * len(supported) >= n and refuted.empty and unsettled.empty and is_harmless.all():
        verdict = "supported"
    else:
        verdict = "no limit" if 2 * (points.verdict == "no limit").sum() >= n else "undecided"
        worst = undecided if unsettled.empty else unsettled
        reason = (
            f"{len(worst)} of {n} points: {worst.reason.iloc[0]}" if len(worst) else "one point is refuted"
        )
    agrees = (points.verdict == "supported") | (points.consistent & points.settles)
    rate_low, rate_high = _bootstrap_median(supported.rate.to_numpy())
    return ClassVerdict(
        verdict=verdict,
        within_error=bool(verdict == "undecided" and agrees.all()),
        points=n,
        n_supported=len(supported),
        n_refuted=len(refuted),
        n_undecided=len(undecided),
        rate=supported.rate.median(),
        rate_low=rate_low,
        rate_high=rate_high,
        least_rate=supported.rate.min(),
        largest_rate=supported.rate.max(),
        offset_least=refuted.offset.min(),
        offset_largest=refuted.offset.max(),
        close_from=points.close_from.median(),
        reason=reason,
    )


def _bootstrap_median(rates: Floats) -> tuple[float, float]:
    """Return the 95 % bootstrap interval of a median; NaN without rates."""
    # One rate is legal, which scipy.stats.bootstrap refuses.
    if not rates.size:
        return math.nan, math.nan
    draws = np.random.default_rng(_SEED).choice(rates, (_RESAMPLES, rates.size))
    low, high = np.quantile(np.median(draws, axis=1), [0.025, 0.975])
    return low, high
