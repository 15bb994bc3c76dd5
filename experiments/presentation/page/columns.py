"""The page of a run of columns of balls, section by section."""

from __future__ import annotations

from impact_xval.experiments.config.arrangements import COLUMN_AXES
from impact_xval.experiments.measures.summary import Summary
from impact_xval.experiments.presentation import findings
from impact_xval.experiments.presentation.document import Block, Section, Table, Text, say
from impact_xval.experiments.presentation.findings import compared, subjects, value_of
from impact_xval.experiments.presentation.page import parts
from impact_xval.experiments.presentation.page.parts import Captions, figure
from impact_xval.experiments.presentation.words import LAWS_WITH_LAWS, WHAT_D_IS, named, one_vote
from impact_xval.experiments.tables.folder import RunFolder
from impact_xval.experiments.tables.numbers import listed, number


def blocks_of(folder: RunFolder, summary: Summary, captions: Captions) -> list[Block]:
    """Return the page of a finished run."""
    arrangements = listed(map(str, summary.levels["arrangement"].values))
    question = (
        "Balls in a line collide at once. The state-transition model of Jia, Mason and Erdmann, for N "
        f"balls that stay in place while they collide, solves that; here are {summary.n_cells} such columns "
        f"({arrangements}) by {listed(named(name) for name in summary.solvers)} beside it. Exact "
        "Kelvin-Voigt is what engines are set to, springs with dashpots; exact bistiffness is the model's "
        f"own restitution in bodies that move. The model is the yardstick, not the truth. {LAWS_WITH_LAWS}"
    )
    found: list[Block] = ["No column could be compared."]
    if compared(summary):
        found = _found(summary, captions)
    shown = {title.title for title in found if isinstance(title, Section)}
    rest = {"What do more balls change?": "velocities", "Do engines do what they were asked for?": "wave"}
    others = [each for title, name in rest.items() if title not in shown for each in figure(captions, name)]
    return [
        question,
        WHAT_D_IS,
        parts.numbers(summary),
        Section("What was found", [*found, *others]),
        *([Section("Column by column", _cells(folder, summary))] if compared(summary) else []),
        Section("Divergence by solver", [findings.overall_table(summary)]),
        parts.causes_section(summary, captions),
        parts.sureness_section(summary),
        parts.effective_section(folder),
        _by_axis(summary),
        parts.unsolved_section(summary),
        _method(summary),
        parts.glossary_section(summary),
        parts.provenance_section(folder),
    ]


def _found(summary: Summary, captions: Captions) -> list[Block]:
    """Return the findings, a picture each."""
    several = len(summary.levels["balls"].values) > 1
    return parts.found(
        captions,
        (
            "How far are they from the model?",
            [findings.how_far(summary), one_vote(summary.solvers)],
            "divergence-by-balls",
        ),
        (
            "What do more balls change?",
            [_balls(summary, name) for name in subjects(summary) if several],
            "velocities",
        ),
        ("Do engines do what they were asked for?", findings.as_asked(summary), "wave"),
        ("Then why do they diverge?", parts.why(summary), "ladder-by-balls"),
        (
            "Who keeps more energy?",
            ["Above zero a solver dissipates less than the model."],
            "energy-by-balls",
        ),
    )


def _balls(summary: Summary, name: str) -> Text:
    """Say what the median D is for the fewest and for the most balls."""
    values = summary.levels["balls"].values
    few, many = (value_of(summary, name, axis="balls", at=at) for at in (values[0], values[-1]))
    return say(
        "The median D of {solver} is {few} at {low} balls and {many} at {high}.",
        **{"solver": named(name), "few": few, "many": many, "low": int(values[0]), "high": int(values[-1])},
    )


def _cells(folder: RunFolder, summary: Summary) -> list[Block]:
    """Lay out the map whose columns open, and the columns with the largest D."""
    piece, button = parts.opening(folder, summary)
    axes = [axis for axis in COLUMN_AXES if axis != "arrangement"]
    rows = [
        (
            row.solver,
            row.arrangement,
            button(row.cell),
            *(number(row[axis]) for axis in (*axes, "velocity_divergence", "largest_dv")),
        )
        for row in parts.worst_of(summary)
    ]
    header = [
        "solver",
        "arrangement",
        "column",
        *(COLUMN_AXES[axis] for axis in axes),
        "D",
        "largest dv/|v0|",
    ]
    worst = Table(header, rows, "The columns with the largest D of every solver", text=3)
    return [piece, Section("Largest divergences", [worst], folded=True)]


def _by_axis(summary: Summary) -> Section:
    """Tabulate D along every axis that has several values."""
    tables: list[Block] = [findings.along_axis(summary, axis, COLUMN_AXES[axis]) for axis in summary.axes]
    return Section("By axis", ["All measures by all axes are in summary.csv.", *tables], folded=True)


def _method(summary: Summary) -> Section:
    """Say how the numbers came about, and what they do not show."""
    c = summary.config
    setting = (
        f"Each column is N balls in a line, ball 1 on top, up is positive, at m1 = {number(c.m1)} kg, k1 = "
        f"{number(c.k1)} N/m^p, v0 = {number(c.v0)} m/s, without gravity. In a chain ball 1 strikes a row "
        "at rest, in a cradle several balls do; in a drop ball 1 falls on balls that rest on a table, in a "
        "stack all balls fall together. All contacts restore e; each next mass and stiffness is the taper "
        "times the last. The model answers a column exactly for linear contacts, within 1e-11 for others; "
        "every other solver restores e in a single contact by a law of its own, engines by dashpots "
        f"({c.mapping} mapping) with a step of {c.step_fraction} of the shortest period of a contact. A "
        "collision is over when no contact carries force and no bodies approach. D = sqrt(sum m_i "
        "dv_i²/sum m_i v_i0²)."
    )
    limits = (
        "The model assumes a fixed configuration: it knows no gaps, and a contact that opened returns when "
        "its relative velocity turns. The dashpot is chosen from the masses of one pair alone; further "
        "bodies in contact change what it restores. Columns whose grazing margin under the model is below "
        f"{c.grazing_threshold} are kept apart. One dimension, no gravity, no friction, no rotation."
    )
    return Section("Method", [setting, limits], folded=True)
