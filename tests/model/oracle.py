"""The oracle: equations (13)-(15) integrated numerically in impulse space.

It shares nothing with the model but `Collision`: no closed-form motion, no time, no certified search.
The equations are, while both contacts act,

    (13) dE1/dI1 = v2 - v1      (14) dE2/dI2 = -v2      (15) dI2/dI1 = sqrt(k2 E2/(k1 E1))

with (11) v1 = v0 + I1/m1 and (12) v2 = (I2 - I1)/m2. In S2 and S3 the same hold for the contact that acts.

(15) is 0/0 at first touch and infinite where E1 = 0, so the impulses and x_i = sqrt(E_i) are functions of the arc
length s of the impulse curve,

    dI_i/ds = sqrt(k_i) x_i/N      dx_i/ds = sqrt(k_i) r_i/(2 N)      N = sqrt(k1 E1 + k2 E2 + c^2)

with the compression rates r1 = v2 - v1 and r2 = -v2; c keeps the parameter regular where both energies vanish. What is
watched is linear in the unknowns, a polynomial on each step of DOP853's dense output: where its Bernstein coefficients
are positive it has no root in the step; otherwise all its roots are computed, and the step is repeated to the first.

Units: m1 = 1, k1 = 1, v0 = -1 (Theorem 5); impulses per m1 |v0|, energies per m1 v0^2.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from itertools import groupby
from typing import NamedTuple

import numpy as np
from numpy.polynomial import Polynomial, chebyshev
from numpy.typing import NDArray
from scipy.integrate import DOP853

from impact_xval.model import SUPPLEMENT_CUTOFF, Collision

INACTIVE, COMPRESSION, RESTITUTION = 0, 1, 2

#: State index by (phase1, phase2 being active).
STATE_OF = {(True, True): 1, (False, True): 2, (True, False): 3, (False, False): 4}

#: First impulse I1 off the series, in units of 1/(1/M + k2/(k1 m2)), the impulse at which its terms are equal. Three
#: terms are kept, so what is left out is of relative order 1e-9 in an I2 that is itself below 1e-6.
SERIES_STEP = 1e-3

#: The constant c of the parametrisation over the largest force of a two-ball impact, sqrt(M).
SOFTENING = 0.05

#: Tolerances of impulses and of sqrt(E_i).
RTOL, ATOL = 1e-12, 1e-15

#: Segments shorter than this in s are two events at once: the state between them is not recorded.
TIE = 1e-13

#: Steps after which a collision is given up.
MAX_STEPS = 1_000_000

_DEGREE = 7

#: Fractions of a step at which a polynomial is sampled; the ends are among them.
NODES = 0.5 * (1 + chebyshev.chebpts2(_DEGREE + 1))

# Values at the nodes to coefficients in powers of the fraction u, and to Bernstein coefficients.
_TO_POWERS = np.linalg.inv(np.vander(NODES, increasing=True))
_BERNSTEIN = [
    [math.comb(_DEGREE, j) * u**j * (1 - u) ** (_DEGREE - j) for j in range(_DEGREE + 1)] for u in NODES
]
_TO_BERNSTEIN = np.linalg.inv(np.array(_BERNSTEIN))

#: Rounding of a root: imaginary parts below this are taken for zero (a double root splits into a complex pair), and so
#: is a root this little before the step.
_REAL = 1e-9

Vector = NDArray[np.float64]
Slope = Callable[[float, Vector], list[float]]


class Answer(NamedTuple):
    v1: float
    v2: float
    states: tuple[str, ...]
    status: str
    n_events: int


def solve_oracle(c: Collision, *, stiffness_ratio_cutoff: float = SUPPLEMENT_CUTOFF) -> Answer:
    """Integrate one collision in impulse space: finite, positive k2/k1 within the cut-off; e1, e2 > 0.

    In S1, once the running k2/k1 exceeds the cut-off or falls below its inverse, the supplement's closed form (3.4)
    finishes the collision, as it is printed: status `limit`. `model.solve` first lets a stiff contact that still holds
    energy part its bodies, which for e below about 0.03 shows at the order of 1/stiffness_ratio_cutoff.
    """
    run = _Run(c.stiffness_ratio, c.mass_ratio, (c.e1, c.e2))
    run.start()
    limit = False
    while run.state != 4 and not limit:
        ratio = run.k[1] / run.k[0]
        limit = run.state == 1 and not 1 / stiffness_ratio_cutoff <= ratio <= stiffness_ratio_cutoff
        if not limit:
            run.advance()
    v1, v2 = run.closed_form() if limit else run.velocities()
    states = tuple(f"S{i}" for i, _ in groupby([*run.visited, run.state, 4]))
    return Answer(v1 * -c.v0, v2 * -c.v0, states, "limit" if limit else "ok", run.n_events)


class _Run:
    """One collision under way: y = (I1, I2, x1, x2) at arc length s, phases, running stiffnesses."""

    def __init__(self, kappa: float, mu: float, e: tuple[float, float]) -> None:
        self.mu, self.e = mu, e
        self.k = [1.0, kappa]
        self.phase = [COMPRESSION, COMPRESSION]
        self.y: Vector = np.zeros(4)
        # r1 = 1 - I1/M + I2/m2 and r2 = (I1 - I2)/m2 as linear forms in y: (11), (12)
        self.rates = np.array([[-(1 + 1 / mu), 1 / mu, 0, 0], [1 / mu, -1 / mu, 0, 0]])
        self.rates_at_rest = np.array([1.0, 0.0])
        self.c2 = SOFTENING**2 * mu / (1 + mu)
        self.visited: list[int] = []
        self.n_events = self.n_steps = 0

    def start(self) -> None:
        """Place the start off the singular point, on the series."""
        kappa, mu = self.k[1], self.mu
        I1 = SERIES_STEP / (1 + 1 / mu + kappa / mu)
        I2, E1, E2 = series(kappa, mu, I1)
        self.y = np.array([I1, I2, math.sqrt(E1), math.sqrt(E2)])

    @property
    def state(self) -> int:
        return STATE_OF[self.phase[0] != INACTIVE, self.phase[1] != INACTIVE]

    def velocities(self) -> tuple[float, float]:
        """v1 and v2 by (11), (12)."""
        I1, I2 = self.y[:2].tolist()
        return I1 - 1, (I2 - I1) / self.mu

    def closed_form(self) -> tuple[float, float]:
        """Finish by the supplement's 3.4 (with 3.3, state S1), from the state at hand: final velocities."""
        v1, v2 = self.velocities()
        E1, E2 = (self.y[2:] ** 2).tolist()
        if self.k[1] < self.k[0]:  # one body of mass m1 + m2 against the table
            total = 1 + self.mu
            v = (v1 + self.mu * v2) / total
            v = math.sqrt(2 * E2 / total + v * v) * (self.e[1] if self.phase[1] == COMPRESSION else 1)
            return v, v
        v = math.sqrt(2 * E1 + v1 * v1) * (self.e[0] if self.phase[0] == COMPRESSION else 1)
        return v, 0.0

    def advance(self) -> None:
        """Integrate to the next event and apply it."""
        slope = self._slope()
        names, forms, offsets = self._watched()
        integrator = DOP853(slope, 0.0, self.y, math.inf, rtol=RTOL, atol=ATOL)
        while True:
            self.n_steps += 1
            assert self.n_steps < MAX_STEPS
            start, y_start = integrator.t, integrator.y
            problem = integrator.step()
            assert problem is None, problem
            h = integrator.t - start
            values = forms @ integrator.dense_output()(start + h * NODES) + offsets[:, None]
            root, which = first_fall(values, start == 0)
            if which >= 0:
                break
        end = start + root * h
        y = _reach(slope, start, y_start, end) if root > 0 else y_start
        # Newton's step along s takes what the dense output left over.
        dy = np.array(slope(end, y))
        fall = float(forms[which] @ dy)
        left = float(forms[which] @ y) + float(offsets[which])
        if abs(left) < -1e-3 * h * fall:
            y = y - left / fall * dy
            end -= left / fall
        self.y = y
        if end > TIE:
            self.visited.append(self.state)
        self._apply(*names[which])

    def _slope(self) -> Slope:
        """Build dy/ds as a function of (s, y); a contact that does not act keeps I_i and x_i."""
        g1 = math.sqrt(self.k[0]) if self.phase[0] != INACTIVE else 0.0
        g2 = math.sqrt(self.k[1]) if self.phase[1] != INACTIVE else 0.0
        c2, mu = self.c2, self.mu

        def slope(s: float, y: Vector) -> list[float]:
            I1, I2, x1, x2 = y.tolist()
            f1, f2 = g1 * x1, g2 * x2
            n = 1 / math.sqrt(f1 * f1 + f2 * f2 + c2)
            v2 = (I2 - I1) / mu
            return [f1 * n, f2 * n, 0.5 * g1 * (v2 + 1 - I1) * n, -0.5 * g2 * v2 * n]

        return slope

    def _watched(self) -> tuple[list[tuple[str, int]], Vector, Vector]:
        """Linear forms that are positive until their events: names, forms in y, constants."""
        names, forms, offsets = [], [], []
        for i, phase in enumerate(self.phase):
            sign = 1.0 if phase == COMPRESSION else -1.0
            names.append((("return", "end", "restart")[phase], i))
            forms.append(sign * self.rates[i])
            offsets.append(sign * self.rates_at_rest[i])
            if phase == RESTITUTION:
                names.append(("spent", i))
                forms.append(np.eye(4)[2 + i])
                offsets.append(0.0)
        return names, np.array(forms), np.array(offsets)

    def _apply(self, kind: str, i: int) -> None:
        """Apply the impact law: as compression ends, E_i <- e_i^2 E_i and k_i <- k_i/e_i^2."""
        self.n_events += 1
        if kind == "end":
            self.phase[i] = RESTITUTION
            self.y[2 + i] *= self.e[i]
            self.k[i] /= self.e[i] ** 2
        elif kind == "spent":
            self.phase[i] = INACTIVE
            self.y[2 + i] = 0.0
        else:  # "restart" keeps the stiffness, and so does "return", from E_i = 0
            self.phase[i] = COMPRESSION


