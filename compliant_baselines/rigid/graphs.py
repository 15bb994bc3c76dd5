"""Rigid impact laws for contact graphs with a Delassus matrix W; `rigid.laws` has the laws' formulas and sources.

An impact with impulses P >= 0 changes the rates of compression w to w - W P. All contacts touch throughout, and there
are no flights. Impacts follow one another until no contact approaches. Two laws differ from `rigid.laws` in the order
of contacts: **sequential** always takes the first contact of a given order that approaches, and
**plastic-then-restitution** sweeps in that order.

**Complementarity.** The problem 0 <= P, q + W P >= 0, P . (q + W P) = 0 is solved as a least-squares problem. With W =
L L^T and q = L c it is that of L^T P = -c with P >= 0. L^T P is unique, and so are the velocities. P is unique only if
no other P >= 0 has the same W P. `impulse_spread` is the largest range of the impulse of compression of a single
contact over all such P, in the first impact. Poisson's law and the sweep of plastic-then-restitution depend on P.
`rate_spread` is the largest difference between the final rates that follow from the extreme P.

`solve_graph_by_rigid_law` returns velocities of bodies. The module needs `rigid.laws` for the names of laws. It is
called by the command `solve` and by users.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import scipy  # pyright: ignore[reportMissingTypeStubs]
from numpy.typing import ArrayLike

from impact_xval.compliant_baselines.rigid.laws import LAWS, ROUNDING, TooManyImpactsError
from impact_xval.model.arrays import Booleans, Floats
from impact_xval.model.graph.collision_outcome import GraphCollisionOutcome
from impact_xval.model.graph.solving import checked_graph

if TYPE_CHECKING:
    from impact_xval.model.graph.collision import GraphCollision

#: SciPy loads `scipy.optimize` at its first use. Commands that solve no graph do without the 0.2 s that this takes.
_scipy: Any = scipy

#: Names of the laws on graphs: those of balls in a line, but with one sequential law for all orders of contacts.
GRAPH_LAWS = (*(name for name in LAWS if not name.startswith("sequential")), "sequential")

#: Laws whose final rates depend on how the impulses of compression are distributed over contacts.
_DEPENDS_ON_SPLIT = ("poisson-restitution", "plastic-then-restitution")

#: Largest number of impacts. A graph that needs more is given up.
MOST_IMPACTS = 100_000

#: Fraction of the largest rate or impulse that is taken for rounding in a least-squares problem.
_TINY = 1e-10


class RigidGraphOutcome(NamedTuple):
    """Result of a rigid law for one contact graph."""

    #: Name of the law, with the order of contacts if the law depends on it.
    law: str
    #: Total impulses in N s and final rates of compression in m/s, shape (C,).
    impulses: Floats
    rates: Floats
    #: Number of impacts.
    impacts: int
    #: Largest range of the impulse of compression of a single contact in the first impact, in N s; 0 if the impulses
    #: are unique.
    impulse_spread: float
    #: Largest difference in m/s of final rates between extreme distributions of the impulses of compression.
    rate_spread: float


class _Impact(NamedTuple):
    """The quantities of an impact from which a law computes impulses."""

    W: Floats
    e: Floats
    #: Rates of compression before the impact.
    w: Floats
    #: Contacts in the order in which a law takes them.
    order: Sequence[int]
    #: Impulses C >= 0 of the compression of all contacts, with W C - w >= 0. They may not be unique.
    compression: Floats
    #: True for the first impact of a collision.
    is_first: bool
    #: Largest rate in m/s at the start of the collision. Rates that are rounding are small compared with it.
    scale: float

    @property
    def threshold(self) -> float:
        """Largest rate in m/s that is taken for rounding."""
        return ROUNDING * self.scale


def solve_rigid_graph(
    law: str,
    delassus: ArrayLike,
    restitutions: ArrayLike,
    rates: ArrayLike,
    *,
    order: Sequence[int] | None = None,
) -> RigidGraphOutcome:
    """Solve one contact graph by a rigid law.

    Parameters
    ----------
    law : str
        One of `GRAPH_LAWS`.
    delassus, restitutions, rates : array_like
        The same arguments as in `impact_xval.model.graph.solving.solve_graph`.
    order : sequence of int, optional
        Numbers of all contacts, from 1, in the order in which a sequential law takes them; by default ascending.

    Returns
    -------
    RigidGraphOutcome

    Raises
    ------
    ValueError
        For an illegal value, or restitutions with which the law has no solution.
    TooManyImpactsError
        If contacts still approach after `MOST_IMPACTS` impacts.
    """
    if law not in GRAPH_LAWS:
        raise ValueError(f"law = {law!r}; legal: {', '.join(GRAPH_LAWS)}")
    e = np.asarray(restitutions, float)
    W, e, w = checked_graph(np.asarray(delassus, float), e, np.asarray(rates, float))
    contacts = range(1, len(w) + 1)
    numbers = list(contacts) if order is None else list(order)
    if sorted(numbers) != list(contacts):
        raise ValueError(f"order = {order!r}; legal: the numbers from 1 to {len(w)}, each once")
    if law == "generalised-reflection" and len(set(e.tolist())) > 1:
        raise ValueError(f"restitutions = {e.tolist()}: {law} has one e for all contacts")
    places = [number - 1 for number in numbers]
    compression = complementary(W, -w, float(np.abs(w).max()))
    splits = _extreme_splits(W, w, compression)
    impulses, impacts = _follow(law, W, e, w, places, compression)
    final_rates = [w - W @ impulses]
    if law in _DEPENDS_ON_SPLIT:
        final_rates += [w - W @ _follow(law, W, e, w, places, split)[0] for split in splits]
    rate_spread = float(np.ptp(np.array(final_rates), axis=0).max())
    spread = np.ptp(np.array([compression, *splits]), axis=0).max()
    is_ordered = law in ("sequential", "plastic-then-restitution")
    name = f"{law} ({', '.join(map(str, numbers))})" if is_ordered else law
    threshold = _TINY * float(np.abs(w).max())
    return RigidGraphOutcome(
        name,
        impulses,
        final_rates[0],
        impacts,
        0.0 if law == "sequential" else float(spread),
        rate_spread if rate_spread > threshold else 0.0,
    )


def solve_graph_by_rigid_law(law: str, collision: GraphCollision) -> GraphCollisionOutcome:
    """Solve one contact graph by one of the laws for balls in a line.

    Parameters
    ----------
    law : str
        One of `rigid.laws.LAWS`. On a graph ``sequential-top`` takes contacts in ascending order, and
        ``sequential-bottom`` in descending order.
    collision : GraphCollision
        The contact graph.

    Returns
    -------
    GraphCollisionOutcome
        The outcome. Its diagnostics are ``impacts``, ``impulse_spread`` in N s and ``rate_spread`` in m/s. Its status
        is ``unrepresentable`` if the law has no solution, and ``timeout`` after `MOST_IMPACTS` impacts.
    """
    if law not in LAWS:
        raise ValueError(f"law = {law!r}; legal: {', '.join(LAWS)}")
    numbers = range(1, len(collision.contacts) + 1)
    order = list(reversed(numbers)) if law == "sequential-bottom" else list(numbers)
    name = "sequential" if law.startswith("sequential") else law
    e = [contact.restitution for contact in collision.contacts]
    try:
        found = solve_rigid_graph(name, collision.delassus, e, collision.rates, order=order)
    except TooManyImpactsError as error:
        return GraphCollisionOutcome.failure(law, collision, "timeout", str(error))
    except ValueError as error:
        return GraphCollisionOutcome.failure(law, collision, "unrepresentable", str(error))
    velocities, turning = collision.after(found.impulses.tolist())
    return GraphCollisionOutcome(
        law,
        tuple(tuple(row) for row in velocities.tolist()),
        tuple(tuple(row) for row in turning.tolist()) if len(collision.inertias) else (),
        diagnostics={
            "impacts": float(found.impacts),
            "impulse_spread": found.impulse_spread,
            "rate_spread": found.rate_spread,
        },
    )


class _NotInRangeError(ValueError):
    """The q of a complementarity problem is not in the range of its W."""


def complementary(W: Floats, q: Floats, scale: float) -> Floats:
    """Return P with 0 <= P, q + W P >= 0, P . (q + W P) = 0, for a positive semidefinite W and a q in its range.

    q is a sum whose terms are about as large as `scale`, so its rounding errors are small compared with `scale`.
    """
    values, vectors = np.linalg.eigh(W)
    is_kept = values > 1e-13 * values[-1]
    L: Floats = vectors[:, is_kept] * np.sqrt(values[is_kept])
    c: Floats = (vectors[:, is_kept].T @ q) / np.sqrt(values[is_kept])
    if np.abs(L @ c - q).max() > 1e-9 * np.abs(q).max() + 1e-12 * scale:
        raise _NotInRangeError("q is not in the range of W")
    impulses: Floats = _scipy.optimize.nnls(L.T, -c)[0]
    return impulses


def _extreme_splits(W: Floats, w: Floats, compression: Floats) -> list[Floats]:
    """Return impulses C with the same W C as `compression` in which one contact has its least or largest impulse."""
    contacts = len(w)
    if np.linalg.matrix_rank(W, hermitian=True) == contacts:
        return []
    slack, scale = W @ compression - w, np.abs(w).max()
    bounds = [(0, None if slack[i] <= _TINY * scale else 0) for i in range(contacts)]
    splits: list[Floats] = []
    for i in range(contacts):
        for sign in (1.0, -1.0):
            solution = _scipy.optimize.linprog(
                sign * np.eye(contacts)[i], A_eq=W, b_eq=W @ compression, bounds=bounds
            )
            if solution.status == 0:
                splits.append(np.asarray(solution.x, float))
    is_other = [np.abs(split - compression).max() > 1e-7 * np.abs(compression).max() for split in splits]
    return [split for split, other in zip(splits, is_other, strict=True) if other]


def _follow(
    law: str, W: Floats, e: Floats, w: Floats, order: Sequence[int], compression: Floats
) -> tuple[Floats, int]:
    """Apply impacts until no contact approaches, and return the total impulses and the number of impacts."""
    total, rates, scale = np.zeros(len(w)), w, float(np.abs(w).max())
    threshold = ROUNDING * scale
    for impact in range(MOST_IMPACTS):
        if not (rates > threshold).any():
            return total, impact
        split = compression if impact == 0 else np.empty(0)
        if impact > 0 and law in _DEPENDS_ON_SPLIT:
            split = complementary(W, -rates, scale)
        total = total + _LAWS[law](_Impact(W, e, rates, order, split, impact == 0, scale))
        rates = w - W @ total
        rates[np.abs(rates) <= threshold] = 0.0
    raise TooManyImpactsError(f"not over after {MOST_IMPACTS} impacts")


def _newton(impact: _Impact) -> Floats:
    try:
        return complementary(impact.W, -(1 + impact.e) * impact.w, impact.scale)
    except _NotInRangeError as error:
        raise ValueError(
            "restitutions: unequal ones with a singular W, where Newton's law need not have a solution; legal: one e"
        ) from error


def _poisson(impact: _Impact) -> Floats:
    back = (1 + impact.e) * impact.compression
    return back + complementary(impact.W, impact.W @ back - impact.w, impact.scale)


def _reflections(impact: _Impact) -> Floats:
    """Return the impulses (1 - e) times the plastic impulses, plus e times the elastic impulses.

    For the elastic impulses all approaching contacts are reflected, again and again, until no contact approaches.
    """
    elastic, rates = np.zeros(len(impact.w)), impact.w
    while True:
        approaching: Booleans = rates > impact.threshold
        if not approaching.any():
            break
        part = np.ix_(approaching, approaching)
        elastic[approaching] += 2 * complementary(impact.W[part], -rates[approaching], impact.scale)
        rates = impact.w - impact.W @ elastic
    e = float(impact.e[0])
    return (1 - e) * complementary(impact.W, -impact.w, impact.scale) + e * elastic


def _plastic_then_restitution(impact: _Impact) -> Floats:
    impulses, e = impact.compression.copy(), impact.e
    if not impact.is_first:
        e = np.where(e < 1, 0.0, e)
    for i in impact.order:
        if impact.w[i] > 0:
            excess = impact.w[i] - impact.W[i] @ impulses + e[i] * impact.w[i]
            impulses[i] = max(impulses[i] + excess / impact.W[i, i], 0.0)
    return impulses


def _sequential(impact: _Impact) -> Floats:
    impulses = np.zeros(len(impact.w))
    i = next(i for i in impact.order if impact.w[i] > impact.threshold)
    impulses[i] = (1 + impact.e[i]) * impact.w[i] / impact.W[i, i]
    return impulses


_LAWS: dict[str, Callable[[_Impact], Floats]] = {
    "newton-restitution": _newton,
    "poisson-restitution": _poisson,
    "generalised-reflection": _reflections,
    "plastic-then-restitution": _plastic_then_restitution,
    "sequential": _sequential,
}
