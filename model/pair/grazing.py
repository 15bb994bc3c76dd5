"""Grazing: how near a collision is to a jump of the model, and which results are marked for it.

The grazing margin is the smallest magnitude of a compression rate at a turning point in S1, relative to the sum of
the amplitudes of its sinusoids, as far as that is below `NEAR` (docs/theory.md, section 6, has the definition).

A segment is looked through for turning points only where its amplitudes allow any near zero (`turns_far`), a window
only where it cannot be excluded from what is known at its ends (`stays_far`).
"""

from __future__ import annotations

from math import inf, sqrt

from impact_xval.model.compiled import inlined, uncounted
from impact_xval.model.pair.motion import modal
from impact_xval.model.pair.roots import EPSILON, positive_between, root_before

#: Near-misses at which an end of compression would lose less than this, as a fraction of the energy of impact, do not
#: count: whether it happens or not hardly changes the outcome.
STAKE = 1e-6

#: Turning points at which a rate is larger than this share of its amplitude do not count: an outcome without a nearer
#: one has an infinite margin.
NEAR = 0.05

#: Stretches shorter than this (in radians of the fast mode) are not searched further for pairs of turning points.
SHORTEST_STRETCH = 1e-7

#: Stretches after which the search of a window for turning points is given up.
MOST_STRETCHES = 1000

#: A cut-off that changes (v1, v2) by more than this marks a result, in the kinetic norm per sqrt(m1) abs(v0).
CUTOFF_THRESHOLD = 1e-9

GRAZING = (
    "grazing: a compression rate turned around next to zero (grazing_margin), and the outcome jumps where one "
    "reaches zero"
)
CUTOFF = (
    f"cut-off: the outcome without a cut-off differs by more than {CUTOFF_THRESHOLD:g} |v0|, or is not known"
)

#: The sentences, by the sum of 1 (grazing) and 2 (cut-off).
MARKS = ("", GRAZING, CUTOFF, f"{GRAZING}; {CUTOFF}")


@inlined
def turns_far(slow, fast, slow2, fast2):
    """Tell whether a sum of two sinusoids is larger than `NEAR` of its amplitude at all of its turning points.

    Given are the amplitudes and the squares of the frequencies. At a turning point slow w_slow sin x = -fast w_fast
    sin y. Hence abs(sin x) is at most fast w_fast/(slow w_slow), and the sum at least slow abs(cos x) - fast. The same
    holds with both sinusoids exchanged.
    """
    near = NEAR * (slow + fast)
    slow_bound, fast_bound = fast + near, slow + near
    by_slow = slow2 * (slow * slow - slow_bound * slow_bound) > fast2 * fast * fast
    by_fast = fast2 * (fast * fast - fast_bound * fast_bound) > slow2 * slow * slow
    return by_slow | by_fast


@inlined
def stays_far(h, start, end, more_start, more_end, C, w1, near):
    """Certify that a rate has no turning point inside a window at which it is below `near`; what is unsure is not.

    Given are value, slope and second derivative at both ends; third and fourth derivative at both ends; and C, the
    bound of the sixth derivative divided by 28800, which grows by w1 with each further derivative. The rate
    is not negative at either end. It stays far if all of it is above `near`; or if its slope has one sign; or if it is
    concave, rises first and falls last, and is above `near` in the middle. Values are bounded by the Bernstein
    coefficients of `pair.roots`.
    """
    reserve = C * (h * h * h) * (h * h * h)
    step0, step1, bend = 0.2 * h * start[1], -0.2 * h * end[1], 0.05 * h * h
    b1, b2 = start[0] + step0, start[0] + 2 * step0 + bend * start[2]
    b4, b3 = end[0] + step1, end[0] + 2 * step1 + bend * end[2]
    if min(min(min(start[0], b1), min(b4, end[0])), min(b2, b3) - reserve) > near:
        return True
    if start[1] * end[1] >= 0:
        sign = 1.0 if start[1] + end[1] > 0 else -1.0
        slope_start = (sign * start[1], sign * start[2], sign * more_start[0])
        slope_end = (sign * end[1], sign * end[2], sign * more_end[0])
        return positive_between(slope_start, slope_end, h, C * w1)
    middle = (start[0] + end[0] + 5 * (b1 + b4) + 10 * (b2 + b3 - reserve)) / 32
    if start[1] < 0 or middle <= near or start[2] > 0 or end[2] > 0:
        return False
    bend_start, bend_end = (-start[2], -more_start[0], -more_start[1]), (-end[2], -more_end[0], -more_end[1])
    return positive_between(bend_start, bend_end, h, C * w1 * w1)


@inlined
def jet(c, omega, q, r):
    """Value and two derivatives of sum c_j q_j."""
    x0, x1 = c[0] * q[0], c[1] * q[1]
    slope = c[0] * omega[0] * r[0] + c[1] * omega[1] * r[1]
    return x0 + x1, slope, -omega[0] * omega[0] * x0 - omega[1] * omega[1] * x1


@uncounted
def nearest_turn(c, force, least_square, t, h, omega, a, b):
    """Smallest magnitude of a rate sum c_j q_j at its turning points in (t, t + h); infinity if there is none.

    Points count where the square of the contact's force, sum force_j r_j, exceeds `least_square`. None is missed: the
    window is passed in stretches that end at a zero of the slope or at their full length, and in which the slope is
    certified to have no zero.
    """
    w0, w1 = omega
    # The slope is a sum of r_j, which lag a quarter turn behind q_j: sum g_j r_j, where r_j starts as u_j.
    g, u, v = (c[0] * w0, c[1] * w1), b, (-a[0], -a[1])
    slow = abs(g[0]) * sqrt(a[0] * a[0] + b[0] * b[0])
    fast = abs(g[1]) * sqrt(a[1] * a[1] + b[1] * b[1])
    C = (slow * (w0 * w0 * w0) ** 2 + fast * (w1 * w1 * w1) ** 2) / 28800
    noise = 4 * EPSILON * (1 + w1 * (t + h)) * (slow + fast)
    least, passed, step = inf, 0.0, h
    r, minus_q = modal(t, omega, u, v)
    start = jet(g, omega, r, minus_q)
    leading = start[0] if start[0] != 0 else (start[1] if start[1] != 0 else start[2])
    if leading < 0:
        g, start = (-g[0], -g[1]), (-start[0], -start[1], -start[2])
    for _ in range(MOST_STRETCHES):
        # The slope is positive, or about to be, at the start of each stretch.
        r, minus_q = modal(t + passed + step, omega, u, v)
        end = jet(g, omega, r, minus_q)
        turns = end[0] < 0
        if turns:
            step, r, minus_q = root_before(g, t + passed, step, 0.0, start, end, noise, omega, u, v)
            _, slope, curve = jet(g, omega, r, minus_q)
            end = (0.0, slope, curve)
        if not positive_between(start, end, step, C) and step * w1 > SHORTEST_STRETCH:
            step *= 0.5
            continue
        passed += step
        if turns:
            F = force[0] * r[0] + force[1] * r[1]
            if least_square < F * F:
                least = min(least, abs(c[0] * minus_q[0] + c[1] * minus_q[1]))
            g, end = (-g[0], -g[1]), (0.0, -end[1], -end[2])
        start, step = end, h - passed
        if step * w1 < SHORTEST_STRETCH:
            break
    return least
