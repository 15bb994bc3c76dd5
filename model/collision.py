"""The vocabulary of the whole project: what goes into a collision and what comes out of it.

`Collision` is what is solved, `Outcome` what any solver gives, `Path` the way there; `Collisions` and `Outcomes` are
many of them as arrays. Nothing here computes a collision.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from itertools import pairwise
from typing import Any, Literal, NamedTuple, get_args, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from impact_xval.model.inputs import (
    EXPONENT,
    LINE,
    MASS_RATIO,
    RATIOS,
    STIFFNESS_RATIO,
    STIFFNESSES_WITH_LIMITS,
    TWO_BALLS,
    Legal,
    checked_array,
)
from impact_xval.model.kinetic import kinetic_norm

Floats = NDArray[np.float64]

Status = Literal["ok", "closed-form", "unconverged", "timeout", "unrepresentable", "unavailable", "crashed"]
STATUSES: tuple[str, ...] = get_args(Status)

#: Statuses of an outcome whose numbers are its result. ``unconverged`` may carry numbers too, which are not.
RESULT_STATUSES: tuple[Status, ...] = ("ok", "closed-form")

_IS_RESULT = np.array([status in RESULT_STATUSES for status in STATUSES])

#: Names of the states of two balls on a table, by the set of contacts.
_STATE_OF_SET = ("S4", "S3", "S2", "S1")

#: Most balls of a collision.
MAX_BALLS = 1000


def _legal(balls: int, table: bool) -> Iterator[tuple[Legal, int]]:
    """Tell what the fields of a collision may hold that are a number a ball or a contact, and how many."""
    masses, stiffnesses, *others = LINE
    if table and balls == 2:
        stiffnesses = STIFFNESSES_WITH_LIMITS
    contacts = balls - 1 + table
    return zip((masses, stiffnesses, *others), (balls, contacts, contacts, balls, contacts), strict=True)


class Units(NamedTuple):
    """Units in which a collision has m1 = k1 = 1 and 1 as its largest compression rate (Theorem 5)."""

    #: In s; sqrt(m1/k1) where contacts are linear; infinite without a stiffness.
    time: float
    #: The largest rate at first touch in m/s, for two balls on a table abs(v0); m1 times that in N s.
    velocity: float
    impulse: float


@dataclass(frozen=True, slots=True)
class Collision:
    """N balls in a line, each touching the next, ball 1 on top; with a table, ball N touches it. Up is positive.

    Contact i is between balls i and i + 1; with a table, contact N is between ball N and the table. The problem of the
    paper is two balls on a table (`two_balls`).

    Parameters
    ----------
    masses : sequence of float, length N
        In kg; positive, finite. N is from 1 to `MAX_BALLS`.
    stiffnesses : sequence of float, one a contact
        N - 1 of them, or N with a table: k_i of F = k_i delta^p, in N/m^p; positive, finite. For two balls on a table
        also 0 and infinity, as limits, but not 0/0 or inf/inf.
    restitutions : sequence of float, one a contact
        Coefficients of energetic restitution, from 0 (perfectly plastic) to 1 (elastic).
    velocities : sequence of float, length N
        At first touch, in m/s; finite. At least one ball approaches the next, or ball N the table.
    table : bool
        Whether there is a fixed table below ball N.
    gaps : sequence of float, one a contact
        Distances of the bodies of each contact at first, in m; not negative. None by default. Only solvers with
        positions know them.
    exponent : float
        p of the contacts' forces, from 1 (linear) to 3; 1.5 are Hertz contacts.

    Raises
    ------
    ValueError
        For an illegal value; the message names the field, the value and the legal range.
    """

    masses: tuple[float, ...]
    stiffnesses: tuple[float, ...]
    restitutions: tuple[float, ...]
    velocities: tuple[float, ...]
    table: bool = False
    gaps: tuple[float, ...] = ()
    exponent: float = 1.0

    def __post_init__(self) -> None:
        if type(self.table) is not bool:
            raise ValueError(f"table = {self.table!r}; legal: True or False")
        object.__setattr__(self, "exponent", EXPONENT.number(self.exponent))
        masses, *_ = LINE
        balls = len(_numbers(masses, self.masses))
        if not 1 <= balls <= MAX_BALLS:
            raise ValueError(f"masses: {balls} balls; legal: from 1 to {MAX_BALLS}")
        for legal, length in _legal(balls, self.table):
            numbers = _numbers(legal, getattr(self, legal.name))
            if legal.name == "gaps":
                numbers = numbers or (0.0,) * length
            if len(numbers) != length:
                given, on = f"{legal.name}: {len(numbers)} values", "on a" if self.table else "without a"
                raise ValueError(f"{given}; legal: {length}, for {balls} balls {on} table")
            object.__setattr__(self, legal.name, numbers)
        if self.table and balls == 2:
            _check_ratios(*self.masses, *self.stiffnesses)
        if not any(rate > 0 for rate in self.compression_rates):
            raise ValueError(
                f"velocities = {self.velocities!r}: nothing meets; legal: a ball is slower than the next below it"
                + (", or the last one falls on the table" if self.table else "")
            )

    @classmethod
    def two_balls(
        cls, m1: float, m2: float, k1: float, k2: float, e1: float, e2: float, v0: float = -1.0
    ) -> Collision:
        """Let B1 fall with v0 < 0 onto B2, which rests on a table. Contact 1 is ball-ball, contact 2 ball-table.

        Parameters
        ----------
        m1, m2 : float
            Masses of B1 and B2 in kg; positive, finite.
        k1, k2 : float
            Contact stiffnesses in N/m; from 0 to infinity, where k2/k1 is not 0/0 or inf/inf.
        e1, e2 : float
            Coefficients of energetic restitution, from 0 (perfectly plastic) to 1 (elastic).
        v0 : float
            Velocity of B1 when it touches B2, in m/s; negative, finite.

        Raises
        ------
        ValueError
            For an illegal value; the message names the parameter, the value and the legal range.
        """
        given = zip(TWO_BALLS, (m1, m2, k1, k2, e1, e2, v0), strict=True)
        m1, m2, k1, k2, e1, e2, v0 = (legal.number(value) for legal, value in given)
        return cls((m1, m2), (k1, k2), (e1, e2), (v0, 0.0), table=True)

    @classmethod
    def from_ratios(cls, stiffness_ratio: float, mass_ratio: float, e1: float, e2: float) -> Collision:
        r"""Build two balls on a table with m1 = 1 kg, k1 = 1 N/m and v0 = -1 m/s.

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
        return cls.two_balls(m1=1.0, m2=mass, k1=1.0, k2=ratio, e1=e1, e2=e2)

    m1 = property(lambda self: self.masses[0], doc="Mass of ball 1, in kg.")
    m2 = property(lambda self: self.masses[1], doc="Mass of ball 2, in kg.")
    k1 = property(lambda self: self.stiffnesses[0], doc="Stiffness of contact 1, in N/m.")
    k2 = property(lambda self: self.stiffnesses[1], doc="Stiffness of contact 2, in N/m.")
    e1 = property(lambda self: self.restitutions[0], doc="Restitution of contact 1.")
    e2 = property(lambda self: self.restitutions[1], doc="Restitution of contact 2.")
    v0 = property(lambda self: self.velocities[0], doc="Velocity of ball 1 at first touch, in m/s.")

    @property
    def falls_on_resting(self) -> bool:
        """Whether this is the problem of the paper: B1 falls on B2, which rests on a table; linear contacts."""
        (first, *others), plain = self.velocities, self.exponent == 1 and not any(self.gaps)
        return plain and self.table and others == [0.0] and first < 0

    @property
    def compression_rates(self) -> tuple[float, ...]:
        """w_i = v_{i+1} - v_i of each contact at first touch, in m/s; -v_N at the table."""
        below = (*self.velocities, 0.0) if self.table else self.velocities
        return tuple(lower - upper for upper, lower in pairwise(below))

    @property
    def stiffness_ratio(self) -> float:
        """k2/k1, from 0 to infinity."""
        return math.inf if self.k1 == 0 else self.k2 / self.k1

    @property
    def mass_ratio(self) -> float:
        """m2/m1."""
        return self.m2 / self.m1

    @property
    def units(self) -> Units:
        """Units in which this collision is one of ratios only."""
        time, speed = (float(unit[0]) for unit in Collisions.of([self]).units)
        return Units(time, speed, self.m1 * speed)

    def reversed(self) -> Collision:
        """Return the collision seen from below, if it has no table: order of balls and sign of velocities reversed."""
        if self.table:
            raise ValueError("table = True: a column on a table has no reverse; legal: False")
        seen = {legal.name: getattr(self, legal.name)[::-1] for legal in LINE}
        return replace(self, **(seen | {"velocities": tuple(-v for v in seen["velocities"])}))


