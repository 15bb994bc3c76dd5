"""Motion under forces that are no power series (Hertz: p = 1.5): steps of DOP853, as no closed form is known.

Each step of Hairer, Norsett and Wanner's method of order 8 (scipy's tables) is followed by cubics and quintics through
its ends, which find the first event as for linear contacts. The step is then repeated up to the event, with Newton's
iteration on its time, so that the event has the order of the method. Where a force begins or ends it is not smooth, and
the error estimate shortens the steps.
"""

from __future__ import annotations

from math import inf, sqrt
from pathlib import Path
from runpy import run_path
from typing import NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from impact_xval.model.chain.laws import FORCE, GAP, before_cut, carries, force, has_dashpot
from impact_xval.model.chain.series import ORDER
from impact_xval.model.chain.state import tangent
from impact_xval.model.compiled import merged, uncounted
from impact_xval.model.pair.law import INACTIVE

# The tables of scipy.integrate.DOP853, from their own file: to import that package takes a quarter of a second.
_tables = run_path(str(Path(scipy.__file__).parent / "integrate/_ivp/dop853_coefficients.py"))
A, B, E3, E5 = (np.ascontiguousarray(_tables[name]) for name in ("A", "B", "E3", "E5"))
STAGES = B.size

#: Degree of the polynomials through the ends of a step.
ORDER_OF_STEP = 5

#: Error of a step: of a velocity per that of the impact, of a deformation per the one that would hold all the energy.
TOLERANCE = 1e-14

#: Newton's steps to the time of an event, and the largest one, as a share of the step.
REFINEMENTS, LARGEST = 8, 0.05

#: Last of Newton's steps, as a share of the step of the method: where it stops, and what rounding may leave.
CONVERGED, RESOLVED = 1e-15, 1e-6


class Workspace(NamedTuple):
    """Arrays of a piece, made once; without a comment of shape (C,)."""

    #: Coefficients of w and delta in x = t/h, a piece of length h, shape (C, ORDER + 1); and of what is watched, a row.
    rates: NDArray[np.float64]
    deltas: NDArray[np.float64]
    watched: NDArray[np.float64]
    #: Stiffness and damping of the contacts that act, 0 of others; whether delta changes.
    k: NDArray[np.float64]
    b: NDArray[np.float64]
    moves: NDArray[np.float64]
    #: Whose force is zero by an event of this instant.
    cut: NDArray[np.bool_]
    #: What is not looked at, since it was seen not to happen in this piece, shape (C, 4).
    left_out: NDArray[np.bool_]
    #: Derivatives of w and delta at the stages of a step, shape (STAGES + 1, C); the state at its start, and w''.
    kw: NDArray[np.float64]
    kd: NDArray[np.float64]
    w: NDArray[np.float64]
    delta: NDArray[np.float64]
    jerk: NDArray[np.float64]
    #: Rates or their slopes at a point of the path.
    values: NDArray[np.float64]
    #: Which contacts of the collision act, and which did where that was last written.
    acts: NDArray[np.bool_]
    acted: NDArray[np.bool_]


def new_workspace(n: int) -> Workspace:
    """Make the workspace of n contacts."""
    rates, deltas = np.zeros((2, n, ORDER + 1))
    k, b, moves, w, delta, jerk, values = np.zeros((7, n))
    cut, acts, acted = np.zeros((3, n), np.bool_)
    kw, kd = np.zeros((2, STAGES + 1, n))
    watched, left_out = np.zeros((1, ORDER + 1)), np.zeros((n, 4), np.bool_)
    return Workspace(
        rates, deltas, watched, k, b, moves, cut, left_out, kw, kd, w, delta, jerk, values, acts, acted
    )


@merged
def slopes(c, n, stage, work):
    """Write the derivatives of the state that `c` holds."""
    above, own, below = 0.0, 0.0, 0.0
    for i in range(-1, n):
        above, own, below = own, below, force(c, n, i + 1)
        if i >= 0:
            work.kw[stage, i] = c.a[i] * (above - own) + c.a[i + 1] * (below - own)
            work.kd[stage, i] = 0.0 if c.frozen and c.phase[i] == INACTIVE else c.w[i]


@merged
def to_stage(c, n, stage, h, work):
    """Carry the state of `work` into `c`, as far as a stage of a step of length h goes; the last one to its end."""
    weights = A[stage] if stage < STAGES else B
    for i in range(n):
        w, delta = 0.0, 0.0
        for j in range(min(stage, STAGES)):
            w += weights[j] * work.kw[j, i]
            delta += weights[j] * work.kd[j, i]
        c.w[i], c.delta[i] = work.w[i] + h * w, work.delta[i] + h * delta


