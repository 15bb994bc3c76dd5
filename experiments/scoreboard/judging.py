"""What moved between two boards, and which answers meet a condition."""

from __future__ import annotations

import math
import operator
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pandas as pd

from impact_xval.experiments.config.errors import UserError
from impact_xval.experiments.measures.aggregates import Frame
from impact_xval.experiments.scoreboard.board import VELOCITIES, answers_frame
from impact_xval.experiments.scoreboard.playing import EXACT
from impact_xval.experiments.tables.files import is_regular

#: The answers of a board, in its folder.
ANSWERS = "answers.parquet"

#: What identifies an answer.
KEY = ["solver", "case", "e", "arrangement"]

#: What a condition can be of, and the column of the board that holds it.
MEASURES = {
    "divergence": "divergence",
    "law-divergence": "law_divergence",
    "spread": "spread",
    "step-spread": "step_spread",
    "energy": "energy",
    "momentum-error": "momentum_error",
}
NO_ANSWER = "no answer"

_CONDITION = re.compile(r"\s*([a-z-]+)\s*([<>])\s*(\S+)\s*")
_SIDES = {"<": operator.lt, ">": operator.gt}


@dataclass(frozen=True, slots=True)
class Moves:
    """What moved between two boards.

    Attributes
    ----------
    rows : DataFrame
        Answers that moved: `KEY`, both statuses, and the largest change of a velocity over that of impact; the largest
        first, infinite where the status is another one.
    compared : int
        Answers that both boards have.
    alone : list of str
        Solvers that one board alone has.
    missing : list of str
        Solvers whose engine is not there, now or before.
    """

    rows: Frame
    compared: int
    alone: list[str]
    missing: list[str]


def moves(before: Frame, now: Frame, tolerance: float) -> Moves:
    """Compare the answers of two boards, those of engines that both had.

    Parameters
    ----------
    before, now : DataFrame
        Of `board.answers_frame`.
    tolerance : float
        Largest change of a velocity over that of impact that is none.
    """
    boards = (before, now)
    alone = sorted(set(before.solver) ^ set(now.solver))
    missing = sorted({name for each in boards for name in each[each.status == "unavailable"].solver})
    kept = [each[~each.solver.isin([*alone, *missing])] for each in boards]
    both = kept[0].merge(kept[1], how="outer", on=KEY, suffixes=(" before", " now"), sort=False)
    changes = pd.concat([(both[f"{v} now"] - both[f"{v} before"]).abs() for v in VELOCITIES], axis=1)
    other = both["status before"] != both["status now"]  # also where one board lacks the answer
    both["change"] = changes.max(axis=1).fillna(0.0).mask(other, math.inf)
    found = both[both.change > tolerance].sort_values("change", ascending=False, kind="stable")
    rows = found[[*KEY, "status before", "status now", "change"]].reset_index(drop=True)
    return Moves(rows, len(both), [name for name in alone if name not in missing], missing)


def read_answers(root: Path) -> Frame:
    """Read the answers of a board.

    Raises
    ------
    UserError
        If they are not there, or are none.
    """
    path, legal = root / ANSWERS, "legal: the folder that impact-xval scoreboard wrote"
    if not is_regular(path):
        raise UserError(f"--baseline {root}: has no {ANSWERS}; {legal}")
    try:
        found: Frame = pd.read_parquet(path)[list(answers_frame([]).columns)]
        found = found.astype(dict.fromkeys(("e", *VELOCITIES), float) | dict.fromkeys(_TEXTS, str))
    except (OSError, ValueError, KeyError, TypeError) as error:
        said = " ".join(str(error).split())
        raise UserError(f"--baseline {root}: {ANSWERS} cannot be read ({said:.100}); {legal}") from None
    if found[KEY].duplicated().any():
        raise UserError(f"--baseline {root}: {ANSWERS} has an answer twice; {legal}")
    return found


_TEXTS = ("solver", "case", "arrangement", "status")


def condition(text: str) -> Callable[[Frame], Frame]:
    """Read a condition: what finds the rows of a board, those of engines, that meet it.

    Raises
    ------
    UserError
        If it is none.
    """
    if text.strip() == NO_ANSWER:
        return lambda board: _engines(board)[lambda rows: rows.divergence.isna()]
    match = _CONDITION.fullmatch(text)
    try:
        measure, side, bound = match.groups() if match else ("", "", "")
        column, limit = MEASURES[measure], float(bound)
        if not math.isfinite(limit):
            raise ValueError
    except (KeyError, ValueError):
        raise UserError(
            f"--fail-if = {text!r:.60}; legal: {NO_ANSWER!r}, or {', '.join(MEASURES)}, < or >, and a finite number"
        ) from None
    return lambda board: _engines(board)[lambda rows: _SIDES[side](rows[column], limit)]


def _engines(board: Frame) -> Frame:
    """Rows of engines that are there."""
    return board[(board.engine != EXACT) & (board.status != "unavailable")]
