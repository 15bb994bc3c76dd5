r"""The laws that data are held against: each maps its free parameters and a mass ratio to final velocities.

Without gravity every law here is free of scale: velocities per \|v0\| depend on k2/k1, m2/m1, e1 and e2 alone (Theorem
5 of the paper; Hunt-Crossley's damping coefficient is that of the speed of impact). Rigid laws know no stiffness. Two
of them are one here: on a ball at rest, contacts 1 and 2 can only be struck in turn, whichever is looked at first, so
`sequential` is `sequential-top` and `sequential-bottom` (`compliant_baselines.rigid.laws`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np
from numba import guvectorize
from numpy.typing import NDArray

from impact_xval.compliant_baselines.references.bistiffness import bistiffness_batch
from impact_xval.compliant_baselines.references.kelvin_voigt import Damping, kelvin_voigt_batch
from impact_xval.experiments.config.errors import UserError
from impact_xval.model import solve_batch

Floats = NDArray[np.float64]

#: Velocities after, per |v0|, given k2/k1, m2/m1, e1 and e2, which broadcast.
Answers = Callable[[Floats, Floats, Floats, Floats], tuple[Floats, Floats]]

#: The box of log10 k2/k1.
STIFFNESS_BOX = (-4.0, 4.0)
#: Least e of the laws that know no e = 0: their springs become infinitely stiff, or their dampings infinite.
LEAST_RESTITUTION = 0.05

#: Segments, or events, after which a collision of the box is given up: it then explains nothing.
_MOST_STEPS, _MOST_EVENTS = 2000, 10_000
#: Rate of approach, over the first, below which the balls rest on each other (`rigid.laws.CUT`).
_CUT = 1e-13


@dataclass(frozen=True, slots=True)
class Law:
    """A law and what is free in it.

    Attributes
    ----------
    name : str
    parameters : tuple of str
        ``log_k``, which is log10 k2/k1, ``e1`` and ``e2``; ``e`` is one coefficient of both contacts.
    answers : callable
        See `Answers`.
    least : float
        Least coefficient of restitution.
    """

    name: str
    parameters: tuple[str, ...]
    answers: Answers
    least: float = 0.0

    @property
    def box(self) -> Floats:
        """Least and greatest value of each parameter, shape (P, 2)."""
        ends = (STIFFNESS_BOX if name == "log_k" else (self.least, 1.0) for name in self.parameters)
        return np.array(list(ends))

    def velocities(self, points: Floats, mass_ratios: Floats) -> tuple[Floats, Floats]:
        """Give velocities after, per speed of impact; NaN where the law gives none.

        Parameters
        ----------
        points : ndarray, shape (..., P)
            Values of the parameters.
        mass_ratios : ndarray, shape (M,)
            m2/m1.

        Returns
        -------
        v1, v2 : ndarray, shape (..., M)
        """
        given = {name: points[..., i, None] for i, name in enumerate(self.parameters)}
        one = np.ones_like(points[..., :1])
        e1, e2 = (given.get(name, given.get("e", one)) for name in ("e1", "e2"))
        cells = np.broadcast_arrays(10.0 ** given.get("log_k", 0 * one), mass_ratios, e1, e2)
        k, mu, e1, e2 = (np.array(each) for each in cells)
        return self.answers(k, mu, e1, e2)


def _model(impact_law: str) -> Answers:
    def answers(k: Floats, mu: Floats, e1: Floats, e2: Floats) -> tuple[Floats, Floats]:
        found = solve_batch(k, mu, e1, e2, impact_law=impact_law, max_events=_MOST_EVENTS)
        return found.v1, found.v2

    return answers


def _bistiffness(k: Floats, mu: Floats, e1: Floats, e2: Floats) -> tuple[Floats, Floats]:
    found = bistiffness_batch(k, mu, e1, e2, max_steps=_MOST_STEPS)
    return found.v1, found.v2


def _dashpots(damping: Damping) -> Answers:
    def answers(k: Floats, mu: Floats, e1: Floats, e2: Floats) -> tuple[Floats, Floats]:
        found = kelvin_voigt_batch(k, mu, e1, e2, damping=damping, max_steps=_MOST_STEPS)
        return found.v1, found.v2

    return answers


def _newton(k: Floats, mu: Floats, e1: Floats, e2: Floats) -> tuple[Floats, Floats]:
    """Ball 2 stays on the table, since contact 2 does not approach and is pressed (`rigid.laws`, (1))."""
    return e1, np.zeros_like(e1)


def _poisson(k: Floats, mu: Floats, e1: Floats, e2: Floats) -> tuple[Floats, Floats]:
    """Both contacts are compressed by m1 |v0|, and return e1 and e2 of it at least (`rigid.laws`, (3) and (4))."""
    v1, v2 = e1, np.maximum(0, (e2 - e1) / mu)
    together = e2 / (1 + mu)
    meet = v2 > v1
    return np.where(meet, together, v1), np.where(meet, together, v2)


def _sequential(k: Floats, mu: Floats, e1: Floats, e2: Floats) -> tuple[Floats, Floats]:
    """Single impacts of contact 1 and contact 2 in turn."""
    return _in_turn(mu, e1, e2)  # pyright: ignore[reportCallIssue]


def _reflection(k: Floats, mu: Floats, e1: Floats, e2: Floats) -> tuple[Floats, Floats]:
    """Blend elastic reflections, single impacts here, with the plastic impact, which leaves both at rest."""
    one = np.ones_like(e1)
    v1, v2 = _sequential(k, mu, one, one)
    return e1 * v1, e1 * v2


@guvectorize(["(float64, float64, float64, float64[:], float64[:])"], "(),(),()->(),()")
def _in_turn(mu, e1, e2, v1, v2):
    """Give both velocities once neither contact approaches; the infinitely many impacts of a collapse leave rest."""
    u1, u2 = -1.0, 0.0
    while u1 - u2 < -_CUT:
        approach = (1 + e1) * (u1 - u2) / (1 + mu)
        u1, u2 = u1 - mu * approach, u2 + approach
        if u2 < 0:
            u2 = -e2 * u2
    v1[0], v2[0] = u1, u2


_CONTACTS = ("log_k", "e1", "e2")

#: The laws by name, in the order in which they are shown.
LAWS = {
    law.name: law
    for law in (
        Law("state-transition", _CONTACTS, _model("jia-mason-erdmann")),
        Law("liu-zhao-brogliato", _CONTACTS, _model("liu-zhao-brogliato")),
        Law("bistiffness", _CONTACTS, _bistiffness, LEAST_RESTITUTION),
        Law("kelvin-voigt", _CONTACTS, _dashpots("pair"), LEAST_RESTITUTION),
        Law("hunt-crossley", _CONTACTS, _dashpots("hunt-crossley"), LEAST_RESTITUTION),
        Law("newton", ("e1",), _newton),
        Law("poisson", ("e1", "e2"), _poisson),
        Law("sequential", ("e1", "e2"), _sequential),
        Law("generalised-reflection", ("e",), _reflection),
    )
}


def laws_of(names: object) -> list[Law]:
    """Give laws by name; all where none is named.

    Raises
    ------
    UserError
        For an unknown name.
    """
    if names is None:
        return list(LAWS.values())
    listed = list(names) if isinstance(names, Iterable) and not isinstance(names, str | bytes) else [names]
    for name in listed:
        if not isinstance(name, str) or name not in LAWS:
            raise UserError(f"law = {name!r:.60}; legal: {', '.join(LAWS)}")
    return [LAWS[name] for name in dict.fromkeys(map(str, listed))] or list(LAWS.values())
