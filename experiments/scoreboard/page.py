"""The page of a scoreboard, and the other files of its folder."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from impact_xval.compliant_baselines.registry import has_fixed_mapping, is_engine, kind_of, law_name_of
from impact_xval.experiments.presentation.document import Block, Figure, Section, Table
from impact_xval.experiments.presentation.html import render_page, render_template
from impact_xval.experiments.presentation.style import save_figure, styled_figure
from impact_xval.experiments.presentation.words import LAWS_WITH_LAWS, display_name
from impact_xval.experiments.scoreboard.cases import CASE_SETUPS, CASES, RESTITUTIONS
from impact_xval.experiments.scoreboard.judging import FROM_LAWS, MODEL, find_nearest_laws, judge_answers
from impact_xval.experiments.tables.folder import write_text
from impact_xval.experiments.tables.frames import Frame
from impact_xval.experiments.tables.numbers import join_words, number
from impact_xval.experiments.tables.parquet import replacing

#: File of all answers in the folder of a scoreboard.
ANSWERS = "answers.parquet"

TITLE = "What physics engines do when several bodies meet at once"
PICTURED = "cradle 1 on 4"

#: Thresholds of D: a law explains an answer up to `EXPLAINED`; an answer whose spread exceeds `SENSITIVE` depends on
#: the placement; two laws whose distances differ by less than `TIED` are tied.
EXPLAINED, SENSITIVE, TIED = 0.05, 0.1, 1e-9

#: Exact laws as a reader knows them.
LAW_WORDS = {
    MODEL: "as the state-transition model",
    "liu-zhao-brogliato": "as the model of Liu, Zhao and Brogliato",
    "bistiffness": "as the model's law in time",
    "kelvin-voigt": "as springs and dashpots that only push",
    "kelvin-voigt-anchored": "as springs and dashpots, the lower ball held",
    "kelvin-voigt-textbook": "as springs and dashpots with the textbook's damping",
    "hunt-crossley": "as springs damped by their depth",
    "compression-dashpot": "as springs damped in compression only",
    "linear-dashpot": "as springs and dashpots that may pull",
    "newton-restitution": "by Newton's restitution, all contacts at once",
    "poisson-restitution": "by Poisson's restitution, all contacts at once",
    "sequential-top": "one contact after the other, from the top",
    "sequential-bottom": "one contact after the other, from the bottom",
    "generalised-reflection": "by generalised reflections",
    "plastic-then-restitution": "first without rebound, then a rebound of each contact in turn",
}

#: Groups of engines on the board, in their order.
GROUPS = SPRINGS, GRAINS, RIGID, AS_PEOPLE_RUN_THEM = (
    "Springs and dashpots",
    "Grains (DEM)",
    "Rigid contacts",
    "As they ship, and as people run them",
)

#: Engines whose contacts of spheres are those of grains; they are springs and dashpots too.
_OF_GRAINS = ("lammps", "exudyn")

LEAD = (
    f"Engines, as they are set up in several ways, are asked for {len(CASES)} collisions of balls in a line, "
    f"{len(CASE_SETUPS)} arrangements with e = {join_words(map(number, RESTITUTIONS))} at every contact, without "
    "gravity, and held against exact laws: the state-transition model of Jia, Mason and Erdmann (2013), other laws of "
    f"springs, and laws of rigid bodies. {LAWS_WITH_LAWS}",
    "“Mapped” is an engine whose own springs and dashpots were set up here for the stiffness and e asked for, at a "
    "step of a thousandth of the shorter contact period: where it follows their law it does what it was asked for. "
    "Steps in brackets are other shares of that period. “Naive” writes k and damping into an engine's parameters as "
    "these are called, “as documented” sets MuJoCo's solref alone; “as it ships” is an engine in which nothing is set "
    "but the e of those that take one.",
    "D = √(Σ m Δv² / Σ m v₀²), Δv the difference of final velocities, v₀ those before. D = 0 is the same outcome; a "
    "striker of 1 kg that stops instead of coming back at half its speed makes D = 0.5. The law of an engine is the "
    f"one with the smallest worst-case D, accepted up to {EXPLAINED}.",
)

BOARD = (
    "The largest D from that law, or else from the nearest, by case. In a drop a ball falls on one that rests on a "
    "table, k2/k1 is the stiffness there over that between the balls. * : it moves by more than "
    f"D = {SENSITIVE} with gaps or overlaps of 1e-4 radii or less, along the line, or in the other order. - : it has "
    "no answer. Springs and dashpots answer no e = 0."
)

WORST = (
    f"The largest of all cases that an engine answers, of {len(CASES)}. Farthest: D from the nearest law that answers "
    "nine in ten of them, and from the next; where that is as near, they do not tell the two apart. It is "
    f"no engine's own where it is farther than {EXPLAINED}. Energy gained, and lost at e = 1, is over that before; "
    "momentum, of cases without a table, over the sum of its absolute values before. Spread: D by another placement "
    "(of: by which); step spread: by half and twice the step. Microseconds of a step are of one machine, the shortest "
    "of seven means over 64 steps. Mapped springs touch in all of them; other bodies have parted by then."
)

CRADLE = (
    f"How a {PICTURED} ends at e = 1: velocities of the five balls, over that of the striker before (grey). Exact laws "
    "first, in black, then engines in the order of the board; laws with the same row cannot be told apart by this "
    "collision. Solvers that do not answer it have no row."
)


def write_scoreboard(answers: Frame, root: Path, more: Sequence[Section] = ()) -> list[Block]:
    """Judge answers, write the files of a scoreboard, and return its summary for the terminal.

    The page has the sections `more` after those of the board.
    """
    judged = judge_answers(answers)
    followed = find_nearest_laws(judged)
    words = describe_engines(followed)
    with replacing(root / ANSWERS) as temporary:
        answers.to_parquet(temporary, index=False, compression="zstd")
    write_text(root / "board.csv", judged.to_csv(index=False, lineterminator="\n"))
    draw_cradle(judged, root)
    shown = judged.drop(columns={*FROM_LAWS} - {f"D_{MODEL}"})
    every = frame_table(shown, f"In the usual arrangement; {ANSWERS} holds the others.", 5)
    blocks: list[Block] = [
        *LEAD,
        *words,
        Section("The board", [render_template("filter.html.j2"), *board_sections(judged, followed)]),
        Section("One ball strikes four", [Figure("cradle", CRADLE)]),
        Section("At worst", [worst_case_table(followed)]),
        *more,
        Section("All answers", [every], folded=True),
    ]
    write_text(root / "report.html", render_page(TITLE, blocks, root))
    brief = followed[["law", "farthest", "next", "next_farthest", "spread", "microseconds"]]
    return [worst_case_table(brief), *words]


def draw_cradle(judged: Frame, folder: Path) -> None:
    """Draw the final velocities of the balls of a cradle, one row per solver: exact laws, then engines by group."""
    v = -judged.query("case == @PICTURED and e == 1").set_index("solver").filter(regex=r"^v\d$").dropna()
    v = v.loc[sorted(v.index, key=_place_in_picture)]
    colors = ["#0b5cad" if is_engine(name) else "#1a1a1a" for name in v.index]
    least = 1.05 * v.to_numpy().min(initial=-0.7)
    with styled_figure(9.5, 0.8 + 0.23 * len(v)) as figure:
        axes = figure.subplots(1, 5, sharey=True)
        for ball, ax in enumerate(axes, 1):
            ax.barh(list(map(display_engine, v.index)), v[f"v{ball}"], height=0.7, color=colors)
            ax.axvline(1.0 if ball == 1 else 0.0, color="0.6", linewidth=3, zorder=0)
            ax.set(xlim=(least, 1.1), title=f"ball {ball}", xlabel="v/v0 (-)")
        axes[0].set_ylim(len(v) - 0.4, -0.6)
    save_figure(figure, folder, "cradle")


def _place_in_picture(solver: str) -> int:
    """Return a solver's place in the picture of a cradle: 0 for exact laws, then the place of its group."""
    return 1 + GROUPS.index(group_of(solver)) if is_engine(solver) else 0


