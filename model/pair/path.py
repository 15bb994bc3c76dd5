"""Functions that write points of the exact motion of two balls into a log.

`write_both` logs a segment of state S1, in which both contacts are active. `write_lone` logs a segment with a single
active contact. `write_point` logs one point.

In S1 the points are equally spaced in time. In every other segment one contact works against one mass, so the motion is
a sinusoid: the rate of compression is W cos(theta), and the force is sqrt(k m) W sin(theta), where theta grows by
sqrt(k/m) per unit of time. At the end of compression W drops to e W and k rises to k/e^2, so the segment has two
pieces. In each piece the points are equally spaced in theta.

Units as in `pair.motion`.

Used by `pair.kernel`.
"""

from __future__ import annotations

from math import atan2, ceil, cos, pi, sin, sqrt

from impact_xval.model.compiled import force_inlined
from impact_xval.model.pair.law import Phase
from impact_xval.model.pair.motion import modal_coordinates, motion_of

#: Number of points per half period of the fastest sinusoid of a segment.
POINTS = 48

#: Largest number of points of a piece. If a segment has thousands of oscillations, the points do not resolve them, but
#: the first and the last point stay exact.
MOST_POINTS = 4000


@force_inlined
def write_point(log, row, state, time, v1, v2, F1, F2):
    """Write a point into a row of the log, if the log has this row, and return the number of the next row."""
    if row < log.shape[0]:
        point = log[row]
        point.state, point.time = state, time
        point.v1, point.v2, point.F1, point.F2 = v1, v2, F1, F2
    return row + 1


@force_inlined
def count_points(points, half_periods):
    """Return the number of points for a smooth piece of a segment, including both ends."""
    return min(MOST_POINTS, 3 + ceil(points * half_periods))


@force_inlined
def write_both(log, row, points, time, state, duration, segment):
    """Log a segment of S1 that starts at `time`, and return the time at its end and the number of the next row."""
    modes, end = segment.modes, time
    n = count_points(points, modes.omega[1] * duration / pi)
    for i in range(n):
        passed = duration * i / (n - 1)
        end = time + passed
        q, r = modal_coordinates(passed, modes.omega, segment.a, segment.b)
        motion = motion_of(q, r, modes)
        row = write_point(log, row, state, end, motion.v2 - motion.d1, motion.v2, motion.F1, motion.F2)
    return end, row


@force_inlined
def write_lone(log, row, points, time, state, pair, lone, mu, leaving):
    """Log a segment in which a single contact is active.

    `pair` is the state at the start of the segment, and `leaving` describes its end. The function returns the time at
    the end and the number of the next row. If the other contact is rigid, it passes on the force of the active contact.
    Otherwise its force stays the same. If the active contact has the stiffness 0, the segment takes an infinite time.
    If its stiffness is infinite, the segment takes no time and the force is infinite.
    """
    c, mass, rate = lone.contact, lone.mass, lone.rate
    v1, v2 = pair.v2 - pair.d1, pair.v2
    # Changes of v1 and v2 per unit of change of the rate of compression.
    if lone.is_ball_ball:
        waiting_force = pair.contact2.F
        per_v1, per_v2 = (-1.0, 0.0) if lone.united else (-mu / (1 + mu), 1 / (1 + mu))
    else:
        waiting_force = pair.contact1.F
        per_v1, per_v2 = (-1.0 if lone.united else 0.0), -1.0
    last = (
        atan2(sqrt(2 * leaving.energy / mass), leaving.rate) if leaving.energy > 0 or leaving.rate > 0 else pi
    )
    W, k = sqrt(rate * rate + 2 * c.E / mass), c.k
    start = atan2(sqrt(2 * c.E / mass), rate)
    pieces = 2 if c.phase == Phase.COMPRESSION and last > 0.5 * pi else 1
    for piece in range(pieces):
        end = last if piece == pieces - 1 else 0.5 * pi
        angle, unit = max(end - start, 0.0), sqrt(mass / k)
        n, t = count_points(points, angle / pi), time
        for i in range(n):
            passed = angle * i / (n - 1)
            theta = start + passed
            change = W * cos(theta) - rate
            F = sqrt(k * mass) * W * sin(theta) if W > 0 and 0 < theta < pi else 0.0
            other_force = waiting_force
            if lone.united:
                other_force = F if lone.is_ball_ball else F / (1 + mu)
            F1, F2 = (F, other_force) if lone.is_ball_ball else (other_force, F)
            t = time + unit * passed if passed > 0 else time
            row = write_point(log, row, state, t, v1 + per_v1 * change, v2 + per_v2 * change, F1, F2)
        time, start, W, k = t, end, c.e * W, k / (c.e * c.e)
    return time, row
