"""The collisions of the scoreboard, and the answers of a solver to them.

A process of another interpreter imports this module, in an environment that holds an engine and little else
(`environments`): NumPy, SciPy, Numba and pydantic, no pandas.
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

#: Coefficients of restitution of all contacts.
RESTITUTIONS = (1.0, 0.9, 0.5, 0.0)

#: Fields of `ChainSetup` by the name of a case. Defaults: balls of 1 kg at 1 m/s, contacts of 1e8 N/m.
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

#: Every case, in the order of the board.
CASES = {
    (name, e): ChainSetup.model_validate({**CASE_SETUPS[name], "e": e}).collision()
    for name, e in product(CASE_SETUPS, RESTITUTIONS)
}

#: The arrangement that is compared with the laws: bodies touch, those of a rigid engine overlap by 2^-16 radii.
USUAL = "as it is"
#: The arrangement in which bodies are made in the opposite order, ball N first.
MIRRORED = "made in the other order"
#: Gaps, in radii, by which touching bodies are apart, or overlap.
_GAPS = {
    "apart by 1e-4": 1e-4,
    "apart by 1e-6": 1e-6,
    "overlapping by 1e-6": -1e-6,
    "overlapping by 1e-4": -1e-4,
}
#: Time steps of arrangements, over the usual step.
STEPS = {"half the step": 0.5, "twice the step": 2.0}

#: Parts of a collision in which a step is timed, and steps of a part: 448 of the 500 in which springs touch.
TIMED_PARTS, STEPS_OF_PART = 7, 64

#: Steps after which an impact is given up: ten times those of the longest.
SETTINGS = Settings(max_steps=200_000)


def warm_up_and_time(_: object, name: str) -> float | None:
    """Compile and import a solver's code; return the microseconds of an engine's step, else None.

    A collision is timed in parts, and the shortest counts: the first part also fills caches, and other processes may
    interrupt a part. In all parts compliant contacts touch; rigid ones are over after the first steps.
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
    except Exception:  # of an engine that met what it does not expect: each case says so
        return None


def _time_of_step(world: World) -> float:
    """Return the microseconds of a step, over the next `STEPS_OF_PART` steps at most."""
    begun = perf_counter()
    steps = len(world.advance(STEPS_OF_PART)[0])  # an engine may take fewer in one call
    return 1e6 * (perf_counter() - begun) / steps


def answer_case(_: object, name: str, case: str, e: float) -> list[tuple[str, str, str, Sequence[float]]]:
    """Answer a case, an engine in every arrangement; return arrangement, status, reason and velocities."""
    solver, collision = get_solver(name), CASES[case, e]
    answers: list[tuple[str, str, str, Sequence[float]]] = []
    try:
        scenes = arrange_scenes(solver, collision)
        if not isinstance(solver, Engine) or not scenes:
            (o,) = answer(solver, [collision], SETTINGS)
            return [(USUAL, o.status, o.reason, o.velocities)]
        runs = solver.run(list(scenes.values()), SETTINGS.max_steps)
    except Exception as error:  # of an engine that met what it does not expect
        return [(USUAL, "crashed", describe_exception(error), ())]
    for arrangement, run in zip(scenes, runs, strict=True):
        reason = run.problem() or run.too_much_energy()
        # A run given up in a long flight, after which balls that hardly approach would meet, has the velocities of it.
        v = run.reported if run.over or run.end == RunEnd.IN_FLIGHT else ()
        v = (
            tuple(-velocity for velocity in v[::-1]) if arrangement == MIRRORED else v
        )  # numbered as in the others
        answers.append((arrangement, "unconverged" if run.over and reason else run.status, reason, v))
    return answers


def arrange_scenes(solver: Solver, collision: Collision) -> dict[str, Scene]:
    """Return the scenes of a collision by arrangement; none unless the solver is an engine that takes the collision.

    Every gap is changed at once. Without a table a chain is also moved along its line, and mirrored.
    """
    if not isinstance(solver, Engine) or solver.unavailable() is not None:
        return {}
    settings = replace(SETTINGS, **solver.fixed_settings)
    usual = solver.scene_or_refusal(collision, settings)
    if isinstance(usual, str):
        return {}
    radius, heights = solver.radius(usual), np.array(usual.heights)
    # Heights grow upwards: ball i is above as many changed gaps as there are contacts below it.
    below = np.arange(len(heights), 0, -1) - (not usual.table)

    def moved(by: float | NDArray[np.floating]) -> Scene:
        return replace(usual, heights=tuple((heights + by * radius).tolist()))

    scenes = {USUAL: usual} | {name: moved(gap * below) for name, gap in _GAPS.items()}
    scenes |= {name: replace(usual, step=usual.step * share) for name, share in STEPS.items()}
    if not usual.table:
        mirrored = replace(Scene.of(collision.reversed(), settings), step=usual.step)
        scenes |= {"moved by 0.37 radii": moved(0.37), MIRRORED: mirrored}
    return scenes
