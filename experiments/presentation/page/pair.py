"""The page of a run of two balls on a table, section by section."""

from __future__ import annotations

import math

from impact_xval.experiments.config.axes import AXES
from impact_xval.experiments.config.experiment import REFERENCE
from impact_xval.experiments.measures.aggregates import FULL_PATHS, OWN_LAW
from impact_xval.experiments.measures.summary import Summary
from impact_xval.experiments.presentation import findings
from impact_xval.experiments.presentation.document import Block, Section, Table, Text, Value, say
from impact_xval.experiments.presentation.findings import D, compared, subjects, value_of
from impact_xval.experiments.presentation.html import render
from impact_xval.experiments.presentation.page import parts
from impact_xval.experiments.presentation.page.parts import Captions, code, figure
from impact_xval.experiments.presentation.pictures.steps import recommended
from impact_xval.experiments.presentation.words import LAWS_WITH_LAWS, WHAT_D_IS, named, one_vote
from impact_xval.experiments.sweep.examination import traps_note
from impact_xval.experiments.tables.folder import RunFolder, cells_of_run
from impact_xval.experiments.tables.numbers import listed, number, percent
from impact_xval.experiments.tables.parquet import column


def blocks_of(folder: RunFolder, summary: Summary, captions: Captions) -> list[Block]:
    """Return the page of a finished run."""
    there = compared(summary)
    axes = [f"{label} from {span}" for axis, label in AXES.items() if (span := _span(summary, axis))]
    question = (
        "A ball falls on a ball that rests on a table, and two contacts are hit at once. Can a physics "
        f"engine be trusted with that? Here are {summary.n_cells} such collisions "
        f"({', '.join(axes) or 'of one cell'}), solved exactly by the state-transition model of Jia, Mason "
        "and Erdmann (2013), in which bodies stay in place while they collide, and by "
        f"{listed(named(name) for name in summary.solvers)}. Exact Kelvin-Voigt is what engines are set to, "
        "springs with dashpots; exact bistiffness is the model's own restitution in bodies that move. The "
        f"model is the yardstick, not the truth. {LAWS_WITH_LAWS}"
    )
    nothing: list[Block] = ["No cell could be compared."]
    return [
        render("sketch.html.j2"),
        question,
        WHAT_D_IS,
        parts.numbers(summary),
        *([_advice(folder, summary, captions)] if summary.ladder.solvers else []),
        Section("What was found", _found(summary, captions) if there else nothing),
        Section("Cell by cell", _cells(folder, summary) if there else nothing),
        Section("All against all", [_matrix(summary)] if there else nothing),
        parts.causes_section(summary, captions),
        parts.sureness_section(summary),
        _hypothesis(),
        parts.effective_section(folder),
        _by_axis(summary, captions),
        _paths(summary),
        parts.unsolved_section(summary),
        _method(folder, summary),
        parts.glossary_section(summary),
        parts.provenance_section(folder),
    ]


def _span(summary: Summary, axis: str) -> str:
    """Say from where to where an axis goes; empty where it has one value."""
    values = sorted(summary.levels[axis].values)
    return f"{number(values[0])} to {number(values[-1])}" if len(values) > 1 else ""


def _advice(folder: RunFolder, summary: Summary, captions: Captions) -> Section:
    """Say what a reader should do with an engine."""
    steps = recommended(summary)
    traps = traps_note(summary.config, cells_of_run(folder, summary.config))
    example = "impact-xval contact --engine mujoco --masses 1 0.5 --restitution 0.7 --stiffness 1e6"
    blocks: list[Block] = [
        say(
            "Look for traps: {command} lists the contacts of a scene with what is known to go wrong. {said}",
            command=code("impact-xval inspect scene.xml"),
            said=traps["introduction"],
        ),
        *traps["found"],
        say(
            "Map a stiffness and a restitution to the engine's own parameters, checked by a simulated drop: {command}.",
            command=code(example),
        ),
        *(
            [
                say(
                    "Choose the step by the faster contact, whose period is 2 pi sqrt(M/k) with M the reduced "
                    "mass of its bodies (with the table, the mass of the ball). {steps}",
                    steps=parts.steps_of(summary, steps),
                )
            ]
            if steps
            else []
        ),
        "The rest is the contact law, not the step: a smaller step does not remove it, and the sections below "
        "show where it matters.",
        *figure(captions, "error-by-step"),
    ]
    return Section("What to do with your engine", blocks, beside=True)