def _numbers(legal: Any, values: Any) -> tuple[float, ...]:
    """Return the values of a field as numbers; the message of a refusal counts them from 1."""
    if isinstance(values, str) or not hasattr(values, "__iter__"):
        raise ValueError(f"{legal.name} = {values!r}: not a sequence of numbers; legal: {legal.text}")
    return tuple(legal._replace(name=f"{legal.name}[{i}]").number(v) for i, v in enumerate(values, 1))


def _check_ratios(m1: float, m2: float, k1: float, k2: float) -> None:
    if k1 == k2 and (k1 == 0 or math.isinf(k1)):
        both = f"k2 = {k2!r} over k1 = {k1!r}"
        raise ValueError(
            f"stiffness ratio: {both} is undefined; legal: k2/k1 from 0 to inf, not 0/0 or inf/inf"
        )
    if not 0 < m2 / m1 < math.inf:
        raise ValueError(
            f"mass ratio: m2 = {m2!r} over m1 = {m1!r} leaves double precision; legal: finite, > 0"
        )


@dataclass(frozen=True, slots=True, eq=False)
class Collisions(Sequence[Collision]):
    """Collisions of one number of balls, as arrays; read-only. C is N - 1, or N on a table.

    Attributes
    ----------
    masses, velocities : ndarray, shape (n, N)
        In kg and m/s.
    stiffnesses, restitutions, gaps : ndarray, shape (n, C)
        In N/m^p, dimensionless, in m.
    table : bool
    exponent : float
        p; with `table` the same for all.

    Raises
    ------
    ValueError
        If a value is illegal; the message names field, row, value and legal range.
    """

    masses: Floats
    stiffnesses: Floats
    restitutions: Floats
    velocities: Floats
    table: bool
    gaps: Floats
    exponent: float = 1.0

    def __post_init__(self) -> None:
        n, balls = self.masses.shape
        for legal, wide in _legal(balls, self.table):
            array = checked_array(legal, getattr(self, legal.name)).view()
            if array.shape != (n, wide):
                raise ValueError(f"{legal.name} has the shape {array.shape}; legal: {(n, wide)}")
            array.flags.writeable = False
            object.__setattr__(self, legal.name, array)
        still = np.flatnonzero(~(self.compression_rates > 0).any(axis=1))
        if still.size:
            raise ValueError(
                f"velocities of row {still[0]}: nothing meets; legal: some contact is compressed"
            )

    @classmethod
    def of(cls, collisions: Iterable[Collision]) -> Collisions:
        """Make arrays of collisions that have the number of balls, the table and the exponent in common."""
        if isinstance(collisions, cls):
            return collisions
        some = list(collisions)
        kinds = {(len(c.masses), c.table, c.exponent) for c in some} or {(2, True, 1.0)}
        if len(kinds) > 1:
            raise ValueError(
                f"collisions of {len(kinds)} kinds; legal: one number of balls, table and exponent"
            )
        ((balls, table, exponent),) = kinds
        arrays = {
            legal.name: np.array([getattr(c, legal.name) for c in some], float).reshape(len(some), wide)
            for legal, wide in _legal(balls, table)
        }
        return cls(**arrays, table=table, exponent=exponent)

    @classmethod
    def from_ratios(
        cls, stiffness_ratio: ArrayLike, mass_ratio: ArrayLike, e1: ArrayLike, e2: ArrayLike
    ) -> Collisions:
        """Build two balls on a table with m1 = 1 kg, k1 = 1 N/m and v0 = -1 m/s, flat from inputs that broadcast."""
        arrays = np.broadcast_arrays(*map(checked_array, RATIOS, (stiffness_ratio, mass_ratio, e1, e2)))
        kappa, mu, e1, e2 = map(np.ravel, arrays)
        ones, zeros = np.ones_like(mu), np.zeros_like(mu)
        pairs = ((ones, mu), (ones, kappa), (e1, e2), (-ones, zeros))
        m, k, e, v = (np.stack(pair, axis=-1) for pair in pairs)
        return cls(m, k, e, v, True, np.zeros_like(k))

    def __len__(self) -> int:
        return len(self.masses)

    @overload
    def __getitem__(self, index: int) -> Collision: ...
    @overload
    def __getitem__(self, index: slice | NDArray[Any]) -> Collisions: ...
    def __getitem__(self, index: Any) -> Collision | Collisions:
        arrays = {legal.name: getattr(self, legal.name)[index] for legal in LINE}
        if arrays["masses"].ndim == 2:
            return replace(self, **arrays)
        numbers = {name: tuple(array.tolist()) for name, array in arrays.items()}
        return Collision(**numbers, table=self.table, exponent=self.exponent)

    @property
    def compression_rates(self) -> Floats:
        """As of `Collision`, shape (n, C)."""
        return np.diff(self.velocities, axis=1, append=np.zeros((len(self), int(self.table))))

    @property
    def stiffness_ratio(self) -> Floats:
        """k2/k1 of two balls on a table, shape (n,)."""
        with np.errstate(divide="ignore"):
            return self.stiffnesses[:, 1] / self.stiffnesses[:, 0]

    @property
    def mass_ratio(self) -> Floats:
        """m2/m1, shape (n,)."""
        return self.masses[:, 1] / self.masses[:, 0]

    @property
    def falls_on_resting(self) -> NDArray[np.bool_]:
        """As of `Collision`, shape (n,)."""
        if self.masses.shape[1] != 2 or not self.table or self.exponent != 1:
            return np.zeros(len(self), bool)
        return (self.velocities[:, 0] < 0) & (self.velocities[:, 1] == 0) & ~self.gaps.any(axis=1)

    @property
    def units(self) -> tuple[Floats, Floats]:
        """Units of time and velocity, as `Units`, each of shape (n,)."""
        p, speed = self.exponent, np.abs(self.compression_rates).max(axis=1)
        with np.errstate(over="ignore", divide="ignore"):
            return (self.masses[:, 0] / self.stiffnesses[:, 0] * speed ** (1 - p)) ** (1 / (p + 1)), speed


