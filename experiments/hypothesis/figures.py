"""The figures of a run; `page` has their captions."""

from __future__ import annotations

import textwrap
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.colors import BoundaryNorm, ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from impact_xval.experiments.hypothesis.cases import BY_KEY, CASES, LOSSY, pair_class
from impact_xval.experiments.hypothesis.columns import PLACES
from impact_xval.experiments.hypothesis.maps import grid_of
from impact_xval.experiments.hypothesis.mechanism import end_share
from impact_xval.experiments.hypothesis.run import DRAWN, Results
from impact_xval.experiments.hypothesis.verdicts import CaseResult, Series
from impact_xval.experiments.presentation.looks import Look, look
from impact_xval.experiments.presentation.style import drawing, save
from impact_xval.experiments.presentation.words import named

#: Dots per inch of the tiles of a map; all else is drawn as lines.
_DPI = 200

#: Distances below this are not drawn: rounding.
_FLOOR = 1e-13

_LOOKS = {
    "kelvin-voigt-anchored": Look("#56B4E9", "<", "--"),
    "kelvin-voigt-textbook": Look("#8C8C8C", "x", (0, (1, 1))),
    "hunt-crossley": Look("#7A4B1E", "P", "-"),
    "liu-zhao-brogliato": Look("#5D3A9B", "*", (0, (3, 1))),
}
_X = {"k1/k2": "k1/k2", "k2/k1": "k2/k1", "1/e1^2": "1/e1$^2$", "1/e2^2": "1/e2$^2$"}
#: Within 1, 5, 20 %, and beyond.
_BANDS = ("#1b7837", "#a6dba0", "#fee0b6", "#b35806")


def _look(results: Results, solver: str) -> Look:
    return _LOOKS.get(solver) or look(solver, results.config.solvers.index(solver))


def write_figures(results: Results, folder: Path) -> list[str]:
    """Draw every figure into a folder, as SVG and PDF; return their names in the order of the page."""
    folder.mkdir(parents=True, exist_ok=True)
    drawn = {"distance": _distance(results)}
    if results.columns:
        drawn["columns"] = _columns(results)
    if results.motions:
        drawn["relative-motion"] = _relative_motion(results)
    if results.branches:
        drawn["no-limit"] = _no_limit(results)
    drawn |= {map_name(e1, e2): _map(results, e1, e2) for e1, e2 in results.mapped}
    for name, figure in drawn.items():
        save(figure, folder, name)
    return list(drawn)


def map_name(e1: float, e2: float) -> str:
    """Name the figure of the maps at given restitutions."""
    return f"map-{e1:g}-{e2:g}"


def _distance(results: Results) -> Figure:
    with drawing(10.0, 6.6) as figure:
        axes = figure.subplots(2, 3)
        handles: dict[str, Any] = {}
        for ax, case in zip(axes.flat, CASES, strict=True):
            for series, found in zip(results.series, results.verdicts, strict=True):
                if series.case != case:
                    continue
                name = series.solver.name
                style = _look(results, name)
                chosen = [i for i, point in enumerate(series.points) if pair_class(case, point) in LOSSY]
                usable, _ = series.usable()
                D = np.where(usable, series.distances(), np.nan)[chosen]
                known = np.isfinite(D).sum(axis=0) > len(chosen) / 2
                median = np.full(series.contrast.size, np.nan)
                median[known] = np.nanmedian(D[:, known], axis=0)
                median[median < _FLOOR] = np.nan
                engine = series.solver.kind == "stepped"
                (line,) = ax.plot(
                    series.contrast,
                    median,
                    color=style.color,
                    linestyle="none" if engine else style.dash,
                    marker=style.marker if engine else "",
                    markersize=6,
                    markerfacecolor="none",
                    zorder=3 if engine else 2,
                )
                handles.setdefault(named(name), line)
                _slope(ax, found, series, median, style.color)
            ax.set_xscale("log")
            ax.set_yscale("log")
            ax.set_xlabel(f"contrast {_X[case.variable]} (-)")
            ax.set_title(textwrap.fill(case.title, 34), fontsize=8.5)
        for ax in axes[:, 0]:
            ax.set_ylabel("distance from the closed form, D (-)")
        figure.legend(list(handles.values()), list(handles), loc="outside lower center", ncols=5)
    return figure


