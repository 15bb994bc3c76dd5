"""Figures of a dense map: where each engine-free cause of divergence matters in the plane of k2/k1 and m2/m1."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from matplotlib.colors import BoundaryNorm, ListedColormap, LogNorm
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from numpy.typing import NDArray

from impact_xval.experiments.measures.plane import PATHS, PLANE_CAUSES, Plane
from impact_xval.experiments.presentation.pages import phrase
from impact_xval.experiments.presentation.style import drawing
from impact_xval.experiments.tables.numbers import number

#: Norms are drawn between these, on a logarithmic scale.
_RANGE = (1e-5, 1.0)

_PATH_COLORS = ("#F7F7F7", "#CC79A7", "#009E73", "#B0B0B0")
_NORMS = {
    "frozen_positions_norm": "frozen positions: with gaps - without",
    "dissipation_law_norm": "dissipation law: dashpots - restitution",
    "gravity_norm": "gravity: with - without",
    "repeats_norm": "restart stiffness: Liu-Zhao-Brogliato - model",
}

Images = dict[str, NDArray]


def draw_plane(plane: Plane, images: Images) -> Iterator[tuple[str, Figure, str]]:
    """Draw the figures of a map: name, figure, caption.

    Parameters
    ----------
    plane : Plane
    images : dict of ndarray, shape (side, side)
        From `plane.write_plane`.
    """
    caption = phrase("captions.md.j2", "plane_causes", plane, _RANGE[0])
    yield "plane-causes", _causes(plane, images), caption
    caption = phrase("captions.md.j2", "plane_dominant_and_paths", plane)
    yield "plane-dominant-and-paths", _kinds(plane, images), caption


def _show(ax: Any, plane: Plane, image: NDArray, **options: Any) -> Any:
    """Draw an image over logarithmic axes."""
    low, high = np.log10(plane.stiffness_ratio), np.log10(plane.mass_ratio)
    shown = ax.imshow(
        image, origin="lower", aspect="auto", extent=(*low, *high), interpolation="nearest", **options
    )
    for axis, (first, last) in ((ax.xaxis, low), (ax.yaxis, high)):
        powers = np.arange(np.ceil(first - 1e-9), np.floor(last + 1e-9) + 1)
        axis.set_ticks(powers, [number(10.0**p, 2) for p in powers])
    ax.set_xlabel("stiffness ratio k2/k1 (-)")
    ax.grid(False)
    return shown


def _causes(plane: Plane, images: Images) -> Figure:
    names = [name for name in _NORMS if name != "gravity_norm" or plane.gravity]
    with drawing(9.4, 7.2 if len(names) > 3 else 3.8) as figure:
        rows = 2 if len(names) > 3 else 1
        axes = figure.subplots(rows, -(-len(names) // rows), squeeze=False, sharey=True)
        shown: Any = None
        for ax, name in zip(axes.flat, names, strict=True):
            image = np.where(images["failed"], np.nan, np.clip(images[name], _RANGE[0], None))
            shown = _show(ax, plane, image, cmap="magma", norm=LogNorm(*_RANGE))
            ax.set_title(_NORMS[name], fontsize=9)
        for row in axes:
            row[0].set_ylabel("mass ratio m2/m1 (-)")
        figure.colorbar(shown, ax=axes, label="kinetic norm of the difference of (v1, v2) (-)", extend="min")
    return figure


def _kinds(plane: Plane, images: Images) -> Figure:
    causes = PLANE_CAUSES if plane.gravity else PLANE_CAUSES[:2]
    dominant = np.where(images["dominant"] < 0, len(causes), images["dominant"])
    panels: list[tuple[NDArray, list[str], list[str], str]] = [
        (
            dominant,
            [*(cause.color for cause in causes), "#F7F7F7"],
            [*(cause.label for cause in causes), "no divergence"],
            "which cause carries most of D",
        ),
        (images["paths"], list(_PATH_COLORS), list(PATHS), "whether the state paths are alike"),
    ]
    with drawing(9.4, 4.9) as figure:
        axes = figure.subplots(1, 2, sharey=True)
        for ax, (image, colors, labels, title) in zip(axes, panels, strict=True):
            norm = BoundaryNorm(np.arange(len(colors) + 1) - 0.5, len(colors))
            _show(ax, plane, image, cmap=ListedColormap(colors), norm=norm)
            ax.set_title(title, fontsize=9)
            there = set(np.unique(image).tolist())
            handles = [
                Patch(facecolor=color, edgecolor="0.6", label=label)
                for code, (color, label) in enumerate(zip(colors, labels, strict=True))
                if code in there
            ]
            ax.legend(handles=handles, loc="upper center", bbox_to_anchor=(0.5, -0.16), fontsize=8)
        axes[0].set_ylabel("mass ratio m2/m1 (-)")
    return figure
