"""Comparison of a scoreboard with an earlier scoreboard, the baseline.

The command `impact-xval scoreboard` calls this module if it is given a baseline (option ``--baseline``).
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import pandas as pd

from impact_xval.experiments.config.errors import UserError
from impact_xval.experiments.config.renamed import CASES, STATUSES
from impact_xval.experiments.presentation.document import Block, Section
from impact_xval.experiments.scoreboard.cases import USUAL
from impact_xval.experiments.scoreboard.judging import ANSWER, list_moved_answers
from impact_xval.experiments.scoreboard.page import ANSWERS, frame_table
from impact_xval.experiments.scoreboard.plane import PLANE_ANSWERS
from impact_xval.experiments.tables.folder import write_text
from impact_xval.experiments.tables.frames import Frame
from impact_xval.experiments.tables.numbers import join_words

#: Name of the file with all answers that differ from the baseline, in the folder of a scoreboard.
MOVED = "moved.csv"

#: Largest number of these answers that are printed.
_PRINTED = 20


class Baseline(NamedTuple):
    """Answers of an earlier scoreboard."""

    folder: Path
    #: Answers to the collisions in a line.
    answers: Frame
    #: Answers to the collisions in a plane; None if the folder has none, because version 0.4 did not ask for them.
    in_plane: Frame | None


def read_baseline(folder: Path) -> Baseline:
    """Return the answers in the folder of an earlier scoreboard; raise a `UserError` if it holds none."""
    try:
        answers = pd.read_parquet(folder / ANSWERS)
        plane = folder / PLANE_ANSWERS
        in_plane = pd.read_parquet(plane) if plane.exists() else None
    except (OSError, ValueError) as error:
        raise UserError(f"--baseline = {folder}: holds no {ANSWERS} of a scoreboard: {error}") from None
    # Files of version 0.4 have the old names of cases and statuses.
    return Baseline(folder, answers.replace({"case": CASES, "status": STATUSES}), in_plane)


def compare_with_baseline(
    baseline: Baseline, answers: Frame, in_plane: Frame, root: Path, named: Sequence[str] = ()
) -> tuple[Section, bool]:
    """Compare a scoreboard with its baseline, and write the answers that differ into the folder `root`.

    Parameters
    ----------
    baseline
        The earlier scoreboard.
    answers, in_plane
        Answers of this scoreboard to the collisions in a line and in a plane.
    root
        Folder of this scoreboard.
    named
        Solvers that the user asked for by name. If there are none, the user asked for every solver. Otherwise answers
        in the baseline of solvers that are not in this scoreboard are ignored.

    Returns
    -------
    section : Section
        What the terminal shows.
    differs : bool
        Whether an answer differs, is in the baseline alone, or is of a solver in `named` and not in the baseline.
    """
    blocks: list[Block] = []
    before: Frame = baseline.answers
    after: Frame = answers
    if baseline.in_plane is None:
        blocks.append(f"{baseline.folder} has no {PLANE_ANSWERS}: answers in a plane were not compared")
    else:
        # The names of the cases in a plane differ from those in a line, so both parts are compared as one table.
        before = pd.concat([before, baseline.in_plane.assign(arrangement=USUAL)], ignore_index=True)
        after = pd.concat([after, in_plane.assign(arrangement=USUAL)], ignore_index=True)
    if named:
        before = before[before.solver.isin(after.solver)]
    sides = before[ANSWER].merge(after[ANSWER], how="outer", indicator="side")
    lost, added = (sides[sides.side == side].solver for side in ("left_only", "right_only"))
    compared = sides[sides.side == "both"]
    moved = list_moved_answers(before, after)
    write_text(root / MOVED, moved.to_csv(index=False, lineterminator="\n"))
    counts = f"{len(compared)} answers of {compared.solver.nunique()} solvers were compared"
    blocks += [
        *_describe_unmatched(lost, str(baseline.folder)),
        *_describe_unmatched(added, "this scoreboard"),
    ]
    if moved.empty:
        blocks.append(f"no answer differs from those in {baseline.folder}; {counts}")
    else:
        caption = f"{len(moved)} answers differ from those in {baseline.folder}; {counts}"
        blocks.append(frame_table(moved.head(_PRINTED), caption, 6))
        more = f"{len(moved) - _PRINTED} more differ; " if len(moved) > _PRINTED else ""
        blocks.append(f"{more}all that differ are in {root / MOVED}")
    # A solver that the user did not name may be new. It is no change that the baseline does not have it.
    differs = len(moved) > 0 or len(lost) > 0 or added.isin(named).any()
    return Section("Compared with the baseline", blocks), bool(differs)


def _describe_unmatched(solvers: pd.Series, place: str) -> list[str]:
    """Return lines that name the solvers of answers that only one scoreboard has, and count the answers.

    `solvers` has the solver of each such answer, and `place` says which scoreboard has them. Solvers with equally many
    answers share a line.
    """
    counts = solvers.value_counts(sort=False)
    lines: list[str] = []
    for count, alike in counts.groupby(counts, sort=False):
        answers = f"{count} answer{'s' * (count != 1)}{' each' * (len(alike) > 1)}"
        lines.append(f"{join_words(alike.index)}: {answers} not compared, only in {place}")
    return lines
