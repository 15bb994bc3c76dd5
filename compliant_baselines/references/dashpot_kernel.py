"""One collision of the column with contacts of spring and dashpot, event by event.

Contact i pushes with F_i = max(0, k_i p_i + D_i) while its bodies overlap, p_i > 0, without memory: that is
what an engine computes step by step (docs/theory.md, section 7). The dashpot's share D_i is one of two laws:

* `LINEAR`, Kelvin and Voigt: D = c p';
* `PRODUCT`, Hunt and Crossley on a linear spring: D = a k p p'.

That makes three modes of a contact, with G = k p + c p', or 1 + a p' for the product law, whose sign is
that of F:

    OPEN     p <= 0, no force        -> LOADED where the gap has closed, p = 0 rising
    LOADED   p > 0 and G > 0         -> SLACK where G falls to 0, OPEN where p does
    SLACK    p > 0 and G < 0: none   -> LOADED where G rises through 0, OPEN where p falls to 0

A linear dashpot pushes from the first touch (F = c p' at p = 0) and is spent before its bodies are apart. A
slack contact becomes loaded again without having opened when the third body pushes its bodies together.

**Frozen positions.** With `frozen` an OPEN contact does not move, and none is SLACK: one whose G or p falls to 0 is
OPEN with p = 0, what was left of its penetration forgotten, and LOADED again at p' = 0, where its bodies begin to
approach. That is the law in the impulse space of the state-transition model.

Units and unknowns as in `references.taylor` and `references.piecewise`.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from impact_xval.compliant_baselines.contract.trajectory import GOING, STUCK
from impact_xval.compliant_baselines.references.first_root import first_root
from impact_xval.compliant_baselines.references.piecewise import (
    END_OF_RESTITUTION,
    OPEN,
    RETURN,
    TOO_LONG,
    flight_time,
    how_over,
    over_within,
    state_of,
    write_row,
)
from impact_xval.compliant_baselines.references.settling import settled
from impact_xval.compliant_baselines.references.taylor import (
    D1,
    LINEAR,
    ORDER,
    P1,
    PRODUCT,
    Q2,
    V2,
    evaluate,
    expand,
    expand_product,
    longest_step,
    trusted,
)

LOADED, SLACK = 1, 2

#: Stretches without an event after which a drop is asked whether its balls only settle any more.
PATIENCE = 6


@njit(cache=True, error_model="numpy")
def collide(law, kappa, mu, c1, c2, g, frozen, max_steps, log):
    r"""Follow one collision to its end.

    Parameters
    ----------
    law : int
        `LINEAR` or `PRODUCT`.
    kappa, mu : float
        k2/k1 and m2/m1, positive and finite.
    c1, c2 : float
        Damping of the contacts: c per sqrt(k1 m1), or a times \|v0\|.
    g : float
        Gravity; 0 is the scenario `impact`, anything else `drop`.
    frozen : bool
        Whether an open contact returns as soon as its bodies approach.
    max_steps : int
        Stretches after which the collision is given up.
    log : ndarray, shape (n, LOG_WIDTH)
        Filled with one row a stretch (`piecewise.LOG_COLUMNS`) and one for the end, as far as it goes.

    Returns
    -------
    v1, v2 : float
        Velocities at the end.
    end : int
        `FREE`, `REST`, `STUCK` or `TOO_LONG`.
    sequence, n_states : int
        States two bits each, the last one lowest (S1 is 0), and how many; the sequence holds the last 32.
    n_events, n_steps : int
        Ends and returns of a force, and stretches.
    time, fall : float
        Duration, and for how long of it gravity acted (`piecewise`).
    """
    table, G = np.empty((4, ORDER + 1)), np.empty((2, ORDER + 1))
    r2 = mu * g / kappa
    p1, d1, q2, v2 = 0.0, 1.0, 0.0, 0.0
    mode1, mode2 = LOADED, LOADED
    zero1, zero2 = False, False  # whether the force of a contact is zero by the event that just happened
    time, fall = 0.0, np.inf
    state, sequence, n_states, n_events, n = 1, np.uint64(0), 1, 0, 0
    end, last = GOING, 0
    while True:
        now = state_of(mode1 == LOADED, mode2 == LOADED)
        if now != state:
            state, sequence, n_states = now, (sequence << np.uint64(2)) | np.uint64(now - 1), n_states + 1
        end = how_over(mode1 == LOADED, mode2 == LOADED, mu, p1, d1, q2, v2, 1.0, kappa, g)
        if end == GOING and n >= max_steps:
            end = TOO_LONG
        if end != GOING:
            break
        if g > 0 and mode1 == OPEN and mode2 == OPEN:
            q2, r2, g, fall = q2 + r2, 0.0, 0.0, time  # in flight: from here on the bodies no longer fall

        if g > 0 and law == LINEAR and n - last >= PATIENCE and mode1 == LOADED and mode2 == LOADED:
            last = n
            if settled(mu, kappa, c1, c2, g, p1, d1, q2, v2):
                end = STUCK
                break

        k1, a1 = (1.0, c1) if mode1 == LOADED else (0.0, 0.0)
        k2, a2 = (kappa, c2) if mode2 == LOADED else (0.0, 0.0)
        # A loaded contact 2 carries m2 g at q2 = 0.
        carried = g if mode2 == LOADED else 0.0
        table[P1, 0], table[D1, 0], table[Q2, 0], table[V2, 0] = p1, d1, q2, v2
        x, fired, degree = 1.0, -1, ORDER
        if mode1 != LOADED and mode2 != LOADED:
            h, degree = flight_time(p1, d1, q2 + r2, v2, g), 2
            expand(table, degree, h, mu, k1, k2, a1, a2, carried, carried - g)
        elif law == LINEAR:
            h = longest_step(mu, k1, k2, a1, a2)
            expand(table, degree, h, mu, k1, k2, a1, a2, carried, carried - g)
        else:
            # A first guess, from the stiffness and the damping at this instant.
            stiff1, stiff2 = k1 * (1 + a1 * abs(d1)), k2 * (1 + a2 * abs(v2))
            h = longest_step(mu, stiff1, stiff2, a1 * k1 * abs(p1), a2 * k2 * abs(q2 + r2))
            expand_product(table, degree, h, mu, k1, k2, a1, a2, r2, carried, carried - g)
            x = trusted(table, degree)

        # Watched, each positive until its event: G of a loaded contact, -G of a slack one; the penetration
        # of a contact whose bodies overlap, the gap of an open one, or, frozen, its negative rate.
        if mode1 != OPEN:
            for j in range(degree + 1):
                G[0, j] = table[P1, j] + c1 * table[D1, j] if law == LINEAR else c1 * table[D1, j]
            G[0, 0] += 0.0 if law == LINEAR else 1.0
            sign = 1.0 if mode1 == LOADED else -1.0
            root = first_root(G, 0, sign, 0.0 if zero1 else sign * G[0, 0], degree, x)
            if root <= x:
                x, fired = root, 0
        if mode1 != LOADED or law == PRODUCT:
            row, start = (D1, d1) if frozen and mode1 == OPEN else (P1, p1)
            sign = -1.0 if mode1 == OPEN else 1.0
            root = first_root(table, row, sign, sign * start, degree, x)
            if root <= x:
                x, fired = root, 1
        if mode2 != OPEN:
            for j in range(degree + 1):
                G[1, j] = kappa * table[Q2, j] - c2 * table[V2, j] if law == LINEAR else -c2 * table[V2, j]
            G[1, 0] += kappa * r2 if law == LINEAR else 1.0
            sign = 1.0 if mode2 == LOADED else -1.0
            root = first_root(G, 1, sign, 0.0 if zero2 else sign * G[1, 0], degree, x)
            if root <= x:
                x, fired = root, 2
        if mode2 != LOADED or law == PRODUCT:
            row, start = (V2, -v2) if frozen and mode2 == OPEN else (Q2, q2 + r2)
            sign = -1.0 if mode2 == OPEN else 1.0
            root = first_root(table, row, -sign if row == V2 else sign, sign * start, degree, x)
            if root <= x:
                x, fired = root, 3
        level = False
        if g > 0 and mode1 == OPEN and mode2 != OPEN and not frozen:
            # B2 at rest counts once B1 no longer approaches: a border of stretches too.
            sign = 1.0 if d1 > 0 or (d1 == 0 and table[D1, 1] > 0) else -1.0
            root = first_root(table, D1, sign, sign * d1, degree, x)
            if root < x:
                x, fired, level = root, -1, True
        if g > 0 and x > 0:
            stop = over_within(table, degree, x, mode1 == LOADED, mode2 == LOADED, mu, 1.0, kappa, g)
            if stop < x:
                x, fired, level = stop, -1, False

        if x < 0:
            end = TOO_LONG  # numbers beyond what can be certified
            break
        write_row(log, n, time, (p1, d1, q2, v2), x * h, 1.0, kappa, mode1, mode2, g)
        p1, d1, q2, v2 = evaluate(table, degree, x)
        time += x * h
        zero1 = zero2 = False
        if level:
            d1 = 0.0
        if frozen and mode1 == OPEN:
            p1, d1 = 0.0, (0.0 if fired == 1 else min(d1, 0.0))
        if frozen and mode2 == OPEN:
            q2, v2 = -r2, (0.0 if fired == 3 else max(v2, 0.0))
        was1, was2 = mode1, mode2
        if fired == 0:
            zero1, mode1 = True, (SLACK if mode1 == LOADED else LOADED)
        elif fired == 1:
            p1, mode1 = 0.0, (LOADED if mode1 == OPEN else OPEN)
        elif fired == 2:
            zero2, mode2 = True, (SLACK if mode2 == LOADED else LOADED)
        elif fired == 3:
            q2, mode2 = -r2, (LOADED if mode2 == OPEN else OPEN)
        # Without a dashpot the force ends where the bodies part: the contact is never slack. Nor is it with frozen
        # positions.
        if mode1 == SLACK and (frozen or (law == LINEAR and c1 == 0)):
            p1, mode1 = 0.0, OPEN
        if mode2 == SLACK and (frozen or (law == LINEAR and c2 == 0)):
            q2, mode2 = -r2, OPEN
        event = 0
        if (was1 == LOADED) != (mode1 == LOADED):
            event = (END_OF_RESTITUTION if was1 == LOADED else RETURN) * 10 + 1
        elif (was2 == LOADED) != (mode2 == LOADED):
            event = (END_OF_RESTITUTION if was2 == LOADED else RETURN) * 10 + 2
        if n < log.shape[0]:
            log[n, 10] = event
        n_events += 1 if event > 0 else 0
        n += 1
        last = n if event > 0 else last

    write_row(log, n, time, (p1, d1, q2, v2), 0.0, 1.0, kappa, mode1, mode2, g)
    if state != 4:
        sequence, n_states = (sequence << np.uint64(2)) | np.uint64(3), n_states + 1
    return v2 - d1, v2, end, sequence, n_states, n_events, n, time, min(fall, time)
