"""Scenes: N bodies in a line or in a plane in the numbers an engine needs; and worlds: scenes as an engine has them.

**In a line** the height of ball i is counted from the place at which it and all bodies below it only just touch; the
last body is the table, if there is one. Contact i has the gap x_i - x_{i+1}, and the last contact on a table has the
gap x_N.

**In a plane** bodies have two coordinates, x and z, body after body: N bodies have 2 N velocities and 2 N heights. A
line is the case of one coordinate. Heights are displacements from the places at which all contacts touch, and J x are
the gaps, with the fixed normals of the contacts. Normals turn by displacement over distance: by a millionth, for radii
are then larger by `WIDER` (`radius_of`).
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from impact_xval.compliant_baselines.engines.arrangement import (
    ROUNDING_OVERLAP,
    Arrangement,
    arrangement_of_graph,
    line_of_balls,
)
from impact_xval.compliant_baselines.mapping import KelvinVoigtContact
from impact_xval.compliant_baselines.solver import MappingName, Settings
from impact_xval.model.arrays import Floats
from impact_xval.model.collision import Collision

if TYPE_CHECKING:
    from impact_xval.model.graph.collision import GraphCollision

#: Factor on the radii of balls in a plane, where normals turn by displacement over distance.
WIDER = 2.0**20


@dataclass(frozen=True)
class Scene:
    """N bodies in SI units, up is positive: balls in a line, ball 1 on top, or in a plane (x, z)."""

    #: In kg, one a body.
    masses: tuple[float, ...]
    #: At t = 0, in m/s, one a body in a line, two in a plane.
    velocities: tuple[float, ...]
    #: At t = 0, in m, one a body in a line, two in a plane, counted as the module says.
    heights: tuple[float, ...]
    #: Asked for, in N/m, one a contact; in a line the last contact is with the table, if there is one.
    stiffnesses: tuple[float, ...]
    #: Asked for, one a contact.
    restitutions: tuple[float, ...]
    #: Whether a fixed table is below the last ball; in a plane, whether some body touches a fixed plane.
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
    #: Of a scene in a plane; None in a line.
    graph: Arrangement | None = None

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

    @classmethod
    def of_graph(cls, collision: GraphCollision, settings: Settings) -> Scene | str:
        """Set a contact graph up with a share of its shortest contact period as step, or say why no scene holds it.

        An ArithmeticError says that double precision has no number for a period.
        """
        arrangement = arrangement_of_graph(collision)
        if isinstance(arrangement, str):
            return arrangement
        velocities = tuple(float(number) for velocity in collision.velocities for number in velocity)
        scene = cls(
            tuple(collision.masses),
            velocities,
            (0.0,) * len(velocities),
            tuple(contact.stiffness for contact in collision.contacts),
            tuple(contact.restitution for contact in collision.contacts),
            arrangement.has_fixed_body,
            step=math.nan,
            mapping=settings.mapping,
            partner_restitution=settings.partner_restitution,
            graph=arrangement,
        )
        return replace(scene, step=float(settings.step_fraction * min(periods(scene))))

    @property
    def arrangement(self) -> Arrangement:
        """The contacts, and the places of the bodies."""
        return self.graph or line_of_balls(len(self.masses), self.table)

    @property
    def axes(self) -> int:
        """Coordinates of a body: 1 in a line, 2 in a plane (x, z)."""
        return self.arrangement.axes

    @property
    def inertia(self) -> Floats:
        """Mass in kg of each coordinate, shape (N axes,)."""
        return np.repeat(np.array(self.masses, np.float64), self.axes)

    @property
    def closing(self) -> Floats:
        """Displacement that makes each touching contact overlap by a radius, over the radius; shape (N axes,)."""
        if self.graph is not None:
            J = self.graph.jacobian
            return np.asarray(np.linalg.lstsq(J, -np.ones(len(J)), rcond=None)[0], np.float64)
        touches_below = np.append(self.gaps == 0, [] if self.table else [False])
        return -np.cumsum(touches_below[::-1])[::-1].astype(np.float64)

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
        return self.arrangement.jacobian @ np.array(self.heights)

    @property
    def rates(self) -> Floats:
        """Compression rates at t = 0, in m/s, shape (C,)."""
        return -(self.arrangement.jacobian @ np.array(self.velocities))

    @property
    def speed(self) -> float:
        """Largest compression rate at t = 0, in m/s; errors are relative to it."""
        return float(self.rates.max())

    @property
    def fastest(self) -> float:
        """Largest speed at t = 0, in m/s."""
        axes = self.axes
        return max(math.hypot(*self.velocities[i : i + axes]) for i in range(0, len(self.velocities), axes))

    def depth(self, stiffnesses: Sequence[float]) -> float:
        """Bound the penetrations in m, given the stiffnesses in N/m as the engine has them.

        For two balls on a table the bound is what a spring needs to stop the masses above it from the highest speed,
        and what their weight presses it in. Otherwise all energy goes into the softest contact.
        """
        if self.graph is None and self.table and len(self.masses) == 2:
            (k1, k2), above = stiffnesses, sum(self.masses)
            dynamic = self.fastest * (math.sqrt(reduced_masses(self)[0] / k1) + math.sqrt(above / k2))
            return dynamic + self.gravity * (self.masses[0] / k1 + above / k2)
        m, v = np.array(self.masses), np.reshape(self.velocities, (len(self.masses), -1))
        mean = 0.0 if self.table else m @ v / m.sum()
        return math.sqrt(float((m @ (v - mean) ** 2).sum()) / min(stiffnesses))


class World(ABC):
    """A scene as an engine has set it up, at t = 0; an adapter gives it, and `stepping` follows it."""

    #: At t = 0, in m, as the engine has them, counted as the heights of a scene; shape (N axes,).
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
    #: Rate of approach in m/s of a contact in a plane that counts as none: what the engine leaves of a contact at rest.
    resting_rate: float = 0.0

    def __init__(self, scene: Scene, radius: float, rest: float = 0.0) -> None:
        #: Coordinates in m of the centres where all balls, of this radius, only just touch; shape (N axes,). In a line
        #: they are heights above the table.
        self.places = radius * np.ravel(scene.arrangement.centres)
        self.radius, self.rest = radius, rest
        # Rounded so that adding up to 2 N radii rounds nothing away: gaps are then exact, see `radius_of`.
        far = 2.0 ** math.ceil(math.log2(2 * len(scene.masses) * radius))
        self.heights = np.asarray((np.array(scene.heights) - rest + far) - far, np.float64)
        if scene.graph is not None:
            self.heights += ROUNDING_OVERLAP * radius * scene.closing

    @abstractmethod
    def advance(self, n: int) -> tuple[Floats, Floats]:
        """Take steps of the engine.

        Parameters
        ----------
        n
            Most steps to take.

        Returns
        -------
        Velocities in m/s and heights in m after each step, shape (steps, N axes) each, from one step to n.

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
    """Return the reduced mass of the two bodies of each contact, in kg; at a fixed body it is the mass of the ball."""
    arrangement = of.arrangement if isinstance(of, Scene) else line_of_balls(len(of.masses), of.table)
    masses: list[float] = []
    for first, second, _ in arrangement.touches:
        m = of.masses[first]
        if second is not None:
            other = of.masses[second]
            # A ratio of masses beyond double precision leaves the lighter mass.
            m = m / (1 + m / other) if m / other < math.inf else other
        masses.append(m)
    return tuple(masses)


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
    if scene.graph is not None:
        radius_of_sweep = _radius_of_sweep(scene.graph.jacobian, scene.inertia, diagonal)
    else:
        with np.errstate(over="ignore"):
            beside = 1 / (np.array(scene.masses)[1 : diagonal.size] * np.sqrt(diagonal[:-1] * diagonal[1:]))
        radius = np.abs(np.linalg.eigvalsh(np.diag(beside, 1) + np.diag(beside, -1))).max(initial=0.0)
        radius_of_sweep = float(radius**2)
    if radius_of_sweep < 1e-16:
        return 0
    return math.ceil(36.7 / -math.log(min(radius_of_sweep, 1 - 2.0**-52)))  # 36.7 = -ln(1.1e-16)


