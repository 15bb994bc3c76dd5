"""The certified first event in S1.

In S1 up to four functions of time are watched, each positive until its event: the compression rate of a contact in
compression (falls through zero: compression ends), its negative in restitution (compression restarts), and the force
of a contact in restitution (falls to zero: restitution ends). Each is a sum of two sinusoids with known amplitudes, so
that its derivatives are bounded by known numbers. Two facts make the search both quick and safe:

* **Certificate.** The values, slopes and second derivatives of a function at both ends of a window prove it positive
  inside (`pair.roots.positive_between`).
* **Envelope.** f is at least its slow sinusoid less the amplitude of its fast one, and the time at which that
  difference first comes near zero is known in closed form (`pair.roots.envelope_time`). It steps over thousands of
  fast oscillations that are too weak to matter.

A window is tried from the last certified time on. If a function is negative at its end, the end moves to a root of
that function; if all are positive but not certified, the window is halved; if all are certified, it is passed, or its
end, where one is zero, is the event. A pair of close roots cannot be stepped over, for no window that holds one is
certified.

**Ties.** Every watched function that is zero within rounding at the first root fires at that instant. Applying the
events in any order gives the same state, since each changes only variables of its own contact; where end of restitution
and restart of compression of one contact coincide, restitution ends (what is left to restart is zero).
"""

from __future__ import annotations

from math import atan2, cos, inf, pi, sin, sqrt

from impact_xval.model.compiled import inlined
from impact_xval.model.pair.grazing import (
    NEAR,
    STAKE,
    nearest_turn,
    stays_far,
    turns_far,
)
from impact_xval.model.pair.motion import cos_sin, modal, motion, turn, turn_little
from impact_xval.model.pair.roots import (
    EPSILON,
    envelope_time,
    leaves_zero,
    positive_between,
    root_before,
    time_above_zero,
)

#: Rounding of a watched function, relative to its amplitude.
NOISE = 4 * EPSILON

#: Windows of the search, in radians of the fast mode; C h^6/28800 is then 6 % of an amplitude.
WINDOW = 3.5
COS_WINDOW, SIN_WINDOW = cos(WINDOW), sin(WINDOW)

#: Windows shorter than this (in radians of the fast mode) resolve a tangency to rounding.
SHORTEST_WINDOW = 1e-9

#: The envelope is tried when the fast mode is at least this much faster than the slow one.
ENVELOPE_RATIO = 6.0

#: A contact that is stiffer than the other by this factor may ring (`next_turn`).
STIFFER = 10.0

#: The slow sinusoid of its rate is then at most this share of the fast one.
RINGING = 0.8

#: Newton's steps from one zero of that rate to the next, in radians of the fast mode, and how short the last one is.
LONGEST_STEP, LAST_STEP = 0.1, 1e-8


@inlined
def jets(d1, v2, F1, F2, signs, k1, k2, inverse_mu, inverse_M):
    """(f, f', f'') of the four watched functions in a state: both rates with their signs, both forces."""
    s1, s2 = signs
    a1, a2 = F2 * inverse_mu - F1 * inverse_M, (F2 - F1) * inverse_mu
    g1, g2 = k1 * d1, -k2 * v2
    return (
        (s1 * d1, s1 * a1, s1 * (g2 * inverse_mu - g1 * inverse_M)),
        (s2 * v2, s2 * a2, s2 * (g2 - g1) * inverse_mu),
        (F1, g1, k1 * a1),
        (F2, g2, -k2 * a2),
    )


@inlined
def higher(x0, x1, x2, x3, signs, k1, k2, inverse_mu, inverse_M):
    """Third and fourth derivative of both watched rates in a state, given its `jets`."""
    s1, s2 = signs
    a1, a2 = x2[2], x3[2]
    g1, g2 = k1 * s1 * x0[2], -k2 * s2 * x1[2]
    return (
        (s1 * (a2 * inverse_mu - a1 * inverse_M), s1 * (g2 * inverse_mu - g1 * inverse_M)),
        (s2 * (a2 - a1) * inverse_mu, s2 * (g2 - g1) * inverse_mu),
    )


@inlined
def behind(below, h, end):
    """How far before the end of a window of length h a function that is negative there vanished, by Newton's step."""
    back = end[0] / end[1]
    back = back if (end[1] < 0) & (back < h) else 0.5 * h
    return back if below else -1.0


@inlined
def pick(is0, is1, is2, x0, x1, x2, x3):
    """Return the jet that a flag chooses, the last if none is set; without a branch, for none could be foretold."""
    return (
        x0[0] if is0 else (x1[0] if is1 else (x2[0] if is2 else x3[0])),
        x0[1] if is0 else (x1[1] if is1 else (x2[1] if is2 else x3[1])),
        x0[2] if is0 else (x1[2] if is1 else (x2[2] if is2 else x3[2])),
    )


