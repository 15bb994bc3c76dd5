"""The certified first event in S1.

In S1 up to four functions of time are watched, each positive until its event: the compression rate of a contact in
compression (falls through zero: compression ends), its negative in restitution (compression restarts), and the force
of a contact in restitution (falls to zero: restitution ends). Each is a sum of two sinusoids with known amplitudes, so
that its sixth derivative is bounded by a known C. Two facts make the search both quick and safe:

* **Certificate.** Let H be the quintic that takes the values, slopes and second derivatives of f at both ends of an
  interval of length h. Then f(x h) >= H(x h) - C h^6 x^3 (1 - x)^3/720, and since x^3 (1 - x)^3 <= (B2 + B3)/40 in
  Bernstein polynomials of degree five, f is positive inside the interval if the Bernstein coefficients of H satisfy
  b0, b1, b4, b5 >= 0 and b2, b3 > C h^6/28800 (`positive_between`). The ends themselves may be zeros: the event that
  began the stretch, and the root that will end it.
* **Envelope.** f is at least its slow sinusoid less the amplitude of its fast one, and the time at which that
  difference first comes near zero is known in closed form (`envelope_time`). It steps over thousands of fast
  oscillations that are too weak to matter.

A window is tried from the last certified time on. If a function is negative at its end, the end moves to a root of
that function; if all are positive but not certified, the window is halved; if all are certified, it is passed, or its
end, where one is zero, is the event. A pair of close roots cannot be stepped over, for no window that holds one is
certified.

**Ties.** Every watched function that is zero within rounding at the first root fires at that instant. Applying the
events in any order gives the same state, since each changes only variables of its own contact; where end of restitution
and restart of compression of one contact coincide, restitution ends (what is left to restart is zero).
"""

from __future__ import annotations

from math import cos, inf, sin, sqrt

from model.compiled import inlined
from model.motion import modal, motion, turn
from model.roots import EPSILON, NEAR, envelope_time, extremum_between, root_before
from model.sinusoid import cos_sin

#: Rounding of a watched function, relative to its amplitude.
NOISE = 4 * EPSILON

#: Windows of the search, in radians of the fast mode; C h^6/28800 is then 6 % of an amplitude.
WINDOW = 3.5
COS_WINDOW, SIN_WINDOW = cos(WINDOW), sin(WINDOW)

#: Windows shorter than this (in radians of the fast mode) resolve a tangency to rounding.
SHORTEST_WINDOW = 1e-9

#: Windows shorter than this (in radians of the fast mode) are not looked through for pairs of near-misses.
SHORTEST_WAVE = 1.0

#: The envelope is tried when the fast mode is at least this much faster than the slow one.
ENVELOPE_RATIO = 6.0

#: Near-misses at which an end of compression would lose less than this, as a fraction of the energy of impact, do not
#: count: whether it happens or not hardly changes the outcome.
STAKE = 1e-6


@inlined
def positive_between(start, end, h, C):
    """Certify f > 0 inside an interval of length h, given (f, f', f'') at its ends and its sixth derivative's bound.

    C is that bound divided by 28800. The end may be a zero, and is taken for one where rounding makes it negative.
    """
    # One comparison, for branches that cannot be foretold cost more than all of this.
    reserve = C * (h * h * h) * (h * h * h)
    last = max(end[0], 0.0)
    step0, step1 = 0.2 * h * start[1], -0.2 * h * end[1]
    bend = 0.05 * h * h
    ends = min(min(start[0], start[0] + step0), last + step1)
    middle = min(start[0] + 2 * step0 + bend * start[2], last + 2 * step1 + bend * end[2])
    return (ends >= 0) & (middle > reserve)


@inlined
def time_above_zero(start, B, w1):
    """How long a function is positive that leaves zero with start[1] > 0, or with start[1] = 0 and start[2] > 0.

    With abs(f'') <= B it is so up to t = 2 f'/B. Where its slope vanishes (contact 2 when the collision begins) its
    third derivative does as well, and with a fourth one within B w1^2 it is positive up to t^2 = 12 f''/(B w1^2).
    """
    return 0.99 * (2 * start[1] / B if start[1] > 0 else sqrt(12 * start[2] / B) / w1)


