"""``impact-xval map``: where the causes of divergence matter that need no engine, over k2/k1 and m2/m1."""

from __future__ import annotations

import math
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from impact_xval.experiments.commands.options import (
    CUTOFF,
    GRAVITY,
    K1,
    M1,
    SCENARIO,
    V0,
    folder_to_write,
    number_or_text,
    one_cell,
    whole,
)
from impact_xval.experiments.config.errors import UserError

if TYPE_CHECKING:
    from impact_xval.experiments.config.configuration import Config
    from impact_xval.experiments.measures.plane import Plane

FORMAT = "impact-xval map, format 1"
DATA, DESCRIPTION = "map.parquet", "map.json"


def _side(text: str) -> int:
    return whole("--side", text, 2, 5000)


def draw_map(
    context: typer.Context,
    e1: Annotated[str, typer.Option(metavar="E", help="Restitution of ball on ball, above 0, at most 1.")],
    e2: Annotated[str, typer.Option(metavar="E", help="Restitution of ball on table, above 0, at most 1.")],
    stiffness_ratio: Annotated[
        tuple[str, str], typer.Option(metavar="LO HI", help="Least and largest k2/k1; logarithmic.")
    ] = ("1e-3", "1e3"),
    mass_ratio: Annotated[
        tuple[str, str], typer.Option(metavar="LO HI", help="Least and largest m2/m1; logarithmic.")
    ] = ("0.1", "10"),
    side: Annotated[
        int, typer.Option(metavar="N", parser=_side, help="Cells along each side, 2 to 5000.")
    ] = 1000,
    out: Annotated[Path | None, folder_to_write("by default maps/SCENARIO-e1-E-e2-E")] = None,
    scenario: Annotated[str, SCENARIO] = "drop",
    gravity: Annotated[str | None, GRAVITY] = None,
    m1: Annotated[str, M1] = "1",
    k1: Annotated[str, K1] = "1e8",
    v0: Annotated[str, V0] = "-1",
    cutoff: Annotated[str, CUTOFF] = "exact",
) -> None:
    """Map where each cause of divergence matters that needs no engine, over k2/k1 and m2/m1.

    A million collisions by the model, by its law in real time and by spring and dashpot, all exact, in less than a
    minute: figures, and map.parquet with one row a cell. Mass, stiffness and velocity matter to a drop.
    """
    from impact_xval.experiments.measures.plane import write_plane
    from impact_xval.experiments.presentation.figures import CAPTIONS
    from impact_xval.experiments.presentation.plane_figures import draw_plane
    from impact_xval.experiments.presentation.style import save
    from impact_xval.experiments.presentation.terminal import make_console, print_line, show_progress
    from impact_xval.experiments.tables.folders import new_folder
    from impact_xval.experiments.tables.store import write_json

    start = time.perf_counter()
    config = one_cell(context.params)
    plane = _plane(config, stiffness_ratio, mass_ratio, side)
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


def findings(images: dict[str, Any]) -> list[str]:
    """Write in plain words what a map shows."""
    import numpy as np

    from impact_xval.experiments.measures.plane import PATHS, PLANE_CAUSES
    from impact_xval.experiments.presentation.pages import Paragraph, blocks_of, render

    there = ~images["failed"]
    norms = {cause: images[f"{cause.name}_norm"][there] for cause in PLANE_CAUSES}
    repeats = images["repeats_norm"][there]
    shares = [
        {
            "label": cause.label,
            "seen": np.mean(norms[cause] > 0.01),
            "most": norms[cause].max(),
            "largest": np.mean(images["dominant"][there] == i),
        }
        for i, cause in enumerate(PLANE_CAUSES)
        if norms[cause].size and norms[cause].max() > 0
    ]
    page = render(
        "map.md.j2",
        solved=int(there.sum()),
        failed=int((~there).sum()),
        shares=shares,
        equal=np.mean(repeats < 1e-12) if repeats.size else 0.0,
        away=np.mean(repeats > 0.01) if repeats.size else 0.0,
        most=repeats.max(initial=0.0),
        paths={text: np.mean(images["paths"] == code) for code, text in enumerate(PATHS)},
        data=DATA,
    )
    return [block.text for block in blocks_of(page) if isinstance(block, Paragraph)]


def _plane(config: Config, stiffness_ratio: tuple[str, str], mass_ratio: tuple[str, str], side: int) -> Plane:
    """Make a map of the options; errors name the options."""
    from impact_xval.experiments.measures.plane import Plane

    cell = config.figure_cell
    for name, e in (("--e1", cell.e1), ("--e2", cell.e2)):
        if e == 0:
            raise UserError(f"{name} = 0.0; legal: greater than 0, at most 1 (no dashpot gives 0)")
    return Plane(
        e1=cell.e1,
        e2=cell.e2,
        stiffness_ratio=_span("--stiffness-ratio", stiffness_ratio),
        mass_ratio=_span("--mass-ratio", mass_ratio),
        side=side,
        gravity=_gravity(config) if config.scenario == "drop" else 0.0,
        stiffness_ratio_cutoff=config.stiffness_ratio_cutoff,
    )


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
    from importlib.metadata import version

    from impact_xval.experiments.config.plain import plain_values
    from impact_xval.experiments.measures.plane import PLANE_SCHEMA

    axes = {name: getattr(plane, name) for name in ("stiffness_ratio", "mass_ratio")}
    return {
        "format": FORMAT,
        "e1": plane.e1,
        "e2": plane.e2,
        **{name: {"from": low, "to": high, "spacing": "log"} for name, (low, high) in axes.items()},
        "cells_along_a_side": plane.side,
        "scenario": config.scenario,
        "gravity_over_v0_sqrt_k1_m1": plane.gravity,
        "stiffness_ratio_cutoff": plain_values(plane.stiffness_ratio_cutoff),
        "version": version("impact-xval"),
        "columns": {field.name: field.metadata[b"meaning"].decode() for field in PLANE_SCHEMA},
        "findings": lines,
        "wall_time_s": round(seconds, 3),
    }
