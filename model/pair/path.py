"""The path of a collision: points of its exact motion, as rows of a log.

In S1 they are equally spaced in time. In every other segment one contact works against one mass, a sinusoid: its
compression rate is W cos(theta), its force sqrt(k m) W sin(theta), where theta grows by sqrt(k/m) a unit of time. There
they are equally spaced in theta, and apart before and after the end of compression, where W drops to e W and k rises
to k/e^2.
"""

from __future__ import annotations

from math import atan2, ceil, cos, pi, sin, sqrt

from impact_xval.model.compiled import inlined
from impact_xval.model.pair.law import COMPRESSION
from impact_xval.model.pair.motion import modal, motion

#: Columns of a row, in units of m1, k1 and abs(v0): state (1 to 4), time since first touch, velocities and forces.
LOG_COLUMNS = ("state", "time", "v1", "v2", "F1", "F2")

#: Points per half period of the fastest sinusoid of a segment.
POINTS = 48

#: Most points of a segment of S1; one of thousands of oscillations is undersampled, its ends stay exact.
MOST_POINTS = 4000


@inlined
def write(log, row, state, time, v1, v2, F1, F2):
    """Write a row, if the log has it; the next one."""
    if row < log.shape[0]:
        log[row, 0], log[row, 1], log[row, 2], log[row, 3] = state, time, v1, v2
        log[row, 4], log[row, 5] = F1, F2
    return row + 1


@inlined
def number_of(points, half_periods):
    """Count the points of a smooth piece, its ends included."""
    return min(MOST_POINTS, 3 + ceil(points * half_periods))


@inlined
def write_both(log, row, points, time, state, duration, modes, a, b):
    """Write a segment of S1; the time and the row after it."""
    n, t = number_of(points, modes.omega[1] * duration / pi), time
    for i in range(n):
        passed = duration * i / (n - 1)
        t = time + passed
        q, r = modal(passed, modes.omega, a, b)
        d1, v2, F1, F2 = motion(q, r, modes)
        row = write(log, row, state, t, v2 - d1, v2, F1, F2)
    return t, row


@inlined
def write_one(log, row, points, time, state, v1, v2, first, united, mu, c, other, mass, rate, until):
    """Write a segment in which one contact works alone, from a state at its start on; the time and the row at its end.

    `first` says whether it is the ball-ball contact, c, that works, `united` whether the other one is rigid and passes
    its force on, else that stands still at the force `other`. The mass that c works against has the compression rate
    `rate` at the start, and `until` is theta at the end. The time is infinite where the contact has no stiffness, and
    does not pass where that is infinite; the force then is infinite.
    """
    if first:
        on_v1, on_v2 = (-1.0, 0.0) if united else (-mu / (1 + mu), 1 / (1 + mu))
    else:
        on_v1, on_v2 = (-1.0 if united else 0.0), -1.0
    W, k = sqrt(rate * rate + 2 * c.E / mass), c.k
    start = atan2(sqrt(2 * c.E / mass), rate)
    pieces = 2 if c.phase == COMPRESSION and until > 0.5 * pi else 1
    for piece in range(pieces):
        end = until if piece == pieces - 1 else 0.5 * pi
        turn, unit = max(end - start, 0.0), sqrt(mass / k)
        n, t = number_of(points, turn / pi), time
        for i in range(n):
            angle = turn * i / (n - 1)
            theta = start + angle
            change = W * cos(theta) - rate
            F = sqrt(k * mass) * W * sin(theta) if W > 0 and 0 < theta < pi else 0.0
            passed = (F if first else F / (1 + mu)) if united else other
            F1, F2 = (F, passed) if first else (passed, F)
            t = time + unit * angle if angle > 0 else time
            row = write(log, row, state, t, v1 + on_v1 * change, v2 + on_v2 * change, F1, F2)
        time, start, W, k = t, end, c.e * W, k / (c.e * c.e)
    return time, row
