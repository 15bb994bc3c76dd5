"""Search for the first event of two balls in state S1, in which both contacts are active. No event can be missed.

`first_event` is the search; the other functions are its steps. At most four functions of time are watched. Each
function is positive until its event, at which it falls to zero:

* the rate of compression of a contact in compression: at its zero, compression ends;
* minus the rate of compression of a contact in restitution: at its zero, compression restarts;
* the force of a contact in restitution: at its zero, restitution ends.

Each function is a sum of two sinusoids with known amplitudes, so its derivatives have known bounds. Two facts make the
search both quick and safe:

* **Proof by end values.** The values, slopes and second derivatives of a function at both ends of a window can prove
  that the function is positive inside the window (`pair.roots.positive_between`). It is then called certified.
* **Envelope.** A function is at least its slow sinusoid minus the amplitude of its fast sinusoid. The first time at
  which this difference is near zero has a closed form (`pair.roots.envelope_time`). So the search steps over thousands
  of fast oscillations that are too weak to matter.

The search tries a window, a time that begins where the last certified window ended (`evaluate`). There are three cases:

* A function is negative at the end of the window. The end is moved to a root of this function (`chase_root`).
* All functions are positive at the end, but not all are certified. The window is halved.
* All functions are certified. The window is done, and `margin_after` searches it for turning points near zero. If a
  function is zero at the end of the window, this end is the event.

A pair of close roots cannot be stepped over, because no window that contains such a pair can be certified.

**Simultaneous events.** Every watched function that is zero within rounding at the first root has its event at this
time. Any order of these events would give the same result, because each event changes only its own contact. If the
force of a contact is zero when its compression would restart, restitution just ends: no force is left to restart.

Needs `pair.motion`, `pair.roots` and `pair.grazing`. Used by `pair.kernel`.
"""

from __future__ import annotations

from enum import IntEnum
from math import cos, inf, pi, sin, sqrt
from typing import Any, NamedTuple

from impact_xval.model.compiled import force_inlined
from impact_xval.model.pair.grazing import NEAR, STAKE, nearest_turn, stays_far, turns_far
from impact_xval.model.pair.motion import Modes, Motion, cos_sin, modal_coordinates, motion_of, rotate
from impact_xval.model.pair.roots import (
    EPSILON,
    Jet,
    envelope_time,
    leaves_zero,
    positive_between,
    root_before,
    time_above_zero,
)

#: Rounding error of a watched function, as a share of its amplitude.
NOISE = 4 * EPSILON

#: Length of a window in radians of the fast mode. The reserve C h^6/28800 (`pair.roots`) is then 6 % of an amplitude.
WINDOW = 3.5
COS_WINDOW, SIN_WINDOW = cos(WINDOW), sin(WINDOW)

#: Length in radians of the fast mode below which a window is not halved any further: within it a function touches zero
#: to rounding.
SHORTEST_WINDOW = 1e-9

#: Ratio of the frequencies of the fast and the slow mode above which the search tries to step over fast oscillations,
#: at every sixth window (`clear_until`).
ENVELOPE_RATIO = 6.0

#: Largest number of windows of a collision; they take half a second. A collision that needs more is given up.
MOST_WINDOWS = 5_000_000


class Function(IntEnum):
    """Name of one of the four watched functions, or of none."""

    RATE1 = 0
    RATE2 = 1
    FORCE1 = 2
    FORCE2 = 3
    NONE = 4


class Four(NamedTuple):
    """One value for each of the four watched functions."""

    rate1: Any
    rate2: Any
    force1: Any
    force2: Any


class Segment(NamedTuple):
    """A segment of the state S1: a time without events, in which both contacts are active. Its end is searched for."""

    #: Mass ratio m2/m1.
    mu: float
    #: Natural modes for the running stiffnesses.
    modes: Modes
    #: Signs with which the rates d1 and v2 are multiplied, so that they are positive until their events.
    signs: tuple[float, float]
    #: Whether the force of each contact is watched, which is so in restitution.
    watches_force: tuple[bool, bool]
    #: Share 1 - e_i^2 of its strain energy that each contact loses at an end of compression.
    losses: tuple[float, float]
    #: Modal coordinates q and r at the start of the segment (`pair.motion.amplitudes`).
    a: tuple[float, float]
    b: tuple[float, float]


