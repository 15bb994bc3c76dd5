"""One column of balls: its final velocities, and the wave through it, by every solver."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.figure import Figure

from impact_xval.experiments.config.experiment import Config
from impact_xval.experiments.measures.aggregates import Frame
from impact_xval.experiments.measures.laws import in_order_of_laws
from impact_xval.experiments.presentation.looks import look
from impact_xval.experiments.presentation.pictures.history import TAIL, passed_at
from impact_xval.experiments.presentation.style import BESIDE, Drawn, drawing
from impact_xval.experiments.presentation.words import arranged, named
from impact_xval.experiments.tables.numbers import number

#: Most panels of the wave in a row.
_ACROSS = 4


def draw_column(curves: Frame, config: Config) -> Iterator[Drawn]:
    """Draw the final velocities and the forces of the column of the figures, of the solvers that have them."""
    by_solver, followed = curves.set_index("solver").velocities.dropna(), curves[curves.time.notna()]
    if len(by_solver):
        solvers = in_order_of_laws(by_solver.index)
        said = "Final velocities of one column, ball by ball and solver beside solver, per |v0|, up is positive: "
        said += f"{arranged(config.figure_column)}."
        yield "velocities", velocities_figure({name: by_solver[name] for name in solvers}), said
    if len(followed):
        said = (
            "The wave through one column: force of each contact over time since first touch, per m1 "
            "|v0| and the unit of time (m1/k1 |v0|^(1 - p))^(1/(p + 1)), by the solvers that follow it "
            f"({arranged(config.figure_column)}). Contact 1 is between balls 1 and 2; the model's time "
            "is that of positions that stay frozen, forces of engines are means over their steps. The "
            f"time axis ends where all but {number(TAIL)} of the impulses have passed, by every solver."
        )
        yield "wave", _wave(followed, config), said


def velocities_figure(drawn: Mapping[str, Sequence[float]]) -> Figure:
    """Draw the final velocities of one column per |v0|, solver beside solver."""
    balls = np.arange(1, 1 + len(next(iter(drawn.values()))))
    with drawing(max(5.0, min(12.0, 1.0 + 0.9 * len(balls))) + 1.6, 3.2) as figure:
        ax = figure.subplots()
        ax.axhline(0, color="black", linewidth=0.8)
        width = 0.8 / len(drawn)
        for position, (name, velocities) in enumerate(drawn.items()):
            place = balls + width * (position + 0.5 - 0.5 * len(drawn))
            ax.bar(place, velocities, width, color=look(name).color, label=named(name))
        step = max(1, len(balls) // 20)
        ax.set(xticks=balls[::step], xlabel="ball, 1 at the top", ylabel="final velocity / |v0| (-)")
        ax.grid(axis="x", visible=False)
        ax.legend(**BESIDE)
    return figure


def _wave(curves: Frame, config: Config) -> Figure:
    """Draw the force of every contact of one column over time, a panel a solver."""
    rows = curves.to_dict("records")
    across = len(rows) if len(rows) <= _ACROSS else -(-len(rows) // 2)
    down = -(-len(rows) // across)
    with drawing(3.0 * across + 1.2, 0.5 + 2.7 * down) as figure:
        grid = figure.subplots(down, across, sharey=True, sharex=True, squeeze=False)
        axes = grid.ravel()[: len(rows)]
        for ax in grid.ravel()[len(rows) :]:
            ax.set_visible(False)
        for place, (ax, row) in enumerate(zip(axes, rows, strict=True)):
            for contact, forces in enumerate(row["forces"], start=1):
                shade = colormaps["viridis"](0.92 * (contact - 1) / max(1, len(row["forces"]) - 1))
                ax.plot(row["time"], forces, color=shade, label=f"contact {contact}", linewidth=1.2)
            if place + across >= len(rows):  # nothing below it
                ax.set_xlabel("time / sqrt(m1/k1) (-)" if config.figure_column.exponent == 1 else "time (-)")
                ax.tick_params(labelbottom=True)
            ax.set_title(named(row["solver"]))
        for ax in grid[:, 0]:
            ax.set_ylabel("contact force (-)")
        axes[0].set_xlim(0, 1.05 * max(map(shown_until, rows)))  # shared
        if len(rows[0]["forces"]) <= 12:
            figure.legend(*axes[0].get_legend_handles_labels(), loc="outside right center")
    return figure


def shown_until(row: dict[Any, Any]) -> float:
    """When all impulses of a column but `TAIL` of their sum have passed."""
    time, total = row["time"], np.sum(np.stack(row["forces"]), axis=0)
    return passed_at(time, np.append(0, np.cumsum(np.diff(time) * 0.5 * (total[1:] + total[:-1]))))
