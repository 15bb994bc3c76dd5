"""The grazing margin of a pair: how near a collision of two balls is to a jump of the model's outcome.

The outcome jumps where a rate of compression touches zero without crossing it. The grazing margin is the smallest
magnitude of a rate at a turning point in S1, divided by the sum of the amplitudes of its sinusoids. It is infinite if
no quotient is below `NEAR` (docs/theory.md, section 6). `nearest_turn` searches for turning points. Two quick tests
spare most searches: `turns_far` shows from the amplitudes of a segment that no turning point is near zero, and
`stays_far` shows it for a window from the derivatives at its ends.

Needs `pair.motion` and `pair.roots`. Used by `pair.events` and `pair.ringing`. `chain.grazing` and `graph.grazing`
use the thresholds.
"""

from __future__ import annotations

from math import inf, sqrt

from impact_xval.model.compiled import force_inlined, kernel_helper
from impact_xval.model.pair.motion import modal_coordinates
from impact_xval.model.pair.roots import EPSILON, Jet, positive_between, root_before

#: Share of the energy of impact. A turning point of a rate of compression is ignored if an end of compression at this
#: time would lose less than this share. The outcome then hardly depends on whether compression ends there.
STAKE = 1e-6

#: Share of the amplitude of a rate of compression. A turning point is ignored if the rate is larger there than this
#: share. An outcome whose turning points are all ignored has an infinite margin. The number must not exceed
#: `pair.roots.ENVELOPE_RESERVE`. The threshold for marks, the sentences that warn of outcomes, is far smaller:
#: `model.inputs.GRAZING_THRESHOLD`.
NEAR = 0.05

#: Shortest part of a window that is still halved in the search for pairs of turning points, in radians of the fast
#: mode.
SHORTEST_STRETCH = 1e-7

#: Largest number of parts of a window in the search for turning points. A search that needs more is given up.
MOST_STRETCHES = 1000


@force_inlined
def turns_far(slow, fast, slow2, fast2):
    """Return whether a sum of two sinusoids exceeds the share `NEAR` of its amplitude at all of its turning points.

    `slow` and `fast` are the amplitudes; `slow2` and `fast2` are the squares of the frequencies w_slow and w_fast. At a
    turning point slow w_slow sin x = -fast w_fast sin y, with the phases x and y. Hence abs(sin x) is at most
    fast w_fast/(slow w_slow), and the magnitude of the sum is at least slow abs(cos x) - fast. The same is true with
    both sinusoids exchanged.
    """
    threshold = NEAR * (slow + fast)
    slow_bound, fast_bound = fast + threshold, slow + threshold
    by_slow = slow2 * (slow * slow - slow_bound * slow_bound) > fast2 * fast * fast
    by_fast = fast2 * (fast * fast - fast_bound * fast_bound) > slow2 * slow * slow
    return by_slow | by_fast


@force_inlined
def stays_far(h, start, end, higher_start, higher_end, C, w1, near):
    """Return whether it is certain that a rate has no turning point below `near` inside a window of length h.

    `start` and `end` are the rate, its slope and its second derivative at both ends, where the rate is not negative.
    `higher_start` and `higher_end` are the pairs of its third and fourth derivatives at the ends. C is a bound of the
    sixth derivative, divided by 28800. The bound of each higher derivative is w1 times as large.

    One of three conditions is enough: the rate stays above `near`; or its slope has one sign; or the rate is concave,
    rises first, falls last, and is above `near` in the middle. Bernstein coefficients bound the values, as described in
    `pair.roots`.
    """
    reserve = C * (h * h * h) * (h * h * h)
    step0, step1, bend = 0.2 * h * start.slope, -0.2 * h * end.slope, 0.05 * h * h
    b1, b2 = start.value + step0, start.value + 2 * step0 + bend * start.bend
    b4, b3 = end.value + step1, end.value + 2 * step1 + bend * end.bend
    if min(min(min(start.value, b1), min(b4, end.value)), min(b2, b3) - reserve) > near:
        return True
    if start.slope * end.slope >= 0:
        sign = 1.0 if start.slope + end.slope > 0 else -1.0
        slope_start = Jet(sign * start.slope, sign * start.bend, sign * higher_start[0])
        slope_end = Jet(sign * end.slope, sign * end.bend, sign * higher_end[0])
        return positive_between(slope_start, slope_end, h, C * w1)
    middle = (start.value + end.value + 5 * (b1 + b4) + 10 * (b2 + b3 - reserve)) / 32
    if start.slope < 0 or middle <= near or start.bend > 0 or end.bend > 0:
        return False
    bend_start = Jet(-start.bend, -higher_start[0], -higher_start[1])
    bend_end = Jet(-end.bend, -higher_end[0], -higher_end[1])
    return positive_between(bend_start, bend_end, h, C * w1 * w1)


