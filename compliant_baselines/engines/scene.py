"""Scenes: N bodies in a line or a plane, in the numbers that an engine needs. Worlds: scenes inside an engine.

**In a line** the height of ball i is counted from the place at which it and all bodies below it only just touch; the
last body is the table, if there is one. Contact i has the gap x_i - x_{i+1}, and the last contact on a table has the
gap x_N.

**In a plane** bodies have two coordinates, x and z, body after body: N bodies have 2 N velocities and 2 N heights. A
line is the case of one coordinate. Heights are displacements from the places at which all contacts touch, and J x are
the gaps, with the fixed normals of the contacts. Normals turn by displacement over distance. This is only a millionth,
because radii in a plane are larger by `WIDER` (`radius_of`).
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

    #: Masses in kg, one for each body.
    masses: tuple[float, ...]
    #: Velocities at t = 0 in m/s, one for each body in a line, two in a plane.
    velocities: tuple[float, ...]
    #: Heights at t = 0 in m, one for each body in a line, two in a plane; the module says from where they count.
    heights: tuple[float, ...]
    #: Stiffnesses asked for in N/m, one for each contact; in a line the last contact is with the table, if there is
    #: one.
    stiffnesses: tuple[float, ...]
    #: Restitutions asked for, one for each contact.
    restitutions: tuple[float, ...]
    #: True if a fixed table is below the last ball; in a plane, if a body touches a fixed plane.
    table: bool
    #: Time step in s.
    step: float
    #: Gravity in m/s^2, downwards; above 0 only in a drop of two balls on a table. The lower ball then starts in static
    #: equilibrium, and its height counts from there. Each engine knows the depth of this equilibrium.
    gravity: float = 0.0
    mapping: MappingName = "calibrated"
    #: Multiple of the engine's least regularisation of contacts, if it has any.
    regularisation: float = 1.0
    #: The mapping of `Settings`.
    partner_restitution: float = 1.0
    #: The arrangement of a scene in a plane; None in a line.
    graph: Arrangement | None = None

    @classmethod
    def of(cls, collision: Collision, settings: Settings) -> Scene:
        """Set up a collision in the scenario of the settings.

        The step is the fraction `settings.step_fraction` of the shortest contact period.

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
        """Set up a contact graph, or return why no scene holds it.

        The step is the fraction `settings.step_fraction` of the shortest contact period.

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
        """The contacts asked for, as springs and dashpots; a ValueError if e = 0, which no dashpot has."""
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

        For two balls on a table the bound is the depth at which a spring stops the masses above it from the highest
        speed, plus its depth under their weight. Otherwise it is the depth of the softest contact if all energy goes
        into it.
        """
        if self.graph is None and self.table and len(self.masses) == 2:
            (k1, k2), above = stiffnesses, sum(self.masses)
            dynamic = self.fastest * (math.sqrt(reduced_masses(self)[0] / k1) + math.sqrt(above / k2))
            return dynamic + self.gravity * (self.masses[0] / k1 + above / k2)
        m, v = np.array(self.masses), np.reshape(self.velocities, (len(self.masses), -1))
        mean = 0.0 if self.table else m @ v / m.sum()
        return math.sqrt(float((m @ (v - mean) ** 2).sum()) / min(stiffnesses))


