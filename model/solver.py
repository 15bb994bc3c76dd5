"""`solve`: one collision by the state transition model, with its path and events if asked for."""

from __future__ import annotations

import math

import numpy as np

from model.automaton import (
    BEYOND_PRECISION,
    COLLAPSE,
    DONE,
    LIMIT,
    LOG_WIDTH,
    MASS_PRECISION,
    ORIGINAL,
    PRECISION_LIMIT,
    STATUS_OF,
    STIFFENING,
    TOO_MANY_EVENTS,
    collide,
)
from model.collision import STATES, Collision, Outcome
from model.path import trace

NAME = "state-transition"

#: Impact laws by name (`model.automaton`).
IMPACT_LAWS = {"jia-mason-erdmann": STIFFENING, "liu-zhao-brogliato": ORIGINAL}

#: Events after which a collision is given up, half a minute. At extreme stiffness ratios there are some 50/(1 - e) of
#: them, for e of the contact that oscillates, or as many as the modes' frequencies are apart if that is fewer.
MAX_EVENTS = 100_000_000

#: The effect of the cut-off is the change of the outcome when it is raised by this factor.
CUTOFF_RAISED = 1e4

#: Rows of the first try at a log; a collision that needs more is run once more.
LOG_ROWS = 256


def solve(
    collision: Collision,
    *,
    stiffness_ratio_cutoff: float = 1e5,
    path: bool = False,
    max_events: int = MAX_EVENTS,
    impact_law: str = "jia-mason-erdmann",
) -> Outcome:
    """Solve one collision by the state transition model of Jia, Mason and Erdmann, exactly.

    Parameters
    ----------
    collision : Collision
        Every limit is legal: k2/k1 = 0 or infinity, e_i = 0, e_i = 1.
    stiffness_ratio_cutoff : float
        When the running ratio k2/k1 exceeds this, or falls below its inverse, the closed form of the limiting case
        finishes the collision (supplement, 3.4). Greater than 1; infinity switches the cut-off off.
    path : bool
        Whether the outcome carries `path` and `events`.
    max_events : int
        Events after which the collision is given up, with the status ``unconverged``.
    impact_law : str
        ``jia-mason-erdmann``, the model's own, or ``liu-zhao-brogliato``, which differs from the second compression of
        a contact on: it runs at the original stiffness.

    Returns
    -------
    Outcome
        Status ``limit`` where a closed-form limit was used, ``unconverged`` after `max_events`, ``unrepresentable``
        where m2/m1 or its inverse exceeds `MASS_PRECISION`, else ``ok``. Its ``diagnostics``: ``energy_residual``, of
        the energy balance per m1 v0^2, and ``cutoff_effect``, by how much (v1, v2) would change if the cut-off were
        raised by `CUTOFF_RAISED` (kinetic norm per sqrt(m1) abs(v0)); not there if with that cut-off the collision is
        not over after `max_events`.

    Raises
    ------
    ValueError
        For an illegal cut-off or an unknown law.
    """
    cutoff, law = check_cutoff(stiffness_ratio_cutoff), check_law(impact_law)
    kappa, mu = collision.stiffness_ratio, collision.mass_ratio
    if not 1 / MASS_PRECISION <= mu <= MASS_PRECISION:
        reason = f"m2/m1 = {mu:g}: beyond {1 / MASS_PRECISION:g} to {MASS_PRECISION:g} squares of velocities are lost"
        return Outcome.failure(NAME, STATUS_OF[BEYOND_PRECISION], reason)
    log = np.zeros((LOG_ROWS, LOG_WIDTH))
    result = collide(kappa, mu, collision.e1, collision.e2, cutoff, max_events, law, log)
    n_rows = result[5] + 1
    if n_rows > LOG_ROWS:
        log = np.zeros((n_rows, LOG_WIDTH))
        result = collide(kappa, mu, collision.e1, collision.e2, cutoff, max_events, law, log)
    v1, v2, code, _, n_events, _, margin, loss, _ = result
    if code == TOO_MANY_EVENTS:
        return Outcome.failure(NAME, STATUS_OF[code], f"not over after {max_events} events")
    log = log[:n_rows]
    states = log[:, 0].astype(int)
    sequence = states[np.concatenate([[True], states[1:] != states[:-1]])]
    speed = -collision.v0
    effect = {"cutoff_effect": 0.0}
    if code == LIMIT and math.isfinite(cutoff):
        u1, u2, raised, *_ = collide(
            kappa, mu, collision.e1, collision.e2, CUTOFF_RAISED * cutoff, max_events, law, log[:0]
        )
        known = raised != TOO_MANY_EVENTS
        effect = {"cutoff_effect": math.hypot(u1 - v1, math.sqrt(mu) * (u2 - v2))} if known else {}
    trail, events = trace(collision, log, law) if path else (None, ())
    return Outcome(
        solver=NAME,
        v1=v1 * speed,
        v2=v2 * speed,
        impulse1=collision.m1 * speed * (1 + v1),
        impulse2=collision.m1 * speed * (1 + v1 + mu * v2),
        states=tuple(STATES[i] for i in sequence),
        status=STATUS_OF[code],
        reason=_reason(collision, cutoff, code),
        grazing_margin=margin,
        n_events=n_events,
        diagnostics={"energy_residual": 0.5 - loss - 0.5 * (v1 * v1 + mu * v2 * v2), **effect},
        path=trail,
        events=events,
    )


def check_cutoff(cutoff: float) -> float:
    """Return the cut-off as a float.

    Raises
    ------
    ValueError
        Unless it is a number greater than 1.
    """
    try:
        number = float(cutoff)
    except (TypeError, ValueError):
        number = math.nan
    if not number > 1:
        raise ValueError(f"stiffness_ratio_cutoff = {cutoff!r}; legal: greater than 1, up to inf")
    return number


def check_law(name: str) -> int:
    """Return the law of that name.

    Raises
    ------
    ValueError
        If there is none.
    """
    if name not in IMPACT_LAWS:
        raise ValueError(f"impact_law = {name!r}; legal: {', '.join(IMPACT_LAWS)}")
    return IMPACT_LAWS[name]


def _reason(collision: Collision, cutoff: float, code: int) -> str:
    if code == DONE:
        return ""
    if code == COLLAPSE:
        return "the bodies come to rest together after infinitely many events"
    c = collision
    ratio = c.stiffness_ratio
    if ratio == 0 or math.isinf(ratio):
        return f"closed form of k2/k1 = {ratio:g}"
    if not 1 / cutoff <= ratio <= cutoff:
        return f"k2/k1 = {ratio:g} lies beyond the cut-off {cutoff:g}: closed form of the limit"
    if code == PRECISION_LIMIT:
        return "the running stiffness ratio left double precision: closed form of the limit from there on"
    plastic = [f"e{i} = 0" for i, e in ((1, c.e1), (2, c.e2)) if e == 0]
    if plastic:
        return f"closed form of {' and '.join(plastic)}"
    return f"the running stiffness ratio left the cut-off {cutoff:g}: closed form of the limit from there on"
