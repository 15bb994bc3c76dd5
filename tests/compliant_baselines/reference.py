"""An independent Kelvin-Voigt column: scipy integrates forces that follow from the state; no event is watched.

Contact i is F = max(0, k delta + c delta') while delta > 0. With an impedance d, contacts are those of MuJoCo's
regularised constraints in continuous time: (1 - d) F_i = k_i delta_i + c_i delta_i' - d M_i a_i, with a_i the rate at
which contact i separates faster (the chapter "Computation" of its documentation, at a constant impedance and with
stiffness k_i/M_i and damping c_i/M_i). Since a_1 = F1/M1 - F2/m2 and a_2 = (F2 - F1)/m2, that is
F1 = L1 + d (M1/m2) F2 and F2 = L2 + d F1, with L_i the force without; not for use with gravity.
"""

from typing import NamedTuple

import numpy as np
from scipy.integrate import DOP853

NAMES = {(True, True): "S1", (False, True): "S2", (True, False): "S3", (False, False): "S4"}


class Reference(NamedTuple):
    """Velocities, impulses (gravity's not among them) and contact states passed through."""

    v1: float
    v2: float
    impulse1: float
    impulse2: float
    states: tuple[str, ...]


def kelvin_voigt(m1, m2, k1, k2, c1, c2, v0, *, gravity=0.0, until=np.inf, impedance=0.0):
    """B1 touches B2 at v0; B2 touches the table at rest, or with gravity rests on it in equilibrium.

    Ends at the time `until`, or where no contact acts and v1 >= v2 >= 0. Units of the integration: m1 = k1 = |v0| = 1.
    """
    omega, speed = np.sqrt(k1 / m1), abs(v0)
    m, kappa, g1, g2 = m2 / m1, k2 / k1, c1 * omega / k1, c2 * omega / k1
    g = gravity / (speed * omega)
    passed1, passed2 = impedance / (1 + m), impedance  # d M1/m2 and d

    def forces(y):
        x1, x2, v1, v2 = y[:4]
        met1, met2 = x1 < x2, x2 < 0
        alone1, alone2 = x2 - x1 + g1 * (v2 - v1), -kappa * x2 - g2 * v2
        whole = 1 - passed1 * passed2
        both = (alone1 + passed1 * alone2) / whole, (alone2 + passed2 * alone1) / whole
        if met1 and met2 and min(both) > 0:
            return both
        return met1 * max(alone1, 0.0), met2 * max(alone2, 0.0)

    def motion(_time, y):
        f1, f2 = forces(y)
        return [y[2], y[3], f1 - g, (f2 - f1) / m - g, f1, f2]

    start = [-m * g / kappa] * 2 + [-1.0, 0.0, 0.0, 0.0]
    fastest = np.sqrt(max(1, kappa / m))
    run = DOP853(motion, 0.0, start, until * omega, rtol=1e-11, atol=1e-14, max_step=0.1 / fastest)
    states = ["S1"]
    while run.status == "running":
        assert run.step() is None
        first, second = forces(run.y)
        if NAMES[first > 0, second > 0] != states[-1]:
            states.append(NAMES[first > 0, second > 0])
        if until == np.inf and states[-1] == "S4" and run.y[2] >= run.y[3] >= 0:
            break
    v1, v2, i1, i2 = run.y[2:] * speed
    return Reference(v1, v2, i1 * m1, i2 * m1, tuple(states))
