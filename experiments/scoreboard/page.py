"""The page of a scoreboard, and the other files of its folder."""

from __future__ import annotations

from pathlib import Path

from impact_xval.compliant_baselines.registry import description_of, engine_free_names, is_engine
from impact_xval.experiments.presentation.document import Block, Figure, Section, Table
from impact_xval.experiments.presentation.html import page_of
from impact_xval.experiments.presentation.style import drawing, save
from impact_xval.experiments.presentation.words import LAWS_WITH_LAWS, named
from impact_xval.experiments.scoreboard.cases import CASES, COLUMNS, RESTITUTIONS
from impact_xval.experiments.scoreboard.judging import ANSWERS, MODEL, Frame
from impact_xval.experiments.tables.folder import write_text
from impact_xval.experiments.tables.numbers import listed, number
from impact_xval.experiments.tables.parquet import replacing

TITLE = "What physics engines do when several bodies meet at once"

PICTURED = "cradle 1 on 4"

#: D up to which a law explains an answer, and difference up to which the cases do not tell two laws apart.
EXPLAINED, TIED = 0.05, 1e-9

LEAD = (
    f"Engines, as they are set up in several ways, are asked for {len(CASES)} collisions of balls in a line, "
    f"{len(COLUMNS)} arrangements with e = {listed(map(number, RESTITUTIONS))} at every contact, without gravity, and "
    "held against exact laws: the state-transition model of Jia, Mason and Erdmann (2013), other laws of springs, and "
    f"laws of rigid bodies. {LAWS_WITH_LAWS}",
    "MuJoCo, PyBullet and Drake without a word in brackets have contacts that were set up here to be springs and "
    "dashpots of the stiffness and e asked for, at a step of a thousandth of the shorter contact period: where they "
    "follow that law they do what they were asked for. Steps in brackets are other shares of that period; “as it "
    "ships” is an engine in which nothing is set.",
    "D = √(Σ m Δv² / Σ m v₀²), Δv the difference of final velocities. D = 0 is the same outcome; a striker of 1 kg "
    "that stops instead of coming back at half its speed makes D = 0.5. The law of an engine is the one with the "
    f"smallest worst-case D, accepted up to {EXPLAINED}.",
)

BOARD = (
    f"The largest of all cases that an engine answers, of {len(CASES)}: springs and dashpots answer no e = 0. "
    "Farthest: D from its law, and from the next one; where that is as near, these cases do not tell the two apart. "
    "Energy is over that before, lost at e = 1; momentum, of cases without a table, over the sum of its absolute "
    "values before. Spread: D by gaps or overlaps of 1e-4 and 1e-6 radii, and, without a table, moved along the line "
    "and made in the other order (of: by which); step spread: by half and twice the step. Microseconds of a step, on "
    "one machine, while balls touch."
)

CRADLE = (
    f"How a {PICTURED} ends at e = 1: velocities of the five balls, over that of the striker before (grey). Exact laws "
    "first, in black, then engines; laws with the same row cannot be told apart by this collision."
)


def write_all(answers: Frame, judged: Frame, laws: Frame, root: Path) -> None:
    """Write everything into the folder of a scoreboard."""
    with replacing(root / ANSWERS) as temporary:
        answers.to_parquet(temporary, index=False, compression="zstd")
    with replacing(root / "board.csv") as temporary:
        judged.to_csv(temporary, index=False, lineterminator="\n")
    draw_cradle(judged, root)
    shown = judged.drop(columns=[f"D_{law}" for law in engine_free_names() if law != MODEL])
    blocks: list[Block] = [
        *LEAD,
        Section("The board", [board_of(laws)]),
        Section("One ball strikes four", [Figure("cradle", CRADLE)]),
        Section(
            "All answers",
            [table_of(shown, f"In the usual arrangement; {ANSWERS} holds the others.", 5)],
            folded=True,
        ),
    ]
    write_text(root / "report.html", page_of(TITLE, blocks, root))


def draw_cradle(judged: Frame, folder: Path) -> None:
    """Draw how the balls of a cradle leave, a row a solver."""
    found = judged[(judged.case == PICTURED) & (judged.e == 1)].set_index("solver")
    v = -found[[f"v{i}" for i in range(1, 6)]].dropna()
    colors = ["#0b5cad" if is_engine(name) else "#1a1a1a" for name in v.index]
    with drawing(9.5, 0.8 + 0.26 * len(v)) as figure:
        axes = figure.subplots(1, 5, sharey=True)
        for ball, ax in enumerate(axes, 1):
            ax.barh(range(len(v)), v[f"v{ball}"], height=0.7, color=colors)
            ax.axvline(1.0 if ball == 1 else 0.0, color="0.6", linewidth=3, zorder=0)
            ax.set(xlim=(-0.7, 1.1), title=f"ball {ball}", xlabel="v/v0 (-)")
        axes[0].set_yticks(range(len(v)), list(map(named, v.index)))
        axes[0].invert_yaxis()
    save(figure, folder, "cradle")


def how(row: Frame) -> str:
    """Say how a solver answers, by its row of `judging.laws`."""
    if row.farthest > EXPLAINED:
        return f"as no exact law (nearest: {row.law})"
    tied = row.next_farthest - row.farthest < TIED
    said = f"as {row.law} ({description_of(row.law).removeprefix('rigid, exact: ')})"
    return said + f"; {row.next} says the same here" * tied


def board_of(laws: Frame) -> Table:
    """Lay out the board: an engine a row."""
    own = laws[list(map(is_engine, laws.index))].drop(columns=["law", "next"])
    own.insert(0, "engine", list(map(named, own.index)))
    own.insert(1, "answers", [how(row) for _, row in laws.loc[own.index].iterrows()])
    return table_of(own, BOARD, 2)


def table_of(frame: Frame, caption: str, text: int) -> Table:
    """Lay out a frame, its numbers in three digits."""
    rows = [[number(x) if isinstance(x, float) else x for x in row] for row in frame.to_numpy(object)]
    return Table([name.replace("_", " ") for name in frame], rows, caption, text)
