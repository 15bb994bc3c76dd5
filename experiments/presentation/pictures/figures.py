"""The figures of a run, drawn from its stored tables, each with a caption that stands alone."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from impact_xval.experiments.config.axes import AXES
from impact_xval.experiments.measures.aggregates import FULL_PATHS, Frame
from impact_xval.experiments.measures.laws import in_order_of_laws
from impact_xval.experiments.measures.summary import Summary, load_divergence
from impact_xval.experiments.presentation.looks import look
from impact_xval.experiments.presentation.pictures.columns import draw_velocities, draw_wave
from impact_xval.experiments.presentation.pictures.curves import draw_cell_curves
from impact_xval.experiments.presentation.pictures.ladders import draw_ladders
from impact_xval.experiments.presentation.pictures.steps import draw_steps
from impact_xval.experiments.presentation.pictures.trust import draw_trust, trust_of
from impact_xval.experiments.presentation.style import drawing, save
from impact_xval.experiments.presentation.words import named, one_vote
from impact_xval.experiments.sweep.curves import CURVES, FIGURE_CELL
from impact_xval.experiments.tables.folder import RunFolder, write_json
from impact_xval.experiments.tables.numbers import number

CAPTIONS = "captions.json"

#: D below this is drawn at this height on logarithmic axes: about the rounding of the solvers.
_FLOOR = 1e-6

_LEFT_OUT = "Marked cells (beside a jump) are left out."

_MEDIANS = "Markers: medians over all other axes; bars: 5th to 95th percentile; solvers stand side by side."

#: What is drawn over k2/k1, or of columns over the number of balls: name, measure, label and the caption's beginning.
_MEASURES = (
    (
        "divergence",
        "velocity_divergence",
        "velocity divergence D (-)",
        "Velocity divergence D of each solver from the model over {over}. {medians} D = sqrt(sum m_i "
        f"dv_i^2/sum m_i v_i0^2), dimensionless; values below {number(_FLOOR)} are drawn there.",
    ),
    (
        "energy",
        "dretained_energy",
        "retained energy, solver minus model (-)",
        "Difference of the fraction of kinetic energy that is left after the collision, solver minus "
        "model, over {over}. {medians} Above zero the solver dissipates less than the model.",
    ),
)


def write_figures(folder: RunFolder, summary: Summary) -> dict[str, str]:
    """Draw every figure of a finished run into ``figures/``: their captions by name, which ``captions.json`` holds."""
    target, captions = folder.root / "figures", {}
    target.mkdir(exist_ok=True)
    draw = draw_pair if summary.config.column is None else draw_columns
    for name, figure, caption in draw(folder, summary):
        save(figure, target, name)
        captions[name] = caption
    write_json(target / CAPTIONS, captions)
    return captions


def draw_pair(folder: RunFolder, summary: Summary) -> Iterator[tuple[str, Figure, str]]:
    """Draw the figures of a run of two balls: name, figure, caption; those with nothing to show are left out."""
    curves = folder.read_table(CURVES).to_pandas()  # of a damaged folder nothing is drawn
    table = load_divergence(folder, summary.config)
    rows = table.frame(("velocity_divergence", "dretained_energy", FULL_PATHS))
    levels = {axis: sorted(levels.values) for axis, levels in table.levels.items()}
    solvers = [name for name in summary.solvers if name in set(rows.solver)]
    if solvers:
        votes, values = one_vote(solvers), levels["stiffness_ratio"]
        for name, measure, label, caption in _MEASURES:
            figure = _over(rows, solvers, "stiffness_ratio", measure, label, values)
            said = caption.format(over="the stiffness ratio k2/k1", medians=_MEDIANS)
            yield f"{name}-by-stiffness", figure, f"{said} {_LEFT_OUT} {votes}".strip()
        yield (
            "state-paths",
            _state_paths(rows, solvers, values),
            (
                "Share of cells in which a solver passes through the same contact states (S1 both contacts "
                "active, S2 ball on table, S3 ball on ball, S4 none) as the model, over the stiffness "
                "ratio k2/k1, of the cells in which the model needed no limiting case. Widths only keep "
                "overlaps visible. "
                f"{_LEFT_OUT} {votes}"
            ).strip(),
        )
        for name, across, up in (
            ("divergence-map", "stiffness_ratio", "mass_ratio"),
            ("divergence-by-restitution", "e1", "e2"),
        ):
            figure = _median_maps(rows, solvers, levels, across, up)
            rest = " and ".join(label for axis, label in AXES.items() if axis not in (across, up))
            yield (
                name,
                figure,
                (
                    f"Median over {rest} of the velocity divergence D from the model, by {AXES[across]} and "
                    f"{AXES[up]}, a panel a solver. White: nothing to compare. {_LEFT_OUT} {votes}"
                ).strip(),
            )
    yield from draw_trust(trust_of(folder, summary.config))
    yield from draw_ladders(summary.ladder)
    yield from draw_steps(summary)
    if len(first := curves[curves.curve == FIGURE_CELL]):
        cell = ", ".join(f"{label} = {number(first[axis].iloc[0])}" for axis, label in AXES.items())
        yield (
            "impulse-curves",
            draw_cell_curves(first, in_order_of_laws(summary.config.solvers)),
            (
                f"Impulse curves of one collision ({cell}): ball-table impulse I2 over ball-ball impulse "
                "I1, both per m1 |v0|. Grey lines: compression line l1 (equal velocities, v1 = v2) and l2 "
                "(lower ball at rest, I1 = I2). Markers: where each curve ends; the right panel enlarges "
                f"the ends. {one_vote(summary.config.solvers)}"
            ).strip(),
        )


def draw_columns(folder: RunFolder, summary: Summary) -> Iterator[tuple[str, Figure, str]]:
    """Draw the figures of a run of columns: name, figure, caption; those with nothing to show are left out."""
    curves = folder.read_table(CURVES).to_pandas()
    rows = folder.read_table("divergence.parquet").to_pandas()
    rows = rows[rows.velocity_divergence.notna() & rows.marked.isna()]
    solvers = [name for name in summary.solvers if name in set(rows.solver)]
    for name, measure, label, caption in _MEASURES if solvers else ():
        figure = _over(rows, solvers, "balls", measure, label, sorted(set(rows.balls)), "arrangement")
        said = caption.format(over="the number of balls N, a panel an arrangement", medians=_MEDIANS)
        yield f"{name}-by-balls", figure, f"{said} {_LEFT_OUT} {one_vote(solvers)}".strip()
    yield from draw_ladders(summary.ladder)
    yield from draw_velocities(curves, summary.config)
    yield from draw_wave(curves, summary.config)


def _axis(ax: Any, axis: str, values: Sequence[float]) -> np.ndarray:
    """Prepare an axis: k2/k1 logarithmic where 0 and infinity are not among its values, else evenly spaced values."""
    ax.set_xlabel("number of balls N" if axis == "balls" else "stiffness ratio k2/k1 (-)")
    array = np.array(values, dtype=float)
    if axis == "stiffness_ratio" and np.all((array > 0) & np.isfinite(array)):
        ax.set_xscale("log")
        return array
    step = 1 if axis == "balls" else max(1, len(values) // 7)
    ax.set_xticks(range(0, len(values), step), [number(value, 2) for value in values[::step]])
    return np.arange(len(array), dtype=float)


def _beside(ax: Any, x: np.ndarray, place: float) -> np.ndarray:
    """Shift places along an axis by a part of what lies between two of them."""
    logarithmic = ax.get_xscale() == "log"
    places = np.log10(x) if logarithmic else x
    apart = float(np.min(np.diff(places))) if len(x) > 1 else 0.5
    shifted = places + 0.6 * apart * place
    return 10**shifted if logarithmic else shifted


def _over(
    rows: Frame,
    solvers: Sequence[str],
    axis: str,
    measure: str,
    label: str,
    values: Sequence[float],
    panel: str | None = None,
) -> Figure:
    """Draw the median of a measure over an axis, and its 5 to 95 %; a panel a value of another axis."""
    panels = list(dict.fromkeys(rows[panel])) if panel else [None]
    with drawing(2.6 * len(panels) + 3.6, 3.2) as figure:
        axes = figure.subplots(1, len(panels), sharey=True, squeeze=False)[0]
        for ax, name in zip(axes, panels, strict=True):
            some = rows if name is None else rows[rows[panel] == name]
            here = [value for value in values if value in set(some[axis])] if panel else values
            x = _axis(ax, axis, here)
            for position, solver in enumerate(solvers):
                style = look(solver, position)
                grouped = some[some.solver == solver].groupby(axis)[measure]
                low, median, high = (grouped.quantile(q).reindex(here) for q in (0.05, 0.5, 0.95))
                if measure == "velocity_divergence":
                    low, median, high = (each.clip(lower=_FLOOR) for each in (low, median, high))
                at = _beside(ax, x, (position + 0.5) / len(solvers) - 0.5)
                ax.vlines(at, low, high, color=style.color, linewidth=1.4, alpha=0.5)
                ax.plot(
                    at,
                    median,
                    color=style.color,
                    marker=style.marker,
                    linewidth=1,
                    linestyle=style.dash,
                    label=named(solver),
                )
            ax.set_title(name or "")
        axes[0].set_ylabel(label)
        if measure == "velocity_divergence":
            axes[0].set_yscale("log")  # shared
        else:
            axes[0].axhline(0, color="black", linewidth=1)
        axes[-1].legend(loc="center left", bbox_to_anchor=(1.01, 0.5))
    return figure


def _state_paths(rows: Frame, solvers: Sequence[str], values: Sequence[float]) -> Figure:
    with drawing(6.2, 3.2) as figure:
        ax = figure.subplots()
        x = _axis(ax, "stiffness_ratio", values)
        for position, solver in enumerate(solvers):
            style, some = look(solver, position), rows[rows.solver == solver]
            share = some[FULL_PATHS].astype(float).groupby(some.stiffness_ratio).mean().reindex(values)
            # Wide below, narrow above: solvers that agree stay visible under one another.
            room = len(solvers) - 1 - position
            size = {"linewidth": 1.4 + 1.6 * room, "markersize": 4 + 3 * room}
            ax.plot(x, 100 * share, color=style.color, marker=style.marker, label=named(solver), **size)
        ax.set_ylim(-3, 103)
        ax.set_ylabel("cells with the model's path (%)")
        ax.legend(loc="center left", bbox_to_anchor=(1.01, 0.5))
    return figure


def _median_maps(
    rows: Frame,
    solvers: Sequence[str],
    levels: dict[str, list[float]],
    across: str,
    up: str,
    written: int = 36,
) -> Figure:
    """Draw the median D over two axes, a panel a solver; maps of at most `written` fields hold their numbers."""
    columns, lines = levels[across], levels[up]
    size = 2.4 * len(solvers) + 1.2, 1.9 + 0.28 * min(len(lines), 20)
    with drawing(*size) as figure:
        axes = figure.subplots(1, len(solvers), sharey=True, squeeze=False)[0]
        parts = (rows[rows.solver == name].groupby([up, across]).velocity_divergence for name in solvers)
        tables = [
            part.median().unstack().reindex(index=lines, columns=columns).to_numpy(float) for part in parts
        ]
        images: list[Any] = []
        highest = max(float(np.nanmax(table)) for table in tables)
        for ax, name, table in zip(axes, solvers, tables, strict=True):
            images.append(
                ax.imshow(table, origin="lower", aspect="auto", cmap="viridis", vmin=0, vmax=highest)
            )
            for (row, column), value in np.ndenumerate(table) if table.size <= written else ():
                shade = "black" if value > 0.6 * highest else "white"
                ax.text(column, row, number(value, 2), ha="center", va="center", fontsize=7, color=shade)
            for axis, values, most in ((ax.xaxis, columns, 5), (ax.yaxis, lines, 12)):
                step = -(-len(values) // most)
                axis.set_ticks(range(0, len(values), step), [number(value, 2) for value in values[::step]])
            ax.set_xlabel(AXES[across])
            ax.set_title(named(name))
            ax.grid(False)
        axes[0].set_ylabel(AXES[up])
        figure.colorbar(images[0], ax=list(axes), label="median D (-)")
    return figure
