"""Verdicts on whether the outcomes of a solver approach the closed form of a limiting case.

In a limiting case one contact becomes infinitely stiff compared with the others. The contrast x is the ratio of the
stiffnesses. A series is the outcomes of one solver at rising contrasts, with all other parameters fixed at one point.
Velocities are written as vectors w whose length is the kinetic norm; for two balls w = (v1, sqrt(m2/m1) v2). D is the
distance of w from the closed form. The rule of the verdict finds out whether a series approaches the closed form, and
at what rate. If the series does not, the rule finds out where it goes instead. These are the steps of the rule:

1. The **window** consists of the usable outcomes in the last `decades` of contrast. It ends where D sinks for good
   below `FLOOR_ERRORS` times the error of the solver.
2. The **rate** is the slope of ln D over ln x, by the method of Theil and Sen. At single contrasts D drops almost to 0,
   because contacts ring. The method takes a median of slopes, which these drops do not influence.
3. The **limit** is L in the fit w = L + A x^-s by least squares, with s from `EXPONENTS`. Several numbers are computed
   for the error of the limit, and the largest of them is taken. Three of them are changes of L: if the fit leaves out
   the last decade (or half of a short window), if it has a second term in x^-2s, or if it takes any other s whose
   residual is at most twice the least residual. The other two are the least residual and the error of the solver.
   If the best s is the first or the last of `EXPONENTS`, the largest distance of the last decade's outcomes from their
   mean counts too.
4. A series **settles** if the diameter of its last decade is smaller than the diameter of its first decade by at least
   the factor 10^`LEAST_RATE` per decade. It also settles if the diameter of its last decade is below what the solver
   resolves, or below a tenth of the distance from the closed form. In the last case the limit is the mean of the last
   decade, and the diameter is the error of the limit.
5. A series **jumps** at a contrast in the later half of the window if D there exceeds two numbers by the factor `JUMP`:
   the fitted line of the rate, and D at the contrast before.

Points are grouped in classes by which of their contacts are elastic (`run.pair_class`). The verdict on a class is

* `refuted` if at least a tenth of its points are refuted. A single counterexample would refute a law, but a tenth is
  robust against errors of the solver;
* else `supported` if at least half of its points are supported, no point is refuted or fails to settle, and every other
  point either agrees with the closed form within the error of its limit or has too few results;
* else `no limit` if at least half of its points have no limit; else `undecided`.

The verdict on a limiting case is the worst verdict on its classes. A class may be undecided only because it agrees with
the closed form within the error of the solver. Such a class does not count if another class is supported.
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

#: Least rate r of an approach D ~ x^-r. Over four decades of contrast D falls at this rate by a factor of 2.5.
LEAST_RATE = 0.1

#: Least factor by which the median D of a supported series falls from the first decade of its window to the last
#: decade. If D falls by less, it may stop falling just beyond the window.
LEAST_FALL = 2.5

#: A distance D counts as known only if it exceeds the error of the solver by this factor.
FLOOR_ERRORS = 3.0

#: Factor by which D at a jump exceeds both the fitted line and the D at the contrast before.
JUMP = 30.0

#: Exponents s that are tried in the fit w = L + A x^-s, which gives the limit L of a series.
EXPONENTS = np.arange(0.1, 3.01, 0.05)

#: Least share of refuted points with which a class of points is refuted.
REFUTING_SHARE = 0.1

#: Margin, in decades, with which two contrasts are compared, because contrasts are rounded.
_SLACK = 1e-6

#: Grazing margin below which an outcome lies next to a jump of the model, and is not used. In the limiting cases of
#: k2/k1 the stiff contact rings, and this ringing grazes. The ringing and the grazing margin both shrink as the inverse
#: of the square root of the contrast. So the margin is multiplied by this square root before it is compared with
#: `GRAZING`.
GRAZING = 1e-3

#: Largest D, in units of the motion before the impact, at which an outcome counts as close to the closed form of a
#: limiting case.
CLOSE = 0.05

#: Number of random samples for the bootstrap interval of a median rate, and the seed of these samples.
_RESAMPLES, _SEED = 2000, 2013

#: All verdicts, from the worst to the best.
_ORDER = ("refuted", "no limit", "undecided", "supported")


@dataclass(frozen=True, slots=True)
class Verdict:
    """Verdict on one series of outcomes. The fields are columns of ``points.csv``, in the order of the columns.

    Velocities and distances are per abs(v0) for pairs of balls. For chains they are in m/s, and the incoming balls have
    1 m/s. A number is NaN if it cannot be computed from the series.
    """

    verdict: str = "undecided"
    #: Reason why the series is neither supported nor refuted. The text is empty for a supported or refuted series.
    reason: str = ""
    #: Whether the distance of the limit from the closed form is at most three times the error of the limit.
    consistent: bool = False
    settles: bool = True
    #: Rate r in D ~ x^-r for the contrast x, and the ends of its 95 % interval.
    rate: float = math.nan
    rate_low: float = math.nan
    rate_high: float = math.nan
    #: Median of D over the last decade of contrast.
    last: float = math.nan
    limit_error: float = math.nan
    #: Distance D of the limit from the closed form.
    offset: float = math.nan
    #: Velocities of the balls in the limit. They are the columns ``limit_v1``, ``limit_v2``, ...
    limit: tuple[float, ...] = ()

    def columns(self) -> Record:
        """Return the fields by name; the limit becomes one column per ball, ``limit_v1``, ``limit_v2``, ..."""
        values = asdict(self)
        limit = values.pop("limit")
        return values | {f"limit_v{ball}": v for ball, v in enumerate(limit, 1)}


@dataclass(frozen=True, slots=True)
class ClassVerdict:
    """Verdict on a class of points. The fields are the last columns of ``verdicts.csv``, in their order."""

    verdict: str
    #: True if the class is undecided only because its points agree with the closed form within the error of the solver.
    within_error: bool
    #: Number of all points of the class, then the numbers of supported, refuted and undecided points. Points with the
    #: verdict ``no limit`` count as undecided.
    points: int
    n_supported: int
    n_refuted: int
    n_undecided: int
    #: Median rate of the supported points, and the ends of its 95 % bootstrap interval.
    rate: float
    rate_low: float
    rate_high: float
    #: Least and largest rate of the supported points.
    least_rate: float
    largest_rate: float
    #: Least and largest distance between the limit of a refuted point and the closed form.
    offset_least: float
    offset_largest: float
    #: Contrast from which on D is at most `CLOSE`. It is the median of this contrast over the points of the class.
    close_from: float
    reason: str


class Approach(NamedTuple):
    """Outcomes of one solver at one point, at n rising contrasts, and the closed form that they may approach."""

    contrast: Floats
    #: Mask of the outcomes that have a result and do not lie next to a jump, shape (n,).
    used: NDArray[np.bool_]
    #: Final velocities of the N balls at each contrast, shape (n, N).
    velocities: Floats
    #: Error of the solver in each outcome, as a distance D, shape (n,).
    error: Floats
    #: Final velocities by the closed form of the limiting case, shape (N,).
    closed_form: Floats
    #: Weights of the balls in D, shape (N,). D is sqrt(sum of weight times velocity difference squared), and the
    #: weights are proportional to the masses.
    weights: Floats
    #: Number of decades of contrast that a verdict is based on.
    decades: float


class Series(NamedTuple):
    """Usable outcomes of one solver at rising contrasts. The arrays have one element or row per outcome."""

    #: Decimal logarithm of the contrast.
    x: Floats
    #: Velocities as vectors w whose length is the kinetic norm, shape (n, N).
    w: Floats
    #: Distance of the velocities from the closed form.
    D: Floats
    #: Error of the solver, as a distance D.
    error: Floats
    #: Whether D is known, which means that D exceeds `FLOOR_ERRORS` times the error of the solver.
    clear: NDArray[np.bool_]

    def part(self, low: float, high: float = np.inf) -> Series:
        """Return the outcomes with a logarithm of the contrast from `low` to `high`, both included."""
        inside = (low - _SLACK <= self.x) & (self.x <= high + _SLACK)
        return Series(self.x[inside], self.w[inside], self.D[inside], self.error[inside], self.clear[inside])

    def first_and_last_decade(self) -> tuple[Series, Series]:
        """Return the outcomes of the first decade of contrast, and of the last decade."""
        return self.part(self.x[0], self.x[0] + 1), self.part(self.x[-1] - 1)


class SeriesLimit(NamedTuple):
    """Limit to which a series of outcomes tends as the contrast grows."""

    #: The limit, as a vector of velocities w, shape (N,), and its error, as a distance D.
    w: Floats
    error: float
    #: Whether the series is restless. Its outcomes then spread over the last decade about as much as over the first
    #: decade, and more than errors explain.
    restless: bool
    #: Whether the series settles. A series settles if it is not restless, or if it moves around a place far from the
    #: closed form.
    settles: bool


class RateLine(NamedTuple):
    """Line log10 D = `at_zero` - `rate` x through the outcomes of a window, where x is log10 of the contrast.

    `low` and `high` are the ends of the 95 % interval of the rate. All are NaN if too few outcomes determine a line.
    """

    rate: float = math.nan
    low: float = math.nan
    high: float = math.nan
    at_zero: float = math.nan


def kinetic_distance(weights: ArrayLike, differences: ArrayLike) -> Floats:
    """Return D, the kinetic norm of velocity differences over the last axis, with `weights` as masses."""
    return np.sqrt((np.asarray(weights) * np.square(differences)).sum(axis=-1))


def mark_usable(outcomes: Frame, root: Floats | float) -> Frame:
    """Return a table of outcomes with two more columns, `used` and `grazing`.

    An outcome is used if it has a result and does not graze. An outcome grazes if it has a result and lies next to a
    jump of the model. That is so if its grazing margin, multiplied by `root`, is below `GRAZING`.
    """
    has_result = outcomes.distance.notna()
    grazing = has_result & (outcomes.grazing_margin.fillna(np.inf) * root < GRAZING)
    return outcomes.assign(used=has_result & ~grazing, grazing=grazing)


def judge_approach(approach: Approach) -> Verdict:
    """Return the verdict on the outcomes of one solver at one point."""
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
    return decide_verdict(window, line, verdict)


def _usable_series(approach: Approach, closed_form: Floats, scale: Floats) -> Series:
    """Return the usable outcomes as a series of vectors w, whose length is the kinetic norm.

    `closed_form` is such a vector w too. `scale` holds the square roots of the weights of the balls in D.
    """
    w = approach.velocities[approach.used] * scale
    D = kinetic_distance(1.0, w - closed_form)
    # The estimate of an error can vanish by chance. So each error is replaced by the largest of the error and its two
    # neighbours.
    error = np.pad(approach.error[approach.used], 1, constant_values=-np.inf)
    error = np.maximum(np.maximum(error[:-2], error[1:-1]), error[2:])
    return Series(np.log10(approach.contrast[approach.used]), w, D, error, FLOOR_ERRORS * error < D)


def _choose_window(series: Series, decades: float) -> Series | str:
    """Return the window of a series, the outcomes that a verdict is based on; or the reason why there is no window."""
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
    """Return the limit of a window of a series, and whether the series settles there."""
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
    """Return the verdict on a series that does not settle.

    The verdict is ``no limit``, or ``undecided`` if D still falls from each contrast to the next.
    """
    last = window.first_and_last_decade()[1]
    reason = f"it does not settle: in the last decade D runs from {last.D.min():.3g} to {last.D.max():.3g}"
    falls = np.all(np.diff(window.D) < 0)
    return replace(verdict, verdict="undecided" if falls else "no limit", reason=reason)


def _is_refuted(window: Series, verdict: Verdict) -> bool:
    """Return whether a series that settles goes to other velocities than the closed form."""
    last = window.first_and_last_decade()[1]
    is_clear_of_error = verdict.offset > max(3 * verdict.limit_error, 0.2 * verdict.last)
    return bool(is_clear_of_error and last.D.min() > 0.5 * verdict.offset)


def fit_rate(window: Series) -> RateLine:
    """Fit the rate at which D falls, from the outcomes whose D clearly exceeds the error of the solver."""
    if np.count_nonzero(window.clear) < 3:
        return RateLine()
    log_D = np.log10(window.D[window.clear])
    line = np.array(theilslopes(log_D, window.x[window.clear], alpha=0.95), dtype=float)
    slope, intercept, low_slope, high_slope = line.tolist()
    return RateLine(-slope, -high_slope, -low_slope, intercept)


def decide_verdict(window: Series, line: RateLine, verdict: Verdict) -> Verdict:
    """Return the verdict on a series that settles and is not refuted.

    The verdict is ``supported``, ``undecided``, or ``no limit`` if the series jumps.
    """
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
    if not line.low > LEAST_RATE:  # true also for NaN, which stands for a series without a line
        reason = f"the rate {line.rate:.2g} ({line.low:.2g} to {line.high:.2g}) cannot be told from none"
        return replace(verdict, reason=reason)
    fall = np.median(first.D) / verdict.last
    if fall < LEAST_FALL:
        reason = f"the distance falls by {fall:.2g} from the fit's first decade to its last: extend the range"
        return replace(verdict, reason=reason)
    return replace(verdict, verdict="supported")


def _count_jumps(window: Series, line: RateLine) -> int:
    """Return the number of jumps in the later half of a window.

    At a jump D exceeds both the fitted line and the D at the contrast before by the factor `JUMP`.
    """
    x, log_D = window.x[window.clear], np.log10(window.D[window.clear])
    above_line = log_D - line.at_zero + line.rate * x
    above_before = np.diff(log_D, prepend=log_D[:1])
    is_jump = np.minimum(above_line, above_before) > np.log10(JUMP)
    is_late = x >= 0.5 * (window.x[0] + window.x[-1])
    return int(np.count_nonzero(is_jump & is_late))


def _fit_limits(x: Floats, w: Floats) -> tuple[Floats, Floats]:
    """Fit w = L + A (contrast)^-s by least squares for each of the k exponents s in `EXPONENTS`.

    Return the limits L, shape (k, N), and the root mean square residuals of the fits, shape (k,). `x` holds the decimal
    logarithms of the contrasts.
    """
    base = 10.0 ** (-np.outer(EXPONENTS, x - x[0]))
    mean, centre = base.mean(axis=1, keepdims=True), w.mean(axis=0)
    slope = ((base - mean) @ (w - centre)) / np.square(base - mean).sum(axis=1, keepdims=True)
    limits = centre - slope * mean
    residual = w[None] - limits[:, None] - base[:, :, None] * slope[:, None]
    return limits, np.sqrt(np.square(residual).sum(axis=(1, 2)) / x.size)


def _extrapolate(window: Series) -> tuple[Floats, float]:
    """Return the velocities w to which a window tends as the contrast grows, and the error of this limit.

    The error is the largest change of the limit among several fits, as the docstring of this module describes.
    """
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
    """Return the verdicts on all series of outcomes, one row per series.

    A series consists of all outcomes, of pairs or of chains, with the same values in the columns `keys`.

    The columns are the keys, the columns of `Verdict`, and three more. `close_from` is the contrast from which on D is
    at most `CLOSE`. `grazing_left_out` is the number of outcomes next to a jump, which are not used. `without_result`
    is a text with the numbers of outcomes without a result.
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
    """Return an `Approach` with the outcomes of one solver at one point, which are given as columns by name."""
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
    """Return the contrast from which on D is at most `CLOSE`.

    It is infinite if D at the last contrast is larger, or not known.
    """
    # The True in front stands for an outcome that is not close. So the result is the first contrast if all outcomes are
    # close.
    last_far_place = np.flatnonzero(np.r_[True, ~(distances <= CLOSE)])[-1]
    return [*contrast, np.inf][last_far_place]


