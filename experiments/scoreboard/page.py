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
    return [
        f"{len(made.engines)} engines and settings of engines are asked for {len(cases())} collisions of balls in a "
        f"line, {len(COLUMNS)} arrangements with e = {listed(number(e) for e in RESTITUTIONS)} at every contact, "
        f"without gravity, and held against {len(made.exact)} exact laws: the state-transition model of Jia, Mason and "
        "Erdmann (2013), other laws of springs, and laws of rigid bodies. Laws are compared with one another; no "
        "laboratory measurement is in the comparison, and no number says which law is nearer to a real collision.",
        "“Mapped” is an engine whose contacts were set up here to be springs and dashpots of the stiffness and e asked "
        "for, at a step of a thousandth of the shorter contact period: where it follows their law it does what it was "
        "asked for. Steps in brackets are other shares of that period; “as it ships” is an engine in which nothing is "
        "set.",
        "D = √(Σ m Δv² / Σ m v₀²), Δv the difference of final velocities. D = 0 is the same outcome; a striker of 1 kg "
        "that stops instead of coming back at half its speed makes D = 0.5. The law of an engine is the one with the "
        f"smallest worst-case D, accepted up to {EXPLAINED}." + _borderline(made),
        " ".join(f"{listed(names)} answer{'s' * (len(names) == 1)} {law}." for law, names in by_law.items()),
        *_sensitive(made),
    ]


def _borderline(made: Board) -> str:
    """Name the engines for which half or twice the largest D that is accepted would change the verdict."""
    farthest = {made.called(name): made.laws.farthest[name] for name in made.engines}
    lost = [name for name, D in farthest.items() if EXPLAINED / 2 < D <= EXPLAINED]
    gained = [name for name, D in farthest.items() if EXPLAINED < D <= 2 * EXPLAINED]
    said = f" Up to half of that {listed(lost)} would have none." * bool(lost)
    return said + f" Up to twice that {listed(gained)} would have one." * bool(gained)


def _sensitive(made: Board) -> list[Block]:
    """Say whose answer hangs on what no one means."""
    judged = made.judged[made.judged.solver.isin(made.engines)]
    found = judged[judged.spread > SENSITIVE]
    if found.empty:
        return []
    worst = found.sort_values("spread").drop_duplicates("solver", keep="last").set_index("solver")
    moved = [
        f"{made.called(name)} ({row.spread_of}: {number(row.spread, 2)})" for name, row in worst.iterrows()
    ]
    return [
        "Each case is answered again with gaps and overlaps of 1e-4 and 1e-6 radii, and, without a table, moved along "
        f"its line and made in the other order. That moves the answers of {listed(moved)}: in brackets what moves it "
        "most, and by which D."
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
