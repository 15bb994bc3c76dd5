"""The judgement of a series of outcomes on a limit: does it get there, at what rate, and where does it go if not.

A series is the outcomes of one solver at one point, at rising contrasts x; velocities are vectors w whose length is the
kinetic norm, of two balls (v1, sqrt(m2/m1) v2). docs/hypothesis.md has the rule in full.

1. The *window* is the last `decades` of the usable outcomes; where the distance D from the closed form has sunk under
   `FLOOR_ERRORS` errors of the solver for good, it ends there.
2. **Rate**: slope of ln D over ln x by Theil and Sen: contacts that ring let D dip to nothing at single contrasts,
   which a median of slopes does not notice.
3. **Limit**: w = L + A x^-s by least squares, s from `EXPONENTS`. Its error is the largest of: what the same fit gives
   without the last decade (or half of a short window), with a second term in x^-2s, or with any s that leaves no more
   than twice the least residual; that residual; and the solver's own error.
4. The series **settles** if the diameter of its last decade is below that of its first by at least `LEAST_RATE` a
   decade, or below what the solver resolves, or below a tenth of its distance from the closed form (its limit is then
   the mean of that decade, with that diameter for an error).
5. It **jumps** where, in the later half of the window, D exceeds both the line of the rate and the D before by `JUMP`.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter1d
from scipy.stats import theilslopes

from impact_xval.experiments.hypothesis.cases import Frame, distance

Floats = NDArray[np.float64]

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

#: A margin in decades: contrasts are rounded.
_SLACK = 1e-6

#: What is known of a series that has no window.
_OPEN: dict[str, Any] = {"verdict": "undecided", "reason": "", "consistent": False, "settles": True}
_OPEN |= dict.fromkeys(("rate", "rate_low", "rate_high", "last", "limit_error", "offset"), math.nan)
_OPEN |= dict.fromkeys(("window_from", "window_to"), math.nan)


class _Window(NamedTuple):
    """Outcomes that are fitted: log10 of the contrast, velocities, their distance from the closed form, errors."""

    x: Floats
    w: Floats
    D: Floats
    own: Floats

    @property
    def first(self) -> NDArray[np.bool_]:
        return self.x <= self.x[0] + 1 + _SLACK

    @property
    def final(self) -> NDArray[np.bool_]:
        return self.x >= self.x[-1] - 1 - _SLACK


def judge(series: Frame) -> dict[str, Any]:
    """Judge a series of outcomes by the kinetic norm of their differences, with `weights` for masses.

    The result is a row of ``points.csv``. `last` is the median distance from the closed form in the last decade,
    `offset` that of the limit, `consistent` whether it is below three errors of the limit.
    """
    used, first = series[series.used], series.iloc[0]
    scale, decades = np.sqrt(first.weights), first.decades
    target = np.array(first.closed_form) * scale
    w = np.array(used.velocities.to_list()).reshape(-1, len(scale)) * scale
    # An estimate of an error can vanish by chance: the largest of three neighbours counts.
    own = maximum_filter1d(used.error, 3, mode="nearest")
    found = _OPEN | {f"limit_v{i}": math.nan for i in range(1, 1 + len(target))}
    window, sunk = _window(
        _Window(np.log10(used.contrast.to_numpy()), w, distance(1.0, w - target), own), decades
    )
    if isinstance(window, str):
        return found | {"reason": window}
    found |= _limit(window, target, scale, decades)
    if not found["settles"]:
        return found
    least = window.D[window.final].min()
    if found["offset"] > max(3 * found["limit_error"], 0.2 * found["last"]) and least > 0.5 * found["offset"]:
        return found | {"verdict": "refuted"}
    return found | _rate(window, found["last"], decades, sunk=sunk)


def _window(series: _Window, decades: float) -> tuple[_Window | str, bool]:
    """Choose the window, or say why there is none; and whether the distance has sunk under the solver's error in it."""
    x = series.x
    span = float(x[-1] - x[0]) if x.size else 0.0
    if span < decades - _SLACK:
        return (
            f"outcomes span {span:.2g} decades of contrast, a rate needs {decades:g}: extend the range",
            False,
        )
    above = np.flatnonzero(FLOOR_ERRORS * series.own < series.D)
    sunk = above.size == 0 or bool(x[above[-1]] - x[0] < decades - _SLACK)
    end = x[0] + decades if sunk else x[above[-1]]
    window = _Window(*(each[(x >= end - decades - _SLACK) & (x <= end + _SLACK)] for each in series))
    reach = window.x[-1] - window.x[0]
    if reach < decades - _SLACK or window.x.size < 2 * decades + 1:
        return (
            f"{window.x.size} outcomes over {reach:.2g} decades are too few: results are missing in between",
            False,
        )
    return window, sunk


