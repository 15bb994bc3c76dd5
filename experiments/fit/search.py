"""The search of a law's box for the parameters of least chi^2: a dense grid, then many starts refined at once.

chi^2 is the sum of the squared residuals, (law - measured)/(standard error), of both velocities after each trial:
minus twice the logarithm of the Gaussian likelihood, but for a constant. It jumps where a collision grazes, and has
kinks where its sequence of states changes; so no step is trusted that does not lower it. A step of Gauss and Newton on
differences, several times damped, and probes along each axis compete, and the least chi^2 of all of them wins; the
probes close in. All starts of a search go through the batch solvers together.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import product

import numpy as np
import pandas as pd

from impact_xval.experiments.fit.laws import LAWS, Floats, Law
from impact_xval.experiments.fit.trials import Trials

#: Values of a parameter on the dense grid.
_GRID = {"log_k": 33, "e1": 16, "e2": 16}
_GRID_OF_TWO = 61
#: Mass ratios that the dense grid is solved for: a fifth of a million collisions a law.
_MOST_RATIOS = 8
#: Points of the grid that are looked at with all trials, and those that are refined.
_CANDIDATES, _STARTS = 600, 64
#: Of those, refined to the end; places that are tried around the best of them, and how far over the box.
_KEPT, _AROUND, _FAR = 16, 48, (1e-3, 0.1)

#: Distance over the box within which two places are one.
_BESIDE = 0.01

#: Residual of a law that gives no velocities.
_NONE = 1e6
#: Dampings of a step, and the smallest probe over the width of the box.
_DAMPINGS, _LEAST_PROBE = (1e-9, 1e-2, 1.0), 1e-7
#: Gain of chi^2 in a round that no longer counts.
_SMALL = 1e-5


@dataclass(frozen=True, slots=True, eq=False)
class Objective:
    """Residuals of a law over trials.

    Attributes
    ----------
    law : Law
    trials : Trials
    fixed : ndarray, shape (P,)
        Values of parameters that are known; NaN where free.
    scatter : ndarray, shape (2 T,)
        chi^2 about each v1, then each v2, of the trials that it is the mean of.
    ratios : ndarray
        Mass ratios that the dense grid is solved for.
    """

    law: Law
    trials: Trials
    fixed: Floats
    scatter: Floats
    ratios: Floats

    @classmethod
    def hold(cls, law: Law, trials: Trials) -> Objective:
        """Hold a law against trials; what is known of their contacts is fixed."""
        known = dict(trials.known)
        known.setdefault("e", known.get("e1", known.get("e2", np.nan)))
        fixed = np.array([known.get(name, np.nan) for name in law.parameters])
        ratios = np.unique(trials.mass_ratio)
        few = np.linspace(0, len(ratios) - 1, min(len(ratios), _MOST_RATIOS)).round().astype(int)
        return cls(law, trials, fixed, np.zeros(2 * len(trials.rows)), ratios[few])

    def pooled(self) -> Objective:
        """Put a mean in the place of the trials of a group that have one mass ratio: chi^2 is less by `scatter`."""
        t = self.trials
        trial, _ = pd.MultiIndex.from_arrays([t.mass_ratio, t.groups]).factorize()
        _, first = np.unique(trial, return_index=True)
        columns: dict[str, Floats] = {}
        scatter = []
        for v, sd, name in ((t.v1, t.sd1, "1"), (t.v2, t.sd2, "2")):
            each = sd**-2.0
            weight = np.bincount(trial, each)
            mean = np.bincount(trial, each * v) / np.where(weight > 0, weight, 1.0)
            scatter.append(np.bincount(trial, each * (v - mean[trial]) ** 2))
            with np.errstate(divide="ignore"):
                columns |= {f"v{name}": mean, f"sd{name}": 1 / np.sqrt(weight)}
        return replace(self, trials=replace(t.chosen(first), **columns), scatter=np.concatenate(scatter))

    def of(self, trials: np.ndarray) -> Objective:
        """Hold the law against some of the trials, given by their places."""
        both = np.concatenate([trials, trials + len(self.trials.rows)])
        chosen = self.trials.chosen(trials)
        kept = np.intersect1d(self.ratios, chosen.mass_ratio)  # what is solved for them is kept
        ratios = kept if kept.size else np.unique(chosen.mass_ratio)[:_MOST_RATIOS]
        return replace(self, trials=chosen, scatter=self.scatter[both], ratios=ratios)

    @property
    def free(self) -> np.ndarray:
        """Whether each parameter is free, shape (P,)."""
        return np.isnan(self.fixed)

    @property
    def box(self) -> Floats:
        """Ends of each parameter, those of a known one equal, shape (P, 2)."""
        return np.where(self.free[:, None], self.law.box, self.fixed[:, None])

    def residuals(self, points: Floats) -> Floats:
        """Give residuals in standard errors: those of v1, then those of v2.

        Parameters
        ----------
        points : ndarray, shape (..., P)

        Returns
        -------
        ndarray, shape (..., 2 T)
        """
        ratios, of_trial = np.unique(self.trials.mass_ratio, return_inverse=True)
        v1, v2 = self.law.velocities(points, ratios)
        return self._scaled(v1[..., of_trial], v2[..., of_trial])

    def _scaled(self, v1: Floats, v2: Floats) -> Floats:
        t = self.trials
        found = np.concatenate([(v1 - t.v1) / t.sd1, (v2 - t.v2) / t.sd2], axis=-1)
        return np.where(np.isfinite(found), found, _NONE)

    def chi2(self, points: Floats) -> Floats:
        """Give chi^2, shape (...)."""
        return (self.residuals(points) ** 2).sum(axis=-1)

    def axes(self) -> list[Floats]:
        """Give the values of each parameter on the dense grid."""
        return _axes(self.law, self.fixed)

    def grid(self) -> tuple[Floats, Floats]:
        """Solve the dense grid: points, shape (G, P), and chi^2 over trials of some mass ratios, shape (G,)."""
        points, t = _grid_points(self.law, self.fixed), self.trials
        chi2 = np.zeros(len(points))
        for ratio in self.ratios:
            # NaN is no key: it equals nothing
            known = tuple(None if free else x for x, free in zip(self.fixed.tolist(), self.free, strict=True))
            v1, v2 = _grid_velocities(self.law.name, known, float(ratio))
            for i in np.flatnonzero(t.mass_ratio == ratio):
                part = ((v1 - t.v1[i]) / t.sd1[i]) ** 2 + ((v2 - t.v2[i]) / t.sd2[i]) ** 2
                chi2 += np.where(np.isfinite(part), part, _NONE**2)
        return points, chi2


@lru_cache(maxsize=256)
def _grid_velocities(name: str, known: tuple[float | None, ...], ratio: float) -> tuple[Floats, Floats]:
    """Velocities on the dense grid of a law: kept, since data of one laboratory share their mass ratios."""
    law = LAWS[name]
    v1, v2 = law.velocities(_grid_points(law, np.array(known, dtype=float)), np.array([ratio]))
    return v1[:, 0], v2[:, 0]


def _axes(law: Law, fixed: Floats) -> list[Floats]:
    free = np.isnan(fixed)
    few = free.sum() <= 2 and "log_k" not in law.parameters
    return [
        np.linspace(low, high, _GRID_OF_TWO if few else _GRID[name]) if not known else np.array([value])
        for name, known, value, (low, high) in zip(law.parameters, ~free, fixed, law.box, strict=True)
    ]


def _grid_points(law: Law, fixed: Floats) -> Floats:
    return np.array(list(product(*_axes(law, fixed))))


def refine(
    objective: Objective,
    starts: Floats,
    free: np.ndarray | None = None,
    weights: Floats | None = None,
    rounds: int = 40,
) -> tuple[Floats, Floats]:
    """Lower chi^2 from many starts at once.

    Parameters
    ----------
    objective : Objective
    starts : ndarray, shape (S, P)
    free : ndarray of bool, shape (S, P), optional
        Which parameters of each start may move; by default all that are not known.
    weights : ndarray, shape (S, 2 T), optional
        Of the squared residuals, 0 or 1; by default 1.
    rounds : int
        At most.

    Returns
    -------
    points : ndarray, shape (S, P)
    chi2 : ndarray, shape (S,)
    """
    box = objective.box
    low, high = box.T
    width = np.where(high > low, high - low, 1.0)
    x = np.clip(starts, low, high)
    free = np.broadcast_to(objective.free, x.shape) if free is None else free & objective.free
    weights = np.ones((len(x), 2 * len(objective.trials.v1))) if weights is None else weights
    r = objective.residuals(x) * weights
    f, probe = (r**2).sum(axis=-1), np.full(x.shape, 0.02) * width
    active = np.flatnonzero(free.any(axis=1))
    for _ in range(rounds):
        if not active.size:
            break
        moved, there, by_probe = _best_of_round(
            objective, x[active], r[active], probe[active], free[active], weights[active]
        )
        squared = (there**2).sum(axis=-1)
        gain = f[active] - squared
        better = gain > 0
        x[active[better]], r[active[better]], f[active[better]] = (
            moved[better],
            there[better],
            squared[better],
        )
        closer = ~better | ~by_probe
        probe[active[closer]] = np.maximum(probe[active[closer]] * 0.2, _LEAST_PROBE * width)
        fine = (probe[active] <= 1e-3 * width).all(axis=1)
        active = active[~(fine & (gain < _SMALL))]
    return x, f


def _best_of_round(
    objective: Objective, x: Floats, r: Floats, probe: Floats, free: np.ndarray, weights: Floats
) -> tuple[Floats, Floats, np.ndarray]:
    """Try probes and damped steps from every start: the best place, residuals there, and whether a probe found it."""
    low, high = objective.box.T
    n, p = x.shape
    moving = np.flatnonzero(free.any(axis=0))
    steps = np.eye(p)[moving, None, :] * (probe * free)[None]
    probes = np.clip(np.concatenate([x + steps, x - steps]), low, high)
    tried = objective.residuals(probes) * weights
    ahead, behind = np.split(tried, 2)
    apart = (probes[: len(moving)] - probes[len(moving) :]).sum(axis=-1)[..., None]
    # One-sided differences near a jump are worse than none: both sides are used.
    slope = np.zeros((p, *r.shape))
    slope[moving] = np.divide(ahead - behind, apart, out=np.zeros_like(ahead), where=apart > 0)
    gradient = np.einsum("isd,sd->si", slope, r)
    held = ~free | ((x <= low) & (gradient > 0)) | ((x >= high) & (gradient < 0))
    slope = np.where(held.T[..., None], 0.0, slope)
    gradient = np.where(held, 0.0, gradient)
    normal = np.einsum("isd,jsd->sij", slope, slope)
    size = np.einsum("sii->si", normal)
    size = np.where(size > 0, size, 1.0)
    candidates = [
        np.clip(
            x - np.linalg.solve(normal + damping * size[:, :, None] * np.eye(p), gradient[..., None])[..., 0],
            low,
            high,
        )
        for damping in _DAMPINGS
    ]
    stepped = np.array(candidates)
    places = np.concatenate([stepped, probes])
    residuals = np.concatenate([objective.residuals(stepped) * weights, tried])
    best = (residuals**2).sum(axis=-1).argmin(axis=0)
    at = np.arange(n)
    return places[best, at], residuals[best, at], best >= len(_DAMPINGS)


def starts_of(objective: Objective, points: Floats, chi2: Floats, n: int) -> Floats:
    """Choose places of the grid to start from: the best that are no neighbours, and the best of every stiffness."""
    order = np.argsort(chi2, kind="stable")[:_CANDIDATES]
    order = order[np.argsort(objective.chi2(points[order]), kind="stable")]
    cells = np.array([len(axis) - 1 for axis in objective.axes()])
    low, high = objective.box.T
    at = (points - low) / np.where(high > low, high - low, 1.0) * cells
    chosen: list[int] = []
    for i in order:
        if all(np.abs(at[i] - at[j]).max() > 1.5 for j in chosen):
            chosen.append(int(i))
        if len(chosen) == n // 2:
            break
    slices = slice_minima(points, chi2, 0)
    return points[np.unique([*chosen, *slices[np.argsort(chi2[slices])][: n // 2]])]


def slice_minima(points: Floats, chi2: Floats, parameter: int) -> np.ndarray:
    """Give the index of the least chi^2 of the grid at every value of a parameter, in its order."""
    order = np.lexsort((chi2, points[:, parameter]))
    _, first = np.unique(points[order, parameter], return_index=True)
    return order[first]


def search(objective: Objective) -> tuple[Floats, Floats, Floats, Floats]:
    """Find the least chi^2.

    Parameters
    ----------
    objective : Objective

    Returns
    -------
    best : ndarray, shape (S, P)
        Places that were refined, the best first.
    chi2 : ndarray, shape (S,)
        Of them.
    points, grid_chi2 : ndarray
        The dense grid, as `Objective.grid`.
    """
    points, grid_chi2 = objective.grid()
    x, f = refine(objective, starts_of(objective, points, grid_chi2, _STARTS), rounds=6)
    x, f = refine(objective, _different(objective, x[np.argsort(f, kind="stable")], _KEPT))
    order = np.argsort(f, kind="stable")
    x, f = x[order], f[order]
    more, found = refine(objective, around(objective, x[:2], _AROUND), rounds=12)
    x, f = np.concatenate([x, more]), np.concatenate([f, found])
    order = np.argsort(f, kind="stable")
    return x[order], f[order], points, grid_chi2


def _different(objective: Objective, places: Floats, n: int) -> Floats:
    """Keep the first places that are not beside one another: data may be explained in several ways."""
    width = np.where(objective.free, np.ptp(objective.box, axis=1), 1.0)
    chosen: list[int] = []
    for i in range(len(places)):
        if all((np.abs(places[i] - places[j]) > _BESIDE * width).any() for j in chosen):
            chosen.append(i)
        if len(chosen) == n:
            break
    return places[chosen]


def around(objective: Objective, places: Floats, n: int) -> Floats:
    """Give n places around each of some, near and far: chi^2 has walls that only a start behind them passes."""
    random = np.random.default_rng(0)  # a fit is a function of its data
    far = np.geomspace(*_FAR, n)[:, None, None] * np.ptp(objective.box, axis=1)
    found = places + far * random.standard_normal((n, *places.shape))
    return found.reshape(-1, places.shape[-1])
