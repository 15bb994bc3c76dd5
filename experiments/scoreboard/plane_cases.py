"""The collisions in a plane for the scoreboard, and the function with which a solver answers one of them.

Used by `plane`, and imported in the process of each solver. It needs no pandas.
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

#: For each case by its name: the name of a graph in `GRAPH_SPECS`, and the parameters of this graph. Balls have 1 kg,
#: but the two balls below a bridge have 2 kg. Ball 1 has a speed of 1 m/s, and in a corner the velocity (-1, -0.3) m/s.
#: All contacts have the stiffness `STIFFNESS`.
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


#: Every case in a plane by its name and restitution e, in the order of the scoreboard.
PLANE_CASES = {(case, e): _plane_case(case, e) for case, e in product(PLANE_SETUPS, RESTITUTIONS)}


def answer_plane_case(_: object, name: str, case: str, e: float) -> tuple[str, str, Sequence[float]]:
    """Let a solver answer one case, and return the status, the reason of the status, and the velocities in m/s.

    The velocities are v1x, v1z, v2x, ... They are empty if there is no result. The first argument is not used.
    """
    try:
        (outcome,) = get_solver(name).solve_graphs([PLANE_CASES[case, e].collision], SETTINGS)
    except Exception as error:  # of an engine that met what it does not expect
        return "crashed", describe_exception(error), ()
    velocities = [component for velocity in outcome.velocities for component in velocity]
    return outcome.status, outcome.reason, velocities if outcome.has_result else ()
