"""Independent solution of two balls on a table: equations (13)-(15), integrated numerically in impulse space.

The model is compared with it. Of the model it uses only `Collision` and a constant: no closed-form motion, no time, no
certified search for events. While both contacts are active, the equations are

    (13) dE1/dI1 = v2 - v1      (14) dE2/dI2 = -v2      (15) dI2/dI1 = sqrt(k2 E2/(k1 E1))

with (11) v1 = v0 + I1/m1 and (12) v2 = (I2 - I1)/m2. In states S2 and S3 these equations are used for the one active
contact.

Equation (15) is 0/0 at first touch and infinite where E1 = 0. Therefore the impulses I_i and the roots of the energies
x_i = sqrt(E_i) are written as functions of the arc length s of the impulse curve:

    dI_i/ds = sqrt(k_i) x_i/N      dx_i/ds = sqrt(k_i) r_i/(2 N)      N = sqrt(k1 E1 + k2 E2 + c^2)

The compression rates are r1 = v2 - v1 and r2 = -v2. The constant c keeps the equations regular where both energies
vanish.

Events are zeros of linear functions of the unknowns. On each step of DOP853's dense output such a function is a
polynomial. Either its coefficients prove that it has no root in the step, or all its roots are computed and the
integration is repeated up to the first one.

Units: m1 = 1, k1 = 1, v0 = -1 (Theorem 5). Impulses are in units of m1 |v0|, energies in units of m1 v0^2.
"""

import math
from itertools import groupby
from typing import NamedTuple

import numpy as np
from numpy.polynomial import Polynomial, chebyshev
from scipy.integrate import DOP853, solve_ivp

from impact_xval.model import SUPPLEMENT_CUTOFF

INACTIVE, COMPRESSION, RESTITUTION = range(3)

#: State of a pair, by whether contact 1 and contact 2 are active.
STATES = {(True, True): "S1", (False, True): "S2", (True, False): "S3", (False, False): "S4"}

#: The constant c of the equations in arc length, as a share of the largest contact force of an impact of two balls,
#: sqrt(M).
SOFTENING = 0.05

#: Length in s of the first stretch of the curve, as a part of the radian of the fastest vibration. No compression ends
#: there. Events are not searched there, because the second compression rate is zero at first touch.
START = 0.1

#: Relative and absolute tolerance of the integration, for impulses and for sqrt(E_i).
RTOL, ATOL = 1e-12, 1e-15

#: If a segment is shorter than this in s, its two events count as simultaneous, and the state between them is not
#: recorded.
TIE = 1e-13

#: Fractions of a step at which a polynomial is sampled (both ends included), and the matrix that turns the sampled
#: values into coefficients.
NODES = 0.5 * (1 + chebyshev.chebpts2(8))
TO_POWERS = np.linalg.inv(np.vander(NODES, increasing=True))

#: Rounding of a root. An imaginary part below this value counts as zero, because a double root splits into a complex
#: pair. A root that lies before the step by less than this counts as a root in the step.
REAL = 1e-9


class Answer(NamedTuple):
    v1: float
    v2: float
    states: tuple[str, ...]
    status: str
    n_events: int


def solve_oracle(c, *, stiffness_ratio_cutoff=SUPPLEMENT_CUTOFF):
    """Integrate one collision in impulse space. It needs finite, positive k2/k1 within the cut-off, and e1, e2 > 0.

    When the running k2/k1 in S1 exceeds the cut-off or falls below its inverse, the closed form printed in the
    supplement (3.4) finishes the collision, and the status is `closed-form`. Here `model.solve` differs: it first lets
    a stiff contact that still holds energy separate its bodies. For e below about 0.03 this changes the outcome by the
    order of 1/stiffness_ratio_cutoff.
    """
    run, most = _Run(c.stiffness_ratio, c.mass_ratio, (c.e1, c.e2)), stiffness_ratio_cutoff
    while run.state != "S4" and (run.state != "S1" or 1 / most <= run.k[1] / run.k[0] <= most):
        run.advance()
    limit = run.state != "S4"
    v1, v2 = run.closed_form() if limit else run.velocities()
    states = tuple(state for state, _ in groupby([*run.visited, run.state, "S4"]))
    return Answer(v1 * -c.v0, v2 * -c.v0, states, "closed-form" if limit else "ok", run.n_events)


