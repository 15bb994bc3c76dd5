"""The grazing margin of a pair: how near a collision of two balls comes to a jump of the model's outcome.

The grazing margin is the smallest magnitude of a compression rate at a turning point in S1, relative to the sum of the
amplitudes of its sinusoids, if that is below `NEAR` (docs/theory.md, section 6, has the definition). `nearest_turn`
searches for turning points. Two quick tests come first. `turns_far` tells from the amplitudes of a segment that no
turning point is near zero; `stays_far` tells the same of a window, from the derivatives at its ends.

Needs `pair.motion` and `pair.roots`. Used by `pair.events` and `pair.ringing`; `chain.grazing` and `graph.grazing`
share the thresholds.
"""

from __future__ import annotations

from math import inf, sqrt

from impact_xval.model.compiled import force_inlined, kernel_helper
from impact_xval.model.pair.motion import modal_coordinates
from impact_xval.model.pair.roots import EPSILON, Jet, positive_between, root_before

#: Near misses count where an end of compression would lose at least this share of the energy of impact. With a smaller
#: loss, the outcome hardly depends on whether compression ends.
STAKE = 1e-6

#: Turning points count where a rate is at most this share of its amplitude. An outcome without such a turning point has
#: an infinite margin. The number must not exceed `pair.roots.ENVELOPE_RESERVE`. Outcomes are marked by a far smaller
#: threshold, `model.inputs.GRAZING_THRESHOLD`.
NEAR = 0.05

#: Stretches shorter than this, in radians of the fast mode, are not halved further to find pairs of turning points.
SHORTEST_STRETCH = 1e-7

#: Number of stretches after which the search of a window for turning points is given up.
MOST_STRETCHES = 1000


@force_inlined
def turns_far(slow, fast, slow2, fast2):
    """Return whether a sum of two sinusoids exceeds `NEAR` of its amplitude at all of its turning points.

    `slow` and `fast` are the amplitudes, `slow2` and `fast2` the squares of the frequencies w_slow and w_fast. At a
    turning point slow w_slow sin x = -fast w_fast sin y. Hence abs(sin x) is at most fast w_fast/(slow w_slow), and the
    magnitude of the sum at least slow abs(cos x) - fast. The same holds with both sinusoids exchanged.
    """
    threshold = NEAR * (slow + fast)
    slow_bound, fast_bound = fast + threshold, slow + threshold
    by_slow = slow2 * (slow * slow - slow_bound * slow_bound) > fast2 * fast * fast
    by_fast = fast2 * (fast * fast - fast_bound * fast_bound) > slow2 * slow * slow
    return by_slow | by_fast


@force_inlined
def stays_far(h, start, end, higher_start, higher_end, C, w1, near):
    """Return whether it is certain that a rate has no turning point below `near` inside a window of length h.

    `start` and `end` are the jets of the rate at both ends, where the rate is not negative. `higher_start` and
    `higher_end` are the pairs of its third and fourth derivatives there. C is the bound of the sixth derivative divided
    by 28800; the bound of each further derivative is w1 times as large.

    One of three conditions is enough: the rate stays above `near`; its slope has one sign; or the rate is concave,
    rises first, falls last, and is above `near` in the middle. Values are bounded by the Bernstein coefficients of
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
    """Return the jet of sum c_j q_j."""
    x0, x1 = c[0] * q[0], c[1] * q[1]
    slope = c[0] * omega[0] * r[0] + c[1] * omega[1] * r[1]
    return Jet(x0 + x1, slope, -omega[0] * omega[0] * x0 - omega[1] * omega[1] * x1)


@kernel_helper
def nearest_turn(c, force, least_square, t, h, omega, a, b):
    """Return the smallest magnitude of a rate sum c_j q_j at its turning points in (t, t + h); infinity without any.

    A turning point counts where the square of the contact's force, sum force_j r_j, exceeds `least_square`. No turning
    point is missed. The window is passed in stretches. Each stretch ends at a zero of the slope or at its full length,
    and inside it the slope is certified to have no zero.
    """
    w0, w1 = omega
    # The slope is sum g_j r_j. r_j starts at b_j, and its quarter-turned partner is -q_j, which starts at -a_j.
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
        # The slope is positive, or about to be, at the start of each stretch.
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
