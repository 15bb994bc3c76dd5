"""Motion of a column with positions while the same contacts carry force: a power series, or steps of DOP853.

Contact i has the penetration delta_i, delta_i' = w_i, negative across a gap, and while it carries force

    bistiffness       F = k delta^p
    Kelvin-Voigt      F = k delta^p + c delta^((p - 1)/2) delta'
    Hunt-Crossley     F = k delta^p (1 + a delta')
    dashpot in        as Kelvin-Voigt while delta' > 0,
    compression       F = k delta^p while not

For p = 1 all but Hunt-Crossley are linear: their power series is summed as that of the model (`model.columns.series`),
over a time of `ANGLE` over omega + gamma, the bounds of the frequencies and of the rates of decay: the norm of
`references.taylor`, so that the remainder is below a rounding. All others take steps of the method of order 8 of
Hairer, Norsett and Wanner, whose cubics and quintics through their ends find the first event; the step is then repeated
up to it, with Newton's iteration on its time.

A column under way is a `Chain` of the model, whose `delta` here is that of every contact and whose `phase` says which
carry force; with it go the law, and the array `b` of c or a.
"""

from __future__ import annotations

from math import inf, sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from impact_xval.compliant_baselines.references.contact_law import (
    COMPRESSION_DASHPOT,
    FORCE,
    GAP,
    HUNT_CROSSLEY,
    KELVIN_VOIGT,
)
from impact_xval.model.columns.chain import power_force
from impact_xval.model.columns.power_law import (
    CONVERGED,
    LARGEST,
    REFINEMENTS,
    STAGES,
    error_of_step,
    quintic,
    to_stage,
)
from impact_xval.model.columns.series import ANGLE, ORDER, largest
from impact_xval.model.compiled import compiled, inlined
from impact_xval.model.law import COMPRESSION, INACTIVE

#: Last step of Newton's iteration, as a share of the step, that rounding may leave.
RESOLVED = 1e-6

#: Degree of the polynomials through the ends of a step.
ORDER_OF_STEP = 5


class Workspace(NamedTuple):
    """Arrays of a column, made once.

    Attributes
    ----------
    rates, deltas : ndarray, shape (ORDER + 1, C)
        Coefficients in x = t/h, a piece of length h.
    watched : ndarray, shape (ORDER + 1,)
        Coefficients of what is watched of one contact.
    kw, kd : ndarray, shape (STAGES + 1, C)
        Derivatives of w and delta at the stages of a step.
    w, delta : ndarray, shape (C,)
        State at the start of a step.
    """

    rates: NDArray[np.float64]
    deltas: NDArray[np.float64]
    watched: NDArray[np.float64]
    kw: NDArray[np.float64]
    kd: NDArray[np.float64]
    w: NDArray[np.float64]
    delta: NDArray[np.float64]


@compiled
def new_workspace(n):
    """Workspace of n contacts."""
    many, stages = (ORDER + 1, n), (STAGES + 1, n)
    return Workspace(
        np.zeros(many),
        np.zeros(many),
        np.zeros(ORDER + 1),
        np.empty(stages),
        np.empty(stages),
        np.empty(n),
        np.empty(n),
    )


@inlined
def is_linear(law, c):
    """Whether the forces of a column are linear."""
    return c.p == 1 and law != HUNT_CROSSLEY


@inlined
def push(law, c, b, i):
    """Force of contact i; 0 of one that carries none."""
    if c.phase[i] == INACTIVE:
        return 0.0
    spring = power_force(c.k[i], c.delta[i], c.p)
    if law == KELVIN_VOIGT or (law == COMPRESSION_DASHPOT and c.phase[i] == COMPRESSION):
        return spring + b[i] * c.w[i] * max(c.delta[i], 0.0) ** (0.5 * (c.p - 1))
    if law == HUNT_CROSSLEY:
        return spring * (1 + b[i] * c.w[i])
    return spring


@inlined
def _term(c, b, work, order, i, n):
    """Coefficient of the force of contact i, linear; 0 beyond the end of the column."""
    if i >= n or c.phase[i] == INACTIVE:
        return 0.0
    damping = b[i] if c.phase[i] == COMPRESSION else 0.0  # as Kelvin-Voigt's are, as long as they act
    return c.k[i] * work.deltas[order, i] + damping * work.rates[order, i]


@compiled
def expand(c, b, n, work):
    """Write the coefficients of all w and delta of linear contacts; the time they hold for."""
    h = ANGLE / (sqrt(largest(c, n, c.k)) + largest(c, n, b))
    for i in range(n):
        work.rates[0, i], work.deltas[0, i] = c.w[i], c.delta[i]
    for order in range(ORDER):
        share = h / (order + 1)
        above, own, below = 0.0, 0.0, _term(c, b, work, order, 0, n)
        for i in range(n):
            above, own, below = own, below, _term(c, b, work, order, i + 1, n)
            work.rates[order + 1, i] = share * (c.a[i] * (above - own) + c.a[i + 1] * (below - own))
            work.deltas[order + 1, i] = share * work.rates[order, i]
    return h


