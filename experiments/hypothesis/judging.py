"""The judgement of a series of outcomes on a limit: does it get there, at what rate, and where does it go if not.

A series is the outcomes of one solver at one point of the design, at rising contrasts x. Velocities are taken as
vectors w, of two balls (v1, sqrt(m2/m1) v2), whose length is the kinetic norm.

1. **Usable** are outcomes that are results, away from a grazing jump. The *window* is their last `decades`; where the
   distance from the closed form has sunk under `FLOOR_ERRORS` errors of the solver for good, the window ends there.
   Without `decades` of them the verdict is `undecided`.
2. **Rate**: slope of ln D over ln x in the window by Theil and Sen, with its 95 % interval: contacts that ring let D
   dip to nothing at single contrasts, which a median of slopes does not notice.
3. **Limit**: w = L + A x^-s by least squares, s from `EXPONENTS`. Its error is the largest of: what the same fit gives
   without the last decade (or half of a short window), with a second term in x^-2s, or with any s that leaves no more
   than twice the least residual; that residual; and the solver's own error.
4. The series **settles** if the diameter of its last decade is below that of its first by at least
   `LEAST_RATE` a decade, or below what the solver resolves, or below a tenth of its distance from the closed form
   (its limit is then the mean of that decade, with that diameter for an error).

5. A series **jumps** where, in the later half of the window, a distance exceeds both the line of the rate and the
   distance before it by `JUMP`.

Verdict: `refuted` if it settles, L lies further from the closed form than three of its errors and than a fifth of the
last distances, and no outcome of the last decade comes closer to the closed form than half that; else `supported` if
the interval of the rate lies above `LEAST_RATE`, the distance falls by `LEAST_FALL`, and the series settles without a
jump; `no limit` if it jumps, or does not settle though its distance falls and rises; else `undecided`, with the reason.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter1d
from scipy.stats import theilslopes

Floats = NDArray[np.float64]
Verdict = Literal["supported", "refuted", "no limit", "undecided"]

#: Rates below this cannot be told from none: over four decades a distance would fall by 2.5.
LEAST_RATE = 0.1

#: Distances within so many errors of the solver tell nothing more of the rate.
FLOOR_ERRORS = 3.0

#: Factor above the fitted line from which an outcome is off it.
JUMP = 30.0

#: Least fall of the distance, from the median of the first decade of a window to that of the last. A series that
#: falls by less may as well level out just beyond.
LEAST_FALL = 2.5

#: Exponents s tried for the approach to the limit.
EXPONENTS = np.arange(0.1, 3.01, 0.05)

#: Confidence of the intervals of rates.
CONFIDENCE = 0.95

#: A margin in decades: contrasts are rounded.
_SLACK = 1e-6


@dataclass(frozen=True, slots=True)
class Judgement:
    """The judgement of a series.

    Attributes
    ----------
    verdict : str
    reason : str
        In one sentence, if undecided or without a limit.
    rate, rate_low, rate_high : float
        Of the distance from the closed form, with its 95 % interval; NaN without a fit.
    window : tuple of float
        Contrasts at its ends.
    last : float
        Median distance from the closed form in the last decade of the window.
    limit : tuple of float
        Velocities it goes to, per abs(v0); NaN if it does not settle.
    limit_error : float
        In the kinetic norm.
    offset : float
        Distance of that limit from the closed form.
    consistent : bool
        Whether the closed form lies within three errors of the limit.
    settles : bool
        False where it oscillates or jumps without end.
    """

    verdict: Verdict
    reason: str = ""
    rate: float = math.nan
    rate_low: float = math.nan
    rate_high: float = math.nan
    window: tuple[float, float] = (math.nan, math.nan)
    last: float = math.nan
    limit: tuple[float, ...] = (math.nan, math.nan)
    limit_error: float = math.nan
    offset: float = math.nan
    consistent: bool = False
    settles: bool = True


def judge(
    contrast: Floats,
    velocities: Floats,
    error: Floats,
    usable: NDArray[np.bool_],
    closed_form: Sequence[float],
    masses: Sequence[float],
    decades: float,
) -> Judgement:
    """Judge a series.

    Parameters
    ----------
    contrast : ndarray, shape (n,)
        Rising.
    velocities : ndarray, shape (n, b)
        Outcomes of b balls, per abs(v0).
    error : ndarray, shape (n,)
        Of the outcomes, in the kinetic norm.
    usable : ndarray of bool, shape (n,)
        Whether an outcome is a result, and no grazing one.
    closed_form : sequence of float, length b
        Velocities of the hypothesis.
    masses : sequence of float, length b
        In the unit of the kinetic norm: of two balls 1 and m2/m1.
    decades : float
        Of the fit.
    """
    scale = np.sqrt(masses)
    w = velocities[usable] * scale
    target = np.array(closed_form) * scale
    # An estimate of an error can vanish by chance: the largest of three neighbours counts.
    own = maximum_filter1d(error[usable], 3, mode="nearest")
    window, sunk = _window(np.log10(contrast[usable]), w, _length(w - target), own, decades)
    if isinstance(window, str):
        return Judgement("undecided", window, limit=(math.nan,) * len(closed_form))
    found, reason = _limit(window, target, scale)
    if reason:
        return replace(found, reason=reason)
    least = window.D[window.final].min()
    if found.offset > max(3 * found.limit_error, 0.2 * found.last) and least > 0.5 * found.offset:
        return replace(found, verdict="refuted")
    return _rate(found, window, sunk)


@dataclass(frozen=True, slots=True, eq=False)
class _Window:
    """The outcomes that are fitted: log10 of the contrast, velocities, their distance from the closed form, error."""

    x: Floats
    w: Floats
    D: Floats
    own: Floats
    decades: float

    @property
    def first(self) -> NDArray[np.bool_]:
        return self.x <= self.x[0] + 1 + _SLACK

    @property
    def final(self) -> NDArray[np.bool_]:
        return self.x >= self.x[-1] - 1 - _SLACK


def _window(x: Floats, w: Floats, D: Floats, own: Floats, decades: float) -> tuple[_Window | str, bool]:
    """Choose the window, or say why there is none; and whether the distance has sunk under the solver's error in it."""
    span = float(x[-1] - x[0]) if x.size else 0.0
    if span < decades - _SLACK:
        return (
            f"outcomes span {span:.2g} decades of contrast, a rate needs {decades:g}: extend the range of contrasts"
        ), False
    above = np.flatnonzero(FLOOR_ERRORS * own < D)
    sunk = above.size == 0 or bool(x[above[-1]] - x[0] < decades - _SLACK)
    end = x[0] + decades if sunk else x[above[-1]]
    inside = (x >= end - decades - _SLACK) & (x <= end + _SLACK)
    x, w, D, own = x[inside], w[inside], D[inside], own[inside]
    if x[-1] - x[0] < decades - _SLACK or x.size < 2 * decades + 1:
        return (
            f"{x.size} outcomes over {x[-1] - x[0]:.2g} decades are too few: results are missing in between"
        ), False
    return _Window(x, w, D, own, decades), sunk