def display_engine(solver: str) -> str:
    """Name a solver for a reader; an engine whose contacts are mapped to a law has ``(mapped)`` after its name."""
    mapped = is_engine(solver) and law_name_of(solver) and ":" not in solver and not has_fixed_mapping(solver)
    return f"{display_name(solver)} (mapped)" if mapped else display_name(solver)


def describe_law(row: Frame) -> str:
    """Say by which law an engine answers, from its row of `judging.find_nearest_laws`.

    A second law that is as near follows after a semicolon.
    """
    if row.farthest > EXPLAINED:
        return "as no exact law"
    tied = row.next_farthest - row.farthest < TIED
    return LAW_WORDS[row.law] + (f"; {row.next} says the same here" if tied else "")


def describe_engines(followed: Frame) -> list[Block]:
    """Say by which law each engine answers, and which engines' answers depend on the placement."""
    if followed.empty:
        return []
    by_law = followed.groupby(followed.apply(describe_law, axis=1), sort=False)
    said = [
        f"{join_words(map(display_engine, own.index))} answer{'s' * (len(own) == 1)} {law}."
        for law, own in by_law
    ]
    least = number(followed[f"D_{MODEL}"].min(), 2)
    said.append(f"From the state-transition model each ends D = {least} or more in some case.")
    sensitive = followed[followed.spread > SENSITIVE].sort_values("spread", kind="stable").itertuples()
    moved = [f"{display_engine(row.Index)} ({row.spread_of}: {number(row.spread, 2)})" for row in sensitive]
    chance = (
        "Each case is answered again with gaps and overlaps of 1e-4 and 1e-6 radii, and, without a table, moved along "
        f"its line and made in the other order. That moves by more than D = {SENSITIVE} the answers of "
        f"{join_words(moved)}: in brackets what moves it most, and by which D."
    )
    return [" ".join(said), *([chance] if moved else [])]