@dataclass(frozen=True, slots=True, eq=False)
class Path:
    """A collision along its way: p points in the order of time, some of them at one instant.

    Attributes
    ----------
    time : ndarray, shape (p,)
        Since first touch, in s; infinite from where a contact without stiffness has to finish. Of the model that of
        positions that stay frozen.
    velocities : ndarray, shape (p, N)
        In m/s.
    impulses, forces : ndarray, shape (p, C)
        Accumulated impulses in N s, and forces in N; of a contact that has become rigid, what it passes on. Forces of
        an engine are means since the point before. Where the model completes the impact of a stiff contact by a closed
        form, the soft one stands still meanwhile, at a force that velocities do not feel (supplement, 3.4).
    acting : ndarray of bool, shape (p, C)
        Which contacts act from here on; one that has become rigid does while another does.
    """

    time: Floats
    velocities: Floats
    impulses: Floats
    forces: Floats
    acting: NDArray[np.bool_]

    v1 = property(lambda self: self.velocities[:, 0], doc="Velocity of ball 1, in m/s.")
    v2 = property(lambda self: self.velocities[:, 1], doc="Velocity of ball 2, in m/s.")
    impulse1 = property(lambda self: self.impulses[:, 0], doc="Impulse of contact 1, in N s.")
    impulse2 = property(lambda self: self.impulses[:, 1], doc="Impulse of contact 2, in N s.")

    @property
    def state(self) -> NDArray[np.int64]:
        """Of two balls on a table: 1 to 4 for S1 to S4."""
        return 4 - self.acting @ np.array([1, 2])


