"""Judgement of the answers of a scoreboard.

An answer is the outcome that a solver computes for one case, a collision of the scoreboard. For each answer this module
finds the distance from every exact law, the gain or loss of energy, the error of momentum, and how much the answer
depends on placement and time step. For each engine it finds the law that the engine follows.
"""

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

#: Name of the model among the exact laws.
MODEL = "state-transition"

#: Names of the columns with the distance D from an exact law, by the name of the law.
_DISTANCE_COLUMNS = {law: f"D_{law}" for law in exact_law_names()}
FROM_LAWS = list(_DISTANCE_COLUMNS.values())

#: Columns of the board that follow the columns of the answers, in their order.
BOARD_COLUMNS = (
    *FROM_LAWS,  # D from each exact law
    "energy_gained",  # energy gained, divided by the energy before
    "energy_lost",  # energy lost at e = 1, divided by the energy before
    "momentum_error",  # change of momentum, divided by the sum of absolute momenta before; only without a table
    "spread",  # largest D between the usual placement and another placement
    "spread_of",  # the other placement, with which this D is reached
    "step_spread",  # largest D between the usual time step and half or twice this step
    "D_nearest",  # least D from an exact law
    "nearest",  # the laws with this least D, separated by commas
)

#: Columns of the table of engines, in their order. A number without a comment is the largest value over all cases.
ENGINE_COLUMNS = (
    "version",
    "cases",  # number of cases for which the engine has an answer
    "asked",  # number of cases for which the engine was asked
    "law",  # nearest law: the exact law for which the engine's largest D is smallest
    "farthest",  # largest D from the nearest law
    "next",  # second nearest law
    "next_farthest",
    "spread_of",  # placement with the largest spread
    "spread",
    "step_spread",
    f"D_{MODEL}",
    "energy_gained",
    "energy_lost",
    "momentum_error",
    "microseconds",  # wall time of one time step
)

#: Columns of the board for which the table of engines shows the largest value over all cases.
_LARGEST_OF_CASES = ["spread", "step_spread", f"D_{MODEL}", "energy_gained", "energy_lost", "momentum_error"]

#: Least share of an engine's solved cases for which a law must have an answer too. A law with fewer answers is not
#: compared with the engine.
_LEAST_ANSWERED = 0.9

#: Largest difference between a law's D and the least D with which the law still counts as nearest.
_AS_NEAR = 1e-6

#: Columns that identify the answers of one solver to one case.
_CASE = ["solver", "case", "e"]

#: Columns that identify an answer.
ANSWER = [*_CASE, "arrangement"]


class AnsweredMotions(NamedTuple):
    """Velocities before and after the collision, for n answers.

    Arrays are of shape (n, N), where N is the largest number of balls. They are NaN where a case has fewer balls.
    """

    #: Solver, case and e of each answer.
    keys: Frame
    #: Masses in kg; velocities before and after the collision in m/s.
    masses: Floats
    before: Floats
    after: Floats
    #: Velocities after the collision in the usual arrangement, by solver, case and e.
    usual: Frame

    def distance_from(self, solver: str | pd.Series) -> Floats:
        """Return D between each answer and the answer of a given solver to the same case, shape (n,).

        The answer of the given solver is its answer in the usual arrangement.
        """
        same_case = pd.MultiIndex.from_frame(self.keys.assign(solver=solver))
        return norms(self.masses, self.after - self.usual.reindex(same_case).to_numpy(), self.before)


