"""A column from its first touch to its end: segment by segment, each with one set of acting contacts.

`collide` is the whole model for one column. A segment is followed in pieces, over each of which every rate and every
deformation is a polynomial in time (`model.columns.series`, `model.columns.power_law`); the first event is found with
certainty (`model.columns.roots`); what it does is in `model.columns.chain`.

Ties: events at one instant are applied one after the other, in the order of contacts. That order does not matter, for
each changes only its own contact's phase, k and delta, and leaves all rates and forces as they are.
"""

from __future__ import annotations

from math import inf, pi, sqrt

import numpy as np

from impact_xval.model.columns.chain import (
    NOTHING,
    NOTHING_OF_STEPS,
    Chain,
    acceleration,
    ball_values,
    begin,
    force,
    neighbours,
    oscillation,
    rate_event,
    spent,
    still,
    strain,
    tangent,
    unite,
)
from impact_xval.model.columns.power_law import ORDER as ORDER_OF_STEP
from impact_xval.model.columns.power_law import STAGES, Workspace, advance, settle
from impact_xval.model.columns.roots import first_root
from impact_xval.model.columns.series import ORDER, evaluate, expand, horizon
from impact_xval.model.compiled import Floats, compiled, inlined
from impact_xval.model.grazing import STAKE
from impact_xval.model.law import COMPRESSION, INACTIVE, RESTITUTION

#: How a column ended, as bits: what happened on the way.
PLASTIC, RUNAWAY, COLLAPSE, TOO_MANY_EVENTS = 1, 2, 4, 8

#: Bodies are united where all that the contact between them can still do changes less than this share of its
#: neighbours' energy.
RIGID = 1e-14

#: Neighbours of less than this share of the other's energy ring themselves, and are disregarded.
SMALL = 1e-6

#: Halvings of an interval in which an extremum lies.
BISECTIONS = 40

#: With this share of the energy left in all contacts that act, their bodies are taken to be at rest.
COLLAPSED = 1e-30

#: Step of the method for power laws that is tried first, in units of about 1 of masses, stiffnesses and velocities.
FIRST_STEP = 1e-3

#: Phase of a contact that has become rigid, in the log.
UNITED = 3


@compiled
def ringing_ends(c: Chain, n: int, i: int) -> bool:
    """Tell whether a contact that has just ended compression may be taken for rigid from here on.

    It rings about the force that its neighbours' forces ask of it, each end of compression stiffens it by 1/e^2 (if
    linear), and it is rigid after a finite time tau. It is taken for rigid at once if its energy is negligible beside
    its neighbours', if they press it together all the while, and if its ringing cannot carry a neighbour's rate
    through zero, which would be an end of compression.
    """
    e = c.e[i]
    inverse, k = c.a[i] + c.a[i + 1], tangent(c, i)
    tau = 2 * pi / sqrt(k * inverse) / (1 - e)
    static, slope, _, swing = neighbours(c, n, i)
    if abs(slope) * tau >= 0.5 * static or max(force(c, n, i), static) ** 2 / (k * (1 - e)) > RIGID * swing:
        return False
    wiggle = abs(force(c, n, i) - static) / sqrt(inverse * k)
    for j in (i - 1, i + 1):
        if 0 <= j < n and c.phase[j] != INACTIVE and oscillation(c, n, j) > SMALL * swing:
            room = 4 * c.a[max(i, j)] * wiggle + 2 * abs(acceleration(c, n, j)) * tau
            if abs(c.w[j]) < room:
                return False
    return True


@compiled
def left_in_contacts(c: Chain, n: int) -> float:
    """Energy left in the contacts that act, with that of their bodies' approach; -1 if none acts."""
    total = -1.0
    for i in range(n):
        if c.phase[i] != INACTIVE:
            own = 0.5 * c.w[i] * c.w[i] / (c.a[i] + c.a[i + 1]) + strain(c, n, i)
            total = max(total, 0.0) + own
    return total