class Event(NamedTuple):
    """First event of a segment."""

    #: Time since the start of the segment.
    time: float
    #: Whether each watched function is zero at that time. All four are False if the search was given up.
    fired: Four
    #: Rates and forces at that time.
    motion: Motion
    #: Grazing margin so far (`pair.grazing`); infinite if no rate had a turning point near zero.
    margin: float
    #: Number of windows tried; `MOST_WINDOWS` if numbers overflow, so that no window can be certified.
    windows: int


class Bounds(NamedTuple):
    """Bounds of one watched function and of its derivatives, valid for a whole segment."""

    #: Sum of the amplitudes of its two sinusoids.
    size: float
    #: Rounding error of its values.
    noise: float
    #: Bound of its second derivative.
    second: float
    #: Bound of its sixth derivative, divided by 28800.
    sixth: float
    #: Whether the function may have a turning point near zero.
    may_graze: bool


@force_inlined
def bounds_of(c, radius, omega):
    """Return the bounds of a function with the coefficients c of both modes.

    `radius` holds the amplitudes of the modal coordinates, and `omega` the frequencies.
    """
    slow2, fast2 = omega[0] * omega[0], omega[1] * omega[1]
    slow6, fast6 = slow2 * slow2 * slow2 / 28800, fast2 * fast2 * fast2 / 28800
    slow, fast = abs(c[0]) * radius[0], abs(c[1]) * radius[1]
    return Bounds(
        size=slow + fast,
        noise=NOISE * (slow + fast),
        second=slow * slow2 + fast * fast2,
        sixth=slow * slow6 + fast * fast6,
        may_graze=not turns_far(slow, fast, slow2, fast2),
    )


@force_inlined
def bounds_of_all(segment, radius):
    """Return the bounds of the four watched functions and of their derivatives, valid for a whole segment."""
    modes = segment.modes
    return Four(
        bounds_of(modes.delta, radius, modes.omega),
        bounds_of(modes.phi2, radius, modes.omega),
        bounds_of(modes.force1, radius, modes.omega),
        bounds_of(modes.force2, radius, modes.omega),
    )


@force_inlined
def jets_of(motion, segment):
    """Return value, slope and second derivative of the four watched functions: both signed rates and both forces."""
    sign1, sign2 = segment.signs
    k1, k2, inverse_mu, inverse_M = segment.modes.k1, segment.modes.k2, 1 / segment.mu, 1 + 1 / segment.mu
    d1, v2, F1, F2 = motion.d1, motion.v2, motion.F1, motion.F2
    a1, a2 = F2 * inverse_mu - F1 * inverse_M, (F2 - F1) * inverse_mu
    g1, g2 = k1 * d1, -k2 * v2
    return Four(
        Jet(sign1 * d1, sign1 * a1, sign1 * (g2 * inverse_mu - g1 * inverse_M)),
        Jet(sign2 * v2, sign2 * a2, sign2 * (g2 - g1) * inverse_mu),
        Jet(F1, g1, k1 * a1),
        Jet(F2, g2, -k2 * a2),
    )


@force_inlined
def higher_derivatives(jets, segment):
    """Return the third and the fourth derivative of both watched rates, as one pair for each rate."""
    sign1, sign2 = segment.signs
    k1, k2, inverse_mu, inverse_M = segment.modes.k1, segment.modes.k2, 1 / segment.mu, 1 + 1 / segment.mu
    a1, a2 = jets.force1.bend, jets.force2.bend
    g1, g2 = k1 * sign1 * jets.rate1.bend, -k2 * sign2 * jets.rate2.bend
    return (
        (sign1 * (a2 * inverse_mu - a1 * inverse_M), sign1 * (g2 * inverse_mu - g1 * inverse_M)),
        (sign2 * (a2 - a1) * inverse_mu, sign2 * (g2 - g1) * inverse_mu),
    )


@force_inlined
def is_past(jet, fresh):
    """Return whether the event of a rate is due at the very start of the segment.

    Rounding may make a rate start below zero. A `fresh` rate is exactly zero at the start, because its own event began
    the segment. Its next event is due at once if it falls from zero.
    """
    falls = jet.slope < 0 or (jet.slope == 0 and jet.bend < 0)
    return jet.value < 0 or (fresh and falls)


