"""What is written of a board: tables, figures, the page in Markdown and in HTML, and what a terminal shows."""

from __future__ import annotations

import math
import platform
from collections.abc import Iterator, Sequence
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any

from impact_xval.experiments.measures.aggregates import Frame
from impact_xval.experiments.presentation.page.charts import scripts
from impact_xval.experiments.presentation.page.html import html_of, render_markup
from impact_xval.experiments.presentation.pages import phrase, render
from impact_xval.experiments.presentation.style import save
from impact_xval.experiments.scoreboard.board import MEANINGS, VELOCITIES, answers_frame, board_of
from impact_xval.experiments.scoreboard.cases import (
    BASIC,
    MOST_STEPS,
    ONE_CONTACT,
    STEPS,
    USUAL,
    VARIATIONS,
    command,
)
from impact_xval.experiments.scoreboard.figures import draw_board
from impact_xval.experiments.scoreboard.judging import ANSWERS, Moves
from impact_xval.experiments.scoreboard.playing import EXACT, Entrant, Part
from impact_xval.experiments.sweep.executors import available_cores
from impact_xval.experiments.tables.numbers import number
from impact_xval.experiments.tables.store import write_json, write_text
from impact_xval.experiments.tables.streams import replacing

FORMAT = "impact-xval scoreboard, format 1"
BOARD, DESCRIPTION = "board.csv", "scoreboard.json"

#: A law explains an answer whose D from it is at most this; a share of energy or momentum below it is no gain or error.
EXPLAINED = 0.01
_GAIN = 1e-3

#: D of an answer in another arrangement above which it is another answer.
SAME = 0.01

#: Rows that a terminal lists of what meets a condition, or moved.
_LISTED = 20

_WORDS = "scoreboard_words.md.j2"


def write_board(root: Path, parts: Sequence[Part], seconds: float) -> tuple[Frame, dict[str, Any]]:
    """Write all that is known of a board into its folder.

    Parameters
    ----------
    root : Path
    parts : sequence of Part
        Of `playing.play`.
    seconds : float
        That it took.

    Returns
    -------
    board : DataFrame
        As `board_of`.
    facts : dict
        What the templates show.
    """
    board, answers = board_of(parts), answers_frame(parts)
    entrants = [entrant for part in parts for entrant in part.entrants if entrant.engine != EXACT]
    with replacing(root / ANSWERS) as temporary:
        answers.to_parquet(temporary, index=False, compression="zstd")
    with replacing(root / BOARD) as temporary:
        board.to_csv(temporary, index=False, lineterminator="\n")
    figures = root / "figures"
    figures.mkdir(exist_ok=True)
    captions = {}
    for name, figure, caption in draw_board(board):
        save(figure, figures, name)
        captions[name] = caption
    facts = facts_of(board, entrants, seconds) | {"figures": captions}
    write_text(root / "scoreboard.md", render("scoreboard.md.j2", page=False, **facts))
    page = render("scoreboard.md.j2", page=True, **facts)
    numbers = render_markup("numbers.html.j2", numbers=facts["numbers"])
    title = "impact-xval: what engines do as people run them"
    write_text(root / "scoreboard.html", html_of(page, title, figures, {"numbers": numbers}, scripts()))
    described = {
        "format": FORMAT,
        **{key: value for key, value in facts["provenance"]},
        "columns": MEANINGS,
    }
    write_json(root / DESCRIPTION, described)
    return board, facts


