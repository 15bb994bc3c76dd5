"""The same contact in MuJoCo, in MJX (JAX) and in MuJoCo Warp, on a CPU.

    python -m benchmarks.mujoco_elsewhere

needs mujoco, mujoco-mjx and mujoco-warp beside this project. Each scene is the one that the adapter `mujoco` runs, with
the contacts that it maps. All three take the same number of steps from the same state. Printed is the largest
difference of a velocity from MuJoCo's, over the speed before the impact, and what the step itself does: the difference
of MuJoCo's velocity from the exact one of springs and dashpots.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from importlib import import_module
from typing import Any

import numpy as np

from impact_xval.compliant_baselines import get_solver
from impact_xval.compliant_baselines.engines.mujoco import Mujoco, MujocoWorld
from impact_xval.compliant_baselines.engines.scene import Scene
from impact_xval.compliant_baselines.solver import Settings
from impact_xval.model.arrays import Floats
from impact_xval.model.collision import Collision

SCENES = {
    "one ball on a table, e = 0.5": Collision((1.0,), (1e6,), (0.5,), (-1.0,), table=True),
    "pile, k2/k1 = 1, e = 0.9": Collision((1.0, 2.0), (1e6, 1e6), (0.9, 0.9), (-1.0, 0.0), table=True),
}

#: Steps over the shortest contact period; each scene is run for this many of its longest periods.
STEP_FRACTIONS, PERIODS = (0.1, 0.03, 0.01, 1e-3), 2.0

#: Gives the velocities in m/s after so many steps.
Stepper = Callable[[MujocoWorld, int], Floats]


def step_in_mujoco(world: MujocoWorld, n: int) -> Floats:
    """Take n steps in C."""
    return world.advance(n)[0][-1]


def step_in_mjx(precision: str) -> Stepper:
    """Return a function that takes steps in JAX, in ``"single"`` or ``"double"`` precision."""
    jax, mjx = import_module("jax"), import_module("mujoco.mjx")

    @jax.jit
    def take(model: Any, data: Any, n: int) -> Any:
        return jax.lax.fori_loop(0, n, lambda _, state: mjx.step(model, state), data)

    def step(world: MujocoWorld, n: int) -> Floats:
        jax.config.update("jax_enable_x64", precision == "double")
        model = mjx.put_model(world.model)
        data = mjx.make_data(model)
        data = data.replace(qpos=jax.numpy.array(world._data.qpos), qvel=jax.numpy.array(world._data.qvel))
        return np.array(take(model, data, n).qvel, float)

    return step


def step_in_warp(world: MujocoWorld, n: int) -> Floats:
    """Take n steps in Warp, which is of single precision."""
    warp, mujoco_warp = import_module("warp"), import_module("mujoco_warp")
    with warp.ScopedDevice("cpu"):
        model = mujoco_warp.put_model(world.model)
        data = mujoco_warp.put_data(world.model, world._data)
        for _ in range(n):
            mujoco_warp.step(model, data)
        return np.array(data.qvel.numpy()[0], float)


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
            with engine.running():
                reference = step_in_mujoco(engine.world(scene), n)
                print(f"{name}, {fraction:g} of a period, {n} steps", end="")
                print(f": step itself {np.abs(reference - exact).max():.1e}", end="", flush=True)
                for where, stepper in steppers.items():
                    world = engine.world(scene)
                    # Warp does not know all flags; none matters to these scenes.
                    world.model.opt.disableflags = 0
                    off = np.abs(stepper(world, n) - reference).max()
                    print(f", {where} {off:.1e}", end="", flush=True)
            print()


if __name__ == "__main__":
    main()
