"""The oracle: equations (13)-(15) integrated numerically in impulse space.

It shares nothing with the model but `Collision`: no closed-form motion, no time, no certified search.
The equations are, while both contacts act,

    (13) dE1/dI1 = v2 - v1      (14) dE2/dI2 = -v2      (15) dI2/dI1 = sqrt(k2 E2/(k1 E1))

with (11) v1 = v0 + I1/m1 and (12) v2 = (I2 - I1)/m2. In S2 and S3 the same hold for the contact that acts.

(15) is 0/0 at first touch and infinite where E1 = 0, so the impulses and x_i = sqrt(E_i) are functions of the arc
length s of the impulse curve,

    dI_i/ds = sqrt(k_i) x_i/N      dx_i/ds = sqrt(k_i) r_i/(2 N)      N = sqrt(k1 E1 + k2 E2 + c^2)

with the compression rates r1 = v2 - v1 and r2 = -v2; c keeps the parameter regular where both energies vanish. What is
watched is linear in the unknowns, a polynomial on each step of DOP853's dense output: either its coefficients tell that
it has no root in the step, or all its roots are computed, and the step is repeated to the first.

Units: m1 = 1, k1 = 1, v0 = -1 (Theorem 5); impulses per m1 |v0|, energies per m1 v0^2.
"""

import math
from itertools import groupby
from typing import NamedTuple

import numpy as np
from numpy.polynomial import Polynomial, chebyshev
from scipy.integrate import DOP853, solve_ivp

from impact_xval.model import SUPPLEMENT_CUTOFF

INACTIVE, COMPRESSION, RESTITUTION = range(3)

#: States by (contact 1 acts, contact 2 acts).
STATES = {(True, True): "S1", (False, True): "S2", (True, False): "S3", (False, False): "S4"}

#: The constant c of the parametrisation over the largest force of a two-ball impact, sqrt(M).
SOFTENING = 0.05

#: Length in s of the start, in which no compression ends: part of the radian of the fastest vibration. Nothing is
#: watched there, for at first touch the second compression rate is zero.
START = 0.1

#: Tolerances of impulses and of sqrt(E_i).
RTOL, ATOL = 1e-12, 1e-15

#: Segments shorter than this in s are two events at once: the state between them is not recorded.
TIE = 1e-13

#: Fractions of a step at which a polynomial is sampled, the ends among them; the values there to its coefficients.
NODES = 0.5 * (1 + chebyshev.chebpts2(8))
TO_POWERS = np.linalg.inv(np.vander(NODES, increasing=True))

#: Rounding of a root: imaginary parts below this are taken for zero (a double root splits into a complex pair), and so
#: is a root this little before the step.
REAL = 1e-9


class Answer(NamedTuple):
    v1: float
    v2: float
    states: tuple[str, ...]
    status: str
    n_events: int


def solve_oracle(c, *, stiffness_ratio_cutoff=SUPPLEMENT_CUTOFF):
    """Integrate one collision in impulse space: finite, positive k2/k1 within the cut-off; e1, e2 > 0.

    In S1, once the running k2/k1 exceeds the cut-off or falls below its inverse, the supplement's closed form (3.4)
    finishes the collision, as it is printed: status `closed-form`. `model.solve` first lets a stiff contact that still
    holds energy part its bodies, which for e below about 0.03 shows at the order of 1/stiffness_ratio_cutoff.
    """
    run, most = _Run(c.stiffness_ratio, c.mass_ratio, (c.e1, c.e2)), stiffness_ratio_cutoff
    while run.state != "S4" and (run.state != "S1" or 1 / most <= run.k[1] / run.k[0] <= most):
        run.advance()
    limit = run.state != "S4"
    v1, v2 = run.closed_form() if limit else run.velocities()
    states = tuple(state for state, _ in groupby([*run.visited, run.state, "S4"]))
    return Answer(v1 * -c.v0, v2 * -c.v0, states, "closed-form" if limit else "ok", run.n_events)