def _found(summary: Summary, captions: Captions) -> list[Block]:
    """Return the findings, a picture each."""
    there = subjects(summary)
    return parts.found(
        captions,
        (
            "How far are they from the model?",
            [findings.how_far(summary), one_vote(summary.solvers)],
            "divergence-by-stiffness",
        ),
        ("Do engines do what they were asked for?", findings.as_asked(summary), "impulse-curves"),
        ("Then why do they diverge?", parts.why(summary), "ladder-by-stiffness"),
        ("Where does it matter?", [_extremes(summary, name) for name in there], "trust-map"),
        (
            "Do contacts open and close in the same order?",
            [_order(summary, name) for name in there],
            "state-paths",
        ),
    )


def _extremes(summary: Summary, name: str) -> Text | str:
    """Say at which k2/k1 the median D is largest and smallest."""
    levels = summary.levels["stiffness_ratio"].values
    values = [(at, value_of(summary, name, axis="stiffness_ratio", at=at)) for at in levels]
    known = sorted((each for each in values if not math.isnan(each[1].value)), key=lambda each: each[1].value)
    low, high = known[0], known[-1]
    if low[1].value == high[1].value:
        return ""
    return say(
        "By k2/k1 the median D of {solver} is largest, {most}, at {high}, and smallest, {least}, at {low}.",
        **{
            "solver": named(name),
            "most": high[1],
            "high": number(high[0]),
            "least": low[1],
            "low": number(low[0]),
        },
    )


def _order(summary: Summary, name: str) -> Text:
    """Say how often a solver passes through the states of the model, and of its own law."""
    said = say(
        "{solver} passes through the contact states of the model in {equal} of the {n} cells in which the "
        "model needed no limiting case",
        solver=named(name),
        equal=value_of(summary, name, "mean", FULL_PATHS),
        n=value_of(summary, name, "n", FULL_PATHS),
    )
    own = value_of(summary, name, "mean", OWN_LAW)
    if math.isnan(own.value):
        return Text((said, "."))
    return Text((said, say(", and through those of the exact law it was asked for in {own}.", own=own)))


def _cells(folder: RunFolder, summary: Summary) -> list[Block]:
    """Lay out the map whose cells open, and the cells with the largest D."""
    piece, button = parts.opening(folder, summary)
    rows = [
        (
            row["solver"],
            *((row[key] or "-") for key in ("model_states_compared", "states_compared")),
            button(row["cell"]),
            *(number(row[key]) for key in (*AXES, D, "dv1", "dv2")),
        )
        for row in parts.worst_of(summary)
    ]
    header = ["solver", "model's path", "solver's path", "cell", *AXES.values(), "D", "dv1", "dv2"]
    worst = Table(header, rows, "The cells with the largest D of every solver; velocities per |v0|", text=4)
    return [piece, Section("Largest divergences", [worst], folded=True)]


def _matrix(summary: Summary) -> Table:
    """Lay out D between every two solvers."""
    names = [REFERENCE, *summary.solvers]
    known = {(REFERENCE, name): summary.get(name, D) for name in summary.solvers}
    known |= {(row["solver"], row["other"]): row for _, row in summary.between.iterrows()}

    def cell(a: str, b: str) -> str | Text:
        if names.index(a) >= names.index(b):
            return ""  # it stands on the other side
        row = known.get((a, b), known.get((b, a)))
        if row is None or not row["n"]:
            return "-"
        return say(
            "{median} ({most})",
            **{
                key: Value(row[cut], f"{a} from {b} {cut}")
                for key, cut in (("median", "median"), ("most", "max"))
            },
        )

    rows = [(named(a), *(cell(a, b) for b in names[1:])) for a in names[:-1]]
    caption = "Median D (largest D) between every two solvers, over the cells that both solved, marked ones left out"
    return Table(["", *map(named, names[1:])], rows, caption)


