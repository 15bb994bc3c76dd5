"""The same contact in MuJoCo, in MJX (JAX) and in MuJoCo Warp, on a CPU.

    python -m benchmarks.mujoco_elsewhere [chains] [ball] [box]

needs mujoco, mujoco-mjx and mujoco-warp beside this project. Each scene is the one that the adapter `mujoco` runs, with
the contacts that it maps. All three take the same number of steps from the same state. The script prints the largest
difference of a velocity from MuJoCo's, over the speed before the impact, and the effect of the step: the difference
between MuJoCo's velocity and the exact velocity of springs and dashpots. ``ball`` is the ball of a forum thread on MJX
(docs/questions.md, question 5), after two seconds with a bounce. ``box`` is a box that falls on a fixed box or a plane,
flat or on an edge, with several contacts: another thread has a falling box, but does not state its size or its
contacts. For a ball and a box the largest difference is in m/s or rad/s.
"""

from __future__ import annotations

import logging
import sys
from collections.abc import Callable
from functools import partial
from importlib import import_module
from itertools import product
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

#: A ball that falls from 1 m on a plane, with the contact of a `solref`; the thread has the solref (-1000, 0).
BALL = """<mujoco><worldbody>
<body pos="0 0 1"><joint type="free"/><geom type="sphere" size="0.12" mass="0.6"/></body>
<geom type="plane" size="7 7.5 0.1" solref="{solref}"/></worldbody>
<option gravity="0 0 -9.81" timestep="0.002" density="1.2" viscosity="0.00002"/></mujoco>"""
SOLREFS, BALL_STEPS = ("-1000 0", ".02 1"), 1000

#: A box of 1 kg that falls from 0.2 m on another box or a plane, with the contact of a `solref` and `solimp`.
BOX = """<mujoco><default><geom solref="{solref}" solimp="{solimp}"/></default><worldbody>
<body pos="0 0 0.3" euler="0 {tilt} 0"><freejoint/><geom type="box" size="0.1 0.1 0.1" mass="1"/></body>
{floor}</worldbody></mujoco>"""
FLOORS = {
    "box": '<geom type="box" size="1 1 0.1" pos="0 0 -0.1"/>',
    "plane": '<geom type="plane" size="1 1 0.1"/>',
}
BOX_CONTACTS = (
    (".02 1", ".9 .95 .001"),
    (".004 1", ".9 .95 .001"),
    (".02 .1", ".9 .95 .001"),
    ("-10000 -10", ".0001 .0001 .001"),
)
TILTS, BOX_STEPS = (0, 30), 200

#: Function that returns the velocities in m/s after a number of steps.
Stepper = Callable[[MjModel, MjData, int], Floats]


def step_in_mujoco(model: MjModel, data: MjData, n: int) -> Floats:
    """Take n time steps with MuJoCo, which is written in C."""
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
    """Take n time steps with MuJoCo Warp, which computes in single precision."""
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


def new_box(floor: str, tilt: float, solref: str, solimp: str) -> tuple[MjModel, MjData]:
    """Return the box above a floor, tilted by an angle in degrees."""
    mujoco = import_module("mujoco")
    text = BOX.format(floor=FLOORS[floor], tilt=tilt, solref=solref, solimp=solimp)
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    return model, data


def new_world(engine: Mujoco, scene: Scene) -> tuple[MjModel, MjData]:
    """Return a scene from the adapter; it needs no flag that Warp does not know."""
    world = engine.world(scene)
    option: Any = world.model.opt
    option.disableflags = 0
    return world.model, world._data


def print_differences(
    steppers: dict[str, Stepper], start: Callable[[], tuple[MjModel, MjData]], n: int
) -> Floats:
    """Print each stepper's distance from MuJoCo after n steps from a start; return MuJoCo's velocities in m/s."""
    reference = step_in_mujoco(*start(), n)
    for where, stepper in steppers.items():
        off = np.abs(stepper(*start(), n) - reference).max()
        print(f", {where} {off:.1e}", end="", flush=True)
    return reference


def print_chains(steppers: dict[str, Stepper]) -> None:
    """Print the differences of one ball on a table and of chains, by step."""
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


def print_ball(steppers: dict[str, Stepper]) -> None:
    """Print the differences of a ball on a plane."""
    for solref in SOLREFS:
        print(f"ball on solref {solref}, {BALL_STEPS} steps", end="")
        print_differences(steppers, partial(new_ball, solref), BALL_STEPS)
        print()


def print_boxes(steppers: dict[str, Stepper]) -> None:
    """Print the differences of a box on a box or a plane."""
    for floor, tilt, (solref, solimp) in product(FLOORS, TILTS, BOX_CONTACTS):
        print(
            f"box on a {floor}, tilted by {tilt}, solref {solref}, solimp {solimp}, {BOX_STEPS} steps", end=""
        )
        print_differences(steppers, partial(new_box, floor, tilt, solref, solimp), BOX_STEPS)
        print(flush=True)
    print_points_of_an_edge()


def print_points_of_an_edge() -> None:
    """Print the places of contacts in C and MJX along the edge of a box that has just met another."""
    mujoco, jax, mjx = import_module("mujoco"), import_module("jax"), import_module("mujoco.mjx")
    made: Any = new_box("box", 30, *BOX_CONTACTS[0])
    model, data = made
    while not data.ncon:
        mujoco.mj_step(model, data)
    mujoco.mj_forward(model, data)
    put = mjx.put_model(model)
    start = mjx.make_data(put)
    state = jax.jit(mjx.forward)(put, start.replace(qpos=jax.numpy.array(data.qpos)))
    found = getattr(state, "_impl", state).contact
    overlaps = np.array(found.dist) < 0
    for where, places in (("C", data.contact.pos), ("MJX", np.array(found.pos)[overlaps])):
        along = " ".join(f"{place:.2f}" for place in sorted(places[:, 1]))
        print(f"contacts of an edge from -0.1 to 0.1 m on a box, {where}: {along}", flush=True)


def main() -> None:
    """Print the differences for the scenes that the command names, or for all scenes."""
    logging.disable()
    printers = {"chains": print_chains, "ball": print_ball, "box": print_boxes}
    steppers: dict[str, Stepper] = {
        "MJX, single": step_in_mjx("single"),
        "MJX, double": step_in_mjx("double"),
        "Warp": step_in_warp,
    }
    for name in sys.argv[1:] or printers:
        printers[name](steppers)


if __name__ == "__main__":
    main()
