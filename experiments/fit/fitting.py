"""A fit: which law explains measured collisions, with which parameters, and how sure that is."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd

from impact_xval.experiments.config.errors import UserError
from impact_xval.experiments.fit.evidence import Evidence, evidence_of, left_out_of, weights_of
from impact_xval.experiments.fit.intervals import Interval, intervals_of
from impact_xval.experiments.fit.laws import Floats, Law, laws_of
from impact_xval.experiments.fit.next_experiment import Suggestion, furthest_apart, tells_stiffness
from impact_xval.experiments.fit.search import Objective, search
from impact_xval.experiments.fit.trials import Trials, read_trials, trials_of
from impact_xval.experiments.measures.aggregates import Frame

#: AIC above the least beyond which a law is out of the question, and its parameters have no intervals.
OUT = 10.0

Progress = Callable[[int, int, str], None]


@dataclass(frozen=True, slots=True, eq=False)
class Fitted:
    """A law fitted to trials.

    Attributes
    ----------
    law : Law
    objective : Objective
    best : ndarray, shape (P,)
        Parameters of least chi^2.
    evidence : Evidence
    intervals : tuple of Interval
        Of the free parameters; empty where there are none, or the law is out of the question.
    """

    law: Law
    objective: Objective
    best: Floats
    evidence: Evidence
    intervals: tuple[Interval, ...] = ()

    def interval(self, parameter: str) -> Interval | None:
        """Return that of a parameter, if it has one."""
        return next((each for each in self.intervals if each.parameter == parameter), None)

    @property
    def parameters(self) -> dict[str, float]:
        """Best values: ``k2/k1``, ``e1``, ``e2``, of those that the law has."""
        found = {name: float(value) for name, value in zip(self.law.parameters, self.best, strict=True)}
        if "e" in found:
            found["e1"] = found["e2"] = found.pop("e")
        return {"k2/k1": 10 ** found.pop("log_k"), **found} if "log_k" in found else found


@dataclass(frozen=True, slots=True, eq=False)
class FitResult:
    """What a fit found.

    Attributes
    ----------
    trials : Trials
    fitted : list of Fitted
        The law of least AIC first.
    skipped : dict
        Reasons by law that could not be fitted.
    apart : list of Suggestion
        Where laws that are not out of the question differ most.
    narrows : tuple of float, optional
        Mass ratio whose trial narrows the interval of k2/k1 of the best law most, and the standard deviation of
        log10 k2/k1 expected then, over that of now.
    """

    trials: Trials
    fitted: list[Fitted]
    skipped: dict[str, str]
    apart: list[Suggestion]
    narrows: tuple[float, float] | None

    @property
    def best(self) -> Fitted:
        """The law of least AIC."""
        return self.fitted[0]

    @property
    def in_question(self) -> list[Fitted]:
        """Laws whose AIC is within `OUT` of the least."""
        return [each for each in self.fitted if each.evidence.aic <= self.best.evidence.aic + OUT]

    @property
    def weights(self) -> Floats:
        """Akaike's weight of each law."""
        return weights_of(np.array([each.evidence.aic for each in self.fitted]))

    @property
    def parameters(self) -> Frame:
        """One row a law and free parameter; k2/k1 as such, not its logarithm."""
        rows = []
        for each in self.fitted:
            known = each.objective.fixed
            for at, name in enumerate(each.law.parameters):
                interval = each.interval(name)
                power = (lambda x: 10.0**x) if name == "log_k" else float
                rows.append(
                    {
                        "law": each.law.name,
                        "parameter": "k2/k1" if name == "log_k" else name,
                        "estimate": power(each.best[at]),
                        "low": np.nan if interval is None else power(interval.low),
                        "high": np.nan if interval is None else power(interval.high),
                        "open_low": interval is not None and interval.open_low,
                        "open_high": interval is not None and interval.open_high,
                        "flat": interval is not None and interval.flat,
                        "pieces": 0 if interval is None else interval.pieces,
                        "known": not np.isnan(known[at]),
                    }
                )
        return pd.DataFrame(rows)

    @property
    def predictions(self) -> Frame:
        """One row a law and trial; velocities in m/s, residuals in standard errors."""
        t, tables = self.trials, []
        for each in self.fitted:
            r1, r2 = np.split(each.objective.residuals(each.best), 2)
            columns = {"law": each.law.name, "row": t.rows, "trial": t.names, "group": t.groups}
            columns |= {"mass_ratio": t.mass_ratio}
            for i, v, sd, r in ((1, t.v1, t.sd1, r1), (2, t.v2, t.sd2, r2)):
                there = np.isfinite(sd)
                model = np.where(there, v + r * np.where(there, sd, 0.0), np.nan)
                columns |= {
                    f"v{i}_after [m/s]": np.where(there, v * t.speed, np.nan),
                    f"v{i}_fitted [m/s]": model * t.speed,
                    f"sd_v{i}_after [m/s]": np.where(there, sd * t.speed, np.nan),
                    f"residual{i}": np.where(there, -r, np.nan),
                }
            tables.append(pd.DataFrame(columns))
        return pd.concat(tables, ignore_index=True)

    @property
    def evidence(self) -> Frame:
        """One row a law, that of least AIC first."""
        rows = [
            {
                "law": each.law.name,
                "chi2": each.evidence.chi2,
                "measured": each.evidence.measured,
                "parameters": each.evidence.free,
                "aic": each.evidence.aic,
                "bic": each.evidence.bic,
                "weight": weight,
                "probability": each.evidence.probability,
                "left_out": each.evidence.left_out,
            }
            for each, weight in zip(self.fitted, self.weights, strict=True)
        ]
        return pd.DataFrame(rows)