def _hypothesis() -> Section:
    said = say(
        "The model has a limit of its own: where one contact is infinitely stiffer than the other, its two "
        "bodies move as one. Whether solvers go there, and how fast, is no matter of a grid: {command} "
        "writes a page with a verdict for every limit and solver.",
        command=code("impact-xval hypothesis"),
    )
    return Section("Hypothesis", [said])


def _by_axis(summary: Summary, captions: Captions) -> Section:
    """Tabulate D along every axis, and draw the figures for print."""
    blocks: list[Block] = [findings.along_axis(summary, axis, label) for axis, label in AXES.items()]
    blocks += [
        each
        for name in ("divergence-map", "divergence-by-restitution", "energy-by-stiffness")
        for each in figure(captions, name)
    ]
    return Section("By axis", ["All measures by all axes are in summary.csv.", *blocks], folded=True)


def _paths(summary: Summary) -> Section:
    """Tabulate how often state paths are equal."""
    levels = findings.spread(summary.levels["stiffness_ratio"].values)
    regions: list[tuple[str, tuple[str, object]]] = [
        (number(value), ("stiffness_ratio", value)) for value in levels
    ]
    rows = [
        (label, *(percent(summary.get(name, FULL_PATHS, *place)["mean"]) for name in summary.solvers))
        for label, place in [*regions, ("all", ("all", ""))]
    ]
    caption = (
        "Share of cells whose state path equals the model's, by k2/k1, where the model needed no limiting case; "
        f"every path without states held for less than {number(summary.config.shortest_state)} of the "
        "shorter contact period"
    )
    return Section("State paths", [Table(["k2/k1", *summary.solvers], rows, caption)], folded=True)


def _method(folder: RunFolder, summary: Summary) -> Section:
    """Say how the numbers came about, and what they do not show."""
    c = summary.config
    setting = (
        "Each cell is one collision: ball B1 falls onto ball B2, which rests on a fixed table, at m1 = "
        f"{number(c.m1)} kg, k1 = {number(c.k1)} N/m, v0 = {number(c.v0)} m/s. Every solver is given the "
        "same stiffnesses k1, k2, and restores e1, e2 in a single contact by a law of its own; engines by "
        f"dashpots ({c.mapping} mapping; one whose name ends in “naive” by the naive one), with a step of "
        f"{c.step_fraction} of the period of the faster contact. A collision is over at the first instant "
        "when the balls are apart, B2 is off the table or at rest on it, and v1 ≥ v2 ≥ 0. D = sqrt((m1 "
        "dv1² + m2 dv2²)/(m1 v0²)). Before state paths are compared, a state held for less than "
        f"{c.shortest_state} of the period of the faster contact is merged into the one before it. Cut-off "
        f"of the model's running stiffness ratio: {c.stiffness_ratio_cutoff}."
    )
    if c.scenario == "drop":
        values = column(folder.root / "cells.parquet", "gravity_number")
        span = " to ".join(dict.fromkeys(number(value, 2) for value in (values.min(), values.max())))
        scenario = (
            f"Scenario drop: gravity {c.gravity} m/s² acts in the solvers until their first flight, but not "
            f"in the model; B2 starts in static equilibrium. Gravity matters by g/(|v0| ω1) = {span}."
        )
    else:
        scenario = "Scenario impact: no gravity; B1 touches B2 with v0."
    limits = [
        "The model assumes a fixed configuration: a contact that opened returns when its relative velocity "
        "turns, not when a gap has closed. Compliant solvers have gaps. The dashpot is chosen from the "
        "mass of one pair alone; a third body on the contact changes what it restores.",
        f"Marked cells are those whose grazing margin in the model is below {c.grazing_threshold}, or where "
        "a change of a thousandth in a parameter moves the exact outcome of the solver's law by 0.01, or "
        "one of four thousandths by 0.02.",
        "One dimension, no friction, no rotation.",
    ]
    return Section("Method", [setting, scenario, *limits], folded=True)
