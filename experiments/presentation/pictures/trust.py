"""Trust maps: where in the plane of k2/k1 and m2/m1 an engine stays near the model, and what is to blame elsewhere.

A field of the plane holds the cells of all restitutions. It counts as within a level where its median cell is, or, more
strictly, where all of its cells are. To blame is the contribution of the ladder (docs/ladder.md) with the largest sum
of components over the cells of the field that are beyond the lowest level.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import pandas as pd
import pyarrow.compute as pc
import pyarrow.parquet as pq
from matplotlib.colors import BoundaryNorm, ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from numpy.typing import NDArray

from impact_xval.compliant_baselines.registry import is_engine
from impact_xval.experiments.config.experiment import Config
from impact_xval.experiments.measures.aggregates import Frame, Levels, axis_levels
from impact_xval.experiments.measures.ladder import CONTRIBUTIONS, Contribution
from impact_xval.experiments.measures.laws import in_order_of_laws
from impact_xval.experiments.presentation.style import drawing
from impact_xval.experiments.presentation.words import named
from impact_xval.experiments.tables.folder import RunFolder
from impact_xval.experiments.tables.numbers import number, percent
from impact_xval.experiments.tables.parquet import column, selected

#: D that is trusted, from the strictest on.
LEVELS = (0.01, 0.05, 0.2)

#: Of the fields of every level, and of those beyond the last: told apart by those who see no red or no green.
_COLORS = ("#08519C", "#6BAED6", "#FEE391", "#A63603")

#: Nothing to compare; nothing beyond the lowest level.
_EMPTY, _WITHIN = "white", "0.9"

#: Sides of the plane: up, and across.
_PLANE = ("mass_ratio", "stiffness_ratio")
_NAMES = [f"{c.name}_share" for c in CONTRIBUTIONS]

Codes = NDArray[np.int64]


@dataclass(frozen=True, slots=True, eq=False)
class Trust:
    """Trust in one engine; every array has the shape (values of m2/m1, values of k2/k1).

    Attributes
    ----------
    solver : str
        The engine.
    cells : ndarray of int
        Cells of the field that are compared: unmarked, and with a result.
    typical, strict : ndarray of int
        Position in `LEVELS` of the level that the median cell, or every cell, stays within; 3 beyond all of them,
        -1 without a cell.
    blamed : ndarray of int
        Position in `CONTRIBUTIONS` of what is to blame; -1 where no cell is beyond the lowest level.
    """

    solver: str
    cells: Codes
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
    levels = []
    for axis in _PLANE:
        known = axis_levels(config, axis, column(path, axis))
        levels.append(Levels(sorted(known.values), known.edges))
    there = set(pq.read_schema(path).names)
    shares = [f"{c.name}_share" for c in CONTRIBUTIONS if f"{c.name}_share" in there]
    columns = ["solver", "status", "marked", *_PLANE, "velocity_divergence", *shares]
    engines = []
    for name in filter(is_engine, in_order_of_laws(config.solvers)):
        keep = (pc.field("solver") == name) & (pc.field("status") == "ok") & pc.field("marked").is_null()
        rows = selected(path, columns, keep).to_pandas()
        if len(rows):
            engines.append(_trust(name, rows, levels, shares))
    if not engines or min(len(each.values) for each in levels) < 2:
        return None
    scattered = config.sample is not None or config.cells is not None
    whole = 0 if scattered else math.prod(list(config.grid.lengths().values())[2:])
    return TrustMap(levels[1].values, levels[0].values, engines, whole)


def _trust(name: str, rows: Frame, levels: list[Levels], shares: list[str]) -> Trust:
    """Put the rows of one engine together by field."""
    field = [each.codes(rows[axis].to_numpy()) for axis, each in zip(_PLANE, levels, strict=True)]
    places = [range(len(each.values)) for each in levels]

    def laid(values: Frame, empty: int) -> NDArray[Any]:
        return (
            values.unstack()
            .reindex(index=places[0], columns=places[1])
            .fillna(empty)
            .to_numpy()
            .astype(np.int64)
        )

    d = rows.velocity_divergence
    by_field = d.groupby(field)
    typical, strict = (
        values.map(partial(bisect_left, LEVELS)) for values in (by_field.median(), by_field.max())
    )
    along = rows[shares].fillna(0.0).mul(d, axis=0)
    sums = along.where(d > LEVELS[0]).groupby(field).sum(min_count=1)
    largest = np.array([_NAMES.index(share) for share in shares])[
        sums.fillna(-np.inf).to_numpy().argmax(axis=1)
    ]
    blamed = pd.Series(np.where(sums.notna().any(axis=1), largest, -1), sums.index)
    return Trust(name, laid(by_field.size(), 0), laid(typical, -1), laid(strict, -1), laid(blamed, -1))


def draw_trust(trust: TrustMap | None) -> Iterator[tuple[str, Figure, str]]:
    """Draw a trust map: name, figure, caption; nothing where there is none."""
    if trust is not None:
        most = int(max(each.cells.max() for each in trust.engines))
        yield "trust-map", _figure(trust), _caption(trust, most)


def _caption(trust: TrustMap, most: int) -> str:
    first, second, *_ = levels = [number(100 * level) for level in LEVELS]
    dot = f" Dot: of its {trust.whole} cells some have no result, or are marked." if trust.whole else ""
    engines = "".join(
        f" {named(each.solver)}: the median cell is within {second} % in {percent(each.share(LEVELS[1]))} "
        "of the fields"
        + (f"; the largest cause is most often: {each.causes()[0][0].label}." if each.causes() else ".")
        for each in trust.engines
    )
    return (
        "Where engines end as the model does, over stiffness ratio k2/k1 and mass ratio m2/m1. A field "
        f"holds the cells of all restitutions, {most} at most. Left: the velocity divergence D that its "
        f"median cell stays within, {', '.join(f'{level} %' for level in levels)} or more; middle: that "
        "every cell of it stays within. Right: the cause with the largest part of D, summed over those of "
        f"its cells that are beyond {first} % (docs/ladder.md); grey: no cell is. White: nothing to "
        f"compare.{dot}{engines} Marked cells (beside a jump) are left out."
    )


def _figure(trust: TrustMap) -> Figure:
    rows = len(trust.engines)
    with drawing(7.4, 1.4 + 1.45 * rows) as figure:
        axes = figure.subplots(rows, 3, sharex=True, sharey=True, squeeze=False)
        titles = (
            "median cell is within",
            "every cell is within",
            f"largest cause beyond {100 * LEVELS[0]:g} %",
        )
        for ax, title in zip(axes[0], titles, strict=True):
            ax.set_title(title, fontsize=8.5)
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
            row[0].set_ylabel(f"{named(each.solver)}\nm2/m1 (-)")
        for axis, values, most in (
            (axes[0, 0].xaxis, trust.stiffness_ratio, 5),
            (axes[0, 0].yaxis, trust.mass_ratio, 6),
        ):
            step = max(1, -(-(len(values) - 1) // (most - 1)))
            axis.set_ticks(range(0, len(values), step), [number(v, 3) for v in values[::step]])
        for ax in axes[-1]:
            ax.set_xlabel("k2/k1 (-)")
        names = [*(f"D up to {100 * level:g} %" for level in LEVELS), f"D above {100 * LEVELS[-1]:g} %"]
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
