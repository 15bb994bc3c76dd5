"""Scenes: N bodies in a line or a plane, with the parameters that an engine needs. Worlds: scenes inside an engine.

**In a line** bodies just touch, with no overlap, when all heights are 0: the height of a ball is counted from the place
where it and all bodies below it just touch. The last body is the table, if there is one. Contact i has the gap x_i -
x_{i+1}; the contact with the table has the gap x_N.

**In a plane** a body has two coordinates, x and z, and coordinates are ordered by body. So N bodies have 2 N velocities
and 2 N heights, and in a line they have N. Heights are displacements from the places where all contacts just touch. The
gaps are J x, where x are the heights, and a row of the matrix J contains the normal of a contact at the start. In fact
normals turn a little: the angle is the displacement over the distance of the centres. The angle is only a millionth,
because radii in a plane are larger by the factor `WIDER` (`radius_of`).
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

#: Factor by which the radii of balls are larger in a plane than in a line. It keeps normals from turning much.
WIDER = 2.0**20


@dataclass(frozen=True)
class Scene:
    """N bodies in a line, ball 1 on top, or in a plane (x, z); in SI units, and up is positive."""

    #: Masses in kg, one for each body.
    masses: tuple[float, ...]
    #: Velocities in m/s at t = 0: one number for each body in a line, two in a plane.
    velocities: tuple[float, ...]
    #: Heights in m at t = 0: one number for each body in a line, two in a plane. The module's docstring says from where
    #: they are counted.
    heights: tuple[float, ...]
    #: Stiffnesses asked for in N/m, one for each contact. In a line the contact with the table, if there is one, is the
    #: last.
    stiffnesses: tuple[float, ...]
    #: Restitutions asked for, one for each contact.
    restitutions: tuple[float, ...]
    #: In a line, True if there is a fixed table below the last ball. In a plane, True if a body touches a fixed plane.
    table: bool
    #: Time step in s.
    step: float
    #: Gravity in m/s^2, downwards. It is above 0 only in a drop of two balls on a table. The lower ball then starts in
    #: static equilibrium, and its height is counted from there. Each engine knows how deep the ball is in this
    #: equilibrium.
    gravity: float = 0.0
    mapping: MappingName = "calibrated"
    #: Factor on the smallest regularisation by which the engine softens contacts, if it has one.
    regularisation: float = 1.0
    #: The number of this name in `Settings`.
    partner_restitution: float = 1.0
    #: Arrangement of a scene in a plane; None in a line.
    graph: Arrangement | None = None

    @classmethod
    def of(cls, collision: Collision, settings: Settings) -> Scene:
        """Return the scene of a collision, in the scenario of the settings.

        The step is the fraction `settings.step_fraction` of the shortest contact period. An ArithmeticError says that a
        period is too large or too small for double precision.
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
        """Return the scene of a contact graph, or a sentence that says why there is none.

        The step is the fraction `settings.step_fraction` of the shortest contact period. An ArithmeticError says that a
        period is too large or too small for double precision.
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
        """The contacts of the bodies, and the places where all of them just touch."""
        return self.graph or line_of_balls(len(self.masses), self.table)

    @property
    def axes(self) -> int:
        """Number of coordinates of a body: 1 in a line, 2 in a plane (x, z)."""
        return self.arrangement.axes

    @property
    def inertia(self) -> Floats:
        """Mass in kg that belongs to each coordinate, shape (N axes,)."""
        return np.repeat(np.array(self.masses, np.float64), self.axes)

    @property
    def closing(self) -> Floats:
        """Displacements of the balls, in radii, that make touching contacts overlap by a radius; shape (N axes,)."""
        if self.graph is not None:
            J = self.graph.jacobian
            return np.asarray(np.linalg.lstsq(J, -np.ones(len(J)), rcond=None)[0], np.float64)
        touches_below = np.append(self.gaps == 0, [] if self.table else [False])
        return -np.cumsum(touches_below[::-1])[::-1].astype(np.float64)

    @cached_property
    def contacts(self) -> tuple[KelvinVoigtContact, ...]:
        """The contacts asked for, as springs and dashpots; a ValueError if a restitution is 0."""
        numbers = zip(self.stiffnesses, self.restitutions, reduced_masses(self), strict=True)
        return tuple(KelvinVoigtContact.from_restitution(k, e, mass, self.mapping) for k, e, mass in numbers)

    @property
    def requested(self) -> dict[str, tuple[float, ...]]:
        """The parameters that were asked for, under the same names as in `World.effective`."""
        numbers = {"restitution": self.restitutions, "step": (self.step,), "threshold": (0.0,)}
        if min(self.restitutions) > 0:
            numbers["stiffness"] = tuple(contact.k for contact in self.contacts)
            numbers["damping"] = tuple(contact.c for contact in self.contacts)
        return numbers

    @property
    def gaps(self) -> Floats:
        """Gaps of the contacts in m at t = 0, shape (C,)."""
        return self.arrangement.jacobian @ np.array(self.heights)

    @property
    def rates(self) -> Floats:
        """Rates of compression in m/s at t = 0, shape (C,)."""
        return -(self.arrangement.jacobian @ np.array(self.velocities))

    @property
    def speed(self) -> float:
        """Largest rate of compression in m/s at t = 0. Errors are stated as fractions of it."""
        return float(self.rates.max())

    @property
    def fastest(self) -> float:
        """Largest speed of a body in m/s at t = 0."""
        axes = self.axes
        return max(math.hypot(*self.velocities[i : i + axes]) for i in range(0, len(self.velocities), axes))

    def depth(self, stiffnesses: Sequence[float]) -> float:
        """Return a bound in m on the depth of contacts, for stiffnesses in N/m that the engine uses.

        For two balls on a table the bound is a sum of two depths: a spring stops the masses above it from the highest
        speed, and it carries their weight. Otherwise the bound is the depth at which the softest contact holds all
        kinetic energy.
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

    #: Heights in m at t = 0 in the engine, counted as in `Scene`; shape (N axes,).
    heights: Floats
    #: The parameters that the engine will use, read back after setting them. ``"stiffness"`` (N/m), ``"damping"`` (N
    #: s/m) and ``"restitution"`` have one number for each contact. ``"step"`` (s) and ``"threshold"`` (the speed of
    #: approach in m/s below which the engine drops restitution) have one number. Numbers that are missing here are not
    #: compared with the parameters that were asked for.
    effective: Mapping[str, tuple[float, ...]]
    #: Depth in m of the settled lowest ball in equilibrium; 0 if no ball has settled or if the support is rigid.
    rest: float = 0.0
    #: Largest impulse in a step that rounding alone can cause, over the momenta before and after the step. The default
    #: is ten times the rounding of two additions and a few products. At a step of 1/1000 of a period it is eleven
    #: orders of magnitude below the impulse per step of a fully loaded contact.
    rounding: float = 64 * 2.0**-52
    #: True if contacts may pull, as a spring and dashpot do that act until the bodies no longer overlap.
    pulls: bool = False
    #: Fraction of a full step's impulse that a dashpot gives in its first step. It is a half if the engine averages the
    #: forces at the two ends of a step.
    first_step_share: float = 1.0
    #: Relative error of the change of velocity by a contact that no shorter step reduces. It is part of the error of a
    #: limit (`convergence`). Rigid engines have no other error.
    accuracy: float = 0.0
    #: Sum of the relative velocities in m/s that impacts so far should have restored but did not, because an engine may
    #: drop the restitution of slow impacts. No shorter step reduces this error of a limit (`convergence`).
    dropped: float = 0.0
    #: Largest number of steps that one call of `leap` takes while no event happens. The effective stiffness and damping
    #: predict the next event (`engines.event_free_steps`). 0 for an engine that is read after every step.
    longest_leap: int = 0
    #: Largest rate of approach in m/s that the engine leaves in a contact at rest in a plane. Such a rate is treated as
    #: zero.
    resting_rate: float = 0.0

    def __init__(self, scene: Scene, radius: float, rest: float = 0.0) -> None:
        """Set `places`, `radius`, `rest` and `heights`.

        Parameters
        ----------
        scene
            The scene.
        radius
            Radius in m that all balls have in the engine; usually `Engine.radius(scene)`.
        rest
            Depth in m at which the lowest ball of a drop rests in the table. All balls start lower by this depth.
        """
        #: Coordinates in m of the balls' centres when all contacts just touch; shape (N axes,). In a line these are
        #: heights above the table.
        self.places = radius * np.ravel(scene.arrangement.centres)
        self.radius, self.rest = radius, rest
        # Heights are rounded so that their sums with up to 2 N radii are exact. Then gaps are exact too (see
        # `radius_of`).
        far = 2.0 ** math.ceil(math.log2(2 * len(scene.masses) * radius))
        self.heights = np.asarray((np.array(scene.heights) - rest + far) - far, np.float64)
        if scene.graph is not None:
            self.heights += ROUNDING_OVERLAP * radius * scene.closing

    @abstractmethod
    def advance(self, n: int) -> tuple[Floats, Floats]:
        """Take at most n steps of the engine, and return the state after each of them.

        Parameters
        ----------
        n
            Largest number of steps to take.

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
        """Continue without gravity from velocities in m/s and heights in m, shape (N,), that `advance` has returned."""

    def leap(self, n: int) -> tuple[int, Floats, Floats]:
        """Take at most n steps. Return their number, and only the last velocities in m/s and heights in m."""
        velocities, heights = self.advance(n)
        return len(velocities), velocities[-1], heights[-1]


def reduced_masses(of: Collision | Scene) -> tuple[float, ...]:
    """Return the reduced mass in kg of the two bodies of each contact; at a fixed body it is the mass of the ball."""
    arrangement = of.arrangement if isinstance(of, Scene) else line_of_balls(len(of.masses), of.table)
    masses: list[float] = []
    for first, second, _ in arrangement.touches:
        m = of.masses[first]
        if second is not None:
            other = of.masses[second]
            # If the ratio of the masses overflows double precision, the reduced mass equals the lighter mass.
            m = m / (1 + m / other) if m / other < math.inf else other
        masses.append(m)
    return tuple(masses)


def periods(of: Collision | Scene) -> tuple[float, ...]:
    """Return the periods 2 pi sqrt(M_i/k_i) of the contacts in s: 0 for a rigid contact, infinite without stiffness."""
    pairs = zip(of.stiffnesses, reduced_masses(of), strict=True)
    return tuple(2 * math.pi / math.sqrt(k / mass) if k / mass > 0 else math.inf for k, mass in pairs)


def count_sweeps(scene: Scene, softening: Sequence[float] | float = 0.0) -> int:
    """Return how many sweeps over the contacts bring sequential impulses to rounding; 0 if no contact has a neighbour.

    A sweep is a step of Gauss and Seidel's method on the inverse-mass matrix of the contacts. `softening` is added to
    its diagonal: the amount in 1/kg by which the engine softens contacts. For a symmetric tridiagonal matrix the
    spectral radius of this method is the square of that of Jacobi's method (Varga, Matrix Iterative Analysis, 1962,
    section 4.1).
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
    # 36.7 = -ln(1.1e-16), the rounding of double precision
    return math.ceil(36.7 / -math.log(min(radius_of_sweep, 1 - 2.0**-52)))


