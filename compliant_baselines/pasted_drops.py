"""Drops of two bodies in MuJoCo or PyBullet, set up only by the text that `paste` prints.

The printed text runs unchanged: MuJoCo loads it from a file, and PyBullet executes it as Python. The scene contains
only two bodies, which are larger than the contact is deep. So every number that the text does not set has the engine's
default, as in the scene of a user who pastes it. The bodies meet along x; in MuJoCo they slide on joints. Gravity has
no effect: MuJoCo's default does not act along x, and PyBullet's default is zero.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from importlib import import_module
from pathlib import Path
from tempfile import TemporaryDirectory
from types import CodeType
from typing import Any

import numpy as np

from impact_xval.compliant_baselines.engines import pybullet
from impact_xval.compliant_baselines.engines.mujoco import Mujoco, take_steps
from impact_xval.compliant_baselines.engines.scene import Floats
from impact_xval.compliant_baselines.solver import SolverError

#: Largest change of the relative velocity in a step, over the speed of approach, that is taken for rounding. A larger
#: change is taken for a force.
ROUNDING = 1e-12

#: Number of steps without force after which bodies that separate are taken for parted.
QUIET_STEPS = 3

#: Number of steps after which all drops are checked for their end.
BLOCK = 128

#: Half the edge in m of the smallest box that is used in PyBullet. Its shapes have a margin of 0.04 m, so that a box
#: must not be much smaller.
SMALLEST_BOX = 0.1

#: A MuJoCo file around the pasted text. The bodies have geoms with the names A and B, which the text uses.
SCENE = """\
<mujoco>
{text}
  <worldbody>
    {b}
    {a}
  </worldbody>
