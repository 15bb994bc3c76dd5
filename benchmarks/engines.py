"""What the harness adds to bare engine stepping, for the same steps in the same run.

Run as ``python benchmarks/engines.py``. The cells are chunks of the default grid, in the default scenario.
For each engine one run measures, in CPU time of this process and as the best of several repetitions,

* **bare**: the engine steps the very same scenes, built in the same way, for the very same numbers of steps, in
  calls as long as the engine allows and with nothing read on the way: ``mj_step(model, data, nstep)`` of MuJoCo, one
  scene after the other; ``stepSimulation`` of PyBullet with 256 sub-steps a call. Building is not part of it;
* **bare, without contacts**: the same steps with no contact looked for, so that none is solved for either: what is left
  is the rest of a step. The motion is then another;
* **end**: the harness as the steps 2h and 4h of a convergence estimate use it: building, stepping, finding the end of
  the collision to the step, states and impulses, no path;
* **path**: the same with the path recorded, as the step h uses it;
* **estimated**: `solve_many` with convergence estimates, everything included, over all the steps it takes,
  beside what a step costs bare.

The numbers to look at are the ratios to bare, a step.
"""

from __future__ import annotations

import argparse
import platform
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from importlib import import_module
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from impact_xval.compliant_baselines import get_solver
from impact_xval.compliant_baselines.engines.engine import Engine
from impact_xval.compliant_baselines.engines.scene import Scene
from impact_xval.compliant_baselines.solver import Convergence, Settings
from impact_xval.experiments.config.cells import experiment_cells
from impact_xval.experiments.config.experiment import parse_config
from impact_xval.model.collision import Collision


def cells(chunks: int) -> list[Collision]:
    """Take chunks of the default grid as a run hands them to a worker, evenly spread over it."""
    grid = experiment_cells(parse_config({}))
    numbers = np.linspace(0, grid.chunks() - 1, chunks + 2).round().astype(int)[1:-1]
    return [grid[index] for number in numbers for index in grid.chunk(int(number))]


def best(run: Callable[[], float], repetitions: int) -> float:
    """Shortest of several times in s."""
    return min(run() for _ in range(repetitions))


def timed(run: Callable[[], object]) -> float:
    """CPU time of this process in s; other processes cost it nothing."""
    start = time.process_time()
    run()
    return time.process_time() - start


def bare_mujoco(scenes: Sequence[Scene], steps: Sequence[int], contacts: bool = True) -> float:
    """Step every scene by mj_step alone, with contacts or without."""
    from impact_xval.compliant_baselines.engines.mujoco import MujocoWorld

    mujoco: Any = import_module("mujoco")
    spent = 0.0
    for scene, n in zip(scenes, steps, strict=True):
        batch = MujocoWorld(scene, {}).batch
        model = batch.get_model(0)
        data = mujoco.MjData(model)
        if not contacts:
            model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
        data.qpos[:], data.qvel[:] = batch.qpos[0], batch.qvel[0]
        spent += timed(lambda model=model, data=data, n=n: mujoco.mj_step(model, data, nstep=n))
    return spent


def bare_pybullet(
    scenes: Sequence[Scene], steps: Sequence[int], contacts: bool = True, stride: int = 256
) -> float:
    """Step every scene by stepSimulation alone, many sub-steps a call, with contacts or without."""
    import pybullet as p

    from impact_xval.compliant_baselines.engines.pybullet import Client, PybulletWorld

    spent, client = 0.0, p.connect(p.DIRECT)
    for scene, n in zip(scenes, steps, strict=True):
        PybulletWorld(Client(client), scene, {})
        for body in () if contacts else range(p.getNumBodies(client)):
            p.setCollisionFilterGroupMask(p.getBodyUniqueId(body, client), -1, 0, 0, client)

        def run(h: float = scene.step, n: int = n) -> None:
            p.setPhysicsEngineParameter(fixedTimeStep=stride * h, numSubSteps=stride, physicsClientId=client)
            for _ in range(n // stride):
                p.stepSimulation(client)
            p.setPhysicsEngineParameter(fixedTimeStep=h, numSubSteps=0, physicsClientId=client)
            for _ in range(n % stride):
                p.stepSimulation(client)

        spent += timed(run)
    p.disconnect(client)
    return spent


def measure(
    name: str, collisions: Sequence[Collision], scenario: Any, repetitions: int
) -> list[tuple[str, float, float]]:
    """Rows of (what, microseconds a step, ratio to bare) of one engine."""
    solver = get_solver(name)
    assert isinstance(solver, Engine)
    settings = Settings(scenario=scenario, record_path=True)
    bare = {"mujoco": bare_mujoco, "pybullet": bare_pybullet}[name]
    rows: list[tuple[str, float, float]] = []
    coarse = [Scene.of(c, settings) for c in collisions]
    spent_bare: list[tuple[float, int]] = []
    for label, times, record in (
        ("path, step h", 1, True),
        ("end, step 2h", 2, False),
        ("end, step 4h", 4, False),
    ):
        scenes = [replace(scene, step=times * scene.step) for scene in coarse]
        runs = [run for run in solver.run(scenes, settings.max_steps, record) if run.over]
        scenes, steps = [run.scene for run in runs], [run.n_steps for run in runs]
        harness = best(
            lambda scenes=scenes, record=record: timed(
                lambda: solver.run(scenes, settings.max_steps, record)
            ),
            repetitions,
        )
        alone = best(lambda scenes=scenes, steps=steps: bare(scenes, steps), repetitions)
        total = sum(steps)
        spent_bare.append((alone, total))
        rows.append((f"bare, {label.split(', ')[1]}", alone / total * 1e6, 1.0))
        if record:
            rest = best(lambda scenes=scenes, steps=steps: bare(scenes, steps, False), repetitions)
            rows.append((f"bare, {label.split(', ')[1]}, without contacts", rest / total * 1e6, rest / alone))
        rows.append((label, harness / total * 1e6, harness / alone))
    estimated = replace(settings, convergence=Convergence())
    taken: list[int] = []
    original = solver.run

    def counting(*arguments: Any, **named: Any) -> Any:
        runs = original(*arguments, **named)
        taken.append(sum(run.n_steps for run in runs))
        return runs

    solver.run = counting
    spent = best(
        lambda: (taken.clear(), timed(lambda: solver.solve_many(collisions, estimated)))[1], repetitions
    )
    solver.run = original
    alone = sum(time for time, _ in spent_bare) / sum(n for _, n in spent_bare)
    rows.append(("estimated, all steps", spent / sum(taken) * 1e6, spent / sum(taken) / alone))
    return rows


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--chunks", type=int, default=3, help="chunks of 16 cells of the default grid")
    parser.add_argument("--repetitions", type=int, default=3)
    parser.add_argument("--scenario", choices=("drop", "impact"), default="drop")
    arguments = parser.parse_args()
    console = Console(width=100)
    console.print(f"{platform.processor() or platform.machine()}, Python {platform.python_version()}")
    collisions = cells(arguments.chunks)
    table = Table("engine", "what", "us a step", "over bare")
    for name in ("mujoco", "pybullet"):
        reason = get_solver(name).unavailable()
        if reason is not None:
            console.print(f"{name}: {reason}")
            continue
        for what, micro, ratio in measure(name, collisions, arguments.scenario, arguments.repetitions):
            table.add_row(name, what, f"{micro:.2f}", f"{ratio:.2f}")
    console.print(table)


if __name__ == "__main__":
    main()