def _radius_of_sweep(J: Floats, inertia: Floats, diagonal: Floats) -> float:
    """Return the spectral radius of Gauss and Seidel's method for contacts that are not in a line.

    If the matrix is singular, the method has eigenvalues of 1. They move impulses from contact to contact without
    changing a velocity, so that they are ignored.
    """
    W = (J / inertia) @ J.T
    np.fill_diagonal(W, diagonal)
    lower = np.tril(W)
    moduli = np.abs(np.linalg.eigvals(np.linalg.solve(lower, lower - W)))
    return float(moduli[moduli < 1 - 1e-9].max(initial=0.0))


def radius_of(depth: float, axes: int = 1) -> float:
    """Return the radius in m of balls whose contacts are at most `depth` deep: the next power of two above four depths.

    In a plane the radius is larger by the factor `WIDER`. While contacts act, normals turn by about depth over radius;
    with this radius final velocities change by a millionth of the speed. Positions are then rounded by 1e-9 of the
    depth.

    With this radius no ball can pass through another one. A larger radius would cost digits, because a depth is the
    difference of positions that are as large as the radius. With a power of two the positions where balls just touch
    are exact. So it does not depend on rounding whether a contact is active in the first step, whatever the unit of
    length is.
    """
    return 2.0 ** math.ceil(math.log2(4 * depth)) * (1.0 if axes == 1 else WIDER)
