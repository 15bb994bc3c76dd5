"""From answers to a board: how far each is from the model and from every exact law, and on what it depends."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd

from impact_xval.compliant_baselines.registry import engine_free_names, is_engine
from impact_xval.experiments.config.errors import UserError
from impact_xval.experiments.measures.aggregates import Frame
from impact_xval.experiments.measures.divergence import masses_and_starts, norms
from impact_xval.experiments.scoreboard.cases import CASES, STEPS, USUAL

MODEL = "state-transition"
#: Columns of the distances from all exact laws.
FROM_LAWS = [f"D_{law}" for law in engine_free_names()]
#: What is worst of a solver.
_WORST = ["spread", "step_spread", f"D_{MODEL}", "energy_gained", "energy_lost", "momentum_error"]

_CASE = ["solver", "case", "e"]

#: How spreads are sorted: those that rounding sets apart are ties, which keep their order on every platform.
_BY_SPREAD: dict[str, Any] = {"by": "spread", "kind": "stable", "key": lambda spread: spread.round(12)}


def judge(answers: Frame) -> Frame:
    """Judge answers as `playing.play` gives them: a row a solver and case, with its answer in the usual arrangement.

    ``D_<law>`` is from each exact law, ``D_nearest`` from the ``nearest``, all as near to 1e-6. Energy, gained and, at
    e = 1, lost, is over that before; the error of momentum, without a table, over all momenta. ``spread`` is the
    largest D between two placements, ``spread_of`` names the other, ``step_spread`` is by half and twice the step.
    """
    chains = [CASES[each] for each in zip(answers.case, answers.e, strict=True)]
    v, usual = answers.filter(regex=r"^v\d$").to_numpy(float), (answers.arrangement == USUAL).to_numpy()
    mass, before = masses_and_starts(chains, v.shape[1])
    outcomes = pd.DataFrame(v, index=pd.MultiIndex.from_frame(answers[_CASE]))[usual]

    def away_from(solver: Any) -> Any:
        """D from what a solver answers to the same case in the usual arrangement."""
        same = pd.MultiIndex.from_frame(answers[_CASE].assign(solver=solver))
        return norms(mass, v - outcomes.reindex(same).to_numpy(), before)

    kept = norms(mass, v, before) ** 2
    off = np.where(np.isnan(mass), 0.0, (v - before) * mass).sum(axis=1)
    momenta = np.where([each.table for each in chains], np.nan, np.nansum(mass * np.abs(before), axis=1))
    judged = answers.assign(
        **{name: away_from(name.removeprefix("D_")) for name in FROM_LAWS},
        energy_gained=np.maximum(kept - 1, 0.0),
        energy_lost=np.where(answers.e == 1, np.maximum(1 - kept, 0.0), np.nan),
        momentum_error=np.abs(off) / momenta,
    )
    away = answers[_CASE].assign(spread=away_from(answers.solver), spread_of=answers.arrangement)
    away = away[~usual].dropna(subset="spread")
    stepped = away.spread_of.isin(STEPS)
    placed = away[~stepped].sort_values(**_BY_SPREAD).drop_duplicates(_CASE, keep="last")
    steps = away[stepped].groupby(_CASE).spread.max().rename("step_spread")
    judged = judged[usual].drop(columns="arrangement").merge(placed, "left", _CASE).join(steps, on=_CASE)
    nearest = judged[FROM_LAWS].min(axis=1)
    near = judged[FROM_LAWS].le(nearest + 1e-6, axis=0)
    return judged.assign(D_nearest=nearest, nearest=near.dot(near.columns.str[2:] + ", ").str[:-2])


def laws(judged: Frame) -> Frame:
    """Find the exact law that explains each engine best: the one whose largest distance over all cases is the smallest.

    A row an engine that has an answer: ``law``, ``farthest``, the largest D from it, ``cases``, those answered;
    ``next`` with ``next_farthest``, of the law after it; and what is worst of all cases.
    """
    judged = judged[judged.solver.map(is_engine)]
    by_engine, D = (each.groupby(judged.solver, sort=False) for each in (judged, judged[FROM_LAWS]))
    cases = by_engine.v1.count()
    last = judged.sort_values(**_BY_SPREAD, na_position="first").groupby("solver").last()
    # A law that answers fewer than nine in ten of an engine's cases is not the one that it follows.
    worst = D.max().where(D.count().ge(np.maximum(1, 0.9 * cases), axis=0))
    order = np.argsort(worst.to_numpy(), axis=1, kind="stable")
    names, farthest = worst.columns.str[2:].to_numpy()[order].T, np.sort(worst.to_numpy(), axis=1).T
    of_laws = {"law": names[0], "farthest": farthest[0], "next": names[1], "next_farthest": farthest[1]}
    found = pd.DataFrame({"version": last.version, "cases": cases} | of_laws, index=cases.index)
    found = found.join([last.spread_of, by_engine[_WORST].max(), last.microseconds])
    return found.dropna(subset="next_farthest")


def moved(before: Frame, after: Frame, tolerance: float = 1e-6) -> Frame:
    """List answers that moved, the farthest first: another status, or a velocity that differs by more, in m/s."""
    answer = [*_CASE, "arrangement"]
    both = before.merge(after, on=answer, suffixes=("_before", "_after"))
    if both.empty:
        raise UserError("--baseline: no answer in common; legal: a scoreboard of the same engines")
    old, new = (both.filter(regex=rf"^v\d_{side}$").to_numpy(float) for side in ("before", "after"))
    both["change"] = np.nan_to_num(np.abs(new - old)).max(axis=1)
    other = (both.status_before != both.status_after) | (np.isnan(old) != np.isnan(new)).any(axis=1)
    found = both[other | (both.change > tolerance)].sort_values("change", ascending=False, kind="stable")
    return found[[*answer, "status_before", "status_after", "change"]]
