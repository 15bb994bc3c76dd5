"""`RigidLaw`: the solver class of the rigid impact laws in `rigid.laws` and `rigid.graphs`; the registry uses it."""

from __future__ import annotations

from collections.abc import Sequence
from importlib.metadata import version

import numpy as np

from impact_xval.compliant_baselines.rigid.graphs import solve_graph_by_rigid_law
from impact_xval.compliant_baselines.rigid.laws import Line, TooManyImpactsError, follow_impacts
from impact_xval.compliant_baselines.solver import OneByOne, Settings
from impact_xval.model.collision import Collision
from impact_xval.model.graph.collision import GraphCollision
from impact_xval.model.graph.collision_outcome import GraphCollisionOutcome
from impact_xval.model.outcome import Outcome
from impact_xval.model.path import Path
from impact_xval.model.states import name_of_set


class RigidLaw(OneByOne):
    """Exact solver of one of `LAWS`; its name is the name of the law. Rigid engines are compared with it.

    It ignores stiffnesses, exponents and steps. Impacts take no time, so there are two states: the contacts that touch
    at the start, and then no contact. `n_events` is the number of impacts, and ``duration`` the time of the last impact
    in s. The status is ``closed-form`` if a sequence has infinitely many impacts. Then only its first impacts are
    counted and recorded in the path.
    """

    kind = "reference"

    def version(self) -> str:
        """Return the version of this project."""
        return version("impact-xval")

    def solve_one(self, collision: Collision, settings: Settings) -> Outcome:
        """Solve one collision of balls in a line."""
        c = collision
        if settings.scenario != "impact":
            reason = f"scenario = {settings.scenario!r}: rigid laws are without gravity; legal: 'impact'"
            return Outcome.failure(self.name, c, "unrepresentable", reason)
        try:
            line = follow_impacts(c, self.name, min(settings.max_steps, 100_000))
        except TooManyImpactsError as error:
            return Outcome.failure(self.name, c, "timeout", str(error))
        except ValueError as error:
            return Outcome.failure(self.name, c, "unrepresentable", str(error))
        touching = sum(1 << int(i) for i in np.flatnonzero(line.points[0].acting))
        paper = c.table and len(c.masses) == 2
        first, end = name_of_set(touching, paper), name_of_set(0, paper)
        return Outcome(
            self.name,
            tuple(line.v.tolist()),
            tuple(line.impulses(line.v).tolist()),
            (first, end) if touching else (end,),
            "closed-form" if line.endless else "ok",
            "bodies come to rest together after infinitely many impacts" if line.endless else "",
            n_events=line.impacts,
            diagnostics={"duration": line.time},
            path=_path_of(line) if settings.record_path else None,
        )

    def solve_graphs(
        self, collisions: Sequence[GraphCollision], settings: Settings
    ) -> Sequence[GraphCollisionOutcome]:
        """Solve contact graphs, one by one (`rigid.graphs`)."""
        if settings.scenario != "impact":
            reason = f"scenario = {settings.scenario!r}: rigid laws are without gravity; legal: 'impact'"
            return [
                GraphCollisionOutcome.failure(self.name, c, "unrepresentable", reason) for c in collisions
            ]
        return [solve_graph_by_rigid_law(self.name, collision) for collision in collisions]


def _path_of(line: Line) -> Path:
    """Return the path of a finished line; its last velocities are those of the outcome."""
    time, u, acting = (np.array(values) for values in zip(*line.points, strict=True))
    u[-1], acting[-1] = line.u, False
    velocities = np.array([line.velocities(rates) for rates in u])
    impulses = np.array([line.impulses(v) for v in velocities])
    return Path(time, velocities, impulses, np.zeros_like(impulses), acting)