#: Windows after which a collision is given up: half a second.
MOST_WINDOWS = 5_000_000


@inlined
def first_event(mu, modes, state, signs, watched, losses, a, b, margin):
    """Time of the first event of a segment of S1, and which of the watched functions fire.

    One function, with the four watched ones as separate variables, because that is faster: split into
    functions of tuples of four, `solve_batch` runs at 0.96 to 0.98 of its rate (medians of 60 to 100 alternations).

    Given are m2/m1 and the modes at the running stiffnesses; d1, v2, F1, F2 at the start (a rate of exactly zero there
    began the segment and is no event) and modal coordinates a and b; the signs that make the watched rates d1 and v2
    positive until their events; whether each force is watched, that of a contact in restitution; 1 - e_i^2, the share
    of its energy that a contact loses at an end of compression; and the margin of the segments before.

    Gives the time since the start of the segment; which of rate 1, rate 2, force 1, force 2 are zero then; the state
    then; the grazing margin so far (`pair.grazing`), infinity if nothing was near; and the number of windows tried:
    `MOST_WINDOWS` where none can be certified, and nothing fires.
    """
    delta, phi2, force1, force2 = modes.delta, modes.phi2, modes.force1, modes.force2
    omega, k1, k2 = modes.omega, modes.k1, modes.k2
    s1, s2 = signs
    w0, w1 = omega
    inverse_mu, inverse_M = 1 / mu, 1 + 1 / mu
    radius = (sqrt(a[0] * a[0] + b[0] * b[0]), sqrt(a[1] * a[1] + b[1] * b[1]))
    slow, fast, slow2, fast2 = radius[0], radius[1], w0 * w0, w1 * w1
    slow6, fast6 = slow2 * slow2 * slow2 / 28800, fast2 * fast2 * fast2 / 28800
    x0, x1 = abs(delta[0]) * slow, abs(delta[1]) * fast
    size0, C0, B0 = x0 + x1, x0 * slow6 + x1 * fast6, x0 * slow2 + x1 * fast2
    may_graze0 = not turns_far(x0, x1, slow2, fast2)
    x0, x1 = abs(phi2[0]) * slow, abs(phi2[1]) * fast
    size1, C1, B1 = x0 + x1, x0 * slow6 + x1 * fast6, x0 * slow2 + x1 * fast2
    may_graze1 = not turns_far(x0, x1, slow2, fast2)
    x0, x1 = abs(force1[0]) * slow, abs(force1[1]) * fast
    noise2, C2 = NOISE * (x0 + x1), x0 * slow6 + x1 * fast6
    x0, x1 = abs(force2[0]) * slow, abs(force2[1]) * fast
    noise3, C3 = NOISE * (x0 + x1), x0 * slow6 + x1 * fast6
    noise0, noise1 = NOISE * size0, NOISE * size1

    d1, v2, F1, F2 = state
    f0, f1, f2, f3 = jets(d1, v2, F1, F2, signs, k1, k2, inverse_mu, inverse_M)
    fresh0, fresh1 = d1 == 0, v2 == 0
    window = WINDOW / w1
    t, h, high = 0.0, window, inf
    steps = passed = 0
    chased = -1

    # A rate that starts below zero, by rounding, has its event behind it; one that starts at zero must leave upwards.
    gone0 = f0[0] < 0 or (fresh0 and (f0[1] < 0 or (f0[1] == 0 and f0[2] < 0)))
    gone1 = f1[0] < 0 or (fresh1 and (f1[1] < 0 or (f1[1] == 0 and f1[2] < 0)))
    if gone0 or gone1:
        return 0.0, (gone0, gone1, False, False), state, 0.0, 0
    if not inf > C0 + C1 + C2 + C3:
        return 0.0, (False, False, False, False), state, margin, MOST_WINDOWS  # nothing could be certified

    # Modal coordinates after one window: its angle in the fast mode is always the same.
    cos_slow, sin_slow = cos_sin(w0 * window)
    q, r = turn(cos_slow, sin_slow, COS_WINDOW, SIN_WINDOW, a, b)
    while True:
        steps += 1
        late = 1 + w1 * (t + h)  # the phases are rounded too
        z0, z1, z2, z3 = late * noise0, late * noise1, late * noise2, late * noise3
        d1, v2, F1, F2 = motion(q, r, modes)
        d1, v2 = (0.0 if chased == 0 else d1), (0.0 if chased == 1 else v2)
        F1, F2 = (0.0 if chased == 2 else F1), (0.0 if chased == 3 else F2)
        g0, g1, g2, g3 = jets(d1, v2, F1, F2, signs, k1, k2, inverse_mu, inverse_M)
        spared0, spared1 = fresh0 & leaves_zero(h, f0, B0, w1), fresh1 & leaves_zero(h, f1, B1, w1)
        below0, below1 = (g0[0] < -z0) & ~spared0, (g1[0] < -z1) & ~spared1
        below2, below3 = (g2[0] < -z2) & watched[0], (g3[0] < -z3) & watched[1]

        if below0 | below1 | below2 | below3:
            # The one that seems to have vanished first, for its root spares those of the others.
            high = h
            back0, back1 = behind(below0, h, g0), behind(below1, h, g1)
            back2, back3 = behind(below2, h, g2), behind(below3, h, g3)
            farthest = max(max(back0, back1), max(back2, back3))
            is0, is1, is2 = back0 == farthest, back1 == farthest, back2 == farthest
            rate = is0 | is1  # a force is a sum of r_j, and has for r_j what a rate has for q_j
            chased = 0 if is0 else (1 if is1 else (2 if is2 else 3))
            low = 0.0
            if fresh0 & is0:
                low = time_above_zero(f0, B0, w1)
            if fresh1 & is1 & (not is0):
                low = time_above_zero(f1, B1, w1)
            c = (
                s1 * delta[0] if is0 else (s2 * phi2[0] if is1 else (force1[0] if is2 else force2[0])),
                s1 * delta[1] if is0 else (s2 * phi2[1] if is1 else (force1[1] if is2 else force2[1])),
            )
            start = pick(is0, is1, is2, f0, f1, f2, f3)
            end = pick(is0, is1, is2, g0, g1, g2, g3)
            noise = z0 if is0 else (z1 if is1 else (z2 if is2 else z3))
            u = (a[0] if rate else b[0], a[1] if rate else b[1])
            v = (b[0] if rate else -a[0], b[1] if rate else -a[1])
            h, u, v = root_before(c, t, h, low, start, end, noise, omega, u, v)
            q, r = ((-v[0], -v[1]), u) if chased > 1 else (u, v)
            continue

        spared0 |= fresh0 & (g0[0] <= z0) & (g0[1] >= 0)
        spared1 |= fresh1 & (g1[0] <= z1) & (g1[1] >= 0)
        sure0, sure1 = spared0 | positive_between(f0, g0, h, C0), spared1 | positive_between(f1, g1, h, C1)
        sure2 = positive_between(f2, g2, h, C2) | ~watched[0]
        sure3 = positive_between(f3, g3, h, C3) | ~watched[1]
        sure = sure0 & sure1 & sure2 & sure3
        if not sure and h * w1 > SHORTEST_WINDOW:
            h, chased = 0.5 * h, -1
            q, r = modal(t + h, omega, a, b)
            continue

        # The window is accepted. Near-misses of the rates on the way:
        if may_graze0 | may_graze1:
            limit = min(margin, NEAR)
            more0, more1 = higher(f0, f1, f2, f3, signs, k1, k2, inverse_mu, inverse_M)
            last0, last1 = higher(g0, g1, g2, g3, signs, k1, k2, inverse_mu, inverse_M)
            if may_graze0 and not stays_far(h, f0, g0, more0, last0, C0, w1, limit * size0):
                least = nearest_turn(delta, force1, STAKE * k1 / losses[0], t, h, omega, a, b) / size0
                margin = least if least < limit else margin
            if may_graze1 and not stays_far(h, f1, g1, more1, last1, C1, w1, limit * size1):
                least = nearest_turn(phi2, force2, STAKE * k2 / losses[1], t, h, omega, a, b) / size1
                margin = least if least < min(margin, NEAR) else margin
        t += h
        # Zero within rounding fires; so does what is unsure at the shortest window and as good as zero.
        fired0 = ~spared0 & (g0[0] <= (z0 if sure0 else 4 * z0))
        fired1 = ~spared1 & (g1[0] <= (z1 if sure1 else 4 * z1))
        fired2 = watched[0] & (g2[0] <= (z2 if sure2 else 4 * z2))
        fired3 = watched[1] & (g3[0] <= (z3 if sure3 else 4 * z3))
        if fired0 | fired1 | fired2 | fired3:
            return t, (fired0, fired1, fired2, fired3), (d1, v2, F1, F2), margin, steps
        f0, f1, f2, f3 = g0, g1, g2, g3
        fresh0 = fresh1 = False
        chased = -1
        if high < inf:
            high -= h
            if high > 0:
                h = high  # some function is negative there
                q, r = modal(t + h, omega, a, b)
                continue
            high = inf
        h = min(2 * h, window)
        passed += 1
        if h == window:
            q, r = turn(cos_slow, sin_slow, COS_WINDOW, SIN_WINDOW, q, r)
        else:
            q, r = modal(t + h, omega, a, b)
        if passed % 6 == 5 and w1 > ENVELOPE_RATIO * w0:
            c0, c1 = (s1 * delta[0], s1 * delta[1]), (s2 * phi2[0], s2 * phi2[1])
            skip = min(
                envelope_time(0.0, c0, t, omega, a, b, radius),
                envelope_time(0.0, c1, t, omega, a, b, radius),
                envelope_time(0.5 * pi, force1, t, omega, a, b, radius) if watched[0] else inf,
                envelope_time(0.5 * pi, force2, t, omega, a, b, radius) if watched[1] else inf,
            )
            if skip > t + window:
                t = skip
                q, r = modal(t, omega, a, b)
                d1, v2, F1, F2 = motion(q, r, modes)
                f0, f1, f2, f3 = jets(d1, v2, F1, F2, signs, k1, k2, inverse_mu, inverse_M)
                q, r = modal(t + h, omega, a, b)


