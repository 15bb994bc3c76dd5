r"""Why an engine diverges from the model: the difference of final velocities, split into its causes.

In every cell, for (v1, v2), to rounding,

    engine - model = frozen positions + dissipation law + gravity + regularisation and mapping + time step

**The three causes** stand between the model and the law that the engine was asked for in its scenario. They are three
switches, and every combination of them is known without an engine (`corners`). What a switch changes depends on the
others: gravity moves more with free positions than with frozen ones. There are six orders in which to turn the three
on, each of which splits the difference another way, and none is the right one. The vector of a cause is the mean of
what it changes over the six (its *Shapley value*): the three still sum to the difference, and none depends on an order.
How far the orders are apart is given beside it, as the least and the largest share.

Where another law is put in the place of the engine's (`corners.laws_of`), the switch of the law is turned by way of it,
in every order: the rung of the dissipation law is then what it changes as far as the alternative, `law_choice` what is
left, and the two sum to what the rung is without. Frozen positions and gravity do not change.

**The last two rungs** have one order, since nothing is known of an engine with the model's law: the limit of small
steps minus the law it was asked for, then the engine minus that limit. Where no limit was computed, or it did not
converge, the two are one, `ENGINE`.

**Sizes.** The size of a rung is its kinetic norm, sqrt(dv1^2 + (m2/m1) dv2^2) per \|v0\|, as D is that of the total.
Norms do not add: rungs are vectors, and may oppose each other. What does add is their component along the total,

    along_i = <rung_i, total>/D,    <a, b> = a1 b1 + (m2/m1) a2 b2,    sum along_i = D,

and share_i = along_i/D, of which the sum is 1. A negative share is a rung that takes the engine back towards the
model; a share above 1 one that others take back. Where one is above `CANCEL[1]` and another below `CANCEL[0]` the
shares say little but that D is small: two large causes cancel (`cancelling`). Over many cells the share of a rung is
sum(along_i)/sum(D): what it contributes to the mean D, cells of large D counting for as much as they diverge; its
range is that of this quotient over the six orders.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import permutations

import numpy as np
from numpy.typing import NDArray

from impact_xval.experiments.measures.corners import Corners
from impact_xval.experiments.measures.rungs import (
    CHOICE,
    ENGINE,
    FROZEN,
    GRAVITY,
    LAW,
    MAPPING,
    STEP,
    Rung,
)

Floats = NDArray[np.float64]

#: D below which there is nothing to split: the accuracy of the references.
NOTHING = 1e-9

#: Two large causes cancel where one share is below the first and another above the second: each is then longer than D,
#: and the larger more than twice as long.
CANCEL = (-1.0, 2.0)


def by_order(corners: Floats) -> Floats:
    """Turn the three switches on in each of their six orders, and say what every step changes.

    Parameters
    ----------
    corners : ndarray, shape (2, m, 2, ...)
        By position of the switches for positions, law and gravity; the switch of the law has m - 1 steps.

    Returns
    -------
    ndarray, shape (6, m + 1, ...)
        By order and step: positions, the steps of the law, gravity. Each order sums to the last corner minus the first.
    """
    found = []
    for order in permutations(range(3)):
        at, steps = [0, 0, 0], {}
        for switch in order:
            for step in range(corners.shape[switch] - 1):
                before = corners[tuple(at)]
                at[switch] += 1
                steps[switch, step] = corners[tuple(at)] - before
        found.append([steps[key] for key in sorted(steps)])
    return np.array(found)


def cancelling(shares: Sequence[float]) -> tuple[int, int] | None:
    """Return which two of these shares are of large causes that cancel, the larger first; None if none are."""
    found = np.nan_to_num(np.asarray(shares, dtype=float))
    high, low = int(found.argmax()), int(found.argmin())
    return (high, low) if found[high] > CANCEL[1] and found[low] < CANCEL[0] else None


@dataclass(frozen=True, slots=True, eq=False)
class Split:
    """The ladders of n cells.

    Attributes
    ----------
    rungs : tuple of Rung
        Those that were asked for, in order.
    vectors : ndarray, shape (m, n, 2)
        dv1 and dv2 of every rung per abs(v0); NaN for a rung that a cell does not have.
    total : ndarray, shape (n, 2)
        Engine minus model.
    norms, along : ndarray, shape (m, n)
        Kinetic norm of every rung, and its component along the total; `along` is NaN where D is 0.
    orders : ndarray, shape (6, m, n)
        `along` by each order of the causes; all the same for the rungs that have one order.
    divergence : ndarray, shape (n,)
        D.
    """

    rungs: tuple[Rung, ...]
    vectors: Floats
    total: Floats
    norms: Floats
    along: Floats
    orders: Floats
    divergence: Floats

    @property
    def shares(self) -> Floats:
        """`along` over D; NaN where D is less than `NOTHING`."""
        return self._over_divergence(self.along)

    @property
    def ranges(self) -> tuple[Floats, Floats]:
        """Least and largest share by the six orders, shape (m, n) each."""
        shares = self._over_divergence(self.orders)
        return shares.min(axis=0), shares.max(axis=0)

    def _over_divergence(self, along: Floats) -> Floats:
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.where(self.divergence >= NOTHING, along / self.divergence, np.nan)

    def dominant(self) -> NDArray[np.intp]:
        """Index into `rungs` of the one with the largest share in each cell; -1 where there is nothing to split."""
        return np.where(self.divergence >= NOTHING, _largest(self.along), -1)

    def agreed(self) -> NDArray[np.bool_]:
        """Whether the same rung has the largest share by all six orders."""
        return np.all([_largest(along) == self.dominant() for along in self.orders], axis=0)

    def residual(self) -> Floats:
        """Return the largest component, cell by cell, by which the rungs fail to sum to the total."""
        return np.abs(np.nansum(self.vectors, axis=0) - self.total).max(axis=1)


def _largest(along: Floats) -> NDArray[np.intp]:
    return np.argmax(np.where(np.isnan(along), -np.inf, along), axis=0)


def split(mass_ratio: Floats, corners: Corners, limit: Floats, engine: Floats) -> Split:
    """Split the difference of an engine from the model into rungs.

    Parameters
    ----------
    mass_ratio : ndarray, shape (n,)
        m2/m1.
    corners : Corners
        The model, the law of the engine in its scenario, and what is between, for the same cells.
    limit : ndarray, shape (n, 2)
        The engine in the limit of small steps; NaN where it is not known.
    engine : ndarray, shape (n, 2)
        Final velocities per abs(v0); NaN without a result.
    """
    known = ~np.isnan(limit).any(axis=1, keepdims=True)
    choice = (CHOICE,) if corners.velocities.shape[1] > 2 else ()
    causes = by_order(corners.velocities)
    rest = np.stack(
        [
            np.where(known, limit - corners.asked, np.nan),
            np.where(known, engine - limit, np.nan),
            np.where(known, np.nan, engine - corners.asked),
        ]
    )
    vectors = np.concatenate([causes.mean(axis=0), rest])
    total = engine - corners.model
    weight = np.stack([np.ones_like(mass_ratio), mass_ratio], axis=1)
    divergence = np.sqrt((weight * total**2).sum(axis=1))

    def component(differences: Floats) -> Floats:
        with np.errstate(invalid="ignore", divide="ignore"):
            return (weight * differences * total).sum(axis=-1) / divergence

    along = component(vectors)
    return Split(
        rungs=(FROZEN, LAW, *choice, GRAVITY, MAPPING, STEP, ENGINE),
        vectors=vectors,
        total=total,
        norms=np.sqrt((weight * vectors**2).sum(axis=2)),
        along=along,
        orders=np.stack(
            [np.concatenate([component(causes[i]), along[-len(rest) :]]) for i in range(len(causes))]
        ),
        divergence=divergence,
    )