@dataclass(frozen=True, slots=True, eq=False)
class Paths(Sequence[Path | None]):
    """Paths of n collisions of one number of balls, one after another; `[i]` is a `Path`, None where there is none."""

    #: The points of path i are those from offsets[i] to offsets[i + 1].
    offsets: NDArray[np.int64]
    time: Floats
    velocities: Floats
    impulses: Floats
    forces: Floats
    acting: NDArray[np.bool_]

    @classmethod
    def of(cls, paths: Iterable[Path | None], balls: int, contacts: int) -> Paths:
        """Put paths together, of that many balls and contacts."""
        t, v, i = np.empty(0), np.empty((0, balls)), np.empty((0, contacts))
        none = Path(t, v, i, i, np.empty(i.shape, bool))
        some = [path or none for path in paths]
        arrays = (
            np.concatenate([getattr(path, each.name) for path in (none, *some)]) for each in fields(Path)
        )
        return cls(np.cumsum([0, *(len(path.time) for path in some)]), *arrays)

    def spread(self, there: NDArray[np.bool_]) -> Paths:
        """Return the paths of more collisions, of which these are those that are there."""
        lengths = np.zeros(len(there), np.int64)
        lengths[there] = np.diff(self.offsets)
        return replace(self, offsets=np.append(0, np.cumsum(lengths)))

    def __len__(self) -> int:
        return len(self.offsets) - 1

    def __getitem__(self, index: int | slice) -> Any:
        if isinstance(index, slice):
            return [self[i] for i in range(len(self))[index]]
        i = range(len(self))[index]
        here = slice(*self.offsets[i : i + 2].tolist())
        if here.start == here.stop:
            return None
        return Path(*(getattr(self, each.name)[here] for each in fields(Path)))


