"""`solve`: one collision by the state transition model, with its path and events; `solve_batch`: arrays of them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit, prange
from numpy.typing import ArrayLike, NDArray

from impact_xval.model.collision import STATES, Collision, Outcome
from impact_xval.model.compiled import OPTIONS
from impact_xval.model.curve import trace
from impact_xval.model.inputs import (
    GRAZING_THRESHOLD,
    LEGAL_CUTOFF,
    MASS_PRECISION,
    Cutoff,
    beyond_precision,
    broadcast_inputs,
    legal_cutoff,
)
from impact_xval.model.pair.events import MOST_WINDOWS
from impact_xval.model.pair.grazing import MARKS, mark_codes
from impact_xval.model.pair.kernel import (
    BEYOND_PRECISION,
    COLLAPSE,
    DONE,
    EXACT,
    LIMIT,
    LOG_WIDTH,
    PRECISION_LIMIT,
    STATUS_OF,
    TOO_MANY_EVENTS,
    collide,
)
from impact_xval.model.pair.law import IMPACT_LAWS, ImpactLaw
from impact_xval.model.pair.limits import BOUND

NAME = "state-transition"

#: Events after which a collision is given up, within a second. At extreme stiffness ratios there are some 50/(1 - e) of
#: them, for e of the contact that oscillates, or as many as the modes' frequencies are apart if that is fewer.
MAX_EVENTS = 2_000_000

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
        that off. By default the outcome is that without a cut-off, to `pair.limits.BOUND`: the closed form finishes
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
        `GRAZING_THRESHOLD` or a cut-off changed it by more than `CUTOFF_THRESHOLD` (`pair.grazing`). Its
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
    if reason := beyond_precision("m2/m1", mu):
        return Outcome.failure(NAME, STATUS_OF[BEYOND_PRECISION], reason)
    log = np.zeros((LOG_ROWS, LOG_WIDTH))
    result = collide(kappa, mu, collision.e1, collision.e2, cutoff, max_events, law, log)
    n_rows = result[5] + 1
    if n_rows > LOG_ROWS:
        log = np.zeros((n_rows, LOG_WIDTH))
        result = collide(kappa, mu, collision.e1, collision.e2, cutoff, max_events, law, log)
    v1, v2, code, _, n_events, _, margin, loss, _ = result
    if code == TOO_MANY_EVENTS:
        most = f"{max_events} events, or {MOST_WINDOWS} windows of the search for them"
        return Outcome.failure(NAME, STATUS_OF[code], f"not over after {most}")
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


def nearest_jump(margin: Any, law: ImpactLaw) -> Any:
    """Grazing margin, or infinity under a law that has no jumps: a restart that takes back the loss leaves none."""
    return margin if law.stiffens else np.full_like(margin, np.inf)


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


def check_law(name: str, parameter: str = "impact_law") -> ImpactLaw:
    """Return the law of that name, given as that parameter.

    Raises
    ------
    ValueError
        If there is none.
    """
    if name not in IMPACT_LAWS:
        raise ValueError(f"{parameter} = {name!r}; legal: {', '.join(IMPACT_LAWS)}")
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


@dataclass(frozen=True, slots=True, eq=False)
class BatchOutcome:
    r"""What `solve_batch` says: arrays of the shape the inputs broadcast to.

    Attributes
    ----------
    v1, v2 : ndarray of float
        Final velocities per \|v0\|; NaN where `status` is ``unconverged`` or ``unrepresentable``.
    code : ndarray of uint8
        How each collision ended, as `pair.kernel` counts it; `status` names it.
    n_states, n_events : ndarray of int32
        Length of the state sequence (S4 included) and number of events.
    grazing_margin : ndarray of float
        As in `Outcome`.
    energy_residual : ndarray of float
        Residual of the energy balance per m1 v0^2.
    cutoff_effect : ndarray of float, or None
        As in `model.solve`, NaN where the collision without a cut-off is not over after `max_events`; None unless asked
        for, or needed to mark results, as with any finite cut-off.
    mark : ndarray of uint8
        Which results are marked, as `pair.grazing` counts it; `marked` says it in words.
    """

    v1: NDArray[np.float64]
    v2: NDArray[np.float64]
    code: NDArray[np.uint8]
    n_states: NDArray[np.int32]
    n_events: NDArray[np.int32]
    grazing_margin: NDArray[np.float64]
    energy_residual: NDArray[np.float64]
    cutoff_effect: NDArray[np.float64] | None
    mark: NDArray[np.uint8]

    @property
    def status(self) -> NDArray[np.str_]:
        """As in `Outcome`; made when asked for, for it takes more room than all the rest."""
        return np.array(STATUS_OF)[self.code]

    @property
    def marked(self) -> NDArray[np.object_]:
        """As in `Outcome`: a sentence, or the empty text."""
        return np.array(MARKS, dtype=object)[self.mark]


def solve_batch(
    stiffness_ratio: ArrayLike,
    mass_ratio: ArrayLike,
    e1: ArrayLike,
    e2: ArrayLike,
    *,
    stiffness_ratio_cutoff: Cutoff = "exact",
    max_events: int = MAX_EVENTS,
    impact_law: str = "jia-mason-erdmann",
    cutoff_effect: bool = False,
) -> BatchOutcome:
    """Solve many collisions at once.

    Parameters
    ----------
    stiffness_ratio, mass_ratio, e1, e2 : array_like
        k2/k1 from 0 to infinity, m2/m1 > 0 and finite, e_i from 0 to 1; they broadcast.
    stiffness_ratio_cutoff, max_events, impact_law
        As for `solve`.
    cutoff_effect : bool
        Whether to say what the cut-off changes, by solving once more those that used it; with a finite cut-off it is
        said in any case.

    Returns
    -------
    BatchOutcome

    Raises
    ------
    ValueError
        If any value is illegal; the message names the parameter, the first such value and the legal range.
    """
    cutoff, law = check_cutoff(stiffness_ratio_cutoff), check_law(impact_law)
    shape, flat = broadcast_inputs(stiffness_ratio, mass_ratio, e1, e2)
    v1, v2, code, n_states, n_events, margin, residual = _solve_all(*flat, cutoff, max_events, law)  # pyright: ignore
    effect = None
    if cutoff_effect or 1 < cutoff < math.inf:
        effect = np.zeros(v1.shape)
        used = np.flatnonzero(code == LIMIT)
        cells = [a[used] for a in flat]
        u1, u2, *_ = _solve_all(*cells, beyond(cutoff), max_events, law)  # pyright: ignore
        effect[used] = np.hypot(u1 - v1[used], np.sqrt(cells[1]) * (u2 - v2[used]))
    mark = mark_codes(nearest_jump(margin, law), 0.0 if effect is None or cutoff == EXACT else effect)
    return BatchOutcome(
        v1=v1.reshape(shape),
        v2=v2.reshape(shape),
        code=code.reshape(shape),
        n_states=n_states.reshape(shape),
        n_events=n_events.reshape(shape),
        grazing_margin=margin.reshape(shape),
        energy_residual=residual.reshape(shape),
        cutoff_effect=None if effect is None else effect.reshape(shape),
        mark=mark.reshape(shape),
    )


@njit(parallel=True, **OPTIONS)
def _solve_all(kappa, mu, e1, e2, cutoff, max_events, law):
    n = kappa.size
    v1, v2 = np.empty(n), np.empty(n)
    code, n_states, n_events = np.empty(n, np.uint8), np.empty(n, np.int32), np.empty(n, np.int32)
    margin, residual = np.empty(n), np.empty(n)
    no_log = np.empty((0, LOG_WIDTH))
    for i in prange(n):
        if not 1 / MASS_PRECISION <= mu[i] <= MASS_PRECISION:
            v1[i], v2[i], residual[i] = np.nan, np.nan, np.nan
            code[i], n_states[i], n_events[i], margin[i] = BEYOND_PRECISION, 0, 0, np.nan
            continue
        u1, u2, c, states, events, _, nearest, loss, _ = collide(
            kappa[i], mu[i], e1[i], e2[i], cutoff, max_events, law, no_log
        )
        if c == TOO_MANY_EVENTS:
            u1, u2 = np.nan, np.nan
        v1[i], v2[i], code[i], n_states[i], n_events[i], margin[i] = u1, u2, c, states, events, nearest
        residual[i] = 0.5 - loss - 0.5 * (u1 * u1 + mu[i] * u2 * u2)
    return v1, v2, code, n_states, n_events, margin, residual
