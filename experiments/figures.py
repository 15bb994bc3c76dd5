"""The figures of a run, drawn from its stored tables, each with a caption that stands alone."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from experiments.config import REFERENCE, Config
from experiments.curve_figures import draw_cell_curves, draw_supplement
from experiments.curves import CURVES, CURVES_SCHEMA
from experiments.ladder_figures import draw_ladders
from experiments.ladder_summary import LadderSummary, summarise_ladder
from experiments.numbers import number
from experiments.store import RunFolder, write_json
from experiments.streams import replacing
from experiments.style import drawing, look
from experiments.summary import FULL_PATHS, Frame, load_divergence

FORMATS = ("png", "pdf")
CAPTIONS = "captions.json"

_DPI = 160
#: D below this is drawn at this height on logarithmic axes: about the rounding of the solvers.
_FLOOR = 1e-6


@dataclass(frozen=True, slots=True)
class Data:
    """What figures are drawn from.

    Attributes
    ----------
    config : Config
    levels : dict of list
        Values of every axis, rising.
    regular : DataFrame
        The compared rows of the divergence table, grazing cells left out; axes by level.
    curves : DataFrame
        The table of curves.
    ladder : LadderSummary
        What the divergence of the engines is made of.
    """

    config: Config
    levels: dict[str, list[float]]
    regular: Frame
    curves: Frame
    ladder: LadderSummary

    @property
    def solvers(self) -> list[str]:
        """The compared solvers that have a result somewhere, in the order of the configuration."""
        there = set(self.regular.solver)
        return [name for name in self.config.solvers if name in there]


def write_figures(folder: RunFolder) -> list[tuple[Path, str]]:
    """Draw every figure of a finished run into ``figures/``.

    Returns
    -------
    list of (Path, str)
        The PNG of each figure, and its caption; a figure that has nothing to show is left out.
    """
    config = folder.config()
    table = load_divergence(folder, config)
    measures = ("velocity_divergence", "dretained_energy", FULL_PATHS)
    data = Data(
        config,
        {axis: sorted(levels.values) for axis, levels in table.levels.items()},
        table.frame(measures, table.compared & ~table.grazing),
        folder.read_table(CURVES, CURVES_SCHEMA).to_pandas(),
        summarise_ladder(folder, config),
    )
    target = folder.root / "figures"
    target.mkdir(exist_ok=True)
    written: list[tuple[Path, str]] = []
    for name, figure, caption in _figures(data):
        for extension in FORMATS:
            with replacing(target / f"{name}.{extension}") as temporary:
                metadata = {"CreationDate": None} if extension == "pdf" else None
                figure.savefig(temporary, format=extension, dpi=_DPI, metadata=metadata)
        written.append((target / f"{name}.png", caption))
    write_json(target / CAPTIONS, {path.stem: caption for path, caption in written})
    return written


def _figures(data: Data) -> Iterator[tuple[str, Figure, str]]:
    drawers: list[tuple[str, Callable[[Data], tuple[Figure, str]]]] = []
    if data.solvers:
        drawers += [
            ("divergence-by-stiffness", _divergence_by_stiffness),
            ("divergence-map", _divergence_map),
            ("divergence-by-restitution", _divergence_by_restitution),
            ("state-paths", _state_paths),
            ("energy", _energy),
        ]
    for name, draw in drawers:
        yield name, *draw(data)
    yield from draw_ladders(data.ladder)
    yield "impulse-curves", *draw_cell_curves(data.curves, data.config.solvers)
    yield "supplement-1b-2b", *draw_supplement(data.curves)


def _stiffness_axis(ax: Any, values: list[float]) -> np.ndarray:
    """Prepare the axis of k2/k1: logarithmic, or evenly spaced values if 0 or infinity is among them."""
    ax.set_xlabel("stiffness ratio k2/k1 (-)")
    array = np.array(values)
    if np.all((array > 0) & np.isfinite(array)):
        ax.set_xscale("log")
        return array
    step = max(1, len(values) // 7)
    ax.set_xticks(range(0, len(values), step), [number(value, 2) for value in values[::step]])
    return np.arange(len(array), dtype=float)


def _sorted_axis(data: Data, axis: str) -> list[float]:
    return data.levels[axis]


def _divergence_by_stiffness(data: Data) -> tuple[Figure, str]:
    values = _sorted_axis(data, "stiffness_ratio")
    columns = len(data.solvers)
    with drawing(2.4 * columns + 0.8, 3.2) as figure:
        axes = figure.subplots(1, columns, sharey=True, squeeze=False)[0]
        for position, (ax, name) in enumerate(zip(axes, data.solvers, strict=True)):
            style = look(name, position)
            rows = data.regular[data.regular.solver == name]
            grouped = rows.groupby("stiffness_ratio").velocity_divergence
            low, median, high, top = (
                grouped.quantile(q).reindex(values).clip(lower=_FLOOR) for q in (0.05, 0.5, 0.95, 1.0)
            )
            x = _stiffness_axis(ax, values)
            ax.fill_between(x, low, high, color=style.color, alpha=0.22, linewidth=0)
            ax.plot(x, median, color=style.color, marker=style.marker or None)
            ax.plot(x, top, color=style.color, linewidth=0.9, linestyle=":")
            ax.set_yscale("log")
            ax.set_title(name)
        axes[0].set_ylabel("velocity divergence D (-)")
    return figure, (
        f"Velocity divergence D of each solver from the {REFERENCE} model over the stiffness ratio k2/k1. "
        "Line with markers: median over mass ratios and restitutions; band: 5th to 95th percentile; dotted: "
        "maximum. D = sqrt((m1 dv1^2 + m2 dv2^2)/(m1 v0^2)), dimensionless; cells beside a jump of the "
        f"model are left out; values below {number(_FLOOR)} are drawn there."
    )


def _divergence_map(data: Data) -> tuple[Figure, str]:
    stiffness, masses = _sorted_axis(data, "stiffness_ratio"), _sorted_axis(data, "mass_ratio")
    columns = len(data.solvers)
    with drawing(2.4 * columns + 1.2, 1.7 + 0.28 * min(len(masses), 20)) as figure:
        axes = figure.subplots(1, columns, sharey=True, squeeze=False)[0]
        tables = [
            data.regular[data.regular.solver == name]
            .groupby(["mass_ratio", "stiffness_ratio"])
            .velocity_divergence.median()
            .unstack()
            .reindex(index=masses, columns=stiffness)
            .to_numpy(dtype=float)
            for name in data.solvers
        ]
        highest = max(float(np.nanmax(table)) for table in tables)
        images = []
        for ax, name, table in zip(axes, data.solvers, tables, strict=True):
            images.append(
                ax.imshow(table, origin="lower", aspect="auto", cmap="viridis", vmin=0, vmax=highest)
            )
            step = max(1, len(stiffness) // 4)
            ax.set_xticks(range(0, len(stiffness), step), [number(v, 2) for v in stiffness[::step]])
            every = max(1, len(masses) // 12)
            ax.set_yticks(range(0, len(masses), every), [number(v) for v in masses[::every]])
            ax.set_xlabel("k2/k1")
            ax.set_title(name)
            ax.grid(False)
        axes[0].set_ylabel("mass ratio m2/m1")
        figure.colorbar(images[0], ax=list(axes), label="median D (-)")
    return figure, (
        f"Median over the restitutions e1, e2 of the velocity divergence D from the {REFERENCE} model, by "
        "stiffness ratio k2/k1 and mass ratio m2/m1, one panel a solver and one colour scale for all. "
        "White: nothing to compare. Cells beside a jump of the model are left out."
    )


def _divergence_by_restitution(data: Data) -> tuple[Figure, str]:
    first, second = _sorted_axis(data, "e1"), _sorted_axis(data, "e2")
    columns = len(data.solvers)
    with drawing(2.3 * columns + 1.2, 2.7) as figure:
        axes = figure.subplots(1, columns, sharey=True, squeeze=False)[0]
        tables = [
            data.regular[data.regular.solver == name]
            .groupby(["e2", "e1"])
            .velocity_divergence.median()
            .unstack()
            .reindex(index=second, columns=first)
            .to_numpy(dtype=float)
            for name in data.solvers
        ]
        highest = max(float(np.nanmax(table)) for table in tables)
        images = []
        for ax, name, table in zip(axes, data.solvers, tables, strict=True):
            images.append(
                ax.imshow(table, origin="lower", aspect="auto", cmap="viridis", vmin=0, vmax=highest)
            )
            if len(first) * len(second) <= 36:
                for (row, column), value in np.ndenumerate(table):
                    shade = "black" if value > 0.6 * highest else "white"
                    ax.text(column, row, number(value, 2), ha="center", va="center", fontsize=7, color=shade)
            for axis, values in ((ax.xaxis, first), (ax.yaxis, second)):
                step = max(1, len(values) // 8)
                axis.set_ticks(range(0, len(values), step), [number(v) for v in values[::step]])
            ax.set_xlabel("e1 (ball on ball)")
            ax.set_title(name)
            ax.grid(False)
        axes[0].set_ylabel("e2 (ball on table)")
        figure.colorbar(images[0], ax=list(axes), label="median D (-)")
    return figure, (
        f"Median over stiffness and mass ratios of the velocity divergence D from the {REFERENCE} model, by "
        "the coefficients of restitution e1 (ball on ball) and e2 (ball on table), one panel a solver. "
        "Cells beside a jump of the model are left out."
    )


def _state_paths(data: Data) -> tuple[Figure, str]:
    values = _sorted_axis(data, "stiffness_ratio")
    with drawing(6.0, 3.2) as figure:
        ax = figure.subplots()
        x = _stiffness_axis(ax, values)
        for position, name in enumerate(data.solvers):
            style = look(name, position)
            rows = data.regular[data.regular.solver == name]
            share = rows[FULL_PATHS].astype(float).groupby(rows.stiffness_ratio).mean().reindex(values)
            # Wide below, narrow above: solvers that agree stay visible under one another.
            room = len(data.solvers) - 1 - position
            size = {"linewidth": 1.4 + 1.6 * room, "markersize": 4 + 3 * room}
            ax.plot(x, 100 * share, color=style.color, marker=style.marker, label=name, **size)
        ax.set_ylim(-3, 103)
        ax.set_ylabel("cells with the model's path (%)")
        ax.legend(loc="center left", bbox_to_anchor=(1.01, 0.5))
    return figure, (
        "Share of cells in which a solver passes through the same sequence of contact states (S1 both "
        f"contacts active, S2 ball on table, S3 ball on ball, S4 none) as the {REFERENCE} model, over the "
        "stiffness ratio k2/k1, of the cells in which the model took no limit (its path ends there). Cells "
        "beside a jump of the model are left out."
    )


def _energy(data: Data) -> tuple[Figure, str]:
    values = _sorted_axis(data, "stiffness_ratio")
    with drawing(6.0, 3.4) as figure:
        ax = figure.subplots()
        x = _stiffness_axis(ax, values)
        ax.axhline(0, color="black", linewidth=1)
        logarithmic = ax.get_xscale() == "log"
        places = np.log10(x) if logarithmic else x
        width = 0.6 * (float(np.min(np.diff(places))) if len(x) > 1 else 0.5)
        count = len(data.solvers)
        for position, name in enumerate(data.solvers):
            style = look(name, position)
            rows = data.regular[data.regular.solver == name]
            grouped = rows.dretained_energy.groupby(rows.stiffness_ratio)
            low, median, high = (grouped.quantile(q).reindex(values) for q in (0.05, 0.5, 0.95))
            shifted = places + width * ((position + 0.5) / count - 0.5)
            shifted = 10**shifted if logarithmic else shifted
            ax.vlines(shifted, low, high, color=style.color, linewidth=1.4, alpha=0.7)
            ax.plot(shifted, median, color=style.color, marker=style.marker, linestyle="none", label=name)
        ax.set_ylabel("retained energy, solver minus model (-)")
        ax.legend(loc="center left", bbox_to_anchor=(1.01, 0.5))
    return figure, (
        "Difference of the fraction of kinetic energy that is left after the collision, solver minus "
        f"{REFERENCE} model, over the stiffness ratio k2/k1: marker the median, bar the 5th to 95th "
        "percentile over mass ratios and restitutions. Above zero the solver dissipates less than the "
        "model. Solvers are set side by side for legibility; cells beside a jump of the model are left out."
    )
