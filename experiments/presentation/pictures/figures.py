"""The figures of a run, drawn from its stored tables, each with a caption that stands alone."""

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

#: Least D on logarithmic axes, about the rounding of the solvers; smaller D are drawn there.
_FLOOR = 1e-6

#: Error of a velocity, per |v0|, that a recommended step may have.
ACCEPTED = 0.01

_D = "velocity_divergence"
_LABELS = {
    _D: "velocity divergence D (-)",
    FULL_PATHS: "share of cells with the model's path (-)",
}
_SIDE = "solvers stand side by side."
_MEDIANS = f"Markers: medians over all other axes; bars: 5th to 95th percentile; {_SIDE}"

#: Labels of the axes of the figures.
_AXIS_LABELS = {
    "balls": "number of balls N",
    "stiffness_ratio": "stiffness ratio k2/k1 (-)",
    "angle": "angle (degrees)",
    "e": "restitution e of every contact (-)",
}

#: Figures of graphs by the axis that they are drawn over.
_FIGURES_OF_GRAPHS = {
    "stiffness_ratio": "divergence-by-stiffness",
    "angle": "divergence-by-angle",
    "e": "divergence-by-restitution",
}

#: Captions of the figures over k2/k1, or for chains over the number of balls.
_CAPTIONS = {
    _D: "Velocity divergence D of each solver from the model over {over}. "
    f"{_MEDIANS} D = sqrt(sum m_i dv_i^2/sum m_i v_i0^2), dimensionless; values below {number(_FLOOR)} are drawn "
    f"there. {LEFT_OUT} {{votes}}",
    FULL_PATHS: "Share of cells in which a solver passes through the same contact states (S1 both contacts active, S2 "
    "ball on table, S3 ball on ball, S4 none) as the model, over {over}, of the cells in which the model needed no "
    f"limiting case; {_SIDE} {LEFT_OUT}",
}


def write_figures(folder: RunFolder, summary: Summary) -> dict[str, str]:
    """Draw every figure of a finished run into ``figures/``; return their captions by name, as in ``captions.json``."""
    target = folder.root / "figures"
    target.mkdir(exist_ok=True)
    return save_figures(_draw_figures(folder, summary), target)


def _draw_figures(folder: RunFolder, summary: Summary) -> Iterator[Drawn]:
    """Draw the figures of a run that have something to show."""
    config, pair = summary.config, summary.config.kind == "pair"
    curves = folder.read_table(CURVES).to_pandas()  # of a damaged folder nothing is drawn
    if config.kind == "graph":
        yield from _draw_graphs(folder, summary)
        return
    if pair:
        measures = {_D: "divergence-by-stiffness", FULL_PATHS: "state-paths"}
        axis, over = "stiffness_ratio", "the stiffness ratio k2/k1"
    else:
        measures = {_D: "divergence-by-balls"}
        axis, over = "balls", "the number of balls N, a panel an arrangement"
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
    """Draw D over each axis that has several values in some graph, a panel a graph; over e all graphs."""
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
            over = f"{_AXIS_LABELS[axis].removesuffix(' (-)')}, a panel a graph"
            yield name, figure, _CAPTIONS[_D].format(over=over, votes=describe_shared_laws(solvers)).strip()


def _draw_over_axis(
    panels: Mapping[str, tuple[Frame, Sequence[AxisValue]]],
    solvers: Sequence[str],
    axis: str,
    measure: str,
) -> Figure:
    """Draw the median of a measure over an axis with its 5th to 95th percentile, or a share.

    `panels` has by title the rows of a panel, and the values of the axis.
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
            axes[0].set_yscale("log")  # shared
        else:
            axes[0].set_ylim(-0.03, 1.03)
        draw_legend_beside(axes[-1])
    return figure


def recommended_steps(summary: Summary) -> list[Record]:
    """Return the estimates of engines, and as `enough` the step with an error of `ACCEPTED` in 95 % of cells.

    The step is over the faster contact period, and extrapolated from the step of the run by the measured order.
    """
    rows = summary.estimates.to_dict("records") if summary.config.kind == "pair" else []
    return [
        row | {"enough": summary.config.step_fraction * (ACCEPTED / row["step_p95"]) ** (1 / row["order"])}
        for row in rows
        if is_engine(row["solver"]) and row["step_p95"] > 0 and row["order"] > 0
    ]


def draw_steps(summary: Summary) -> Iterator[Drawn]:
    """Draw the error over the step; nothing if no engine has a limit."""
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
        "Error that an engine's step makes in a final velocity, per |v0|, over the step. Markers: median (thin) "
        "and 95th percentile (thick) over the cells at the step of this run; dashed: extrapolated by the order "
        f"measured in this run. Grey: {100 * ACCEPTED:.0f} %.",
    )
