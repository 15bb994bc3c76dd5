"""A quick way to the next event of a stiff contact that oscillates: `next_zero_of_rate`.

It spares the search of `pair.events.first_event` where it is certain which event comes first.

Needs `pair.motion`, `pair.roots`, `pair.grazing` and the types of `pair.events`. Used by `pair.kernel`.
"""

from __future__ import annotations

from math import atan2, pi, sqrt

from impact_xval.model.compiled import force_inlined
from impact_xval.model.pair.grazing import NEAR, turns_far
from impact_xval.model.pair.motion import Motion, cos_sin, motion_of, rotate_briefly

#: The quick way is tried if one contact is more than this many times as stiff as the other contact.
STIFFER = 10.0

#: Largest amplitude of the slow sinusoid of the stiff contact's rate, as a share of the amplitude of its fast sinusoid.
RINGING = 0.8

#: Steps of Newton's method, in radians of the fast mode: the longest step, and the step below which the method ends.
LONGEST_STEP, LAST_STEP = 0.1, 1e-8


@force_inlined
def next_zero_of_rate(segment, start):
    """Return the next zero of the rate of a stiff contact, if this zero is certainly the first event of a segment.

    The function returns three values: the time of this zero, or 0 if it is not certain to be the first event; whether
    the stiff contact is contact 1; and the motion at that time.

    The rate of the stiff contact is zero at the start. While the amplitude of its slow sinusoid is smaller than that of
    its fast sinusoid, the rate is zero twice in each oscillation, and the force of the stiff contact is monotonic
    between these zeros. The rate of the soft contact keeps its sign while its slow sinusoid exceeds the amplitude of
    its fast sinusoid. Then the force of the soft contact is monotonic, too. So if both forces are positive at the end,
    they were positive all the time. No turning point of a rate is nearer to zero than the share `NEAR` of its
    amplitude.
    """
    modes, omega, a, b = segment.modes, segment.modes.omega, segment.a, segment.b
    rings1 = start.d1 == 0 and modes.k1 > STIFFER * modes.k2
    rings2 = start.v2 == 0 and modes.k2 > STIFFER * modes.k1
    if not (rings1 or rings2):
        return 0.0, rings1, start
    stiff, soft = (modes.delta, modes.phi2) if rings1 else (modes.phi2, modes.delta)
    stiff_sign, soft_sign = segment.signs if rings1 else (segment.signs[1], segment.signs[0])
    slow, fast = sqrt(a[0] * a[0] + b[0] * b[0]), sqrt(a[1] * a[1] + b[1] * b[1])
    leaves_zero = stiff_sign * (stiff[0] * omega[0] * b[0] + stiff[1] * omega[1] * b[1]) > 0
    # After this angle the fast sinusoid has the same value again, on the other side of its extremum.
    angle = 2 * atan2(b[1], a[1])
    angle = angle if angle > 0 else angle + 2 * pi
    per_turn = omega[0] / omega[1]
    cos_slow, sin_slow = cos_sin(angle * per_turn)
    q, r = (
        (a[0] * cos_slow + b[0] * sin_slow, a[1]),
        (b[0] * cos_slow - a[0] * sin_slow, -b[1]),
    )
    nearest = min(soft_sign * soft[0] * a[0], soft_sign * soft[0] * q[0])
    # The slow sinusoid falls at most this share of its amplitude below the lower one of its values at both ends. This
    # is true between the ends, and also as far as Newton's steps go beyond the second end.
    reserve = per_turn * (1 + 5 * per_turn)
    stiff_slow, stiff_fast = abs(stiff[0]) * slow, abs(stiff[1]) * fast
    soft_slow, soft_fast = abs(soft[0]) * slow, abs(soft[1]) * fast
    if not (
        leaves_zero
        and stiff_slow < RINGING * stiff_fast
        and turns_far(stiff_slow, stiff_fast, omega[0] * omega[0], omega[1] * omega[1])
        and nearest > soft_fast + reserve * soft_slow + NEAR * (soft_slow + soft_fast)
    ):
        return 0.0, rings1, start
    time, longest = angle / omega[1], LONGEST_STEP / omega[1]
    h = longest
    for _ in range(10):
        slope = stiff[0] * omega[0] * r[0] + stiff[1] * omega[1] * r[1]
        h = min(max(-(stiff[0] * q[0] + stiff[1] * q[1]) / slope, -longest), longest)
        time += h
        q, r = rotate_briefly(h, omega, q, r)
        if abs(h) * omega[1] < LAST_STEP:
            break
    end = motion_of(q, r, modes)
    if abs(h) * omega[1] >= LAST_STEP or end.F1 <= 0 or end.F2 <= 0:
        return 0.0, rings1, start
    return time, rings1, Motion(0.0 if rings1 else end.d1, end.v2 if rings1 else 0.0, end.F1, end.F2)
