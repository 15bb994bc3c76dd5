"""What ``impact-xval map`` does."""

from __future__ import annotations

import math
import time
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from impact_xval.experiments.commands.options import number_or_text, one_cell
from impact_xval.experiments.config.configuration import Config
from impact_xval.experiments.config.errors import UserError
from impact_xval.experiments.config.plain import plain_values
from impact_xval.experiments.measures.plane import (
    PATHS,
    PLANE_CAUSES,
    PLANE_SCHEMA,
    Plane,
    write_plane,
)
from impact_xval.experiments.presentation.figures import CAPTIONS
from impact_xval.experiments.presentation.plane_figures import draw_plane
from impact_xval.experiments.presentation.style import save
from impact_xval.experiments.presentation.terminal import make_console, print_line, show_progress
from impact_xval.experiments.tables.folders import new_folder
from impact_xval.experiments.tables.store import write_json

FORMAT = "impact-xval map, format 1"
DATA, DESCRIPTION = "map.parquet", "map.json"


def draw_map(
    values: dict[str, str],
    stiffness_ratio: tuple[str, str],
    mass_ratio: tuple[str, str],
    side: int,
    out: Path | None,
) -> None:
    """Solve and draw a dense map, and write everything into a folder.

    Raises
    ------
    UserError
        If a value is illegal, or the folder cannot be used.
    """
    start = time.perf_counter()
    plane, config = _plane(values, stiffness_ratio, mass_ratio, side)
    root = out if out is not None else Path("maps") / f"{config.scenario}-e1-{plane.e1:g}-e2-{plane.e2:g}"
    new_folder(root)
    console = make_console()
    try:
        with show_progress(console) as progress:
            images = write_plane(plane, root / DATA, progress)
    except KeyboardInterrupt:
        if not any(root.iterdir()):
            root.rmdir()
        raise
    captions = {}
    for name, figure, caption in draw_plane(plane, images):
        save(figure, root, name, dpi=200)
        captions[name] = caption
        print_line(console, f"{root / name}.png: {caption}")
    write_json(root / CAPTIONS, captions)
    seconds = time.perf_counter() - start
    lines = findings(images)
    write_json(root / DESCRIPTION, _description(plane, config, lines, seconds))
    for line in lines:
        print_line(console, line)
    print_line(console, f"{seconds:.0f} s; {plane.side**2} cells are in {root / DATA}")


def findings(images: dict[str, np.ndarray]) -> list[str]:
    """Say in plain words what a map shows."""
    there = ~images["failed"]
    n = int(there.sum())
    if not n:
        return ["No cell of the map could be solved."]
    lines = []
    for i, cause in enumerate(PLANE_CAUSES):
        norm = images[f"{cause.name}_norm"][there]
        if norm.max() > 0:
            carries = np.mean(images["dominant"][there] == i)
            lines.append(
                f"{cause.label}: more than 0.01 in {100 * np.mean(norm > 0.01):.1f} % of the cells, at most "
                f"{norm.max():.3g}; the largest cause in {100 * carries:.1f} %."
            )
    repeats = images["repeats_norm"][there]
    lines.append(
        f"the law of Liu, Zhao and Brogliato: equal to the model to 1e-12 in {100 * np.mean(repeats < 1e-12):.1f} % of "
        f"the cells, more than 0.01 away in {100 * np.mean(repeats > 0.01):.1f} %, at most {repeats.max():.3g}."
    )
    shares = (f"{text} in {100 * np.mean(images['paths'] == code):.1f} %" for code, text in enumerate(PATHS))
    lines.append("state paths: " + "; ".join(shares) + ".")
    if n < there.size:
        lines.append(f"{there.size - n} cells have no result: 'failed' in {DATA}.")
    return lines


def _plane(
    values: dict[str, str], stiffness_ratio: tuple[str, str], mass_ratio: tuple[str, str], side: int
) -> tuple[Plane, Config]:
    """Make a map of the options; errors name the options."""
    config = one_cell(values)
    for name, e in (("--e1", config.figure_cell.e1), ("--e2", config.figure_cell.e2)):
        if e == 0:
            raise UserError(f"{name} = 0.0; legal: greater than 0, at most 1 (no dashpot gives 0)")
    plane = Plane(
        e1=config.figure_cell.e1,
        e2=config.figure_cell.e2,
        stiffness_ratio=_span("--stiffness-ratio", stiffness_ratio),
        mass_ratio=_span("--mass-ratio", mass_ratio),
        side=side,
        gravity=_gravity(config) if config.scenario == "drop" else 0.0,
        stiffness_ratio_cutoff=config.stiffness_ratio_cutoff,
    )
    return plane, config


def _gravity(config: Config) -> float:
    """Return g/(abs(v0) sqrt(k1/m1)), all that a drop depends on beside its ratios."""
    scale = abs(config.v0) * math.sqrt(config.k1 / config.m1)
    gravity = config.gravity / scale if scale > 0 else math.inf
    if not 0 < gravity < math.inf:
        raise UserError(
            f"--gravity, --m1, --k1, --v0: g/(|v0| sqrt(k1/m1)) = {gravity!r} leaves double precision; "
            "legal: a finite number > 0"
        )
    return gravity


def _span(option: str, ends: tuple[str, str]) -> tuple[float, float]:
    low, high = map(number_or_text, ends)
    if isinstance(low, str) or isinstance(high, str) or not 1e-12 <= low < high <= 1e12:
        raise UserError(
            f"{option} = {ends[0]} {ends[1]}; legal: two numbers from 1e-12 to 1e12, the first smaller"
        )
    return low, high


def _description(plane: Plane, config: Config, lines: list[str], seconds: float) -> dict[str, Any]:
    return {
        "format": FORMAT,
        "e1": plane.e1,
        "e2": plane.e2,
        "stiffness_ratio": {
            "from": plane.stiffness_ratio[0],
            "to": plane.stiffness_ratio[1],
            "spacing": "log",
        },
        "mass_ratio": {"from": plane.mass_ratio[0], "to": plane.mass_ratio[1], "spacing": "log"},
        "cells_along_a_side": plane.side,
        "scenario": config.scenario,
        "gravity_over_v0_sqrt_k1_m1": plane.gravity,
        "stiffness_ratio_cutoff": plain_values(plane.stiffness_ratio_cutoff),
        "version": version("impact-xval"),
        "columns": {field.name: field.metadata[b"meaning"].decode() for field in PLANE_SCHEMA},
        "findings": lines,
        "wall_time_s": round(seconds, 3),
    }
