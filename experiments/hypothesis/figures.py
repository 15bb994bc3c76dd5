"""The figure of a test: how far each solver is from the closed form, over the contrast."""

from __future__ import annotations

import textwrap
from pathlib import Path
from typing import Any

import numpy as np

from impact_xval.compliant_baselines.registry import is_engine
from impact_xval.experiments.hypothesis.cases import CASES, LOSSY
from impact_xval.experiments.hypothesis.run import Results
from impact_xval.experiments.presentation.looks import Look, look
from impact_xval.experiments.presentation.style import drawing, save
from impact_xval.experiments.presentation.words import named

#: Distances below this are not drawn: rounding.
_FLOOR = 1e-13

_LOOKS = {
    "kelvin-voigt-anchored": Look("#56B4E9", "<", "--"),
    "kelvin-voigt-textbook": Look("#8C8C8C", "x", (0, (1, 1))),
    "hunt-crossley": Look("#7A4B1E", "P", "-"),
    "liu-zhao-brogliato": Look("#5D3A9B", "*", (0, (3, 1))),
}
_X = {"k1/k2": "k1/k2", "k2/k1": "k2/k1", "1/e1^2": "1/e1$^2$", "1/e2^2": "1/e2$^2$"}

CAPTION = (
    "D = sqrt((m1 dv1^2 + m2 dv2^2)/(m1 v0^2)) from the closed form of the limit: median over the points none of whose "
    "other contacts is elastic. Open markers: engines, in the limit dt -> 0. A line that levels out goes to another "
    "limit."
)


def write_figure(results: Results, folder: Path) -> str:
    """Draw it into a folder, as SVG and PDF; return its name."""
    folder.mkdir(parents=True, exist_ok=True)
    usable: Any = results.outcomes[results.outcomes.used & results.outcomes["class"].isin(LOSSY)]
    with drawing(10.0, 6.0) as figure:
        axes = figure.subplots(2, 3)
        handles: dict[str, Any] = {}
        for ax, case in zip(axes.flat, CASES, strict=True):
            for name in results.solvers:
                here = usable[(usable["case"] == case.key) & (usable.solver == name)]
                by_contrast = here.groupby("contrast").distance.agg(["median", "size"])
                known = by_contrast["size"] > here.point.nunique() / 2
                median = by_contrast["median"].where(known & (by_contrast["median"] >= _FLOOR), np.nan)
                style, engine = (
                    _LOOKS.get(name) or look(name, results.config.solvers.index(name)),
                    is_engine(name),
                )
                (line,) = ax.loglog(
                    median.index,
                    median,
                    color=style.color,
                    linestyle="none" if engine else style.dash,
                    marker=style.marker if engine else "",
                    markerfacecolor="none",
                    zorder=3 if engine else 2,
                )
                handles.setdefault(named(name), line)
            ax.set_xlabel(f"contrast {_X[case.variable]} (-)")
            ax.set_title(textwrap.fill(case.title, 34), fontsize=8.5)
        for ax in axes[:, 0]:
            ax.set_ylabel("distance from the closed form, D (-)")
        figure.legend(list(handles.values()), list(handles), loc="outside lower center", ncols=5)
    save(figure, folder, "distance")
    return "distance"
