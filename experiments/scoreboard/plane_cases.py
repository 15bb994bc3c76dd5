"""The collisions of the scoreboard in a plane, and the answer of a solver to each of them.

The process of a solver imports this module; it needs no pandas.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product
from typing import NamedTuple

from impact_xval.compliant_baselines.answers import describe_exception
from impact_xval.compliant_baselines.registry import get_solver
from impact_xval.experiments.config.graphs import GRAPH_SPECS, Mirror, named_graph
from impact_xval.experiments.scoreboard.cases import RESTITUTIONS, SETTINGS
from impact_xval.model.graph.collision import GraphCollision

#: Name of a graph and its numbers by the name of a case. Balls weigh 1 kg, those below a bridge 2 kg; ball 1 has 1 m/s,
#: in a corner (-1, -0.3) m/s; all contacts have 1e8 N/m.
PLANE_SETUPS: dict[str, tuple[str, dict[str, float]]] = {
    "bernoulli": ("bernoulli", {"angle": 30.0, "stiffness_ratio": 1.0}),
    "corner, 60 degrees": ("corner", {"angle": 60.0, "stiffness_ratio": 1.0}),
    "corner, 90 degrees": ("corner", {"angle": 90.0, "stiffness_ratio": 1.0}),
    "corner, 120 degrees": ("corner", {"angle": 120.0, "stiffness_ratio": 1.0}),
    "bridge": ("bridge", {"angle": 30.0, "stiffness_ratio": 1.0, "mass_ratio": 2.0}),
    "rack of 3": ("rack", {"balls": 3.0}),
    "rack of 6": ("rack", {"balls": 6.0}),
}

#: Stiffness of all contacts in N/m.
STIFFNESS = 1e8


class PlaneCase(NamedTuple):
    """A collision of balls in a plane, and its mirror symmetry if it has one."""

    collision: GraphCollision
    mirror: Mirror | None


def _plane_case(case: str, e: float) -> PlaneCase:
    name, numbers = PLANE_SETUPS[case]
    numbers = numbers | {"e": e}
    return PlaneCase(named_graph(name, numbers, 1.0, STIFFNESS, -1.0), GRAPH_SPECS[name].mirror(numbers))


#: Every case in a plane, in the order of the board.
PLANE_CASES = {(case, e): _plane_case(case, e) for case, e in product(PLANE_SETUPS, RESTITUTIONS)}


def answer_plane_case(_: object, name: str, case: str, e: float) -> tuple[str, str, Sequence[float]]:
    """Answer a case; return status, reason, and the velocities (x, z) of ball after ball in m/s, if there are any."""
    try:
        (outcome,) = get_solver(name).solve_graphs([PLANE_CASES[case, e].collision], SETTINGS)
    except Exception as error:  # of an engine that met what it does not expect
        return "crashed", describe_exception(error), ()
    velocities = [component for velocity in outcome.velocities for component in velocity]
    return outcome.status, outcome.reason, velocities if outcome.has_result else ()