def _count_missing(statuses: Sequence[str], reasons: Sequence[str]) -> str:
    """Return a text that counts the outcomes without a result by status, with the first reason of each status.

    The text is empty if all outcomes have a result.
    """
    counts = Counter(status for status in statuses if status not in RESULT_STATUSES)
    first_reasons = dict(zip(statuses[::-1], reasons[::-1], strict=True))
    return "; ".join(f"{n} {status}: {first_reasons[status]}" for status, n in sorted(counts.items()))


def judge_classes(points: Frame, keys: Sequence[str]) -> Frame:
    """Return the verdicts on the classes of points.

    Each value of `keys` has one row for all its points together, with the class ``all``, and then one row per class.

    The columns are the keys, `class`, and the fields of `ClassVerdict`.
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
    """Return the verdict on the class with the worst verdict.

    Some classes are undecided only because of the solver's own error. They do not count if another class is supported.
    """
    is_supported = any(verdict.verdict == "supported" for verdict in classes)
    counting = [verdict for verdict in classes if not (verdict.within_error and is_supported)]
    return min(counting, key=lambda verdict: _ORDER.index(verdict.verdict))


def _judge_class(points: Frame) -> ClassVerdict:
    """Return the verdict on a class of points, by the rule in the docstring of this module."""
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
    """Return the ends of the 95 % bootstrap interval of the median of rates; NaN if there are no rates."""
    # scipy.stats.bootstrap is not used, because it does not accept a single rate.
    if not rates.size:
        return math.nan, math.nan
    draws = np.random.default_rng(_SEED).choice(rates, (_RESAMPLES, rates.size))
    low, high = np.quantile(np.median(draws, axis=1), [0.025, 0.975])
    return low, high
