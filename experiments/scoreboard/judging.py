"""From answers to a board: how far each is from the model and from every exact law, and on what it depends."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from impact_xval.compliant_baselines.registry import engine_free_names
from impact_xval.experiments.config.errors import UserError
from impact_xval.experiments.scoreboard.cases import COLUMNS, STEPS, USUAL, Case

MODEL = "state-transition"

#: File of all answers in the folder of a scoreboard.
ANSWERS = "answers.parquet"

#: D up to which a law explains an answer, and from which on a spread is one of the outcome, not of its last digits.
EXPLAINED, CHANCE = 0.05, 0.1

#: Share of an engine's cases that a law must answer to be the one that it follows.
_ENOUGH = 0.75

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
        A row a solver and case: its answer, ``D_<law>`` of all exact laws, ``energy_error`` (gained, over that before;
        at e = 1 lost, too), ``momentum_error`` (without a table, over all momenta), ``spread`` (the largest D from the
        same case in another arrangement), ``spread_of`` (which), and ``step_spread`` (at half and twice the step).
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

    def apart(one: Any, other: Any) -> Any:
        return np.sqrt((one - other) ** 2 @ mass / (mass @ before**2))

    usual = answers[answers.arrangement == USUAL].drop(columns="arrangement").set_index("solver")
    v = velocities_of(usual)[:, : mass.size]
    of = dict(zip(usual.index, v, strict=True))
    nothing = np.full(mass.size, np.nan)
    kept = v**2 @ mass / (mass @ before**2)
    momentum = np.abs((v - before) @ mass) / (mass @ np.abs(before))
    others = answers[answers.arrangement != USUAL]
    base = np.array([of[solver] for solver in others.solver]).reshape(len(others), mass.size)
    away = (
        others.assign(D=apart(velocities_of(others)[:, : mass.size], base))
        .dropna(subset="D")
        .sort_values("D")
    )
    stepped = away.arrangement.isin(STEPS)
    worst = away[~stepped].drop_duplicates("solver", keep="last").set_index("solver")
    return usual.assign(
        **{f"D_{law}": apart(v, of.get(law, nothing)) for law in engine_free_names()},
        energy_error=np.abs(kept - 1) if case.e == 1 else np.maximum(kept - 1, 0.0),
        momentum_error=np.nan if column.table else momentum,
        spread=worst.D,
        spread_of=worst.arrangement.astype(object),
        step_spread=away[stepped].groupby("solver").D.max(),
    ).reset_index()


def laws(judged: Frame) -> Frame:
    """Find the exact law that explains each solver best: the one that it is least far from at worst.

    Returns
    -------
    DataFrame
        A row a solver that has an answer: ``law``, and ``farthest``, D from it at worst.
    """
    rows = {}
    for solver, own in judged.groupby("solver", sort=False):
        D = own[[f"D_{law}" for law in engine_free_names()]]
        enough = D.notna().sum() >= max(1, _ENOUGH * own.v1.notna().sum())
        if enough.any():
            worst = D.loc[:, enough].max()
            rows[solver] = {"law": str(worst.idxmin()).removeprefix("D_"), "farthest": worst.min()}
    return pd.DataFrame.from_dict(rows, orient="index", columns=["law", "farthest"])


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


def by_case(judged: Frame, solver: str, column: str) -> list[float]:
    """Give the largest value of a column for every case of a solver, in the order of the board; NaN without any."""
    own = judged[judged.solver == solver].groupby("case")[column].max()
    return [float(own.get(name, np.nan)) for name in COLUMNS]
