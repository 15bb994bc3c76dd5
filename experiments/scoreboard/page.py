"""The page of a scoreboard, and the other files in its folder.

The command `impact-xval scoreboard` calls `write_scoreboard` with the answers of all solvers.
"""

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

#: Name of the file with all answers, in the folder of a scoreboard.
ANSWERS = "answers.parquet"

TITLE = "What physics engines do when several bodies meet at once"
PICTURED = "cradle 1 on 4"

#: Thresholds of D, the distance between two outcomes. A law explains an engine whose D from it is at most `EXPLAINED`.
#: An answer counts as dependent on the placement of the balls if another placement changes the answer by more than
#: `SENSITIVE`. Two laws are equally near to an engine if their distances differ by less than `TIED`.
EXPLAINED, SENSITIVE, TIED = 0.05, 0.1, 1e-9

#: Words for each exact law. In a sentence they follow "the engine answers".
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

#: Words for an engine that no exact law explains, in the same place.
NO_LAW = "unlike any exact law"

#: Titles of the groups of engines on the board, in the order of the page.
GROUPS = SPRINGS, GRAINS, RIGID, AS_PEOPLE_RUN_THEM = (
    "Springs and dashpots",
    "Grains (DEM)",
    "Rigid contacts",
    "As they ship, and as people run them",
)

#: Engines for grains (discrete element method). Contacts of spheres in these engines are springs and dashpots, as in
#: other engines, but the board shows these engines as a separate group.
_OF_GRAINS = ("lammps", "exudyn")

LEAD = (
    f"Engines, as they are set up in several ways, are asked for {len(CASES)} collisions of balls in a line, "
    f"{len(CASE_SETUPS)} arrangements with e = {join_words(map(number, RESTITUTIONS))} at every contact, without "
    "gravity. Their answers are compared with exact laws: the state-transition model of Jia, Mason and Erdmann (2013), "
    f"other laws of springs, and laws of rigid bodies. {LAWS_WITH_LAWS}",
    "“Mapped” is an engine whose own springs and dashpots were set up here for the stiffness and e asked for, at a "
    "step of a thousandth of the shorter contact period. If a mapped engine follows the law of springs and dashpots, "
    "it does what it was asked for. Steps in brackets are other shares of that period. “Naive” is an engine in which "
    "k and the damping were written into the parameters with these names. “As documented” sets only MuJoCo's solref. "
    "“As it ships” is an engine in which nothing is set except e, where an engine has such a parameter.",
    "D = √(Σ m Δv² / Σ m v₀²), where Δv is the difference of final velocities, and v₀ the velocities before. D = 0 "
    "means the same outcome. A striker of 1 kg that stops instead of coming back at half its speed makes D = 0.5. The "
    "law of an engine is the law from which its largest D over all cases is smallest, if that D is at most "
    f"{EXPLAINED}.",
)

BOARD = (
    "The largest D of each case from the law of the engine, or from the nearest law if it has none. In a pile a ball "
    "falls on a ball that rests on a table, and k2/k1 is the stiffness of the table contact over the stiffness of the "
    f"contact between the balls. * : the answer changes by more than D = {SENSITIVE} with gaps or overlaps of 1e-4 "
    "radii or less, at another place along the line, or if the balls are made in the other order. - : the engine has "
    f"no answer. “Cases answered” counts the cases that the engine answers, of the {len(CASES)} that it is asked for. "
    "Springs and dashpots have no answer for e = 0, which is a quarter of the cases."
)

WORST = (
    "Each number is the largest over all cases that the engine answers; “cases answered” counts them. Farthest: D "
    "from the nearest law. Only laws that answer at least nine tenths of the cases that the engine answers are "
    "compared. Next farthest: D from the second nearest law. If both numbers are equal, the cases do not tell the two "
    f"laws apart. An engine follows its nearest law if farthest is at most {EXPLAINED}. Energy gained, and energy lost "
    "at e = 1, are divided by the energy before. The momentum error is divided by the sum of the absolute momenta "
    "before. Only cases without a table have one. Spread: the largest D between the answer to the usual placement and "
    "the answer to another placement. “Spread of” names this other placement. Step spread: the largest D between the "
    "usual time step and half or twice this step. Microseconds: time for a step on one machine, the shortest of seven "
    "means over 64 steps. Bodies of engines with springs touch during all these steps, bodies of rigid engines only "
    "during the first."
)

CRADLE = (
    f"How a {PICTURED} ends at e = 1: velocities of the five balls, over the velocity of the striker before. Grey "
    "lines: the velocities before. Exact laws come first, in black, then engines in the order of the board. Solvers "
    "that do not solve this collision have no row. The collision does not tell laws with the same row apart."
)