@inlined
def next_turn(modes, state, signs, a, b):
    """Find the first event of a segment of S1 where it is sure to be the next zero of a ringing contact's rate.

    It saves `first_event` where a stiff contact rings and its rate is zero at the start. While the slow
    sinusoid of the stiff rate is smaller than its fast one, that rate is zero twice in each turn and the force of its
    contact is monotonic in between. The soft rate keeps its sign while its slow sinusoid stays above the amplitude of
    its fast one, and the force of its contact then is monotonic too: that neither force vanishes is seen at the end.
    No turning point of either rate is nearer to zero than `NEAR`. Gives time, fired and state as `first_event` does, or
    a time of zero if nothing is sure.
    """
    omega = modes.omega
    first = state[0] == 0 and modes.k1 > STIFFER * modes.k2
    fired = (first, not first, False, False)
    if not (first or (state[1] == 0 and modes.k2 > STIFFER * modes.k1)):
        return 0.0, fired, state
    stiff, soft = (modes.delta, modes.phi2) if first else (modes.phi2, modes.delta)
    s, t = signs if first else (signs[1], signs[0])
    slow, fast = sqrt(a[0] * a[0] + b[0] * b[0]), sqrt(a[1] * a[1] + b[1] * b[1])
    leaves = s * (stiff[0] * omega[0] * b[0] + stiff[1] * omega[1] * b[1]) > 0
    # The fast sinusoid is back at its value on the other side of its extremum.
    angle = 2 * atan2(b[1], a[1])
    angle = angle if angle > 0 else angle + 2 * pi
    per_turn = omega[0] / omega[1]
    cos_slow, sin_slow = cos_sin(angle * per_turn)
    q, r = (
        (a[0] * cos_slow + b[0] * sin_slow, a[1]),
        (b[0] * cos_slow - a[0] * sin_slow, -b[1]),
    )
    nearest = min(t * soft[0] * a[0], t * soft[0] * q[0])
    # Between the two ends, and in Newton's steps beyond the second, the slow sinusoid falls little below them.
    reserve = per_turn * (1 + 5 * per_turn)
    stiff_slow, stiff_fast = abs(stiff[0]) * slow, abs(stiff[1]) * fast
    soft_slow, soft_fast = abs(soft[0]) * slow, abs(soft[1]) * fast
    if not (
        leaves
        and stiff_slow < RINGING * stiff_fast
        and turns_far(stiff_slow, stiff_fast, omega[0] * omega[0], omega[1] * omega[1])
        and nearest > soft_fast + reserve * soft_slow + NEAR * (soft_slow + soft_fast)
    ):
        return 0.0, fired, state
    time, longest = angle / omega[1], LONGEST_STEP / omega[1]
    h = longest
    for _ in range(10):
        slope = stiff[0] * omega[0] * r[0] + stiff[1] * omega[1] * r[1]
        h = min(max(-(stiff[0] * q[0] + stiff[1] * q[1]) / slope, -longest), longest)
        time += h
        q, r = turn_little(h, omega, q, r)
        if abs(h) * omega[1] < LAST_STEP:
            break
    d1, v2, F1, F2 = motion(q, r, modes)
    if abs(h) * omega[1] >= LAST_STEP or F1 <= 0 or F2 <= 0:
        return 0.0, fired, state
    return time, fired, (0.0 if first else d1, v2 if first else 0.0, F1, F2)