def judge_answers(answers: Frame) -> Frame:
    """Return the board: one row per solver and case, with the answer in the usual arrangement and `BOARD_COLUMNS`.

    `answers` is a table from `playing.collect_answers`.
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
    """Return the velocities of answers before and after the collision."""
    after = answers.filter(regex=r"^v\d$").to_numpy(float)
    collisions = [CASES[case] for case in zip(answers.case, answers.e, strict=True)]
    masses, before = masses_and_starts(collisions, after.shape[1])
    keys = answers[_CASE]
    usual = pd.DataFrame(after, index=pd.MultiIndex.from_frame(keys))
    return AnsweredMotions(keys, masses, before, after, usual[(answers.arrangement == USUAL).to_numpy()])


def _add_distances_from_laws(answers: Frame, motions: AnsweredMotions) -> Frame:
    """Return the answers with one more column for each exact law, which holds D from this law."""
    return answers.assign(**{column: motions.distance_from(law) for law, column in _DISTANCE_COLUMNS.items()})


def _add_energy_and_momentum(answers: Frame, motions: AnsweredMotions) -> Frame:
    """Return the answers with columns for the energy gained, the energy lost at e = 1, and the error of momentum."""
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
    """Return D between each answer in another arrangement and the answer in the usual arrangement.

    The column `spread` is this D, and the column `spread_of` is the other arrangement.
    """
    distances = answers[_CASE].assign(
        spread=motions.distance_from(answers.solver), spread_of=answers.arrangement
    )
    return distances[(answers.arrangement != USUAL).to_numpy()].dropna(subset="spread")


def _add_largest_spreads(judged: Frame, distances: Frame) -> Frame:
    """Return the board with columns for how much answers depend on placement and time step.

    The columns are the largest D between the usual placement and another placement, the name of this other placement,
    and the largest D between the usual time step and another step.
    """
    by_step = distances.spread_of.isin(STEPS)
    of_placement = _sort_by_spread(distances[~by_step]).drop_duplicates(_CASE, keep="last")
    of_step = distances[by_step].groupby(_CASE).spread.max().rename("step_spread")
    return judged.merge(of_placement, "left", _CASE).join(of_step, on=_CASE)


def _sort_by_spread(table: Frame) -> Frame:
    """Return rows sorted by `spread`; rows without a spread come first.

    Spreads that differ only by rounding count as equal. Rows with equal spreads keep their order, so that the order is
    the same on every platform.
    """
    return table.sort_values(
        "spread", kind="stable", key=lambda spread: spread.round(12), na_position="first"
    )


def _add_nearest_laws(judged: Frame) -> Frame:
    """Return the board with columns for the least D from an exact law, and the names of all laws at this D."""
    least = judged[FROM_LAWS].min(axis=1)
    is_nearest = judged[FROM_LAWS].le(least + _AS_NEAR, axis=0).to_numpy()
    names = [", ".join(compress(_DISTANCE_COLUMNS, nearest)) for nearest in is_nearest]
    return judged.assign(D_nearest=least, nearest=names)


def find_nearest_laws(judged: Frame) -> Frame:
    """Return for each engine with answers the exact law that explains it best, with the columns `ENGINE_COLUMNS`.

    For each law, the largest D of the engine over all cases is taken. The best law is the one for which this number is
    smallest.
    """
    judged = judged[judged.solver.map(is_engine)]
    by_engine = judged.groupby(judged.solver, sort=False)
    ranking = _rank_laws(judged)
    at_largest_spread = _sort_by_spread(judged).groupby("solver").last()
    engines = ranking.join(at_largest_spread[["version", "spread_of", "microseconds"]])
    engines = engines.join(by_engine[_LARGEST_OF_CASES].max())
    return engines[list(ENGINE_COLUMNS)].dropna(subset="next_farthest")


def _rank_laws(judged: Frame) -> Frame:
    """Return the two nearest laws of each engine, by the largest D between engine and law over all cases.

    Columns are the two laws, the engine's largest D from each law, and the numbers of cases that the engine solves and
    is asked for. If the largest D from two laws differ by rounding only, the law with the smaller mean D comes first.
    """
    v1 = judged.groupby(judged.solver, sort=False).v1
    cases = v1.count()
    distances = judged[FROM_LAWS].groupby(judged.solver, sort=False)
    is_answered = distances.count().ge(np.maximum(1, _LEAST_ANSWERED * cases), axis=0)
    largest = distances.max().where(is_answered).to_numpy()  # NaN comes last in the order
    order = np.lexsort((distances.mean().to_numpy().round(12), largest.round(12)))
    laws = np.array(list(_DISTANCE_COLUMNS), dtype=object)[order]
    ranked = np.take_along_axis(largest, order, axis=1)
    columns = {"cases": cases, "asked": v1.size(), "law": laws[:, 0], "farthest": ranked[:, 0]}
    return pd.DataFrame(columns | {"next": laws[:, 1], "next_farthest": ranked[:, 1]}, index=cases.index)


def list_moved_answers(before: Frame, after: Frame, tolerance: float = 1e-6) -> Frame:
    """Return those answers that differ between two tables of answers: changes of status, then the largest changes.

    An answer differs if the two tables have different statuses for it, if only one table has its velocities, or if a
    velocity changes by more than `tolerance` in m/s. The column `change` is the largest change of a velocity in m/s. It
    is NaN if one of the two tables has no velocities.
    """
    both = before.merge(after, on=ANSWER, suffixes=("_before", "_after"))
    if both.empty:
        raise UserError("--baseline: no answer in common; legal: a scoreboard of the same engines")
    # Velocities are v1, v2, ..., and in a plane v1x, v1z, ... Those of balls that a case does not have are NaN.
    old, new = (both.filter(regex=rf"^v\d[xz]?_{side}$").to_numpy(float) for side in ("before", "after"))
    both["change"] = pd.DataFrame(np.abs(new - old)).max(axis=1)
    both["has_other_status"] = both.status_before != both.status_after
    is_answered_once = (np.isnan(old) != np.isnan(new)).any(axis=1)
    changed = both[both.has_other_status | is_answered_once | (both.change > tolerance)]
    # A lost answer comes before all changes of a velocity, although it has no change that could be compared with them.
    changed = changed.sort_values(
        ["has_other_status", "change"], ascending=False, kind="stable", na_position="first"
    )
    return changed[[*ANSWER, "status_before", "status_after", "change"]]