class _Run:
    """A collision during its integration: y = (I1, I2, x1, x2) at an arc length s, phases and stiffnesses."""

    def __init__(self, kappa, mu, e):
        self.mu, self.e, self.k = mu, e, [1.0, kappa]
        self.phase, self.g = [COMPRESSION, COMPRESSION], [1.0, math.sqrt(kappa)]
        # The compression rates r1 = 1 - I1/M + I2/m2 and r2 = (I1 - I2)/m2, by (11) and (12), as linear functions of y.
        self.rates = np.array([[-(1 + 1 / mu), 1 / mu, 0, 0], [1 / mu, -1 / mu, 0, 0]])
        self.c2 = SOFTENING**2 * mu / (1 + mu)
        self.visited, self.n_events = [], 0
        self.y = self.reach(0.0, np.zeros(4), START * math.sqrt(self.c2 / (1 + 1 / mu + kappa / mu)))

    @property
    def state(self):
        return STATES[self.phase[0] != INACTIVE, self.phase[1] != INACTIVE]

    def velocities(self):
        """Return the velocities v1 and v2 by (11) and (12)."""
        I1, I2 = self.y[:2].tolist()
        return I1 - 1, (I2 - I1) / self.mu

    def closed_form(self):
        """Return the final velocities by the supplement's 3.4 (with 3.3), from the present state S1."""
        v1, v2 = self.velocities()
        # Only the soft contact changes the motion: either the united balls, of mass m1 + m2, on the table, or B1 on a
        # B2 at rest.
        soft, mass, momentum = (1, 1 + self.mu, v1 + self.mu * v2) if self.k[1] < self.k[0] else (0, 1.0, v1)
        v = math.sqrt(2 * self.y[2 + soft] ** 2 / mass + (momentum / mass) ** 2)
        v *= self.e[soft] if self.phase[soft] == COMPRESSION else 1
        return v, soft * v

    def slope(self, _, y):
        """Return dy/ds, the derivative of the unknowns. An inactive contact keeps its I_i and x_i."""
        (I1, I2, x1, x2), (g1, g2) = y.tolist(), self.g
        f1, f2, v2 = g1 * x1, g2 * x2, (I2 - I1) / self.mu
        n = 1 / math.sqrt(f1 * f1 + f2 * f2 + self.c2)
        return [f1 * n, f2 * n, 0.5 * g1 * (v2 + 1 - I1) * n, -0.5 * g2 * v2 * n]

    def reach(self, s, y, end):
        run = solve_ivp(self.slope, (s, end), y, "DOP853", rtol=RTOL, atol=ATOL, first_step=end - s)
        return run.y[:, -1]

    def advance(self):
        events, forms, offsets = zip(*self.watched(), strict=True)
        integrator = DOP853(self.slope, 0.0, self.y, math.inf, rtol=RTOL, atol=ATOL)
        while True:
            start, y = integrator.t, integrator.y
            problem = integrator.step()
            assert problem is None, problem
            h = integrator.t - start
            values = forms @ integrator.dense_output()(start + h * NODES) + np.reshape(offsets, (-1, 1))
            root, which = min((first_fall(row, start == 0), i) for i, row in enumerate(values))
            if root <= 1:
                break
        end = start + root * h
        if root > 0:
            y = self.reach(start, y, end)
        # One step of Newton's method along s removes the error of the dense output.
        dy = np.array(self.slope(end, y))
        fall, left = forms[which] @ dy, forms[which] @ y + offsets[which]
        if abs(left) < -1e-3 * h * fall:
            y, end = y - left / fall * dy, end - left / fall
        self.y = y
        if end > TIE:
            self.visited.append(self.state)
        self.n_events += 1
        self.apply(*events[which])

    def watched(self):
        """Yield for each possible event its contact, the phase after it, and a function that is positive until then.

        The function is linear in y. It is given by its coefficients and a constant.
        """
        for i, phase in enumerate(self.phase):
            sign, after = (1.0, RESTITUTION) if phase == COMPRESSION else (-1.0, COMPRESSION)
            yield (i, after), sign * self.rates[i], sign * (1.0 - i)
            if phase == RESTITUTION:
                yield (i, INACTIVE), np.eye(4)[2 + i], 0.0

    def apply(self, i, after):
        """Apply the impact law: an end of compression turns E_i into e_i^2 E_i and k_i into k_i/e_i^2 for good."""
        self.phase[i] = after
        if after == RESTITUTION:
            self.y[2 + i] *= self.e[i]
            self.k[i] /= self.e[i] ** 2
        elif after == INACTIVE:
            self.y[2 + i] = 0.0
        self.g[i] = 0.0 if after == INACTIVE else math.sqrt(self.k[i])


def first_fall(values, fresh):
    """Return where a polynomial first falls through zero, as a fraction of the step; infinity if nowhere.

    `values` are the values of the polynomial at `NODES`. `fresh` means that the step is the first after an event. Then
    the function that triggered the event starts at zero and rises, and this zero does not count.
    """
    powers = TO_POWERS @ values
    if powers[0] + np.minimum(powers[1:], 0).sum() > 0:
        return math.inf
    polynomial = Polynomial(powers)
    slope = polynomial.deriv()
    if values[0] < 0 and (not fresh or slope(0.0) < 0):
        return 0.0  # rounding put the root into the step before, or it coincides with the event at the start
    roots = polynomial.roots()
    real = roots.real[(np.abs(roots.imag) < REAL) & (roots.real > -REAL) & (roots.real <= 1)]
    return min((max(u, 0.0) for u in real.tolist() if slope(u) < 0), default=math.inf)
