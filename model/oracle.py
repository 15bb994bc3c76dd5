"""The oracle: equations (13)-(15) integrated numerically in impulse space, for tests and for doubt.

It shares nothing with the solver but `Collision` and `Outcome`: no closed-form motion, no time, no certified search.
The equations are, while both contacts act,

    (13) dE1/dI1 = v2 - v1      (14) dE2/dI2 = -v2      (15) dI2/dI1 = sqrt(k2 E2/(k1 E1))

with (11) v1 = v0 + I1/m1 and (12) v2 = (I2 - I1)/m2. In S2 and S3 the same hold for the contact that acts.

**Parametrisation.** (15) is 0/0 at first touch and infinite where E1 = 0 (a return, an end of restitution), so I1 is no
good independent variable, and E_i is none either: its slope in the impulse of the other contact vanishes like
sqrt(E_i). Both impulses and x_i = sqrt(E_i) are therefore functions of the arc length s of the impulse curve,

    dI_i/ds = sqrt(k_i) x_i/N      dx_i/ds = sqrt(k_i) r_i/(2 N)      N = sqrt(k1 E1 + k2 E2 + c^2)

with the compression rates r1 = v2 - v1 and r2 = -v2. Dividing one by another gives (13)-(15) back, whatever N is. With
c = 0 the parameter is the arc length exactly; the small constant c keeps it regular where both energies vanish. x_i
passes through zero with a finite slope, so an end of restitution is a simple root.

**Events.** Everything watched is linear in the unknowns, and so is a polynomial on each step of DOP853's dense output,
of degree 7. Where its Bernstein coefficients are positive it has no root in the step; otherwise all its roots are
computed (`first_fall`), so that a pair of roots inside one step, which a look at the signs would pass over, is found.
The step is then repeated up to the first one.

Units: m1 = 1, k1 = 1, v0 = -1 (Theorem 5); impulses per m1 |v0|, energies per m1 v0^2.
"""

# The symbols of the paper, I1 and E1, are variables here; scipy states no types.
# pyright: reportConstantRedefinition=false, reportMissingTypeStubs=false

from __future__ import annotations

import math
from collections.abc import Callable
from itertools import groupby
from typing import Protocol, cast

import numpy as np
from numpy.polynomial import Polynomial, chebyshev
from numpy.typing import NDArray
from scipy.integrate import DOP853

from impact_xval.model.collision import STATES, Collision, Outcome
from impact_xval.model.inputs import SUPPLEMENT_CUTOFF

NAME = "oracle"

INACTIVE, COMPRESSION, RESTITUTION = 0, 1, 2

#: State index by (phase1, phase2 being active).
STATE_OF = {(True, True): 1, (False, True): 2, (True, False): 3, (False, False): 4}

#: First impulse I1 off the series, in units of 1/(1/M + k2/(k1 m2)), the impulse at which its terms are equal. Three
#: terms are kept, so what is left out is of relative order 1e-9 in an I2 that is itself below 1e-6.
SERIES_STEP = 1e-3

#: The constant c of the parametrisation over the largest force of a two-ball impact, sqrt(M).
SOFTENING = 0.05

#: Absolute tolerance of impulses and of sqrt(E_i).
ATOL = 1e-15

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


class Integrator(Protocol):
    """What is used of scipy's integrators."""

    t: float
    y: Vector
    status: str

    def step(self) -> str | None:
        """Make one step; say what went wrong, if anything did."""
        ...

    def dense_output(self) -> Callable[[Vector], Vector]:
        """Return the solution over the last step."""
        ...


