r"""Why an engine diverges from the model: the difference of final velocities, split into its causes (docs/ladder.md).

In every cell, for the velocities of all balls, to rounding,

    engine - model = frozen positions + dissipation law + gravity + regularisation and mapping + time step

**The three causes** stand between the model and the law that the engine was asked for in its scenario: three switches,
every combination of which is known without an engine (`corners`). The vector of a cause is the mean of what its switch
changes over the six orders in which they can be turned on (its *Shapley value*); how far the orders are apart is given
as the least and the largest share. Columns of N balls know no gravity, and have two switches with two orders.

**The last two contributions** have one order, since nothing is known of an engine with the model's law: the limit
dt -> 0 minus the law it was asked for, then the engine minus that limit. Where no limit was computed, or it did not
converge, the two are one, `ENGINE`.

**Sizes.** The size of a contribution is its kinetic norm (`model.kinetic`) per \|v0\|. Norms do not add; components
along the total do:

    along_i = <contribution_i, total>/D,    <a, b> = a1 b1 + (m2/m1) a2 b2,    sum along_i = D,

and share_i = along_i/D. A negative share takes the engine back towards the model. Over many cells a share is
sum(along_i)/sum(D), its range that of this quotient over the six orders.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import permutations

import numpy as np
from numpy.typing import NDArray

from impact_xval.experiments.measures.corners import Corners, Floats

#: D below which there is nothing to split: the accuracy of the references.
NOTHING = 1e-9

#: Two large causes cancel where one share is below the first and another above the second: each is then longer than D,
#: and the larger more than twice as long.
CANCEL = (-1.0, 2.0)


@dataclass(frozen=True, slots=True)
class Contribution:
    """One part of a divergence.

    Attributes
    ----------
    before, after : str
        Of a cause (`CAUSES`) the positions of a switch of `corners`; else two outcomes, of which it is the difference.
    color : str
        Of Tol's muted palette, which shares none with solvers.
    phrase : str
        In a sentence about an engine, after "by".
    """

    name: str
    label: str
    before: str
    after: str
    color: str
    phrase: str


_ASKED = "kelvin-voigt in the scenario of the run"
_LIMIT = "the engine in the limit dt -> 0"
_RUN = "the engine at the step it was run with"

FROZEN = Contribution(
    "frozen_positions",
    "frozen positions",
    "contacts that return when their bodies approach",
    "contacts that return when their gap has closed",
    "#332288",
    "frozen positions",
)
LAW = Contribution(
    "dissipation_law",
    "dissipation law",
    "energetic restitution",
    "the law the engine was asked for (spring and dashpot, kelvin-voigt)",
    "#DDCC77",
    "the dissipation law",
)
GRAVITY = Contribution(
    "gravity",
    "gravity",
    "no gravity",
    "gravity as in the scenario of the run, B2 in static equilibrium",
    "#88CCEE",
    "gravity",
)
MAPPING = Contribution(
    "mapping",
    "regularisation and mapping",
    _ASKED,
    _LIMIT,
    "#AA4499",
    "its regularisation and mapping",
)
STEP = Contribution("discretisation", "time step", _LIMIT, _RUN, "#999933", "its time step")
ENGINE = Contribution(
    "engine", "mapping and time step", _ASKED, _RUN, "#117733", "its mapping and time step, not separated"
)

#: Those that need no engine, in the order of `by_order`: averages over the orders in which they can be made.
CAUSES = (FROZEN, LAW, GRAVITY)

#: All, in their order; a cell has either the last one or the two before it. Where one says kelvin-voigt, an engine of
#: another law has its own.
CONTRIBUTIONS = (*CAUSES, MAPPING, STEP, ENGINE)


def contributions_of(*, gravity: bool = True) -> tuple[Contribution, ...]:
    """Return the contributions in their order; `gravity` is whether there may be any."""
    return tuple(c for c in CONTRIBUTIONS if gravity or c is not GRAVITY)


def by_order(corners: Floats) -> Floats:
    """Turn the three switches of corners on in each of their six orders, and say what every step changes.

    From shape (2, 2, g, ...) to (6, g + 1, ...), by order and cause; g is 1 without gravity. Each order sums to the
    last corner minus the first.
    """
    found = []
    for order in permutations(range(3)):
        at, steps = [0, 0, 0], {}
        for switch in order:
            if corners.shape[switch] > 1:
                before = corners[tuple(at)]
                at[switch] = 1
                steps[switch] = corners[tuple(at)] - before
        found.append([steps[switch] for switch in sorted(steps)])
    return np.array(found)


def cancelling(shares: Sequence[float]) -> tuple[int, int] | None:
    """Return which two of these shares are of large causes that cancel, the larger first; None if none are."""
    found = np.nan_to_num(np.asarray(shares, dtype=float))
    high, low = int(found.argmax()), int(found.argmin())
    return (high, low) if found[high] > CANCEL[1] and found[low] < CANCEL[0] else None


@dataclass(frozen=True, eq=False)
class Split:
    """The m contributions to the divergence of n cells of N balls, as differences of velocities per abs(v0).

    Attributes
    ----------
    weights : ndarray, shape (n, N)
        Masses over that of what moves at first.
    vectors : ndarray, shape (m, n, N)
        NaN for a contribution that a cell does not have.
    causes : ndarray, shape (6, c, n, N)
        Those of the causes by each of their orders, without gravity two orders three times each.
    total : ndarray, shape (n, N)
        Engine minus model.
    """

    contributions: tuple[Contribution, ...]
    weights: Floats
    vectors: Floats
    causes: Floats
    total: Floats

    @cached_property
    def divergence(self) -> Floats:
        """D, shape (n,)."""
        return np.sqrt((self.weights * self.total**2).sum(axis=1))

    @cached_property
    def norms(self) -> Floats:
        """Kinetic norm of each contribution, shape (m, n)."""
        return np.sqrt((self.weights * self.vectors**2).sum(axis=2))

    def component(self, differences: Floats) -> Floats:
        """Component of differences of velocities along the total, shape (..., n); NaN where D is 0."""
        with np.errstate(invalid="ignore", divide="ignore"):
            return (self.weights * differences * self.total).sum(axis=-1) / self.divergence

    @cached_property
    def along(self) -> Floats:
        """Component of each contribution along the total, shape (m, n)."""
        return self.component(self.vectors)

    @cached_property
    def orders(self) -> Floats:
        """`along` by each order of the causes, shape (6, m, n); all the same for those that have one order."""
        causes = self.component(self.causes)
        rest = self.along[causes.shape[1] :]
        return np.concatenate([causes, np.broadcast_to(rest, (len(causes), *rest.shape))], axis=1)

    @property
    def shares(self) -> Floats:
        """`along` over D; NaN where there is nothing to split."""
        return self.along / self._divided

    @property
    def ranges(self) -> tuple[Floats, Floats]:
        """Least and largest share by the orders, shape (m, n) each."""
        shares = self.orders / self._divided
        return shares.min(axis=0), shares.max(axis=0)

    @property
    def _divided(self) -> Floats:
        return np.where(self.divergence >= NOTHING, self.divergence, np.nan)

    def dominant(self) -> NDArray[np.intp]:
        """Index of the largest share in each cell; -1 where there is nothing to split."""
        return np.where(self.divergence >= NOTHING, _largest(self.along), -1)

    def agreed(self) -> NDArray[np.bool_]:
        """Whether the same contribution has the largest share by all orders."""
        return np.all([_largest(along) == self.dominant() for along in self.orders], axis=0)


def _largest(along: Floats) -> NDArray[np.intp]:
    return np.argmax(np.where(np.isnan(along), -np.inf, along), axis=0)


def split(weights: Floats, corners: Corners, limit: Floats, engine: Floats) -> Split:
    """Split the difference of an engine from the model into contributions.

    Parameters
    ----------
    weights : ndarray, shape (n, N)
        Masses over that of what moves at first.
    corners : Corners
    limit, engine : ndarray, shape (n, N)
        The engine in the limit dt -> 0, and at its step: final velocities per abs(v0), NaN where there are none.
    """
    known = ~np.isnan(limit).any(axis=1, keepdims=True)
    causes = by_order(corners.velocities)
    mapping, step = (np.where(known, x, np.nan) for x in (limit - corners.asked, engine - limit))
    joined = np.where(known, np.nan, engine - corners.asked)
    vectors = np.concatenate([causes.mean(axis=0), [mapping, step, joined]])
    return Split(contributions_of(gravity=corners.gravity), weights, vectors, causes, engine - corners.model)