@force_inlined
def jet_of(c, omega, q, r):
    """Return the value, the slope and the second derivative of the sum of c_j q_j over both modes j."""
    x0, x1 = c[0] * q[0], c[1] * q[1]
    slope = c[0] * omega[0] * r[0] + c[1] * omega[1] * r[1]
    return Jet(x0 + x1, slope, -omega[0] * omega[0] * x0 - omega[1] * omega[1] * x1)


@kernel_helper
def nearest_turn(c, force, least_square, t, h, omega, a, b):
    """Return the smallest magnitude of a rate at its turning points in (t, t + h); infinity without turning points.

    The rate is the sum of c_j q_j over both modes j, and the force of the contact is the sum of force_j r_j. Turning
    points are ignored if the square of the force is at most `least_square`. No other turning point is missed. The
    window is searched in parts: inside each part it is proven that the slope has no zero, and a part may end at a zero
    of the slope.
    """
    w0, w1 = omega
    # The slope is the sum of g_j r_j. r_j starts at b_j. Its derivative is -omega_j q_j, and -q_j starts at -a_j.
    g = (c[0] * w0, c[1] * w1)
    u, v = b, (-a[0], -a[1])
    slow = abs(g[0]) * sqrt(a[0] * a[0] + b[0] * b[0])
    fast = abs(g[1]) * sqrt(a[1] * a[1] + b[1] * b[1])
    C = (slow * (w0 * w0 * w0) ** 2 + fast * (w1 * w1 * w1) ** 2) / 28800
    noise = 4 * EPSILON * (1 + w1 * (t + h)) * (slow + fast)
    least = inf
    passed, step = 0.0, h
    r, minus_q = modal_coordinates(t, omega, u, v)
    start = jet_of(g, omega, r, minus_q)
    leading = start.value if start.value != 0 else (start.slope if start.slope != 0 else start.bend)
    if leading < 0:
        g, start = (-g[0], -g[1]), Jet(-start.value, -start.slope, -start.bend)
    for _ in range(MOST_STRETCHES):
        # The slope is positive, or zero and rising, at the start of each part.
        r, minus_q = modal_coordinates(t + passed + step, omega, u, v)
        end = jet_of(g, omega, r, minus_q)
        turns = end.value < 0
        if turns:
            step, r, minus_q = root_before(g, t + passed, step, 0.0, start, end, noise, omega, u, v)
            at_root = jet_of(g, omega, r, minus_q)
            end = Jet(0.0, at_root.slope, at_root.bend)
        if not positive_between(start, end, step, C) and step * w1 > SHORTEST_STRETCH:
            step *= 0.5
            continue
        passed += step
        if turns:
            F = force[0] * r[0] + force[1] * r[1]
            if least_square < F * F:
                least = min(least, abs(c[0] * minus_q[0] + c[1] * minus_q[1]))
            g, end = (-g[0], -g[1]), Jet(0.0, -end.slope, -end.bend)
        start, step = end, h - passed
        if step * w1 < SHORTEST_STRETCH:
            break
    return least
