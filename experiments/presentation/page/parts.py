"""Parts that the pages of two balls and of columns share."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import pandas as pd
from markupsafe import Markup

from impact_xval.experiments.config.experiment import REFERENCE
from impact_xval.experiments.measures.ladder import cancelling
from impact_xval.experiments.measures.summary import HONEST, Summary, load_divergence
from impact_xval.experiments.presentation import findings
from impact_xval.experiments.presentation.document import (
    Block,
    Figure,
    Section,
    Table,
    Text,
    Value,
    say,
    together,
)
from impact_xval.experiments.presentation.findings import (
    CUTS,
    D,
    asked,
    count_of,
    shares,
    subjects,
    unit_of,
    value_of,
)
from impact_xval.experiments.presentation.html import render
from impact_xval.experiments.presentation.page.charts import cells_piece
from impact_xval.experiments.presentation.page.opened import packed_cells
from impact_xval.experiments.presentation.page.tiles import tiles_of
from impact_xval.experiments.presentation.pictures.steps import ACCEPTED
from impact_xval.experiments.presentation.words import MEANINGS, named
from impact_xval.experiments.tables.folder import RunFolder
from impact_xval.experiments.tables.numbers import number, percent

#: Figures of a run: captions by name.
Captions = Mapping[str, str]

_REASONS = 10

#: What is said of limits dt -> 0: columns of `Summary.estimates`.
_ERRORS = ("step", "error", "asked")

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


def figure(captions: Captions, name: str) -> list[Block]:
    """Return a figure, if it was drawn."""
    return [Figure(name, captions[name])] if name in captions else []


def numbers(summary: Summary) -> Markup:
    """Lay out up to three numbers: how far, how near to what was asked for, and why."""
    shown: list[tuple[Value, str]] = []
    unit = unit_of(summary)
    for name in subjects(summary)[:1]:
        shown.append(
            (
                value_of(summary, name),
                f"is the median D of {named(name)} from the model, of {int(count_of(summary, name).value)} {unit}",
            )
        )
    for name, law, d in list(asked(summary))[:1]:
        what = "D" if summary.config.column is None else "distance of the limit dt -> 0, per |v0|,"
        shown.append(
            (
                d["median"],
                f"is the median {what} of {named(name)} from {named(law)}, the law it was set to",
            )
        )
    for name in summary.ladder.solvers[:1]:
        regions = [(f"all {unit}", ("all", math.nan)), *summary.ladder.regions.items()]
        there = [(label, place) for label, place in regions if len(summary.ladder.region(name, *place))]
        label, place = there[min(1, len(there) - 1)]  # the first region that is told apart
        causes = shares(summary, name, *place)
        if causes and cancelling(summary.ladder.region(name, *place).share) is None:
            cause, share = next(iter(causes.items()))
            shown.append((share, f"of {named(name)}'s mean D ({label}) is due to {findings.LABELS[cause]}"))
    return render("numbers.html.j2", numbers=shown)


def opening(folder: RunFolder, summary: Summary) -> tuple[Markup, Callable[[int], Markup | int]]:
    """Lay out the map whose cells open; and what opens a cell, its number where it does not."""
    tiles = tiles_of(load_divergence(folder, summary.config))
    opens = set(tiles.cells)
    piece = cells_piece(tiles, packed_cells(folder, tiles.cells), summary.config.solvers, summary.n_cells)
    button = Markup('<button type="button" data-cell="{0}">{0}</button>')
    return piece, lambda cell: button.format(cell) if cell in opens else cell


def worst_of(summary: Summary) -> Iterator[Any]:
    """Give the cells with the largest D, as rows of the table of divergence, in the order of the solvers."""
    order = summary.worst.solver.map(summary.solvers.index).sort_values(kind="stable").index
    return (row for _, row in summary.worst.loc[order].iterrows())


def causes_section(summary: Summary, captions: Captions) -> Section:
    """Say what divergences consist of."""
    ladder = summary.ladder
    if not ladder.solvers:
        return Section("Causes", ["No engine has a result: there is nothing to split."])
    causes = "three causes" if ladder.orders == "six" else "two causes"
    said = (
        "Between the model and what an engine was asked for one thing is changed at a time, in every "
        "order, and the mean differences sum to the engine's divergence exactly, in every cell. The share "
        "of a cause is the component of its difference of velocities along the whole difference, over D; "
        f"it is the mean over the {ladder.orders} orders of {causes}. Over a region it is summed "
        "over cells, over the sum of D. Shares are signed and sum to 100 %."
    )
    changed = Table(
        ["contribution", "from", "to", "in words"],
        [(c.label, c.before, c.after, MEANINGS.get(c.name, "")) for c in ladder.present],
        text=4,
    )
    details = [changed, findings.norm_table(ladder)]
    details += [
        each
        for name in ("ladder-by-restitution", "ladder-by-column", "ladder-norms")
        for each in figure(captions, name)
    ]
    return Section(
        "Causes",
        [said, with_names(findings.region_table(ladder)), Section("Causes in detail", details, folded=True)],
    )


def sureness_section(summary: Summary) -> Section:
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
    header += ["limit's distance from the law", "regularisation", f"within {number(HONEST)} estimates"]
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


def effective_section(folder: RunFolder) -> Section:
    """Say which solvers use other numbers than they were asked for."""
    rows = pd.read_parquet(folder.root / "cells.parquet", columns=["solver", "differences"]).dropna()
    found: list[Block] = [
        f"{named(str(name))} uses other numbers than it was asked for in {len(each)} cells, in the first: "
        f"{each.iloc[0]}."
        for name, each in rows.groupby("solver").differences
    ]
    said = "Stiffness, damping, restitution and step of an engine are read back after they were set."
    return Section(
        "Requested and effective",
        [said, *(found or ["All are as requested, to the engines' own precision."])],
    )


def unsolved_section(summary: Summary) -> Section:
    """Count results by status, and say why there are none and which are kept apart."""
    statuses, unit = summary.statuses, unit_of(summary)
    reasons = summary.reasons.head(_REASONS).to_numpy().tolist()
    more = len(summary.reasons) - len(reasons)
    blocks: list[Block] = [
        Table(
            ["solver", *statuses],
            [(name, *row) for name, row in statuses.iterrows()],
            f"{unit} by solver and status".capitalize(),
        ),
        Table(
            ["solver", "status", "reason", unit],
            reasons,
            f"Why {unit} have no result"
            + (f" (and {more} reasons more, in cells.parquet)" if more > 0 else ""),
            text=3,
        ),
    ]
    marked = [
        (name, int(row["n"]), *(number(row[cut]) for cut in CUTS))
        for name in summary.solvers
        if (row := summary.get(name, D, cells="marked"))["n"]
    ]
    return Section(
        "Marked and unsolved",
        [*blocks, Table(["solver", unit, "median", "95 %", "max"], marked, f"D in the marked {unit}")],
        folded=True,
    )


def glossary_section(summary: Summary) -> Section:
    """Say what words mean, and what solvers are called in tables and commands."""
    pair = summary.config.column is None
    rows = [(word, f"{meaning}.") for word, meaning in GLOSSARY if pair or not word.startswith("S1")]
    names = [(named(name), name) for name in summary.config.solvers]
    tables = [
        Table(["word", "meaning"], rows, text=2),
        Table(["solver", "in tables and commands"], names, text=2),
    ]
    return Section("Glossary", tables, folded=True)


def provenance_section(folder: RunFolder) -> Section:
    """Say with what a run was computed."""
    manifest: dict[str, Any] = folder.manifest()
    rows = [
        ("cells", manifest.get("cells")),
        ("identity", manifest.get("identity")),
        *((f"version of {name}", value) for name, value in manifest.get("versions", {}).items()),
        *((f"library {name}", value) for name, value in manifest.get("libraries", {}).items()),
        *manifest.get("machine", {}).items(),
        ("seeds", manifest.get("seeds")),
        *(
            (
                f"session {i}",
                f"finished {each['finished']}, {each['wall_time_s']} s on {each['workers']} workers, "
                f"{each['parts_computed']} parts computed, {each['parts_reused']} reused",
            )
            for i, each in enumerate(manifest.get("sessions", []), start=1)
        ),
    ]
    return Section(
        "Provenance",
        [Table(["what", "value"], [(key, str(value)) for key, value in rows], text=2)],
        folded=True,
    )


def found(captions: Captions, *findings: tuple[str, Sequence[Text | str], str]) -> list[Block]:
    """Return findings, each a question, sentences and the name of a picture; those without a sentence are left out."""
    sections: list[Block] = []
    for title, sentences, name in findings:
        said, picture = [each for each in sentences if str(each)], figure(captions, name)
        if said:
            sections.append(Section(title, [*said, *picture], beside=bool(picture)))
    return sections


def why(summary: Summary) -> list[Text]:
    """Say what the mean D of engines consists of; the first time with what a cause is."""
    return [
        findings.causes(summary, name, explain=name == summary.ladder.solvers[0])
        for name in summary.ladder.solvers
    ]


def with_names(table: Table) -> Table:
    """Name the solvers in the first column of a table as a reader knows them."""
    return replace(table, rows=[(named(str(row[0])), *row[1:]) for row in table.rows])


def code(text: str) -> Markup:
    """Show a command."""
    return Markup("<code>{}</code>").format(text)


def steps_of(summary: Summary, steps: Mapping[str, float]) -> Text:
    """Say which step keeps the error of engines small."""
    by_solver, f = summary.estimates.set_index("solver"), summary.config.step_fraction
    return together(
        say(
            "At {run} steps a period {solver} is off by {median} |v0| (median; 95 % of the cells: less "
            "than {p95}); for an error below {accepted} |v0| in 95 % of the cells take about {n} "
            "(extrapolated).",
            run=number(1 / f),
            solver=named(name),
            median=Value(by_solver.step_median[name], f"{name} step median"),
            p95=Value(by_solver.step_p95[name], f"{name} step p95"),
            accepted=ACCEPTED,
            n=Value(1 / step, f"{name} steps a period"),
        )
        for name, step in steps.items()
    )
