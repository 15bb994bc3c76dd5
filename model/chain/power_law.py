"""Motion under power laws such as Hertz's (p = 1.5), in steps of the method DOP853: no closed form is known.

`advance` makes one step; `refine_event` repeats it up to an event. `WORK` is the workspace of a contact; the motion by
power series uses it too.

After each step, of order 8, cubics and quintics are laid through its ends, and their first event is found as for linear
contacts. The step is then repeated up to the event, with Newton's iteration on its time, so that the event has the
order of the method. A force is not smooth where it begins or ends; there the error estimate shortens the steps.

Needs `chain.dop853` for the coefficients. Used by `chain.kernel` and `chain.event`.
"""

from __future__ import annotations

from math import inf, sqrt

import numpy as np

from impact_xval.model.arrays import Records, zero_records
from impact_xval.model.chain.dop853 import E3, E5, STAGES, A, B
from impact_xval.model.chain.laws import Watched, force, force_indicator, has_dashpot, is_active
from impact_xval.model.chain.series import ORDER
from impact_xval.model.chain.state import tangent
from impact_xval.model.compiled import kernel_helper
from impact_xval.model.pair.law import Phase

#: Degree of the polynomials through the ends of a step.
ORDER_OF_STEP = 5

#: Largest error of a step. Velocities are measured per velocity of impact, deformations per deformation that would hold
#: all the energy of impact.
TOLERANCE = 1e-14

#: Largest number of iterations for the time of an event inside a bracket; halving alone would need no more.
MOST_REFINEMENTS = 60

#: Largest number of Newton's iterations while no bracket is known, and their largest change of time as a share of the
#: step.
REFINEMENTS, LONGEST = 8, 0.05

#: Changes of time as shares of the step: below the first, Newton's iteration stops; a last change below the second is
#: rounding.
CONVERGED, RESOLVED = 1e-15, 1e-6


#: Workspace of a contact, made once for all chains.
WORK = np.dtype(
    [
        # Coefficients, in powers of x = t/h over a window of length h, of the rate w, of the deformation delta, and of
        # a watched function.
        ("rates", "f8", ORDER + 1),
        ("deltas", "f8", ORDER + 1),
        ("watched", "f8", ORDER + 1),
        ("k", "f8"),  # stiffness; 0 if the contact is not active
        ("b", "f8"),  # damping; 0 if the contact is not active
        ("moves", "f8"),  # 1 if delta changes, else 0
        ("value", "f8"),  # rate, or slope of the rate, at a point of a path
        ("kw", "f8", STAGES + 1),  # derivatives of w at the stages of a step
        ("kd", "f8", STAGES + 1),  # derivatives of delta at the stages of a step
        ("w", "f8"),  # rate at the start of a step
        ("delta", "f8"),  # deformation at the start of a step
        ("jerk", "f8"),  # w'' at the start of a step
        ("ruled_out", "u1", 4),  # 1 for each function of `Watched` that has no further event in this window
        ("force_is_zero", "?"),  # whether an event at this instant has made the force zero
        ("active", "?"),  # whether this contact of the collision is active now
        ("was_active", "?"),  # whether it was active at the previous call of `log_set`
    ],
    align=True,
)


def new_workspace(contacts: int) -> Records:
    """Return the workspace of a chain, one record per contact."""
    return zero_records(contacts, WORK)


@kernel_helper
def write_derivatives(c, n, stage, work):
    """Write the derivatives of the present state as the derivatives at a stage."""
    above, middle, below = 0.0, 0.0, 0.0
    for i in range(-1, n):
        above, middle, below = middle, below, force(c[i + 1])
        if i >= 0:
            contact, scratch = c[i], work[i]
            scratch.kw[stage] = contact.a * (above - middle) + c[i + 1].a * (below - middle)
            is_held = contact.frozen and contact.phase == Phase.INACTIVE
            scratch.kd[stage] = 0.0 if is_held else contact.w


