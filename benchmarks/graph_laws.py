"""Measure the distance of rigid laws from the model in Bernoulli's problem, over the stiffness ratio.

Run as ``python -m benchmarks.graph_laws``; with ``--figure`` it draws docs/figures/bernoulli-laws.svg too. A ball falls
between two equal balls at rest, 30 degrees to either side (`model.graph.bernoulli`). D is the kinetic norm of the
difference of all final velocities from the model's, over the kinetic norm of the velocities at first touch.

A rigid law has no stiffness. It has the same outcome for all ratios k2/k1, while the model's outcomes form a curve. So
somewhere along the curve D is at least half of the largest D between two points of the curve, whatever the law's
outcome is. This half is `least`.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike
from rich.console import Console
from rich.table import Table

from impact_xval.compliant_baselines.rigid.graphs import solve_rigid_graph
from impact_xval.experiments.presentation.style import draw_legend_beside, save_picture, styled_figure
from impact_xval.model.arrays import Floats
from impact_xval.model.graph import bernoulli, solve_graph_collision

#: Laws by their names in figures: the name of the law, and the order of the contacts.
RIGID_LAWS: dict[str, tuple[str, Sequence[int]]] = {
    "Newton": ("newton-restitution", (1, 2, 3)),
    "Poisson": ("poisson-restitution", (1, 2, 3)),
    "generalised reflection": ("generalised-reflection", (1, 2, 3)),
    "plastic, then restitution": ("plastic-then-restitution", (1, 2, 3)),
    "single impacts, contact 1 first": ("sequential", (1, 2, 3)),
    "single impacts, contact 2 first": ("sequential", (2, 1, 3)),
}

RESTITUTIONS = (1.0, 0.7)
RATIOS = np.geomspace(0.01, 100, 41)

#: Stiffness ratios k2/k1 of the rows of the printed table.
SHOWN = (0.01, 0.1, 0.5, 1.0, 2.0, 10.0, 100.0)

FIGURE = Path(__file__).parents[1] / "docs" / "figures" / "bernoulli-laws.svg"

_LOOKS = {
    "Newton": ("#000000", "solid"),
    "Poisson": ("#E69F00", "dashed"),
    "generalised reflection": ("#56B4E9", "dotted"),
    "plastic, then restitution": ("#009E73", "dashdot"),
    "single impacts, contact 1 first": ("#0072B2", "solid"),
    "single impacts, contact 2 first": ("#D55E00", "solid"),
}


def model_outcomes(ratios: ArrayLike, e: float) -> Floats:
    """Return the model's final velocities in m/s at each ratio k2/k1, shape (n, 3, 2)."""
    graphs = (bernoulli(stiffness_ratio=float(ratio), restitution=e) for ratio in np.ravel(ratios))
    return np.array([solve_graph_collision(graph).velocities for graph in graphs])


def rigid_outcome(law: str, e: float) -> Floats:
    """Return the final velocities in m/s by one of `RIGID_LAWS`, shape (3, 2); they depend on no stiffness."""
    name, order = RIGID_LAWS[law]
    graph = bernoulli(restitution=e)
    solved = solve_rigid_graph(name, graph.delassus, [e] * len(order), graph.rates, order=order)
    return graph.after(solved.impulses.tolist())[0]


def distance(a: Floats, b: Floats) -> Floats:
    """Return D between velocities of equal balls; the last two axes are bodies and components.

    At first touch one ball has 1 m/s, and all others are at rest.
    """
    return np.sqrt(((a - b) ** 2).sum(axis=(-2, -1)))


def least_error(outcomes: Floats) -> float:
    """Return half of the largest D between two outcomes: no single outcome is nearer to all of them."""
    return float(distance(outcomes[:, None], outcomes[None]).max()) / 2


def main() -> None:
    """Print the table of distances, and draw the figure if the options ask for it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--figure", action="store_true")
    draws = parser.parse_args().figure
    console = Console(width=150)
    found: dict[float, dict[str, Floats]] = {}
    for e in RESTITUTIONS:
        outcomes = model_outcomes(RATIOS, e)
        found[e] = {law: distance(outcomes, rigid_outcome(law, e)) for law in RIGID_LAWS}
        shown = model_outcomes(SHOWN, e)
        least = least_error(outcomes)
        title = f"D from the model, e = {e}; by any law without stiffness at least {least:.3f} somewhere"
        table = Table(
            "law", *(f"k2/k1 = {ratio:g}" for ratio in SHOWN), "least", "largest", box=None, title=title
        )
        for law, over in found[e].items():
            at = distance(shown, rigid_outcome(law, e))
            table.add_row(law, *(f"{d:.4f}" for d in at), f"{over.min():.4f}", f"{over.max():.4f}")
        nearest = np.min([*found[e].values()], axis=0)
        table.add_row("nearest law", *[""] * len(SHOWN), f"{nearest.min():.4f}", f"{nearest.max():.4f}")
        console.print(table)
        console.print(f"the nearest law is farthest at k2/k1 = {RATIOS[nearest.argmax()]:.3g}\n")
    if draws:
        draw(found)


def draw(found: dict[float, dict[str, Floats]]) -> None:
    """Draw D over the stiffness ratio, a panel for each e."""
    with styled_figure(8.6, 3.2) as figure:
        axes = figure.subplots(1, len(found), sharey=True)
        for ax, (e, by_law) in zip(axes, found.items(), strict=True):
            for law, over in by_law.items():
                color, dash = _LOOKS[law]
                ax.plot(RATIOS, over, color=color, linestyle=dash, label=law)
            ax.set(xscale="log", xlabel="stiffness ratio k2/k1 (-)", title=f"e = {e:g}")
        axes[0].set_ylabel("velocity divergence D (-)")
        axes[0].set_ylim(0, None)
        draw_legend_beside(axes[-1])
    save_picture(figure, FIGURE)


if __name__ == "__main__":
    main()