@compiled
def _slopes(law, c, b, n, stage, work):
    """Write the derivatives of the state that `c` holds."""
    above, own, below = 0.0, 0.0, push(law, c, b, 0)
    for i in range(n):
        above, own = own, below
        below = push(law, c, b, i + 1) if i + 1 < n else 0.0
        work.kw[stage, i] = c.a[i] * (above - own) + c.a[i + 1] * (below - own)
        work.kd[stage, i] = c.w[i]


@compiled
def step(law, c, b, n, h, work):
    """Carry the state of `work` over a time h into `c`; the estimated error."""
    for stage in range(STAGES + 1):
        to_stage(c, n, stage, h, work)
        _slopes(law, c, b, n, stage, work)
    return error_of_step(c, n, h, work)


@inlined
def cubic(out, f0, d0, f1, d1):
    """Write the polynomial in x with values f and slopes d at 0 and at 1."""
    out[0], out[1], out[2], out[3] = f0, d0, 3 * (f1 - f0) - 2 * d0 - d1, 2 * (f0 - f1) + d0 + d1
    out[4], out[5] = 0.0, 0.0


@compiled
def advance(law, c, b, n, h, tolerance, work):
    """Make one step as long as its error allows, h at first; the step made, 0 if none is short enough, and the next."""
    for i in range(n):
        work.w[i], work.delta[i] = c.w[i], c.delta[i]
    factor = 4.0
    while h > 0:
        error = step(law, c, b, n, h, work) / tolerance
        factor = min(4.0, 0.9 * error**-0.125) if error > 0 else 4.0
        if error <= 1:
            break
        h *= max(0.1, factor)
    for i in range(n):
        w0, w1 = h * work.kw[0, i], h * work.kw[STAGES, i]
        d0, d1 = h * work.w[i], h * c.w[i]
        cubic(work.rates[:, i], work.w[i], w0, c.w[i], w1)
        quintic(work.deltas, i, work.delta[i], d0, h * w0, c.delta[i], d1, h * w1)
    return h, h * factor


@inlined
def before_cut(law, c, b, i, delta, w, dw):
    """Give what has the sign of a dashpot's force before it is cut off at zero, and its slope."""
    if law == HUNT_CROSSLEY:
        return 1 + b[i] * w, b[i] * dw
    if b[i] == 0:
        return delta, w
    q, depth = 0.5 * (c.p + 1), max(delta, 0.0)
    return c.k[i] * depth**q + b[i] * w, c.k[i] * q * depth ** (q - 1) * w + b[i] * dw


@compiled
def watch(law, c, b, i, what, h, work):
    """Write the polynomial of what is watched of contact i in a piece; its degree."""
    linear = is_linear(law, c)
    order = ORDER if linear else ORDER_OF_STEP
    out = work.watched
    if what == FORCE and linear:
        for j in range(order + 1):
            out[j] = c.k[i] * work.deltas[j, i] + b[i] * work.rates[j, i]
    elif what == FORCE:
        f0, d0 = before_cut(law, c, b, i, work.delta[i], work.w[i], work.kw[0, i])
        f1, d1 = before_cut(law, c, b, i, c.delta[i], c.w[i], work.kw[STAGES, i])
        cubic(out, f0, h * d0, f1, h * d1)
    else:
        source = work.deltas if what == GAP else work.rates
        for j in range(order + 1):
            out[j] = source[j, i]
    return order


@compiled
def settle(law, c, b, n, h, x, i, what, sign, work):
    """Repeat the step of length h up to the event near x h, where what is watched of contact i is zero.

    Returns
    -------
    x : float
        The time, per h; the state then is in `c`.
    happened : bool
        False where the polynomial has a root and the motion has none.
    """
    value, again = inf, REFINEMENTS
    while True:
        step(law, c, b, n, x * h, work)
        value, slope = c.w[i], work.kw[STAGES, i]
        if what == GAP:
            value, slope = c.delta[i], c.w[i]
        elif what == FORCE:
            value, slope = before_cut(law, c, b, i, c.delta[i], c.w[i], slope)
        change = -value / (slope * h) if slope != 0 else 0.0
        if abs(change) <= CONVERGED or again == 0:
            return x, sign * value <= 0 or (sign * slope < 0 and abs(change) <= RESOLVED)
        x, again = max(0.0, x + max(-LARGEST, min(change, LARGEST))), again - 1