def facts_of(board: Frame, entrants: Sequence[Entrant], seconds: float) -> dict[str, Any]:
    """Collect what the templates show."""
    mine = board[board.engine != EXACT]
    together = mine[~mine.case.isin(ONE_CONTACT)]
    there = [entrant for entrant in entrants if not entrant.missing]
    summaries = [_summary(entrant, together[together.solver == entrant.name]) for entrant in there]
    answered = together[together.spread.notna()]
    other = answered[answered.spread > SAME]
    gains = together[together.energy > 1 + _GAIN]
    momentum = together[together.momentum_error.abs() > _GAIN]
    engines: dict[str, str] = {}
    for entrant in there:
        engines.setdefault(entrant.engine, entrant.version)
    basic = mine[(mine.case == BASIC) & (mine.e == 1)]
    return {
        "engines": [f"{engine} {number}" for engine, number in engines.items()],
        "missing": [(entrant.name, entrant.missing) for entrant in entrants if entrant.missing],
        "short": [[row[at] for at in (0, 2, 3, 4, 5, 6, 8, 10, 13)] for row in summaries],
        "settings": len(there),
        "n_cases": len(together.groupby(["case", "e"])),
        "arrangements": [name for name in VARIATIONS if name not in (USUAL, *STEPS)],
        "summaries": summaries,
        "explained": [_explained(entrant, mine[mine.solver == entrant.name]) for entrant in there],
        "share_explained": int((basic.nearest_divergence <= EXPLAINED).sum()),
        "laws": _laws(board),
        "threshold": EXPLAINED,
        "same": SAME,
        "n_answered": len(answered),
        "n_other": len(other),
        "other": _worst(other, "spread", ("spread_by",)),
        "n_gains": len(gains),
        "gains": _worst(gains, "energy", ()),
        "n_momentum": len(momentum),
        "momentum": _worst(momentum.assign(size=momentum.momentum_error.abs()), "size", ()),
        "energy_solvers": list(dict.fromkeys(gains.solver)),
        "refused": _refused(mine, there),
        "rows": _rows(board),
        "most_steps": MOST_STEPS,
        "commands": [command(BASIC, 1.0)],
        "numbers": _numbers(engines, there, answered, other, gains),
        "provenance": [
            ("made by", "impact-xval scoreboard"),
            ("impact-xval", version("impact-xval")),
            ("finished", datetime.now(UTC).isoformat(timespec="seconds")),
            ("seconds", round(seconds, 1)),
            ("engines", engines),
            ("missing", {entrant.name: entrant.missing for entrant in entrants if entrant.missing}),
            (
                "machine",
                {
                    "system": f"{platform.system()} {platform.release()}",
                    "processor": platform.processor() or platform.machine(),
                    "cores": available_cores(),
                    "python": platform.python_version(),
                },
            ),
        ],
    }


def _numbers(
    engines: dict[str, str],
    there: Sequence[Entrant],
    answered: Frame,
    other: Frame,
    gains: Frame,
) -> list[tuple[str, str]]:
    found = [(str(len(engines)), phrase(_WORDS, "engines_words", len(engines), len(there)))]
    if len(answered):
        share = f"{100 * len(other) / len(answered):.0f} %"
        found += [
            (share, phrase(_WORDS, "other_words", SAME)),
            (str(gains.solver.nunique()), phrase(_WORDS, "gains_words", _GAIN)),
        ]
    return found


def _summary(entrant: Entrant, rows: Frame) -> tuple[Any, ...]:
    """Sum an entrant up over the simultaneous impacts."""

    def of(name: str, how: str) -> float:
        return float(getattr(rows[name], how)()) if rows[name].notna().any() else math.nan

    return (
        entrant.name,
        entrant.law or "-",
        int(rows.divergence.notna().sum()),
        *(
            number(of(measure, how))
            for measure in ("divergence", "law_divergence", "spread")
            for how in ("median", "max")
        ),
        number(of("step_spread", "max")),
        number(of("energy", "max")),
        number(float(rows.momentum_error.abs().max()), 1),
        number(1e3 * of("step", "median")),
        number(1e6 * of("seconds_per_step", "median"), 2),
    )


