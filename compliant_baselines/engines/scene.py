"""What an engine is asked to run, N balls in a line in the numbers an engine needs, and what it makes of it.

Heights are counted from touching: that of ball i above the place where it and all balls below it only just touch, the
last one the table, if there is one. Contact i has the gap x_i - x_{i+1}, and the last one on a table x_N.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from impact_xval.compliant_baselines.mapping import Contact
from impact_xval.compliant_baselines.solver import MappingName, Settings
from impact_xval.model.arrays import Floats
from impact_xval.model.collision import Collision


@dataclass(frozen=True)
class Scene:
    """N balls in a line, ball 1 on top, in SI units."""

    #: One a ball; velocities and heights at t = 0, heights counted as the module says.
    masses: tuple[float, ...]
    velocities: tuple[float, ...]
    heights: tuple[float, ...]
    #: Of the contacts asked for; the last one is with the table, if there is one.
    stiffnesses: tuple[float, ...]
    restitutions: tuple[float, ...]
    table: bool
    step: float
    #: Downwards; above 0 in a drop, of two balls on a table only. The lower one then starts in static equilibrium (each
    #: engine knows its own), from which heights count.
    gravity: float = 0.0
    mapping: MappingName = "calibrated"
    #: How many times the engine's least regularisation of contacts, where it has any.
    regularisation: float = 1.0

    @classmethod
    def of(cls, collision: Collision, settings: Settings) -> Scene:
        """Set a collision up in the scenario of the settings, at their share of its shortest contact period.

        An ArithmeticError says that double precision has no number for a period.
        """
        c = collision
        below = [*c.gaps, *([] if c.table else [0.0])]
        return cls(
            c.masses,
            c.velocities,
            tuple(np.cumsum(below[::-1])[::-1].tolist()),
            c.stiffnesses,
            c.restitutions,
            c.table,
            step=float(settings.step_fraction * min(periods(c))),
            gravity=settings.gravity if settings.scenario == "drop" else 0.0,
            mapping=settings.mapping,
        )

    @cached_property
    def contacts(self) -> tuple[Contact, ...]:
        """What is asked of each contact as a spring and a dashpot; a ValueError for e = 0, which no dashpot gives."""
        asked = zip(self.stiffnesses, self.restitutions, reduced_masses(self), strict=True)
        return tuple(Contact.from_restitution(k, e, mass, self.mapping) for k, e, mass in asked)

    @property
    def requested(self) -> dict[str, tuple[float, ...]]:
        """What an engine may be held to under the names of `World.effective`."""
        asked = {"restitution": self.restitutions, "step": (self.step,), "threshold": (0.0,)}
        if min(self.restitutions) > 0:
            asked["stiffness"] = tuple(contact.k for contact in self.contacts)
            asked["damping"] = tuple(contact.c for contact in self.contacts)
        return asked

    @property
    def gaps(self) -> Floats:
        """Gaps of the contacts at t = 0, in m, shape (C,)."""
        return -np.diff([*self.heights, *([0.0] if self.table else [])])

    @property
    def rates(self) -> Floats:
        """Compression rates at t = 0, in m/s, shape (C,)."""
        return np.diff([*self.velocities, *([0.0] if self.table else [])])

    @property
    def speed(self) -> float:
        """Largest compression rate at t = 0, in m/s: what errors are relative to."""
        return float(self.rates.max())

    @property
    def fastest(self) -> float:
        """Largest speed at t = 0, in m/s."""
        return max(map(abs, self.velocities))

    def depth(self, stiffnesses: Sequence[float]) -> float:
        """Bound the penetrations in m, given the stiffnesses in N/m as the engine has them.

        Of two balls on a table what a spring needs to stop the masses above it from the highest speed, and what their
        weight presses it in by; else all energy in the softest contact.
        """
        if self.table and len(self.masses) == 2:
            (k1, k2), above = stiffnesses, sum(self.masses)
            dynamic = self.fastest * (math.sqrt(reduced_masses(self)[0] / k1) + math.sqrt(above / k2))
            return dynamic + self.gravity * (self.masses[0] / k1 + above / k2)
        m, v = np.array(self.masses), np.array(self.velocities)
        mean = 0.0 if self.table else float(m @ v / m.sum())
        return math.sqrt(float(m @ (v - mean) ** 2) / min(stiffnesses))


class World(ABC):
    """One scene as an engine has set it up, at t = 0: what an adapter gives, and `stepping` follows."""

    #: At t = 0, in m, as the engine has them, counted as those of a scene; shape (N,).
    heights: Floats
    #: What the engine says it will use, read back after setting it: ``"stiffness"`` (N/m), ``"damping"`` (N s/m),
    #: ``"restitution"``, one a contact; ``"step"`` (s), ``"threshold"`` (the speed of approach in m/s below which it
    #: drops restitution), one number. What is not said is not compared with what was asked for.
    effective: Mapping[str, tuple[float, ...]]
    #: How deep a settled lowest ball rests, in m; 0 if nothing is settled, or on a rigid support.
    rest: float = 0.0
    #: Impulse in a step, over the momenta before and after it, that rounding alone can make: an order of magnitude
    #: above that of two additions and a handful of products, and, at 1/1000 of a period, eleven orders below the
    #: impulse per step of a fully loaded contact.
    rounding: float = 64 * 2.0**-52
    #: Share of a contact's change of velocity that the engine may get wrong at every length of the step; stated in the
    #: limits of rigid engines, which have no other error (`convergence`).
    accuracy: float = 0.0
    #: Relative velocities in m/s that impacts so far should have given back and did not, summed: an engine may drop the
    #: restitution of slow ones. An error of the limit that no shorter step mends (`convergence`).
    dropped: float = 0.0
    #: Steps that `leap` takes at most, between events that stiffness and damping as effective foretell
    #: (`engines.quiet`); 0 for an engine that is read after every step.
    longest_leap: int = 0

    def __init__(self, scene: Scene, radius: float, rest: float = 0.0) -> None:
        #: Centres of balls of this radius above the table where all only just touch, in m, shape (N,).
        self.places = radius * np.arange(2 * len(scene.masses) - 1, 0, -2, dtype=np.float64)
        self.radius, self.rest = radius, rest
        # Rounded so that adding up to 2 N radii rounds nothing away: gaps are then exact, see `radius_of`.
        far = 2.0 ** math.ceil(math.log2(2 * len(scene.masses) * radius))
        self.heights = np.asarray((np.array(scene.heights) - rest + far) - far, np.float64)

    @abstractmethod
    def advance(self, n: int) -> tuple[Floats, Floats]:
        """Take up to n steps, at least one; velocities in m/s and heights in m after each, shape (steps, N).

        A RuntimeError says that the engine broke, and why.
        """

    @abstractmethod
    def weightless(self, velocities: Floats, heights: Floats) -> None:
        """Go on without gravity from the state after a step that was given, shape (N,) each."""

    def leap(self, n: int) -> tuple[int, Floats, Floats]:
        """Take up to n steps that nobody reads: how many, and velocities and heights after the last, shape (N,)."""
        velocities, heights = self.advance(n)
        return len(velocities), velocities[-1], heights[-1]


def reduced_masses(of: Collision | Scene) -> tuple[float, ...]:
    """Reduced mass of the two bodies of each contact, in kg; at the table that of the ball."""
    pairs = zip(of.masses, of.masses[1:], strict=False)
    between = (m / (1 + m / below) if m / below < math.inf else below for m, below in pairs)
    return (*between, *(of.masses[-1:] if of.table else ()))


def periods(of: Collision | Scene) -> tuple[float, ...]:
    """Periods 2 pi sqrt(M_i/k_i) of the contacts asked for in s: 0 of a rigid one, infinite without stiffness."""
    pairs = zip(of.stiffnesses, reduced_masses(of), strict=True)
    return tuple(2 * math.pi / math.sqrt(k / mass) if k / mass > 0 else math.inf for k, mass in pairs)


def sweeps(scene: Scene, soft: Sequence[float] | float = 0.0) -> int:
    """Count the sweeps over the contacts that bring sequential impulses to rounding; 0 where none is beside another.

    One sweep is Gauss and Seidel's on the inverse-mass matrix of the contacts, with what an engine softens them by, in
    1/kg, on its diagonal. On a symmetric tridiagonal matrix its spectral radius is the square of that of Jacobi's
    (Varga, Matrix Iterative Analysis, 1962, section 4.1).
    """
    diagonal = 1 / np.array(reduced_masses(scene)) + soft
    with np.errstate(over="ignore"):
        beside = 1 / (np.array(scene.masses)[1 : diagonal.size] * np.sqrt(diagonal[:-1] * diagonal[1:]))
    radius = np.abs(np.linalg.eigvalsh(np.diag(beside, 1) + np.diag(beside, -1))).max(initial=0.0)
    if radius**2 < 1e-16:
        return 0
    return math.ceil(36.7 / -math.log(min(radius**2, 1 - 2.0**-52)))  # 36.7 = -ln(1.1e-16)


def radius_of(depth: float) -> float:
    """Choose the radius in m of balls that go this deep: a power of two, fourfold or more.

    Then no ball comes near to passing through another; a penetration is the difference of positions of that size, and
    would lose more digits beside a larger one. A power of two, so that the places at which the balls only just touch
    are exact: whether a contact shows in the first step is the same at any scale, and not rounding's to say.
    """
    return 2.0 ** math.ceil(math.log2(4 * depth))
