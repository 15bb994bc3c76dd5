"""Rigid impact laws as solvers: to rigid engines what Kelvin-Voigt contacts are to compliant ones."""

from __future__ import annotations

from importlib.metadata import version

import numpy as np

from impact_xval.compliant_baselines.rigid.laws import ENDLESS, TINY, TooManyImpactsError, follow
from impact_xval.compliant_baselines.solver import OneByOne, Settings
from impact_xval.model.collision import Collision, Outcome, Path, name_of_set

_ENDLESS = "bodies come to rest together after infinitely many impacts"


class RigidLaw(OneByOne):
    """A law of `rigid.laws`, by its name; stiffnesses, exponents and steps do not concern it.

    Impacts take no time: the states are the contacts that touch at first, and none. `n_events` is the number of
    impacts, ``duration`` the time of the last one in s; status ``limit`` where a sequence of infinitely many impacts
    was ended (`laws.ENDLESS`).
    """

    kind = "reference"

    def version(self) -> str:
        """Version of this project: what is exact is its own."""
        return version("impact-xval")

    def solve_one(self, collision: Collision, settings: Settings) -> Outcome:
        """Answer one collision."""
        c = collision
        if settings.scenario != "impact":
            reason = f"scenario = {settings.scenario!r}: rigid laws are without gravity; legal: 'impact'"
            return Outcome.failure(self.name, c, "unrepresentable", reason)
        try:
            line = follow(c, self.name, min(settings.max_steps, 100_000))
        except TooManyImpactsError as error:
            return Outcome.failure(self.name, c, "timeout", str(error))
        except ValueError as error:
            return Outcome.failure(self.name, c, "unrepresentable", str(error))
        endless = line.slowest < ENDLESS / TINY * line.tiny
        touching = sum(1 << int(i) for i in np.flatnonzero(line.points[0][3]))
        paper = c.table and len(c.masses) == 2
        return Outcome(
            self.name,
            tuple(line.v.tolist()),
            tuple(line.impulse.tolist()),
            (name_of_set(touching, paper), name_of_set(0, paper))[not touching :],
            "limit" if endless else "ok",
            _ENDLESS if endless else "",
            n_events=line.impacts,
            diagnostics={"duration": line.time},
            path=path_of(line.points, line.v) if settings.record_path else None,
        )


def path_of(points: list[tuple[float, np.ndarray, np.ndarray, np.ndarray]], end: np.ndarray) -> Path:
    """Give the path through the points of a line; velocities at the end as they are reported."""
    time, velocities, impulses, acting = (np.array(each) for each in zip(*points, strict=True))
    velocities[-1], acting[-1] = end, False
    return Path(time, velocities, impulses, np.zeros_like(impulses), acting)