@compiled
def first_event(
    c: Chain, n: int, order: int, rates: Floats, deltas: Floats, bounds: Floats
) -> tuple[int, bool, float]:
    """First event of a piece: the contact, whether its restitution ends, and the time in [0, 1] (infinite if none).

    `bounds` is room for two rows of n numbers.
    """
    # A polynomial is not less than its first coefficient and all the negative ones: no more is needed for most.
    for i in range(n):
        bounds[0, i] = rates[0, i] if c.phase[i] == COMPRESSION else -rates[0, i]
        bounds[1, i] = deltas[0, i] if c.phase[i] == RESTITUTION else inf
    for j in range(1, order + 1):
        for i in range(n):
            bounds[0, i] += min(rates[j, i] if c.phase[i] == COMPRESSION else -rates[j, i], 0.0)
            bounds[1, i] += min(deltas[j, i], 0.0)
    first, which, ends = inf, -1, False
    for i in range(n):
        sign = 1.0 if c.phase[i] == COMPRESSION else -1.0
        if bounds[0, i] <= 0:
            x = first_root_of_rate(rates[:, i], order, sign, min(first, 1.0))
            if x < first:
                first, which, ends = x, i, False
        if bounds[1, i] <= 0:
            x = first_root(deltas[:, i], order, 1.0, min(first, 1.0))
            if x < first:
                first, which, ends = x, i, True
    return which, ends, first


@inlined
def first_root_of_rate(c: Floats, order: int, sign: float, last: float) -> float:
    """Find the first root of a rate."""
    if order == ORDER_OF_STEP and c[0] == c[1] == c[2] == 0:
        # At rest and not yet pressed: the quintic knows nothing of how it begins, but its neighbours can only press it.
        return 0.0 if sign < 0 and c[3] + c[4] + c[5] > 0 else inf
    return first_root(c, order, sign, last)


@compiled
def near_misses(c: Chain, n: int, order: int, rates: Floats, x: float, energy: float, margin: float) -> float:
    """Grazing margin after a piece of length x at whose end `c` is, given that before it.

    The magnitude of an extremum of a rate is taken relative to its amplitude: of the contact's own oscillation about
    the force that its neighbours ask of it, and of the motion that a change of that force imposes.
    """
    for i in range(n):
        start = rates[1, i]
        stake = (1 - c.e[i] * c.e[i]) * strain(c, n, i)
        if c.phase[i] == INACTIVE or stake <= STAKE * energy or start * acceleration(c, n, i) >= 0:
            continue
        low, high = 0.0, x
        for _ in range(BISECTIONS):
            middle = 0.5 * (low + high)
            if _slope(rates, order, i, middle) * start > 0:
                low = middle
            else:
                high = middle
        value = 0.0
        for j in range(order, -1, -1):
            value = value * low + rates[j, i]
        static, _, imposed, _ = neighbours(c, n, i)
        k = tangent(c, i)
        if k > 0:
            ring = (force(c, n, i) - static) * sqrt((c.a[i] + c.a[i + 1]) / k)
            size = sqrt(max(value * value, c.w[i] * c.w[i]) + ring * ring) + imposed
            margin = min(margin, abs(value) / size)
    return margin


@inlined
def _slope(rates: Floats, order: int, i: int, x: float) -> float:
    """Return the derivative of a rate in a piece."""
    value = 0.0
    for j in range(order, 0, -1):
        value = value * x + j * rates[j, i]
    return value


@compiled
def write_path(
    c: Chain,
    n: int,
    order: int,
    rates: Floats,
    x: float,
    h: float,
    time: float,
    drift: float,
    points: int,
    log: Floats,
    row: int,
) -> int:
    """Write points of a piece: time, velocities and accelerations of the balls, phases of the contacts."""
    if row >= log.shape[0]:
        return row + points
    balls = c.body.size
    values = np.empty(n)
    for point in range(points):
        if row < log.shape[0]:
            now = x * point / points
            log[row, 0] = time + now * h
            evaluate(rates, order, n, now, values)
            ball_values(c, n, values, drift, log[row, 1 : 1 + balls])
            for i in range(n):
                values[i] = _slope(rates, order, i, now) / h
            ball_values(c, n, values, 0.0, log[row, 1 + balls : 1 + 2 * balls])
            log[row, 1 + 2 * balls :] = UNITED
            for i in range(n):
                log[row, 1 + 2 * balls + c.contact[i]] = c.phase[i]
        row += 1
    return row