@dataclass(frozen=True, slots=True)
class Outcome:
    """The result of one collision by any solver.

    Attributes
    ----------
    solver : str
    velocities : tuple of float, length N
        When the collision is over, in m/s; NaN only with a status that explains it.
    impulses : tuple of float, one a contact
        Total impulses in N s.
    states : tuple of str
        The sets of contacts that act, in their order, such as ``("1+2", "2", "-")``; for two balls on a table by the
        paper's names, ``("S1", "S3", "S1", "S2", "S4")``.
    status : str
        One of `STATUSES`: ``"ok"``, or ``"closed-form"`` where a closed-form limit was used, or why there is no result.
    reason : str
        One sentence; not empty where the status is neither ``"ok"`` nor ``"closed-form"``.
    grazing_margin : float or None
        How near the collision came to a jump of the model's outcome (docs/theory.md, section 6): the smallest
        compression rate at a turning point, relative to its own amplitude. Infinity if none is below
        `pair.grazing.NEAR`, None if not computed.
    marked : str
        Which jump of its outcome, or which cut-off, is so near that a little of anything would change the numbers, in
        one sentence; empty if none is. A marked result is kept apart from all statistics.
    n_events : int
    diagnostics : mapping of str to float
        Further numbers a solver wishes to state (its time step, its number of steps, an energy residual).
    path : Path or None
        The way there, if asked for.
    requested, effective : mapping of str to tuple of float
        What an engine was asked for, and what it says it uses, one number a contact or one in all: ``"stiffness"``
        (N/m), ``"damping"`` (N s/m), ``"restitution"``, ``"step"`` (s).

    Raises
    ------
    ValueError
        For an unknown status, a result that is not finite, no result without a reason, or lengths that fit no line of
        balls; the message names the field, the value and what is legal.
    """

    solver: str
    velocities: tuple[float, ...]
    impulses: tuple[float, ...]
    states: tuple[str, ...] = ()
    status: Status = "ok"
    reason: str = ""
    grazing_margin: float | None = None
    marked: str = ""
    n_events: int = 0
    diagnostics: Mapping[str, float] = field(default_factory=dict[str, float])
    path: Path | None = None
    requested: Mapping[str, tuple[float, ...]] = field(default_factory=dict[str, tuple[float, ...]])
    effective: Mapping[str, tuple[float, ...]] = field(default_factory=dict[str, tuple[float, ...]])

    def __post_init__(self) -> None:
        balls, contacts = len(self.velocities), len(self.impulses)
        if self.status not in STATUSES:
            raise ValueError(f"status = {self.status!r}; legal: {', '.join(STATUSES)}")
        if contacts not in (balls - 1, balls):
            raise ValueError(f"impulses: {contacts} values for {balls} balls; legal: {balls - 1} or {balls}")
        if self.status not in RESULT_STATUSES:
            if not self.reason:
                raise ValueError(f"reason = ''; legal with the status {self.status!r}: why, in one sentence")
            return
        for name, values in (("velocities", self.velocities), ("impulses", self.impulses)):
            for i, value in enumerate(values, 1):
                if not math.isfinite(value):
                    raise ValueError(
                        f"{name}[{i}] = {value!r}; legal with the status {self.status!r}: finite numbers"
                    )

    v1 = property(lambda self: self.velocities[0], doc="Velocity of ball 1, in m/s.")
    v2 = property(lambda self: self.velocities[1], doc="Velocity of ball 2, in m/s.")
    impulse1 = property(lambda self: self.impulses[0], doc="Impulse of contact 1, in N s.")
    impulse2 = property(lambda self: self.impulses[1], doc="Impulse of contact 2, in N s.")

    @property
    def differences(self) -> str:
        """What an engine uses instead of what it was asked for, beyond rounding; empty if nothing."""
        found: list[str] = []
        for name in sorted(self.requested.keys() & self.effective.keys()):
            both = self.requested[name], self.effective[name]
            for i, (asked, used) in enumerate(zip(*both, strict=True), 1):
                if not math.isclose(asked, used, rel_tol=1e-9):
                    which = f"{name} {i}" if len(both[0]) > 1 else name
                    found.append(f"{which} is {used:.6g}, {asked:.6g} was asked for")
        return "; ".join(found)

    def retained_energy(self, collision: Collision) -> float:
        """Kinetic energy after the collision over that before it, dimensionless."""
        before, after = (kinetic_norm(collision.masses, each.velocities) for each in (collision, self))
        return float((after / before) ** 2)

    @classmethod
    def failure(cls, solver: str, collision: Collision, status: Status, reason: str) -> Outcome:
        """Record that a solver gave no result, and why."""
        unknown = (math.nan,)
        balls, contacts = len(collision.masses), len(collision.stiffnesses)
        return cls(solver, unknown * balls, unknown * contacts, status=status, reason=reason)


