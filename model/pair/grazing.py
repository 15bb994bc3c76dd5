"""Grazing: how near a collision is to a jump of the model, and which results are marked for it.

The grazing margin is the smallest magnitude of a local extremum of a compression rate, relative to the rate's
amplitude (docs/theory.md, section 6).
"""

from __future__ import annotations

from math import inf

from impact_xval.model.compiled import inlined
from impact_xval.model.pair.motion import modal

#: Near-misses at which an end of compression would lose less than this, as a fraction of the energy of impact, do not
#: count: whether it happens or not hardly changes the outcome.
STAKE = 1e-6

#: Extrema nearer to zero than this, relative to the amplitude, are made exact.
NEAR = 0.1

#: A cut-off that changes (v1, v2) by more than this marks a result, in the kinetic norm per sqrt(m1) abs(v0).
CUTOFF_THRESHOLD = 1e-9

GRAZING = (
    "grazing: a compression rate turned around next to zero (grazing_margin), and the outcome jumps where one "
    "reaches zero"
)
CUTOFF = (
    f"cut-off: the outcome without a cut-off differs by more than {CUTOFF_THRESHOLD:g} |v0|, or is not known"
)

#: The sentences, by the sum of 1 (grazing) and 2 (cut-off).
MARKS = ("", GRAZING, CUTOFF, f"{GRAZING}; {CUTOFF}")


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
def extremum_between(c, t, h, start, end, size, omega, a, b):
    """Magnitude, relative to `size`, of the extremum in (t, t + h) of a rate, given (f, f', f'') at both ends.

    A parabola places it; where it comes near zero, Newton's iteration on f' makes it exact.
    """
    low, high, df0 = 0.0, h, start[1]
    x = h * df0 / (df0 - end[1])
    f = start[0] + 0.5 * df0 * x
    if abs(f) > NEAR * size:
        return abs(f) / size
    w0, w1 = omega[0] * omega[0], omega[1] * omega[1]
    for _ in range(20):
        q, r = modal(t + x, omega, a, b)
        f = c[0] * q[0] + c[1] * q[1]
        df = c[0] * omega[0] * r[0] + c[1] * omega[1] * r[1]
        ddf = -w0 * c[0] * q[0] - w1 * c[1] * q[1]
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
    return abs(f) / size
