"""How an engine's error grows with its step, from the distances of a run's velocities from their limits dt -> 0."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from impact_xval.compliant_baselines.registry import is_engine
from impact_xval.experiments.measures.summary import Summary
from impact_xval.experiments.presentation.looks import look
from impact_xval.experiments.presentation.style import BESIDE, Drawn, drawing
from impact_xval.experiments.presentation.words import named

#: The error, per |v0|, that steps are recommended for.
ACCEPTED = 0.01


def recommended(summary: Summary) -> dict[str, float]:
    """Return, by engine, the step, over the faster contact period, with an error of `ACCEPTED` in 95 % of the cells.

    It is extrapolated from the step of the run by the order that was measured.
    """
    rows = summary.estimates.to_dict("records") if summary.config.column is None else []
    return {
        row["solver"]: summary.config.step_fraction * (ACCEPTED / row["step_p95"]) ** (1 / row["order"])
        for row in rows
        if is_engine(row["solver"]) and row["step_p95"] > 0 and row["order"] > 0
    }


def draw_steps(summary: Summary) -> Iterator[Drawn]:
    """Draw the error over the step; nothing where no engine has a limit."""
    steps, f = recommended(summary), summary.config.step_fraction
    if not steps:
        return
    known = summary.estimates.set_index("solver")
    with drawing(6.2, 3.2) as figure:
        ax = figure.subplots()
        for position, (name, step) in enumerate(steps.items()):
            style, h = look(name, position), np.geomspace(f, max(4 * f, min(0.1, 1.5 * step)), 20)
            for cut, width, label in (("median", 0.9, None), ("p95", 1.8, named(name))):
                error = known[f"step_{cut}"][name]
                ax.plot(f, error, color=style.color, marker=style.marker)
                line = {"color": style.color, "linestyle": "--", "linewidth": width, "label": label}
                ax.plot(h, error * (h / f) ** known.order[name], **line)
        ax.axhline(ACCEPTED, color="0.4", linewidth=1)
        ax.set_xscale("log")
        ax.set_yscale("log")
        ax.set_xlabel("step / period of the faster contact (-)")
        ax.set_ylabel("error of a velocity / |v0| (-)")
        ax.legend(**BESIDE)
    yield (
        "error-by-step",
        figure,
        "Error that an engine's step makes in a final velocity, per |v0|, over the step. Markers: median (thin) "
        "and 95th percentile (thick) over the cells at the step of this run; dashed: extrapolated by the order "
        f"measured in this run. Grey: {100 * ACCEPTED:.0f} %.",
    )
