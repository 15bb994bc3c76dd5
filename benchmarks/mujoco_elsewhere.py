"""The same contact in MuJoCo, in MJX (JAX) and in MuJoCo Warp, on a CPU.

    python -m benchmarks.mujoco_elsewhere

needs mujoco, mujoco-mjx and mujoco-warp beside this project. Each scene is the one that the adapter `mujoco` runs, with
the contacts that it maps. All three take the same number of steps from the same state. Printed is the largest
difference of a velocity from MuJoCo's, over the speed before the impact, and what the step itself does: the difference
of MuJoCo's velocity from the exact one of springs and dashpots. The last lines are of the ball that a thread on MJX is
about (docs/questions.md, question 5), after two seconds with a bounce.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from functools import partial
from importlib import import_module
from typing import Any

import numpy as np

from impact_xval.compliant_baselines import get_solver
from impact_xval.compliant_baselines.engines.mujoco import MjData, MjModel, Mujoco, take_steps
from impact_xval.compliant_baselines.engines.scene import Scene
from impact_xval.compliant_baselines.solver import Settings
from impact_xval.model.arrays import Floats
from impact_xval.model.collision import Collision

SCENES = {
    "one ball on a table, e = 0.5": Collision((1.0,), (1e6,), (0.5,), (-1.0,), table=True),
    "pile, k2/k1 = 1, e = 0.9": Collision((1.0, 2.0), (1e6, 1e6), (0.9, 0.9), (-1.0, 0.0), table=True),
    "cradle 1 on 2, e = 1": Collision((1.0,) * 3, (1e6,) * 2, (1.0,) * 2, (-1.0, 0.0, 0.0)),
}

#: Steps over the shortest contact period; each scene is run for this many of its longest periods.
STEP_FRACTIONS, PERIODS = (0.1, 0.03, 0.01, 1e-3), 2.0

#: A ball that falls from 1 m on a plane, by the contact of a `solref`; that of the thread is (-1000, 0).
BALL = """<mujoco><worldbody>
<body pos="0 0 1"><joint type="free"/><geom type="sphere" size="0.12" mass="0.6"/></body>
<geom type="plane" size="7 7.5 0.1" solref="{solref}"/></worldbody>
<option gravity="0 0 -9.81" timestep="0.002" density="1.2" viscosity="0.00002"/></mujoco>"""
SOLREFS, BALL_STEPS = ("-1000 0", ".02 1"), 1000

#: Gives the velocities in m/s after so many steps.
Stepper = Callable[[MjModel, MjData, int], Floats]


def step_in_mujoco(model: MjModel, data: MjData, n: int) -> Floats:
    """Take n steps in C."""
    return take_steps(model, data, n)[1][-1]


def step_in_mjx(precision: str) -> Stepper:
    """Return a function that takes steps in JAX, in ``"single"`` or ``"double"`` precision."""
    jax, mjx = import_module("jax"), import_module("mujoco.mjx")

    @jax.jit
    def take(model: Any, data: Any, n: int) -> Any:
        return jax.lax.fori_loop(0, n, lambda _, state: mjx.step(model, state), data)

    def step(model: MjModel, data: MjData, n: int) -> Floats:
        jax.config.update("jax_enable_x64", precision == "double")
        put = mjx.put_model(model)
        start = mjx.make_data(put)
        start = start.replace(qpos=jax.numpy.array(data.qpos), qvel=jax.numpy.array(data.qvel))
        return np.array(take(put, start, n).qvel, float)

    return step


def step_in_warp(model: MjModel, data: MjData, n: int) -> Floats:
    """Take n steps in Warp, which is of single precision."""
    warp, mujoco_warp = import_module("warp"), import_module("mujoco_warp")
    with warp.ScopedDevice("cpu"):
        put, state = mujoco_warp.put_model(model), mujoco_warp.put_data(model, data)
        for _ in range(n):
            mujoco_warp.step(put, state)
        return np.array(state.qvel.numpy()[0], float)


def new_ball(solref: str) -> tuple[MjModel, MjData]:
    """Return the ball on the contact of a solref, before it falls."""
    mujoco = import_module("mujoco")
    model = mujoco.MjModel.from_xml_string(BALL.format(solref=solref))
    return model, mujoco.MjData(model)


def new_world(engine: Mujoco, scene: Scene) -> tuple[MjModel, MjData]:
    """Return a scene as the adapter sets it up; no flag that Warp does not know matters to it."""
    world = engine.world(scene)
    option: Any = world.model.opt
    option.disableflags = 0
    return world.model, world._data


def print_differences(
    steppers: dict[str, Stepper], start: Callable[[], tuple[MjModel, MjData]], n: int
) -> Floats:
    """Print how far each stepper ends from MuJoCo after n steps from a start; return MuJoCo's velocities in m/s."""
    reference = step_in_mujoco(*start(), n)
    for where, stepper in steppers.items():
        off = np.abs(stepper(*start(), n) - reference).max()
        print(f", {where} {off:.1e}", end="", flush=True)
    return reference


def main() -> None:
    """Print the differences, by scene and step."""
    logging.disable()
    steppers: dict[str, Stepper] = {
        "MJX, single": step_in_mjx("single"),
        "MJX, double": step_in_mjx("double"),
        "Warp": step_in_warp,
    }
    engine = get_solver("mujoco")
    assert isinstance(engine, Mujoco)
    for name, collision in SCENES.items():
        exact = get_solver("kelvin-voigt").solve(collision).velocities
        for fraction in STEP_FRACTIONS:
            scene = engine.scene_or_refusal(collision, Settings(step_fraction=fraction))
            assert isinstance(scene, Scene)
            longest = max(contact.mass / contact.k for contact in scene.contacts) ** 0.5 * 2 * np.pi
            n = round(PERIODS * longest / scene.step)
            print(f"{name}, {fraction:g} of a period, {n} steps", end="")
            with engine.running():
                reference = print_differences(steppers, partial(new_world, engine, scene), n)
            print(f"; the step itself {np.abs(reference - exact).max():.1e}")
    for solref in SOLREFS:
        print(f"ball on solref {solref}, {BALL_STEPS} steps", end="")
        print_differences(steppers, partial(new_ball, solref), BALL_STEPS)
        print()


if __name__ == "__main__":
    main()
