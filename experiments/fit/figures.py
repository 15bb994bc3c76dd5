"""A fit as pictures: measured beside fitted, residuals, profiles, and where laws differ."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from matplotlib.figure import Figure

from impact_xval.experiments.fit.fitting import FitResult
from impact_xval.experiments.fit.intervals import THRESHOLD
from impact_xval.experiments.fit.next_experiment import mass_ratios
from impact_xval.experiments.presentation.looks import CONTACT_COLORS, look
from impact_xval.experiments.presentation.pages import phrase
from impact_xval.experiments.presentation.style import drawing

_WORDS = "fit_words.md.j2"
#: Rise of chi^2 up to which a profile is drawn.
_HIGHEST = 4 * THRESHOLD
_AXES = {"log_k": "log10 k2/k1 (-)", "e1": "e1 (-)", "e2": "e2 (-)", "e": "e (-)"}


def draw_fit(result: FitResult) -> Iterator[tuple[str, Figure, str]]:
    """Draw what was found: name, figure, caption."""
    law = result.best.law.name
    yield "fitted", _fitted(result), phrase(_WORDS, "caption_fitted", law)
    if result.best.intervals:
        yield "profiles", _profiles(result), phrase(_WORDS, "caption_profiles", THRESHOLD)
    yield "laws", _laws(result), phrase(_WORDS, "caption_laws")


def _fitted(result: FitResult) -> Figure:
    """Measured over fitted velocities, and the residuals of each trial."""
    rows = result.predictions[result.predictions.law == result.best.law.name]
    with drawing(9.2, 3.8) as figure:
        left, right = figure.subplots(1, 2, width_ratios=(1, 1.4))
        at = np.arange(1, len(rows) + 1)
        for i, color, marker in ((1, CONTACT_COLORS[0], "o"), (2, CONTACT_COLORS[1], "s")):
            looks = {"color": color, "marker": marker, "linestyle": "", "label": f"ball {i}"}
            fitted, measured = rows[f"v{i}_fitted [m/s]"], rows[f"v{i}_after [m/s]"]
            left.errorbar(fitted, measured, yerr=rows[f"sd_v{i}_after [m/s]"], **looks)
            right.plot(at + 0.15 * (i - 1), rows[f"residual{i}"], **looks)
        left.axline((0, 0), slope=1, color="0.5", linewidth=0.8)
        left.set_xlabel("velocity after, fitted (m/s)")
        left.set_ylabel("measured (m/s)")
        right.axhspan(-2, 2, color="0.93", zorder=0)
        right.set_xlabel("trial, in the order of the file")
        right.set_ylabel("residual, measured - fitted (standard errors)")
        right.legend()
    return figure


def _profiles(result: FitResult) -> Figure:
    intervals = result.best.intervals
    with drawing(3.1 * len(intervals), 2.9) as figure:
        for ax, interval in zip(figure.subplots(1, len(intervals), squeeze=False)[0], intervals, strict=True):
            near = interval.profile <= 2 * _HIGHEST
            color = look(result.best.law.name).color
            ax.plot(interval.values[near], interval.profile[near], marker=".", color=color)
            ax.axhline(THRESHOLD, color="0.5", linewidth=0.8)
            ax.axvspan(interval.low, interval.high, color="#56B4E9", alpha=0.25)
            ax.set_ylim(0, _HIGHEST)
            reach = max(interval.high - interval.low, 1e-6)
            ax.set_xlim(interval.low - reach, interval.high + reach)
            ax.set_xlabel(_AXES[interval.parameter])
            ax.set_ylabel("chi^2 above the least (-)")
    return figure


def _laws(result: FitResult) -> Figure:
    """Velocities of each law in question at its best fit over the mass ratio, with the data."""
    t, ratios = result.trials, mass_ratios(result.trials)
    with drawing(9.2, 3.6) as figure:
        axes = figure.subplots(1, 2, sharex=True)
        for at, each in enumerate(result.in_question):
            drawn = look(each.law.name, at)
            for ax, v in zip(axes, each.law.velocities(each.best, ratios), strict=True):
                ax.plot(ratios, v, color=drawn.color, linestyle=drawn.dash, label=each.law.name)
        for i, (ax, v, sd) in enumerate(zip(axes, (t.v1, t.v2), (t.sd1, t.sd2), strict=True), 1):
            there = np.isfinite(sd)
            ax.errorbar(t.mass_ratio[there], v[there], yerr=sd[there], color="0.4", marker="o", linestyle="")
            ax.set_xscale("log")
            ax.set_xlabel("m2/m1 (-)")
            ax.set_ylabel(f"v{i} after, per speed of impact (-)")
            if result.apart:
                ax.axvline(result.apart[0].mass_ratio, color="0.6", linewidth=0.8, linestyle=":")
        axes[0].legend(fontsize=7)
    return figure