@uncounted
def error_of_step(c, n, h, work):
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


@uncounted
def step(c, n, h, work):
    """Carry the state of `work` over a time h into `c`; the estimated error."""
    for stage in range(STAGES + 1):
        to_stage(c, n, stage, h, work)
        slopes(c, n, stage, work)
    return error_of_step(c, n, h, work)


@uncounted
def jerk(c, n, i):
    """Return w'' of contact i, without dashpots."""
    above = tangent(c, i - 1) * c.w[i - 1] if i > 0 and carries(c.phase[i - 1]) else 0.0
    own = tangent(c, i) * c.w[i] if carries(c.phase[i]) else 0.0
    below = tangent(c, i + 1) * c.w[i + 1] if i + 1 < n and carries(c.phase[i + 1]) else 0.0
    return c.a[i] * (above - own) + c.a[i + 1] * (below - own)


@uncounted
def cubic(out, i, f0, d0, f1, d1):
    """Write to row i the polynomial in x with values f and slopes d at 0 and at 1."""
    out[i, 0], out[i, 1], out[i, 2], out[i, 3] = f0, d0, 3 * (f1 - f0) - 2 * d0 - d1, 2 * (f0 - f1) + d0 + d1
    out[i, 4], out[i, 5] = 0.0, 0.0


@uncounted
def quintic(out, i, f0, d0, s0, f1, d1, s1):
    """Write to row i the polynomial in x with values f, slopes d and second derivatives s at 0 and at 1."""
    r0, r1, r2 = f1 - f0 - d0 - 0.5 * s0, d1 - d0 - s0, 0.5 * (s1 - s0)
    out[i, 0], out[i, 1], out[i, 2] = f0, d0, 0.5 * s0
    out[i, 3], out[i, 4], out[i, 5] = 10 * r0 - 4 * r1 + r2, -15 * r0 + 7 * r1 - 2 * r2, 6 * r0 - 3 * r1 + r2


@uncounted
def advance(c, n, h, tolerance, work):
    """Make one step as long as its error allows, h at first; the step made, and the one to try next.

    The coefficients in x = t/h of the polynomials through its ends are in `work`, the state after it in `c`. The step
    is 0 where none is short enough: a slope lies beyond double precision.
    """
    for i in range(n):
        work.w[i], work.delta[i], work.jerk[i] = c.w[i], c.delta[i], jerk(c, n, i)
    factor = 4.0
    while h > 0:
        error = step(c, n, h, work) / tolerance
        factor = min(4.0, 0.9 * error**-0.125) if error > 0 else 4.0
        if error <= 1:
            break
        h *= max(0.1, factor)
    for i in range(n):
        w0, w1 = h * work.kw[0, i], h * work.kw[STAGES, i]
        if has_dashpot(c):
            cubic(work.rates, i, work.w[i], w0, c.w[i], w1)
        else:
            quintic(work.rates, i, work.w[i], w0, h * h * work.jerk[i], c.w[i], w1, h * h * jerk(c, n, i))
        if c.frozen and c.phase[i] == INACTIVE:
            work.deltas[i, : ORDER_OF_STEP + 1] = 0.0
        else:
            quintic(work.deltas, i, work.delta[i], h * work.w[i], h * w0, c.delta[i], h * c.w[i], h * w1)
    return h, h * factor


@merged
def watch_force(c, i, h, work):
    """Write the polynomial of the force of a dashpot before it is cut off."""
    f0, d0 = before_cut(c, i, work.delta[i], work.w[i], work.kw[0, i])
    f1, d1 = before_cut(c, i, c.delta[i], c.w[i], work.kw[STAGES, i])
    cubic(work.watched, 0, f0, h * d0, f1, h * d1)


@uncounted
def settle(c, n, h, x, i, what, sign, work):
    """Repeat the step of length h up to the event near x h, where what is watched of contact i is zero.

    The time, per h, and the state then in `c`; and whether it happens: the polynomial may have a root where the motion
    has none.
    """
    again = REFINEMENTS
    while True:
        step(c, n, x * h, work)
        value, rise = c.w[i], work.kw[STAGES, i]
        if what == GAP:
            value, rise = c.delta[i], c.w[i]
        elif what == FORCE:
            value, rise = before_cut(c, i, c.delta[i], c.w[i], rise)
        change = -value / (rise * h) if rise != 0 else 0.0
        if abs(change) <= CONVERGED or again == 0:
            return x, sign * value <= 0 or (sign * rise < 0 and abs(change) <= RESOLVED)
        x, again = max(0.0, x + max(-LARGEST, min(change, LARGEST))), again - 1
