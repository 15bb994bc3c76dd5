"""An independent solution of the model: plain event-driven integration in time with scipy.

Shares nothing with the package but the parameters. The unknowns are positions and velocities, the integrator is
DOP853, events are found by sign changes on its dense output.
"""

import math
from typing import NamedTuple

import numpy as np
from scipy.integrate import solve_ivp


class Answer(NamedTuple):
    v1: float
    v2: float
    states: tuple[str, ...]
    limit: bool


def integrate(kappa, mu, e1, e2, cutoff=math.inf, rtol=1e-12, resolution=0.1):
    """Model in units m1 = 1, k1 = 1, v0 = -1; the cut-off as the design of the model prescribes it.

    The sign alone is looked at: of two events closer than `resolution` (rad of the fastest mode), both can be missed.
    """
    k = np.array([1.0, kappa])
    e = np.array([e1, e2])
    y = np.array([-1.0, 0.0, 0.0, 0.0])  # v1, v2, delta1, delta2
    active = [True, True]
    compressing = [True, True]
    states = ["S1"]
    while True:
        ratio = k[1] / k[0]
        if states[-1] == "S1" and not 1 / cutoff <= ratio <= cutoff:
            v1, v2, x1, x2 = y
            if ratio < 1:  # one body: 3.3 of the supplement for S1
                v = math.sqrt(k[1] * x2 * x2 / (1 + mu) + v2 * v2)
                v *= e2 if compressing[1] else 1
                return Answer(v, v, (*states, "S4"), True)
            v = math.sqrt(k[0] * x1 * x1 + v1 * v1)
            return Answer(v * (e1 if compressing[0] else 1), 0.0, (*states, "S4"), True)

        def rhs(_, y, k=k, active=tuple(active)):
            f1 = k[0] * y[2] if active[0] else 0.0
            f2 = k[1] * y[3] if active[1] else 0.0
            return [f1, (f2 - f1) / mu, (y[1] - y[0]) if active[0] else 0.0, -y[1] if active[1] else 0.0]

        # name and function, positive until the event
        watched = []
        for i, rate in ((0, lambda y: y[1] - y[0]), (1, lambda y: -y[1])):
            if not active[i]:
                watched.append((f"return{i}", lambda t, y, rate=rate: -rate(y)))
            elif compressing[i]:
                watched.append((f"end{i}", lambda t, y, rate=rate: rate(y)))
            else:
                watched.append((f"restart{i}", lambda t, y, rate=rate: -rate(y)))
                watched.append((f"spent{i}", lambda t, y, i=i: y[2 + i]))
        for _, f in watched:
            f.terminal, f.direction = True, -1
        fastest = math.sqrt(k[0] * (1 + 1 / mu) + k[1] / mu)
        # 40 slow half periods: far longer than any stretch lasts
        horizon = 40 * math.pi * math.sqrt((1 + mu) / min(k))
        run = solve_ivp(
            rhs,
            (0, horizon),
            y,
            method="DOP853",
            rtol=rtol,
            atol=1e-15 * np.array([1, 1, 1 / fastest, 1 / fastest]),
            events=[f for _, f in watched],
            max_step=resolution / fastest,
            first_step=1e-3 / fastest,
        )
        assert run.status == 1, run.message
        y = run.y[:, -1].copy()
        name = next(name for (name, _), t in zip(watched, run.t_events, strict=True) if t.size)
        i = int(name[-1])
        if name.startswith(("end", "restart", "return")):
            if i == 0:
                y[0] = y[1]
            else:
                y[1] = 0.0
        if name.startswith("end"):
            compressing[i] = False
            y[2 + i] *= e[i] ** 2
            k = k.copy()
            k[i] /= e[i] ** 2
        elif name.startswith("restart"):
            compressing[i] = True
        elif name.startswith("spent"):
            active[i] = False
            y[2 + i] = 0.0
        else:
            active[i], compressing[i], y[2 + i] = True, True, 0.0
        state = {(True, True): "S1", (False, True): "S2", (True, False): "S3", (False, False): "S4"}[
            tuple(active)
        ]
        if state != states[-1]:
            states.append(state)
        if state == "S4":
            return Answer(float(y[0]), float(y[1]), tuple(states), False)