@force_inlined
def evaluate(q, r, segment, chased):
    """Return the motion at the end of a window, and value, slope and second derivative of all watched functions.

    The end of the window is a root of the function `chased`, so this function is set to exactly zero.
    """
    motion = motion_of(q, r, segment.modes)
    motion = Motion(
        0.0 if chased == Function.RATE1 else motion.d1,
        0.0 if chased == Function.RATE2 else motion.v2,
        0.0 if chased == Function.FORCE1 else motion.F1,
        0.0 if chased == Function.FORCE2 else motion.F2,
    )
    return motion, jets_of(motion, segment)


@force_inlined
def any_of(four):
    """Return whether any of four flags is set, without a branch."""
    return four.rate1 | four.rate2 | four.force1 | four.force2


@force_inlined
def noise_at(segment, bounds, time):
    """Return the rounding errors of the four watched functions at a time of the segment. They grow with the phases."""
    growth = 1 + segment.modes.omega[1] * time
    return Four(
        growth * bounds.rate1.noise,
        growth * bounds.rate2.noise,
        growth * bounds.force1.noise,
        growth * bounds.force2.noise,
    )


@force_inlined
def below_zero(segment, end, noise, leaves1, leaves2):
    """Return which watched functions are below zero by more than rounding at the end of a window.

    `leaves1` and `leaves2` state whether rate 1 and rate 2 leave zero in this window. Such a rate is positive at the
    end of the window.
    """
    return Four(
        (end.rate1.value < -noise.rate1) & ~leaves1,
        (end.rate2.value < -noise.rate2) & ~leaves2,
        (end.force1.value < -noise.force1) & segment.watches_force[0],
        (end.force2.value < -noise.force2) & segment.watches_force[1],
    )


@force_inlined
def certify(segment, bounds, before, end, h, leaves1, leaves2):
    """Return which functions are proven to be positive inside a window of length h, or are not watched."""
    return Four(
        leaves1 | positive_between(before.rate1, end.rate1, h, bounds.rate1.sixth),
        leaves2 | positive_between(before.rate2, end.rate2, h, bounds.rate2.sixth),
        positive_between(before.force1, end.force1, h, bounds.force1.sixth) | ~segment.watches_force[0],
        positive_between(before.force2, end.force2, h, bounds.force2.sixth) | ~segment.watches_force[1],
    )


@force_inlined
def zero_at_end(segment, end, noise, certified, leaves1, leaves2):
    """Return which watched functions are zero, and so have their events, at the end of a window that is done."""
    return Four(
        ~leaves1 & is_zero(end.rate1, noise.rate1, certified.rate1),
        ~leaves2 & is_zero(end.rate2, noise.rate2, certified.rate2),
        segment.watches_force[0] & is_zero(end.force1, noise.force1, certified.force1),
        segment.watches_force[1] & is_zero(end.force2, noise.force2, certified.force2),
    )


@force_inlined
def is_zero(jet, noise, certified):
    """Return whether a function is zero within rounding.

    If the function could not be certified in the window, four times the rounding error is allowed.
    """
    return jet.value <= (noise if certified else 4 * noise)


@force_inlined
def time_below(is_below, h, end):
    """Estimate the time from the root of a function to the end of a window of length h; -1 if it is not below zero.

    The estimate is Newton's step from the end of the window.
    """
    back = end.value / end.slope
    back = back if (end.slope < 0) & (back < h) else 0.5 * h
    return back if is_below else -1.0


@force_inlined
def select(is_rate1, is_rate2, is_force1, four):
    """Return the value whose flag is set, or the last value if no flag is set. No branch is used: it would be slow."""
    return (
        four.rate1 if is_rate1 else (four.rate2 if is_rate2 else (four.force1 if is_force1 else four.force2))
    )


@force_inlined
def select_jet(is_rate1, is_rate2, is_force1, jets):
    """Return the `Jet` whose flag is set, or the last one if no flag is set."""
    a, b, c, d = jets.rate1, jets.rate2, jets.force1, jets.force2
    return Jet(
        select(is_rate1, is_rate2, is_force1, Four(a.value, b.value, c.value, d.value)),
        select(is_rate1, is_rate2, is_force1, Four(a.slope, b.slope, c.slope, d.slope)),
        select(is_rate1, is_rate2, is_force1, Four(a.bend, b.bend, c.bend, d.bend)),
    )