def write_scoreboard(answers: Frame, root: Path, more: Sequence[Section] = ()) -> list[Block]:
    """Write the page and the other files of a scoreboard; return a summary for the terminal.

    `answers` holds the answers of all solvers to all cases. On the page, the sections `more` follow the table of the
    worst cases.
    """
    judged = judge_answers(answers)
    followed = find_nearest_laws(judged)
    words = describe_engines(followed)
    with replacing(root / ANSWERS) as temporary:
        answers.to_parquet(temporary, index=False, compression="zstd")
    write_text(root / "board.csv", judged.to_csv(index=False, lineterminator="\n"))
    draw_cradle(judged, root)
    shown = judged.drop(columns={*FROM_LAWS} - {f"D_{MODEL}"})
    every = frame_table(
        shown, f"Answers in the usual arrangement. {ANSWERS} holds the answers in the others.", 5
    )
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
    brief = followed[["law", "cases", "asked", "farthest", "next", "next_farthest", "spread", "microseconds"]]
    return [worst_case_table(brief), *words]


def draw_cradle(judged: Frame, folder: Path) -> None:
    """Draw the final velocities of the balls of a cradle into a figure, one row per solver: laws, then engines."""
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
    """Return the name of a solver for a reader.

    If the contacts of an engine were set up for the requested law, stiffness and e, ``(mapped)`` follows its name.
    """
    mapped = is_engine(solver) and law_name_of(solver) and ":" not in solver and not has_fixed_mapping(solver)
    return f"{display_name(solver)} (mapped)" if mapped else display_name(solver)


def describe_law(row: Frame) -> str:
    """Return words for the law that an engine follows, from the engine's row of `judging.find_nearest_laws`.

    If a second law is equally near, words for this law follow after a semicolon.
    """
    if row.farthest > EXPLAINED:
        return NO_LAW
    tied = row.next_farthest - row.farthest < TIED
    return LAW_WORDS[row.law] + (f"; {row.next} gives the same answers in these cases" if tied else "")


def describe_engines(followed: Frame) -> list[Block]:
    """Return sentences on the law that each engine follows, and on answers that depend on the placement of balls."""
    if followed.empty:
        return []
    by_law = followed.groupby(followed.apply(describe_law, axis=1), sort=False)
    said = [
        f"{join_words(map(display_engine, own.index))} answer{'s' * (len(own) == 1)} {law}."
        for law, own in by_law
    ]
    least = number(followed[f"D_{MODEL}"].min(), 2)
    said.append(
        f"Every engine differs from the state-transition model by D = {least} or more in at least one case."
    )
    sensitive = followed[followed.spread > SENSITIVE].sort_values("spread", kind="stable").itertuples()
    moved = [f"{display_engine(row.Index)} ({row.spread_of}: {number(row.spread, 2)})" for row in sensitive]
    chance = (
        "Engines answer each case again with gaps and overlaps of 1e-4 and 1e-6 radii. Without a table they also "
        "answer it moved along the line, and with the balls made in the other order. The answers of these engines "
        f"change by more than D = {SENSITIVE}: {join_words(moved)}. In brackets stands what changes an answer most, "
        "and by which D."
    )
    return [" ".join(said), *([chance] if moved else [])]


def group_of(solver: str) -> str:
    """Return the title of the group of the board to which an engine belongs."""
    if has_fixed_mapping(solver) or ":step-" in solver:
        return AS_PEOPLE_RUN_THEM
    if solver.partition(":")[0] in _OF_GRAINS:
        return GRAINS
    return RIGID if kind_of(solver) == "rigid" else SPRINGS


def board_sections(judged: Frame, followed: Frame) -> list[Block]:
    """Return the board: an explanation, then one section with a table for each group of engines."""
    groups = followed.groupby(followed.index.map(group_of), sort=False)
    by_title = {title: board_table(judged, engines) for title, engines in groups}
    return [BOARD, *(Section(title, [by_title[title]]) for title in GROUPS if title in by_title)]


def board_table(judged: Frame, followed: Frame) -> Table:
    """Return the table of a group of engines, with one row per engine and one column per case."""
    rows: list[tuple[str, ...]] = []
    worst = judged.groupby(["solver", "case"]).max(numeric_only=True)
    for law in followed.itertuples():
        its = worst.loc[law.Index].reindex(list(CASE_SETUPS))
        cells = [
            ("< 1e-4" if D < 1e-4 else number(D, 2)) + (" *" if spread > SENSITIVE else "")
            for D, spread in zip(its[f"D_{law.law}"], its.spread, strict=True)
        ]
        answers = describe_law(law).partition(";")[0]
        rows.append((display_engine(law.Index), law.version, answers, f"{law.cases} of {law.asked}", *cells))
    return Table(("engine", "release", "answers", "cases answered", *CASE_SETUPS), rows, text=3)


def worst_case_table(followed: Frame) -> Table:
    """Return the table with the worst values of each engine over all cases, one row per engine."""
    counts = followed.cases.astype(str) + " of " + followed.asked.astype(str)
    own = (
        followed.assign(cases=counts).drop(columns="asked").rename(display_engine).reset_index(names="engine")
    )
    names = {"cases": "cases answered", "law": "nearest law", "next": "next law"}
    return frame_table(own.rename(columns=names), WORST, 2)


def frame_table(frame: Frame, caption: str, text: int) -> Table:
    """Return a DataFrame as a table of a page, with numbers in three digits. Its first `text` columns are text."""
    rows = [[number(x) if isinstance(x, float) else x for x in row] for row in frame.to_numpy(object)]
    return Table([name.replace("_", " ") for name in frame], rows, caption, text)
