"""Why an engine diverges from the model: the difference of final velocities, split into its causes (docs/ladder.md).

The three causes stand between the model and the law that the engine was asked for in its scenario: switches, all
combinations of which (`corners`) are known without an engine. A cause is the mean of what its switch changes over the
six orders in which they can be turned on (its Shapley value); columns of N balls know no gravity, and have two. The
last two contributions, from that law to the engine, have one order. All sum to engine minus model, to rounding.

Norms do not add, components along the total do: their sum is D. A share is one of them over D; over many cells it is
sum(along)/sum(D), its range that of this quotient over the orders.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import permutations
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from impact_xval.experiments.measures.corners import Corners, Floats

#: D below which there is nothing to split: the accuracy of the references.
NOTHING = 1e-9

#: Two large causes cancel where one share is below the first and another above the second: each is then longer than D,
#: and the larger more than twice as long.
CANCEL = (-1.0, 2.0)


class Contribution(NamedTuple):
    """One part of a divergence; the phrase stands in a sentence about an engine, after "by"."""

    name: str
    label: str
    #: Of a cause the positions of its switch (`corners`); else two outcomes, of which it is the difference.
    before: str
    after: str
    #: Of Tol's muted palette, which shares none with solvers.
    color: str
    phrase: str


_ASKED = "kelvin-voigt in the scenario of the run"
_LIMIT = "the engine in the limit dt -> 0"
_RUN = "the engine at the step it was run with"

#: Those that need no engine, in the order of `by_order`: averages over the orders in which they can be made.
CAUSES = (
    Contribution(
        "frozen_positions",
        "frozen positions",
        "contacts that return when their bodies approach",
        "contacts that return when their gap has closed",
        "#332288",
        "frozen positions",
    ),
    Contribution(
        "dissipation_law",
        "dissipation law",
        "energetic restitution",
        "the law the engine was asked for (spring and dashpot, kelvin-voigt)",
        "#DDCC77",
        "the dissipation law",
    ),
    Contribution(
        "gravity",
        "gravity",
        "no gravity",
        "gravity as in the scenario of the run, B2 in static equilibrium",
        "#88CCEE",
        "gravity",
    ),
)

#: All, in their order; a cell has either the last one or the two before it. Where one says kelvin-voigt, an engine of
#: another law has its own.
CONTRIBUTIONS = (
    *CAUSES,
    Contribution(
        "mapping", "regularisation and mapping", _ASKED, _LIMIT, "#AA4499", "its regularisation and mapping"
    ),
    Contribution("discretisation", "time step", _LIMIT, _RUN, "#999933", "its time step"),
    Contribution(
        "engine", "mapping and time step", _ASKED, _RUN, "#117733", "its mapping and time step, not separated"
    ),
)


def contributions_of(*, gravity: bool) -> tuple[Contribution, ...]:
    """Return the contributions in their order; `gravity` is whether there may be any."""
    return tuple(c for c in CONTRIBUTIONS if gravity or c.name != "gravity")


def by_order(corners: Floats) -> Floats:
    """Turn the three switches of corners on in each of their six orders, and say what every step changes.

    From shape (2, 2, g, ...) to (6, g + 1, ...), by order and cause; g is 1 without gravity, and each of the two orders
    there three times. Each order sums to the last corner minus the first.
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


class Split(NamedTuple):
    """The m contributions to the divergence of n cells of N balls, as differences of velocities per abs(v0)."""

    contributions: tuple[Contribution, ...]
    #: Engine minus model, shape (n, N), and D, its kinetic norm, shape (n,).
    total: Floats
    divergence: Floats
    #: Contributions, shape (m, n, N), and their kinetic norms, shape (m, n); NaN for one that a cell does not have.
    vectors: Floats
    norms: Floats
    #: Their components along the total, shape (m, n), and these by each order of the causes, shape (6, m, n); NaN where
    #: D is 0.
    along: Floats
    orders: Floats
    #: Component of each corner minus the model along the total, shape (2, 2, g, n).
    corners: Floats

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
        return (_largest(self.orders) == self.dominant()).all(axis=0)


def _largest(along: Floats) -> NDArray[np.intp]:
    return np.argmax(np.where(np.isnan(along), -np.inf, along), axis=-2)


def split(weights: Floats, corners: Corners, limit: Floats, engine: Floats) -> Split:
    """Split the difference of an engine from the model into contributions.

    Weights are masses over that of what moves at first; `limit` and `engine` final velocities per abs(v0), in the limit
    dt -> 0 and at the engine's step, NaN where there are none. All are of shape (n, N).
    """
    known = ~np.isnan(limit).any(axis=1, keepdims=True)
    mapping, step = (np.where(known, x, np.nan) for x in (limit - corners.asked, engine - limit))
    joined = np.where(known, np.nan, engine - corners.asked)
    causes, total = by_order(corners.velocities), engine - corners.model
    vectors = np.concatenate([causes.mean(axis=0), [mapping, step, joined]])
    divergence = _norm(weights, total)

    def component(differences: Floats) -> Floats:
        with np.errstate(invalid="ignore", divide="ignore"):
            return (weights * differences * total).sum(axis=-1) / divergence

    along, of_causes = component(vectors), component(causes)
    rest = along[of_causes.shape[1] :]  # the same by every order
    return Split(
        contributions=contributions_of(gravity=corners.gravity),
        total=total,
        divergence=divergence,
        vectors=vectors,
        norms=_norm(weights, vectors),
        along=along,
        orders=np.concatenate([of_causes, np.broadcast_to(rest, (len(of_causes), *rest.shape))], axis=1),
        corners=component(corners.velocities - corners.model),
    )


def _norm(weights: Floats, differences: Floats) -> Floats:
    """Kinetic norm."""
    return np.sqrt((weights * differences**2).sum(axis=-1))
