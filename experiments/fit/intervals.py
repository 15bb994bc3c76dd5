"""Intervals by the profile likelihood, and what the data cannot tell.

The profile of a parameter is the least chi^2 at each of its values, all others fitted anew. Its 95 % interval is
where the profile is within 3.841, the 95 % quantile of chi^2 with one degree of freedom, of its least value (Wilks
1938; Venzon and Moolgavkar 1988, Appl. Statist. 37:87). An interval that does not close within the box is open on
that side: beyond it the data say nothing. At an end of the box, such as e = 1, the interval is one-sided and covers
more than 95 %.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from impact_xval.experiments.fit.laws import Floats
from impact_xval.experiments.fit.search import Objective, refine, slice_minima

#: 95 % quantile of chi^2 with one degree of freedom.
THRESHOLD = 3.841458820694124
#: Shares of the way from inside to outside that are tried at first, and after that.
_FIRST, _THEN = np.geomspace(0.003, 0.6, 8), np.linspace(0, 1, 7)[1:-1]
_CUTS = 3
#: How far aside, over the box, the other parameters are also started from: chi^2 has walls.
_ASIDE = 0.01
#: How far apart, over the box, places between those of the grid are.
_APART = 0.002
#: chi^2 below the least so far that is a better fit.
_BETTER = 1e-3
#: Times that intervals are sought anew, where a profile came by a better fit.
_REPEATS = 3


@dataclass(frozen=True, slots=True, eq=False)
class Interval:
    """A 95 % interval of one parameter, and its profile.

    Attributes
    ----------
    parameter : str
    estimate, low, high : float
        Where it is open, `low` or `high` is the end of the box.
    open_low, open_high : bool
        Whether it reaches the end of the box.
    pieces : int
        Intervals that it consists of, on the grid of the profile; `low` and `high` enclose all.
    values, profile : ndarray
        The parameter, and chi^2 there less the least.
    places : ndarray, shape (n, P)
        All parameters on the profile.
    """

    parameter: str
    estimate: float
    low: float
    high: float
    open_low: bool
    open_high: bool
    pieces: int
    values: Floats
    profile: Floats
    places: Floats

    @property
    def flat(self) -> bool:
        """Whether the data cannot close it: a stiffness ratio open on a side, or anything open on both."""
        if self.parameter == "log_k":
            return self.open_low or self.open_high
        return self.open_low and self.open_high


def intervals_of(
    objective: Objective, pool: Floats, points: Floats, grid_chi2: Floats
) -> tuple[list[Interval], Floats]:
    """Profile every free parameter.

    Parameters
    ----------
    objective : Objective
    pool : ndarray, shape (S, P)
        Places where chi^2 is low, the best first.
    points, grid_chi2 : ndarray
        Of the dense grid (`search.search`).

    Returns
    -------
    intervals : list of Interval
        One a free parameter.
    best : ndarray, shape (P,)
        A better place where a profile came by one, else as given.
    """
    best, intervals = pool[0], list[Interval]()
    for _ in range(_REPEATS):
        least = float(objective.chi2(best))
        profiles = _profiles(objective, best, pool, points, grid_chi2)
        ends = _ends(objective, best, pool, least, profiles)
        intervals = [
            _interval(objective, best, least, profile, pair)
            for profile, pair in zip(profiles, ends, strict=True)
        ]
        lowest = min(intervals, key=lambda each: each.profile.min(), default=None)
        if lowest is None or lowest.profile.min() >= -_BETTER:
            break
        moved, _ = refine(objective, lowest.places[[lowest.profile.argmin()]])
        best, pool = moved[0], np.concatenate([moved, pool])
    return intervals, best


_Profile = tuple[int, Floats, Floats]


def _profiles(
    objective: Objective, best: Floats, pool: Floats, points: Floats, grid_chi2: Floats
) -> list[_Profile]:
    """Follow chi^2 along every free parameter: its index, places and chi^2 in the order of its values."""
    found, least, pool_chi2 = [], float(objective.chi2(best)), objective.chi2(pool)
    low, width = pool[pool_chi2 <= least + THRESHOLD], np.ptp(objective.box, axis=1)
    for i in np.flatnonzero(objective.free):
        # The pool holds places of low chi^2 that may lie between those of the grid.
        _, apart = np.unique(np.round(low[:, i] / (_APART * width[i])), return_index=True)
        starts = np.concatenate([points[slice_minima(points, grid_chi2, int(i))], low[apart]])
        fixed = np.full(len(starts), i)
        near = np.repeat(best[None], len(starts), axis=0)
        near[:, i] = starts[:, i]
        x, f = _at_fixed(objective, [starts, near, *_others(starts, fixed, pool, 1)], fixed, 10)
        x, f = _least_of(x, f, len(starts))
        places, chi2 = np.concatenate([x, [best]]), np.concatenate([f, [least]])
        order = np.argsort(places[:, i], kind="stable")
        found.append((int(i), places[order], chi2[order]))
    return found


def _at_fixed(
    objective: Objective, blocks: list[Floats], fixed: np.ndarray, rounds: int
) -> tuple[Floats, Floats]:
    """Refine blocks of starts, in each of which start n keeps its parameter ``fixed[n]``."""
    starts = np.concatenate(blocks)
    free = np.ones(starts.shape, dtype=bool)
    free[np.arange(len(starts)), np.tile(fixed, len(blocks))] = False
    return refine(objective, starts, free, rounds=rounds)


def _others(starts: Floats, fixed: np.ndarray, pool: Floats, n: int) -> list[Floats]:
    """Give n blocks of starts whose other parameters are those of the places of the pool that are nearest."""
    rows = np.arange(len(starts))
    values = starts[rows, fixed]
    nearest = np.argsort(np.abs(pool[:, fixed] - values), axis=0, kind="stable")
    found = []
    for at in range(min(n, len(pool))):
        block = pool[nearest[at]].copy()
        block[rows, fixed] = values
        found.append(block)
    return found


def _least_of(x: Floats, f: Floats, n: int) -> tuple[Floats, Floats]:
    """Of several answers to each of n questions, one block after the other, take the best."""
    blocks = f.reshape(-1, n)
    best = blocks.argmin(axis=0)
    return x.reshape(-1, n, x.shape[-1])[best, np.arange(n)], blocks.min(axis=0)


@dataclass(slots=True)
class _Bracket:
    """A place inside of an interval and one outside, with chi^2 less the least."""

    parameter: int
    inside: Floats
    outside: Floats
    low: float
    high: float
    first: bool
    seen: list[tuple[Floats, Floats]] = field(default_factory=list)

    def between(self) -> Floats:
        shares = _FIRST if self.first else _THEN
        return self.inside + shares[:, None] * (self.outside - self.inside)

    def narrow(self, x: Floats, rise: Floats) -> None:
        """Take the last place inside before the first outside, seen from outside: the interval encloses all pieces."""
        self.seen.append((x, rise))
        within = np.flatnonzero(rise <= THRESHOLD)
        last = within[-1] if within.size else -1
        if last + 1 < len(x):
            self.outside, self.high = x[last + 1], float(rise[last + 1])
        if last >= 0:
            self.inside, self.low = x[last], float(rise[last])
        self.first = False

    def edge(self) -> float:
        """Where the square root of the rise, which is nearly straight, passes that of the threshold."""
        low, high = np.sqrt(max(self.low, 0.0)), np.sqrt(self.high)
        share = (np.sqrt(THRESHOLD) - low) / (high - low) if high > low else 1.0
        a, b = self.inside[self.parameter], self.outside[self.parameter]
        return float(a + min(max(share, 0.0), 1.0) * (b - a))


def _ends(
    objective: Objective, best: Floats, pool: Floats, least: float, profiles: list[_Profile]
) -> list[list[_Bracket | None]]:
    """Find both ends of every interval together; None where one does not close."""
    brackets: list[list[_Bracket | None]] = [
        [_bracket(places, f - least, i, side, best) for side in (-1, 1)] for i, places, f in profiles
    ]
    random, width = np.random.default_rng(0), np.ptp(objective.box, axis=1)
    flat = [bracket for pair in brackets for bracket in pair if bracket is not None]
    for _ in range(_CUTS if flat else 0):
        between = [bracket.between() for bracket in flat]
        fixed = np.concatenate([np.full(len(x), b.parameter) for b, x in zip(flat, between, strict=True)])
        starts = np.concatenate(between)
        aside = starts + _ASIDE * width * random.standard_normal((2, *starts.shape))
        aside[:, np.arange(len(starts)), fixed] = starts[np.arange(len(starts)), fixed]
        blocks = [starts, *aside, *_others(starts, fixed, pool, 3)]
        x, f = _at_fixed(objective, blocks, fixed, 12)
        x, f = _least_of(x, f, len(starts))
        begin = 0
        for bracket, part in zip(flat, between, strict=True):
            end = begin + len(part)
            bracket.narrow(x[begin:end], f[begin:end] - least)
            begin = end
    return brackets


def _bracket(places: Floats, rise: Floats, i: int, side: int, best: Floats) -> _Bracket | None:
    """Find the outermost place inside on a side, and its neighbour outside; None where there is no neighbour."""
    within = np.flatnonzero(rise <= THRESHOLD)
    inside = int(within[-1] if side > 0 else within[0])
    outside = inside + side
    if not 0 <= outside < len(places):
        return None
    at_best = bool(places[inside, i] == best[i])
    return _Bracket(i, places[inside], places[outside], float(rise[inside]), float(rise[outside]), at_best)


def _interval(
    objective: Objective, best: Floats, least: float, profile: _Profile, ends: list[_Bracket | None]
) -> Interval:
    i, places, f = profile
    low, high = objective.box[i]
    inside = f - least <= THRESHOLD
    seen = [(places, f - least), *(one for end in ends if end is not None for one in end.seen)]
    places, rise = (np.concatenate(columns) for columns in zip(*seen, strict=True))
    order = np.argsort(places[:, i], kind="stable")
    return Interval(
        objective.law.parameters[i],
        float(best[i]),
        float(low) if ends[0] is None else ends[0].edge(),
        float(high) if ends[1] is None else ends[1].edge(),
        ends[0] is None,
        ends[1] is None,
        int((np.diff(inside.astype(int), prepend=0) == 1).sum()),
        places[order, i],
        rise[order],
        places[order],
    )