def _explained(entrant: Entrant, rows: Frame) -> tuple[Any, ...]:
    """Say what one contact and the basic collision show of an entrant."""
    by = {(row.case, row.e): row for row in _records(rows)}
    returned = [by[name, 0.9] for name in ONE_CONTACT]
    # A ball that rebounds from the table; two balls in space, whose relative speed was 1.
    bounces = [returned[0].v1, returned[1].v1 - returned[1].v2]
    return (
        entrant.name,
        *(_fixed(e) if math.isfinite(e) else row.status for e, row in zip(bounces, returned, strict=True)),
        number(max(abs(e - 0.9) for e in bounces), 2),
        *(words for row in (by[BASIC, 1.0], by[BASIC, 0.9]) for words in (_velocities(row), _nearest(row))),
    )


def _records(rows: Frame) -> Iterator[Any]:
    """Give rows whose columns are attributes."""
    return iter(rows.itertuples())


def _velocities(row: Any) -> str:
    found = [getattr(row, name) for name in VELOCITIES]
    return " ".join(_fixed(v) for v in found if math.isfinite(v)) or row.status


def _fixed(value: float) -> str:
    return f"{round(value, 4) + 0.0:.4f}"  # no minus zero


def _nearest(row: Any) -> str:
    """Name the laws nearest to an answer, and how far they are; none where they explain nothing."""
    if not math.isfinite(row.nearest_divergence):
        return "-"
    if row.nearest_divergence > EXPLAINED:
        return phrase(_WORDS, "unexplained", row.nearest, row.nearest_divergence)
    return phrase(_WORDS, "explained", row.nearest, row.nearest_divergence)


def _laws(board: Frame) -> list[tuple[str, ...]]:
    """Give the exact answers to the basic collision."""
    rows = board[(board.engine == EXACT) & (board.case == BASIC)]
    names = list(dict.fromkeys(rows.solver))
    return [(name, *(_velocities(row) for row in _records(rows[rows.solver == name]))) for name in names]


def _worst(rows: Frame, measure: str, more: Sequence[str], most: int = 12) -> list[tuple[Any, ...]]:
    """Give the worst row of each entrant, the worst first."""
    worst = rows.sort_values(measure, ascending=False, kind="stable").groupby("solver", sort=False).head(1)
    return [
        (
            row.solver,
            row.case,
            f"{row.e:g}",
            number(getattr(row, measure), 4),
            *(getattr(row, name) for name in more),
        )
        for row in _records(worst.head(most))
    ]


def _refused(rows: Frame, there: Sequence[Entrant]) -> list[tuple[Any, ...]]:
    """Count what was not answered, by entrant, status and reason."""
    names = {entrant.name for entrant in there}
    rows = rows[rows.solver.isin(names) & rows.divergence.isna()]
    found = rows.groupby(["solver", "status", "reason"], sort=False).size()
    return [(solver, status, count, reason) for (solver, status, reason), count in found.items()]


def _rows(board: Frame) -> list[tuple[str, ...]]:
    measures = ("divergence", "law_divergence", "spread", "step_spread", "energy", "momentum_error")
    return [
        (
            row.solver,
            row.case,
            f"{row.e:g}",
            _velocities(row),
            *(number(getattr(row, name)) for name in measures),
            row.nearest if isinstance(row.nearest, str) else "-",
            number(row.nearest_divergence),
        )
        for row in _records(board)
    ]


def run_facts(
    board: Frame, held: Sequence[tuple[str, Frame]], moves: Moves | None, baseline: str
) -> dict[str, Any]:
    """Collect what a terminal shows beside: conditions that hold, and what moved."""
    return {
        "held": [
            (
                text,
                len(rows),
                [(row.solver, row.case, f"{row.e:g}") for row in _records(rows.head(_LISTED))],
            )
            for text, rows in held
        ],
        "moves": moves,
        "baseline": baseline,
        "moved": []
        if moves is None
        else [
            (*row[:-1], "other status" if math.isinf(row[-1]) else number(row[-1]))
            for row in moves.rows.head(_LISTED).itertuples(index=False, name=None)
        ],
        "by_solver": [] if moves is None else list(moves.rows.groupby("solver", sort=False).size().items()),
    }
