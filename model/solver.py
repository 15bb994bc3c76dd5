"""`solve`: one collision by the state transition model, with its path and events if asked for."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from impact_xval.model.automaton import (
    BEYOND_PRECISION,
    COLLAPSE,
    DONE,
    EXACT,
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
from impact_xval.model.collision import STATES, Collision, Outcome
from impact_xval.model.inputs import LEGAL_CUTOFF, Cutoff, legal_cutoff
from impact_xval.model.limits import BOUND
from impact_xval.model.marks import GRAZING_THRESHOLD, MARKS, mark_codes
from impact_xval.model.path import trace

NAME = "state-transition"

#: Impact laws by name (`model.automaton`).
IMPACT_LAWS = {"jia-mason-erdmann": STIFFENING, "liu-zhao-brogliato": ORIGINAL}

#: Events after which a collision is given up, half a minute. At extreme stiffness ratios there are some 50/(1 - e) of
#: them, for e of the contact that oscillates, or as many as the modes' frequencies are apart if that is fewer.
MAX_EVENTS = 100_000_000

#: Rows of the first try at a log; a collision that needs more is run once more.
LOG_ROWS = 256


def solve(
    collision: Collision,
    *,
    stiffness_ratio_cutoff: Cutoff = "exact",
    path: bool = False,
    max_events: int = MAX_EVENTS,
    impact_law: str = "jia-mason-erdmann",
    grazing_threshold: float = GRAZING_THRESHOLD,
) -> Outcome:
    """Solve one collision by the state transition model of Jia, Mason and Erdmann, exactly.

    Parameters
    ----------
    collision : Collision
        Every limit is legal: k2/k1 = 0 or infinity, e_i = 0, e_i = 1.
    stiffness_ratio_cutoff : float or "exact"
        A number greater than 1: when the running ratio k2/k1 exceeds it, or falls below its inverse, the closed form of
        the limiting case finishes the collision (supplement, 3.4, where it is `SUPPLEMENT_CUTOFF`). Infinity switches
        that off. By default the outcome is that without a cut-off, to `model.limits.BOUND`: the closed form finishes
        the collision once it cannot change more.
    path : bool
        Whether the outcome carries `path` and `events`.
    max_events : int
        Events after which the collision is given up, with the status ``unconverged``.
    impact_law : str
        ``jia-mason-erdmann``, the model's own, or ``liu-zhao-brogliato``, which differs from the second compression of
        a contact on: it runs at the original stiffness.
    grazing_threshold : float
        Grazing margin below which the outcome is marked.

    Returns
    -------
    Outcome
        Status ``limit`` where a closed-form limit was used, ``unconverged`` after `max_events`, ``unrepresentable``
        where m2/m1 or its inverse exceeds `MASS_PRECISION`, else ``ok``. Marked where its grazing margin is below
        `GRAZING_THRESHOLD` or a cut-off changed it by more than `CUTOFF_THRESHOLD` (`model.marks`). Its
        ``diagnostics``: ``energy_residual``, of the energy balance per m1 v0^2, and ``cutoff_effect``, by how much
        (v1, v2) differ from the outcome without a cut-off (kinetic norm per sqrt(m1) abs(v0)); not there if that is not
        reached within `max_events`.

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
    effect = 0.0
    if code == LIMIT and cutoff != math.inf:
        u1, u2, end, *_ = collide(
            kappa, mu, collision.e1, collision.e2, beyond(cutoff), max_events, law, log[:0]
        )
        effect = math.nan if end == TOO_MANY_EVENTS else math.hypot(u1 - v1, math.sqrt(mu) * (u2 - v2))
    known = {} if math.isnan(effect) else {"cutoff_effect": effect}
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
        marked=MARKS[
            int(mark_codes(nearest_jump(margin, law), 0.0 if cutoff == EXACT else effect, grazing_threshold))
        ],
        n_events=n_events,
        diagnostics={"energy_residual": 0.5 - loss - 0.5 * (v1 * v1 + mu * v2 * v2), **known},
        path=trail,
        events=events,
    )


def nearest_jump(margin: Any, law: int) -> Any:
    """Grazing margin, or infinity under a law that has no jumps: a restart that takes back the loss leaves none."""
    return margin if law == STIFFENING else np.full_like(margin, np.inf)


def check_cutoff(cutoff: Cutoff) -> float:
    """Return the cut-off as the kernel counts it.

    Raises
    ------
    ValueError
        Unless it is ``"exact"`` or a number greater than 1.
    """
    if not legal_cutoff(cutoff):
        raise ValueError(f"stiffness_ratio_cutoff = {cutoff!r}; legal: {LEGAL_CUTOFF}")
    return EXACT if cutoff == "exact" else float(cutoff)


def beyond(cutoff: float) -> float:
    """Return the cut-off to compare an outcome with: the exact rule, and none at all for an outcome by that rule."""
    return math.inf if cutoff == EXACT else EXACT


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
    if cutoff != EXACT and not 1 / cutoff <= ratio <= cutoff:
        return f"k2/k1 = {ratio:g} lies beyond the cut-off {cutoff:g}: closed form of the limit"
    if code == PRECISION_LIMIT:
        return "the running stiffness ratio left double precision: closed form of the limit from there on"
    plastic = [f"e{i} = 0" for i, e in ((1, c.e1), (2, c.e2)) if e == 0]
    if plastic:
        return f"closed form of {' and '.join(plastic)}"
    if cutoff == EXACT:
        return f"the running stiffness ratio runs away: closed form of the limit, to {BOUND:g} |v0|"
    return f"the running stiffness ratio left the cut-off {cutoff:g}: closed form of the limit from there on"