@force_inlined
def chase_root(segment, bounds, below, before, end, noise, fresh1, fresh2, t, h):
    """Return a root of one of the functions that are below zero at the end of a window from t to t + h.

    The function that seems to have reached zero first is chosen, so that no roots of other functions have to be found.
    The function returns the chosen function, its root counted from t, and the modal coordinates q and r at the root.
    """
    modes, a, b = segment.modes, segment.a, segment.b
    sign1, sign2 = segment.signs
    back1, back2 = time_below(below.rate1, h, end.rate1), time_below(below.rate2, h, end.rate2)
    back3, back4 = time_below(below.force1, h, end.force1), time_below(below.force2, h, end.force2)
    longest = max(max(back1, back2), max(back3, back4))
    is_rate1, is_rate2, is_force1 = back1 == longest, back2 == longest, back3 == longest
    is_rate = is_rate1 | is_rate2
    chased = (
        Function.RATE1
        if is_rate1
        else (Function.RATE2 if is_rate2 else (Function.FORCE1 if is_force1 else Function.FORCE2))
    )
    # A fresh rate is zero at the start of the window. This zero is not the root that is searched.
    low = 0.0
    if fresh1 & is_rate1:
        low = time_above_zero(before.rate1, bounds.rate1.second, modes.omega[1])
    if fresh2 & is_rate2 & (not is_rate1):
        low = time_above_zero(before.rate2, bounds.rate2.second, modes.omega[1])
    slow = Four(sign1 * modes.delta[0], sign2 * modes.phi2[0], modes.force1[0], modes.force2[0])
    fast = Four(sign1 * modes.delta[1], sign2 * modes.phi2[1], modes.force1[1], modes.force2[1])
    c = (select(is_rate1, is_rate2, is_force1, slow), select(is_rate1, is_rate2, is_force1, fast))
    at_start = select_jet(is_rate1, is_rate2, is_force1, before)
    at_end = select_jet(is_rate1, is_rate2, is_force1, end)
    its_noise = select(is_rate1, is_rate2, is_force1, noise)
    # A rate is a sum of q_j, and its slope is a sum of r_j. A force is a sum of r_j, and its slope a sum of -q_j.
    u = (a[0] if is_rate else b[0], a[1] if is_rate else b[1])
    v = (b[0] if is_rate else -a[0], b[1] if is_rate else -a[1])
    root, u, v = root_before(c, t, h, low, at_start, at_end, its_noise, modes.omega, u, v)
    q, r = (u, v) if is_rate else ((-v[0], -v[1]), u)
    return chased, root, q, r


@force_inlined
def margin_after(segment, bounds, before, end, t, h, margin):
    """Return the grazing margin after a window from t to t + h; `margin` is the grazing margin before the window."""
    modes, a, b = segment.modes, segment.a, segment.b
    if bounds.rate1.may_graze | bounds.rate2.may_graze:
        limit = min(margin, NEAR)
        start1, start2 = higher_derivatives(before, segment)
        end1, end2 = higher_derivatives(end, segment)
        rate1, rate2, fast = bounds.rate1, bounds.rate2, modes.omega[1]
        if rate1.may_graze and not stays_far(
            h, before.rate1, end.rate1, start1, end1, rate1.sixth, fast, limit * rate1.size
        ):
            least_square = STAKE * modes.k1 / segment.losses[0]
            share = (
                nearest_turn(modes.delta, modes.force1, least_square, t, h, modes.omega, a, b) / rate1.size
            )
            margin = share if share < limit else margin
        if rate2.may_graze and not stays_far(
            h, before.rate2, end.rate2, start2, end2, rate2.sixth, fast, limit * rate2.size
        ):
            least_square = STAKE * modes.k2 / segment.losses[1]
            share = nearest_turn(modes.phi2, modes.force2, least_square, t, h, modes.omega, a, b) / rate2.size
            margin = share if share < min(margin, NEAR) else margin
    return margin


