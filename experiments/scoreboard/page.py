"""The page of a scoreboard, the other files of its folder, and what the command prints."""

from __future__ import annotations

import json
import platform
from importlib.metadata import version
from pathlib import Path

import numpy as np
from rich.console import Console

from impact_xval.compliant_baselines.registry import description_of
from impact_xval.experiments.presentation.document import Block, Figure, Section, Table
from impact_xval.experiments.presentation.html import page_of
from impact_xval.experiments.presentation.terminal import show
from impact_xval.experiments.scoreboard.cases import COLUMNS, RESTITUTIONS, cases
from impact_xval.experiments.scoreboard.figures import CASES, CRADLE, DIVERGENCE, draw_all
from impact_xval.experiments.scoreboard.judging import (
    ANSWERS,
    EXPLAINED,
    MODEL,
    SENSITIVE,
    Board,
    Frame,
)
from impact_xval.experiments.tables.folder import write_text
from impact_xval.experiments.tables.numbers import listed, number
from impact_xval.experiments.tables.parquet import replacing

TITLE = "What physics engines do when several bodies meet at once"


def write_all(solvers: Frame, answers: Frame, root: Path) -> Board:
    """Write everything into the folder of a scoreboard."""
    made = Board(solvers, answers)
    with replacing(root / ANSWERS) as temporary:
        answers.to_parquet(temporary, index=False, compression="zstd")
    with replacing(root / "board.csv") as temporary:
        made.judged.to_csv(temporary, index=False, lineterminator="\n")
    facts = {"impact-xval": version("impact-xval"), "python": platform.python_version()}
    facts |= {"machine": platform.machine(), **made.solvers.version[made.engines]}
    write_text(root / "versions.json", json.dumps(facts, indent=1) + "\n")
    draw_all(made, root / "figures")
    write_text(root / "report.html", page_of(TITLE, blocks_of(made), root / "figures"))
    return made


def show_board(console: Console, made: Board) -> None:
    """Print the board, a row an engine."""
    show(console, [_summary(made), *_sensitive(made)])


def blocks_of(made: Board) -> list[Block]:
    """Build the page."""
    solvers = [(name, row.version, description_of(name), row.reason) for name, row in made.solvers.iterrows()]
    return [
        *_lead(made),
        Section("The collisions", [Figure("cases", CASES)]),
        Section("The board", [_board(made)]),
        Section("One ball strikes four", [Figure("cradle", CRADLE)]),
        Section("At worst", [_summary(made)]),
        Section("How far from the model", [Figure("divergence", DIVERGENCE)]),
        Section("All answers", [_answers(made)], folded=True),
        Section("Commands", [_commands()], folded=True),
        Section(
            "Solvers",
            [Table(("solver", "version", "what it is", "why it is not there"), solvers, text=4)],
            folded=True,
        ),
    ]


def _lead(made: Board) -> list[Block]:
    by_law: dict[str, list[str]] = {}
    for name in filter(made.explained, made.engines):
        by_law.setdefault(made.how(name), []).append(made.called(name))
    close = [
        made.called(name) for name in made.engines if EXPLAINED / 2 < made.laws.farthest[name] < 2 * EXPLAINED
    ]
    return [
        f"{len(made.engines)} engines and settings of engines are asked for {len(cases())} collisions of balls in a "
        f"line, {len(COLUMNS)} arrangements with e = {listed(number(e) for e in RESTITUTIONS)} at every contact, "
        f"without gravity, and held against {len(made.exact)} exact laws: the state-transition model of Jia, Mason and "
        "Erdmann (2013), other laws of springs, and laws of rigid bodies. Laws are compared with one another; no "
        "laboratory measurement is in the comparison, and no number says which law is nearer to a real collision.",
        "“Mapped” is an engine whose contacts were set up here to be springs and dashpots of the stiffness and e asked "
        "for, at a step of a thousandth of the shorter contact period: that it answers so says that it does what it "
        "was asked for. Steps in brackets are other shares of that period. Without these settings it does not.",
        "D = √(Σ m Δv² / Σ m v₀²), Δv the difference of final velocities. D = 0 is the same outcome; a striker of 1 kg "
        "that stops instead of coming back at half its speed makes D = 0.5. The law of an engine is the one whose "
        f"largest D over all cases is the smallest, if that is at most {EXPLAINED}"
        + (f"; {listed(close)} would change sides at half or twice that." if close else "."),
        " ".join(f"{listed(names)} answer{'s' * (len(names) == 1)} {law}." for law, names in by_law.items()),
        *_sensitive(made),
    ]