def solve_oracle(
    collision: Collision,
    *,
    stiffness_ratio_cutoff: float = SUPPLEMENT_CUTOFF,
    first_step: float | None = None,
    rtol: float = 1e-12,
    max_steps: int = MAX_STEPS,
) -> Outcome:
    r"""Integrate one collision in impulse space.

    Parameters
    ----------
    collision : Collision
        Finite, positive k2/k1; e1, e2 > 0. Limits are not represented.
    stiffness_ratio_cutoff : float
        In S1, once the running k2/k1 exceeds this or falls below its inverse, the supplement's closed form (3.4)
        finishes the collision. As for `model.solve`, whose default needs none; with infinity the cost of a cell grows
        with the square root of the ratio it drifts to. The closed form is applied as it is printed; `model.solve` first
        lets a stiff contact that still holds energy part its bodies, which for e below about 0.03 shows at the order of
        1/stiffness_ratio_cutoff.
    first_step : float, optional
        The paper's finite first step instead of the series: the impulse I1 after it, per m1 \|v0\|.
    rtol : float
        Relative tolerance of the integration.
    max_steps : int
        Steps after which the collision is given up, with the status ``unconverged``.

    Returns
    -------
    Outcome
        Status ``ok``, ``limit`` (the cut-off was reached) or ``unconverged``. No path.

    Raises
    ------
    ValueError
        For a limit (k2/k1 = 0, infinity or beyond the cut-off from the start; e_i = 0), which has no differential
        equation, and for an illegal option.
    """
    c = collision
    _refuse(c, stiffness_ratio_cutoff, first_step)
    run = _Run(c.stiffness_ratio, c.mass_ratio, (c.e1, c.e2), rtol, max_steps)
    run.start(first_step)
    limit = False
    while run.state != 4:
        if run.state == 1:
            ratio = run.k[1] / run.k[0]
            limit = not 1 / stiffness_ratio_cutoff <= ratio <= stiffness_ratio_cutoff
            if limit:
                break
        problem = run.advance()
        if problem:
            return Outcome.failure(NAME, "unconverged", problem)
    v1, v2 = run.closed_form() if limit else run.velocities()
    mu, speed = c.mass_ratio, -c.v0
    diagnostics: dict[str, float] = {"steps": run.n_steps}
    if not limit:
        diagnostics["energy_residual"] = 0.5 - run.loss - 0.5 * (v1 * v1 + mu * v2 * v2)
    return Outcome(
        solver=NAME,
        v1=v1 * speed,
        v2=v2 * speed,
        impulse1=c.m1 * speed * (1 + v1),
        impulse2=c.m1 * speed * (1 + v1 + mu * v2),
        states=tuple(STATES[i] for i, _ in groupby([*run.visited, run.state, 4])),
        status="limit" if limit else "ok",
        reason=f"the running stiffness ratio left the cut-off {stiffness_ratio_cutoff:g}" if limit else "",
        n_events=run.n_events,
        diagnostics=diagnostics,
    )


def _refuse(c: Collision, cutoff: float, first_step: float | None) -> None:
    ratio = c.stiffness_ratio
    if not cutoff > 1:
        raise ValueError(f"stiffness_ratio_cutoff = {cutoff!r}; legal: greater than 1, up to inf")
    if ratio == 0 or math.isinf(ratio):
        raise ValueError(f"k2/k1 = {ratio:g}: the oracle integrates finite, positive stiffness ratios only")
    if not 1 / cutoff <= ratio <= cutoff:
        raise ValueError(f"k2/k1 = {ratio:g} lies beyond the cut-off {cutoff:g} from the start: a limit")
    for name in ("e1", "e2"):
        if getattr(c, name) == 0:
            raise ValueError(f"{name} = 0: the stiffness becomes infinite, which the oracle cannot integrate")
    largest = 1 / (1 + 1 / c.mass_ratio)
    if first_step is not None and not 0 < first_step < largest:
        raise ValueError(
            f"first_step = {first_step!r}; legal: greater than 0, below m2/(m1 + m2) = {largest:g}"
        )