@compiled
def apply_event(
    c: Chain, n: int, i: int, ends: bool, stiffens: bool, nothing: float, loss: float, code: int
) -> tuple[int, float, int]:
    """Apply the law to contact i, and unite its bodies if that made it rigid: contacts left, loss, code."""
    if ends:
        loss += strain(c, n, i)
        spent(c, i)
        return n, loss, code
    compressing = c.phase[i] == COMPRESSION
    if compressing and c.e[i] == 0:
        loss += strain(c, n, i)
        return unite(c, n, i), loss, code | PLASTIC
    loss = rate_event(c, n, i, stiffens, nothing, loss)
    if compressing and c.phase[i] == RESTITUTION and stiffens and c.e[i] < 1 and ringing_ends(c, n, i):
        loss += strain(c, n, i)
        return unite(c, n, i), loss, code | RUNAWAY
    return n, loss, code


@compiled
def collide(
    c: Chain, energy: float, drift: float, stiffens: bool, max_events: int, points: int, log: Floats
) -> tuple[int, int, int, float, float, float, int]:
    """Follow one column to its end.

    Parameters
    ----------
    c : Chain
        At first touch; left as it is at the end.
    energy : float
        Kinetic energy of the balls relative to their centre of mass, or to the table.
    drift : float
        Velocity of the centre of mass; without meaning on a table.
    stiffens : bool
        As in `model.law.ImpactLaw`.
    max_events : int
        Pieces of segments after which the column is given up.
    points : int
        Rows of the log for each piece.
    log : ndarray, shape (rows, 1 + 2 N + C)
        Filled with the path, as far as it goes; may have no rows.

    Returns
    -------
    n, code, events : int
        Contacts that have not become rigid; how it ended, as bits; number of events.
    margin : float
        Grazing margin: the smallest rate at which a compression rate turned around while its contact acted, per the
        largest one since it last did; contacts of e = 1 do not count.
    loss : float
        Energy lost.
    time : float
        Since first touch.
    rows : int
        Of the log, had it room for all.
    """
    n = c.k.size
    order = ORDER if c.p == 1 else ORDER_OF_STEP
    rates, deltas = np.zeros((ORDER + 1, n)), np.zeros((ORDER + 1, n))
    bounds = np.empty((2, n))
    work = Workspace(
        np.empty((STAGES + 1, n)), np.empty((STAGES + 1, n)), np.empty(n), np.empty(n), np.empty(n)
    )
    nothing = (NOTHING if c.p == 1 else NOTHING_OF_STEPS) * energy
    code, events, pieces, rows = 0, 0, 0, 0
    margin, loss, time, h_next = inf, 0.0, 0.0, FIRST_STEP
    begin(c, n)
    left = left_in_contacts(c, n)
    while left > COLLAPSED * energy and pieces < max_events:
        pieces += 1
        if c.p == 1:
            h = horizon(c, n)
            expand(c, n, h, rates, deltas)
        else:
            h, h_next = advance(c, n, h_next, work, rates, deltas)
            if h == 0:
                break  # slopes lie beyond double precision
        which, ends, x = first_event(c, n, order, rates, deltas, bounds)
        happened, x = which >= 0, min(x, 1.0)
        if c.p == 1:
            evaluate(rates, order, n, x, c.w)
            evaluate(deltas, order, n, x, c.delta)
        elif happened:
            x, happened = settle(c, n, h, x, which, ends, work)
        margin = near_misses(c, n, order, rates, x, energy, margin)
        if x > 0:
            rows = write_path(c, n, order, rates, x, h, time, drift, points, log, rows)
        time += x * h
        if happened:
            events += 1
            n, loss, code = apply_event(c, n, which, ends, stiffens, nothing, loss, code)
        still(c, n, nothing)
        left = left_in_contacts(c, n)
    if left > COLLAPSED * energy:
        code |= TOO_MANY_EVENTS
    elif left >= 0:
        code |= COLLAPSE
        loss += bring_to_rest(c, n)
    return n, code, events, margin, loss, time, rows


@compiled
def bring_to_rest(c: Chain, n: int) -> float:
    """End all that acts, with no rate left; the strain energy that is dropped."""
    dropped = 0.0
    for i in range(n):
        if c.phase[i] != INACTIVE:
            dropped += strain(c, n, i)
            c.w[i] = 0.0
            spent(c, i)
    return dropped