def _limit(window: _Window, target: Floats, scale: Floats) -> tuple[Judgement, str]:
    """Find where the series goes, as a judgement that is still open; the reason why it settles nowhere, if so."""
    w, D, own, final = window.w, window.D, window.own, window.final
    limit, limit_error = _extrapolate(window.x, w)
    limit_error = max(limit_error, float(own[final].max()))
    early, late = _diameter(w[window.first]), _diameter(w[final])
    resolved = FLOOR_ERRORS * float(own[final].max())
    restless = late > resolved and late > early * 10 ** (-LEAST_RATE * (window.decades - 1))
    aside = restless and bool(late < 0.1 * D[final].min())
    if aside:
        limit, limit_error = w[final].mean(axis=0), late
    settles = aside or not restless
    offset = float(_length(limit - target))
    velocities = limit / scale if settles else np.full(limit.shape, math.nan)
    found = Judgement(
        "undecided",
        window=(float(10 ** window.x[0]), float(10 ** window.x[-1])),
        last=float(np.median(D[final])),
        limit=tuple(map(float, velocities)),
        limit_error=limit_error,
        offset=offset,
        consistent=not restless and offset <= 3 * limit_error,
        settles=settles,
    )
    if settles:
        return found, ""
    ends = zip((w[final] / scale).min(axis=0), (w[final] / scale).max(axis=0), strict=True)
    ranges = [f"from {a:.3g} to {b:.3g}" for a, b in ends]
    first, *others = (f"v{i} {'runs ' if i == 1 else ''}{each}" for i, each in enumerate(ranges, 1))
    drifts = bool(np.all(np.diff(D) < 0))
    found = found if drifts else replace(found, verdict="no limit")
    return found, f"it does not settle: in the last decade {' and '.join([first, *others])}"


