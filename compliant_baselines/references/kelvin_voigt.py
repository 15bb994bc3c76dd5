r"""Kelvin-Voigt contacts without an engine, and the named alternatives to them.

Contact i is F = max(0, k_i delta + c_i delta') while its bodies overlap; `references.dashpot_kernel`
follows it exactly. What c_i is made from has a name:

| solver | damping | c_1 | c_2 |
|---|---|---|---|
| kelvin-voigt | `pair` | 2 zeta sqrt(k1 M), M = m1 m2/(m1 + m2) | 2 zeta sqrt(k2 m2) |
| kelvin-voigt-anchored | `anchored` | 2 zeta sqrt(k1 m1): B2 as part of the table | 2 zeta sqrt(k2 m2) |
| kelvin-voigt-textbook | `textbook` | as `pair`, zeta from the textbook | likewise |
| hunt-crossley | `hunt-crossley` | F = k1 delta (1 + a delta'), a = A(e1)/\|v0\| | likewise with e2 |

zeta is the damping ratio that gives e to a contact that ends at zero force (docs/theory.md, section 7; the
default) or the textbook's -ln e/sqrt(pi^2 + ln^2 e). In `pair` the mass is that of the two bodies of the contact, as
if no third took part; `anchored` is the other extreme for contact 1, exact where B2 stays pressed on the
table. For a, and what it means that it depends on a speed, see `contact.restitution_laws`.

e = 0 has no finite damping, and k2/k1 = 0 or infinity no two springs: both are refused.
"""

from __future__ import annotations

from typing import Literal, get_args

import numpy as np
from numba import njit, prange
from numpy.typing import ArrayLike

from impact_xval.compliant_baselines.contact.restitution_laws import (
    damping_ratios,
    hunt_crossley_coefficients,
    textbook_damping_ratios,
)
from impact_xval.compliant_baselines.references.dashpot_kernel import LOADED, collide
from impact_xval.compliant_baselines.references.piecewise import LOG_WIDTH
from impact_xval.compliant_baselines.references.reference_batch import (
    MAX_STEPS,
    Floats,
    Followed,
    ReferenceBatch,
    batch_of,
    scaled_inputs,
)
from impact_xval.compliant_baselines.references.reference_path import KernelLaw
from impact_xval.compliant_baselines.references.reference_solver import ReferenceSolver
from impact_xval.compliant_baselines.references.taylor import LINEAR, PRODUCT
from impact_xval.model.collision import Collision

Damping = Literal["pair", "anchored", "textbook", "hunt-crossley"]
DAMPINGS: tuple[str, ...] = get_args(Damping)


def dampings(
    damping: Damping, kappa: Floats, mu: Floats, e1: Floats, e2: Floats
) -> tuple[int, Floats, Floats]:
    """Law of the kernel and the damping of both contacts in its units, NaN for e = 0.

    Parameters
    ----------
    damping : str
        One of `DAMPINGS`.
    kappa, mu, e1, e2 : ndarray, shape (n,)
        k2/k1, m2/m1 and the coefficients of restitution.

    Raises
    ------
    ValueError
        For an unknown name.
    """
    if damping not in DAMPINGS:
        raise ValueError(f"damping = {damping!r}; legal: {', '.join(DAMPINGS)}")
    if damping == "hunt-crossley":
        return PRODUCT, hunt_crossley_coefficients(e1), hunt_crossley_coefficients(e2)
    ratios = textbook_damping_ratios if damping == "textbook" else damping_ratios
    mass1 = np.ones_like(mu) if damping == "anchored" else 1 / (1 + 1 / mu)
    return LINEAR, 2 * ratios(e1) * np.sqrt(mass1), 2 * ratios(e2) * np.sqrt(kappa * mu)


