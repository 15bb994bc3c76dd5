"""Hausdorff distance of two polylines in the plane.

The directed distance from A to B is the largest distance that a point of A has from B. The points of A are its vertices
and all points inside its segments. The symmetric distance is the larger of the distances from A to B and from B to A.
`divergence` calls this module to compare impulse curves.

Two facts keep the computation fast on curves of 1e5 points:

* The sum s = x + y differs between two points by at most sqrt(2) times their distance. So only some points of B can be
  nearer to a given point than d: their s differs from the s of the given point by at most sqrt(2) d. Along an impulse
  curve both impulses grow, so that these points make up a short part of B. The search is also right where a curve turns
  back.
* The distance from one segment is a convex function. So if both ends of a segment of A lie within d of the same segment
  of B, the whole segment of A lies within d of it. Other segments of A are halved, until each half lies within d or is
  shorter than the tolerance.
"""

from __future__ import annotations

import math

import numpy as np

from impact_xval.model.compiled import kernel_decorator, strict_float_helper

#: Largest absolute error of a distance, in the unit of the coordinates.
TOLERANCE = 1e-9

#: Largest coordinate for which a distance is computed. The squares of larger coordinates may overflow in double
#: precision, and the halving of segments would then never end.
LARGEST = 1e150


@kernel_decorator(fastmath=False, nogil=True)
def distances(a, b, offsets_a, offsets_b):
    """Return the symmetric Hausdorff distances of n pairs of polylines, shape (n,).

    The vertices of all polylines follow one another in `a` and in `b`, of shape (number of vertices, 2). Polyline i has
    the vertices from offsets[i] up to, but without, offsets[i + 1]. A distance is NaN if one of its polylines has no
    vertex, or has a coordinate larger than `LARGEST`.
    """
    found = np.empty(len(offsets_a) - 1)
    for i in range(len(found)):
        one, other = a[offsets_a[i] : offsets_a[i + 1]], b[offsets_b[i] : offsets_b[i + 1]]
        found[i] = np.nan
        if _legal(one) and _legal(other):
            found[i] = max(_directed(one, other), _directed(other, one))
    return found


@strict_float_helper
def _legal(one):
    """Return whether a polyline has at least one vertex, and all its coordinates are at most `LARGEST`."""
    for i in range(len(one)):
        if not (abs(one[i, 0]) <= LARGEST and abs(one[i, 1]) <= LARGEST):
            return False
    return len(one) > 0


@strict_float_helper
def _to_segment(x, y, b, j):
    """Return the squared distance of the point (x, y) from segment j of the polyline b."""
    ax, ay = x - b[j, 0], y - b[j, 1]
    if j + 1 < len(b):
        dx, dy = b[j + 1, 0] - b[j, 0], b[j + 1, 1] - b[j, 1]
        along, length2 = ax * dx + ay * dy, dx * dx + dy * dy
        if along > 0.0:
            t = along / length2 if along < length2 else 1.0
            ax, ay = ax - t * dx, ay - t * dy
    return ax * ax + ay * ay


@strict_float_helper
def _nearest(x, y, b, lowest, highest, enough):
    """Return the distance of the point (x, y) from a segment of the polyline b, and the index of that segment.

    The segment is either the nearest segment of b, or any segment of b within the distance `enough` of the point. With
    s = x + y, `lowest[j]` is the least s on segment j and all later segments, and `highest[j]` the greatest s on
    segment j and all earlier ones.
    """
    n, s, root2 = len(highest), x + y, math.sqrt(2.0)
    # Begin with the segment of b that has the s of the point. On an impulse curve this segment is near the point.
    where, last = 0, n - 1
    while where < last:
        middle = (where + last) // 2
        where, last = (middle + 1, last) if highest[middle] < s else (where, middle)
    best2 = _to_segment(x, y, b, where)
    best = math.sqrt(best2)
    left, right = where - 1, where + 1
    while best > enough and (left >= 0 or right < n):
        if right < n:
            if lowest[right] > s + root2 * best:
                right = n
            else:
                d2 = _to_segment(x, y, b, right)
                if d2 < best2:
                    best2, best, where = d2, math.sqrt(d2), right
                right += 1
        if left >= 0:
            if highest[left] < s - root2 * best:
                left = -1
            else:
                d2 = _to_segment(x, y, b, left)
                if d2 < best2:
                    best2, best, where = d2, math.sqrt(d2), left
                left -= 1
    return best, where


@strict_float_helper
def _directed(a, b):
    """Return the directed Hausdorff distance from the polyline a to the polyline b, at most `TOLERANCE` too small."""
    n = max(1, len(b) - 1)
    lowest, highest = np.empty(n), np.empty(n)
    for j in range(n):
        s0, s1 = b[j, 0] + b[j, 1], b[min(j + 1, len(b) - 1), 0] + b[min(j + 1, len(b) - 1), 1]
        lowest[j], highest[j] = min(s0, s1), max(s0, s1)
    for j in range(1, n):
        highest[j] = max(highest[j], highest[j - 1])
        lowest[n - 1 - j] = min(lowest[n - 1 - j], lowest[n - j])

    # The vertices of a are searched from coarse to fine: for example every 1024th vertex, then the vertices halfway
    # between them, and so on. After a few searches the largest distance is nearly known. The search from a vertex that
    # is not farther away then ends at once. If the vertices were searched in sequence, each new largest distance would
    # cost a full search.
    near, worst = np.empty(len(a), dtype=np.int64), 0.0
    stride = 1
    while stride < len(a):
        stride *= 2
    start = 0
    while stride > 0:
        for i in range(start, len(a), 2 * stride):
            d, near[i] = _nearest(a[i, 0], a[i, 1], b, lowest, highest, worst)
            worst = max(worst, d)
        stride //= 2
        start = stride

    for i in range(len(a) - 1):
        ends = (a[i, 0], a[i, 1], near[i]), (a[i + 1, 0], a[i + 1, 1], near[i + 1])
        worst = _within(*ends, b, lowest, highest, worst)
    return worst


@strict_float_helper
def _within(one, two, b, lowest, highest, worst):
    """Return the largest distance of the points on a piece of a from the polyline b, or `worst` if `worst` is larger.

    `one` and `two` are the two ends of the piece. Each has x, y, and the index of a segment of b near this end.
    """
    (x1, y1, near1), (x2, y2, near2) = one, two
    # The distance from a segment of b is convex: no point of the piece is farther from it than the farther end.
    bound = max(_to_segment(x1, y1, b, near1), _to_segment(x2, y2, b, near1))
    if near2 != near1:
        bound = min(bound, max(_to_segment(x1, y1, b, near2), _to_segment(x2, y2, b, near2)))
    if bound <= (worst + TOLERANCE) ** 2:
        return worst
    x, y = 0.5 * (x1 + x2), 0.5 * (y1 + y2)
    d, near = _nearest(x, y, b, lowest, highest, worst)
    worst = _within(one, (x, y, near), b, lowest, highest, max(worst, d))
    return _within((x, y, near), two, b, lowest, highest, worst)
