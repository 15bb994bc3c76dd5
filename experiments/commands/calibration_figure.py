"""The figure of ``impact-xval calibrate``: convergence in the step, restitution and duration by both mappings."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import NullLocator

from impact_xval.experiments.commands.calibrate import STEP_FRACTIONS, Calibration
from impact_xval.experiments.presentation.style import drawing, look
from impact_xval.experiments.tables.numbers import number

#: Errors are drawn no smaller than this.
_FLOOR = 1e-9


def draw(calibration: Calibration) -> tuple[Figure, str]:
    """Draw convergence in the step, and restitution and duration by both mappings."""
    with drawing(11.0, 3.6) as figure:
        by_step, by_e, by_k = figure.subplots(1, 3)
        for position, engine in enumerate(calibration.engines):
            style = look(engine, position)
            _convergence(by_step, calibration, engine, style)
            for mapping, line in (("calibrated", "-"), ("naive", ":")):
                limits = calibration.limits_of(engine, mapping)
                if not limits.restitution_at_step.notna().any():
                    continue
                label = f"{engine}, {mapping}"
                for ax, axis, value in (
                    (by_e, "e", "restitution_at_step"),
                    (by_k, "k", "duration_ratio_at_step"),
                ):
                    grouped = limits.groupby(axis)[value]
                    middle, low, high = grouped.median(), grouped.min(), grouped.max()
                    marker = style.marker if mapping == "calibrated" else ""
                    ax.plot(
                        middle.index,
                        middle,
                        color=style.color,
                        linestyle=line,
                        marker=marker or None,
                        label=label,
                    )
                    ax.fill_between(middle.index, low, high, color=style.color, alpha=0.15, linewidth=0)
        by_step.set(xscale="log", yscale="log", xlabel="time step / contact period (-)")
        by_step.set_ylabel("error of restitution (-)")
        by_step.set_xticks(
            STEP_FRACTIONS, [f"{1e3 * fraction:g}e-3" for fraction in STEP_FRACTIONS], minor=False
        )
        by_step.xaxis.set_minor_locator(NullLocator())
        by_step.invert_xaxis()
        by_e.plot([0.2, 1], [0.2, 1], color="0.4", linewidth=0.8)
        by_e.set(xlabel="restitution asked for (-)", ylabel="restitution obtained (-)")
        by_k.set(xscale="log", xlabel="stiffness asked for (N/m)")
        by_k.set_ylabel("duration / duration asked for (-)")
        for ax, title in (
            (by_step, "a  calibrated, in the step"),
            (by_e, "b  restitution"),
            (by_k, "c  duration"),
        ):
            ax.set_title(title, loc="left", fontsize=9)
        for ax in (by_step, by_e):
            if ax.get_legend_handles_labels()[0]:
                ax.legend()
    caption = (
        "Single contacts, ball on table and ball on ball. a: largest error of the restitution over e = 0.2 to 0.9, "
        "six decades of stiffness and both contacts against the time step, by the calibrated mapping; grey lines have "
        f"the slope of first order. b: restitution obtained at a step of {number(STEP_FRACTIONS[0])} of a period, "
        "median and range over stiffness and contact, by the calibrated and by the naive mapping; the grey line is "
        "what was asked for. c: duration over that asked for against stiffness, median and range over e and contact. "
        "MuJoCo's naive numbers are per kilogram: with the masses of about 1 kg used here they come closer than with "
        "others."
    )
    return figure, caption


def _convergence(ax: Any, calibration: Calibration, engine: str, style: Any) -> None:
    steps = calibration.steps
    rows = steps[
        (steps.engine == engine) & (steps.mapping == "calibrated") & (steps.status == "ok") & (steps.e < 1)
    ]
    if not len(rows):
        return
    worst = (rows.restitution - rows.e).abs().groupby(rows.step_fraction).max().clip(lower=_FLOOR)
    ax.plot(worst.index, worst, color=style.color, marker=style.marker or None, label=engine)
    fraction = np.array([worst.index.min(), worst.index.max()])
    first_order = 0.7 * worst.iloc[-1] * fraction / fraction[-1]
    ax.plot(fraction, first_order, color="0.4", linewidth=0.8, zorder=1)