def group_of(solver: str) -> str:
    """Name the group of the board in which an engine stands."""
    if has_fixed_mapping(solver) or ":step-" in solver:
        return AS_PEOPLE_RUN_THEM
    if solver.partition(":")[0] in _OF_GRAINS:
        return GRAINS
    return RIGID if kind_of(solver) == "rigid" else SPRINGS


def board_sections(judged: Frame, followed: Frame) -> list[Block]:
    """Lay out the board in groups of engines, each with a table; what the tables show precedes them."""
    groups = followed.groupby(followed.index.map(group_of), sort=False)
    by_title = {title: board_table(judged, engines) for title, engines in groups}
    return [BOARD, *(Section(title, [by_title[title]]) for title in GROUPS if title in by_title)]


def board_table(judged: Frame, followed: Frame) -> Table:
    """Lay out a part of the board: one row per engine, one column per case."""
    rows: list[tuple[str, ...]] = []
    worst = judged.groupby(["solver", "case"]).max(numeric_only=True)
    for law in followed.itertuples():
        its = worst.loc[law.Index].reindex(list(CASE_SETUPS))
        cells = [
            ("< 1e-4" if D < 1e-4 else number(D, 2)) + (" *" if spread > SENSITIVE else "")
            for D, spread in zip(its[f"D_{law.law}"], its.spread, strict=True)
        ]
        answers = describe_law(law).partition(";")[0]
        rows.append((display_engine(law.Index), law.version, answers, *cells))
    return Table(("engine", "release", "answers", *CASE_SETUPS), rows, text=3)


def worst_case_table(followed: Frame) -> Table:
    """Lay out the worst values of each engine."""
    own = followed.rename(display_engine).reset_index(names="engine")
    return frame_table(own.rename(columns={"law": "nearest law", "next": "next law"}), WORST, 2)


def frame_table(frame: Frame, caption: str, text: int) -> Table:
    """Lay out a frame as a table, with numbers in three digits."""
    rows = [[number(x) if isinstance(x, float) else x for x in row] for row in frame.to_numpy(object)]
    return Table([name.replace("_", " ") for name in frame], rows, caption, text)
