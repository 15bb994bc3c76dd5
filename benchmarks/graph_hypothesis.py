"""Test on contact graphs whether an infinitely stiff contact makes its two bodies one, by the model.

Run as ``python -m benchmarks.graph_hypothesis``. One contact of a graph becomes stiffer than the others by a contrast
of 10 to 1e8. Its outcomes are compared with the outcome of the *welded* graph, in which the contact is a constraint:
w_i = 0 from the first touch on, by a push or a pull. With the impulses I of the other contacts

```text
I_i = (w_i - sum_j W_ij I_j)/W_ii     W'_jl = W_jl - W_ji W_il/W_ii     w'_j = w_j - W_ji w_i/W_ii
```

so that the welded graph has C - 1 contacts, with the Schur complement of W. The two welded bodies share the momentum of
both; if one of them is fixed, both are at rest. The series is judged by the rule of `experiments.hypothesis.judging`. D
is the kinetic norm of the difference of all velocities, over the kinetic norm of the velocities at first touch.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from rich.console import Console
from rich.table import Table

from impact_xval.experiments.hypothesis.chains import ERROR
from impact_xval.experiments.hypothesis.judging import Approach, Verdict, judge_approach
from impact_xval.model.arrays import Floats
from impact_xval.model.graph import (
    GraphCollision,
    bernoulli,
    bridge,
    corner,
    rack,
    solve_graph,
    solve_graph_collision,
)

RESTITUTIONS = (1.0, 0.9, 0.7, 0.5)
CONTRASTS = np.geomspace(10, 1e8, 29)

#: Decades of contrast that a verdict is based on.
DECADES = 3.0

#: Fraction of W_jj below which W'_jj is rounding: contact j is then welded too.
_WELDED = 1e-12


class WeldedVerdict(NamedTuple):
    """Verdict on one contact of a graph."""

    graph: str
    #: Number of the contact, from 1, and its bodies; None is a fixed body.
    contact: int
    bodies: tuple[int, int | None]
    #: True if the contact's bodies approach at first.
    struck: bool
    e: float
    verdict: Verdict
    #: D from the welded graph at the first, the middle and the last contrast.
    distances: tuple[float, float, float]
    #: Final speed of separation of the two bodies in m/s, at the last contrast.
    parting: float


def graphs(e: float) -> dict[str, GraphCollision]:
    """Return the graphs of the test, in which all contacts restore e."""
    return {
        "bernoulli, 45 degrees": bernoulli(45, restitution=e),
        "bernoulli, 30 degrees": bernoulli(30, restitution=e),
        "corner, 60 degrees": corner(60, restitutions=(e, e)),
        "corner, 90 degrees": corner(90, restitutions=(e, e)),
        "corner, 120 degrees": corner(120, restitutions=(e, e)),
        "bridge, 45 degrees": bridge(45, restitutions=(e, e)),
        "bridge, 30 degrees": bridge(30, restitutions=(e, e)),
        "rack of 3": rack(3, restitution=e),
    }


def stiffen(graph: GraphCollision, contact: int, contrast: float) -> GraphCollision:
    """Return the graph with one contact, from 0, stiffer by a factor."""
    contacts = list(graph.contacts)
    contacts[contact] = replace(contacts[contact], stiffness=contrast * contacts[contact].stiffness)
    return replace(graph, contacts=contacts)


def welded_velocities(graph: GraphCollision, contact: int) -> Floats:
    """Return the final velocities in m/s, shape (B, 2), where one contact, from 0, is a constraint."""
    W, w, i = graph.delassus, graph.rates, contact
    schur = W - np.outer(W[:, i], W[i]) / W[i, i]
    rates = w - W[:, i] * w[i] / W[i, i]
    others = [j for j in range(len(w)) if j != i and schur[j, j] > _WELDED * W[j, j]]
    impulses = np.zeros(len(w))
    # Rounding must not make bodies approach that the weld gives the same velocity.
    rates[np.abs(rates) <= 2.0**-48 * np.abs(w).max()] = 0.0
    if (rates[others] > 0).any():
        kept = [graph.contacts[j] for j in others]
        outcome = solve_graph(
            schur[np.ix_(others, others)],
            [each.stiffness for each in kept],
            [each.restitution for each in kept],
            rates[others],
        )
        impulses[others] = outcome.impulses
    impulses[i] = (w[i] - W[i] @ impulses) / W[i, i]
    return graph.after(impulses.tolist())[0]


def judge_contact(name: str, graph: GraphCollision, contact: int, e: float) -> WeldedVerdict:
    """Judge whether the outcomes of a graph approach the welded one as a contact, from 0, becomes stiff."""
    outcomes = [solve_graph_collision(stiffen(graph, contact, contrast)) for contrast in CONTRASTS]
    velocities = np.array([np.ravel(outcome.velocities) for outcome in outcomes])
    form = welded_velocities(graph, contact).ravel()
    dimension = len(graph.velocities[0])
    masses = np.repeat(graph.masses, dimension)
    weights = masses / np.dot(masses, np.square(np.ravel(graph.velocities)))
    used = np.array([outcome.has_result and not outcome.mark for outcome in outcomes])
    approach = Approach(CONTRASTS, used, velocities, np.full(len(used), ERROR), form, weights, DECADES)
    D = np.sqrt(((velocities - form) ** 2) @ weights)
    struck = bool(graph.rates[contact] > 0)
    ends = (float(D[0]), float(D[len(D) // 2]), float(D[-1]))
    bodies = graph.contacts[contact].bodies
    parting = -outcomes[-1].rates[contact]
    return WeldedVerdict(name, contact + 1, bodies, struck, e, judge_approach(approach), ends, parting)


def all_verdicts() -> Iterator[WeldedVerdict]:
    """Judge every contact of every graph; of two contacts that are mirror images, only the first."""
    mirrored = {"bridge, 45 degrees": (1, 3), "bridge, 30 degrees": (1, 4), "rack of 3": (2,)}
    mirrored |= {"bernoulli, 45 degrees": (1,), "bernoulli, 30 degrees": (1,)}
    for e in RESTITUTIONS:
        for name, graph in graphs(e).items():
            for contact in range(len(graph.contacts)):
                if contact not in mirrored.get(name, ()):
                    yield judge_contact(name, graph, contact, e)


def main() -> None:
    """Judge every contact of every graph, and print a table of the verdicts."""
    ends = (CONTRASTS[0], CONTRASTS[len(CONTRASTS) // 2], CONTRASTS[-1])
    header = ["graph", "contact", "bodies", "at first", "e", "verdict", "order", "D of the limit", "parts at"]
    table = Table(*header, *(f"D at {x:.0e}" for x in ends), box=None)
    for row in sorted(all_verdicts(), key=lambda each: (each.graph, each.contact, -each.e)):
        first, second = row.bodies
        bodies = f"{first} and {'fixed' if second is None else second}"
        v = row.verdict
        order = f"{v.rate:.2f}" if v.verdict == "supported" else "-"
        numbers = (order, f"{v.offset:.3g}", f"{row.parting:.2g}", *(f"{d:.2g}" for d in row.distances))
        start = "struck" if row.struck else "at rest"
        table.add_row(row.graph, str(row.contact), bodies, start, f"{row.e:g}", v.verdict, *numbers)
        if v.verdict not in ("supported", "refuted"):
            table.add_row("", "", "", "", "", v.reason)
    Console(width=160).print(table)


if __name__ == "__main__":
    main()
