"""What the page says a run compares, and the sections on what its numbers rest on: causes, limits, method, words."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import Any

import pandas as pd

from impact_xval.compliant_baselines.registry import is_engine, kind_of
from impact_xval.experiments.config.axes import AXES
from impact_xval.experiments.config.experiment import REFERENCE
from impact_xval.experiments.measures.summary import HONEST, Summary
from impact_xval.experiments.presentation import findings, words
from impact_xval.experiments.presentation.document import Block, Piece, Section, Table, Value, together
from impact_xval.experiments.presentation.findings import CUTS, D, unit_of
from impact_xval.experiments.presentation.html import render
from impact_xval.experiments.presentation.words import MEANINGS, begun, named
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


def opening(summary: Summary, numbers: Iterable[tuple[Value, str]]) -> Piece:
    """Say what was compared, and what to remember of it."""
    config = summary.config
    spans = [
        f"{AXES[axis]} from {number(min(x))} to {number(max(x))}"
        for axis, x in summary.axes.items()
        if axis in AXES
    ]
    return render(
        "opening.html.j2",
        c=config,
        pair=config.column is None,
        n=summary.n_cells,
        spans=", ".join(spans),
        arrangements=listed(map(str, summary.levels["arrangement"].values)) if config.column else "",
        solvers=listed(named(name) for name in summary.solvers),
        laws=begun("; ".join(said for name, said in _LAWS.items() if name in summary.solvers)),
        weightless=listed(named(name) for name in config.solvers if kind_of(name) == "model"),
        engines=any(map(is_engine, summary.solvers)),
        words=words,
        numbers=[*numbers],
    )


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
    span: list[str] = []
    if summary.config.scenario == "drop":
        values = column(folder.root / "cells.parquet", "gravity_number")
        span = [number(value, 2) for value in (values.min(), values.max())]
    said = render("method.html.j2", c=summary.config, gravity_number=" to ".join(dict.fromkeys(span)))
    return Section("Method", [said], folded=True)


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
    """Say with what a run was computed: all that its manifest holds."""
    rows = [*_flat({key: value for key, value in folder.manifest().items() if key != "statuses"})]
    return Section("Provenance", [Table(["what", "value"], rows, text=2)], folded=True)


def _flat(value: Any, *names: str) -> Iterator[tuple[str, Any]]:
    """Give what nested tables and lists hold, by the names that lead to it."""
    if isinstance(value, list):
        value = {str(place): each for place, each in enumerate(value, 1)}
    if not isinstance(value, dict):
        yield " ".join(names), value
        return
    for name, each in value.items():
        yield from _flat(each, *names, name)
