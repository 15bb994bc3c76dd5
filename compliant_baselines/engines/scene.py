"""Scenes: N balls in a line in the numbers an engine needs; and worlds: scenes as an engine has set them up.

The height of ball i is counted from the place at which it and all bodies below it only just touch; the last body is the
table, if there is one. Contact i has the gap x_i - x_{i+1}, and the last contact on a table has the gap x_N.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from impact_xval.compliant_baselines.mapping import KelvinVoigtContact
from impact_xval.compliant_baselines.solver import MappingName, Settings
from impact_xval.model.arrays import Floats
from impact_xval.model.collision import Collision


@dataclass(frozen=True)
class Scene:
    """N balls in a line, ball 1 on top, in SI units, up is positive."""

    #: In kg, one a ball.
    masses: tuple[float, ...]
    #: At t = 0, in m/s, one a ball.
    velocities: tuple[float, ...]
    #: At t = 0, in m, one a ball, counted as the module says.
    heights: tuple[float, ...]
    #: Asked for, in N/m, one a contact; the last contact is with the table, if there is one.
    stiffnesses: tuple[float, ...]
    #: Asked for, one a contact.
    restitutions: tuple[float, ...]
    #: Whether a fixed table is below the last ball.
    table: bool
    #: Time step in s.
    step: float
    #: In m/s^2, downwards; above 0 in a drop of two balls on a table. The lower ball then starts in static equilibrium,
    #: whose depth each engine knows, and heights count from there.
    gravity: float = 0.0
    mapping: MappingName = "calibrated"
    #: Multiple of the engine's least regularisation of contacts, where it has any.
    regularisation: float = 1.0
    #: As of `Settings`.
    partner_restitution: float = 1.0

    @classmethod
    def of(cls, collision: Collision, settings: Settings) -> Scene:
        """Set a collision up in the scenario of the settings, with their share of its shortest contact period as step.

        An ArithmeticError says that double precision has no number for a period.
        """
        c = collision
        gaps_below = [*c.gaps, *([] if c.table else [0.0])]
        return cls(
            c.masses,
            c.velocities,
            tuple(np.cumsum(gaps_below[::-1])[::-1].tolist()),
            c.stiffnesses,
            c.restitutions,
            c.table,
            step=float(settings.step_fraction * min(periods(c))),
            gravity=settings.gravity if settings.scenario == "drop" else 0.0,
            mapping=settings.mapping,
            partner_restitution=settings.partner_restitution,
        )

    @cached_property
    def contacts(self) -> tuple[KelvinVoigtContact, ...]:
        """The contacts asked for, as springs and dashpots; a ValueError for e = 0, which no dashpot gives."""
        numbers = zip(self.stiffnesses, self.restitutions, reduced_masses(self), strict=True)
        return tuple(KelvinVoigtContact.from_restitution(k, e, mass, self.mapping) for k, e, mass in numbers)

    @property
    def requested(self) -> dict[str, tuple[float, ...]]:
        """The numbers asked for, under the names of `World.effective`."""
        numbers = {"restitution": self.restitutions, "step": (self.step,), "threshold": (0.0,)}
        if min(self.restitutions) > 0:
            numbers["stiffness"] = tuple(contact.k for contact in self.contacts)
            numbers["damping"] = tuple(contact.c for contact in self.contacts)
        return numbers

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
        """Largest compression rate at t = 0, in m/s; errors are relative to it."""
        return float(self.rates.max())

    @property
    def fastest(self) -> float:
        """Largest speed at t = 0, in m/s."""
        return max(map(abs, self.velocities))

    def depth(self, stiffnesses: Sequence[float]) -> float:
        """Bound the penetrations in m, given the stiffnesses in N/m as the engine has them.

        For two balls on a table the bound is what a spring needs to stop the masses above it from the highest speed,
        and what their weight presses it in. Otherwise all energy goes into the softest contact.
        """
        if self.table and len(self.masses) == 2:
            (k1, k2), above = stiffnesses, sum(self.masses)
            dynamic = self.fastest * (math.sqrt(reduced_masses(self)[0] / k1) + math.sqrt(above / k2))
            return dynamic + self.gravity * (self.masses[0] / k1 + above / k2)
        m, v = np.array(self.masses), np.array(self.velocities)
        mean = 0.0 if self.table else float(m @ v / m.sum())
        return math.sqrt(float(m @ (v - mean) ** 2) / min(stiffnesses))


class World(ABC):
    """A scene as an engine has set it up, at t = 0; an adapter gives it, and `stepping` follows it."""

    #: At t = 0, in m, as the engine has them, counted as the heights of a scene; shape (N,).
    heights: Floats
    #: The numbers that the engine says it will use, read back after setting them. ``"stiffness"`` (N/m), ``"damping"``
    #: (N s/m) and ``"restitution"`` are one a contact. ``"step"`` (s) and ``"threshold"`` (the speed of approach in m/s
    #: below which the engine drops restitution) are one number. A name that is missing is not compared with what was
    #: asked for.
    effective: Mapping[str, tuple[float, ...]]
    #: Equilibrium depth in m of a settled lowest ball; 0 if no ball has settled, or on a rigid support.
    rest: float = 0.0
    #: Impulse in a step, over the momenta before and after it, that rounding alone can make. The default is an order of
    #: magnitude above the rounding of two additions and a handful of products. At 1/1000 of a period it is eleven
    #: orders below the impulse per step of a fully loaded contact.
    rounding: float = 64 * 2.0**-52
    #: Whether contacts may pull, as a spring and dashpot do that act until the bodies no longer overlap.
    pulls: bool = False
    #: Share of a step's impulse that a dashpot gives in the step in which its bodies meet: a half where the engine
    #: averages the forces at the two ends of a step.
    first_step_share: float = 1.0
    #: Share of a contact's change of velocity that the engine may get wrong at every length of the step. It is part of
    #: the error of a limit (`convergence`); rigid engines have no other error.
    accuracy: float = 0.0
    #: Relative velocities in m/s that impacts so far should have given back and did not, summed: an engine may drop the
    #: restitution of slow impacts. No shorter step mends this error of the limit (`convergence`).
    dropped: float = 0.0
    #: Most steps of one `leap` between events, which the effective stiffness and damping foretell
    #: (`engines.event_free_steps`); 0 for an engine that is read after every step.
    longest_leap: int = 0

    def __init__(self, scene: Scene, radius: float, rest: float = 0.0) -> None:
        #: Heights in m of the centres above the table where all balls, of this radius, only just touch; shape (N,).
        self.places = radius * np.arange(2 * len(scene.masses) - 1, 0, -2, dtype=np.float64)
        self.radius, self.rest = radius, rest
        # Rounded so that adding up to 2 N radii rounds nothing away: gaps are then exact, see `radius_of`.
        far = 2.0 ** math.ceil(math.log2(2 * len(scene.masses) * radius))
        self.heights = np.asarray((np.array(scene.heights) - rest + far) - far, np.float64)

    @abstractmethod
    def advance(self, n: int) -> tuple[Floats, Floats]:
        """Take steps of the engine.

        Parameters
        ----------
        n
            Most steps to take.

        Returns
        -------
        Velocities in m/s and heights in m after each step, shape (steps, N) each, from one step to n.

        Raises
        ------
        RuntimeError
            If the engine broke; the message says why.
        """

    @abstractmethod
    def weightless(self, velocities: Floats, heights: Floats) -> None:
        """Go on without gravity from a state that `advance` gave: velocities in m/s and heights in m, shape (N,)."""

    def leap(self, n: int) -> tuple[int, Floats, Floats]:
        """Take up to n steps that nobody reads; return their number, and velocities and heights after the last."""
        velocities, heights = self.advance(n)
        return len(velocities), velocities[-1], heights[-1]


def reduced_masses(of: Collision | Scene) -> tuple[float, ...]:
    """Return the reduced mass of the two bodies of each contact, in kg; at the table it is the mass of the ball."""
    pairs = zip(of.masses, of.masses[1:], strict=False)
    # A ratio of masses beyond double precision leaves the lighter mass.
    between = (m / (1 + m / below) if m / below < math.inf else below for m, below in pairs)
    return (*between, *(of.masses[-1:] if of.table else ()))


def periods(of: Collision | Scene) -> tuple[float, ...]:
    """Return the periods 2 pi sqrt(M_i/k_i) of the contacts in s: 0 of a rigid contact, infinite without stiffness."""
    pairs = zip(of.stiffnesses, reduced_masses(of), strict=True)
    return tuple(2 * math.pi / math.sqrt(k / mass) if k / mass > 0 else math.inf for k, mass in pairs)


def count_sweeps(scene: Scene, softening: Sequence[float] | float = 0.0) -> int:
    """Count the sweeps over the contacts that bring sequential impulses to rounding; 0 if no contact has a neighbour.

    A sweep is a step of Gauss and Seidel's method on the inverse-mass matrix of the contacts. Its diagonal also has
    what the engine softens contacts by, in 1/kg. On a symmetric tridiagonal matrix the spectral radius of the method is
    the square of the radius of Jacobi's (Varga, Matrix Iterative Analysis, 1962, section 4.1).
    """
    diagonal = 1 / np.array(reduced_masses(scene)) + softening
    with np.errstate(over="ignore"):
        beside = 1 / (np.array(scene.masses)[1 : diagonal.size] * np.sqrt(diagonal[:-1] * diagonal[1:]))
    radius = np.abs(np.linalg.eigvalsh(np.diag(beside, 1) + np.diag(beside, -1))).max(initial=0.0)
    if radius**2 < 1e-16:
        return 0
    return math.ceil(36.7 / -math.log(min(radius**2, 1 - 2.0**-52)))  # 36.7 = -ln(1.1e-16)


def radius_of(depth: float) -> float:
    """Choose the radius in m of balls whose contacts go this deep: the power of two from four depths up.

    No ball then comes near to passing through another. A larger radius would cost digits: a penetration is the
    difference of positions of that size. A power of two makes the places exact at which the balls only just touch.
    Whether a contact shows in the first step is then the same at any scale, and not up to rounding.
    """
    return 2.0 ** math.ceil(math.log2(4 * depth))
