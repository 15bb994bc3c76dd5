"""What the page says a run compares, and the sections on what its numbers rest on: causes, limits, method, words."""

from __future__ import annotations

from collections.abc import Sequence

import pandas as pd

from impact_xval.compliant_baselines.registry import is_engine, kind_of
from impact_xval.experiments.config.axes import AXES
from impact_xval.experiments.config.experiment import REFERENCE
from impact_xval.experiments.measures.summary import HONEST, Summary
from impact_xval.experiments.presentation import findings
from impact_xval.experiments.presentation.document import Block, Section, Table, together
from impact_xval.experiments.presentation.findings import CUTS, D, unit_of
from impact_xval.experiments.presentation.words import LAWS_WITH_LAWS, MEANINGS, begun, named
from impact_xval.experiments.tables.folder import RunFolder
from impact_xval.experiments.tables.numbers import listed, number, percent
from impact_xval.experiments.tables.parquet import column

_REASONS = 10

#: What is said of limits dt -> 0: columns of `Summary.estimates`.
_ERRORS = ("step", "error", "asked")

#: What the laws are that stand beside the model in most runs.
_LAWS = {
    "kelvin-voigt": "exact Kelvin-Voigt is what engines are set to, springs with dashpots",
    "bistiffness": "exact bistiffness is the model's own restitution in bodies that move",
}

GLOSSARY = (
    ("model", "the state-transition model of Jia, Mason and Erdmann, solved exactly"),
    ("S1, S2, S3, S4", "contact states: both contacts act; ball on table only; ball on ball only; none"),
    ("solver", "the model, a reference, or an engine"),
    ("reference", "a contact law followed in time without an engine, exactly or with a stated error"),
    ("exact bistiffness", "springs that are stiffer when they restore: the model's restitution in real time"),
    ("exact Kelvin-Voigt", "springs and dashpots: what engines are asked for"),
    ("restitution e", "energetic: e² is the share of the work of compression that restitution returns"),
    ("share", "the part of D that one cause accounts for; the shares of a cell sum to 100 %"),
    (
        "limit dt -> 0",
        "where an engine's result goes as its step shrinks, with an estimate of how well that is known",
    ),
    ("marked", "beside a jump, where an arbitrarily small change of a parameter ends in another outcome"),
    ("limit (a status)", "a closed-form limiting case of the model was used"),
)


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
        spans = [
            f"{AXES[axis]} from {number(min(values))} to {number(max(values))}"
            for axis, values in summary.axes.items()
        ]
        beginning = (
            "A ball falls on a ball that rests on a table, and two contacts are hit at once. Solvers differ on how "
            f"that ends: by how much, and why? Here are {summary.n_cells} such collisions "
            f"({', '.join(spans) or 'of one cell'}), solved by the state-transition model of Jia, "
            "Mason and Erdmann (2013), in which bodies stay in place while they collide, and by "
            f"{solvers}."
        )
    weightless = listed(named(name) for name in summary.config.solvers if kind_of(name) == "model")
    laws = "; ".join(said for name, said in _LAWS.items() if name in summary.solvers)
    given = [
        beginning,
        begun(f"{laws}.") * bool(laws),
        f"Gravity acts in all but {weightless}." * (summary.config.scenario == "drop"),
        f"Engines take steps of {number(summary.config.step_fraction)} of the faster contact's period."
        * any(map(is_engine, summary.solvers)),
        f"The model is the yardstick, not the truth. {LAWS_WITH_LAWS}",
    ]
    return " ".join(filter(None, given))


def causes(summary: Summary, figures: Sequence[Block]) -> Section:
    """Say what divergences consist of."""
    ladder = summary.ladder
    if not ladder.solvers:
        return Section("Causes", ["No engine has a result: there is nothing to split."])
    several = "three causes" if ladder.orders == "six" else "two causes"
    said = (
        "Between the model and what an engine was asked for one thing is changed at a time, in every "
        "order, and the mean differences sum to the engine's divergence exactly, in every cell. The share "
        "of a cause is the component of its difference of velocities along the whole difference, over D; "
        f"it is the mean over the {ladder.orders} orders of the first {several}. Over a region it is summed "
        "over cells, over the sum of D. Shares are signed and sum to 100 %."
    )
    header = ["contribution", "from", "to", "in words"]
    rows = [(c.label, c.before, c.after, MEANINGS.get(c.name, "")) for c in ladder.present]
    details = Section("Causes in detail", [Table(header, rows, text=4), *figures], folded=True)
    return Section("Causes", [said, findings.region_table(ladder, named), details])


