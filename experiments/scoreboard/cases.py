"""The collisions of the scoreboard, which are called cases, and the answers of a solver to these cases.

An answer is the outcome that a solver computes for a case.

Processes in other Python environments import this module (`environments`). Such an environment holds an engine, NumPy,
SciPy, Numba and pydantic, but no pandas. So this module must not import pandas.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import product
from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from impact_xval.compliant_baselines.answers import answer, describe_exception
from impact_xval.compliant_baselines.engines.engine import Engine
from impact_xval.compliant_baselines.engines.scanner import RunEnd
from impact_xval.compliant_baselines.engines.scene import Scene, World
from impact_xval.compliant_baselines.registry import get_solver
from impact_xval.compliant_baselines.solver import Settings, Solver
from impact_xval.experiments.config.arrangements import ChainSetup
from impact_xval.model.collision import Collision

#: Restitutions e of the cases. All contacts of a case have the same e.
RESTITUTIONS = (1.0, 0.9, 0.5, 0.0)

#: Arrangement of each case, as fields of `ChainSetup`, by the name of the case. By default a ball has 1 kg, a striking
#: ball has 1 m/s, and a contact has 1e8 N/m.
CASE_SETUPS: dict[str, dict[str, float | str]] = {
    "pile, k2/k1 = 0.01": {"arrangement": "pile", "balls": 2, "mass_taper": 2.0, "stiffness_taper": 0.01},
    "pile, k2/k1 = 1": {"arrangement": "pile", "balls": 2, "mass_taper": 2.0},
    "pile, k2/k1 = 100": {"arrangement": "pile", "balls": 2, "mass_taper": 2.0, "stiffness_taper": 100.0},
    "cradle 1 on 2": {"arrangement": "cradle", "balls": 3},
    "1 on 2, 1 mm apart": {"arrangement": "row", "balls": 3, "gap": 1e-3},
    "cradle 1 on 4": {"arrangement": "cradle", "balls": 5},
    "cradle 2 on 3": {"arrangement": "cradle", "balls": 5, "strike": 2},
    "stack of 3": {"arrangement": "stack", "balls": 3},
}

#: Collision of every case, by the name and the restitution e of the case, in the order of the scoreboard.
CASES = {
    (name, e): ChainSetup.model_validate({**CASE_SETUPS[name], "e": e}).collision()
    for name, e in product(CASE_SETUPS, RESTITUTIONS)
}

#: Name of the arrangement whose answers are compared with the laws. In this arrangement bodies touch; in a rigid engine
#: they overlap by 2^-16 radii.
USUAL = "as it is"
#: Name of the arrangement in which an engine creates the bodies in the opposite order, ball N first.
MIRRORED = "made in the other order"
#: Gaps between bodies that touch in the usual arrangement, in radii, by the name of the arrangement. Overlaps are
#: negative.
_GAPS = {
    "apart by 1e-4": 1e-4,
    "apart by 1e-6": 1e-6,
    "overlapping by 1e-6": -1e-6,
    "overlapping by 1e-4": -1e-4,
}
#: Arrangements with another time step, each with the ratio of its step to the usual step.
STEPS = {"half the step": 0.5, "twice the step": 2.0}

#: Number of parts into which the timed steps of a collision are divided, and number of steps in a part. Balls with
#: springs touch during 500 steps.
TIMED_PARTS, STEPS_OF_PART = 7, 64

#: Settings of all solvers. Engines give up after `max_steps` time steps, ten times the number that the longest case
#: needs.
SETTINGS = Settings(max_steps=200_000)


def warm_up_and_time(_: object, name: str) -> float | None:
    """Return the wall time in microseconds of one time step of an engine while balls touch; None for other solvers.

    The call also makes the solver import and compile its code, so that later answers are not delayed. A collision is
    timed in parts, and the result is the time of a step in the fastest part. Other parts may be slower, because the
    first part also fills caches, and because other processes may interrupt a part. Balls with compliant contacts touch
    during all parts, balls with rigid contacts only during the first steps.
    """
    solver, collision = get_solver(name), CASES["pile, k2/k1 = 1", 0.9]
    scenes = arrange_scenes(solver, collision)
    if not isinstance(solver, Engine) or not scenes:
        answer(solver, [collision], SETTINGS)
        return None
    try:
        with solver.running():
            world = solver.world(scenes[USUAL])
            return min(_time_of_step(world) for _ in range(TIMED_PARTS))
    except Exception:  # an engine may raise any exception; the answers to the cases will report it
        return None


def _time_of_step(world: World) -> float:
    """Return the time of a step in microseconds, as a mean over at most the next `STEPS_OF_PART` steps."""
    begun = perf_counter()
    steps = len(world.advance(STEPS_OF_PART)[0])  # an engine may take fewer steps in one call
    return 1e6 * (perf_counter() - begun) / steps


def answer_case(_: object, name: str, case: str, e: float) -> list[tuple[str, str, str, Sequence[float]]]:
    """Return a solver's answers to a case, each with arrangement, status, reason and final velocities in m/s.

    An engine solves the case in every arrangement, any other solver only in the usual arrangement.
    """
    solver, collision = get_solver(name), CASES[case, e]
    answers: list[tuple[str, str, str, Sequence[float]]] = []
    try:
        scenes = arrange_scenes(solver, collision)
        if not isinstance(solver, Engine) or not scenes:
            (o,) = answer(solver, [collision], SETTINGS)
            return [(USUAL, o.status, o.reason, o.velocities)]
        runs = solver.run(list(scenes.values()), SETTINGS.max_steps)
    except Exception as error:  # an engine may fail in any way
        return [(USUAL, "crashed", describe_exception(error), ())]
    for arrangement, run in zip(scenes, runs, strict=True):
        reason = run.problem() or run.too_much_energy()
        # An engine may have given up in a long flight. After this flight, balls that approach very slowly would meet.
        # In that case the velocities in the flight are the answer.
        v = run.reported if run.over or run.end == RunEnd.IN_FLIGHT else ()
        # The balls are numbered as in the other arrangements, ball 1 first.
        v = tuple(-velocity for velocity in v[::-1]) if arrangement == MIRRORED else v
        answers.append((arrangement, "unconverged" if run.over and reason else run.status, reason, v))
    return answers


def arrange_scenes(solver: Solver, collision: Collision) -> dict[str, Scene]:
    """Return the scenes in which an engine solves a collision, by the name of the arrangement.

    The result is empty if the solver is no engine, or if the engine cannot solve the collision. An arrangement with
    gaps changes all gaps at once. For a chain without a table there are two more kinds of arrangements. In the first
    the chain is moved along its line. In the second its balls are created in the opposite order.
    """
    if not isinstance(solver, Engine) or solver.unavailable() is not None:
        return {}
    settings = replace(SETTINGS, **solver.fixed_settings)
    usual = solver.scene_or_refusal(collision, settings)
    if isinstance(usual, str):
        return {}
    radius, heights = solver.radius(usual), np.array(usual.heights)
    # Heights grow upwards. The number of changed gaps below a ball is the number of contacts below it.
    below = np.arange(len(heights), 0, -1) - (not usual.table)

    def moved(by: float | NDArray[np.floating]) -> Scene:
        return replace(usual, heights=tuple((heights + by * radius).tolist()))

    scenes = {USUAL: usual} | {name: moved(gap * below) for name, gap in _GAPS.items()}
    scenes |= {name: replace(usual, step=usual.step * share) for name, share in STEPS.items()}
    if not usual.table:
        mirrored = replace(Scene.of(collision.reversed(), settings), step=usual.step)
        scenes |= {"moved by 0.37 radii": moved(0.37), MIRRORED: mirrored}
    return scenes