@inlined
def leaves_zero(h, start, B, w1):
    """Whether h is below `time_above_zero`, without its division."""
    return (B * h < 1.98 * start[1]) | ((start[1] == 0) & (B * (w1 * h) * (w1 * h) < 11.7 * start[2]))


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
def near_miss(h, start, end):
    """Magnitude of an extremum inside a window, by a parabola; infinite if there is none."""
    spread = start[1] - end[1]
    value = abs(start[0] + 0.5 * h * start[1] * start[1] / spread)
    return value if start[1] * end[1] < 0 else inf


@inlined
def two_extrema(h, start, end):
    """Whether a function may turn twice inside a window: seen from either end, its slope tends to zero and beyond."""
    here, there = start[1] * (start[1] + h * start[2]), end[1] * (end[1] - h * end[2])
    return (start[1] * end[1] > 0) & (here < 0) & (there < 0)


@inlined
def first_event(mu, k1, k2, state, signs, watched, losses, shape, omega, a, b, margin):
    """Time of the first event of an S1 stretch, and which of the watched functions fire.

    Parameters
    ----------
    mu, k1, k2 : float
        m2/m1 and the running stiffnesses.
    state : 4 floats
        d1, v2, F1, F2 at the start. A rate that is exactly zero there began the stretch; that is not an event.
    signs : pair
        Of d1 and v2, so that the watched rates signs[0] d1 and signs[1] v2 are positive until their events.
    watched : pair of bools
        Whether the forces are watched (contacts in restitution); the rates always are.
    losses : pair
        1 - e_i^2, the share of its energy a contact loses at an end of compression.
    shape : 4 pairs
        delta, phi2, force1, force2 of `model.motion.modes`.
    omega, a, b : pairs
        Frequencies and modal coordinates at the start.
    margin : float
        Of the stretches before.

    Returns
    -------
    time : float
        Since the start of the stretch.
    fired : 4 bools
        Which of rate 1, rate 2, force 1, force 2 reach zero at that time.
    state : 4 floats
        d1, v2, F1, F2 at that time.
    margin : float
        Smallest magnitude, relative to its amplitude, of a local extremum of a rate passed so far where an end of
        compression would have lost more than `STAKE` (infinity if there was none).
    steps : int
        Windows tried, a measure of cost.
    """
    delta, phi2, force1, force2 = shape
    s1, s2 = signs
    w0, w1 = omega
    inverse_mu, inverse_M = 1 / mu, 1 + 1 / mu
    radius = (sqrt(a[0] * a[0] + b[0] * b[0]), sqrt(a[1] * a[1] + b[1] * b[1]))
    slow, fast, slow2, fast2 = radius[0], radius[1], w0 * w0, w1 * w1
    slow6, fast6 = slow2 * slow2 * slow2 / 28800, fast2 * fast2 * fast2 / 28800
    x0, x1 = abs(delta[0]) * slow, abs(delta[1]) * fast
    size0, C0, B0 = x0 + x1, x0 * slow6 + x1 * fast6, x0 * slow2 + x1 * fast2
    x0, x1 = abs(phi2[0]) * slow, abs(phi2[1]) * fast
    size1, C1, B1 = x0 + x1, x0 * slow6 + x1 * fast6, x0 * slow2 + x1 * fast2
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

    # Modal coordinates after one window: its angle in the fast mode is always the same.
    cos_slow, sin_slow = cos_sin(w0 * window)
    q, r = turn(cos_slow, sin_slow, COS_WINDOW, SIN_WINDOW, a, b)
    while True:
        steps += 1
        late = 1 + w1 * (t + h)  # the phases are rounded too
        z0, z1, z2, z3 = late * noise0, late * noise1, late * noise2, late * noise3
        d1, v2, F1, F2 = motion(q, r, delta, phi2, force1, force2)
        d1, v2 = (0.0 if chased == 0 else d1), (0.0 if chased == 1 else v2)
        F1, F2 = (0.0 if chased == 2 else F1), (0.0 if chased == 3 else F2)
        g0, g1, g2, g3 = jets(d1, v2, F1, F2, signs, k1, k2, inverse_mu, inverse_M)
        spared0, spared1 = fresh0 & leaves_zero(h, f0, B0, w1), fresh1 & leaves_zero(h, f1, B1, w1)
        below0, below1 = (g0[0] < -z0) & ~spared0, (g1[0] < -z1) & ~spared1
        below2, below3 = (g2[0] < -z2) & watched[0], (g3[0] < -z3) & watched[1]

        if below0 | below1 | below2 | below3:
            high, u, v = h, a, b
            if below0:
                chased, c, start, end, noise = 0, (s1 * delta[0], s1 * delta[1]), f0, g0, z0
                low = time_above_zero(f0, B0, w1) if fresh0 else 0.0
            elif below1:
                chased, c, start, end, noise = 1, (s2 * phi2[0], s2 * phi2[1]), f1, g1, z1
                low = time_above_zero(f1, B1, w1) if fresh1 else 0.0
            elif below2:
                chased, c, start, end, noise, low = 2, force1, f2, g2, z2, 0.0
                u, v = b, (-a[0], -a[1])
            else:
                chased, c, start, end, noise, low = 3, force2, f3, g3, z3, 0.0
                u, v = b, (-a[0], -a[1])
            h, u, v = root_before(c, t, h, low, start, end, noise, omega, u, v)
            q, r = ((-v[0], -v[1]), u) if chased > 1 else (u, v)
            continue

        spared0 |= fresh0 & (g0[0] <= z0) & (g0[1] >= 0)
        spared1 |= fresh1 & (g1[0] <= z1) & (g1[1] >= 0)
        sure0, sure1 = spared0 | positive_between(f0, g0, h, C0), spared1 | positive_between(f1, g1, h, C1)
        sure2 = positive_between(f2, g2, h, C2) | ~watched[0]
        sure3 = positive_between(f3, g3, h, C3) | ~watched[1]
        sure = sure0 & sure1 & sure2 & sure3
        waves = (two_extrema(h, f0, g0) | two_extrema(h, f1, g1)) & (h * w1 > SHORTEST_WAVE)
        if (not sure and h * w1 > SHORTEST_WINDOW) or waves:
            h, chased = 0.5 * h, -1
            q, r = modal(t + h, omega, a, b)
            continue

        # The window is accepted. Near-misses of the rates on the way:
        if (
            near_miss(h, f0, g0) < max(margin, NEAR) * size0
            and losses[0] * (f2[0] + g2[0]) ** 2 > 4 * STAKE * k1
        ):
            c = (s1 * delta[0], s1 * delta[1])
            margin = min(margin, extremum_between(c, t, h, f0, g0, size0, omega, a, b))
        if (
            near_miss(h, f1, g1) < max(margin, NEAR) * size1
            and losses[1] * (f3[0] + g3[0]) ** 2 > 4 * STAKE * k2
        ):
            c = (s2 * phi2[0], s2 * phi2[1])
            margin = min(margin, extremum_between(c, t, h, f1, g1, size1, omega, a, b))
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
            skip = min(
                envelope_time(0, (s1 * delta[0], s1 * delta[1]), t, omega, a, b, radius),
                envelope_time(0, (s2 * phi2[0], s2 * phi2[1]), t, omega, a, b, radius),
            )
            if watched[0]:
                skip = min(skip, envelope_time(1, force1, t, omega, a, b, radius))
            if watched[1]:
                skip = min(skip, envelope_time(1, force2, t, omega, a, b, radius))
            if skip > t + window:
                t = skip
                q, r = modal(t, omega, a, b)
                d1, v2, F1, F2 = motion(q, r, delta, phi2, force1, force2)
                f0, f1, f2, f3 = jets(d1, v2, F1, F2, signs, k1, k2, inverse_mu, inverse_M)
                q, r = modal(t + h, omega, a, b)
