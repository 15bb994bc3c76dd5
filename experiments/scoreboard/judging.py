"""From answers to a board: how far each is from the model and from every exact law, and on what it depends."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from impact_xval.compliant_baselines.registry import engine_free_names, is_engine, is_mapped, law_of
from impact_xval.experiments.config.errors import UserError
from impact_xval.experiments.measures.divergence import norms
from impact_xval.experiments.presentation.words import named
from impact_xval.experiments.scoreboard.cases import COLUMNS, STEPS, USUAL, Case

MODEL = "state-transition"

#: File of all answers in the folder of a scoreboard.
ANSWERS = "answers.parquet"

#: D up to which a law explains an answer, and from which on an answer hangs on how exactly bodies are placed.
EXPLAINED, SENSITIVE = 0.05, 0.1

#: Share of an engine's cases that a law must answer to be the one that it follows.
_ENOUGH = 0.9

#: Exact laws as a reader knows them.
LAW_WORDS = {
    MODEL: "as the state-transition model",
    "liu-zhao-brogliato": "as the model of Liu, Zhao and Brogliato",
    "bistiffness": "as the model's law in time",
    "kelvin-voigt": "as springs and dashpots that only push",
    "kelvin-voigt-anchored": "as springs and dashpots, the lower ball held",
    "kelvin-voigt-textbook": "as springs and dashpots with the textbook's damping",
    "hunt-crossley": "as springs damped in proportion to their depth",
    "compression-dashpot": "as springs with dashpots in compression only",
    "newton-restitution": "by Newton's restitution, all contacts at once",
    "poisson-restitution": "by Poisson's restitution, all contacts at once",
    "sequential-top": "one contact after the other, from the top",
    "sequential-bottom": "one contact after the other, from the bottom",
    "generalised-reflection": "by generalised reflections",
    "plastic-then-restitution": "first without rebound, then a rebound of each contact in turn",
}

#: Difference of the largest D from two laws up to which the cases do not tell them apart.
TIED = 1e-9

_KEY = ["solver", "case", "e", "arrangement"]

Frame = Any  # pandas: what its operators return is known to no type checker


def velocities_of(answers: Frame) -> NDArray[np.float64]:
    """Give velocities in m/s, shape (rows, balls), NaN without an answer and beyond the last ball."""
    return answers.filter(regex=r"^v\d+$").to_numpy(float)


def board(answers: Frame) -> Frame:
    """Judge every answer in the usual arrangement.

    Parameters
    ----------
    answers : DataFrame
        As `playing.play` gives them.

    Returns
    -------
    DataFrame
        A row a solver and case: its answer, ``D_<law>`` of all exact laws, ``energy_gained`` and, at e = 1,
        ``energy_lost`` (over that before), ``momentum_error`` (without a table, over all momenta), ``spread`` (the
        largest D from the same case in another arrangement), ``spread_of`` (which), and ``step_spread`` (at half and
        twice the step).
    """
    order = {name: place for place, name in enumerate(answers.solver.unique())}
    judged = [_judged(Case(*key), rows) for key, rows in answers.groupby(["case", "e"], sort=False)]
    return pd.concat(judged).sort_values(
        "solver", key=lambda names: names.map(order), kind="stable", ignore_index=True
    )


def _judged(case: Case, answers: Frame) -> Frame:
    """Judge all answers to one case."""
    column = case.arranged.column()
    mass, before = np.array(column.masses), np.array(column.velocities)

    usual = answers[answers.arrangement == USUAL].drop(columns="arrangement").set_index("solver")
    v = velocities_of(usual)[:, : mass.size]
    of = dict(zip(usual.index, v, strict=True))
    nothing = np.full(mass.size, np.nan)
    kept = norms(mass, v, before) ** 2
    momentum = np.abs((v - before) @ mass) / (mass @ np.abs(before))
    others = answers[answers.arrangement != USUAL]
    base = np.array([of[solver] for solver in others.solver]).reshape(len(others), mass.size)
    away = (
        others.assign(D=norms(mass, velocities_of(others)[:, : mass.size] - base, before))
        .dropna(subset="D")
        .sort_values("D")
    )
    stepped = away.arrangement.isin(STEPS)
    worst = away[~stepped].drop_duplicates("solver", keep="last").set_index("solver")
    return usual.assign(
        **{f"D_{law}": norms(mass, v - of.get(law, nothing), before) for law in engine_free_names()},
        energy_gained=np.maximum(kept - 1, 0.0),
        energy_lost=np.maximum(1 - kept, 0.0) if case.e == 1 else np.nan,
        momentum_error=np.nan if column.table else momentum,
        spread=worst.D,
        spread_of=worst.arrangement.astype(object),
        step_spread=away[stepped].groupby("solver").D.max(),
    ).reset_index()


def laws(judged: Frame) -> Frame:
    """Find the exact law that explains each solver best: the one whose largest distance over all cases is the smallest.

    Returns
    -------
    DataFrame
        A row a solver that has an answer: ``law``, ``farthest``, the largest D from it, ``answered``, its cases; and
        ``next`` with ``next_farthest``, of the law after it.
    """
    rows = {}
    for solver, own in judged.groupby("solver", sort=False):
        D = own[[f"D_{law}" for law in engine_free_names()]]
        answered = own.v1.notna().sum()
        worst = D.loc[:, D.notna().sum() >= max(1, _ENOUGH * answered)].max().sort_values(kind="stable")
        if len(worst) > 1:
            law, runner_up = (name.removeprefix("D_") for name in worst.index[:2])
            rows[solver] = (law, worst.iloc[0], answered, runner_up, worst.iloc[1])
    columns = ["law", "farthest", "answered", "next", "next_farthest"]
    return pd.DataFrame.from_dict(rows, orient="index", columns=columns)


def nearest(judged: Frame, best: Frame) -> Frame:
    """Add to each row the nearest exact law and D from it; of several as near the law of all the solver's cases."""
    names = np.array(engine_free_names())
    D = judged[[f"D_{law}" for law in names]].fillna(np.inf).to_numpy(float)
    least = D.min(axis=1)
    own = names == judged.solver.map(best.law).to_numpy(object)[:, None]
    as_near = least[:, None] + 1e-6 >= D
    law = names[np.argmax(np.where((own & as_near).any(axis=1)[:, None], own, least[:, None] == D), axis=1)]
    known = np.isfinite(least)
    return judged.assign(law=np.where(known, law, ""), D_nearest=np.where(known, least, np.nan))