@kernel_helper
def move_to_stage(c, n, stage, h, work):
    """Move the chain to a stage of a step of length h; the last stage is the end of the step."""
    weights = A[stage] if stage < STAGES else B
    for i in range(n):
        scratch, w, delta = work[i], 0.0, 0.0
        for j in range(min(stage, STAGES)):
            w += weights[j] * scratch.kw[j]
            delta += weights[j] * scratch.kd[j]
        c[i].w, c[i].delta = scratch.w + h * w, scratch.delta + h * delta


@kernel_helper
def error_of_step(c, n, h, work):
    """Estimate the error of a step of length h from the derivatives at its stages; units as in `TOLERANCE`.

    Deformations are measured by the length of their contact. An active contact takes the length at its running
    stiffness. An inactive contact takes the length at its original stiffness: it may have become far stiffer, and its
    gap is then rounded coarsely in units of the shorter length.
    """
    fifth, third = 0.0, 0.0
    for i in range(n):
        contact, scratch = c[i], work[i]
        w5, w3, d5, d3 = 0.0, 0.0, 0.0, 0.0
        for j in range(STAGES + 1):
            w5 += E5[j] * scratch.kw[j]
            w3 += E3[j] * scratch.kw[j]
            d5 += E5[j] * scratch.kd[j]
            d3 += E3[j] * scratch.kd[j]
        length = contact.length
        if is_active(contact):
            length *= (contact.original / contact.k) ** (1 / (contact.p + 1))
        fifth += w5 * w5 + (d5 / length) ** 2
        third += w3 * w3 + (d3 / length) ** 2
    weighted = (fifth + 0.01 * third) * 2 * n
    if not weighted < inf:
        return inf  # a stage is beyond double precision: the step is far too long
    return h * fifth / sqrt(weighted) if fifth > 0 else 0.0


@kernel_helper
def step(c, n, h, work):
    """Move the chain by a time h from the state in `work`, and return the estimated error."""
    for stage in range(STAGES + 1):
        move_to_stage(c, n, stage, h, work)
        write_derivatives(c, n, stage, work)
    return error_of_step(c, n, h, work)


@kernel_helper
def jerk(c, i):
    """Return w'' of contact i, without dashpots."""
    above = tangent(c[i - 1]) * c[i - 1].w if is_active(c[i - 1]) else 0.0
    middle = tangent(c[i]) * c[i].w if is_active(c[i]) else 0.0
    below = tangent(c[i + 1]) * c[i + 1].w if is_active(c[i + 1]) else 0.0
    return c[i].a * (above - middle) + c[i + 1].a * (below - middle)


@kernel_helper
def write_cubic(out, f0, d0, f1, d1):
    """Write the polynomial in x with values f and slopes d at 0 and at 1."""
    out[0], out[1], out[2], out[3] = f0, d0, 3 * (f1 - f0) - 2 * d0 - d1, 2 * (f0 - f1) + d0 + d1
    out[4], out[5] = 0.0, 0.0


@kernel_helper
def write_quintic(out, f0, d0, s0, f1, d1, s1):
    """Write the polynomial in x with values f, slopes d and second derivatives s at 0 and at 1."""
    r0, r1, r2 = f1 - f0 - d0 - 0.5 * s0, d1 - d0 - s0, 0.5 * (s1 - s0)
    out[0], out[1], out[2] = f0, d0, 0.5 * s0
    out[3], out[4], out[5] = 10 * r0 - 4 * r1 + r2, -15 * r0 + 7 * r1 - 2 * r2, 6 * r0 - 3 * r1 + r2


