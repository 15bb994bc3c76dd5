"""The page of a scoreboard, its figures, the other files of its folder, and what the command prints."""

from __future__ import annotations

import json
import platform
from importlib.metadata import version
from pathlib import Path

import numpy as np
from matplotlib.colors import LogNorm
from rich.console import Console

from impact_xval.compliant_baselines.registry import description_of
from impact_xval.experiments.presentation.document import Block, Figure, Section, Table
from impact_xval.experiments.presentation.html import page_of
from impact_xval.experiments.presentation.style import drawing, save
from impact_xval.experiments.presentation.terminal import show
from impact_xval.experiments.presentation.words import LAWS_WITH_LAWS, WHAT_D_IS, named
from impact_xval.experiments.scoreboard.cases import COLUMNS, PICTURED, RESTITUTIONS, cases
from impact_xval.experiments.scoreboard.judging import (
    ANSWERS,
    CHANCE,
    EXPLAINED,
    MODEL,
    Frame,
    board,
    by_case,
    laws,
    nearest,
)
from impact_xval.experiments.tables.folder import write_text
from impact_xval.experiments.tables.numbers import listed, number
from impact_xval.experiments.tables.parquet import replacing

TITLE = "What every engine does when three bodies meet at once"

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


class Board:
    """A scoreboard: solvers, their answers, and what is made of them."""

    def __init__(self, solvers: Frame, answers: Frame) -> None:
        self.solvers, self.answers = solvers.set_index("solver"), answers
        judged = board(answers)
        self.laws = laws(judged)
        self.judged = nearest(judged, self.laws)
        there = [name for name in self.solvers.index if name in self.laws.index]
        self.engines = [name for name in there if self.solvers.kind[name] in ("compliant", "rigid")]
        self.exact = [name for name in there if name not in self.engines]

    def explained(self, solver: str) -> bool:
        """Whether an exact law is near to all that a solver answers."""
        return bool(self.laws.farthest[solver] <= EXPLAINED)

    def worst(self, solver: str, column: str) -> float:
        """Give the largest value of a column of a solver; NaN without any."""
        return float(self.judged[self.judged.solver == solver][column].max())

    def how(self, solver: str) -> str:
        """Say how a solver answers."""
        return LAW_WORDS[self.laws.law[solver]] if self.explained(solver) else "as no exact law"


def write_all(solvers: Frame, answers: Frame, root: Path) -> Board:
    """Write everything into the folder of a scoreboard."""
    made = Board(solvers, answers)
    with replacing(root / ANSWERS) as temporary:
        answers.to_parquet(temporary, index=False, compression="zstd")
    with replacing(root / "board.csv") as temporary:
        made.judged.to_csv(temporary, index=False, lineterminator="\n")
    facts = {
        "impact-xval": version("impact-xval"),
        "python": platform.python_version(),
        "machine": platform.machine(),
    }
    facts |= {name: text for name, text in made.solvers.version[made.engines].items()}
    write_text(root / "versions.json", json.dumps(facts, indent=1) + "\n")
    (root / "figures").mkdir(exist_ok=True)
    draw_divergence(made, root / "figures")
    draw_cradle(made, root / "figures")
    write_text(root / "report.html", page_of(TITLE, blocks_of(made), root / "figures"))
    return made


def show_board(console: Console, made: Board) -> None:
    """Print the board, a row an engine."""
    show(console, [_summary(made), *_chance(made)])


def _summary(made: Board) -> Table:
    """Lay out what is worst of each engine."""
    columns = {
        f"D_{MODEL}": "D from the model",
        "energy_error": "energy, wrong by",
        "momentum_error": "momentum, wrong by",
        "spread": "moves by arrangement, D",
        "step_spread": "by half or twice the step, D",
    }
    worst = made.judged.groupby("solver")[list(columns)].max()
    worst.insert(0, "farthest", made.laws.farthest)
    worst["pace"] = made.solvers.microseconds
    rows = [(named(name), made.how(name), *(number(x, 2) for x in worst.loc[name])) for name in made.engines]
    header = (
        "engine",
        "answers",
        "D from that, or the nearest law",
        *columns.values(),
        "microseconds a step",
    )
    caption = (
        "At worst over all cases that an engine answers. Energy: gained, over that before; at e = 1 also lost. "
        "Momentum: without a table, over all momenta. A step is timed while balls touch, on this machine."
    )
    return Table(header, rows, caption, text=2)


def _chance(made: Board) -> list[str]:
    """Say whose answer depends on what no one means."""
    found = [name for name in made.engines if made.worst(name, "spread") > CHANCE]
    if not found:
        return []
    return [
        f"The answer of {listed(map(named, found))} depends on chance: with bodies that overlap, or are apart, by a "
        "ten-thousandth or a millionth of a radius, moved along the line, or made in the other order, the same "
        f"collision ends elsewhere, by D up to {number(max(made.worst(name, 'spread') for name in found), 2)}."
    ]


