"""The board of the scoreboard, from answers: distances from the model and every exact law, and what they depend on."""

from __future__ import annotations

from itertools import compress
from typing import NamedTuple

import numpy as np
import pandas as pd

from impact_xval.compliant_baselines.registry import exact_law_names, is_engine
from impact_xval.experiments.config.errors import UserError
from impact_xval.experiments.measures.divergence import masses_and_starts, norms
from impact_xval.experiments.scoreboard.cases import CASES, STEPS, USUAL
from impact_xval.experiments.tables.frames import Frame
from impact_xval.model.arrays import Floats

MODEL = "state-transition"

#: Columns of the distances from the exact laws, by law.
_DISTANCE_COLUMNS = {law: f"D_{law}" for law in exact_law_names()}
FROM_LAWS = list(_DISTANCE_COLUMNS.values())

#: Columns of the board after those of the answers, in their order.
BOARD_COLUMNS = (
    *FROM_LAWS,  # D from each exact law
    "energy_gained",  # over the energy before
    "energy_lost",  # over the energy before, at e = 1
    "momentum_error",  # over the sum of absolute momenta before, without a table
    "spread",  # largest D between the usual placement and another
    "spread_of",  # that other placement
    "step_spread",  # largest D by half and twice the step
    "D_nearest",  # least D from an exact law
    "nearest",  # the laws at that D, separated by commas
)

#: Columns of the table of engines, in their order; each is the largest of all cases but where said.
ENGINE_COLUMNS = (
    "version",
    "cases",  # how many an engine answers
    "law",  # the exact law with the smallest largest D
    "farthest",  # that D
    "next",  # the law after it
    "next_farthest",
    "spread_of",  # the placement of the largest spread
    "spread",
    "step_spread",
    f"D_{MODEL}",
    "energy_gained",
    "energy_lost",
    "momentum_error",
    "microseconds",  # of one step
)

#: Columns of the board whose largest value over all cases is shown of an engine.
_LARGEST_OF_CASES = ["spread", "step_spread", f"D_{MODEL}", "energy_gained", "energy_lost", "momentum_error"]

#: Share of an engine's cases that a law must answer to be the one that the engine follows.
_LEAST_ANSWERED = 0.9

#: Laws whose D exceeds the least by no more are nearest too.
_AS_NEAR = 1e-6

_CASE = ["solver", "case", "e"]


class AnsweredMotions(NamedTuple):
    """Velocities of n answers beside those before, shape (n, N) in m/s; NaN where a case has fewer balls."""

    #: Solver, case and e of each answer.
    keys: Frame
    #: Masses in kg.
    masses: Floats
    before: Floats
    after: Floats
    #: Velocities after the collision in the usual arrangement, by solver, case and e.
    usual: Frame

    def distance_from(self, solver: str | pd.Series) -> Floats:
        """Return D of each answer from the usual one of a solver to the same case, shape (n,)."""
        same_case = pd.MultiIndex.from_frame(self.keys.assign(solver=solver))
        return norms(self.masses, self.after - self.usual.reindex(same_case).to_numpy(), self.before)


def judge_answers(answers: Frame) -> Frame:
    """Judge answers as `playing.collect_answers` gives them.

    Return one row per solver and case, with its answer in the usual arrangement and `BOARD_COLUMNS`.
    """
    motions = _motions_of(answers)
    is_usual = (answers.arrangement == USUAL).to_numpy()
    judged = _add_distances_from_laws(answers, motions)
    judged = _add_energy_and_momentum(judged, motions)
    judged = judged[is_usual].drop(columns="arrangement")
    judged = _add_largest_spreads(judged, _distances_from_usual(answers, motions))
    judged = _add_nearest_laws(judged)
    return judged[[*answers.columns.drop("arrangement"), *BOARD_COLUMNS]]


def _motions_of(answers: Frame) -> AnsweredMotions:
    """Return the velocities of answers, and those before."""
    after = answers.filter(regex=r"^v\d$").to_numpy(float)
    collisions = [CASES[case] for case in zip(answers.case, answers.e, strict=True)]
    masses, before = masses_and_starts(collisions, after.shape[1])
    keys = answers[_CASE]
    usual = pd.DataFrame(after, index=pd.MultiIndex.from_frame(keys))
    return AnsweredMotions(keys, masses, before, after, usual[(answers.arrangement == USUAL).to_numpy()])


def _add_distances_from_laws(answers: Frame, motions: AnsweredMotions) -> Frame:
    """Add D from each exact law."""
    return answers.assign(**{column: motions.distance_from(law) for law, column in _DISTANCE_COLUMNS.items()})


