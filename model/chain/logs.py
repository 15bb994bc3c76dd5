"""Functions with which the kernel of chains writes its logs: the motion in time, and the sets of active contacts.

Used by `chain.kernel`.
"""

from __future__ import annotations

import numpy as np

from impact_xval.model.chain.laws import is_active
from impact_xval.model.chain.series import slope, value
from impact_xval.model.chain.state import write_ball_values
from impact_xval.model.compiled import kernel_helper

#: The number 1, to be passed as an argument. For a literal 1 Numba would compile the called function once more.
_ONE = np.int64(1)


@kernel_helper
def log_points(c, n, work, degree, x, h, time, setup, points, log, row):
    """Log the motion from the start of a window to its place x, and return the number of the next free row of the log.

    The window has the length h, and began at `time`. Each of the `points` rows holds the time, the velocities of the
    balls, their accelerations, and for each contact 1 if it is active, else 0.
    """
    balls = (log.shape[1] - c.size) // 2
    for point in range(points):
        if row < log.shape[0]:
            instant = x * point / points
            log[row, 0] = time + instant * h
            for i in range(n):
                work[i].value = value(work[i].rates, degree, instant)
            write_ball_values(c, n, work.value, setup.drift, log, row, _ONE)
            for i in range(n):
                work[i].value = slope(work[i].rates, degree, instant) / h
            write_ball_values(c, n, work.value, 0.0, log, row, _ONE + balls)
            for i in range(work.size):
                log[row, 1 + 2 * balls + i] = 1.0 if work[i].active else 0.0
        row += 1
    return row


@kernel_helper
def log_set(c, n, work, sets, first, row):
    """Log the set of active contacts if it differs from the set before it, and return the number of the next free row.

    The sets of this chain begin at row `first`. A rigid contact is logged as active while any other contact is active.
    """
    any_active = False
    for i in range(n):
        any_active |= is_active(c[i])
    for i in range(work.size):
        work[i].was_active, work[i].active = work[i].active, any_active
    for i in range(n):
        work[c[i].index].active = is_active(c[i])
    is_new = row == first
    for i in range(work.size):
        is_new |= work[i].active != work[i].was_active
    if is_new and row < sets.shape[0]:
        for i in range(work.size):
            sets[row, i // 64] |= np.uint64(work[i].active) << np.uint64(i % 64)
    return row + 1 if is_new else row
