"""The figures of a run, drawn from its stored tables, each with a caption that stands alone."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from impact_xval.experiments.config.axes import AXES
from impact_xval.experiments.config.experiment import REFERENCE, Config
from impact_xval.experiments.measures.aggregates import FULL_PATHS, Frame
from impact_xval.experiments.measures.ladder_summary import LadderSummary, summarise_ladder
from impact_xval.experiments.measures.laws import in_order_of_laws
from impact_xval.experiments.measures.summary import Summary, load_divergence, summarise
from impact_xval.experiments.presentation.columns.figures import draw_columns
from impact_xval.experiments.presentation.curve_figures import draw_cell_curves
from impact_xval.experiments.presentation.ladder_figures import draw_ladders
from impact_xval.experiments.presentation.looks import Look, look
from impact_xval.experiments.presentation.pages import phrase
from impact_xval.experiments.presentation.pictures.trust import draw_trust, trust_of
from impact_xval.experiments.presentation.style import drawing, save
from impact_xval.experiments.sweep.curves import CURVES, FIGURE_CELL
from impact_xval.experiments.sweep.process import FaultError
from impact_xval.experiments.tables.folder import RunFolder, write_json
from impact_xval.experiments.tables.numbers import number

CAPTIONS = "captions.json"

#: D below this is drawn at this height on logarithmic axes: about the rounding of the solvers.
_FLOOR = 1e-6


@dataclass(frozen=True, slots=True)
class Data:
    """What figures of divergence are drawn from.

    Attributes
    ----------
    levels : dict of list
        Values of every axis, rising.
    regular : DataFrame
        The compared rows of the divergence table, marked cells left out; axes by level.
    solvers : list of str
        The compared solvers that have a result somewhere, grouped by the law they were asked for.
    """

    levels: dict[str, list[float]]
    regular: Frame
    solvers: list[str]

    def by_solver(self) -> Iterator[tuple[str, Look, Frame]]:
        """Give each solver with its look and its rows."""
        for position, name in enumerate(self.solvers):
            yield name, look(name, position), self.regular[self.regular.solver == name]


def write_figures(
    folder: RunFolder,
    summary: Summary | None = None,
    divergences: Callable[[], dict[str, str]] | None = None,
) -> list[tuple[Path, str]]:
    """Draw every figure of a finished run into ``figures/``.

    Parameters
    ----------
    folder : RunFolder
    summary : Summary, optional
        That of the run, where it is known; by default what is needed of it is computed.
    divergences : callable, optional
        Waits for `draw_divergences`, at which another process may be; by default it is called here.

    Returns
    -------
    list of (Path, str)
        The PNG of each figure, and its caption; a figure that has nothing to show is left out.
    """
    config, target = folder.config(), folder.root / "figures"
    if config.column is not None:
        found = summary or summarise(folder)
        captions = _saved(folder, draw_columns(folder, found))
    else:
        known = summary.ladder if summary else None
        captions = _collision_figures(folder, config, known, divergences)
    write_json(target / CAPTIONS, captions)
    return [(target / f"{name}.png", caption) for name, caption in captions.items()]


def _collision_figures(
    folder: RunFolder,
    config: Config,
    ladder: LadderSummary | None,
    divergences: Callable[[], dict[str, str]] | None,
) -> dict[str, str]:
    """Draw the figures of a run of two balls: their captions by name."""
    # All that is drawn is read first: of a damaged folder nothing is drawn.
    curves = folder.read_table(CURVES).to_pandas()
    ladder = summarise_ladder(folder, config) if ladder is None else ladder
    first = draw_divergences(folder) if divergences is None else {}
    ladders = _saved(folder, draw_ladders(ladder))
    last = _saved(folder, _draw_curves(curves, config))
    if divergences is not None:
        try:
            first = divergences()
        except FaultError:
            first = draw_divergences(folder)
    return {**first, **ladders, **last}


def draw_divergences(folder: RunFolder) -> dict[str, str]:
    """Draw what the table of divergence holds: the figures' captions by name."""
    config = folder.config()
    captions = _saved(folder, _draw_divergences(_divergences(folder, config)))
    return captions | _saved(folder, draw_trust(trust_of(folder, config)))


def _saved(folder: RunFolder, drawn: Iterable[tuple[str, Figure, str]]) -> dict[str, str]:
    """Save figures; their captions by name."""
    target = folder.root / "figures"
    target.mkdir(exist_ok=True)
    captions = {}
    for name, figure, caption in drawn:
        save(figure, target, name)
        captions[name] = caption
    return captions


def _divergences(folder: RunFolder, config: Config) -> Data:
    table = load_divergence(folder, config)
    measures = ("velocity_divergence", "dretained_energy", FULL_PATHS)
    regular = table.frame(measures)
    levels = {axis: sorted(levels.values) for axis, levels in table.levels.items()}
    there = set(regular.solver)
    return Data(levels, regular, in_order_of_laws(name for name in config.solvers if name in there))


def _draw_divergences(data: Data) -> Iterator[tuple[str, Figure, str]]:
    """Draw what the table of divergence holds: name, figure, caption; nothing where nothing was compared."""
    facts = {"model": REFERENCE, "floor": _FLOOR, "solvers": data.solvers}
    drawers: dict[str, Callable[[Data], Figure]] = {
        "divergence-by-stiffness": _divergence_by_stiffness,
        "divergence-map": _divergence_map,
        "divergence-by-restitution": _divergence_by_restitution,
        "state-paths": _state_paths,
        "energy": _energy,
    }
    for name, draw in drawers.items() if data.solvers else ():
        yield name, draw(data), _caption(name, facts)