def _add_energy_and_momentum(answers: Frame, motions: AnsweredMotions) -> Frame:
    """Add the energy gained, the energy lost at e = 1, and the error of momentum without a table."""
    retained_energy = norms(motions.masses, motions.after, motions.before) ** 2
    momentum_changes = (motions.after - motions.before) * motions.masses
    momentum_change = np.where(np.isnan(motions.masses), 0.0, momentum_changes).sum(axis=1)
    momentum_before = np.nansum(motions.masses * np.abs(motions.before), axis=1)
    has_table = [CASES[case].table for case in zip(answers.case, answers.e, strict=True)]
    return answers.assign(
        energy_gained=np.maximum(retained_energy - 1, 0.0),
        energy_lost=np.where(answers.e == 1, np.maximum(1 - retained_energy, 0.0), np.nan),
        momentum_error=np.abs(momentum_change) / np.where(has_table, np.nan, momentum_before),
    )


def _distances_from_usual(answers: Frame, motions: AnsweredMotions) -> Frame:
    """Return D between the answers in the other arrangements and the usual one: `spread`, of `spread_of`."""
    distances = answers[_CASE].assign(
        spread=motions.distance_from(answers.solver), spread_of=answers.arrangement
    )
    return distances[(answers.arrangement != USUAL).to_numpy()].dropna(subset="spread")


def _add_largest_spreads(judged: Frame, distances: Frame) -> Frame:
    """Add the largest D by placement, and which placement it is, and the largest D by step."""
    by_step = distances.spread_of.isin(STEPS)
    of_placement = _sort_by_spread(distances[~by_step]).drop_duplicates(_CASE, keep="last")
    of_step = distances[by_step].groupby(_CASE).spread.max().rename("step_spread")
    return judged.merge(of_placement, "left", _CASE).join(of_step, on=_CASE)


def _sort_by_spread(table: Frame) -> Frame:
    """Sort rows by `spread`, those without one first.

    Spreads that only rounding sets apart are ties, which keep their order on every platform.
    """
    return table.sort_values(
        "spread", kind="stable", key=lambda spread: spread.round(12), na_position="first"
    )


def _add_nearest_laws(judged: Frame) -> Frame:
    """Add the least D from an exact law, and all laws that are as near."""
    least = judged[FROM_LAWS].min(axis=1)
    is_nearest = judged[FROM_LAWS].le(least + _AS_NEAR, axis=0).to_numpy()
    names = [", ".join(compress(_DISTANCE_COLUMNS, nearest)) for nearest in is_nearest]
    return judged.assign(D_nearest=least, nearest=names)


def find_nearest_laws(judged: Frame) -> Frame:
    """Find the exact law that explains each engine best: the one whose largest distance over all cases is the smallest.

    Return one row per engine that has an answer, with `ENGINE_COLUMNS`.
    """
    judged = judged[judged.solver.map(is_engine)]
    by_engine = judged.groupby(judged.solver, sort=False)
    ranking = _rank_laws(judged)
    at_largest_spread = _sort_by_spread(judged).groupby("solver").last()
    engines = ranking.join(at_largest_spread[["version", "spread_of", "microseconds"]])
    engines = engines.join(by_engine[_LARGEST_OF_CASES].max())
    return engines[list(ENGINE_COLUMNS)].dropna(subset="next_farthest")


def _rank_laws(judged: Frame) -> Frame:
    """Return by engine the two laws with the smallest largest D, these D, and how many cases the engine answers.

    Of laws that only rounding sets apart, the one with the smaller mean D comes first. Laws whose mean D is the same as
    well keep their order, on every platform.
    """
    cases = judged.groupby(judged.solver, sort=False).v1.count()
    distances = judged[FROM_LAWS].groupby(judged.solver, sort=False)
    is_answered = distances.count().ge(np.maximum(1, _LEAST_ANSWERED * cases), axis=0)
    largest = distances.max().where(is_answered).to_numpy()  # NaN comes last in the order
    order = np.lexsort((distances.mean().to_numpy().round(12), largest.round(12)))
    laws = np.array(list(_DISTANCE_COLUMNS), dtype=object)[order]
    ranked = np.take_along_axis(largest, order, axis=1)
    columns = {"cases": cases, "law": laws[:, 0], "farthest": ranked[:, 0]}
    return pd.DataFrame(columns | {"next": laws[:, 1], "next_farthest": ranked[:, 1]}, index=cases.index)


def list_moved_answers(before: Frame, after: Frame, tolerance: float = 1e-6) -> Frame:
    """List the answers that moved, the farthest first: another status, or a velocity that differs by more, in m/s."""
    answer = [*_CASE, "arrangement"]
    both = before.merge(after, on=answer, suffixes=("_before", "_after"))
    if both.empty:
        raise UserError("--baseline: no answer in common; legal: a scoreboard of the same engines")
    old, new = (both.filter(regex=rf"^v\d_{side}$").to_numpy(float) for side in ("before", "after"))
    both["change"] = np.nan_to_num(np.abs(new - old)).max(axis=1)
    has_other_status = both.status_before != both.status_after
    is_answered_once = (np.isnan(old) != np.isnan(new)).any(axis=1)
    changed = both[has_other_status | is_answered_once | (both.change > tolerance)]
    changed = changed.sort_values("change", ascending=False, kind="stable")
    return changed[[*answer, "status_before", "status_after", "change"]]
