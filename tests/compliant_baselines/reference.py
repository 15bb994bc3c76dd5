"""An independent Kelvin-Voigt column, integrated in time between located events by scipy.

Shares no code with the package: damping comes in as a number. Contact i is F = max(0, k delta + c delta')
while delta > 0. Everything is integrated in units in which m1 = k1 = |v0| = 1, so that tolerances mean the
same for every collision.

With an impedance d, contacts are those of MuJoCo's regularised constraints in continuous time: (1 - d) F_i =
k_i delta_i + c_i delta_i' - d M_i a_i, with a_i the rate at which contact i separates faster (the chapter
"Computation" of its documentation, at a constant impedance and with stiffness k_i/M_i and damping c_i/M_i).
Since a_1 = F1/M1 - F2/m2 and a_2 = (F2 - F1)/m2, that is F1 = L1 + d (M1/m2) F2 and F2 = L2 + d F1, with L_i
the force without; not for use with gravity.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.integrate import solve_ivp

NAMES = {(True, True): "S1", (False, True): "S2", (True, False): "S3", (False, False): "S4"}


@dataclass(frozen=True)
class Reference:
    """Velocities, impulses (gravity's not among them), time and contact states passed through."""

    v1: float
    v2: float
    impulse1: float
    impulse2: float
    time: float
    states: tuple[str, ...]


def kelvin_voigt(
    m1: float,
    m2: float,
    k1: float,
    k2: float,
    c1: float,
    c2: float,
    v0: float,
    *,
    gravity: float = 0.0,
    until: float | None = None,
    impedance: float = 0.0,
    rtol: float = 1e-11,
    max_pieces: int = 400,
) -> Reference:
    """B1 touches B2 at v0; B2 touches the table at rest, or with gravity rests on it in equilibrium.

    Ends at the time `until`, or without one when no contact is active and v1 >= v2 >= 0 (without gravity that
    is for good).
    """
    omega, speed = np.sqrt(k1 / m1), abs(v0)
    m, kappa, g1, g2 = m2 / m1, k2 / k1, c1 * omega / k1, c2 * omega / k1
    g = gravity / (speed * omega)
    end = np.inf if until is None else until * omega
    coupling = (impedance / (1 + m), impedance)  # d M1/m2 and d

    def laws(y: np.ndarray) -> tuple[float, float, float, float]:
        x1, x2, v1, v2 = y[:4]
        d1, d2 = x2 - x1, -x2
        return d1, d2, d1 + g1 * (v2 - v1), kappa * d2 - g2 * v2

    def piece(on1: bool, on2: bool):
        def forces(y):
            _, _, f1, f2 = laws(y)
            f1, f2 = (f1 if on1 else 0.0), (f2 if on2 else 0.0)
            if on1 and on2:
                whole = 1 - coupling[0] * coupling[1]
                f1, f2 = (f1 + coupling[0] * f2) / whole, (f2 + coupling[1] * f1) / whole
            return f1, f2

        def rhs(_t, y):
            f1, f2 = forces(y)
            return [y[2], y[3], f1 - g, (f2 - f1) / m - g, f1, f2]

        def watch(index: int, on: bool):
            # An active contact ends when its force falls through zero. An inactive one returns when
            # penetration and would-be force are both there: the smaller of the two rises through zero.
            def event(_t, y):
                d, f = laws(y), forces(y)
                return f[index] if on else min(d[index], d[2 + index] + coupling[index] * f[1 - index])

            event.terminal = True
            event.direction = -1 if on else 1
            return event

        return rhs, [watch(0, on1), watch(1, on2)]

    rest = -m * g / kappa
    y, t, on, states = np.array([rest, rest, -1.0, 0.0, 0.0, 0.0]), 0.0, [True, True], ["S1"]
    for _ in range(max_pieces):
        over = until is None and not any(on) and y[2] >= y[3] >= 0
        if over or t >= end:
            v1, v2, i1, i2 = y[2:] * speed
            return Reference(v1, v2, i1 * m1, i2 * m1, t / omega, tuple(states))
        rhs, events = piece(*on)
        solution = solve_ivp(
            rhs,
            (t, min(end, t + 1e5)),
            y,
            method="DOP853",
            rtol=rtol,
            atol=rtol * 1e-3,
            events=events,
            max_step=0.2 / np.sqrt(max(1, kappa / m)) if any(on) else 1e3,
        )
        t, y = solution.t[-1], solution.y[:, -1]
        hits = [i for i in (0, 1) if solution.t_events[i].size]
        if not hits and t < end:
            raise RuntimeError("the reference never came to the next event")
        for i in hits:
            on[i] = not on[i]
        if hits:
            states.append(NAMES[on[0], on[1]])
    raise RuntimeError("too many events for the reference")
