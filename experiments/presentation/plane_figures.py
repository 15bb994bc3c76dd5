"""Figures of a dense map: where each engine-free cause of divergence matters in the plane of k2/k1 and m2/m1."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from matplotlib.colors import BoundaryNorm, ListedColormap, LogNorm
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from numpy.typing import NDArray

from impact_xval.experiments.measures.plane import PATHS, RUNGS, Plane
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
    yield "plane-causes", *_causes(plane, images)
    yield "plane-dominant-and-paths", *_kinds(plane, images)


def _where(plane: Plane) -> str:
    gravity = f", g/(|v0| sqrt(k1/m1)) = {number(plane.gravity)}" if plane.gravity else ", no gravity"
    return f"e1 = {number(plane.e1)}, e2 = {number(plane.e2)}{gravity}"


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


def _causes(plane: Plane, images: Images) -> tuple[Figure, str]:
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
    return figure, (
        f"Where each cause of divergence that needs no engine matters, over {plane.side} x {plane.side} collisions at "
        f"{_where(plane)}. Colour: kinetic norm, sqrt(dv1^2 + (m2/m1) dv2^2) per |v0|, of the difference of final "
        "velocities between exact solvers that differ in this alone, the mean over the orders in which positions, law "
        "and gravity can be changed; black: "
        f"{number(_RANGE[0])} or less. Sharp edges are jumps of the model and of bistiffness, whose outcomes are "
        "discontinuous where a compression just ends or just does not. 'Restart stiffness' is the second impulse-level "
        "model, in which a repeated compression starts at the original stiffness."
    )


def _kinds(plane: Plane, images: Images) -> tuple[Figure, str]:
    rungs = RUNGS if plane.gravity else RUNGS[:2]
    dominant = np.where(images["dominant"] < 0, len(rungs), images["dominant"])
    panels: list[tuple[NDArray, list[str], list[str], str]] = [
        (
            dominant,
            [*(rung.color for rung in rungs), "#F7F7F7"],
            [*(rung.label for rung in rungs), "no divergence"],
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
    return figure, (
        f"What divergence is made of, over {plane.side} x {plane.side} collisions at {_where(plane)}. Left: the cause "
        "with the largest share of D, the kinetic norm of the difference of kelvin-voigt in this scenario from the "
        "model; a share is the component along the whole difference of the cause, the mean over all orders of the "
        "causes. Right: whether bistiffness and "
        "kelvin-voigt, without gravity, pass through the same contact states (S1 both contacts active, S2 ball on "
        "table, S3 ball on ball, S4 none) as the model; where a closed-form limit ended a path, that is not told."
    )
