"""Motion under power-law contacts, F = k delta^p (Hertz: p = 1.5): steps of DOP853, for no closed form is known.

Each step of Hairer, Norsett and Wanner's method of order 8 (scipy's tables) is followed by the quintics through its
ends, which find the first event as for linear contacts. The step is then repeated up to the event, with Newton's
iteration on its time, so that the event has the order of the method. Where a force begins or ends it is not smooth, and
the error estimate shortens the steps.
"""

# scipy states no types.
# pyright: reportMissingTypeStubs=false

from __future__ import annotations

from math import inf, sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import DOP853

from impact_xval.model.columns.chain import Chain, acceleration, power_force, tangent
from impact_xval.model.compiled import Floats, Pair, compiled, inlined
from impact_xval.model.law import COMPRESSION, INACTIVE

A, B, E3, E5 = (np.ascontiguousarray(table) for table in (DOP853.A, DOP853.B, DOP853.E3, DOP853.E5))
STAGES = B.size

#: Degree of the polynomials through the ends of a step.
ORDER = 5

#: Error of a step: of a velocity per that of the impact, of a deformation per the one that would hold all the energy.
TOLERANCE = 1e-14

#: Newton's steps to the time of an event, and the largest one, as a share of the step.
REFINEMENTS, LARGEST = 8, 0.05

#: Last step, as a share of the step of the method.
CONVERGED = 1e-15


class Workspace(NamedTuple):
    """Arrays of a step, made once a column.

    Attributes
    ----------
    kw, kd : ndarray, shape (STAGES + 1, C)
        Derivatives of w and delta at the stages.
    w, delta : ndarray, shape (C,)
        State at the start of the step.
    jerk : ndarray, shape (C,)
        w'' at the start of the step.
    """

    kw: NDArray[np.float64]
    kd: NDArray[np.float64]
    w: NDArray[np.float64]
    delta: NDArray[np.float64]
    jerk: NDArray[np.float64]


@compiled
def slopes(c: Chain, n: int, stage: int, work: Workspace) -> None:
    """Write the derivatives of the state that `c` holds."""
    above, own, below = 0.0, 0.0, power_force(c.k[0], c.delta[0], c.p)
    for i in range(n):
        above, own = own, below
        below = power_force(c.k[i + 1], c.delta[i + 1], c.p) if i + 1 < n else 0.0
        work.kw[stage, i] = c.a[i] * (above - own) + c.a[i + 1] * (below - own)
        work.kd[stage, i] = c.w[i] if c.phase[i] != INACTIVE else 0.0


@compiled
def to_stage(c: Chain, n: int, stage: int, h: float, work: Workspace) -> None:
    """Carry the state of `work` into `c`, as far as a stage of a step of length h goes; the last one to its end."""
    weights = A[stage] if stage < STAGES else B
    for i in range(n):
        w, delta = 0.0, 0.0
        for j in range(min(stage, STAGES)):
            w += weights[j] * work.kw[j, i]
            delta += weights[j] * work.kd[j, i]
        c.w[i], c.delta[i] = work.w[i] + h * w, work.delta[i] + h * delta


@compiled
def error_of_step(c: Chain, n: int, h: float, work: Workspace) -> float:
    """Estimate the error of a step of length h from the derivatives at its stages; as of `TOLERANCE`."""
    fifth, third = 0.0, 0.0
    for i in range(n):
        w5, w3, d5, d3 = 0.0, 0.0, 0.0, 0.0
        for j in range(STAGES + 1):
            w5 += E5[j] * work.kw[j, i]
            w3 += E3[j] * work.kw[j, i]
            d5 += E5[j] * work.kd[j, i]
            d3 += E3[j] * work.kd[j, i]
        length = c.length[i] * (c.original[i] / c.k[i]) ** (1 / (c.p + 1))
        fifth += w5 * w5 + (d5 / length) ** 2
        third += w3 * w3 + (d3 / length) ** 2
    both = (fifth + 0.01 * third) * 2 * n
    if not both < inf:
        return inf  # a stage lies beyond double precision: the step is far too long
    return h * fifth / sqrt(both) if fifth > 0 else 0.0