def fit(
    data: str | Path | Frame,
    laws: str | Iterable[str] | None = None,
    progress: Progress | None = None,
    *,
    leave_out: bool = True,
) -> FitResult:
    """Fit laws to measured collisions by maximum likelihood.

    Parameters
    ----------
    data : path or DataFrame
        A row a collision, units in the headers: docs/measurements.md.
    laws : iterable of str, optional
        Names of `laws.LAWS`; by default all.
    progress : callable, optional
        Takes how many laws are fitted, of how many, and the name of the last.
    leave_out : bool
        Whether groups are left out in turn, and predicted by the others: most of the time.

    Returns
    -------
    FitResult

    Raises
    ------
    UserError
        If the file cannot be read, a law is unknown, or nothing is left to fit.
    """
    chosen = laws_of(laws)
    if not isinstance(data, str | os.PathLike | pd.DataFrame):
        raise UserError(f"data = {data!r:.60}; legal: a path, or a DataFrame of trials")
    trials = trials_of(data if isinstance(data, pd.DataFrame) else read_trials(Path(data)))
    fitted: list[Fitted] = []
    grids: dict[str, tuple[Floats, Floats, Floats]] = {}
    skipped: dict[str, str] = {}
    for done, law in enumerate(chosen):
        if progress:
            progress(done, len(chosen), law.name)
        objective = Objective.hold(law, trials)
        reason = _refused(objective)
        if reason:
            skipped[law.name] = reason
            continue
        places, _, points, chi2 = search(objective.pooled())
        fitted.append(Fitted(law, objective, places[0], evidence_of(objective, places[0])))
        grids[law.name] = places, points, chi2
    if not fitted:
        raise UserError(
            "nothing is left to fit: " + "; ".join(f"{name}: {why}" for name, why in skipped.items())
        )
    fitted = _profiled(fitted, grids, leave_out)
    if progress:
        progress(len(chosen), len(chosen), "")
    best, stiffness = fitted[0], fitted[0].interval("log_k")
    narrows = None if stiffness is None else tells_stiffness(best.objective, stiffness)
    found = FitResult(trials, fitted, skipped, [], narrows)
    in_question = {each.law.name: each.best for each in found.in_question}
    return replace(found, apart=furthest_apart(trials, in_question))


def _profiled(
    fitted: list[Fitted], grids: dict[str, tuple[Floats, Floats, Floats]], leave_out: bool
) -> list[Fitted]:
    """Add intervals to laws that are not out of the question, and order them all."""
    least = min(each.evidence.aic for each in fitted)
    found = []
    for each in fitted:
        if each.evidence.aic <= least + OUT:
            intervals, best = intervals_of(each.objective.pooled(), *grids[each.law.name])
            if not np.array_equal(best, each.best):  # a profile came by a better place
                each = replace(each, best=best, evidence=evidence_of(each.objective, best))
            if leave_out:
                each = replace(each, evidence=replace(each.evidence, left_out=left_out_of(each.objective)))
            each = replace(each, intervals=tuple(intervals))
        found.append(each)
    return sorted(found, key=lambda each: each.evidence.aic)


def _refused(objective: Objective) -> str | None:
    """Say why a law cannot be fitted; None if it can."""
    law, trials, known = objective.law, objective.trials, objective.trials.known
    free = int(objective.free.sum())
    if trials.measured < free:
        return f"{trials.measured} measured velocities for {free} parameters; legal: at least as many"
    if "e" in law.parameters and known.get("e1", known.get("e2")) != known.get("e2", known.get("e1")):
        return f"e1 = {known['e1']:g} and e2 = {known['e2']:g} are known; legal: one for both contacts"
    for name in ("e1", "e2"):
        if name in law.parameters and known.get(name, 1.0) < law.least:
            return f"{name} = {known[name]:g} is known; legal for this law: from {law.least:g}"
    return None
