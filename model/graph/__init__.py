"""Contact graphs: bodies of any kind that meet at once, in exact event-driven motion (docs/graphs.md).

What users call:

- `solving`: `solve_graph` and `solve_graphs` solve graphs that are given by a Delassus matrix.
- `collision`: `GraphCollision` is a graph that is given by its bodies and contacts.
- `named`: functions that return well-known graphs, such as Bernoulli's problem.
- `outcome`: the model's results. `collision_outcome`: the result of any solver.

How a graph is solved:

- `law`: which functions of a contact are watched for a zero, and the effect of each event.
- `motion`: the power series of the motion between events, and the start rule, which makes contacts active at first
  touch and after each event.
- `event`: the search for the first event. `rigid`: infinitely stiff contacts. `grazing`: how near the collision is to a
  jump of its outcome.
- `kernel`: the compiled loop over events. `state`: the record of a contact, and its energies. `record`: types that the
  kernel shares with Python.
- `in_time`: the same graphs for contact laws over time, whose contacts have a depth, such as a spring with a dashpot.

This package takes four things from `model.chain`: power series (`chain.series`), the certified first root of a
polynomial (`chain.roots`), the turning points of a rate (`chain.grazing`), and the shares of energy below which a
contact is treated as rigid (`chain.rigid`).
"""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from impact_xval.model.graph.collision import (
        BodyContact,
        GraphCollision,
        Plane,
        touching_balls,
    )
    from impact_xval.model.graph.collision_outcome import GraphCollisionOutcome
    from impact_xval.model.graph.named import GRAPHS, bernoulli, box, bridge, corner, graph_of_balls, rack
    from impact_xval.model.graph.outcome import ContactEvent, GraphOutcome, GraphOutcomes
    from impact_xval.model.graph.solving import solve_graph, solve_graph_collision, solve_graphs

__all__ = [
    "GRAPHS",
    "BodyContact",
    "ContactEvent",
    "GraphCollision",
    "GraphCollisionOutcome",
    "GraphOutcome",
    "GraphOutcomes",
    "Plane",
    "bernoulli",
    "box",
    "bridge",
    "corner",
    "graph_of_balls",
    "rack",
    "solve_graph",
    "solve_graph_collision",
    "solve_graphs",
    "touching_balls",
]

#: Names in `__all__`, by the module that defines them. A module is imported when one of its names is first used,
#: because importing the compiler takes a while.
_MODULES = {
    "collision": ("BodyContact", "GraphCollision", "Plane", "touching_balls"),
    "collision_outcome": ("GraphCollisionOutcome",),
    "named": ("GRAPHS", "bernoulli", "box", "bridge", "corner", "graph_of_balls", "rack"),
    "outcome": ("ContactEvent", "GraphOutcome", "GraphOutcomes"),
    "solving": ("solve_graph", "solve_graph_collision", "solve_graphs"),
}


def __getattr__(name: str) -> object:
    for module, names in _MODULES.items():
        if name in names:
            return getattr(import_module(f"{__name__}.{module}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
