"""Impulse-level impact laws, integrated in time with scipy: the model's own, and that of Liu, Zhao and Brogliato.

Both are energetic restitution by a second stiffness of unloading, k/e^2, with positions frozen. They differ in
what a compression that is not the first uses:

* the model: the stiffness the contact has by then, k/e^(2n) after n ends of compression;
* Liu, Zhao and Brogliato (Proc. R. Soc. A 464:3193, 2008): the original k. Their energy is E with F = sqrt(2 k E)
  at all times; dE = V dP in compression, V dP/e^2 in expansion, where V is the rate and P the impulse. So a restart
  of compression during restitution keeps the *force* and E: in the model's terms, where the recoverable energy
  during restitution is e^2 E, stiffness and energy go to k and E together. A return starts from E = 0 with k.

The reading of the restart is that of the implementation by the authors' group (Siconos, OSNSMultipleImpact,
`Compute_energyContact`). The known numbers involve returns only, so they pin down the return, not the restart.
"""

import math
from typing import NamedTuple

import numpy as np
from scipy.integrate import solve_ivp


class Answer(NamedTuple):
    v1: float
    v2: float
    states: tuple[str, ...]
    compressions: tuple[int, int]  # how many each contact began


def integrate(kappa, mu, e1, e2, original_stiffness, rtol=1e-12, least=0.0):
    """Units m1 = 1, k1 = 1, v0 = -1; unknowns v1, v2 and the forces F1, F2; ends early where all are below `least`."""
    loading, e = (1.0, kappa), (e1, e2)
    k, phase, begun = list(loading), ["compression", "compression"], [1, 1]
    y = np.array([-1.0, 0.0, 0.0, 0.0])
    rates = (lambda y: y[1] - y[0], lambda y: -y[1])
    states = ["S1"]
    while states[-1] != "S4" and np.max(np.abs(y)) > least:
        on = [p != "inactive" for p in phase]
        k1, k2 = (k[i] * on[i] for i in (0, 1))

        def motion(_t, y, k1=k1, k2=k2):
            return [y[2], (y[3] - y[2]) / mu, k1 * (y[1] - y[0]), -k2 * y[1]]

        watched = []
        for i in (0, 1):
            down = 1 if phase[i] == "compression" else -1
            watched.append((i, lambda _t, y, i=i, s=down: s * rates[i](y)))
            if phase[i] == "restitution":
                watched.append((i + 2, lambda _t, y, i=i: y[2 + i]))
        for _, event in watched:
            event.terminal, event.direction = True, -1
        w = math.sqrt(k1 * (1 + 1 / mu) + k2 / mu)
        run = solve_ivp(
            motion, (0, 1e4), y, method="DOP853", rtol=rtol, atol=1e-15, events=[f for _, f in watched],
            max_step=0.03 / w, first_step=1e-4 / w,  # at 0.1 / w it misses a return and its end
        )  # fmt: skip
        assert run.status == 1, run.message
        y = run.y[:, -1].copy()
        which = next(i for (i, _), t in zip(watched, run.t_events, strict=True) if t.size)
        i = which % 2
        if which >= 2:
            phase[i], y[2 + i] = "inactive", 0.0
        else:
            y[0 if i == 0 else 1] = y[1] if i == 0 else 0.0
            if phase[i] == "compression":
                phase[i], k[i] = "restitution", k[i] / e[i] ** 2
            else:
                phase[i] = "compression"
                begun[i] += 1
                k[i] = loading[i] if original_stiffness else k[i]
        on = tuple(p != "inactive" for p in phase)
        state = {(True, True): "S1", (False, True): "S2", (True, False): "S3", (False, False): "S4"}[on]
        if state != states[-1]:
            states.append(state)
    return Answer(float(y[0]), float(y[1]), tuple(states), (begun[0], begun[1]))
