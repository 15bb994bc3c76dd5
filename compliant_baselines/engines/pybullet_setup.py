"""PyBullet: what two balls and N have in common. The reasons are in `engines.pybullet_engine`."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from impact_xval.compliant_baselines.engines.packages import import_pybullet

#: Most sub-steps of one call.
STRIDE = 256

#: Fewest sub-steps that pay for the reads about them.
LEAST_STRIDE = 8

#: Gap at which the engine forgets a contact point, over the balls' radius; see the module.
BREAKING_OVER_RADIUS = 2e-7

#: What a body must not do on the engine's own account, as `changeDynamics` has it.
ZERO = (
    *("restitution", "lateralFriction", "spinningFriction", "rollingFriction"),
    *("linearDamping", "angularDamping", "contactProcessingThreshold"),
)


def exact_contacts(radius: float) -> dict[str, float]:
    """Give the engine's parameters with which contacts of balls of a radius in m do what was asked for."""
    return {
        "solverResidualThreshold": 0,
        "contactSlop": 0,
        "contactBreakingThreshold": BREAKING_OVER_RADIUS * radius,
        "restitutionVelocityThreshold": 0,
        "useSplitImpulse": 0,
    }


@contextmanager
def connected() -> Iterator[int]:
    """Connect a client without a window, and disconnect it afterwards."""
    p = import_pybullet()
    client = p.connect(p.DIRECT)
    if client < 0:
        raise RuntimeError("PyBullet gave no client: more than 1024 are connected in this process")
    try:
        yield client
    finally:
        p.disconnect(physicsClientId=client)


def exact(n: int, h: float) -> int:
    """Give the largest number up to n of sub-steps that the engine makes of their time as they are meant.

    It divides the time n h of a call by n, and counts how often what comes out goes into it
    (btDiscreteDynamicsWorld.cpp, stepSimulation); rounding spoils that for some n. Powers of two are safe.
    """
    while n * h / n != h or int(n * h / h) != n:
        n -= 1
    return n