@kernel_helper
def advance(c, n, h, tolerance, work):
    """Move the chain by one step, whose length h is reduced until its error is small enough.

    Returned are the length of the step, and the length to try next. The length of the step is 0 where no step is short
    enough, because a slope is beyond double precision.
    """
    for i in range(n):
        scratch = work[i]
        scratch.w, scratch.delta, scratch.jerk = c[i].w, c[i].delta, jerk(c, i)
    factor = 4.0
    while h > 0:
        error = step(c, n, h, work) / tolerance
        factor = min(4.0, 0.9 * error**-0.125) if error > 0 else 4.0
        if error <= 1:
            break
        h *= max(0.1, factor)
    interpolate(c, n, h, work)
    return h, h * factor


@kernel_helper
def interpolate(c, n, h, work):
    """Write the polynomials in x = t/h through both ends of a step of length h; `c` is at the end of the step."""
    for i in range(n):
        contact, scratch = c[i], work[i]
        w0, w1 = h * scratch.kw[0], h * scratch.kw[STAGES]
        if has_dashpot(contact):
            write_cubic(scratch.rates, scratch.w, w0, contact.w, w1)
        else:
            write_quintic(
                scratch.rates, scratch.w, w0, h * h * scratch.jerk, contact.w, w1, h * h * jerk(c, i)
            )
        if contact.frozen and contact.phase == Phase.INACTIVE:
            write_cubic(scratch.deltas, 0.0, 0.0, 0.0, 0.0)
        else:
            write_quintic(
                scratch.deltas, scratch.delta, h * scratch.w, h * w0, contact.delta, h * contact.w, h * w1
            )


@kernel_helper
def interpolate_force(contact, h, scratch):
    """Write the polynomial of a dashpot's `force_indicator` through both ends of a step of length h."""
    f0, d0 = force_indicator(contact, scratch.delta, scratch.w, scratch.kw[0])
    f1, d1 = force_indicator(contact, contact.delta, contact.w, scratch.kw[STAGES])
    write_cubic(scratch.watched, f0, h * d0, f1, h * d1)


@kernel_helper
def value_and_slope_at_end(contact, scratch, watched):
    """Return the value of a watched function at the end of a step, and its slope in time."""
    if watched == Watched.GAP:
        return contact.delta, contact.w
    if watched == Watched.FORCE:
        return force_indicator(contact, contact.delta, contact.w, scratch.kw[STAGES])
    return contact.w, scratch.kw[STAGES]


@kernel_helper
def refine_event(c, n, h, x, i, watched, sign, work):
    """Repeat a step of length h up to the zero, near x h, of a watched function of contact i.

    On entry the chain is at the end of the step; on return it is at the zero. Returned are the time of the zero over h,
    and whether the zero is an event: the polynomial may have a root where the motion has none.

    Once the function is known to change its sign, Newton's iteration stays inside a bracket, and halves the bracket
    where Newton's step would leave it. The reason is the force of a weak dashpot: it bends so sharply next to its end
    that Newton's step from beyond the end is useless.
    """
    contact, scratch = c[i], work[i]
    low, high = 0.0, 1.0
    value, _ = value_and_slope_at_end(contact, scratch, watched)
    changes_sign, refinements = sign * value <= 0, 0
    while True:
        step(c, n, x * h, work)
        value, rise = value_and_slope_at_end(contact, scratch, watched)
        change = -value / (rise * h) if rise != 0 else 0.0
        if sign * value > 0:
            low = x
        else:
            high, changes_sign = x, True
        if not changes_sign:
            after = max(0.0, x + max(-LONGEST, min(change, LONGEST)))
        elif value == 0 or low < x + change < high:
            after = x + change
        else:
            after = 0.5 * (low + high)
        most_refinements = MOST_REFINEMENTS if changes_sign else REFINEMENTS
        if abs(after - x) <= CONVERGED or refinements == most_refinements:
            # A function that only leaves zero has no event there.
            is_past_zero = sign * value < 0 or (value == 0 and sign * rise <= 0)
            is_falling_to_zero = sign * rise < 0 and abs(change) <= RESOLVED
            return x, is_past_zero or is_falling_to_zero
        x, refinements = after, refinements + 1