def _limit(window: _Window, target: Floats, scale: Floats, decades: float) -> dict[str, Any]:
    """Find where a series goes, or say that it settles nowhere."""
    w, D, own, final = window.w, window.D, float(window.own[window.final].max()), window.final
    limit, limit_error = _extrapolate(window.x, w)
    limit_error = max(limit_error, own)
    early, late = _diameter(w[window.first]), _diameter(w[final])
    restless = late > FLOOR_ERRORS * own and late > early * 10 ** (-LEAST_RATE * (decades - 1))
    aside = restless and bool(late < 0.1 * D[final].min())
    if aside:
        limit, limit_error = w[final].mean(axis=0), late
    offset = float(distance(1.0, limit - target))
    found: dict[str, Any] = {
        "last": float(np.median(D[final])),
        "limit_error": limit_error,
        "offset": offset,
        "consistent": not restless and offset <= 3 * limit_error,
        "settles": aside or not restless,
        "window_from": float(10 ** window.x[0]),
        "window_to": float(10 ** window.x[-1]),
    }
    if found["settles"]:
        return found | {f"limit_v{i}": v for i, v in enumerate((limit / scale).tolist(), 1)}
    drifts = bool(np.all(np.diff(D) < 0))
    reason = (
        f"it does not settle: in the last decade D runs from {D[final].min():.3g} to {D[final].max():.3g}"
    )
    return found | {"reason": reason, "verdict": "undecided" if drifts else "no limit"}


def _rate(window: _Window, last: float, decades: float, *, sunk: bool) -> dict[str, Any]:
    """Find the rate of the approach of a series that is not refuted, and decide on it."""
    x, D, own = window.x, window.D, window.own
    clear = FLOOR_ERRORS * own < D
    x_clear, log_D = x[clear], np.log10(D[clear])
    slope = at_zero = low = high = math.nan
    if x_clear.size >= 3:
        line: Any = theilslopes(log_D, x_clear, alpha=0.95)
        slope, at_zero, low, high = map(float, line)
    found: dict[str, Any] = {"rate": -slope, "rate_low": -high, "rate_high": -low}
    off = np.minimum(log_D - at_zero - slope * x_clear, np.diff(log_D, prepend=log_D[:1])) > math.log10(JUMP)
    jumps = int(np.count_nonzero(off & (x_clear >= 0.5 * (x[0] + x[-1]))))
    if jumps:
        reason = f"it jumps: {jumps} of {x.size} outcomes lie {JUMP:g} times further off than the others"
        return found | {"verdict": "no limit", "reason": reason, "settles": False, "consistent": False}
    if sunk:
        reason = (
            f"it is within the solver's own error ({own[window.final].max():.1g}) of the closed form too soon"
        )
    elif not -high > LEAST_RATE:
        reason = f"the rate {-slope:.2g} ({-high:.2g} to {-low:.2g}) cannot be told from none"
    elif (fall := float(np.median(D[window.first])) / last) < LEAST_FALL:
        reason = (
            f"the distance falls by {fall:.2g} from the first decade of the fit to the last: extend the range"
        )
    else:
        return found | {"verdict": "supported"}
    return found | {"reason": reason}


def _diameter(w: Floats) -> float:
    return float(distance(1.0, w[:, None] - w[None]).max())


def _fits(x: Floats, w: Floats) -> tuple[Floats, Floats]:
    """Limits (k, b) of w = L + A x^-s for every s of `EXPONENTS`, and the root mean square residuals (k,)."""
    base = 10.0 ** (-np.outer(EXPONENTS, x - x[0]))
    mean, centre = base.mean(axis=1, keepdims=True), w.mean(axis=0)
    slope = ((base - mean) @ (w - centre)) / np.square(base - mean).sum(axis=1, keepdims=True)
    limits = centre - slope * mean
    residual = w[None] - limits[:, None] - base[:, :, None] * slope[:, None]
    return limits, np.sqrt(np.square(residual).sum(axis=(1, 2)) / x.size)


def _extrapolate(x: Floats, w: Floats) -> tuple[Floats, float]:
    """Limit of a series and its error, without the solver's own."""
    limits, residuals = _fits(x, w)
    best = int(np.argmin(residuals))
    limit, least = limits[best], float(residuals[best])
    shorter = x <= x[-1] - min(1.0, 0.5 * (x[-1] - x[0])) + _SLACK
    before, shorter_residuals = _fits(x[shorter], w[shorter])
    base = 10.0 ** (-EXPONENTS[best] * (x - x[0]))
    two_terms = np.linalg.lstsq(np.column_stack([np.ones_like(x), base, base**2]), w, rcond=None)[0][0]
    others = [before[int(np.argmin(shorter_residuals))], two_terms, *limits[residuals <= 2 * least + 1e-15]]
    error = max(least, float(distance(1.0, np.array(others) - limit).max()))
    if best in (0, len(EXPONENTS) - 1) and least > 1e-12:  # no exponent of those tried fits
        final = w[x >= x[-1] - 1 - _SLACK]
        error = max(error, float(distance(1.0, final - final.mean(axis=0)).max()))
    return limit, error