def _rate(found: Judgement, window: _Window, sunk: bool) -> Judgement:
    """Complete a judgement that refutes nothing by the rate of the approach, and decide on it."""
    x, D, own = window.x, window.D, window.own
    clear = FLOOR_ERRORS * own < D
    x_clear, log_D = x[clear], np.log10(D[clear])
    if x_clear.size >= 3:
        line: Any = theilslopes(log_D, x_clear, alpha=CONFIDENCE)
        slope, at_zero, low, high = map(float, line)
        found = replace(found, rate=-slope, rate_low=-high, rate_high=-low)
        above = log_D - at_zero - slope * x_clear
        rise = np.diff(log_D, prepend=log_D[0])
        late_half = x_clear >= 0.5 * (x[0] + x[-1])
        jumps = int(np.count_nonzero(late_half & (np.minimum(above, rise) > math.log10(JUMP))))
        if jumps:
            reason = f"it jumps: {jumps} of {x.size} outcomes lie {JUMP:g} times further off than the others"
            return replace(found, verdict="no limit", reason=reason, settles=False, consistent=False)
    if sunk:
        reach = float(x_clear[-1] - x[0]) if x_clear.size else 0.0
        reason = (
            f"after {reach:.2g} decades it is within the solver's own error ({own[window.final].max():.1g}) of the "
            f"closed form, and a rate needs {window.decades:g}"
        )
    elif not found.rate_low > LEAST_RATE:
        reason = (
            f"the rate {found.rate:.2g} ({found.rate_low:.2g} to {found.rate_high:.2g}) cannot be told from none, nor "
            "the limit from the closed form"
        )
    elif (fall := float(np.median(D[window.first])) / found.last) < LEAST_FALL:
        reason = (
            f"the distance falls by {fall:.2g} from the first to the last decade of the fit; {LEAST_FALL:g} is "
            "needed: extend the range of contrasts"
        )
    else:
        return replace(found, verdict="supported")
    return replace(found, reason=reason)


def _length(w: Floats) -> Floats:
    """Kinetic norm of vectors along the last axis."""
    return np.hypot.reduce(w, axis=-1)


def _diameter(w: Floats) -> float:
    return float(_length(w[:, None] - w[None]).max())


def _fits(x: Floats, w: Floats) -> tuple[Floats, Floats]:
    """Limits (k, b) of w = L + A x^-s for every s of `EXPONENTS`, and the root mean square residuals (k,)."""
    base = 10.0 ** (-np.outer(EXPONENTS, x - x[0]))
    mean, centre = base.mean(axis=1, keepdims=True), w.mean(axis=0)
    slope = ((base - mean) @ (w - centre)) / np.square(base - mean).sum(axis=1, keepdims=True)
    limits = centre - slope * mean
    residual = w[None] - limits[:, None] - base[:, :, None] * slope[:, None]
    return limits, np.sqrt(np.square(residual).sum(axis=(1, 2)) / x.size)


def _two_terms(x: Floats, w: Floats, s: float) -> Floats:
    """Limit of w = L + A x^-s + B x^-2s."""
    base = 10.0 ** (-s * (x - x[0]))
    return np.linalg.lstsq(np.column_stack([np.ones_like(x), base, base**2]), w, rcond=None)[0][0]


def _extrapolate(x: Floats, w: Floats) -> tuple[Floats, float]:
    """Limit of a series and its error, without the solver's own."""
    limits, residuals = _fits(x, w)
    best = int(np.argmin(residuals))
    second = _two_terms(x, w, EXPONENTS[best])
    near = limits[residuals <= 2 * residuals[best] + 1e-15]
    shorter = x <= x[-1] - min(1.0, 0.5 * (x[-1] - x[0])) + _SLACK
    before, shorter_residuals = _fits(x[shorter], w[shorter])
    moved = limits[best] - before[int(np.argmin(shorter_residuals))]
    final = x >= x[-1] - 1 - _SLACK
    rest = w[final] - w[final].mean(axis=0)
    candidates = [
        float(_length(moved)),
        float(_length(second - limits[best])),
        float(_length(near - limits[best]).max()),
        float(residuals[best]),
    ]
    if best in (0, len(EXPONENTS) - 1) and residuals[best] > 1e-12:
        candidates.append(float(np.sqrt(np.square(rest).sum(axis=1)).max()))
    return limits[best], max(candidates)