</mujoco>
"""
BODY = """<body pos="{x!r} 0 0"><joint type="slide" axis="1 0 0"/>
      <inertial pos="0 0 0" mass="{mass!r}" diaginertia="1 1 1"/><geom name="{name}" size="{radius!r}"/></body>"""
FIXED_BODY = '<geom name="{name}" size="{radius!r}" pos="{x!r} 0 0"/>'

#: Function that takes n more steps of all drops. It returns the relative velocities in m/s after each step, shape
#: (drops, n).
Advance = Callable[[int], Floats]


def mujoco_scene(text: str, masses: Sequence[float], radius: float) -> str:
    """Return an MJCF file with the pasted text and two spheres that touch. A has the larger x.

    `masses` are the masses of A and B in kg. B is fixed if its mass is infinite.
    """
    (mass_a, mass_b), fixed = masses, math.isinf(masses[1])
    b = (FIXED_BODY if fixed else BODY).format(x=0.0, mass=mass_b, name="B", radius=radius)
    a = BODY.format(x=2 * radius, mass=mass_a, name="A", radius=radius)
    return SCENE.format(text=text.rstrip(), a=a, b=b)


def drop_in_mujoco(
    text: str, masses: Sequence[float], radius: float, speed: float, gaps: Sequence[float], most_steps: int
) -> list[tuple[float, int]]:
    """Drop A on B in MuJoCo once for each gap in m.

    Return the restitution and the number of time steps with contact of each drop.
    """
    mujoco: Any = import_module("mujoco")
    with TemporaryDirectory() as folder, Mujoco().running():
        path = Path(folder, "scene.xml")
        path.write_text(mujoco_scene(text, masses, radius), encoding="utf-8")
        try:
            model = mujoco.MjModel.from_xml_path(str(path))
        except ValueError as error:
            raise SolverError("mujoco", "unrepresentable", " ".join(str(error).split())) from None
        drops = [mujoco.MjData(model) for _ in gaps]
        for data, gap in zip(drops, gaps, strict=True):
            data.qpos[-1], data.qvel[-1] = gap, -speed

        def advance(n: int) -> Floats:
            try:
                velocities = np.array([take_steps(model, data, n)[1] for data in drops])
            except RuntimeError as error:
                raise SolverError("mujoco", "crashed", str(error)) from None
            return velocities[:, :, -1] - velocities[:, :, :-1].sum(axis=-1)

        return _follow("mujoco", advance, len(gaps), speed, most_steps)


def drop_in_pybullet(
    text: str, masses: Sequence[float], radius: float, speed: float, gaps: Sequence[float], most_steps: int
) -> list[tuple[float, int]]:
    """Drop A on B in PyBullet once for each gap in m.

    Both bodies are spheres. Return the restitution and the number of time steps with contact of each drop.
    """
    return _drop_each(text, masses, radius, speed, gaps, most_steps, flat=False)


def drop_on_flat_in_pybullet(
    text: str, masses: Sequence[float], radius: float, speed: float, gaps: Sequence[float], most_steps: int
) -> list[tuple[float, int]]:
    """Drop A on a flat surface of B in PyBullet once for each gap in m: on a plane if B is fixed, else on a box.

    Return the restitution and the number of time steps with contact of each drop.

    PyBullet makes the contact of a sphere with a flat surface already at a distance of `contactBreakingThreshold`, but
    the contact of two spheres only when they touch. So the first step with force may be another one than with two
    spheres.
    """
    return _drop_each(text, masses, radius, speed, gaps, most_steps, flat=True)


def _drop_each(
    text: str,
    masses: Sequence[float],
    radius: float,
    speed: float,
    gaps: Sequence[float],
    most_steps: int,
    flat: bool,
) -> list[tuple[float, int]]:
    """Drop A on B once for each gap in m. All drops use one connection, because connecting takes longer than a drop."""
    code = compile(text, "pasted", "exec")
    with pybullet.connected() as p:
        return [_drop_once(p, code, masses, radius, speed, gap, most_steps, flat) for gap in gaps]


def _drop_once(
    p: pybullet.Client,
    code: CodeType,
    masses: Sequence[float],
    radius: float,
    speed: float,
    gap: float,
    most_steps: int,
    flat: bool,
) -> tuple[float, int]:
    """Empty the engine's world, drop A on B in it, and return the restitution and the number of steps with contact."""
    (mass_a, mass_b), fixed = masses, math.isinf(masses[1])
    p.resetSimulation()
    sphere, depth = p.createCollisionShape(p.GEOM_SPHERE, radius=radius), radius
    side = sphere
    if flat and fixed:
        side, depth = p.createCollisionShape(p.GEOM_PLANE, planeNormal=[1, 0, 0]), 0.0
    elif flat:
        depth = max(radius, SMALLEST_BOX)
        side = p.createCollisionShape(p.GEOM_BOX, halfExtents=[depth] * 3)
    b = p.createMultiBody(0 if fixed else mass_b, side, basePosition=[-depth, 0, 0])
    a = p.createMultiBody(mass_a, sphere, basePosition=[radius + gap, 0, 0])
    exec(code, {"p": p, "a": a, "b": b})
    p.resetBaseVelocity(a, [-speed, 0, 0])
    step, read, client = p.module.stepSimulation, p.module.getBaseVelocity, p.number

    def advance(n: int) -> Floats:
        rates = np.empty((1, n))
        for i in range(n):
            step(client)
            rates[0, i] = read(a, client)[0][0] - read(b, client)[0][0]
        return rates

    (drop,) = _follow("pybullet", advance, 1, speed, most_steps)
    return drop


def _follow(
    name: str, advance: Advance, drops: int, speed: float, most_steps: int
) -> list[tuple[float, int]]:
    """Take steps of all drops until all are over. Return each drop's restitution and number of steps with contact."""
    before = np.full((drops, 1), -speed)
    first, last = np.full(drops, -1), np.full(drops, -1)
    for start in range(0, most_steps, BLOCK):
        n = min(BLOCK, most_steps - start)
        rates = advance(n)
        if not np.isfinite(rates).all():
            raise SolverError(name, "crashed", "velocities are no longer finite")
        loaded = np.abs(np.diff(rates, axis=1, prepend=before)) > ROUNDING * speed
        has_force = loaded.any(axis=1)
        first = np.where(has_force & (first < 0), start + loaded.argmax(axis=1), first)
        last = np.where(has_force, start + n - 1 - loaded[:, ::-1].argmax(axis=1), last)
        before = rates[:, -1:]
        is_quiet = start + n - 1 - last >= QUIET_STEPS
        separates = before[:, 0] >= -ROUNDING * speed
        if ((first >= 0) & is_quiet & separates).all():
            return list(zip((before[:, 0] / speed).tolist(), (last - first + 1).tolist(), strict=True))
    if (first < 0).any():
        raise SolverError(name, "unconverged", "no step with force: the bodies passed through each other")
    raise SolverError(name, "timeout", f"not over after {most_steps} steps")