def name_of_set(contacts: int, paper: bool) -> str:
    """Name a set of acting contacts, contact i + 1 as bit i: as the paper does that of two balls, or as ``"1+3"``."""
    if paper:
        return _STATE_OF_SET[contacts]
    return "+".join(str(i + 1) for i in range(contacts.bit_length()) if contacts >> i & 1) or "-"


class States(NamedTuple):
    """Sequences of states of many collisions."""

    #: Those of collision i are the entries from offsets[i] to offsets[i + 1].
    offsets: NDArray[np.int64]
    #: Which contacts act, shape (entries, words): bit i of word j is contact 64 j + i + 1.
    sets: NDArray[np.uint64]

    @classmethod
    def of(cls, counts: Floats, sets: NDArray[np.uint64]) -> States:
        """Take numbers of states, shape (n,), and what was logged of them."""
        return cls(np.append(0, np.cumsum(counts)).astype(np.int64), sets)

    def texts(self) -> list[str]:
        """Name the states of all collisions of two balls on a table, each in one text."""
        codes, places = self.sets[:, 0].astype(np.uint8).tobytes(), self.offsets.tolist()
        keys = [codes[i:j] for i, j in pairwise(places)]
        known = {key: " ".join(_STATE_OF_SET[contacts] for contacts in key) for key in set(keys)}
        return [known[key] for key in keys]

    def names(self, index: int, paper: bool) -> tuple[str, ...]:
        """Name the states of one collision, as the paper does or as sets of contacts."""
        rows = self.sets[self.offsets[index] : self.offsets[index + 1]]
        words = [sum(word << 64 * j for j, word in enumerate(row)) for row in rows.tolist()]
        known = {word: name_of_set(word, paper) for word in set(words)}
        return tuple(known[word] for word in words)


