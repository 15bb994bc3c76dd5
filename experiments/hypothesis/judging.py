"""From the outcomes of a solver to its verdict on a limit.

A series is the outcomes of one solver at one point, at rising contrasts x; velocities are vectors w whose length is the
kinetic norm, of two balls (v1, sqrt(m2/m1) v2). It is judged by whether it gets to the closed form, at what rate, and
where it goes if not:

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

Within a class of points (which contacts are elastic, `run.pair_class`) the verdict is

* `refuted` where a tenth of the points or more is: one law, one counterexample would do, a tenth is robust;
* else `supported` where half of the points or more is, and every other one either agrees with the closed form within
  the error of its limit, or is short of results; none is refuted or fails to settle;
* else `no limit` where half of the points or more have none; else `undecided`.

Over the classes of a limit the worst counts; one that is undecided only because it is within the solver's own error of
the closed form does not count against one that is supported.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from scipy.spatial.distance import pdist
from scipy.stats import theilslopes

from impact_xval.experiments.measures.aggregates import Frame
from impact_xval.model.arrays import Floats
from impact_xval.model.status import RESULT_STATUSES

#: Least rate: over four decades a distance falls by 2.5. Least fall of the distance, from the median of the first
#: decade of a window to that of the last: a series that falls by less may as well level out just beyond.
LEAST_RATE, LEAST_FALL = 0.1, 2.5

#: Errors of the solver that hide D, factor of a jump, exponents s of the limit, and share of points that refutes.
FLOOR_ERRORS = 3.0
JUMP = 30.0
EXPONENTS = np.arange(0.1, 3.01, 0.05)
REFUTING_SHARE = 0.1

#: A margin in decades: contrasts are rounded.
_SLACK = 1e-6

#: Grazing margin below which an outcome lies beside a jump. In the limits of k2/k1 the stiff contact's ringing, which
#: is what grazes, shrinks as the root of the contrast, and the margin with it: there it is multiplied by that root.
GRAZING = 1e-3

#: D from which on a limit is close enough to be used, per impact.
CLOSE = 0.05

#: Resamples of a bootstrap, and its seed.
_RESAMPLES, _SEED = 2000, 2013

#: The worst first.
_ORDER = ("refuted", "no limit", "undecided", "supported")

#: What is known of a series that has no window.
_OPEN: dict[str, Any] = {"verdict": "undecided", "reason": "", "consistent": False, "settles": True}
_OPEN |= dict.fromkeys(("rate", "rate_low", "rate_high", "last", "limit_error", "offset"), np.nan)


def distance(weights: Any, differences: Any) -> Any:
    """D of differences of velocities, shape (..., N): their kinetic norm, by masses in the unit of that."""
    return np.sqrt((weights * np.square(differences)).sum(axis=-1))


def usable(outcomes: Frame, root: Any) -> Frame:
    """Tell which outcomes can be used: those with a result, hence a distance, that lie beside no jump (`GRAZING`)."""
    there = outcomes.distance.notna()
    grazing = there & (outcomes.grazing_margin.fillna(np.inf) * root < GRAZING)
    return outcomes.assign(used=there & ~grazing, grazing=grazing)


class Series(NamedTuple):
    """Usable outcomes at rising contrasts, an element or row each."""

    #: log10 of the contrast.
    x: Floats
    #: Velocities, shape (n, N), as vectors whose length is the kinetic norm, and D from the closed form.
    w: Floats
    D: Floats
    #: The solver's error, and whether D exceeds it.
    own: Floats
    clear: Any

    def part(self, low: float, high: float = np.inf) -> Series:
        """Return the outcomes between two x, both included."""
        inside = (low - _SLACK <= self.x) & (self.x <= high + _SLACK)
        return Series(*(each[inside] for each in self))

    def ends(self) -> tuple[Series, Series]:
        """Return the first decade, and the last."""
        return self.part(self.x[0], self.x[0] + 1), self.part(self.x[-1] - 1)


def judge(outcomes: dict[str, Any]) -> dict[str, Any]:
    """Judge a series of outcomes by the kinetic norm of their differences, with `weights` for masses.

    The result is a row of ``points.csv``. `last` is the median distance from the closed form in the last decade,
    `offset` that of the limit, `consistent` whether it is below three errors of the limit.
    """
    used, decades = outcomes["used"].astype(bool), outcomes["decades"][0]
    scale = np.sqrt(outcomes["weights"][0])
    target = np.array(outcomes["closed_form"][0]) * scale
    w = np.array([*outcomes["velocities"][used]]).reshape(-1, len(scale)) * scale
    D, error = distance(1.0, w - target), np.pad(outcomes["error"][used], 1, constant_values=-np.inf)
    # An estimate of an error can vanish by chance: the largest of three neighbours counts.
    own = np.maximum(np.maximum(error[:-2], error[1:-1]), error[2:])
    series = Series(np.log10(outcomes["contrast"][used]), w, D, own, FLOOR_ERRORS * own < D)
    found = _OPEN | {f"limit_v{i}": np.nan for i in range(1, 1 + len(target))}
    window = _window(series, decades)
    if isinstance(window, str):
        return found | {"reason": window}
    found |= _limit(window, target, scale, decades)
    if found["verdict"] == "refuted" or not found["settles"]:
        return found
    return found | _rate(window, found["last"])


def _window(series: Series, decades: float) -> Series | str:
    """Choose the window of a series, or say why there is none."""
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


def _limit(window: Series, target: Floats, scale: Floats, decades: float) -> dict[str, Any]:
    """Find where a series goes and whether that refutes the closed form, or say that it settles nowhere."""
    first, final = window.ends()
    w, D, own = final.w, final.D, final.own.max()
    limit, limit_error = _extrapolate(window)
    early, late = (pdist(end.w).max(initial=0.0) for end in (first, final))
    restless = late > FLOOR_ERRORS * own and late > early * 10 ** (-LEAST_RATE * (decades - 1))
    settles = not restless
    if restless and late < 0.1 * D.min():  # it goes round a place far off
        settles, limit, limit_error = True, w.mean(axis=0), late
    offset, last = distance(1.0, limit - target), np.median(D)
    found = {"last": last, "limit_error": limit_error, "offset": offset, "settles": settles}
    found |= {"consistent": not restless and offset <= 3 * limit_error}
    if not settles:
        reason = f"it does not settle: in the last decade D runs from {D.min():.3g} to {D.max():.3g}"
        falls = np.all(np.diff(window.D) < 0)
        return found | {"reason": reason, "verdict": "undecided" if falls else "no limit"}
    found |= {f"limit_v{i}": v for i, v in enumerate(limit / scale, 1)}
    refuted = offset > max(3 * limit_error, 0.2 * last) and D.min() > 0.5 * offset
    return found | {"verdict": "refuted" if refuted else "undecided"}


def _rate(window: Series, last: float) -> dict[str, Any]:
    """Find the rate of the approach of a series that is not refuted, and decide on it."""
    x, (first, final) = window.x, window.ends()
    x_clear, log_D = x[window.clear], np.log10(window.D[window.clear])
    line: Any = theilslopes(log_D, x_clear, alpha=0.95) if x_clear.size >= 3 else 4 * (np.nan,)
    slope, at_zero, low, high = line
    found: dict[str, Any] = {"rate": -slope, "rate_low": -high, "rate_high": -low}
    off = np.minimum(log_D - at_zero - slope * x_clear, np.diff(log_D, prepend=log_D[:1])) > np.log10(JUMP)
    jumps = np.count_nonzero(off & (x_clear >= 0.5 * (x[0] + x[-1])))
    if jumps:
        reason = f"it jumps: {jumps} of {x.size} outcomes lie {JUMP:g} times further off than the others"
        return found | {"verdict": "no limit", "reason": reason, "settles": False, "consistent": False}
    if not window.clear[-1]:
        reason = f"it is within the solver's own error ({final.own.max():.1g}) of the closed form too soon"
    elif not -high > LEAST_RATE:
        reason = f"the rate {-slope:.2g} ({-high:.2g} to {-low:.2g}) cannot be told from none"
    elif (fall := np.median(first.D) / last) < LEAST_FALL:
        reason = f"the distance falls by {fall:.2g} from the fit's first decade to its last: extend the range"
    else:
        return found | {"verdict": "supported"}
    return found | {"reason": reason}


def _fits(x: Floats, w: Floats) -> tuple[Floats, Floats]:
    """Limits (k, b) of w = L + A x^-s for every s of `EXPONENTS`, and the root mean square residuals (k,)."""
    base = 10.0 ** (-np.outer(EXPONENTS, x - x[0]))
    mean, centre = base.mean(axis=1, keepdims=True), w.mean(axis=0)
    slope = ((base - mean) @ (w - centre)) / np.square(base - mean).sum(axis=1, keepdims=True)
    limits = centre - slope * mean
    residual = w[None] - limits[:, None] - base[:, :, None] * slope[:, None]
    return limits, np.sqrt(np.square(residual).sum(axis=(1, 2)) / x.size)


def _extrapolate(window: Series) -> tuple[Floats, float]:
    """Limit of a series and its error."""
    x, w, (_, final) = window.x, window.w, window.ends()
    limits, residuals = _fits(x, w)
    best = int(np.argmin(residuals))
    limit, least = limits[best], float(residuals[best])
    shorter = x <= x[-1] - min(1.0, 0.5 * (x[-1] - x[0])) + _SLACK
    before, shorter_residuals = _fits(x[shorter], w[shorter])
    base = 10.0 ** (-EXPONENTS[best] * (x - x[0]))
    two_terms = np.linalg.lstsq(np.column_stack([np.ones_like(x), base, base**2]), w, rcond=None)[0][0]
    others = [before[int(np.argmin(shorter_residuals))], two_terms, *limits[residuals <= 2 * least + 1e-15]]
    error = max(least, final.own.max(), float(distance(1.0, np.array(others) - limit).max()))
    if best in (0, len(EXPONENTS) - 1) and least > 1e-12:  # no exponent of those tried fits
        error = max(error, float(distance(1.0, final.w - final.w.mean(axis=0)).max()))
    return limit, error


def judged(outcomes: Frame, keys: Sequence[str]) -> Frame:
    """Judge every series of outcomes, of pairs or of chains: those with the same `keys`; a row each."""
    rows = []
    table = {name: outcomes[name].to_numpy() for name in outcomes}
    for key, places in outcomes.groupby(list(keys), sort=False).indices.items():
        series = {name: values[places] for name, values in table.items()}
        lost = Counter(status for status in series["status"] if status not in RESULT_STATUSES)
        reasons = dict(zip(series["status"][::-1], series["reason"][::-1], strict=True))
        why = [f"{n} {status}: {reasons[status]}" for status, n in sorted(lost.items())]
        # The last outcome that is not close; the one after it is the first of those that stay so.
        far = np.flatnonzero(np.r_[True, ~(series["distance"] <= CLOSE)])[-1]
        row = dict(zip(keys, key, strict=True)) | judge(series)
        row |= {"close_from": [*series["contrast"], np.inf][far], "grazing_left_out": series["grazing"].sum()}
        rows.append(row | {"without_result": "; ".join(why)})
    return pd.DataFrame(rows)


def verdicts(points: Frame, keys: Sequence[str]) -> Frame:
    """Gather judgements: a row for all points that have the same keys, then one for each of their classes.

    Rates are those of points that support, the median with its 95 % bootstrap interval; offsets of those that refute.
    """
    rows = []
    for key, group in points.groupby(list(keys), sort=False):
        classes = [{"class": name} | _gathered(some) for name, some in group.groupby("class", sort=False)]
        supported = any(row["verdict"] == "supported" for row in classes)
        counting = [row for row in classes if not (row["within_error"] and supported)]
        worst = min(counting, key=lambda row: _ORDER.index(row["verdict"]))
        whole = {"class": "all"} | _gathered(group) | {name: worst[name] for name in ("verdict", "reason")}
        rows += [dict(zip(keys, key, strict=True)) | row for row in (whole, *classes)]
    return pd.DataFrame(rows)


def _gathered(points: Frame) -> dict[str, Any]:
    """Return a row of verdicts, by the rule of a class."""
    supported, refuted = (points[points.verdict == verdict] for verdict in ("supported", "refuted"))
    undecided = points[~points.verdict.isin(["supported", "refuted"])]
    n, astray, reason = len(points), undecided[~undecided.settles], ""
    harmless = astray.empty and (undecided.consistent | ~np.isfinite(undecided.offset)).all()
    if len(refuted) >= max(1, REFUTING_SHARE * n):
        verdict = "refuted"
    elif 2 * len(supported) >= n and refuted.empty and harmless:
        verdict = "supported"
    else:
        verdict = "no limit" if 2 * (points.verdict == "no limit").sum() >= n else "undecided"
        worst = undecided if astray.empty else astray
        reason = (
            f"{len(worst)} of {n} points: {worst.reason.iloc[0]}" if len(worst) else "one point is refuted"
        )
    quiet = (points.verdict == "supported") | (points.consistent & points.settles)
    # Bootstrap; one rate is legal, which scipy.stats.bootstrap refuses.
    rates, draws = supported.rate.to_numpy(), (_RESAMPLES, len(supported))
    medians = np.median(np.random.default_rng(_SEED).choice(rates, draws), axis=1) if rates.size else np.nan
    low, high = np.quantile(medians, [0.025, 0.975])
    return {
        "verdict": verdict,
        "within_error": verdict == "undecided" and quiet.all(),
        "points": n,
        **{"n_supported": len(supported), "n_refuted": len(refuted), "n_undecided": len(undecided)},
        **{"rate": supported.rate.median(), "rate_low": low, "rate_high": high},
        **{"least_rate": supported.rate.min(), "largest_rate": supported.rate.max()},
        **{"offset_least": refuted.offset.min(), "offset_largest": refuted.offset.max()},
        "close_from": points.close_from.median(),
        "reason": reason,
    }