def _columns(results: Results) -> Figure:
    """Draw D from the welded column at every place, the median over the lossy points."""
    with drawing(10.0, 9.0) as figure:
        axes = figure.subplots(4, 3, sharex=True, sharey=True)
        panels, handles = dict(zip(PLACES, axes.flat, strict=True)), {}
        for found in results.columns:
            style = _look(results, found.solver)
            lossy = [p.distances() for group in found.classes if group.name == "lossy" for p in group.members]
            median = np.median(lossy, axis=0)
            median[median < _FLOOR] = np.nan
            (line,) = panels[found.place].plot(
                found.contrast, median, color=style.color, linestyle=style.dash
            )
            handles.setdefault(named(found.solver), line)
        for place, ax in panels.items():
            ax.set_xscale("log")
            ax.set_yscale("log")
            first = "its bodies meet" if place.meets else "its bodies are at one velocity"
            ax.set_title(
                f"{place.arrangement}, stiff contact: {place.where};\nat first {first}", fontsize=8.5
            )
        for ax in axes[-1]:
            ax.set_xlabel("stiffness over the stiffest other contact's (-)")
        for ax in axes[:, 0]:
            ax.set_ylabel("D from the welded column (-)")
        figure.legend(list(handles.values()), list(handles), loc="outside lower center", ncols=5)
    return figure


def _slope(ax: Any, found: CaseResult, series: Series, median: np.ndarray, color: str) -> None:
    """Draw below a line the power law fitted to its last decades, where the verdict of its class is `supported`."""
    supported = any(group.name in LOSSY and group.verdict == "supported" for group in found.classes)
    if not supported or series.solver.kind == "stepped":
        return
    known = np.flatnonzero(np.isfinite(median))
    last = known[series.contrast[known] >= series.contrast[known[-1]] * 10**-found.decades]
    if last.size < 3:
        return
    x = np.log10(series.contrast[last])
    slope, at_zero = np.polyfit(x, np.log10(median[last]), 1)
    ends = np.array([x[0], x[-1]])
    heights = 0.25 * 10 ** (at_zero + slope * ends)
    ax.plot(10**ends, heights, color=color, linestyle=":", linewidth=0.9)
    ax.text(10 ** ends[1], heights[1], f" {-slope:.2f}", color=color, fontsize=7, va="center")