@force_inlined
def clear_until(segment, radius, t):
    """Return the time, not before t, until which the envelopes prove that all watched functions stay above zero."""
    modes, omega, a, b = segment.modes, segment.modes.omega, segment.a, segment.b
    sign1, sign2 = segment.signs
    rate1 = (sign1 * modes.delta[0], sign1 * modes.delta[1])
    rate2 = (sign2 * modes.phi2[0], sign2 * modes.phi2[1])
    quarter = 0.5 * pi
    return min(
        envelope_time(0.0, rate1, t, omega, a, b, radius),
        envelope_time(0.0, rate2, t, omega, a, b, radius),
        envelope_time(quarter, modes.force1, t, omega, a, b, radius) if segment.watches_force[0] else inf,
        envelope_time(quarter, modes.force2, t, omega, a, b, radius) if segment.watches_force[1] else inf,
    )


@force_inlined
def first_event(segment, start, margin):
    """Return the first event of a segment of S1.

    `start` is the motion at its start, and `margin` is the grazing margin before the segment.
    """
    modes, omega, a, b = segment.modes, segment.modes.omega, segment.a, segment.b
    w0, w1 = omega
    radius = (sqrt(a[0] * a[0] + b[0] * b[0]), sqrt(a[1] * a[1] + b[1] * b[1]))
    bounds = bounds_of_all(segment, radius)
    before = jets_of(start, segment)
    fresh1, fresh2 = start.d1 == 0, start.v2 == 0
    past1, past2 = is_past(before.rate1, fresh1), is_past(before.rate2, fresh2)
    if past1 or past2:
        return Event(0.0, Four(past1, past2, False, False), start, 0.0, 0)
    certifiable = inf > bounds.rate1.sixth + bounds.rate2.sixth + bounds.force1.sixth + bounds.force2.sixth
    if not certifiable:
        return Event(0.0, Four(False, False, False, False), start, margin, MOST_WINDOWS)

    window = WINDOW / w1
    # The search has reached time t. It tries the window from t to t + h; q and r are the modal coordinates at t + h. If
    # negative_at is finite, some function is negative at t + negative_at.
    t, h, negative_at = 0.0, window, inf
    windows = passed = 0
    chased = Function.NONE
    # All full windows turn the fast mode by the same angle.
    cos_slow, sin_slow = cos_sin(w0 * window)
    q, r = rotate(cos_slow, sin_slow, COS_WINDOW, SIN_WINDOW, a, b)
    while True:
        windows += 1
        motion, end = evaluate(q, r, segment, chased)
        noise = noise_at(segment, bounds, t + h)
        leaves1 = fresh1 & leaves_zero(h, before.rate1, bounds.rate1.second, w1)
        leaves2 = fresh2 & leaves_zero(h, before.rate2, bounds.rate2.second, w1)
        below = below_zero(segment, end, noise, leaves1, leaves2)
        if any_of(below):
            negative_at = h
            chased, h, q, r = chase_root(segment, bounds, below, before, end, noise, fresh1, fresh2, t, h)
            continue

        leaves1 |= fresh1 & (end.rate1.value <= noise.rate1) & (end.rate1.slope >= 0)
        leaves2 |= fresh2 & (end.rate2.value <= noise.rate2) & (end.rate2.slope >= 0)
        certified = certify(segment, bounds, before, end, h, leaves1, leaves2)
        all_certified = certified.rate1 & certified.rate2 & certified.force1 & certified.force2
        if not all_certified and h * w1 > SHORTEST_WINDOW:
            h, chased = 0.5 * h, Function.NONE
            q, r = modal_coordinates(t + h, omega, a, b)
            continue

        margin = margin_after(segment, bounds, before, end, t, h, margin)
        t += h
        fired = zero_at_end(segment, end, noise, certified, leaves1, leaves2)
        if any_of(fired):
            return Event(t, fired, motion, margin, windows)

        before = end
        fresh1 = fresh2 = False
        chased = Function.NONE
        negative_at -= h
        if 0 < negative_at < inf:
            h = negative_at
            q, r = modal_coordinates(t + h, omega, a, b)
            continue
        negative_at = inf
        h = min(2 * h, window)
        passed += 1
        if h == window:
            q, r = rotate(cos_slow, sin_slow, COS_WINDOW, SIN_WINDOW, q, r)
        else:
            q, r = modal_coordinates(t + h, omega, a, b)
        if passed % 6 == 5 and w1 > ENVELOPE_RATIO * w0:
            clear = clear_until(segment, radius, t)
            if clear > t + window:
                t = clear
                q, r = modal_coordinates(t, omega, a, b)
                before = jets_of(motion_of(q, r, modes), segment)
                q, r = modal_coordinates(t + h, omega, a, b)
