r"""Kelvin-Voigt contacts without an engine, and the named alternatives to them.

Contact i is F = max(0, k_i delta + c_i delta') while its bodies overlap; see `model.chain.laws`. What c_i is
made from has a name:

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
from numpy.typing import ArrayLike

from impact_xval.compliant_baselines.contact.restitution_laws import (
    damping_ratios,
    hunt_crossley_coefficients,
    textbook_damping_ratios,
)
from impact_xval.compliant_baselines.references.batch import (
    MAX_STEPS,
    Floats,
    Law,
    ReferenceBatch,
    follow_batch,
)
from impact_xval.compliant_baselines.references.solver import ReferenceSolver
from impact_xval.model.chain.laws import HUNT_CROSSLEY, KELVIN_VOIGT
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
        return HUNT_CROSSLEY, hunt_crossley_coefficients(e1), hunt_crossley_coefficients(e2)
    ratios = textbook_damping_ratios if damping == "textbook" else damping_ratios
    mass1 = np.ones_like(mu) if damping == "anchored" else 1 / (1 + 1 / mu)
    with np.errstate(
        over="ignore", invalid="ignore"
    ):  # NaN, refused, for an infinite stiffness without damping
        root = np.sqrt(kappa * mu)
        root = np.where(np.isinf(root), np.sqrt(kappa) * np.sqrt(mu), root)
        return KELVIN_VOIGT, 2 * ratios(e1) * np.sqrt(mass1), 2 * ratios(e2) * root


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
    """Follow many collisions with contacts of spring and dashpot at once.

    Parameters
    ----------
    stiffness_ratio, mass_ratio, e1, e2, gravity_number, max_steps
        As for `batch.follow_batch`.
    damping : str
        One of `DAMPINGS`, see the module.
    frozen : bool
        Whether a contact ends for good when its force does, and returns as soon as its bodies approach: the law in
        the impulse space of the state-transition model.

    Returns
    -------
    ReferenceBatch

    Raises
    ------
    ValueError
        If any value is illegal; the message names the parameter, the first such value and the legal range.
    """
    cells = stiffness_ratio, mass_ratio, e1, e2, gravity_number
    return follow_batch(
        lambda *ratios: Law(*dampings(damping, *ratios)), *cells, frozen=frozen, max_steps=max_steps
    )


class KelvinVoigtSolver(ReferenceSolver):
    """Kelvin-Voigt contacts, c_i from the reduced mass of the pair."""

    name = "kelvin-voigt"
    damping: Damping = "pair"

    def batch(self, *cells: Floats) -> ReferenceBatch:
        """Follow many collisions at once."""
        return kelvin_voigt_batch(*cells, damping=self.damping)

    def law(self, collision: Collision) -> Law:
        """Give the law its dampings, scaled."""
        c = collision
        one = (np.array([x]) for x in (c.stiffness_ratio, c.mass_ratio, c.e1, c.e2))
        with np.errstate(over="ignore"):
            code, c1, c2 = dampings(self.damping, *one)
        return Law(code, float(c1[0]), float(c2[0]))


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