def _radius_of_sweep(J: Floats, inertia: Floats, diagonal: Floats) -> float:
    """Return the spectral radius of Gauss and Seidel's method on contacts that do not stand in a line.

    Where the matrix is singular the method has eigenvalues of 1, which move impulses between contacts and no velocity;
    they do not count.
    """
    W = (J / inertia) @ J.T
    np.fill_diagonal(W, diagonal)
    lower = np.tril(W)
    moduli = np.abs(np.linalg.eigvals(np.linalg.solve(lower, lower - W)))
    return float(moduli[moduli < 1 - 1e-9].max(initial=0.0))


def radius_of(depth: float, axes: int = 1) -> float:
    """Choose the radius in m of balls whose contacts go this deep: the power of two from four depths up.

    In a plane it is larger by `WIDER`: normals turn by about depth over radius while contacts act, and final velocities
    with them, by a millionth of the speed. Places are rounded by 1e-9 of the depth.

    No ball then comes near to passing through another. A larger radius would cost digits: a penetration is the
    difference of positions of that size. A power of two makes the places exact at which the balls only just touch.
    Whether a contact shows in the first step is then the same at any scale, and not up to rounding.
    """
    return 2.0 ** math.ceil(math.log2(4 * depth)) * (1.0 if axes == 1 else WIDER)
