"""`solve_batch`: the automaton over arrays, compiled and parallel."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit, prange
from numpy.typing import ArrayLike, NDArray

from impact_xval.model.automaton import (
    BEYOND_PRECISION,
    EXACT,
    LIMIT,
    LOG_WIDTH,
    MASS_PRECISION,
    STATUS_OF,
    TOO_MANY_EVENTS,
    collide,
)
from impact_xval.model.compiled import OPTIONS
from impact_xval.model.inputs import Cutoff, broadcast_inputs
from impact_xval.model.marks import MARKS, mark_codes
from impact_xval.model.solver import (
    MAX_EVENTS,
    beyond,
    check_cutoff,
    check_law,
    nearest_jump,
)

_STATUS_OF = np.array(STATUS_OF)
_MARKS = np.array(MARKS, dtype=object)


@dataclass(frozen=True, slots=True, eq=False)
class BatchOutcome:
    r"""What `solve_batch` says: arrays of the shape the inputs broadcast to.

    Attributes
    ----------
    v1, v2 : ndarray of float
        Final velocities per \|v0\|; NaN where `status` is ``unconverged`` or ``unrepresentable``.
    code : ndarray of uint8
        How each collision ended, as `model.automaton` counts it; `status` names it.
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
        Which results are marked, as `model.marks` counts it; `marked` says it in words.
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
        return _STATUS_OF[self.code]

    @property
    def marked(self) -> NDArray[np.object_]:
        """As in `Outcome`: a sentence, or the empty text."""
        return _MARKS[self.mark]


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
