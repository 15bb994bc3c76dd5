"""`fit`, for Python: its result shows itself in a notebook."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, fields
from pathlib import Path

from impact_xval.experiments.fit import fitting
from impact_xval.experiments.fit.fitting import FitResult, Progress
from impact_xval.experiments.fit.page import facts_of
from impact_xval.experiments.measures.aggregates import Frame
from impact_xval.experiments.presentation.pages import parser, render


@dataclass(frozen=True, slots=True, eq=False)
class Fit(FitResult):
    """What a fit found; in a notebook it is a sentence and its tables."""

    def _repr_html_(self) -> str:
        return parser().render(render("fit_run.md.j2", **facts_of(self)))


def fit(
    data: str | Path | Frame, laws: str | Iterable[str] | None = None, progress: Progress | None = None
) -> Fit:
    """Fit laws to measured collisions by maximum likelihood.

    Parameters
    ----------
    data : path or DataFrame
        A row a collision, units in the headers: docs/measurements.md.
    laws : iterable of str, optional
        Names of `laws.LAWS`; by default all.
    progress : callable, optional
        Takes how many laws are fitted, of how many, and the name of the next.

    Returns
    -------
    Fit

    Raises
    ------
    UserError
        If the file cannot be read, a law is unknown, or nothing is left to fit.
    """
    found = fitting.fit(data, laws, progress)
    return Fit(*(getattr(found, field.name) for field in fields(found)))