def _sensitive(made: Board) -> list[Block]:
    """Say whose answer hangs on what no one means."""
    judged = made.judged[made.judged.solver.isin(made.engines)]
    found = judged[judged.spread > SENSITIVE]
    if found.empty:
        return []
    names = [made.called(name) for name in found.solver.unique()]
    return [
        f"The answer of {listed(names)} hangs on how exactly bodies are placed. Placed otherwise "
        f"({listed(sorted(found.spread_of.unique()))}; gaps and overlaps in radii), the same collision ends elsewhere, "
        f"by D up to {number(found.spread.max(), 2)}."
    ]


def _board(made: Board) -> Table:
    """Lay out the board: an engine a row, a case a column."""
    rows = []
    for name in made.engines:
        distances = made.by_case(name, f"D_{made.laws.law[name]}")
        marks = [" *" * (spread > SENSITIVE) for spread in made.by_case(name, "spread")]
        cells = [number(D, 2) + mark for D, mark in zip(distances, marks, strict=True)]
        rows.append((made.called(name), made.how(name), *cells))
    caption = (
        f"The largest D from that law, by case. * : it moves by more than D = {SENSITIVE} with gaps or overlaps of "
        "1e-4 radii or less, along the line, or in the other order. - : it has no answer. Springs and dashpots answer "
        "no e = 0."
    )
    return Table(("engine", "answers", *COLUMNS), rows, caption, text=2)


def _summary(made: Board) -> Table:
    """Lay out what is worst of each engine."""
    columns = {
        f"D_{MODEL}": "D from the model",
        "energy_gained": "energy gained",
        "energy_lost": "energy lost at e = 1",
        "momentum_error": "momentum, off by",
        "spread": "D by placement",
        "step_spread": "D by half or twice the step",
    }
    worst = made.judged.groupby("solver")[list(columns)].max()
    worst.insert(0, "farthest", made.laws.farthest)
    worst.insert(1, "next", made.laws.next_farthest)
    worst["pace"] = made.solvers.microseconds
    rows = [
        (
            made.called(name),
            made.laws.law[name],
            f"{made.laws.answered[name]}",
            *(number(x, 2) for x in worst.loc[name]),
        )
        for name in made.engines
    ]
    caption = (
        f"The largest of all cases that an engine answers, of {len(cases())}. Where the next law is as near, these "
        "cases do not tell the two apart. Energy is over that before; momentum, of cases without a table, over the sum "
        "of its absolute values before. A step is timed on one machine while balls touch."
    )
    header = (
        "engine",
        "nearest law",
        "cases",
        "D from it",
        "from the next",
        *columns.values(),
        "microseconds a step",
    )
    return Table(header, rows, caption, text=2)


def _answers(made: Board) -> Table:
    rows = []
    for row in made.judged.to_dict("records"):
        velocities = " ".join(number(row[f"v{i}"], 4) for i in range(1, 6) if np.isfinite(row[f"v{i}"]))
        distances = (number(row[key], 2) for key in (f"D_{MODEL}", "D_nearest", "spread"))
        asked = made.called(row["solver"]), row["case"], number(row["e"]), row["status"]
        rows.append((*asked, velocities or row["reason"], *distances, row["law"], row["spread_of"]))
    header = ("solver", "case", "e", "status", "velocities in m/s, or why not", "D, model", "D, nearest")
    header += ("D by placement", "nearest law", "placed how")
    return Table(header, rows, f"All answers in the usual arrangement; {ANSWERS} holds the others.", text=5)


def _commands() -> Table:
    rows = [(case.name, number(case.e), case.command) for case in cases()]
    return Table(
        ("case", "e", "command"), rows, "Each case alone, by every solver, or those of --solver.", text=3
    )