class _Run:
    """One collision under way: y = (I1, I2, x1, x2) at arc length s, phases, running stiffnesses."""

    def __init__(self, kappa: float, mu: float, e: tuple[float, float], rtol: float, max_steps: int) -> None:
        self.mu, self.e, self.rtol, self.max_steps = mu, e, rtol, max_steps
        self.k = [1.0, kappa]
        self.phase = [COMPRESSION, COMPRESSION]
        self.y: Vector = np.zeros(4)
        # r1 = 1 - I1/M + I2/m2 and r2 = (I1 - I2)/m2 as linear forms in y: (11), (12)
        self.rates = np.array([[-(1 + 1 / mu), 1 / mu, 0, 0], [1 / mu, -1 / mu, 0, 0]])
        self.rates_at_rest = np.array([1.0, 0.0])
        self.c2 = SOFTENING**2 * mu / (1 + mu)
        self.visited: list[int] = []
        self.n_events = self.n_steps = 0
        self.loss = 0.0

    def start(self, first_step: float | None) -> None:
        """Place the start off the singular point: on the series, or after the paper's finite first step."""
        kappa, mu = self.k[1], self.mu
        if first_step is None:
            I1 = SERIES_STEP / (1 + 1 / mu + kappa / mu)
            I2, E1, E2 = series(kappa, mu, I1)
        else:
            I1 = first_step
            I2, E1, E2 = straight_first_step(kappa, mu, I1)
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

    def advance(self) -> str | None:
        """Integrate to the next event and apply it; say what went wrong, if anything did."""
        slope = self._slope()
        names, forms, offsets = self._watched()
        integrator = cast(Integrator, DOP853(slope, 0.0, self.y, math.inf, rtol=self.rtol, atol=ATOL))
        while True:
            if self.n_steps >= self.max_steps:
                return f"not over after {self.max_steps} steps"
            self.n_steps += 1
            start, y_start = integrator.t, integrator.y
            problem = integrator.step()
            if problem:
                return problem
            h = integrator.t - start
            values = forms @ integrator.dense_output()(start + h * NODES) + offsets[:, None]
            root, which = first_fall(values, start == 0)
            if which >= 0:
                break
        end = start + root * h
        y = _reach(slope, start, y_start, end, self.rtol) if root > 0 else y_start
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
        return None

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
        names: list[tuple[str, int]] = []
        forms: list[Vector] = []
        offsets: list[float] = []
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
            self.loss += (1 - self.e[i] ** 2) * float(self.y[2 + i]) ** 2
            self.y[2 + i] *= self.e[i]
            self.k[i] /= self.e[i] ** 2
        elif kind == "spent":
            self.phase[i] = INACTIVE
            self.y[2 + i] = 0.0
        else:  # "restart" keeps the stiffness, and so does "return", from E_i = 0
            self.phase[i] = COMPRESSION


def _reach(slope: Slope, s: float, y: Vector, end: float, rtol: float) -> Vector:
    """Repeat a step, up to `end`."""
    integrator = cast(Integrator, DOP853(slope, s, y, end, rtol=rtol, atol=ATOL, first_step=end - s))
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


def straight_first_step(kappa: float, mu: float, I1: float) -> tuple[float, float, float]:
    """I2, E1, E2 after the paper's finite first step of I1, along which dI2/dI1 = y is constant.

    (13) and (14) give E1 = I1 - (1 + 1/m2) I1^2/2 + y I1^2/(2 m2) and E2 = y (1 - y) I1^2/(2 m2), and y is the one for
    which (15) holds at the end of the step. The main paper's (27) is not at hand: this is the rule that has the limit
    the supplement (3.1) quotes of it, y -> 1 as k2/k1 -> infinity. I2 comes out three times too large.
    """
    a = I1 / (2 * mu)
    b = 1 - 0.5 * (1 + 1 / mu) * I1
    q = b + kappa * a  # y (b + a y) = kappa a (1 - y)
    y = 2 * kappa * a / (q + math.sqrt(q * q + 4 * kappa * a * a))
    return y * I1, I1 * (b + a * y), y * (1 - y) * a * I1


def first_fall(values: NDArray[np.float64], fresh: bool) -> tuple[float, int]:
    """First root, as a fraction of the step, at which one of the watched polynomials falls through zero.

    Parameters
    ----------
    values : ndarray, shape (n, 8)
        Of the polynomials at `NODES`.
    fresh : bool
        Whether this is the first step after an event: whatever triggered that one starts at zero and rises.

    Returns
    -------
    fraction : float
    which : int
        Row of `values`, or -1 if none falls.
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