class _Run:
    """One collision under way: y = (I1, I2, x1, x2) at arc length s, phases, running stiffnesses."""

    def __init__(self, kappa, mu, e):
        self.mu, self.e, self.k = mu, e, [1.0, kappa]
        self.phase, self.g = [COMPRESSION, COMPRESSION], [1.0, math.sqrt(kappa)]
        # r1 = 1 - I1/M + I2/m2 and r2 = (I1 - I2)/m2 as linear forms in y: (11), (12)
        self.rates = np.array([[-(1 + 1 / mu), 1 / mu, 0, 0], [1 / mu, -1 / mu, 0, 0]])
        self.c2 = SOFTENING**2 * mu / (1 + mu)
        self.visited, self.n_events = [], 0
        self.y = self.reach(0.0, np.zeros(4), START * math.sqrt(self.c2 / (1 + 1 / mu + kappa / mu)))

    @property
    def state(self):
        return STATES[self.phase[0] != INACTIVE, self.phase[1] != INACTIVE]

    def velocities(self):
        """v1 and v2 by (11), (12)."""
        I1, I2 = self.y[:2].tolist()
        return I1 - 1, (I2 - I1) / self.mu

    def closed_form(self):
        """Finish by the supplement's 3.4 (with 3.3, state S1), from the state at hand: final velocities."""
        v1, v2 = self.velocities()
        # The soft contact works alone: against one body of mass m1 + m2, or against B1 above B2 at rest.
        soft, mass, momentum = (1, 1 + self.mu, v1 + self.mu * v2) if self.k[1] < self.k[0] else (0, 1.0, v1)
        v = math.sqrt(2 * self.y[2 + soft] ** 2 / mass + (momentum / mass) ** 2)
        v *= self.e[soft] if self.phase[soft] == COMPRESSION else 1
        return v, soft * v

    def slope(self, _, y):
        """dy/ds; a contact that does not act keeps I_i and x_i."""
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
        # Newton's step along s takes what the dense output left over.
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
        """What is positive until its event: the contact and its phase after that, a linear form in y and a constant."""
        for i, phase in enumerate(self.phase):
            sign, after = (1.0, RESTITUTION) if phase == COMPRESSION else (-1.0, COMPRESSION)
            yield (i, after), sign * self.rates[i], sign * (1.0 - i)
            if phase == RESTITUTION:
                yield (i, INACTIVE), np.eye(4)[2 + i], 0.0

    def apply(self, i, after):
        """Apply the impact law: as compression ends, E_i <- e_i^2 E_i and k_i <- k_i/e_i^2; k_i stays from then on."""
        self.phase[i] = after
        if after == RESTITUTION:
            self.y[2 + i] *= self.e[i]
            self.k[i] /= self.e[i] ** 2
        elif after == INACTIVE:
            self.y[2 + i] = 0.0
        self.g[i] = 0.0 if after == INACTIVE else math.sqrt(self.k[i])


def first_fall(values, fresh):
    """First root, as a fraction of the step, at which a polynomial falls through zero; infinite if there is none.

    `values` are those of the polynomial at `NODES`; `fresh` says that this is the first step after an event: whatever
    triggered that one starts at zero and rises.
    """
    powers = TO_POWERS @ values
    if powers[0] + np.minimum(powers[1:], 0).sum() > 0:
        return math.inf
    polynomial = Polynomial(powers)
    slope = polynomial.deriv()
    if values[0] < 0 and (not fresh or slope(0.0) < 0):
        return 0.0  # by rounding its root fell into the step before, or ties with the event that was there
    roots = polynomial.roots()
    real = roots.real[(np.abs(roots.imag) < REAL) & (roots.real > -REAL) & (roots.real <= 1)]
    return min((max(u, 0.0) for u in real.tolist() if slope(u) < 0), default=math.inf)
