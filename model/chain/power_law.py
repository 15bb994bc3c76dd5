"""Motion of a chain under power laws such as Hertz's (p = 1.5), integrated in steps of the method DOP853.

No closed form of this motion is known. `advance` makes one step, and `refine_event` repeats a step so that it ends at
an event. `WORK` is the working memory of a contact, which the motion by power series uses as well.

A step has the order 8. After each step, polynomials of degree 3 and 5 are laid through its ends, and their first event
is found as for linear contacts. The step is then repeated so that it ends at the event, whose time is found by Newton's
iteration. So the event has the accuracy of the method. A force is not smooth where it begins or ends; there the error
estimate makes the steps shorter.

Needs `chain.dop853` for the coefficients of the method. Used by `chain.kernel` and `chain.event`.
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

#: Highest degree of the polynomials that are laid through the ends of a step.
ORDER_OF_STEP = 5

#: Largest error of a step. Errors of velocities are divided by the velocity of impact. Errors of deformations are
#: divided by the deformation at which the contact would hold all the energy of impact.
TOLERANCE = 1e-14

#: Largest number of iterations for the time of an event inside a bracket. Even halving alone needs no more.
MOST_REFINEMENTS = 60

#: Limits of Newton's iteration while no bracket is known: largest number of iterations, and largest change of time in
#: one iteration as a share of the step.
REFINEMENTS, LONGEST = 8, 0.05

#: Changes of the time of an event, as shares of the step. At `CONVERGED` Newton's iteration stops. A last change of at
#: most `RESOLVED` is taken for rounding.
CONVERGED, RESOLVED = 1e-15, 1e-6


#: Record of the working memory of one contact. It is allocated once for all chains.
WORK = np.dtype(
    [
        # Coefficients in powers of x = t/h, over a window of length h: of the rate w, of the deformation delta, and of
        # a watched function.
        ("rates", "f8", ORDER + 1),
        ("deltas", "f8", ORDER + 1),
        ("watched", "f8", ORDER + 1),
        ("k", "f8"),  # stiffness; 0 unless the contact is active
        ("b", "f8"),  # damping; 0 unless the contact is active
        ("moves", "f8"),  # 1 if the deformation changes in this window, else 0
        ("value", "f8"),  # rate of compression, or its derivative, at a logged point of time
        ("kw", "f8", STAGES + 1),  # derivatives of the rate w at the stages of a step
        ("kd", "f8", STAGES + 1),  # derivatives of the deformation delta at the stages of a step
        ("w", "f8"),  # rate of compression at the start of a step
        ("delta", "f8"),  # deformation at the start of a step
        ("jerk", "f8"),  # second derivative of the rate at the start of a step
        ("ruled_out", "u1", 4),  # 1 for each function of `Watched` that has no further event in this window
        ("force_is_zero", "?"),  # whether an event at the present time has made the force zero
        ("active", "?"),  # whether this contact of the collision is active in the present window
        ("was_active", "?"),  # whether this contact was active at the previous call of `log_set`
    ],
    align=True,
)


def new_workspace(contacts: int) -> Records:
    """Return the working memory of a chain: zeros in one record of `WORK` per contact."""
    return zero_records(contacts, WORK)


@kernel_helper
def write_derivatives(c, n, stage, work):
    """Compute the derivatives of rates and deformations in the present state, and store them for a stage."""
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
    """Move the chain to the place of a stage in a step of length h. The stage `STAGES` is the end of the step."""
    weights = A[stage] if stage < STAGES else B
    for i in range(n):
        scratch, w, delta = work[i], 0.0, 0.0
        for j in range(min(stage, STAGES)):
            w += weights[j] * scratch.kw[j]
            delta += weights[j] * scratch.kd[j]
        c[i].w, c[i].delta = scratch.w + h * w, scratch.delta + h * delta


@kernel_helper
def error_of_step(c, n, h, work):
    """Estimate the error of a step of length h from the derivatives at its stages, in the units of `TOLERANCE`.

    The error of a deformation is divided by a length: the deformation at which the contact would hold all the energy of
    impact. For an active contact the length is computed with its running stiffness. For an inactive contact it is
    computed with the original stiffness. An inactive contact may have become far stiffer. In units of the shorter
    length the rounding of its gap would then appear as an error.
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
        return inf  # a derivative exceeds double precision: the step is far too long
    return h * fifth / sqrt(weighted) if fifth > 0 else 0.0