@compiled
def step(c: Chain, n: int, h: float, work: Workspace) -> float:
    """Carry the state of `work` over a time h into `c`; the estimated error per tolerance."""
    for stage in range(STAGES + 1):
        to_stage(c, n, stage, h, work)
        slopes(c, n, stage, work)
    return error_of_step(c, n, h, work) / TOLERANCE


@inlined
def jerk(c: Chain, n: int, i: int) -> float:
    """Return w'' of contact i."""
    above = tangent(c, i - 1) * c.w[i - 1] if i > 0 and c.phase[i - 1] != INACTIVE else 0.0
    own = tangent(c, i) * c.w[i] if c.phase[i] != INACTIVE else 0.0
    below = tangent(c, i + 1) * c.w[i + 1] if i + 1 < n and c.phase[i + 1] != INACTIVE else 0.0
    return c.a[i] * (above - own) + c.a[i + 1] * (below - own)


@inlined
def quintic(out: Floats, i: int, f0: float, d0: float, s0: float, f1: float, d1: float, s1: float) -> None:
    """Write to column i the polynomial in x with values f, slopes d and second derivatives s at 0 and at 1."""
    r0, r1, r2 = f1 - f0 - d0 - 0.5 * s0, d1 - d0 - s0, 0.5 * (s1 - s0)
    out[0, i], out[1, i], out[2, i] = f0, d0, 0.5 * s0
    out[3, i], out[4, i], out[5, i] = 10 * r0 - 4 * r1 + r2, -15 * r0 + 7 * r1 - 2 * r2, 6 * r0 - 3 * r1 + r2


@compiled
def advance(c: Chain, n: int, h: float, work: Workspace, rates: Floats, deltas: Floats) -> Pair:
    """Make one step as long as its error allows, h at first; the step made, and the one to try next.

    The coefficients of the quintics in x = t/h through its ends are in `rates` and `deltas`, the state after it in `c`.
    The step is 0 where none is short enough: a slope lies beyond double precision.
    """
    for i in range(n):
        work.w[i], work.delta[i], work.jerk[i] = c.w[i], c.delta[i], jerk(c, n, i)
    factor = 4.0
    while h > 0:
        error = step(c, n, h, work)
        factor = min(4.0, 0.9 * error**-0.125) if error > 0 else 4.0
        if error <= 1:
            break
        h *= max(0.1, factor)
    for i in range(n):
        w0, w1 = h * work.kw[0, i], h * work.kw[STAGES, i]
        quintic(rates, i, work.w[i], w0, h * h * work.jerk[i], c.w[i], w1, h * h * jerk(c, n, i))
        if c.phase[i] != INACTIVE:
            quintic(deltas, i, work.delta[i], h * work.w[i], h * w0, c.delta[i], h * c.w[i], h * w1)
    return h, h * factor


@compiled
def settle(c: Chain, n: int, h: float, x: float, i: int, spent: bool, work: Workspace) -> tuple[float, bool]:
    """Repeat the step of length h up to the event near x h, where w_i = 0, or delta_i = 0 if it is `spent`.

    Returns
    -------
    x : float
        The time, per h; the state then is in `c`.
    happened : bool
        False where the quintic has a root and the motion has none.
    """
    sign = 1.0 if spent or c.phase[i] == COMPRESSION else -1.0
    for _ in range(REFINEMENTS):
        step(c, n, x * h, work)
        value, slope = (c.delta[i], c.w[i]) if spent else (c.w[i], acceleration(c, n, i))
        change = -value / (slope * h) if slope != 0 else 0.0
        if abs(change) <= CONVERGED:
            return x, True
        x = max(0.0, x + max(-LARGEST, min(change, LARGEST)))
    step(c, n, x * h, work)
    return x, sign * (c.delta[i] if spent else c.w[i]) <= 0
