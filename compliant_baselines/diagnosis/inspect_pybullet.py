"""The contacts of a client of PyBullet, each to be measured in a client of its own.

The two bodies become spheres, a fixed one a plane, with the restitution, stiffness and damping that each has, in the
coordinates that each has, under the engine's parameters as far as they are known: what a client does not tell is known
where the calls that set it were seen, and else as it is shipped. Without friction, which does nothing to bodies that
meet along their normal, and without the damping of velocities (0.04 of them a second by default), which is no contact.

The engine begins to act on approaching bodies `contactBreakingThreshold` ahead of touch, times the smaller of their
sizes (btCollisionShape.cpp, getContactBreakingThreshold: half the diagonal of the box around a shape). So the spheres
have that size: of a sphere its radius, else half the diagonal over sqrt(3), which is that of a sphere.

Left out are pairs of links of one body, which by default do not collide. Filters (`setCollisionFilterPair` and others)
cannot be asked for: a pair that they keep apart is here all the same.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from typing import Any

from impact_xval.compliant_baselines.diagnosis.bouncing import Meeting, Place
from impact_xval.compliant_baselines.diagnosis.diagnose_pybullet import (
    MOST_PAIRS,
    Dynamics,
    Link,
    links_of,
)
from impact_xval.compliant_baselines.diagnosis.diagnosis import sentence
from impact_xval.compliant_baselines.engines.packages import import_pybullet
from impact_xval.compliant_baselines.engines.pybullet_setup import connected
from impact_xval.compliant_baselines.practical.bullet import SHIPPED_BREAKING

#: Parameters that are set apart, or name the client.
_NOT_COPIED = ("fixedTimeStep", "numSubSteps", "physicsClientId")

#: What a client tells of its parameters, beside the step.
_TOLD = ("numSolverIterations", "contactBreakingThreshold")

#: What would act on a body beside its contact.
_NOTHING_ELSE = dict.fromkeys(
    ("lateralFriction", "spinningFriction", "rollingFriction", "linearDamping", "angularDamping"), 0.0
)

_Values = tuple[tuple[str, Any], ...]


@dataclass(frozen=True)
class BulletMeeting(Meeting):
    """Two links.

    Attributes
    ----------
    surfaces : tuple
        What `changeDynamics` is told of each.
    maximal : tuple of bool
        Which of them are in maximal coordinates.
    radius : float
        Of the spheres, in m.
    parameters : tuple
        What `setPhysicsEngineParameter` is told.
    """

    surfaces: tuple[_Values, _Values]
    maximal: tuple[bool, bool]
    radius: float
    parameters: _Values

    def refusal(self) -> str | None:
        """Why these two cannot be driven: a movable link has no mass of its own."""
        if 0 in self.masses:
            return (
                "a movable link has no mass of its own: give it one, or look at the body that it is fixed to"
            )
        return None

    @contextmanager
    def engine(self) -> Iterator[Place]:
        """Connect a client for these two; nothing of one meeting is left to the next."""
        with connected() as client:
            yield partial(_World, client, self)


class _World:
    def __init__(self, client: int, meeting: BulletMeeting, speed: float, step: float, place: float) -> None:
        self._p, self._client = import_pybullet(), client
        p, at = self._p, {"physicsClientId": client}
        p.resetSimulation(**at)
        p.setPhysicsEngineParameter(**dict(meeting.parameters), fixedTimeStep=step, numSubSteps=0, **at)
        p.setGravity(0, 0, 0, **at)
        radius = meeting.radius
        sphere = p.createCollisionShape(p.GEOM_SPHERE, radius=radius, **at)
        # The movable one above.
        order = (0, 1) if math.isfinite(meeting.masses[0]) else (1, 0)
        self._bodies = []
        for i, height in zip(order, (radius + place * speed * step, -radius), strict=True):
            fixed = math.isinf(meeting.masses[i])
            shape = p.createCollisionShape(p.GEOM_PLANE, **at) if fixed else sphere
            body = p.createMultiBody(
                0.0 if fixed else meeting.masses[i],
                shape,
                basePosition=(0.0, 0.0, 0.0 if fixed else height),
                useMaximalCoordinates=int(meeting.maximal[i]),
                **at,
            )
            awake = {"activationState": p.ACTIVATION_STATE_DISABLE_SLEEPING}
            p.changeDynamics(body, -1, **_NOTHING_ELSE, **awake, **dict(meeting.surfaces[i]), **at)
            self._bodies.append(body)
        p.resetBaseVelocity(self._bodies[0], (0.0, 0.0, -speed), (0.0, 0.0, 0.0), **at)

    def step(self) -> None:
        self._p.stepSimulation(self._client)

    def rate(self) -> float:
        one, two = (self._p.getBaseVelocity(body, self._client)[0][2] for body in self._bodies)
        return one - two


def pybullet_meetings(
    client: int, engine_parameters: Mapping[str, Any] | None = None, dynamics: Dynamics | None = None
) -> Iterator[BulletMeeting]:
    """List the contacts that the bodies of a client can have.

    Parameters
    ----------
    client, engine_parameters, dynamics
        As of `diagnose_pybullet`.

    Yields
    ------
    BulletMeeting
        Those of two fixed links are none; of `MOST_PAIRS` pairs.
    """
    import pybullet as p

    at = {"physicsClientId": client}
    told = p.getPhysicsEngineParameters(**at)
    step = told["fixedTimeStep"] / max(1, told["numSubSteps"])
    parameters = {"contactBreakingThreshold": SHIPPED_BREAKING}
    parameters |= {name: told[name] for name in _TOLD if name in told}
    parameters |= {k: v for k, v in (engine_parameters or {}).items() if k not in _NOT_COPIED}
    links, _ = links_of(client, dynamics)
    found = [(link, _mass(p, client, link), _size(p, client, link)) for link in links]
    for (one, mass, size), (two, other_mass, other_size) in itertools.islice(
        itertools.combinations(found, 2), MOST_PAIRS
    ):
        if one.body == two.body or math.isinf(min(mass, other_mass)):
            continue
        jointed = any(
            math.isfinite(m) and p.getNumJoints(link.body, **at)
            for link, m in ((one, mass), (two, other_mass))
        )
        yield BulletMeeting(
            f"{one.name} and {two.name}",
            (mass, other_mass),
            step,
            (sentence("remarks.j2", "own_mass"),) if jointed else (),
            (_surface(one), _surface(two)),
            (one.maximal, two.maximal),
            min(size, other_size),
            tuple(sorted(parameters.items())),
        )


def _surface(link: Link) -> _Values:
    found = {"restitution": link.restitution}
    if link.contact is not None:
        found |= {"contactStiffness": link.contact.stiffness, "contactDamping": link.contact.damping}
    return tuple(found.items())


def _mass(p: Any, client: int, link: Link) -> float:
    """Mass of a link in kg; infinite if it is fixed, by fixed joints all the way up to a fixed base."""
    at = link.link
    while at >= 0:
        joint = p.getJointInfo(link.body, at, physicsClientId=client)
        if joint[2] != p.JOINT_FIXED:
            return link.mass
        at = joint[16]
    return link.mass if p.getDynamicsInfo(link.body, -1, physicsClientId=client)[0] else math.inf


def _size(p: Any, client: int, link: Link) -> float:
    """Radius in m of the sphere on whose approach the engine acts as on that of this link."""
    if not link.maximal:  # the shapes of others cannot be asked for
        shapes = p.getCollisionShapeData(link.body, link.link, physicsClientId=client)
        if len(shapes) == 1 and shapes[0][2] == p.GEOM_SPHERE:
            return shapes[0][3][0]
    low, high = p.getAABB(link.body, link.link, physicsClientId=client)
    return math.dist(low, high) / 2 / math.sqrt(3)
