"""The figures of a run of columns, drawn from its stored tables: name, figure and caption of each."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.figure import Figure

from impact_xval.experiments.config.experiment import REFERENCE, Config
from impact_xval.experiments.measures.aggregates import Frame
from impact_xval.experiments.measures.laws import in_order_of_laws
from impact_xval.experiments.measures.summary import Summary
from impact_xval.experiments.presentation.ladder_figures import draw_ladders
from impact_xval.experiments.presentation.looks import look
from impact_xval.experiments.presentation.pages import phrase
from impact_xval.experiments.presentation.style import drawing
from impact_xval.experiments.sweep.curves import CURVES
from impact_xval.experiments.tables.folder import RunFolder

#: Most panels of the wave in a row.
_ACROSS = 4

#: Share of the impulses of a column that may pass beyond the end of the time axis.
_TAIL = 1e-3

#: D below this is drawn at this height: about the rounding of the solvers.
_FLOOR = 1e-6


def draw_columns(folder: RunFolder, summary: Summary) -> Iterator[tuple[str, Figure, str]]:
    """Draw every figure of a finished run of columns; one that has nothing to show is left out."""
    curves = folder.read_table(CURVES).to_pandas()
    config, rows = summary.config, folder.read_table("divergence.parquet").to_pandas()
    rows = rows[rows.velocity_divergence.notna() & rows.marked.isna()]
    solvers = [name for name in summary.solvers if name in set(rows.solver)]
    facts = {
        "model": REFERENCE,
        "floor": _FLOOR,
        "solvers": solvers,
        "column": config.figure_column,
        "tail": _TAIL,
    }
    if solvers:
        yield (
            "divergence-by-balls",
            _by_balls(rows, solvers, "velocity_divergence"),
            _caption("by_balls", facts),
        )
        yield (
            "energy-by-balls",
            _by_balls(rows, solvers, "dretained_energy"),
            _caption("energy_by_balls", facts),
        )
    moved = curves[curves.velocities.notna()]
    if len(moved):
        shown = in_order_of_laws(moved.solver)
        yield "velocities", draw_velocities(moved, shown), _caption("velocities", facts | {"solvers": shown})
    yield from draw_ladders(summary.ladder)
    followed = curves[curves.time.notna()]
    if len(followed):
        yield "wave", _wave(followed, config), _caption("wave", facts)


def _caption(figure: str, facts: dict[str, Any]) -> str:
    return phrase("captions_columns.md.j2", figure, facts)


def _by_balls(rows: Frame, solvers: list[str], measure: str) -> Figure:
    """Draw the median of a measure over the number of balls, a panel an arrangement."""
    arrangements = list(dict.fromkeys(rows.arrangement))
    with drawing(3.3 * len(arrangements) + 1.7, 3.3) as figure:
        axes = figure.subplots(1, len(arrangements), sharey=True, squeeze=False)[0]
        for ax, arrangement in zip(axes, arrangements, strict=True):
            some = rows[rows.arrangement == arrangement]
            balls = sorted(some.balls.unique())
            for position, name in enumerate(solvers):
                style = look(name, position)
                grouped = some[some.solver == name].groupby("balls")[measure]
                low, median, high = (grouped.quantile(q).reindex(balls) for q in (0.05, 0.5, 0.95))
                # Side by side: solvers of one law would hide one another.
                x = np.arange(len(balls)) + 0.5 * ((position + 0.5) / len(solvers) - 0.5)
                if measure == "velocity_divergence":
                    low, median, high = (values.clip(lower=_FLOOR) for values in (low, median, high))
                ax.vlines(x, low, high, color=style.color, linewidth=1.4, alpha=0.5)
                ax.plot(x, median, color=style.color, marker=style.marker, linestyle=style.dash, label=name)
            ax.set_xticks(range(len(balls)), [f"{n:g}" for n in balls])
            ax.set_xlabel("number of balls N")
            ax.set_title(arrangement)
        axes[0].set_ylabel("retained energy, solver minus model (-)")
        if measure == "velocity_divergence":
            axes[0].set_ylabel("velocity divergence D (-)")
            axes[0].set_yscale("log")  # shared
        axes[-1].legend(loc="center left", bbox_to_anchor=(1.01, 0.5))
    return figure


def draw_velocities(curves: Frame, solvers: list[str]) -> Figure:
    """Draw the final velocities of one column, solver beside solver."""
    by_solver = curves.set_index("solver").velocities
    balls = np.arange(1, 1 + len(by_solver.iloc[0]))
    with drawing(max(5.0, min(12.0, 1.0 + 0.9 * len(balls))) + 1.6, 3.2) as figure:
        ax = figure.subplots()
        ax.axhline(0, color="black", linewidth=0.8)
        width = 0.8 / len(solvers)
        for position, name in enumerate(solvers):
            place = balls + width * (position + 0.5 - 0.5 * len(solvers))
            ax.bar(place, by_solver[name], width, color=look(name, position).color, label=name)
        step = max(1, len(balls) // 20)
        ax.set_xticks(balls[::step])
        ax.set_xlabel("ball, 1 at the top")
        ax.set_ylabel("final velocity / |v0| (-)")
        ax.grid(axis="x", visible=False)
        ax.legend(loc="center left", bbox_to_anchor=(1.01, 0.5))
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
            ax.set_title(row["solver"])
        for ax in grid[:, 0]:
            ax.set_ylabel("contact force (-)")
        axes[0].set_xlim(0, 1.05 * max(map(shown_until, rows)))  # shared
        if len(rows[0]["forces"]) <= 12:
            figure.legend(*axes[0].get_legend_handles_labels(), loc="outside right center")
    return figure


def shown_until(row: dict[Any, Any]) -> float:
    """When all impulses but `_TAIL` of their sum have passed: balls may meet again long after."""
    time, total = row["time"], np.sum(np.stack(row["forces"]), axis=0)
    passed = np.cumsum(np.diff(time) * 0.5 * (total[1:] + total[:-1]))
    return float(time[1 + np.searchsorted(passed, (1 - _TAIL) * passed[-1])])