#: How collisions may end: a condition of shape (n,) or (), a status, and the reason.
Ending = tuple[NDArray[np.bool_] | bool, Status, str]


def first_endings(endings: Sequence[Ending], n: int) -> tuple[NDArray[np.uint8], NDArray[np.int32]]:
    """Return status and reason of n collisions, as `Outcomes` has them, by the first ending that holds for each.

    Where none holds the status is ``ok``, without a reason.
    """
    conditions, statuses, _ = zip(*endings, strict=True)
    reason = np.broadcast_to(np.select(conditions, range(1, 1 + len(conditions))), n).astype(np.int32)
    return np.array([STATUSES.index(each) for each in ("ok", *statuses)], np.uint8)[reason], reason


def reasons_of(endings: Sequence[Ending]) -> tuple[str, ...]:
    """Return the texts that the reasons of `first_endings` are indices into."""
    return ("", *(text for _, _, text in endings))


def total_impulses(collisions: Collisions, velocities: Floats, fallen: ArrayLike = 0.0) -> Floats:
    """Return the impulses in N s, shape (n, C), that led to final velocities.

    `fallen` is what gravity has added to the velocities of free balls, in m/s.
    """
    changes = velocities - collisions.velocities + np.reshape(fallen, (-1, 1))
    return np.cumsum(collisions.masses * changes, axis=1)[:, : collisions.stiffnesses.shape[1]]