def blocks_of(made: Board) -> list[Block]:
    """Build the page."""
    explained = [name for name in made.engines if made.explained(name)]
    by_law: dict[str, list[str]] = {}
    for name in explained:
        by_law.setdefault(made.laws.law[name], []).append(named(name))
    missing = [(name, row.reason) for name, row in made.solvers.iterrows() if row.reason]
    first: list[Block] = [
        f"{len(made.engines)} engines and settings of engines answer {len(cases())} collisions of balls in a line, "
        f"{len(COLUMNS)} arrangements with e = {listed(number(e) for e in RESTITUTIONS)} at every contact. Beside them "
        f"stand {len(made.exact)} exact laws. An engine is explained by the law that it is least far from at worst, if "
        f"that is no further than D = {EXPLAINED}. " + WHAT_D_IS,
        " ".join(
            f"{listed(names)} answer{'s' * (len(names) == 1)} {LAW_WORDS[law]}."
            for law, names in by_law.items()
        ),
        *_chance(made),
        LAWS_WITH_LAWS,
    ]
    return [
        *first,
        Section("The board", [_main_table(made)]),
        Section("One ball strikes four", [Figure("cradle", CRADLE)]),
        Section("How far from the model", [Figure("divergence", DIVERGENCE)]),
        Section("What it costs, and what it depends on", [_summary(made)]),
        Section("All answers", [_answers_table(made)], folded=True),
        Section("The collisions", [_cases_table()], folded=True),
        Section(
            "Solvers",
            [
                Table(
                    ("solver", "version", "what it is"),
                    [(name, row.version, description_of(name)) for name, row in made.solvers.iterrows()],
                    text=3,
                ),
                Table(("solver", "not there, since"), missing, text=2),
            ],
            folded=True,
        ),
    ]


def _main_table(made: Board) -> Table:
    """Lay out the board: an engine a row, a case a column."""
    rows = []
    for name in made.engines:
        distances = by_case(made.judged, name, f"D_{made.laws.law[name]}")
        spreads = by_case(made.judged, name, "spread")
        cells = [
            number(D, 1) + (" *" if spread > CHANCE else "")
            for D, spread in zip(distances, spreads, strict=True)
        ]
        rows.append((named(name), made.how(name), *cells))
    caption = (
        "D from the law that is named, or else from the nearest of all, at worst over e. * : by chance, the answer "
        f"moves by more than D = {CHANCE} where touching bodies overlap or are apart by 1e-4 radii or less. "
        "- : it takes no case of that kind."
    )
    return Table(("engine", "answers", *COLUMNS), rows, caption, text=2)


def _answers_table(made: Board) -> Table:
    rows = []
    for row in made.judged.to_dict("records"):
        velocities = " ".join(number(row[f"v{i}"], 4) for i in range(1, 6) if np.isfinite(row[f"v{i}"]))
        distances = (number(row[key], 2) for key in (f"D_{MODEL}", "D_nearest"))
        ends = velocities or row["reason"]
        rows.append(
            (named(row["solver"]), row["case"], number(row["e"]), row["status"], ends, *distances, row["law"])
        )
    header = (
        "solver",
        "case",
        "e",
        "status",
        "velocities in m/s, or why not",
        "D, model",
        "D, nearest",
        "nearest law",
    )
    return Table(header, rows, f"All answers in the usual arrangement; {ANSWERS} holds the others.", text=5)


def _cases_table() -> Table:
    rows = [(case.name, number(case.e), case.command) for case in cases()]
    return Table(("case", "e", "by exact laws"), rows, "Each is solved by one command, too.", text=3)


DIVERGENCE = (
    "D from the state-transition model, by solver and collision; in each group e = 1, 0.9, 0.5, 0 from left to right. "
    "White: no answer, or none of the model, which knows no gaps."
)

CRADLE = (
    f"How a {PICTURED} ends at e = 1: velocities of the five balls, over that of the striker. Grey: before. Exact "
    "laws first, in black, then engines; two rows alike are one law."
)


def draw_divergence(made: Board, folder: Path) -> None:
    """Draw D from the model, a row a solver and a column a case."""
    names = [*made.engines, *(name for name in made.exact if name != MODEL)]
    grid = made.judged.pivot_table(index="solver", columns=["case", "e"], values=f"D_{MODEL}")
    grid = grid.reindex(index=names, columns=[(case.name, case.e) for case in cases()])
    with drawing(9.5, 0.9 + 0.24 * len(names)) as figure:
        ax = figure.subplots()
        ax.grid(visible=False)
        shown = np.ma.masked_invalid(np.maximum(grid.to_numpy(float), 1e-4))
        image = ax.imshow(shown, aspect="auto", cmap="viridis_r", norm=LogNorm(1e-4, 1.0))
        ax.set_yticks(range(len(names)), list(map(named, names)))
        n = len(RESTITUTIONS)
        titles = [name.replace(", ", "\n").replace("cradle ", "cradle\n") for name in COLUMNS]
        ax.set_xticks([n * i + (n - 1) / 2 for i in range(len(COLUMNS))], titles)
        for i in range(1, len(COLUMNS)):
            ax.axvline(n * i - 0.5, color="white", linewidth=3)
        ax.axhline(len(made.engines) - 0.5, color="black", linewidth=1)
        figure.colorbar(image, label="D from the model (-)", extend="min", fraction=0.03)
    save(figure, folder, "divergence")


def draw_cradle(made: Board, folder: Path) -> None:
    """Draw how the balls of a cradle leave, a row a solver."""
    found = made.judged[(made.judged.case == PICTURED) & (made.judged.e == 1)].set_index("solver")
    v = -found.reindex([*made.exact, *made.engines])[[f"v{i}" for i in range(1, 6)]].dropna()
    colors = ["#0b5cad" if name in made.engines else "#1a1a1a" for name in v.index]
    with drawing(9.5, 0.8 + 0.26 * len(v)) as figure:
        axes = figure.subplots(1, 5, sharey=True)
        for ball, ax in enumerate(axes, 1):
            ax.barh(range(len(v)), v[f"v{ball}"], height=0.7, color=colors)
            ax.axvline(1.0 if ball == 1 else 0.0, color="0.6", linewidth=3, zorder=0)
            ax.set_xlim(-0.7, 1.1)
            ax.set_title(f"ball {ball}", fontsize=9)
            ax.set_xlabel("v/v0 (-)")
        axes[0].set_yticks(range(len(v)), list(map(named, v.index)))
        axes[0].invert_yaxis()
    save(figure, folder, "cradle")
