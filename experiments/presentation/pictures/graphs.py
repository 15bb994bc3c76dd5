"""Figure of one contact graph: bodies, contact normals, and velocities before and after, with one panel per solver.

The figure needs a graph in the plane and its outcomes. The option ``--plot`` of `solve --graph` calls this module.

A graph has no positions. Bodies are therefore drawn along the normals of their contacts, as balls of equal radius that
touch. A body whose contacts have arms (points of contact away from its centre) is drawn as the box of its arms.
"""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Rectangle

from impact_xval.experiments.presentation.style import styled_figure
from impact_xval.model.arrays import Floats
from impact_xval.model.graph.collision import GraphCollision
from impact_xval.model.graph.collision_outcome import GraphCollisionOutcome

#: Radius of a ball, and length of the longest arrow, in units of the figure.
_RADIUS, _LONGEST = 0.5, 0.9

#: Largest number of panels in a row, and width of a panel in inches.
_ACROSS, _WIDTH = 4, 2.6


def draw_graph(
    collision: GraphCollision, outcomes: Mapping[str, GraphCollisionOutcome], caption: str
) -> Figure:
    """Draw a graph in the plane (x, z), with one panel per outcome. The keys of `outcomes` are titles of panels."""
    if len(collision.velocities[0]) != 2:
        raise ValueError("bodies move in space; legal: a graph in the plane")
    sizes = _half_sizes(collision)
    places = _lay_out(collision, sizes)
    speeds = [
        np.hypot(*np.array(v).T).max()
        for v in (collision.velocities, *(o.velocities for o in outcomes.values()))
    ]
    fastest = max(speeds)
    reach = np.array(sizes).max() + 0.7 * _LONGEST
    low, high = places.min(axis=0) - reach, places.max(axis=0) + reach
    across = min(_ACROSS, len(outcomes))
    down = -(-len(outcomes) // across)
    shape = float((high - low)[1] / (high - low)[0])
    height = _WIDTH * min(max(shape, 0.5), 1.6)
    lines = textwrap.wrap(caption, max(50, int(17 * across * _WIDTH)))
    with styled_figure(max(4.2, across * _WIDTH), down * (height + 0.35) + 0.6 + 0.17 * len(lines)) as figure:
        axes = figure.subplots(down, across, squeeze=False, sharex=True, sharey=True).ravel()
        for ax in axes[len(outcomes) :]:
            ax.set_visible(False)
        for place, (ax, (title, outcome)) in enumerate(zip(axes, outcomes.items(), strict=False)):
            _draw_bodies(ax, collision, places, sizes)
            scale = _LONGEST / fastest
            _draw_arrows(ax, places, np.array(collision.velocities) * scale, "0.65")
            color = colormaps["tab10"](place % 10)
            key = _draw_arrows(ax, places, np.array(outcome.velocities) * scale, color)
            for body, turning in enumerate(outcome.angular_velocities):
                ax.annotate(f"ω = {turning[0]:.4g} rad/s", places[body], (0, -14), textcoords="offset points",
                            ha="center", fontsize=7)  # fmt: skip
            if place == 0:
                unit = float(f"{fastest:.1g}")
                ax.quiverkey(key, 0.18, 0.95, unit * scale, f"{unit:g} m/s", labelpos="E", color="0.3")
            ax.set_title(title, fontsize=8)
            ax.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal", xticks=[], yticks=[])
            ax.grid(visible=False)
            ax.set(xlabel="x (to the right)" if place + across >= len(outcomes) else "")
            ax.set(ylabel="z (up)" if place % across == 0 else "")
        figure.supxlabel("\n".join(lines), fontsize=8, x=0.02, ha="left")
    return figure


def _half_sizes(collision: GraphCollision) -> list[Floats]:
    """Return half the width and half the height of each body, in units of the figure."""
    sizes = [np.full(2, _RADIUS) for _ in collision.masses]
    for contact in collision.contacts:
        for body, arm in zip(contact.bodies, contact.arms, strict=False):
            if body is not None:
                sizes[body - 1] = np.maximum(sizes[body - 1], np.abs(arm))
    return sizes


def _lay_out(collision: GraphCollision, sizes: Sequence[Floats]) -> Floats:
    """Return centres for the B bodies of a graph, shape (B, 2), such that bodies in contact are side by side."""
    places: dict[int, Floats] = {}
    while len(places) < len(sizes):
        start = next(body for body in range(len(sizes)) if body not in places)
        places[start] = np.array([2.5 * len(places), 0.0])
        grows = True
        while grows:
            grows = False
            for contact in collision.contacts:
                first, second = contact.bodies
                if second is None:
                    continue
                a, b, apart = first - 1, second - 1, 2 * _RADIUS * np.array(contact.normal)
                if a in places and b not in places:
                    places[b], grows = places[a] - apart, True
                elif b in places and a not in places:
                    places[a], grows = places[b] + apart, True
    return np.array([places[body] for body in range(len(sizes))])


def _draw_bodies(ax: Axes, collision: GraphCollision, places: Floats, sizes: Sequence[Floats]) -> None:
    """Draw the bodies with their numbers, the walls, and the normal of every contact as a short black arrow."""
    with_arms = {
        body for contact in collision.contacts if contact.arms for body in contact.bodies if body is not None
    }
    for body, (place, size) in enumerate(zip(places, sizes, strict=True), 1):
        look = {"facecolor": "0.95", "edgecolor": "0.4", "linewidth": 0.8}
        if body in with_arms:
            ax.add_patch(Rectangle(place - size, *(2 * size), **look))
        else:
            ax.add_patch(Circle(tuple(place), _RADIUS, **look))
        ax.annotate(str(body), place, (4, -8), textcoords="offset points", fontsize=7, color="0.4")
    for contact in collision.contacts:
        first, second = contact.bodies
        normal = np.array(contact.normal)
        arm = np.array(contact.arms[0]) if contact.arms else -_RADIUS * normal
        point = places[first - 1] + arm
        if second is None:
            along = 0.8 * np.array([-normal[1], normal[0]])
            ax.plot(*np.array([point - along, point + along]).T, color="0.4", linewidth=2.0)
        ax.annotate("", point + 0.3 * normal, point, arrowprops={"arrowstyle": "->", "linewidth": 0.9})


def _draw_arrows(ax: Axes, places: Floats, vectors: Floats, color: object) -> object:
    """Draw one arrow per body from its centre. The vectors are in units of the figure."""
    return ax.quiver(
        *places.T, *vectors.T, angles="xy", scale_units="xy", scale=1, color=color, width=0.012, zorder=3
    )