class World(ABC):
    """A scene at t = 0 inside an engine; an adapter makes it, and `stepping` runs it."""

    #: The engine's heights in m at t = 0, counted as in `Scene`; shape (N axes,).
    heights: Floats
    #: The numbers that the engine will use, read back after setting them. ``"stiffness"`` (N/m), ``"damping"`` (N s/m)
    #: and ``"restitution"`` have one number for each contact. ``"step"`` (s) and ``"threshold"`` (the speed of approach
    #: in m/s below which the engine drops restitution) have one number. Numbers that are missing here are not compared
    #: with the numbers asked for.
    effective: Mapping[str, tuple[float, ...]]
    #: Equilibrium depth in m of a settled lowest ball; 0 if no ball has settled, or on a rigid support.
    rest: float = 0.0
    #: Largest impulse in a step, over the momenta before and after it, that rounding alone can make. The default is an
    #: order of magnitude above the rounding of two additions and a handful of products. At 1/1000 of a period it is
    #: eleven orders below the impulse per step of a fully loaded contact.
    rounding: float = 64 * 2.0**-52
    #: True if contacts may pull, like a spring and dashpot that act until the bodies no longer overlap.
    pulls: bool = False
    #: Fraction of a whole step's impulse that a dashpot gives in the step in which its bodies meet. It is a half if the
    #: engine averages the forces at the two ends of a step.
    first_step_share: float = 1.0
    #: Relative error of a contact's change of velocity that the engine may have at every length of the step. It is part
    #: of the error of a limit (`convergence`); rigid engines have no other error.
    accuracy: float = 0.0
    #: Sum of the relative velocities in m/s that the impacts so far should have restored but did not: an engine may
    #: drop the restitution of slow impacts. No shorter step reduces this error of the limit (`convergence`).
    dropped: float = 0.0
    #: Most steps of one `leap` between events. The effective stiffness and damping predict the next event
    #: (`engines.event_free_steps`). 0 for an engine that is read after every step.
    longest_leap: int = 0
    #: Largest rate of approach in m/s of a contact in a plane that counts as zero: the engine leaves such a rate in a
    #: contact at rest.
    resting_rate: float = 0.0

    def __init__(self, scene: Scene, radius: float, rest: float = 0.0) -> None:
        #: Coordinates in m of the balls' centres when all balls of this radius only just touch; shape (N axes,). In a
        #: line they are heights above the table.
        self.places = radius * np.ravel(scene.arrangement.centres)
        self.radius, self.rest = radius, rest
        # Rounded so that sums with up to 2 N radii are exact. Gaps are then exact, see `radius_of`.
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
        Velocities in m/s and heights in m after each step, shape (steps, N axes) each; the number of
        steps is from 1 to n.

        Raises
        ------
        RuntimeError
            If the engine failed; the message says why.
        """

    @abstractmethod
    def weightless(self, velocities: Floats, heights: Floats) -> None:
        """Go on without gravity from a state of `advance`: velocities in m/s and heights in m, shape (N,)."""

    def leap(self, n: int) -> tuple[int, Floats, Floats]:
        """Take up to n steps without reading them; return their number, and the velocities and heights after them."""
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
            # If the ratio of masses is beyond double precision, the result is the lighter mass.
            m = m / (1 + m / other) if m / other < math.inf else other
        masses.append(m)
    return tuple(masses)


def periods(of: Collision | Scene) -> tuple[float, ...]:
    """Return the periods 2 pi sqrt(M_i/k_i) of the contacts in s: 0 for a rigid contact, infinite without stiffness."""
    pairs = zip(of.stiffnesses, reduced_masses(of), strict=True)
    return tuple(2 * math.pi / math.sqrt(k / mass) if k / mass > 0 else math.inf for k, mass in pairs)


def count_sweeps(scene: Scene, softening: Sequence[float] | float = 0.0) -> int:
    """Count the sweeps over the contacts that bring sequential impulses to rounding; 0 if no contact has a neighbour.

    A sweep is a step of Gauss and Seidel's method on the inverse-mass matrix of the contacts. Its diagonal includes the
    amount in 1/kg by which the engine softens contacts. On a symmetric tridiagonal matrix the spectral radius of the
    method is the square of the radius of Jacobi's (Varga, Matrix Iterative Analysis, 1962, section 4.1).
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
    """Return the spectral radius of Gauss and Seidel's method on contacts that are not in a line.

    If the matrix is singular, the method has eigenvalues of 1. They move impulses between contacts and change no
    velocity, so they are left out.
    """
    W = (J / inertia) @ J.T
    np.fill_diagonal(W, diagonal)
    lower = np.tril(W)
    moduli = np.abs(np.linalg.eigvals(np.linalg.solve(lower, lower - W)))
    return float(moduli[moduli < 1 - 1e-9].max(initial=0.0))


def radius_of(depth: float, axes: int = 1) -> float:
    """Return the radius in m for balls whose contacts go this deep: the next power of two from four depths up.

    In a plane the radius is larger by `WIDER`. Normals turn by about depth over radius while contacts act; with this
    radius final velocities change by a millionth of the speed. Places are rounded by 1e-9 of the depth.

    With this radius no ball comes near to passing through another. A larger radius would cost digits, because a
    penetration is the difference of positions of the size of the radius. With a power of two the places at which balls
    only just touch are exact. So rounding does not decide whether a contact is active in the first step, at any scale.
    """
    return 2.0 ** math.ceil(math.log2(4 * depth)) * (1.0 if axes == 1 else WIDER)