def _relative_motion(results: Results) -> Figure:
    kinds = {series.solver.name: series.solver.kind for series in results.series}
    with drawing(7.6, 4.3) as figure:
        axes = figure.subplots(2, len(DRAWN))
        handles: dict[str, Any] = {}
        for column, key in enumerate(DRAWN):
            for (name, case), motion in results.motions.items():
                if case != key or name in ("kelvin-voigt-textbook", "kelvin-voigt-anchored"):
                    continue
                style = _look(results, name)
                engine = kinds[name] == "stepped"
                width = 2.4 if name == "state-transition" else 1.2
                keep = slice(None, None, max(1, motion.time.size // 4000)) if engine else slice(None)
                for ax, what in ((axes[0, column], motion.rate), (axes[1, column], motion.separation)):
                    (line,) = ax.plot(
                        motion.time[keep],
                        what[keep],
                        color=style.color,
                        linestyle="--" if engine else "-",
                        linewidth=width,
                        zorder=1 if name == "state-transition" else 2,
                    )
                handles.setdefault(named(name), line)
                if name in ("state-transition", "bistiffness") and motion.joined is not None:
                    axes[1, column].plot(
                        motion.time[motion.joined], motion.separation[motion.joined], "o", color=style.color
                    )
            axes[0, column].set_title(textwrap.fill(BY_KEY[key].title, 28), fontsize=8.5)
            axes[1, column].set_xlabel("time, half periods of\nthe soft contact (-)")
        axes[0, 0].set_ylabel("relative velocity\nper |v0| (-)")
        axes[1, 0].set_ylabel("separation per\nsoft compression (-)")
        figure.legend(list(handles.values()), list(handles), loc="outside lower center", ncols=4)
    return figure


def _no_limit(results: Results) -> Figure:
    worst = max(results.branches, key=lambda branch: branch.measured)
    series = next(
        s for s in results.series if s.solver.name == "state-transition" and s.case.key == "zero-early"
    )
    i = series.points.index(worst.point)
    with drawing(9.0, 3.2) as figure:
        left, right = figure.subplots(1, 2)
        left.plot(series.contrast, series.rows("v1")[i], "o", color="black", markersize=3.5)
        for n in (worst.more_ends + 1, worst.more_ends + 2):
            value = worst.once * worst.point.e2 ** (n - 1)
            name = {1: "one end of compression", 2: "two ends"}.get(n, f"{n} ends")
            left.axhline(value, color="#0072B2", linewidth=1)
            left.text(
                series.contrast[-1],
                value + 0.012 * worst.once,
                f" {name}",
                color="#0072B2",
                fontsize=7.5,
                va="bottom",
                ha="right",
            )
        left.set_xscale("log")
        left.set_xlabel("contrast k1/k2 (-)")
        left.set_ylabel("v1 of the model, per |v0| (-)")
        lightest = min(branch.point.mass_ratio for branch in results.branches)
        masses = np.linspace(min(0.15, lightest), 1, 200)
        right.plot(masses, [100 * end_share(m, 2) for m in masses], color="#0072B2", label="closed form")
        right.errorbar(
            [b.point.mass_ratio for b in results.branches],
            [100 * b.measured for b in results.branches],
            [100 * b.uncertainty for b in results.branches],
            fmt="o",
            color="black",
            capsize=3,
            label="counted",
        )
        right.set_xlabel("mass ratio m2/m1 (-)")
        right.set_ylabel("outcomes with two ends\nof compression (%)")
        right.legend()
    return figure


def _map(results: Results, e1: float, e2: float) -> Figure:
    chosen = (results.maps.e1 == e1) & (results.maps.e2 == e2)
    maps: Any = results.maps[chosen].groupby("solver", sort=False)
    columns = min(4, len(maps))
    rows = -(-len(maps) // columns)
    norm, colors = BoundaryNorm([0, 0.01, 0.05, 0.2, 1e9], 4), ListedColormap(_BANDS)
    with drawing(2.5 * columns, 2.35 * rows + 0.6) as figure:
        figure.dpi = _DPI
        axes = figure.subplots(rows, columns, squeeze=False)
        for ax in axes.flat[len(maps) :]:
            ax.set_visible(False)
        for position, (ax, (solver, one)) in enumerate(zip(axes.flat, maps, strict=False)):
            grid = grid_of(one)
            error = np.ma.masked_invalid(grid.T)
            ax.pcolormesh(
                grid.index, grid.columns, error, cmap=colors, norm=norm, shading="nearest", rasterized=True
            )
            ax.set_xscale("log")
            ax.set_yscale("log")
            ax.set_xlim(*results.config.map.stiffness_ratio)
            ax.set_ylim(*results.config.map.mass_ratio)
            ax.axvline(1, color="black", linewidth=0.8)
            ax.set_title(named(solver), fontsize=9)
            ax.grid(False)
            ax.set_yticks([0.1, 1, 10], ["0.1", "1", "10"])
            if position % columns == 0:
                ax.set_ylabel("mass ratio m2/m1 (-)")
            if position + columns >= len(maps):
                ax.set_xlabel("stiffness ratio k2/k1 (-)")
        labels = ("within 1 %", "within 5 %", "within 20 %", "beyond 20 %")
        figure.legend([Patch(color=color) for color in _BANDS], labels, loc="outside lower center", ncols=4)
    return figure