def _draw_curves(curves: Frame, config: Config) -> Iterator[tuple[str, Figure, str]]:
    """Draw the stored impulse curves."""
    first = curves[curves.curve == FIGURE_CELL].head(1).to_dict("records")
    cell = {label: first[0][axis] for axis, label in AXES.items()} if first else {}
    facts = {"model": REFERENCE, "solvers": in_order_of_laws(config.solvers), "cell": cell}
    if first:
        yield "impulse-curves", draw_cell_curves(curves, facts["solvers"]), _caption("impulse-curves", facts)


def _caption(figure: str, facts: dict[str, Any]) -> str:
    return phrase("captions.md.j2", figure.replace("-", "_"), facts)


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


def _divergence_by_stiffness(data: Data) -> Figure:
    values = data.levels["stiffness_ratio"]
    columns = len(data.solvers)
    with drawing(2.4 * columns + 0.8, 3.2) as figure:
        axes = figure.subplots(1, columns, sharey=True, squeeze=False)[0]
        for ax, (name, style, rows) in zip(axes, data.by_solver(), strict=True):
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
    return figure


def _divergence_map(data: Data) -> Figure:
    across = _Side("stiffness_ratio", "k2/k1", ticks=4, digits=2)
    up = _Side("mass_ratio", "mass ratio m2/m1", ticks=12)
    size = (2.4 * len(data.solvers) + 1.2, 1.7 + 0.28 * min(len(data.levels[up.axis]), 20))
    return _median_maps(data, across, up, size)


def _divergence_by_restitution(data: Data) -> Figure:
    across, up = _Side("e1", "e1 (ball on ball)", ticks=8), _Side("e2", "e2 (ball on table)", ticks=8)
    size = (2.3 * len(data.solvers) + 1.2, 2.7)
    return _median_maps(data, across, up, size, written=36)


@dataclass(frozen=True, slots=True)
class _Side:
    """A side of a map: the axis along it, its label, about how many values are written and with how many digits."""

    axis: str
    label: str
    ticks: int
    digits: int = 3


def _median_maps(data: Data, across: _Side, up: _Side, size: tuple[float, float], written: int = 0) -> Figure:
    """Draw the median D over two axes, a panel a solver; maps of at most `written` fields hold their numbers."""
    columns, rows = data.levels[across.axis], data.levels[up.axis]
    with drawing(*size) as figure:
        axes = figure.subplots(1, len(data.solvers), sharey=True, squeeze=False)[0]
        tables = [
            part.groupby([up.axis, across.axis])
            .velocity_divergence.median()
            .unstack()
            .reindex(index=rows, columns=columns)
            .to_numpy(dtype=float)
            for _, _, part in data.by_solver()
        ]
        highest = max(float(np.nanmax(table)) for table in tables)
        images = []
        for ax, name, table in zip(axes, data.solvers, tables, strict=True):
            images.append(
                ax.imshow(table, origin="lower", aspect="auto", cmap="viridis", vmin=0, vmax=highest)
            )
            if table.size <= written:
                for (row, column), value in np.ndenumerate(table):
                    shade = "black" if value > 0.6 * highest else "white"
                    ax.text(column, row, number(value, 2), ha="center", va="center", fontsize=7, color=shade)
            for axis, values, side in ((ax.xaxis, columns, across), (ax.yaxis, rows, up)):
                step = max(1, len(values) // side.ticks)
                axis.set_ticks(range(0, len(values), step), [number(v, side.digits) for v in values[::step]])
            ax.set_xlabel(across.label)
            ax.set_title(name)
            ax.grid(False)
        axes[0].set_ylabel(up.label)
        figure.colorbar(images[0], ax=list(axes), label="median D (-)")
    return figure


def _state_paths(data: Data) -> Figure:
    values = data.levels["stiffness_ratio"]
    with drawing(6.0, 3.2) as figure:
        ax = figure.subplots()
        x = _stiffness_axis(ax, values)
        for position, (name, style, rows) in enumerate(data.by_solver()):
            share = rows[FULL_PATHS].astype(float).groupby(rows.stiffness_ratio).mean().reindex(values)
            # Wide below, narrow above: solvers that agree stay visible under one another.
            room = len(data.solvers) - 1 - position
            size = {"linewidth": 1.4 + 1.6 * room, "markersize": 4 + 3 * room}
            ax.plot(x, 100 * share, color=style.color, marker=style.marker, label=name, **size)
        ax.set_ylim(-3, 103)
        ax.set_ylabel("cells with the model's path (%)")
        ax.legend(loc="center left", bbox_to_anchor=(1.01, 0.5))
    return figure


def _energy(data: Data) -> Figure:
    values = data.levels["stiffness_ratio"]
    with drawing(6.0, 3.4) as figure:
        ax = figure.subplots()
        x = _stiffness_axis(ax, values)
        ax.axhline(0, color="black", linewidth=1)
        logarithmic = ax.get_xscale() == "log"
        places = np.log10(x) if logarithmic else x
        width = 0.6 * (float(np.min(np.diff(places))) if len(x) > 1 else 0.5)
        count = len(data.solvers)
        for position, (name, style, rows) in enumerate(data.by_solver()):
            grouped = rows.dretained_energy.groupby(rows.stiffness_ratio)
            low, median, high = (grouped.quantile(q).reindex(values) for q in (0.05, 0.5, 0.95))
            shifted = places + width * ((position + 0.5) / count - 0.5)
            shifted = 10**shifted if logarithmic else shifted
            ax.vlines(shifted, low, high, color=style.color, linewidth=1.4, alpha=0.7)
            ax.plot(shifted, median, color=style.color, marker=style.marker, linestyle="none", label=name)
        ax.set_ylabel("retained energy, solver minus model (-)")
        ax.legend(loc="center left", bbox_to_anchor=(1.01, 0.5))
    return figure
