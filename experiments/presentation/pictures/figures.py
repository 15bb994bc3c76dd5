"""Figures of a run, drawn from its tables, each with a caption that can be read without other text.

The figures need the folder and the `Summary` of a finished run. `report` calls this module.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from matplotlib.figure import Figure

from impact_xval.compliant_baselines.registry import is_engine
from impact_xval.experiments.measures.aggregates import FULL_PATHS
from impact_xval.experiments.measures.summary import Summary, load_divergence
from impact_xval.experiments.presentation.pictures.curves import draw_cell_curves, draw_chain_figures
from impact_xval.experiments.presentation.pictures.ladders import draw_ladders, draw_trust, make_trust_maps
from impact_xval.experiments.presentation.style import (
    LEFT_OUT,
    Drawn,
    draw_legend_beside,
    label_axis_values,
    save_figures,
    styled_figure,
)
from impact_xval.experiments.presentation.words import describe_shared_laws, display_name, look_of
from impact_xval.experiments.sweep.curves import CURVES
from impact_xval.experiments.tables.folder import RunFolder
from impact_xval.experiments.tables.frames import AxisValue, Frame, Record
from impact_xval.experiments.tables.numbers import number

#: Smallest D on logarithmic axes, about as large as the rounding errors of the solvers. A smaller D is drawn at this
#: value.
_FLOOR = 1e-6

#: Largest error of a velocity, per |v0|, that a recommended time step may cause.
ACCEPTED = 0.01

_D = "velocity_divergence"
_LABELS = {
    _D: "velocity divergence D (-)",
    FULL_PATHS: "share of cells with the model's states (-)",
}
_SIDE = "The solvers are drawn side by side."
_MEDIANS = (
    f"Markers are medians over all other axes, and bars reach from the 5th to the 95th percentile. {_SIDE}"
)

#: Labels of the axes of the figures, by name of the axis.
_AXIS_LABELS = {
    "balls": "number of balls N",
    "stiffness_ratio": "stiffness ratio k2/k1 (-)",
    "angle": "angle (degrees)",
    "e": "restitution e of every contact (-)",
}

#: Names of the figures of graphs, by the axis over which the figure is drawn.
_FIGURES_OF_GRAPHS = {
    "stiffness_ratio": "divergence-by-stiffness",
    "angle": "divergence-by-angle",
    "e": "divergence-by-restitution",
}

#: Captions of the figures over one axis, by measure.
_CAPTIONS = {
    _D: "Velocity divergence D between each solver and the model, over {over}. "
    f"{_MEDIANS} D = sqrt(sum m_i dv_i^2/sum m_i v_i0^2) has no unit. Values below {number(_FLOOR)} are drawn at "
    f"{number(_FLOOR)}. {LEFT_OUT} {{votes}}",
    FULL_PATHS: "Share of cells in which a solver has the same sequence of contact states as the model, over {over}. "
    "The states are S1 (both contacts active), S2 (ball on table), S3 (ball on ball) and S4 (none). Only cells count "
    "that the model solves without a closed form (closed forms end limiting cases, such as e = 0). "
    f"{_SIDE} {LEFT_OUT}",
}


def write_figures(folder: RunFolder, summary: Summary) -> dict[str, str]:
    """Draw every figure of a finished run into its folder ``figures``, and return the captions by name."""
    target = folder.root / "figures"
    target.mkdir(exist_ok=True)
    return save_figures(_draw_figures(folder, summary), target)


def _draw_figures(folder: RunFolder, summary: Summary) -> Iterator[Drawn]:
    """Draw the figures of a run; figures that would be empty are left out."""
    config, pair = summary.config, summary.config.kind == "pair"
    # If the folder is damaged, this raises an error before anything is drawn.
    curves = folder.read_table(CURVES).to_pandas()
    if config.kind == "graph":
        yield from _draw_graphs(folder, summary)
        return
    if pair:
        measures = {_D: "divergence-by-stiffness", FULL_PATHS: "state-paths"}
        axis, over = "stiffness_ratio", "the stiffness ratio k2/k1"
    else:
        measures = {_D: "divergence-by-balls"}
        axis, over = "balls", "the number of balls N, with one panel per arrangement"
    table = load_divergence(folder, config)
    rows, values = table.frame(tuple(measures)), sorted(table.levels[axis].values)
    panels = {"": (rows, values)}
    if not pair:
        by_arrangement = rows.groupby("arrangement", observed=True, sort=False)
        panels = {name: (some, [n for n in values if n in set(some.balls)]) for name, some in by_arrangement}
    solvers = [name for name in summary.solvers if name in set(rows.solver)]
    for measure, name in measures.items() if solvers else ():
        figure = _draw_over_axis(panels, solvers, axis, measure)
        yield name, figure, _CAPTIONS[measure].format(over=over, votes=describe_shared_laws(solvers)).strip()
    yield from draw_trust(make_trust_maps(folder, config) if pair else None)
    yield from draw_ladders(summary.ladder)
    yield from draw_steps(summary)
    yield from (draw_cell_curves if pair else draw_chain_figures)(curves, config)


def _draw_graphs(folder: RunFolder, summary: Summary) -> Iterator[Drawn]:
    """Draw D over every axis on which a graph has several values, with one panel per graph."""
    table = load_divergence(folder, summary.config)
    rows = table.frame((_D,))
    solvers = [name for name in summary.solvers if name in set(rows.solver)]
    for axis, name in _FIGURES_OF_GRAPHS.items() if solvers else ():
        panels: dict[str, tuple[Frame, Sequence[AxisValue]]] = {}
        for graph, some in rows.groupby("graph", observed=True, sort=False):
            values = [value for value in sorted(table.levels[axis].values) if value in set(some[axis])]
            if len(values) > 1:
                panels[str(graph)] = some, values
        if panels:
            figure = _draw_over_axis(panels, solvers, axis, _D)
            over = f"{_AXIS_LABELS[axis].removesuffix(' (-)')}, with one panel per graph"
            yield name, figure, _CAPTIONS[_D].format(over=over, votes=describe_shared_laws(solvers)).strip()


def _draw_over_axis(
    panels: Mapping[str, tuple[Frame, Sequence[AxisValue]]],
    solvers: Sequence[str],
    axis: str,
    measure: str,
) -> Figure:
    """Draw a measure over an axis: its median with the 5th to 95th percentile, or its mean if it is a share.

    `panels` has, for each panel by its title, the rows that the panel shows and their values on the axis.
    """
    with styled_figure(2.6 * len(panels) + 3.6, 3.2) as figure:
        axes = figure.subplots(1, len(panels), sharey=True, squeeze=False)[0]
        for ax, (title, (rows, values)) in zip(axes, panels.items(), strict=True):
            label_axis_values(ax.xaxis, values, 8)
            ax.set(xlabel=_AXIS_LABELS[axis], title=title)
            for position, solver in enumerate(solvers):
                style = look_of(solver)
                at = np.arange(len(values)) + 0.6 * ((position + 0.5) / len(solvers) - 0.5)
                grouped = rows[rows.solver == solver].groupby(axis)[measure]
                if measure == FULL_PATHS:
                    middle = grouped.mean().reindex(values)
                else:
                    ends = (grouped.quantile(q).reindex(values) for q in (0.05, 0.5, 0.95))
                    low, middle, high = (quantiles.clip(lower=_FLOOR) for quantiles in ends)
                    ax.vlines(at, low, high, color=style.color, linewidth=1.4, alpha=0.5)
                line = {"marker": style.marker, "linestyle": style.dash, "color": style.color}
                ax.plot(at, middle, linewidth=1, label=display_name(solver), **line)
        axes[0].set_ylabel(_LABELS[measure])
        if measure == _D:
            axes[0].set_yscale("log")  # all panels share this axis
        else:
            axes[0].set_ylim(-0.03, 1.03)
        draw_legend_beside(axes[-1])
    return figure


def recommended_steps(summary: Summary) -> list[Record]:
    """Return the error estimates of engines, each with a time step that is short enough, under the key ``enough``.

    ``enough`` is the largest time step, in periods of the faster contact, with which the error of an engine is at most
    `ACCEPTED` in 95 % of the cells. This step is extrapolated from the step of the run by the measured order of the
    error.
    """
    rows = summary.estimates.to_dict("records") if summary.config.kind == "pair" else []
    return [
        row | {"enough": summary.config.step_fraction * (ACCEPTED / row["step_p95"]) ** (1 / row["order"])}
        for row in rows
        if is_engine(row["solver"]) and row["step_p95"] > 0 and row["order"] > 0
    ]


def draw_steps(summary: Summary) -> Iterator[Drawn]:
    """Draw the error of a velocity over the time step; nothing if no engine has an error estimate."""
    engines, f = recommended_steps(summary), summary.config.step_fraction
    if not engines:
        return
    with styled_figure(6.2, 3.2) as figure:
        ax = figure.subplots()
        for row in engines:
            style, h = look_of(row["solver"]), np.geomspace(f, max(4 * f, min(0.1, 1.5 * row["enough"])), 20)
            for cut, width, label in (("median", 0.9, None), ("p95", 1.8, display_name(row["solver"]))):
                error = row[f"step_{cut}"]
                ax.plot(f, error, color=style.color, marker=style.marker)
                steps_error = error * (h / f) ** row["order"]
                ax.plot(h, steps_error, color=style.color, linestyle="--", linewidth=width, label=label)
        ax.axhline(ACCEPTED, color="0.4", linewidth=1)
        ax.set(xscale="log", yscale="log")
        ax.set(xlabel="step / period of the faster contact (-)", ylabel="error of a velocity / |v0| (-)")
        draw_legend_beside(ax)
    yield (
        "error-by-step",
        figure,
        "Error of a final velocity that the time step of an engine causes, per |v0|, over the time step. Markers show "
        "the median (thin line) and the 95th percentile (thick line) over the cells, at the time step of this run. "
        "Dashed lines extrapolate these errors by the order of the error measured in this run. The grey line is at "
        f"{100 * ACCEPTED:.0f} %.",
    )