def _reach(slope: Slope, s: float, y: Vector, end: float) -> Vector:
    """Repeat a step, up to `end`."""
    integrator = DOP853(slope, s, y, end, rtol=RTOL, atol=ATOL, first_step=end - s)
    while integrator.status == "running":
        integrator.step()
    return integrator.y


def series(kappa: float, mu: float, I1: float) -> tuple[float, float, float]:
    """I2, E1, E2 at a small first impulse I1, from the expansion of (13)-(15) about first touch.

    With I2 = c2 I1^2 + c3 I1^3 + c4 I1^4 and E1 = I1 + a2 I1^2 + a3 I1^3, the coefficients follow from
    E1 (dI2/dI1)^2 = (k2/k1) E2, which is (15) squared, in the orders 3, 4, 5.
    """
    a2 = -0.5 * (1 + 1 / mu)
    c2 = kappa / (6 * mu)
    a3 = c2 / (3 * mu)
    c3 = -(4 * a2 * c2 + 3 * c2 * c2) / 7.5
    c4 = -(9 * c3 * c3 + 12 * a2 * c2 * c3 + 4 * a3 * c2 * c2 + 6 * c2 * c2 * c3) / (11.2 * c2)
    I2 = I1 * I1 * (c2 + I1 * (c3 + I1 * c4))
    E1 = I1 * (1 + I1 * (a2 + I1 * (a3 + I1 * c3 / (4 * mu))))
    # (14) integrated: the integral of I1 dI2, less I2^2/2, over m2
    E2 = (I1**3 * (2 / 3 * c2 + I1 * (3 / 4 * c3 + I1 * 4 / 5 * c4)) - 0.5 * I2 * I2) / mu
    return I2, E1, E2


def first_fall(values: NDArray[np.float64], fresh: bool) -> tuple[float, int]:
    """First root, as a fraction of the step, at which a polynomial falls through zero, and its row (-1 if none does).

    `values` (n, 8) are those of the polynomials at `NODES`; `fresh` says that this is the first step after an event:
    whatever triggered that one starts at zero and rises.
    """
    first, which = math.inf, -1
    for row, coefficients in enumerate(values @ _TO_BERNSTEIN.T):
        if coefficients.min() > 0:
            continue
        polynomial = Polynomial(_TO_POWERS @ values[row])
        slope = polynomial.deriv()
        if values[row, 0] < 0 and (not fresh or slope(0.0) < 0):
            # By rounding its root fell into the step before, or ties with the event that was there.
            fall = 0.0
        else:
            roots = polynomial.roots()
            real = roots.real[(np.abs(roots.imag) < _REAL) & (roots.real > -_REAL) & (roots.real <= 1)]
            fall = min((max(u, 0.0) for u in real.tolist() if slope(u) < 0), default=math.inf)
        if fall < first:
            first, which = fall, row
    return first, which