def moved(before: Frame, after: Frame, tolerance: float) -> Frame:
    """List the answers that are not those of before: another status, or a velocity that differs by more, per m/s.

    Raises
    ------
    UserError
        Where they have no answer in common.
    """
    both = before.merge(after, on=_KEY, suffixes=("_before", "_after"), how="inner")
    if both.empty:
        raise UserError(
            "--baseline: no answer in common; legal: a folder of this command's, of the same engines"
        )
    old, new = (both.filter(regex=rf"^v\d+_{side}$").to_numpy(float) for side in ("before", "after"))
    width = min(old.shape[1], new.shape[1])
    change = np.abs(new[:, :width] - old[:, :width])
    both["change"] = np.where(np.isfinite(change), change, 0.0).max(axis=1, initial=0.0)
    other = (both.status_before != both.status_after) | (
        np.isfinite(old[:, :width]) != np.isfinite(new[:, :width])
    ).any(axis=1)
    return both[other | (both.change > tolerance)]


def read_answers(folder: Path) -> Frame:
    """Read the answers of a board that was made before.

    Raises
    ------
    UserError
        Where there are none.
    """
    try:
        return pd.read_parquet(folder / ANSWERS)
    except (OSError, ValueError) as error:
        raise UserError(f"--baseline = {folder}: holds no {ANSWERS} of a scoreboard: {error}") from None


class Board:
    """A scoreboard: solvers, their answers, and what is made of them."""

    def __init__(self, solvers: Frame, answers: Frame) -> None:
        self.solvers = solvers.set_index("solver")
        judged = board(answers)
        self.laws = laws(judged)
        self.judged = nearest(judged, self.laws)
        there = [name for name in self.solvers.index if name in self.laws.index]
        self.engines = [name for name in there if is_engine(name)]
        self.exact = [name for name in there if not is_engine(name)]

    def explained(self, solver: str) -> bool:
        """Whether an exact law is near to all that a solver answers."""
        return bool(self.laws.farthest[solver] <= EXPLAINED)

    def worst(self, solver: str, column: str) -> float:
        """Give the largest value of a column of a solver; NaN without any."""
        return float(self.judged[self.judged.solver == solver][column].max())

    def by_case(self, solver: str, column: str) -> list[float]:
        """Give the largest value of a column for every case of a solver, in their order; NaN without any."""
        own = self.judged[self.judged.solver == solver].groupby("case")[column].max()
        return [float(own.get(name, np.nan)) for name in COLUMNS]

    def called(self, solver: str) -> str:
        """Name a solver; an engine of compliant contacts that was set up for a law says so."""
        mapped = is_engine(solver) and law_of(solver) and ":" not in solver and not is_mapped(solver)
        return f"{named(solver)} (mapped)" if mapped else named(solver)

    def how(self, solver: str) -> str:
        """Say how a solver answers."""
        own = self.laws.loc[solver]
        if not self.explained(solver):
            return f"as no exact law (nearest: {own.law})"
        tied = own.next_farthest - own.farthest < TIED
        return LAW_WORDS[own.law] + (f"; {own.next} says the same here" if tied else "")
