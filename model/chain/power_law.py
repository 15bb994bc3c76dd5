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
from typing import Any

import numpy as np
import scipy

from impact_xval.model.chain.laws import FORCE, GAP, before_cut, carries, force, has_dashpot
from impact_xval.model.chain.series import ORDER
from impact_xval.model.chain.state import tangent
from impact_xval.model.compiled import uncounted
from impact_xval.model.pair.law import INACTIVE

# The tables of scipy.integrate.DOP853, from their own file: to import that package takes a quarter of a second.
_tables = run_path(str(Path(scipy.__file__).parent / "integrate/_ivp/dop853_coefficients.py"))
A, B, E3, E5 = (np.ascontiguousarray(_tables[name]) for name in ("A", "B", "E3", "E5"))
STAGES = B.size

#: Degree of the polynomials through the ends of a step.
ORDER_OF_STEP = 5

#: Error of a step: of a velocity per that of the impact, of a deformation per the one that would hold all the energy.
TOLERANCE = 1e-14

#: Most steps to the time of an event between whose ends a sign changes: halvings alone would do.
MOST_REFINEMENTS = 60

#: Most of Newton's steps, and the largest one as a share of the step, while no change of sign is known.
REFINEMENTS, LARGEST = 8, 0.05

#: Last of Newton's steps, as a share of the step of the method: where it stops, and what rounding may leave.
CONVERGED, RESOLVED = 1e-15, 1e-6


#: Working numbers of a contact in a piece; made once.
WORK = np.dtype(
    [
        # Coefficients of w and delta in x = t/h, a piece of length h, and of what is watched.
        *((name, "f8", ORDER + 1) for name in ("rates", "deltas", "watched")),
        # Stiffness and damping if it acts, else 0; 1 if delta changes, else 0; rate or its slope at a point of a path.
        *((name, "f8") for name in ("k", "b", "moves", "value")),
        # Derivatives of w and delta at the stages of a step; the state at its start, and w''.
        *((name, "f8", STAGES + 1) for name in ("kw", "kd")),
        *((name, "f8") for name in ("w", "delta", "jerk")),
        # What is not looked at, as bits, since it was seen not to happen in this piece.
        ("left_out", "i8"),
        # Whether its force is zero by an event of this instant; whether this contact of the collision acts, and whether
        # it did where that was last written.
        *((name, "?") for name in ("cut", "acts", "acted")),
    ],
    align=True,
)


def new_workspace(contacts: int) -> Any:
    """Make the workspace of a chain, a record a contact."""
    return np.zeros(contacts, WORK).view(np.recarray)


@uncounted
def slopes(c, n, stage, work):
    """Write the derivatives of the state that `c` holds."""
    above, middle, below = 0.0, 0.0, 0.0
    for i in range(-1, n):
        above, middle, below = middle, below, force(c[i + 1])
        if i >= 0:
            one, own = c[i], work[i]
            own.kw[stage] = one.a * (above - middle) + c[i + 1].a * (below - middle)
            own.kd[stage] = 0.0 if one.frozen and one.phase == INACTIVE else one.w


@uncounted
def to_stage(c, n, stage, h, work):
    """Carry the state of `work` into `c`, as far as a stage of a step of length h goes; the last one to its end."""
    weights = A[stage] if stage < STAGES else B
    for i in range(n):
        own, w, delta = work[i], 0.0, 0.0
        for j in range(min(stage, STAGES)):
            w += weights[j] * own.kw[j]
            delta += weights[j] * own.kd[j]
        c[i].w, c[i].delta = own.w + h * w, own.delta + h * delta


@uncounted
def error_of_step(c, n, h, work):
    """Estimate the error of a step of length h from the derivatives at its stages; as of `TOLERANCE`.

    A deformation is measured by its contact's length at the running stiffness while that acts, else at the original
    one: the gap of a contact that has become far stiffer is rounded coarsely in the length that it would now have.
    """
    fifth, third = 0.0, 0.0
    for i in range(n):
        one, own, w5, w3, d5, d3 = c[i], work[i], 0.0, 0.0, 0.0, 0.0
        for j in range(STAGES + 1):
            w5 += E5[j] * own.kw[j]
            w3 += E3[j] * own.kw[j]
            d5 += E5[j] * own.kd[j]
            d3 += E3[j] * own.kd[j]
        length = one.length
        if carries(one):
            length *= (one.original / one.k) ** (1 / (one.p + 1))
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
def jerk(c, i):
    """Return w'' of contact i, without dashpots."""
    above = tangent(c[i - 1]) * c[i - 1].w if carries(c[i - 1]) else 0.0
    own = tangent(c[i]) * c[i].w if carries(c[i]) else 0.0
    below = tangent(c[i + 1]) * c[i + 1].w if carries(c[i + 1]) else 0.0
    return c[i].a * (above - own) + c[i + 1].a * (below - own)


