"""How an engine's error grows with its step, from the distances of a run's velocities from their limits dt -> 0."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pyarrow.compute as pc
from matplotlib.figure import Figure

from impact_xval.compliant_baselines.registry import is_engine
from impact_xval.experiments.measures.aggregates import Frame
from impact_xval.experiments.measures.summary import Summary
from impact_xval.experiments.presentation.looks import look
from impact_xval.experiments.presentation.style import drawing
from impact_xval.experiments.presentation.words import named
from impact_xval.experiments.tables.folder import RunFolder
from impact_xval.experiments.tables.parquet import selected

#: The error, per |v0|, that steps are recommended for, and the share of cells that it is kept in.
ACCEPTED, KEPT = 0.01, 0.95


def recommended(summary: Summary) -> dict[str, float]:
    """Return, by engine, the step, over the faster contact period, with an error of `ACCEPTED` in `KEPT` of the cells.

    It is extrapolated from the step of the run by the order that was measured.
    """
    rows = summary.estimates.to_dict("records") if summary.config.column is None else []
    return {
        row["solver"]: summary.config.step_fraction * (ACCEPTED / row["step_p95"]) ** (1 / row["order"])
        for row in rows
        if is_engine(row["solver"]) and row["step_p95"] > 0 and row["order"] > 0
    }


def draw_steps(folder: RunFolder, summary: Summary) -> Iterator[tuple[str, Figure, str]]:
    """Draw the error over the step: name, figure, caption; nothing where no engine has a limit."""
    steps = recommended(summary)
    if not steps:
        return
    f = summary.config.step_fraction
    known = ["v0", "v1", "v2", "v1_limit", "v2_limit"]
    with drawing(6.2, 3.2) as figure:
        ax = figure.subplots()
        for position, (name, step) in enumerate(steps.items()):
            order = float(summary.estimates.set_index("solver").order[name])
            keep = (
                (pc.field("solver") == name) & pc.field("v1_limit").is_valid() & (pc.field("status") == "ok")
            )
            error = _distance(selected(folder.table_path("cells.parquet"), known, keep).to_pandas())
            style, h = look(name, position), np.geomspace(f, max(4 * f, min(0.1, 1.5 * step)), 20)
            for q, width in ((0.5, 0.9), (KEPT, 1.8)):
                at = float(np.quantile(error, q))
                ax.plot(f, at, color=style.color, marker=style.marker)
                label = named(name) if q == KEPT else None
                ax.plot(
                    h, at * (h / f) ** order, color=style.color, linestyle="--", linewidth=width, label=label
                )
        ax.axhline(ACCEPTED, color="0.4", linewidth=1)
        ax.set_xscale("log")
        ax.set_yscale("log")
        ax.set_xlabel("step / period of the faster contact (-)")
        ax.set_ylabel("error of a velocity / |v0| (-)")
        ax.legend(loc="center left", bbox_to_anchor=(1.01, 0.5))
    yield (
        "error-by-step",
        figure,
        (
            "Error that an engine's step makes in a final velocity, per |v0|, over the step. Markers: "
            f"median (thin) and {100 * KEPT:.0f}th percentile (thick) over the cells at the step of this "
            f"run; dashed: extrapolated by the order measured in this run. Grey: {100 * ACCEPTED:.0f} %."
        ),
    )


def _distance(rows: Frame) -> np.ndarray:
    """Distance of the velocities at the step from the limit, the larger of both balls, per abs(v0)."""
    speed = rows.v0.abs()
    return np.maximum(
        (rows.v1 / speed - rows.v1_limit).abs(), (rows.v2 / speed - rows.v2_limit).abs()
    ).to_numpy()
