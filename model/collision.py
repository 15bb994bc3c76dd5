"""The vocabulary of the whole project: what goes into a collision and what comes out of it.

`Collision` is what is solved, `Outcome` what any solver gives, `ImpulseCurve` and `Event` the way there.
Nothing here computes a collision.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from html import escape
from typing import Literal, NamedTuple, get_args

import numpy as np
from numpy.typing import NDArray

from impact_xval.model.inputs import E1, E2, K1, K2, M1, M2, MASS_RATIO, STIFFNESS_RATIO, V0

Status = Literal["ok", "limit", "unconverged", "timeout", "unrepresentable", "unavailable", "crashed"]
STATUSES: tuple[str, ...] = get_args(Status)

#: Statuses of an outcome whose numbers are its result. ``unconverged`` may carry numbers too, which are not.
RESULT_STATUSES: tuple[Status, ...] = ("ok", "limit")

#: Names of the phases of a contact, indexed by the integer the kernels use.
PHASES = ("inactive", "compression", "restitution")

#: Names of the states, indexed by the integer the kernels use (0 is no state).
STATES = ("", "S1", "S2", "S3", "S4")


class Units(NamedTuple):
    """Units in which a collision has m1 = k1 = 1 and v0 = -1, and its outcome only its ratios (Theorem 5).

    Attributes
    ----------
    time : float
        sqrt(m1/k1), in s; infinite without a stiffness.
    velocity, impulse, energy : float
        abs(v0) in m/s, m1 abs(v0) in N s and m1 v0^2 in J.
    """

    time: float
    velocity: float
    impulse: float
    energy: float


def in_unit(values: NDArray[np.float64], unit: float) -> NDArray[np.float64]:
    """Return values times a unit: 0 stays 0 where the unit leaves double precision, as that of time or energy may."""
    with np.errstate(over="ignore"):
        return np.multiply(values, unit, out=np.zeros_like(values), where=values != 0)


@dataclass(frozen=True, slots=True)
class Collision:
    """Upper ball B1 falls with v0 < 0 onto lower ball B2, which rests on a fixed table. Up is positive.

    Contact 1 is ball-ball, contact 2 is ball-table.

    Parameters
    ----------
    m1, m2 : float
        Masses of B1 and B2 in kg; positive, finite.
    k1, k2 : float
        Contact stiffnesses in N/m; from 0 to infinity, where k2/k1 must be a number or infinite
        (not 0/0, not inf/inf).
    e1, e2 : float
        Coefficients of energetic restitution, from 0 (perfectly plastic) to 1 (elastic).
    v0 : float
        Velocity of B1 when it touches B2, in m/s; negative, finite.

    Raises
    ------
    ValueError
        For an illegal value; the message names the field, the value and the legal range.
    """

    m1: float
    m2: float
    k1: float
    k2: float
    e1: float
    e2: float
    v0: float = -1.0

    def __post_init__(self) -> None:
        for legal in (M1, M2, K1, K2, E1, E2, V0):
            object.__setattr__(self, legal.name, legal.number(getattr(self, legal.name)))
        both = f"k2 = {self.k2!r} over k1 = {self.k1!r}"
        if self.k1 == self.k2 and (self.k1 == 0 or math.isinf(self.k1)):
            raise ValueError(
                f"stiffness ratio: {both} is undefined; legal: k2/k1 from 0 to inf, not 0/0 or inf/inf"
            )
        if not 0 < self.mass_ratio < math.inf:
            raise ValueError(
                f"mass ratio: m2 = {self.m2!r} over m1 = {self.m1!r} leaves double precision; legal: finite, > 0"
            )

    @classmethod
    def from_ratios(cls, stiffness_ratio: float, mass_ratio: float, e1: float, e2: float) -> Collision:
        r"""Build the collision with m1 = 1 kg, k1 = 1 N/m and v0 = -1 m/s.

        By Theorem 5 of the paper the outcome per \|v0\| depends on these four numbers only.

        Parameters
        ----------
        stiffness_ratio : float
            k2/k1, from 0 to infinity.
        mass_ratio : float
            m2/m1, positive, finite.
        e1, e2 : float
            Coefficients of energetic restitution, from 0 to 1.

        Raises
        ------
        ValueError
            For an illegal value; the message names the parameter, the value and the legal range.
        """
        ratio, mass = STIFFNESS_RATIO.number(stiffness_ratio), MASS_RATIO.number(mass_ratio)
        return cls(m1=1.0, m2=mass, k1=1.0, k2=ratio, e1=e1, e2=e2, v0=-1.0)

    @property
    def stiffness_ratio(self) -> float:
        """k2/k1, from 0 to infinity."""
        return math.inf if self.k1 == 0 else self.k2 / self.k1

    @property
    def mass_ratio(self) -> float:
        """m2/m1."""
        return self.m2 / self.m1

    @property
    def reduced_mass(self) -> float:
        """M = m1 m2/(m1 + m2) of the ball-ball contact, in kg (supplement, below its equation (1))."""
        ratio = self.m1 / self.m2
        return self.m1 / (1 + ratio) if ratio < math.inf else self.m2

    @property
    def units(self) -> Units:
        """Units in which this collision is one of ratios only."""
        speed = -self.v0
        time = math.sqrt(self.m1 / self.k1) if self.k1 > 0 else math.inf
        return Units(time, speed, self.m1 * speed, self.m1 * speed * speed)

    def gravity_number(self, gravity: float) -> float:
        """g/(abs(v0) omega1), omega1 = sqrt(k1 (1/m1 + 1/m2)): how much g in m/s^2 matters beside the impact."""
        return gravity / (-self.v0 * math.sqrt(self.k1 / self.reduced_mass))


@dataclass(frozen=True, slots=True)
class Event:
    """One change along a collision.

    Attributes
    ----------
    kind : str
        ``"end-of-compression"``, ``"restart-of-compression"``, ``"end-of-restitution"``, ``"return"`` or
        ``"limit"`` (from here on a closed-form limit was used).
    contact : int
        1 (ball-ball), 2 (ball-table), or 0 where the event belongs to neither.
    state : str
        The state the collision is in from here on.
    time : float
        Since first touch, in s.
    impulse1, impulse2 : float
        In N s.
    v1, v2 : float
        In m/s.
    """

    kind: str
    contact: int
    state: str
    time: float
    impulse1: float
    impulse2: float
    v1: float
    v2: float


@dataclass(frozen=True, slots=True, eq=False)
class ImpulseCurve:
    """A collision along its impulse curve: arrays of one shape (n,), in the order of time.

    Attributes
    ----------
    time : ndarray
        Since first touch, in s.
    impulse1, impulse2 : ndarray
        Accumulated impulses, in N s.
    v1, v2 : ndarray
        In m/s.
    energy1, energy2 : ndarray or None
        Strain energies in J; None from a solver that does not know them.
    state : ndarray of int
        1 to 4 for S1 to S4; on a border between two states the point is given once for each.
    phase1, phase2 : ndarray of int
        0 inactive, 1 compression, 2 restitution.
    """

    time: NDArray[np.float64]
    impulse1: NDArray[np.float64]
    impulse2: NDArray[np.float64]
    v1: NDArray[np.float64]
    v2: NDArray[np.float64]
    energy1: NDArray[np.float64] | None
    energy2: NDArray[np.float64] | None
    state: NDArray[np.int64]
    phase1: NDArray[np.int64]
    phase2: NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class Outcome:
    r"""The result of one collision by any solver.

    Attributes
    ----------
    solver : str
        Name of the solver.
    v1, v2 : float
        Velocities when the collision is over, in m/s; NaN only with a status that explains it.
    impulse1, impulse2 : float
        Total impulses of the ball-ball and the ball-table contact, in N s.
    states : tuple of str
        The state sequence, such as ``("S1", "S3", "S1", "S2", "S4")``.
    status : str
        One of `STATUSES`: ``"ok"``, or ``"limit"`` where a closed-form limit was used, or why there is no result.
    reason : str
        One sentence where the status is not ``"ok"``.
    grazing_margin : float or None
        How near the collision came to a jump of the model's outcome (docs/theory.md, section 6): the smallest
        compression rate, relative to its own amplitude, at which a compression nearly ended, or nearly did not.
        Infinity if nothing of the kind happened, None if not computed.
    marked : str
        Which jump of its outcome, or which cut-off, is so near that a little of anything would change the numbers, in
        one sentence; empty if none is. A marked result is kept apart from all statistics.
    n_events : int
        Number of events.
    diagnostics : mapping of str to float
        Further numbers a solver wishes to state (its time step, its number of steps, an energy residual).
    path : ImpulseCurve or None
        The way there, if asked for.
    events : tuple of Event
        What happened on the way, if the solver knows it.
    """

    solver: str
    v1: float
    v2: float
    impulse1: float
    impulse2: float
    states: tuple[str, ...]
    status: Status = "ok"
    reason: str = ""
    grazing_margin: float | None = None
    marked: str = ""
    n_events: int = 0
    diagnostics: Mapping[str, float] = field(default_factory=dict[str, float])
    path: ImpulseCurve | None = None
    events: tuple[Event, ...] = ()

    def _repr_html_(self) -> str:
        """Return what a notebook shows."""
        return html_table(
            self.solver,
            (
                ("status", self.status),
                ("reason", self.reason),
                ("v1 (m/s)", self.v1),
                ("v2 (m/s)", self.v2),
                ("impulse of ball on ball (N s)", self.impulse1),
                ("impulse of ball on table (N s)", self.impulse2),
                ("states", " ".join(self.states)),
                ("grazing margin", self.grazing_margin),
                ("marked", self.marked),
            ),
        )

    def retained_energy(self, collision: Collision) -> float:
        """Kinetic energy after the collision over that before it, dimensionless."""
        c = collision
        return (self.v1 / c.v0) ** 2 + c.mass_ratio * (self.v2 / c.v0) ** 2

    @classmethod
    def failure(cls, solver: str, status: Status, reason: str) -> Outcome:
        """Record that a solver gave no result, and why."""
        return cls(solver, math.nan, math.nan, math.nan, math.nan, (), status, reason)


def html_table(title: str, rows: Iterable[tuple[str, object]]) -> str:
    """Return a table of two columns as HTML; rows without a value are left out, and any text stays text.

    Parameters
    ----------
    title : str
        Its caption.
    rows : iterable of (str, object)
        What a value is, and the value; numbers get six digits.
    """
    shown = [
        f'<tr><th scope="row" style="text-align: left">{escape(name)}</th><td>{escape(_text(value))}</td></tr>'
        for name, value in rows
        if value is not None and value != ""
    ]
    return f"<table><caption>{escape(title)}</caption><tbody>{''.join(shown)}</tbody></table>"


def _text(value: object) -> str:
    return f"{value:.6g}" if isinstance(value, float) else str(value)