@uncounted
def cubic(out, f0, d0, f1, d1):
    """Write the polynomial in x with values f and slopes d at 0 and at 1."""
    out[0], out[1], out[2], out[3] = f0, d0, 3 * (f1 - f0) - 2 * d0 - d1, 2 * (f0 - f1) + d0 + d1
    out[4], out[5] = 0.0, 0.0


@uncounted
def quintic(out, f0, d0, s0, f1, d1, s1):
    """Write the polynomial in x with values f, slopes d and second derivatives s at 0 and at 1."""
    r0, r1, r2 = f1 - f0 - d0 - 0.5 * s0, d1 - d0 - s0, 0.5 * (s1 - s0)
    out[0], out[1], out[2] = f0, d0, 0.5 * s0
    out[3], out[4], out[5] = 10 * r0 - 4 * r1 + r2, -15 * r0 + 7 * r1 - 2 * r2, 6 * r0 - 3 * r1 + r2


@uncounted
def advance(c, n, h, tolerance, work):
    """Make one step as long as its error allows, h at first; the step made, and the one to try next.

    The state after it is in `c`. The step is 0 where none is short enough: a slope lies beyond double precision.
    """
    for i in range(n):
        own = work[i]
        own.w, own.delta, own.jerk = c[i].w, c[i].delta, jerk(c, i)
    factor = 4.0
    while h > 0:
        error = step(c, n, h, work) / tolerance
        factor = min(4.0, 0.9 * error**-0.125) if error > 0 else 4.0
        if error <= 1:
            break
        h *= max(0.1, factor)
    through_ends(c, n, h, work)
    return h, h * factor


@uncounted
def through_ends(c, n, h, work):
    """Write the coefficients in x = t/h of polynomials through the ends of a step of length h; `c` is at its end."""
    for i in range(n):
        one, own = c[i], work[i]
        w0, w1 = h * own.kw[0], h * own.kw[STAGES]
        if has_dashpot(one):
            cubic(own.rates, own.w, w0, one.w, w1)
        else:
            quintic(own.rates, own.w, w0, h * h * own.jerk, one.w, w1, h * h * jerk(c, i))
        if one.frozen and one.phase == INACTIVE:
            cubic(own.deltas, 0.0, 0.0, 0.0, 0.0)
        else:
            quintic(own.deltas, own.delta, h * own.w, h * w0, one.delta, h * one.w, h * w1)


@uncounted
def watch_force(one, h, own):
    """Write the polynomial of the force of a dashpot before it is cut off."""
    f0, d0 = before_cut(one, own.delta, own.w, own.kw[0])
    f1, d1 = before_cut(one, one.delta, one.w, own.kw[STAGES])
    cubic(own.watched, f0, h * d0, f1, h * d1)


@uncounted
def watched_value(one, own, what):
    """Give what is watched of a contact in the state that it is in, and its slope, after a step to there."""
    if what == GAP:
        return one.delta, one.w
    if what == FORCE:
        return before_cut(one, one.delta, one.w, own.kw[STAGES])
    return one.w, own.kw[STAGES]


@uncounted
def settle(c, n, h, x, i, what, sign, work):
    """Repeat the step of length h, which `c` is after, up to the event near x h: zero of what is watched of contact i.

    The time, per h, and the state then in `c`; and whether it happens: the polynomial may have a root where the motion
    has none. Newton's iteration stays within the part of the step in which what is watched changes its sign, and halves
    that part where it would leave it: the force of a weak dashpot bends so sharply next to its end that a step of
    Newton's from beyond that is of no use.
    """
    one, own, low, high = c[i], work[i], 0.0, 1.0
    value, _ = watched_value(one, own, what)
    changes, refinements = sign * value <= 0, 0
    while True:
        step(c, n, x * h, work)
        value, rise = watched_value(one, own, what)
        change = -value / (rise * h) if rise != 0 else 0.0
        if sign * value > 0:
            low = x
        else:
            high, changes = x, True
        if not changes:
            after = max(0.0, x + max(-LARGEST, min(change, LARGEST)))
        elif value == 0 or low < x + change < high:
            after = x + change
        else:
            after = 0.5 * (low + high)
        if abs(after - x) <= CONVERGED or refinements == (MOST_REFINEMENTS if changes else REFINEMENTS):
            # What only leaves zero has no event there.
            reached = sign * value < 0 or (value == 0 and sign * rise <= 0)
            return x, reached or (sign * rise < 0 and abs(change) <= RESOLVED)
        x, refinements = after, refinements + 1
