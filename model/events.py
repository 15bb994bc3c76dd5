"""The certified first event in S1.

In S1 up to four functions of time are watched, each positive until its event: the compression rate of a contact in
compression (falls through zero: compression ends), its negative in restitution (compression restarts), and the force
of a contact in restitution (falls to zero: restitution ends). Each is a sum of two sinusoids with known amplitudes, so
that its fourth derivative is bounded by a known C. Two facts make the search both quick and safe:

* **Certificate.** Let H be the cubic that takes the values and slopes of f at both ends of an interval of length h.
  Then f(x h) >= H(x h) - C h^4 x^2 (1 - x)^2/24, and since x^2 (1 - x)^2 <= (B1 + B2)/12 in Bernstein polynomials of
  degree three, f is positive inside the interval if the Bernstein coefficients of H satisfy b0 >= 0, b3 >= 0,
  b1 > C h^4/288 and b2 > C h^4/288 (`positive_between`). The ends themselves may be zeros: the event that began the
  stretch, and the root that will end it.
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

from math import inf, sqrt

from model.compiled import compiled
from model.motion import modal, motion
from model.roots import EPSILON, envelope_time, extremum_between, root_before

THIRD = 1 / 3

#: Rounding of a watched function, relative to its amplitude.
NOISE = 4 * EPSILON

#: First window of the search, in radians of the fast mode; C h^4/288 is then 7 % of an amplitude.
WINDOW = 2.1

#: Windows shorter than this (in radians of the fast mode) resolve a tangency to rounding.
SHORTEST_WINDOW = 1e-9

#: The envelope is tried when the fast mode is at least this much faster than the slow one.
ENVELOPE_RATIO = 6.0

#: Near-misses at which an end of compression would lose less than this, as a fraction of the energy of impact, do not
#: count: whether it happens or not hardly changes the outcome.
STAKE = 1e-6

# What a window says of one function: certified positive; zero at the end and certified before; negative at the end;
# positive at the end but not certified.
CLEAR, ZERO, NEGATIVE, UNSURE = 0, 1, 2, 3


@compiled
def positive_between(f0, df0, f1, df1, h, C):
    """Certify f > 0 inside an interval of length h, given values and slopes at its ends and abs(f'''') <= 288 C."""
    reserve = C * (h * h) * (h * h)
    return f0 >= 0 and f1 >= 0 and f0 + THIRD * h * df0 > reserve and f1 - THIRD * h * df1 > reserve


@compiled
def judge(h, f0, df0, f1, df1, noise, C, fresh, safe):
    """Say what a window of length h tells of one function.

    `fresh` marks a function that began the stretch at zero, while the window still starts there; up to `safe` it is
    known to be positive.
    """
    if f1 > noise:
        return CLEAR if h <= safe or positive_between(f0, df0, f1, df1, h, C) else UNSURE
    if h <= safe or (fresh and f1 >= -noise and df1 >= 0):
        return CLEAR
    if f1 < -noise:
        return NEGATIVE
    return ZERO if positive_between(f0, df0, 0.0, df1, h, C) else UNSURE


@compiled
def first_event(mu, k1, k2, state, signs, watched, losses, shape, omega, a, b):
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
        phi1, phi2, delta, sigma of `model.motion.modes`.
    omega, a, b : pairs
        Frequencies and modal coordinates at the start.

    Returns
    -------
    time : float
        Since the start of the stretch.
    fired : 4 bools
        Which of rate 1, rate 2, force 1, force 2 reach zero at that time.
    state : 4 floats
        d1, v2, F1, F2 at that time.
    margin : float
        Smallest magnitude, relative to its amplitude, of a local extremum of a rate passed on the way where an end of
        compression would have lost more than `STAKE` (infinity if there was none).
    steps : int
        Windows tried, a measure of cost.
    """
    phi1, phi2, delta, sigma = shape
    s1, s2 = signs
    w0, w1 = omega
    inverse_mu, inverse_M = 1 / mu, 1 + 1 / mu
    radius = (sqrt(a[0] * a[0] + b[0] * b[0]), sqrt(a[1] * a[1] + b[1] * b[1]))
    slow, fast, slow4, fast4 = radius[0], radius[1], w0 * w0 * w0 * w0, w1 * w1 * w1 * w1
    x0, x1 = abs(delta[0]) * slow, abs(delta[1]) * fast
    size0, C0, B0 = x0 + x1, (x0 * slow4 + x1 * fast4) / 288, x0 * w0 * w0 + x1 * w1 * w1
    x0, x1 = abs(phi2[0]) * slow, abs(phi2[1]) * fast
    size1, C1, B1 = x0 + x1, (x0 * slow4 + x1 * fast4) / 288, x0 * w0 * w0 + x1 * w1 * w1
    x0, x1 = abs(phi1[0]) * slow * w0, abs(phi1[1]) * fast * w1
    noise2, C2 = NOISE * (x0 + x1), (x0 * slow4 + x1 * fast4) / 288
    x0, x1 = abs(sigma[0]) * slow * w0, abs(sigma[1]) * fast * w1
    noise3, C3 = NOISE * (x0 + x1), (x0 * slow4 + x1 * fast4) / 288

    noise0, noise1 = NOISE * size0, NOISE * size1

    d1, v2, F1, F2 = state
    f0, f1, f2, f3 = s1 * d1, s2 * v2, F1, F2
    df0, df1 = s1 * (F2 * inverse_mu - F1 * inverse_M), s2 * (F2 - F1) * inverse_mu
    df2, df3 = k1 * d1, -k2 * v2
    fresh0, fresh1 = d1 == 0, v2 == 0
    safe0 = safe1 = 0.0
    window = WINDOW / w1
    t, h, high = 0.0, window, inf
    margin = inf
    steps = passed = 0
    chased = -1

    # A rate that starts below zero, by rounding, has its event behind it.
    if f0 < 0 or f1 < 0:
        return 0.0, (f0 < 0, f1 < 0, False, False), state, 0.0, 0
    # One that starts at zero must leave it upwards, and with |f''| <= B it is positive up to t = 2 f'/B. Where its
    # slope vanishes too (contact 2 when the collision begins), start off the expansion: f >= f'' t^2/2 - C t^4/24, its
    # third derivative being zero there, is positive up to t^2 = 12 f''/C.
    if fresh0:
        curve = -s1 * k2 * v2 * inverse_mu
        if df0 < 0 or (df0 == 0 and curve < 0):
            return 0.0, (True, False, False, False), state, 0.0, 0
        safe0 = 0.99 * (2 * df0 / B0 if df0 > 0 else sqrt(12 * curve / (288 * C0)))
    if fresh1:
        curve = -s2 * k1 * d1 * inverse_mu
        if df1 < 0 or (df1 == 0 and curve < 0):
            return 0.0, (False, True, False, False), state, 0.0, 0
        safe1 = 0.99 * (2 * df1 / B1 if df1 > 0 else sqrt(12 * curve / (288 * C1)))
    if (fresh0 and df0 == 0) or (fresh1 and df1 == 0):
        h = min(h, max(safe0, safe1))

    q, p = modal(h, omega, a, b)
    while True:
        steps += 1
        d1, v2, F1, F2 = motion(q, p, phi1, phi2, delta, sigma)
        g0, g1, g2, g3 = s1 * d1, s2 * v2, F1, F2
        if chased == 0:
            g0 = 0.0
        elif chased == 1:
            g1 = 0.0
        elif chased == 2:
            g2 = 0.0
        elif chased == 3:
            g3 = 0.0
        dg0, dg1 = s1 * (F2 * inverse_mu - F1 * inverse_M), s2 * (F2 - F1) * inverse_mu
        dg2, dg3 = k1 * d1, -k2 * v2
        late = 1 + w1 * (t + h)  # the phases are rounded too
        verdict0 = judge(h, f0, df0, g0, dg0, late * noise0, C0, fresh0, safe0)
        verdict1 = judge(h, f1, df1, g1, dg1, late * noise1, C1, fresh1, safe1)
        verdict2 = judge(h, f2, df2, g2, dg2, late * noise2, C2, False, 0.0) if watched[0] else CLEAR
        verdict3 = judge(h, f3, df3, g3, dg3, late * noise3, C3, False, 0.0) if watched[1] else CLEAR
        worst = max(max(verdict0, verdict1), max(verdict2, verdict3))

        if worst == NEGATIVE:
            high = h
            if verdict0 == NEGATIVE:
                chased, c0, c1, base, dbase, noise, low = (
                    0,
                    s1 * delta[0],
                    s1 * delta[1],
                    f0,
                    df0,
                    noise0,
                    safe0,
                )
            elif verdict1 == NEGATIVE:
                chased, c0, c1, base, dbase, noise, low = (
                    1,
                    s2 * phi2[0],
                    s2 * phi2[1],
                    f1,
                    df1,
                    noise1,
                    safe1,
                )
            elif verdict2 == NEGATIVE:
                chased, c0, c1, base, dbase, noise, low = 2, phi1[0], phi1[1], f2, df2, noise2, 0.0
            else:
                chased, c0, c1, base, dbase, noise, low = 3, sigma[0], sigma[1], f3, df3, noise3, 0.0
            h, q, p = root_before(chased > 1, c0, c1, t, h, low, base, dbase, q, p, late * noise, omega, a, b)
            continue
        if worst == UNSURE and h * w1 > SHORTEST_WINDOW:
            h, chased = 0.5 * h, -1
            q, p = modal(t + h, omega, a, b)
            continue

        # The window is accepted. Near-misses of the rates on the way:
        if dg0 * df0 < 0 and losses[0] * (f2 + g2) * (f2 + g2) > 4 * STAKE * k1:
            c = (s1 * delta[0], s1 * delta[1])
            margin = min(margin, abs(extremum_between(c, t, h, f0, df0, dg0, size0, omega, a, b)) / size0)
        if dg1 * df1 < 0 and losses[1] * (f3 + g3) * (f3 + g3) > 4 * STAKE * k2:
            c = (s2 * phi2[0], s2 * phi2[1])
            margin = min(margin, abs(extremum_between(c, t, h, f1, df1, dg1, size1, omega, a, b)) / size1)
        t += h
        if worst != CLEAR:
            # Zero within rounding fires; so does what is unsure at the shortest window and as good as zero.
            fired = (
                verdict0 != CLEAR and g0 <= 4 * late * noise0,
                verdict1 != CLEAR and g1 <= 4 * late * noise1,
                verdict2 != CLEAR and g2 <= 4 * late * noise2,
                verdict3 != CLEAR and g3 <= 4 * late * noise3,
            )
            if fired[0] or fired[1] or fired[2] or fired[3]:
                return t, fired, (d1, v2, F1, F2), margin, steps
        f0, df0, f1, df1, f2, df2, f3, df3 = g0, dg0, g1, dg1, g2, dg2, g3, dg3
        fresh0 = fresh1 = False
        safe0 = safe1 = 0.0
        chased = -1
        if high < inf:
            high -= h
            if high > 0:
                h = high  # some function is negative there
                q, p = modal(t + h, omega, a, b)
                continue
            high = inf
        h = min(2 * h, window)
        passed += 1
        if passed % 6 == 5 and w1 > ENVELOPE_RATIO * w0:
            skip = min(
                envelope_time(0, (s1 * delta[0], s1 * delta[1]), t, omega, a, b, radius),
                envelope_time(0, (s2 * phi2[0], s2 * phi2[1]), t, omega, a, b, radius),
            )
            if watched[0]:
                skip = min(skip, envelope_time(1, phi1, t, omega, a, b, radius))
            if watched[1]:
                skip = min(skip, envelope_time(1, sigma, t, omega, a, b, radius))
            if skip > t + window:
                t = skip
                q, p = modal(t, omega, a, b)
                d1, v2, f2, f3 = motion(q, p, phi1, phi2, delta, sigma)
                f0, f1 = s1 * d1, s2 * v2
                df0, df1 = s1 * (f3 * inverse_mu - f2 * inverse_M), s2 * (f3 - f2) * inverse_mu
                df2, df3 = k1 * d1, -k2 * v2
        q, p = modal(t + h, omega, a, b)