def sureness(summary: Summary) -> Section:
    """Say how well results are known: limits of steps, statuses, and which cells count."""
    limits = summary.statuses.loc[REFERENCE].get("limit", 0)
    said = [
        "Nothing is random: the same run gives the same numbers. Every collision of an engine is run at "
        "several steps, and extrapolated to a step of zero with an estimate of the error.",
        *(f"{each}." for each in findings.unsolved(summary)),
        *([f"In {limits} cells the model is a limiting case in closed form."] if limits else []),
        findings.counted(summary),
    ]
    header = ["solver", "asked for", "converged", "error order", "step error", "estimated error of the limit"]
    header += [
        "limit's distance from the law",
        "largest regularisation",
        f"within {number(HONEST)} estimates",
    ]
    rows = [
        (
            named(row["solver"]),
            named(row["asked"] or "-"),
            f"{row['converged']} of {row['n']}",
            number(row["order"], 2),
            *(" / ".join(number(row[f"{kind}_{cut}"], 2) for cut in ("median", "max")) for kind in _ERRORS),
            number(row["regularisation"], 2),
            percent(row["honest"]),
        )
        for row in summary.estimates.to_dict("records")
    ]
    caption = (
        "Limits dt -> 0 of engines, and the exact solver of the law they were asked for: velocities per "
        "|v0|, the largest of all balls, median / maximum"
    )
    return Section("How sure is it?", [together(said), Table(header, rows, caption, text=3)])


def effective(folder: RunFolder) -> Section:
    """Say which solvers use other numbers than they were asked for."""
    rows = pd.read_parquet(folder.root / "cells.parquet", columns=["solver", "differences"]).dropna()
    found: list[Block] = [
        f"{named(str(name))} uses other numbers than it was asked for in {len(each)} cells, in the first: "
        f"{each.iloc[0]}."
        for name, each in rows.groupby("solver").differences
    ]
    said = "Stiffness, damping, restitution and step of an engine are read back after they were set."
    none = "All are as requested, to the engines' own precision."
    return Section("Requested and effective", [said, *(found or [none])])


def unsolved(summary: Summary) -> Section:
    """Count results by status, and say why there are none and which are kept apart."""
    statuses, unit, more = summary.statuses, unit_of(summary), len(summary.reasons) - _REASONS
    counts = [(named(name), *row) for name, row in zip(statuses.index, statuses.to_numpy(), strict=True)]
    reasons = [(named(name), *rest) for name, *rest in summary.reasons.head(_REASONS).to_numpy()]
    marked = [
        (named(name), int(row["n"]), *(number(row[cut]) for cut in CUTS))
        for name in summary.solvers
        if (row := summary.get(name, D, cells="marked"))["n"]
    ]
    why = f"Why {unit} have no result" + (f" (and {more} reasons more, in cells.parquet)" if more > 0 else "")
    tables = [
        Table(["solver", *statuses], counts, f"{unit} by solver and status".capitalize()),
        Table(["solver", "status", "reason", unit], reasons, why, text=3),
        Table(["solver", unit, "median", "95 %", "max"], marked, f"D in the marked {unit}"),
    ]
    return Section("Marked and unsolved", tables, folded=True)


def method(folder: RunFolder, summary: Summary) -> Section:
    """Say how the numbers came about, and what they do not show."""
    said = _method_of_pair(folder, summary) if summary.config.column is None else _method_of_columns(summary)
    return Section("Method", said, folded=True)


def _method_of_pair(folder: RunFolder, summary: Summary) -> list[str]:
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


def _method_of_columns(summary: Summary) -> list[str]:
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


def glossary(summary: Summary) -> Section:
    """Say what words mean, and what solvers are called in tables and commands."""
    pair = summary.config.column is None
    rows = [(word, f"{meaning}.") for word, meaning in GLOSSARY if pair or not word.startswith("S1")]
    names = [(named(name), name) for name in summary.config.solvers]
    tables = [
        Table(["word", "meaning"], rows, text=2),
        Table(["solver", "in tables and commands"], names, text=2),
    ]
    return Section("Glossary", tables, folded=True)


def provenance(folder: RunFolder) -> Section:
    """Say with what a run was computed."""
    manifest = folder.manifest()
    rows = [
        *((key, manifest.get(key)) for key in ("cells", "identity")),
        *((f"version of {name}", value) for name, value in manifest.get("versions", {}).items()),
        *((f"library {name}", value) for name, value in manifest.get("libraries", {}).items()),
        *manifest.get("machine", {}).items(),
        ("seeds", manifest.get("seeds")),
    ]
    for i, each in enumerate(manifest.get("sessions", []), start=1):
        said = f"finished {each['finished']}, {each['wall_time_s']} s on {each['workers']} workers, "
        said += f"{each['parts_computed']} parts computed, {each['parts_reused']} reused"
        rows.append((f"session {i}", said))
    return Section("Provenance", [Table(["what", "value"], rows, text=2)], folded=True)
