"""Trust maps: where in the plane of k2/k1 and m2/m1 an engine stays near the model, and what is to blame elsewhere.

A field of the plane holds the cells of all restitutions. It counts as within a level where its median cell is, or, more
strictly, where all of its cells are. To blame is the contribution of the ladder (docs/ladder.md) with the largest sum
of components over the cells of the field that are beyond the lowest level.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyarrow.parquet as pq
from matplotlib.colors import BoundaryNorm, ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from numpy.typing import NDArray

from impact_xval.compliant_baselines.registry import is_engine
from impact_xval.experiments.config.experiment import Config
from impact_xval.experiments.measures.aggregates import Levels, axis_levels
from impact_xval.experiments.measures.ladder import CONTRIBUTIONS, Contribution
from impact_xval.experiments.measures.laws import in_order_of_laws
from impact_xval.experiments.presentation.pages import phrase
from impact_xval.experiments.presentation.style import drawing
from impact_xval.experiments.tables.folder import RunFolder
from impact_xval.experiments.tables.numbers import number
from impact_xval.experiments.tables.parquet import codes, column, present

#: D that is trusted, from the strictest on.
LEVELS = (0.01, 0.05, 0.2)

#: Of the fields of every level, and of those beyond the last: told apart by those who see no red or no green.
_COLORS = ("#08519C", "#6BAED6", "#FEE391", "#A63603")

#: Nothing to compare; nothing beyond the lowest level.
_EMPTY, _WITHIN = "white", "0.9"

Codes = NDArray[np.int8]


@dataclass(frozen=True, slots=True, eq=False)
class Trust:
    """Trust in one engine; every array has the shape (values of m2/m1, values of k2/k1).

    Attributes
    ----------
    solver : str
        The engine.
    cells : ndarray of int
        Cells of the field that are compared: unmarked, and with a result.
    typical, strict : ndarray of int8
        Position in `LEVELS` of the level that the median cell, or every cell, stays within; 3 beyond all of them,
        -1 without a cell.
    blamed : ndarray of int8
        Position in `CONTRIBUTIONS` of what is to blame; -1 where no cell is beyond the lowest level.
    """

    solver: str
    cells: NDArray[np.intp]
    typical: Codes
    strict: Codes
    blamed: Codes

    def share(self, level: float) -> float:
        """Return the share of fields whose median cell is within a level, of `LEVELS`; NaN without a field."""
        there = self.typical >= 0
        return float((self.typical[there] <= LEVELS.index(level)).mean()) if there.any() else np.nan

    def causes(self) -> list[tuple[Contribution, float]]:
        """Return what is to blame in which share of the fields where anything is, the largest first."""
        blamed = self.blamed[self.blamed >= 0]
        counts = np.bincount(blamed, minlength=len(CONTRIBUTIONS)) / max(1, blamed.size)
        return [
            (CONTRIBUTIONS[i], float(counts[i])) for i in np.argsort(-counts, kind="stable") if counts[i] > 0
        ]


@dataclass(frozen=True, slots=True, eq=False)
class TrustMap:
    """Trust in the engines of a run over its plane.

    Attributes
    ----------
    stiffness_ratio, mass_ratio : list of float
        Values along the plane, rising.
    engines : list of Trust
    whole : int
        Cells of a field of a grid, one a pair of restitutions; 0 where cells are scattered.
    """

    stiffness_ratio: list[float]
    mass_ratio: list[float]
    engines: list[Trust]
    whole: int


def trust_of(folder: RunFolder, config: Config) -> TrustMap | None:
    """Compute the trust map of a finished run of two balls from its table of ladders.

    Returns
    -------
    TrustMap or None
        None where there is no plane, only one value along an axis, or no engine with a result.
    """
    path = folder.table_path("ladder.parquet")
    engines = [name for name in in_order_of_laws(config.solvers) if is_engine(name)]
    solver = codes(path, "solver", engines)
    regular = (codes(path, "status", ["ok"]) == 0) & ~present(path, "marked") & (solver >= 0)
    if not regular.any():
        return None
    places, values = [], []
    for axis in ("mass_ratio", "stiffness_ratio"):
        x = column(path, axis)
        levels = axis_levels(config, axis, x)
        ordered = Levels(sorted(levels.values), levels.edges)
        places.append(ordered.codes(x))
        values.append(ordered.values)
    shape = len(values[0]), len(values[1])
    if min(shape) < 2:
        return None
    field = places[0].astype(np.intp) * shape[1] + places[1]
    total = column(path, "velocity_divergence")
    schema = set(pq.read_schema(path).names)
    sums = np.zeros((len(CONTRIBUTIONS), len(engines), shape[0] * shape[1]))
    beyond = regular & (total > LEVELS[0])
    for i, contribution in enumerate(CONTRIBUTIONS):
        if f"{contribution.name}_share" in schema:
            along = np.nan_to_num(column(path, f"{contribution.name}_share")[beyond]) * total[beyond]
            np.add.at(sums[i], (solver[beyond], field[beyond]), along)
    found = []
    for place, name in enumerate(engines):
        rows = regular & (solver == place)
        if rows.any():
            trust = _trust(name, field[rows], total[rows], sums[:, place], shape)
            found.append(trust)
    scattered = config.sample is not None or config.cells is not None
    lengths = list(config.grid.lengths().values())
    whole = 0 if scattered else math.prod(lengths[2:])
    return TrustMap(values[1], values[0], found, whole)


def _trust(
    name: str, field: NDArray[Any], total: NDArray[np.float64], sums: NDArray[Any], shape: tuple[int, int]
) -> Trust:
    """Put the rows of one engine together by field."""
    size = shape[0] * shape[1]
    cells = np.bincount(field, minlength=size)
    order = np.lexsort((total, field))
    sorted_total, ends = total[order], np.cumsum(cells)
    there = cells > 0
    first = (ends - cells)[there]
    middles = first + (cells[there] - 1) // 2, first + cells[there] // 2
    median, largest = np.full(size, np.nan), np.full(size, np.nan)
    median[there] = 0.5 * (sorted_total[middles[0]] + sorted_total[middles[1]])
    largest[there] = sorted_total[ends[there] - 1]

    def level(values: NDArray[np.float64]) -> Codes:
        return np.where(there, np.searchsorted(LEVELS, values), -1).astype(np.int8).reshape(shape)

    blamed = np.where(largest > LEVELS[0], sums.argmax(axis=0), -1).astype(np.int8)
    return Trust(name, cells.reshape(shape), level(median), level(largest), blamed.reshape(shape))


def draw_trust(trust: TrustMap | None) -> Iterator[tuple[str, Figure, str]]:
    """Draw a trust map: name, figure, caption; nothing where there is none."""
    if trust is not None:
        most = int(max(each.cells.max() for each in trust.engines))
        yield "trust-map", _figure(trust), phrase("pictures.md.j2", "trust", trust, LEVELS, most)


def _figure(trust: TrustMap) -> Figure:
    rows = len(trust.engines)
    with drawing(7.4, 1.5 + 1.75 * rows) as figure:
        axes = figure.subplots(rows, 3, sharex=True, sharey=True, squeeze=False)
        kinds = ("trust_typical", "trust_strict", "trust_blamed")
        for ax, kind in zip(axes[0], kinds, strict=True):
            ax.set_title(phrase("pictures.md.j2", kind), fontsize=8.5)
        shown = [
            i for i, _ in enumerate(CONTRIBUTIONS) if any((each.blamed == i).any() for each in trust.engines)
        ]
        colors = [_EMPTY, _WITHIN, *(CONTRIBUTIONS[i].color for i in shown)]
        for row, each in zip(axes, trust.engines, strict=True):
            for ax, codes_ in zip(row, (each.typical, each.strict), strict=False):
                _show(ax, codes_ + 1, [_EMPTY, *_COLORS])
                y, x = np.nonzero((each.cells > 0) & (each.cells < trust.whole))
                ax.plot(x, y, "o", color="white", markeredgecolor="black", markersize=4)
            blamed = np.where(each.typical < 0, 0, 1)
            for place, i in enumerate(shown):
                blamed[each.blamed == i] = 2 + place
            _show(row[2], blamed, colors)
            row[0].set_ylabel(f"{each.solver}\nm2/m1 (-)")
        for axis, values, most in (
            (axes[0, 0].xaxis, trust.stiffness_ratio, 5),
            (axes[0, 0].yaxis, trust.mass_ratio, 6),
        ):
            step = max(1, -(-(len(values) - 1) // (most - 1)))
            axis.set_ticks(range(0, len(values), step), [number(v, 2) for v in values[::step]])
        for ax in axes[-1]:
            ax.set_xlabel("k2/k1 (-)")
        names = [phrase("pictures.md.j2", "trust_level", level) for level in LEVELS]
        names.append(phrase("pictures.md.j2", "trust_beyond", LEVELS[-1]))
        levels = [Patch(color=color, label=name) for color, name in zip(_COLORS, names, strict=True)]
        causes = [Patch(color=CONTRIBUTIONS[i].color, label=CONTRIBUTIONS[i].label) for i in shown]
        figure.legend(handles=levels, loc="outside lower left", ncols=2, fontsize=8)
        if causes:
            figure.legend(handles=causes, loc="outside lower right", ncols=2, fontsize=8)
    return figure


def _show(ax: Any, image: NDArray[Any], colors: list[str]) -> None:
    norm = BoundaryNorm(np.arange(len(colors) + 1) - 0.5, len(colors))
    ax.imshow(
        image, origin="lower", aspect="auto", cmap=ListedColormap(colors), norm=norm, interpolation="nearest"
    )
    ax.grid(False)