def kelvin_voigt_batch(
    stiffness_ratio: ArrayLike,
    mass_ratio: ArrayLike,
    e1: ArrayLike,
    e2: ArrayLike,
    gravity_number: ArrayLike = 0.0,
    *,
    damping: Damping = "pair",
    frozen: bool = False,
    max_steps: int = MAX_STEPS,
) -> ReferenceBatch:
    r"""Follow many collisions with contacts of spring and dashpot at once.

    Parameters
    ----------
    stiffness_ratio, mass_ratio, e1, e2 : array_like
        k2/k1, m2/m1 and the coefficients of restitution; they broadcast. e_i = 0 and k2/k1 = 0 or infinity
        give the status ``unrepresentable``.
    gravity_number : array_like
        g/(\|v0\| omega1), omega1 = sqrt(k1 (1/m1 + 1/m2)); 0 is the scenario `impact`, above it is a
        `drop`.
    damping : str
        One of `DAMPINGS`, see the module.
    frozen : bool
        Whether a contact ends for good when its force does, and returns as soon as its bodies approach: the law in
        the impulse space of the state-transition model.
    max_steps : int
        Stretches after which a cell is given up (status ``timeout``).

    Returns
    -------
    ReferenceBatch

    Raises
    ------
    ValueError
        If any value is illegal; the message names the parameter, the first such value and the legal range.
    """
    shape, (kappa, mu, first, second, g) = scaled_inputs(stiffness_ratio, mass_ratio, e1, e2, gravity_number)
    with np.errstate(invalid="ignore", over="ignore"):
        law, c1, c2 = dampings(damping, kappa, mu, first, second)
    return batch_of(shape, mu, g, Followed(*_follow_all(law, kappa, mu, c1, c2, g, frozen, max_steps)))


@njit(cache=True, parallel=True, error_model="numpy")
def _follow_all(law, kappa, mu, c1, c2, g, frozen, max_steps):
    n = kappa.size
    v1, v2 = np.full(n, np.nan), np.full(n, np.nan)
    duration, fall = np.full(n, np.nan), np.full(n, np.nan)
    end, sequence = np.full(n, -1, np.int8), np.zeros(n, np.uint64)
    n_states, n_events, n_steps = np.zeros(n, np.int32), np.zeros(n, np.int32), np.zeros(n, np.int32)
    no_log = np.empty((0, LOG_WIDTH))
    for i in prange(n):
        if 0 < kappa[i] < np.inf and c1[i] < np.inf and c2[i] < np.inf:
            result = collide(law, kappa[i], mu[i], c1[i], c2[i], g[i], frozen, max_steps, no_log)
            v1[i], v2[i], end[i], sequence[i], n_states[i], n_events[i], n_steps[i] = result[:7]
            duration[i], fall[i] = result[7:]
    return v1, v2, end, sequence, n_states, n_events, n_steps, duration, fall, np.zeros(n, np.bool_)


class KelvinVoigtSolver(ReferenceSolver):
    """Kelvin-Voigt contacts, c_i from the reduced mass of the pair."""

    name = "kelvin-voigt"
    damping: Damping = "pair"

    def follow(self, collision: Collision, g: float, max_steps: int, log: Floats) -> Followed:
        """Call the kernel, in scaled units."""
        law = self.law(collision)
        ratios = collision.stiffness_ratio, collision.mass_ratio
        return Followed(*collide(law.force, *ratios, law.c1, law.c2, g, False, max_steps, log), limited=False)

    def batch(self, *cells: Floats) -> ReferenceBatch:
        """Follow many collisions at once."""
        return kelvin_voigt_batch(*cells, damping=self.damping)

    def law(self, collision: Collision) -> KernelLaw:
        """Law and damping, scaled; a contact carries force when loaded, and its phase shows in its rate."""
        c = collision
        one = (np.array([x]) for x in (c.stiffness_ratio, c.mass_ratio, c.e1, c.e2))
        law, c1, c2 = dampings(self.damping, *one)
        return KernelLaw(law, float(c1[0]), float(c2[0]), (LOADED,))


class AnchoredKelvinVoigtSolver(KelvinVoigtSolver):
    """Kelvin-Voigt contacts, c_1 from the mass of the upper ball alone."""

    name = "kelvin-voigt-anchored"
    damping = "anchored"


class TextbookKelvinVoigtSolver(KelvinVoigtSolver):
    """Kelvin-Voigt contacts, c_i from the textbook's zeta, which is that of a contact that may pull."""

    name = "kelvin-voigt-textbook"
    damping = "textbook"


class HuntCrossleySolver(KelvinVoigtSolver):
    """Hunt-Crossley contacts on linear springs, F = max(0, k delta (1 + a delta'))."""

    name = "hunt-crossley"
    damping = "hunt-crossley"
