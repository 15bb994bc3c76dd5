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

An interval that is neither certified nor brackets a root is halved. A pair of close roots cannot be stepped over, for
no interval that holds one is certified.

**Ties.** Every watched function that is zero within rounding at the first root fires at that instant. Applying the
events in any order gives the same state, since each changes only variables of its own contact; where end of restitution
and restart of compression of one contact coincide, restitution ends (what is left to restart is zero).
"""

from __future__ import annotations

from math import acos, atan2, hypot, inf, pi, sqrt

from numba import njit

from model.motion import modal

EPSILON = 2.0**-52

#: First window of the search, in radians of the fast mode; C h^4/288 is then 1 % of an amplitude.
WINDOW = 1.3

#: Windows shorter than this (in radians of the fast mode) resolve a tangency to rounding.
SHORTEST_WINDOW = 1e-9

#: The envelope is tried when the fast mode is at least this much faster than the slow one.
ENVELOPE_RATIO = 6.0

#: How far from zero, relative to its slow amplitude, a function stays where the envelope steps over it.
ENVELOPE_RESERVE = 0.05


@njit(cache=True, error_model="numpy")
def positive_between(f0, df0, f1, df1, h, C):
    """Certify f > 0 inside an interval of length h, given values and slopes at its ends and abs(f'''') <= C."""
    reserve = C * h**4 / 288
    return f0 >= 0 and f1 >= 0 and f0 + h * df0 / 3 > reserve and f1 - h * df1 / 3 > reserve


@njit(cache=True, error_model="numpy")
def value(order, c, q, p, omega):
    """f, f', f'' of a watched function f = sum c_j q_j (order 0) or sum c_j q_j' (order 1)."""
    zeroth = c[0] * q[0] + c[1] * q[1]
    first = c[0] * p[0] + c[1] * p[1]
    w0, w1 = -omega[0] * omega[0], -omega[1] * omega[1]
    second = w0 * c[0] * q[0] + w1 * c[1] * q[1]
    if order == 0:
        return zeroth, first, second
    return first, second, w0 * c[0] * p[0] + w1 * c[1] * p[1]


@njit(cache=True, error_model="numpy")
def envelope_time(order, c, t, omega, a, b, radius):
    """Earliest time from t on at which the slow sinusoid of a watched function comes near its fast amplitude.

    Near is within `ENVELOPE_RESERVE` of the slow amplitude, so that no near-miss is stepped over unseen.
    """
    slow = abs(c[0]) * radius[0]
    fast = abs(c[1]) * radius[1]
    if order == 1:
        slow *= omega[0]
        fast *= omega[1]
    fast += ENVELOPE_RESERVE * slow
    if slow <= fast:
        return t
    # the slow part is slow * cos(omega t - phase)
    phase = atan2(b[0], a[0])
    if order == 1:
        phase -= 0.5 * pi
    if c[0] < 0:
        phase += pi
    now = (omega[0] * t - phase) % (2 * pi)
    if now > pi:
        now -= 2 * pi
    limit = acos(fast / slow)
    if abs(now) >= limit:
        return t
    return t + (limit - now) / omega[0]


@njit(cache=True, error_model="numpy")
def root_between(order, c, t, h, f0, df0, f1, df1, tolerance, omega, a, b):
    """Root of a watched function in (t, t + h], where f > 0 at t (or f = 0 and f' > 0) and f <= 0 at t + h.

    Halley's iteration, kept inside the bracket by bisection, from the root of a parabola.
    """
    low, high = 0.0, h
    # the parabola with f1, df1 and f0: starts within a few per cent of a simple root
    curve = (f0 - f1 + h * df1) / (h * h)
    discriminant = df1 * df1 - 4 * curve * f1
    x = 0.5 * h
    if discriminant > 0 and df1 < 0:
        x = h + 2 * f1 / (-df1 + sqrt(discriminant))
    if not low < x <= high:
        x = 0.5 * h
    for _ in range(100):
        q, p = modal(t + x, omega, a, b)
        f, df, ddf = value(order, c, q, p, omega)
        if f > 0:
            low = x
        else:
            high = x
        if abs(f) <= tolerance:
            break
        step = -2 * f * df / (2 * df * df - f * ddf) if df < 0 else 0.0
        nxt = x + step
        if not low < nxt < high or step == 0.0:
            nxt = 0.5 * (low + high)
        if abs(nxt - x) <= EPSILON * (t + x):
            x = nxt
            break
        x = nxt
    return x


@njit(cache=True, error_model="numpy")
def extremum_between(c, t, h, f0, df0, df1, omega, a, b):
    """Time in (t, t + h) and value of the extremum of a watched rate whose slopes at the ends differ in sign.

    A parabola places it; where it comes near zero, and so matters, Newton's iteration on f' makes it exact.
    """
    low, high = 0.0, h
    x = h * df0 / (df0 - df1)
    f = f0 + 0.5 * df0 * x
    if abs(f) > 0.2:
        return x, f
    for _ in range(20):
        q, p = modal(t + x, omega, a, b)
        f, df, ddf = value(0, c, q, p, omega)
        if df * df0 > 0:
            low = x
        else:
            high = x
        nxt = x - df / ddf if ddf != 0 else low
        if not low < nxt < high:
            nxt = 0.5 * (low + high)
        if abs(nxt - x) < 1e-6 * h:
            break
        x = nxt
    return x, f


@njit(cache=True, error_model="numpy")
def first_event(active, order, c, zero_at_start, slope_at_start, curve_at_start, omega, a, b):
    """Time of the first event of an S1 stretch, and which of the watched functions fire.

    Parameters
    ----------
    active : 4 bools
        Which functions are watched.
    order : 4 ints
        0: a rate, sum c_j q_j; 1: a force, sum c_j q_j'.
    c : 4 pairs
        Coefficients on the slow and the fast mode.
    zero_at_start : 4 bools
        Which functions are zero when the stretch begins; that zero is not an event.
    slope_at_start, curve_at_start : 4 floats
        Their first and second derivatives there, from the equations of motion.
    omega, a, b : pairs
        Frequencies and modal coordinates at the start.

    Returns
    -------
    time : float
        Since the start of the stretch.
    fired : 4 bools
        Which functions reach zero at that time.
    margin : float
        Smallest magnitude of a local extremum of a watched rate passed on the way (infinity if none was).
    steps : int
        Windows tried, a measure of cost.
    """
    radius = (hypot(a[0], b[0]), hypot(a[1], b[1]))
    sizes = (radius, (radius[0] * omega[0], radius[1] * omega[1]))
    slow4, fast4 = omega[0] ** 4, omega[1] ** 4
    window = WINDOW / omega[1]
    envelope = omega[1] > ENVELOPE_RATIO * omega[0]
    margin = inf
    steps = 0
    t = 0.0
    h = window

    for i in range(4):
        if active[i] and zero_at_start[i]:
            if slope_at_start[i] < 0 or (slope_at_start[i] == 0 and curve_at_start[i] < 0):
                return 0.0, (i == 0, i == 1, i == 2, i == 3), 0.0, 0  # it leaves its zero downwards
            if slope_at_start[i] == 0:
                # A double zero: contact 2 when the collision begins. Start off the expansion, whose third
                # derivative vanishes: f >= f'' t^2/2 - C t^4/24 is positive up to t^2 = 12 f''/C.
                size = sizes[order[i]]
                C = abs(c[i][0]) * size[0] * slow4 + abs(c[i][1]) * size[1] * fast4
                h = min(h, sqrt(6 * curve_at_start[i] / C))

    q, p = modal(0.0, omega, a, b)
    while True:
        steps += 1
        if envelope:
            skip = inf
            for i in range(4):
                if active[i]:
                    skip = min(skip, envelope_time(order[i], c[i], t, omega, a, b, radius))
            if skip > t + 0.5 * window:
                t = skip
                q, p = modal(t, omega, a, b)
        q1, p1 = modal(t + h, omega, a, b)
        first, found = h, -1
        nearest1, nearest2 = (inf, inf), (inf, inf)  # time and value of an extremum of either rate
        certified = True
        for i in range(4):
            if not active[i]:
                continue
            f0, df0, _ = value(order[i], c[i], q, p, omega)
            f1, df1, _ = value(order[i], c[i], q1, p1, omega)
            size = sizes[order[i]]
            tolerance = 4 * EPSILON * (abs(c[i][0]) * size[0] + abs(c[i][1]) * size[1])
            C = abs(c[i][0]) * size[0] * slow4 + abs(c[i][1]) * size[1] * fast4
            double = False
            if t == 0.0 and zero_at_start[i]:
                f0, df0 = 0.0, slope_at_start[i]
                double = df0 == 0
            elif f0 < 0:
                f0 = 0.0  # rounding, at a point already certified
            if order[i] == 0 and df0 * df1 < 0:
                if i == 0:
                    nearest1 = extremum_between(c[i], t, h, f0, df0, df1, omega, a, b)
                else:
                    nearest2 = extremum_between(c[i], t, h, f0, df0, df1, omega, a, b)
            if f1 > 0 and (double or positive_between(f0, df0, f1, df1, h, C)):
                continue
            if f1 <= tolerance and not double:
                x = root_between(order[i], c[i], t, h, f0, df0, f1, df1, tolerance, omega, a, b)
                qx, px = modal(t + x, omega, a, b)
                _, dfx, _ = value(order[i], c[i], qx, px, omega)
                if positive_between(f0, df0, 0.0, dfx, x, C) or h * omega[1] < SHORTEST_WINDOW:
                    if x <= first:
                        first, found = x, i
                    continue
            if h * omega[1] < SHORTEST_WINDOW:
                if f1 <= 4 * tolerance:
                    first, found = 0.0, i  # a tangency, to rounding
                continue
            certified = False
            break
        if not certified:
            h *= 0.5
            continue
        if nearest1[0] <= first:
            margin = min(margin, abs(nearest1[1]))
        if nearest2[0] <= first:
            margin = min(margin, abs(nearest2[1]))
        t += first
        if found >= 0:
            break
        q, p = q1, p1
        h = min(2 * h, window)

    q, p = modal(t, omega, a, b)
    fired = (False, False, False, False)
    for i in range(4):
        if active[i]:
            f, _, _ = value(order[i], c[i], q, p, omega)
            size = sizes[order[i]]
            noise = (8 + omega[1] * t) * EPSILON * (abs(c[i][0]) * size[0] + abs(c[i][1]) * size[1])
            if i == found or (f <= noise and not zero_at_start[i]):
                fired = (
                    fired[0] or i == 0,
                    fired[1] or i == 1,
                    fired[2] or i == 2,
                    fired[3] or i == 3,
                )
    return t, fired, margin, steps