@kernel_helper
def step(c, n, h, work):
    """Make a step of length h from the state that is stored in `work`, and return the estimated error."""
    for stage in range(STAGES + 1):
        move_to_stage(c, n, stage, h, work)
        write_derivatives(c, n, stage, work)
    return error_of_step(c, n, h, work)


@kernel_helper
def jerk(c, i):
    """Return the second derivative of the rate of contact i, for contacts without dashpots."""
    above = tangent(c[i - 1]) * c[i - 1].w if is_active(c[i - 1]) else 0.0
    middle = tangent(c[i]) * c[i].w if is_active(c[i]) else 0.0
    below = tangent(c[i + 1]) * c[i + 1].w if is_active(c[i + 1]) else 0.0
    return c[i].a * (above - middle) + c[i + 1].a * (below - middle)


@kernel_helper
def write_cubic(out, f0, d0, f1, d1):
    """Write the coefficients of the cubic that has the values f0 and f1, and the slopes d0 and d1, at 0 and at 1."""
    out[0], out[1], out[2], out[3] = f0, d0, 3 * (f1 - f0) - 2 * d0 - d1, 2 * (f0 - f1) + d0 + d1
    out[4], out[5] = 0.0, 0.0


@kernel_helper
def write_quintic(out, f0, d0, s0, f1, d1, s1):
    """Write the coefficients of the polynomial of degree 5 with given values, slopes and second derivatives at 0 and 1.

    The values are f0 and f1, the slopes d0 and d1, and the second derivatives s0 and s1.
    """
    r0, r1, r2 = f1 - f0 - d0 - 0.5 * s0, d1 - d0 - s0, 0.5 * (s1 - s0)
    out[0], out[1], out[2] = f0, d0, 0.5 * s0
    out[3], out[4], out[5] = 10 * r0 - 4 * r1 + r2, -15 * r0 + 7 * r1 - 2 * r2, 6 * r0 - 3 * r1 + r2


@kernel_helper
def advance(c, n, h, tolerance, work):
    """Move the chain by one step. Its length h is reduced until the error is at most `tolerance`.

    The function returns the length of the step, and the length to try for the next step. The length is 0 if no step is
    short enough, because a derivative exceeds double precision.
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
    """Write the polynomials in x = t/h that connect the start of a step of length h with its end, where `c` is."""
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
    """Write the cubic that follows `force_indicator`, which has the sign of the force, over a step of length h."""
    f0, d0 = force_indicator(contact, scratch.delta, scratch.w, scratch.kw[0])
    f1, d1 = force_indicator(contact, contact.delta, contact.w, scratch.kw[STAGES])
    write_cubic(scratch.watched, f0, h * d0, f1, h * d1)


@kernel_helper
def value_and_slope_at_end(contact, scratch, watched):
    """Return the value of a watched function at the end of a step, and its derivative in time."""
    if watched == Watched.GAP:
        return contact.delta, contact.w
    if watched == Watched.FORCE:
        return force_indicator(contact, contact.delta, contact.w, scratch.kw[STAGES])
    return contact.w, scratch.kw[STAGES]


@kernel_helper
def refine_event(c, n, h, x, i, watched, sign, work):
    """Repeat a step of length h so that it ends at the zero of a watched function of contact i, near the time x h.

    On entry the chain is at the end of the step, and on return it is at the zero. The function returns the time of the
    zero, divided by h, and whether the zero is an event. It is no event if only the polynomial has a root, and not the
    motion.

    Once the function is known to change its sign, Newton's iteration stays inside a bracket. If Newton's step would
    leave the bracket, the bracket is halved instead. This is needed for a weak dashpot: its force bends so sharply just
    before it ends that Newton's step from beyond the end is useless.
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
            # If the function only leaves zero, this is no event.
            is_past_zero = sign * value < 0 or (value == 0 and sign * rise <= 0)
            is_falling_to_zero = sign * rise < 0 and abs(change) <= RESOLVED
            return x, is_past_zero or is_falling_to_zero
        x, refinements = after, refinements + 1
