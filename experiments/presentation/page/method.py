"""What a run compares, for the head of its page, and how its numbers came about."""

from __future__ import annotations

from impact_xval.experiments.config.axes import AXES
from impact_xval.experiments.measures.summary import Summary
from impact_xval.experiments.presentation.document import Section
from impact_xval.experiments.presentation.words import LAWS_WITH_LAWS, named
from impact_xval.experiments.tables.folder import RunFolder
from impact_xval.experiments.tables.numbers import listed, number
from impact_xval.experiments.tables.parquet import column


def question(summary: Summary) -> str:
    """Say what was compared."""
    solvers = listed(named(name) for name in summary.solvers)
    if summary.config.column is not None:
        beginning = (
            "Balls in a line collide at once. The state-transition model of Jia, Mason and Erdmann, for N balls that "
            f"stay in place while they collide, solves that; here are {summary.n_cells} such columns "
            f"({listed(map(str, summary.levels['arrangement'].values))}) by {solvers} beside it."
        )
    else:
        spans = [_span(summary, axis, label) for axis, label in AXES.items() if axis in summary.axes]
        beginning = (
            "A ball falls on a ball that rests on a table, and two contacts are hit at once. Can a physics engine be "
            f"trusted with that? Here are {summary.n_cells} such collisions ({', '.join(spans) or 'of one cell'}), "
            "solved exactly by the state-transition model of Jia, Mason and Erdmann (2013), in which bodies stay in "
            f"place while they collide, and by {solvers}."
        )
    return (
        f"{beginning} Exact Kelvin-Voigt is what engines are set to, springs with dashpots; exact bistiffness is the "
        "model's own restitution in bodies that move. The model is the yardstick, not the truth. "
        f"{LAWS_WITH_LAWS}"
    )


def _span(summary: Summary, axis: str, label: str) -> str:
    """Say from where to where an axis goes."""
    values = summary.axes[axis]
    return f"{label} from {number(min(values))} to {number(max(values))}"


def section(folder: RunFolder, summary: Summary) -> Section:
    """Say how the numbers came about, and what they do not show."""
    said = _of_pair(folder, summary) if summary.config.column is None else _of_columns(summary)
    return Section("Method", said, folded=True)


def _of_pair(folder: RunFolder, summary: Summary) -> list[str]:
    c = summary.config
    if c.scenario == "drop":
        values = column(folder.root / "cells.parquet", "gravity_number")
        span = " to ".join(dict.fromkeys(number(value, 2) for value in (values.min(), values.max())))
        scenario = (
            f"Scenario drop: gravity {c.gravity} m/s² acts in the solvers until their first flight, but not "
            f"in the model; B2 starts in static equilibrium. Gravity matters by g/(|v0| ω1) = {span}."
        )
    else:
        scenario = "Scenario impact: no gravity; B1 touches B2 with v0."
    return [
        "Each cell is one collision: ball B1 falls onto ball B2, which rests on a fixed table, at m1 = "
        f"{number(c.m1)} kg, k1 = {number(c.k1)} N/m, v0 = {number(c.v0)} m/s. Every solver is given the "
        "same stiffnesses k1, k2, and restores e1, e2 in a single contact by a law of its own; engines by "
        f"dashpots ({c.mapping} mapping; one whose name ends in “naive” by the naive one), with a step of "
        f"{c.step_fraction} of the period of the faster contact. A collision is over at the first instant "
        "when the balls are apart, B2 is off the table or at rest on it, and v1 ≥ v2 ≥ 0. D = sqrt((m1 "
        "dv1² + m2 dv2²)/(m1 v0²)). Before state paths are compared, a state held for less than "
        f"{c.shortest_state} of the period of the faster contact is merged into the one before it. Cut-off "
        f"of the model's running stiffness ratio: {c.stiffness_ratio_cutoff}.",
        scenario,
        "The model assumes a fixed configuration: a contact that opened returns when its relative velocity "
        "turns, not when a gap has closed. Compliant solvers have gaps. The dashpot is chosen from the "
        "mass of one pair alone; a third body on the contact changes what it restores.",
        f"Marked cells are those whose grazing margin in the model is below {c.grazing_threshold}, or where "
        "a change of a thousandth in a parameter moves the exact outcome of the solver's law by 0.01, or "
        "one of four thousandths by 0.02.",
        "One dimension, no friction, no rotation.",
    ]


def _of_columns(summary: Summary) -> list[str]:
    c = summary.config
    return [
        f"Each column is N balls in a line, ball 1 on top, up is positive, at m1 = {number(c.m1)} kg, k1 = "
        f"{number(c.k1)} N/m^p, v0 = {number(c.v0)} m/s, without gravity. In a chain ball 1 strikes a row "
        "at rest, in a cradle several balls do; in a drop ball 1 falls on balls that rest on a table, in a "
        "stack all balls fall together. All contacts restore e; each next mass and stiffness is the taper "
        "times the last. The model answers a column exactly for linear contacts, within 1e-11 for others; "
        "every other solver restores e in a single contact by a law of its own, engines by dashpots "
        f"({c.mapping} mapping) with a step of {c.step_fraction} of the shortest period of a contact. A "
        "collision is over when no contact carries force and no bodies approach. D = sqrt(sum m_i "
        "dv_i²/sum m_i v_i0²).",
        "The model assumes a fixed configuration: it knows no gaps, and a contact that opened returns when "
        "its relative velocity turns. The dashpot is chosen from the masses of one pair alone; further "
        "bodies in contact change what it restores. Columns whose grazing margin under the model is below "
        f"{c.grazing_threshold} are kept apart. One dimension, no gravity, no friction, no rotation.",
    ]