@dataclass(frozen=True, slots=True, eq=False)
class Outcomes(Sequence[Outcome]):
    """Outcomes of n collisions of one number of balls by one solver, as arrays; `[i]` is an `Outcome`.

    Attributes
    ----------
    solver : str
    velocities, impulses : ndarray, shapes (n, N) and (n, C)
        In m/s and N s; NaN where there is no result.
    status : ndarray of uint8, shape (n,)
        Index into `STATUSES`; `statuses` is the text.
    reason, mark : ndarray of int, shape (n,)
        Index into `reasons` and `marks`, of which the first is empty.
    n_states, n_events : ndarray of int, shape (n,)
    states : States or None
        None where they were not asked for.
    grazing_margin : ndarray, shape (n,)
        NaN where it is not known, infinity where nothing of the kind happened.
    diagnostics : dict of str to ndarray, shape (n,)
        NaN where an outcome does not state it.
    paths : Paths, or None
        None where they were not asked for.
    """

    solver: str
    velocities: Floats
    impulses: Floats
    status: NDArray[np.uint8]
    reason: NDArray[np.int32]
    reasons: tuple[str, ...]
    mark: NDArray[np.int32]
    marks: tuple[str, ...]
    n_states: NDArray[np.int64]
    n_events: NDArray[np.int64]
    grazing_margin: Floats
    states: States | None = None
    diagnostics: dict[str, Floats] = field(default_factory=dict[str, Floats])
    paths: Paths | None = None

    v1 = property(lambda self: self.velocities[..., 0], doc="Velocities of ball 1, in m/s.")
    v2 = property(lambda self: self.velocities[..., 1], doc="Velocities of ball 2, in m/s.")
    impulse1 = property(lambda self: self.impulses[..., 0], doc="Impulses of contact 1, in N s.")
    impulse2 = property(lambda self: self.impulses[..., 1], doc="Impulses of contact 2, in N s.")

    @property
    def statuses(self) -> NDArray[np.str_]:
        """Statuses as text; made when asked for, for they take more room than all the rest."""
        return np.array(STATUSES)[self.status]

    @property
    def marked(self) -> NDArray[np.object_]:
        """As of `Outcome`: a sentence, or the empty text."""
        return np.array(self.marks, dtype=object)[self.mark]

    @property
    def has_result(self) -> NDArray[np.bool_]:
        """Where the numbers are a result."""
        return _IS_RESULT[self.status]

    @classmethod
    def of(
        cls,
        solver: str,
        collisions: Collisions,
        velocities: Floats,
        endings: Sequence[Ending],
        *,
        fallen: ArrayLike = 0.0,
        n_states: ArrayLike = 0,
        n_events: ArrayLike = 0,
        grazing_margin: ArrayLike = math.nan,
        **more: Any,
    ) -> Outcomes:
        """Say what became of collisions; none is marked yet.

        Of endings the first that holds counts (`first_endings`); `fallen` is that of `total_impulses`.
        """
        n = len(collisions)
        status, reason = first_endings(endings, n)
        return cls(
            solver=solver,
            velocities=velocities,
            impulses=total_impulses(collisions, velocities, fallen),
            status=status,
            reason=reason,
            reasons=reasons_of(endings),
            mark=np.zeros(n, np.int32),
            marks=("",),
            n_states=np.broadcast_to(n_states, n).astype(np.int64),
            n_events=np.broadcast_to(n_events, n).astype(np.int64),
            grazing_margin=np.array(np.broadcast_to(grazing_margin, n), float),
            **more,
        )

    @classmethod
    def failures(cls, solver: str, collisions: Collisions, status: Status, reason: str) -> Outcomes:
        """Record that a solver gave no result of any of some collisions, and why."""
        return cls.of(solver, collisions, np.nan * collisions.masses, [(True, status, reason)])

    def with_marks(self, says: NDArray[np.object_]) -> Outcomes:
        """Return the same with other marks: a sentence each, or the empty text."""
        marked = np.flatnonzero(says != "")
        mark = np.zeros(len(self), np.int32)
        mark[marked] = 1 + np.arange(marked.size)
        return replace(self, mark=mark, marks=("", *says[marked]))

    def shaped(self, shape: tuple[int, ...]) -> Outcomes:
        """Return the same with arrays of a leading shape, such as that of a grid; `[i]` is for flat ones."""
        given = {each.name: getattr(self, each.name) for each in fields(self)}
        arrays: dict[str, Any] = {name: x for name, x in given.items() if isinstance(x, np.ndarray)}
        shaped = {name: x.reshape(shape + x.shape[1:]) for name, x in arrays.items()}
        diagnostics = {name: x.reshape(shape) for name, x in self.diagnostics.items()}
        return replace(self, **shaped, diagnostics=diagnostics)

    def __len__(self) -> int:
        return len(self.velocities)

    def __getitem__(self, index: int | slice) -> Any:
        if isinstance(index, slice):
            return [self[i] for i in range(len(self))[index]]
        i = range(len(self))[index]
        margin, paper = float(self.grazing_margin[i]), self.velocities.shape[1] == self.impulses.shape[1] == 2
        stated = ((name, float(values[i])) for name, values in self.diagnostics.items())
        return Outcome(
            self.solver,
            tuple(self.velocities[i].tolist()),
            tuple(self.impulses[i].tolist()),
            () if self.states is None or not self.n_states[i] else self.states.names(i, paper),
            STATUSES[int(self.status[i])],  # pyright: ignore[reportArgumentType]
            self.reasons[int(self.reason[i])],
            None if math.isnan(margin) else margin,
            self.marks[int(self.mark[i])],
            int(self.n_events[i]),
            {name: value for name, value in stated if not math.isnan(value)},
            None if self.paths is None else self.paths[i],
        )
