r"""The rigid laws, each a function of G, the rates u- before the impact, and e (`rigid.row`).

**Newton's** restitution at all contacts at once (Moreau 1988, Unilateral contact and dry friction in finite freedom
dynamics, CISM 302; Pfeiffer and Glocker 1996, Multibody Dynamics with Unilateral Contacts; Glocker 2001, Set-Valued
Force Laws):

    0 <= p_i,    0 <= u_i+ + e_i min(u_i-, 0),    one of the two 0.    (1)

A contact that touches without approaching (u- = 0: the balls at rest of a cradle) takes part: it has an impulse if
without it u+ would be negative, and then u+ = 0, whatever its e. The sources have u- where (1) has min(u-, 0). There
the two are one: bodies that touch now and did not overlap before cannot have receded. A contact may recede here,
since the velocities are the user's; the sources' words would then let its bodies end up approaching, at e u-, and
overlap. So it is treated as one at rest. With u- <= 0 everywhere energy does not grow, since u_i+ p_i = -e_i u_i- p_i
and so

    T+ - T- = 1/2 sum p_i (u_i+ + u_i-) = 1/2 sum (1 - e_i) p_i u_i- <= 0;    (2)

an impulse at a receding contact adds 1/2 p_i u_i- (docs/rigid.md, section 3).

**Poisson's** (Pfeiffer and Glocker 1996): compression to no approach, then expansion with at least e_i times its
impulse,

    0 <= p_C,  0 <= u_C = u- + G p_C,  one of the two 0;    (3)
    0 <= p_E - e p_C,  0 <= u_E = u_C + G p_E,  one of the two 0.    (4)

**Sequential**: of the contacts that approach the one nearest the top (or the bottom) has a single impact, p_i = -(1 +
e_i) u_i/G_ii; then again of those that approach now, until none does. The order matters: both are offered. The
sequence may be infinite (McNamara and Young 1992, Phys. Fluids A 4:496: inelastic collapse). It then has a limit:
velocities are bounded, since energy does not grow, and so are the impulses, since they follow from velocities (W has
full column rank); they only ever grow, so they converge, the impact speeds go to 0, and with them the rates of all
contacts S that are struck infinitely often. So whatever the order, the impulses still to come are those that leave S
at rest,

    G_SS p_S = -u_S,    the others 0,    (5)

and the limit is exact from any point on. That a sequence is infinite is seen where a word of contacts has come twice.
A word is a matrix P on the rates u_S, and that its next impact is always on the contact of the word is a number of
linear conditions a u_S < 0. With u_S = sum c_k x_k in the eigenvectors of P, the first that of the largest
eigenvalue, real and from 0 to 1, the word comes for ever if a x_1 c_1 + sum |a x_k c_k| < 0 (k > 1) for all of them,
and if no contact that would come first is brought to approach by (5). After it the contacts that still approach have
their turn, also to strike balls of S anew: a word may hold such limits, each as one step. What is not seen to be
infinite ends where no contact approaches faster than `CUT` times the fastest at first; what is left changes
velocities, in the kinetic norm, by no more than twice the relative velocities within those balls. The status is
`limit` either way.

**Generalised reflection** (Smith, Kaufman, Vouga, Tamstorf and Grinspun 2012, Reflections on Simultaneous Impact, ACM
Trans. Graph. 31(4):106): the contacts V that approach are reflected together,

    u <- u + G_V 2 p,    0 <= p,  0 <= u_V + G_VV p,  one of the two 0;    (6)

then those that approach now, until none does. With restitution the impulses are e times these and 1 - e times those of
(3). So it is in the authors' own code (breannansmith/scisim, GROperator and GRROperator), which knows one e for all
contacts and refuses several, as here.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from impact_xval.compliant_baselines.rigid.complementarity import solve_lcp
from impact_xval.compliant_baselines.rigid.row import Floats

#: Rate of approach, over the fastest one before the impact, below which a contact does not approach. A few hundred
#: times what rounding leaves of a contact at rest.
CUT = 1e-13
#: Impact speed, likewise, below which a sequence that ends in approaches below `CUT` is taken for an infinite one.
_SLOW = 1e-6

#: Impacts between two looks for short words that come again, and for longer ones; and the greatest lengths of both.
_LOOKS, _WORDS = (6, 24), (4, 96)
#: Rounding in the conditions of a word, over the fastest of its rates.
_ROUNDING = 1e-12


class Phase(NamedTuple):
    """A part of an impact: impulses that belong together.

    Attributes
    ----------
    contacts : tuple of int
        Those with an impulse, from 0 on.
    impulses : tuple of float
        Theirs.
    restores : bool
        Whether they are what restitution returns, known of Poisson's law alone.
    """

    contacts: tuple[int, ...]
    impulses: tuple[float, ...]
    restores: bool = False


class Jump(NamedTuple):
    """What a law makes of an impact.

    Attributes
    ----------
    rates : ndarray, shape (C,)
        u_i after it, none negative.
    impulses : ndarray, shape (C,)
        p_i in all.
    phases : list of Phase
        In their order.
    over : bool
        Whether nothing approaches any more; False where a sequence of impacts was given up.
    infinite : bool
        Whether the sequence of impacts has no last one.
    """

    rates: Floats
    impulses: Floats
    phases: list[Phase]
    over: bool = True
    infinite: bool = False


#: A law, given G, u-, e and how many impacts a sequence may have.
Law = Callable[[Floats, Floats, Floats, int], Jump]


def newton(G: Floats, u: Floats, e: Floats, most: int) -> Jump:
    """Solve (1)."""
    least = -e * np.minimum(u, 0.0)
    p = solve_lcp(G, u - least)
    return Jump(_after(u + G @ p, p, least), p, [_phase(p)])


def poisson(G: Floats, u: Floats, e: Floats, most: int) -> Jump:
    """Solve (3), then (4)."""
    none = np.zeros_like(u)
    compression = solve_lcp(G, u)
    u = _after(u + G @ compression, compression, none)
    least = e * compression
    more = solve_lcp(G, u + G @ least)
    expansion = least + more
    u = _after(u + G @ expansion, more, none)
    phases = [_phase(compression)]
    if expansion.any():
        phases.append(_phase(expansion, restores=True))
    return Jump(u, compression + expansion, phases)


def sequential_top(G: Floats, u: Floats, e: Floats, most: int) -> Jump:
    """Strike single contacts, the topmost first."""
    return _sequence(G, u, e, most, range(len(u)))


def sequential_bottom(G: Floats, u: Floats, e: Floats, most: int) -> Jump:
    """Strike single contacts, the lowest first."""
    return _sequence(G, u, e, most, range(len(u) - 1, -1, -1))


def generalised_reflection(G: Floats, u: Floats, e: Floats, most: int) -> Jump:
    """Reflect by (6) and blend, with one e."""
    restitution = float(e[0])
    plastic = newton(G, u, np.zeros_like(u), most)
    if restitution == 0:
        return plastic
    elastic = _reflections(G, u, most)
    if restitution == 1 or not elastic.over:
        return elastic
    u, p = (restitution * a + (1 - restitution) * b for a, b in zip(elastic[:2], plastic[:2], strict=True))
    return Jump(u, p, [_phase(p)])


def _reflections(G: Floats, u: Floats, most: int) -> Jump:
    u, p, phases, slowest = u.copy(), np.zeros_like(u), [], CUT * float(-u.min())
    while (violated := np.flatnonzero(u < -slowest)).size:
        if len(phases) == most:
            return Jump(u, p, phases, over=False)
        part = np.zeros_like(u)
        part[violated] = solve_lcp(G[np.ix_(violated, violated)], 2 * u[violated])
        least = np.where(part > 0, -u, 0.0)
        u = u + G @ part
        u[part > 0] = least[part > 0]
        p += part
        phases.append(_phase(part))
    return Jump(np.maximum(u, 0.0), p, phases)


def _sequence(G: Floats, u: Floats, e: Floats, most: int, order: range) -> Jump:
    # Plain numbers: a collapse has thousands of impacts, each of which concerns three of them.
    own, shared, rates = np.diag(G).tolist(), np.diag(G, 1).tolist(), u.tolist()
    back, phases, impacts, infinite = e.tolist(), [], 0, False
    fastest = -min(rates)
    cut, slow, slowest = CUT * fastest, _SLOW * fastest, fastest
    while (i := next((i for i in order if rates[i] < -cut), None)) is not None:
        if impacts == most:
            return Jump(np.array(rates), _sum(phases, len(u)), phases, over=False)
        slowest = min(slowest, -rates[i])
        impulse = -(1 + back[i]) * rates[i] / own[i]
        rates[i] *= -back[i]
        if i > 0:
            rates[i - 1] += shared[i - 1] * impulse
        if i < len(shared):
            rates[i + 1] += shared[i] * impulse
        impacts += 1
        phases.append(Phase((i,), (impulse,)))
        look = impacts % _LOOKS[0] == 0
        longest = _WORDS[impacts % _LOOKS[1] == 0]
        while look and (word := _word(phases, longest)):
            now = np.array(rates)
            struck = sorted({contact for phase in word for contact in phase.contacts})
            rest, after = _limit(G, now, struck)
            first = order[: min(map(order.index, struck))]
            look = _comes_for_ever(G, e, now, word, struck, order) and all(after[j] >= -cut for j in first)
            if look:
                rates, infinite = after.tolist(), True
                _gather(phases, struck, rest)
    infinite |= slowest < slow and any(rate < 0 for rate in rates)
    return Jump(np.maximum(np.array(rates), 0.0), _sum(phases, len(u)), phases, infinite=infinite)


def _word(phases: list[Phase], longest: int) -> list[Phase]:
    """Give the shortest word of at least two contacts that has come twice at last; nothing if none has."""
    for n in range(2, min(len(phases) // 2, longest) + 1):
        last, before = phases[-n:], phases[-2 * n : -n]
        if all(a.contacts == b.contacts for a, b in zip(last, before, strict=True)):
            return last
    return []


def _comes_for_ever(
    G: Floats, e: Floats, u: Floats, word: list[Phase], struck: list[int], order: range
) -> bool:
    """Tell whether a word will come again and again, from the rates u after it (see the module)."""
    G, e, u, n = G[np.ix_(struck, struck)], e[struck], u[struck], len(struck)
    P, conditions = np.eye(n), []
    for phase in word:
        on = [struck.index(contact) for contact in phase.contacts]
        if len(on) == 1:
            place = order.index(phase.contacts[0])
            conditions += [-P[j] for j, contact in enumerate(struck) if order.index(contact) < place]
            conditions.append(P[on[0]])
        back = 1 + e[on] if len(on) == 1 else np.ones(len(on))
        after = (1 - back)[:, None] * P[on]
        P = P - G[:, on] @ np.linalg.solve(G[np.ix_(on, on)], back[:, None] * P[on])
        P[on] = after
    values, vectors = np.linalg.eig(P)
    by_size = np.argsort(-np.abs(values))
    largest = complex(values[by_size[0]])
    if largest.imag != 0 or not 0 <= largest.real < 1:
        return False
    try:
        parts = vectors * np.linalg.solve(vectors, u)
    except np.linalg.LinAlgError:
        return False
    terms = (np.array(conditions) @ parts)[:, by_size]
    # A contact that a word has left at rest is so but for rounding in the eigenvectors.
    none = _ROUNDING * np.abs(u).max()
    return bool((terms[:, 0].real + np.abs(terms[:, 1:]).sum(axis=1) <= none).all())


def _limit(G: Floats, u: Floats, struck: list[int]) -> tuple[Floats, Floats]:
    """Solve (5); the impulses and the rates after them."""
    p = np.zeros_like(u)
    p[struck] = np.linalg.solve(G[np.ix_(struck, struck)], -u[struck])
    after = u + G @ p
    after[struck] = 0.0
    return p, after


def _gather(phases: list[Phase], struck: list[int], rest: Floats) -> None:
    """Make one phase of the infinitely many impacts that just ended: all since another contact was last struck.

    So words in which such a sequence comes again are the same words, however many of its impacts were followed.
    """
    total = rest.copy()
    while phases and set(phases[-1].contacts) <= set(struck):
        phase = phases.pop()
        total[list(phase.contacts)] += phase.impulses
    phases.append(Phase(tuple(struck), tuple(total[struck].tolist())))


def _sum(phases: list[Phase], contacts: int) -> Floats:
    p = np.zeros(contacts)
    for phase in phases:
        p[list(phase.contacts)] += phase.impulses
    return p


def _after(u: Floats, p: Floats, least: Floats) -> Floats:
    """Rates after an impact: exactly the least they may be where there is an impulse, and nowhere less."""
    return np.where(p > 0, least, np.maximum(u, least))


def _phase(p: Floats, *, restores: bool = False) -> Phase:
    contacts = np.flatnonzero(p)
    return Phase(tuple(contacts.tolist()), tuple(p[contacts].tolist()), restores)
