"""The summary as a document: what was found in plain words, with the numbers of the run, and tables."""

from __future__ import annotations

import math
from collections.abc import Sequence

from impact_xval.compliant_baselines.contract.registry import is_naive, law_of
from impact_xval.experiments.config.axes import AXES
from impact_xval.experiments.config.configuration import REFERENCE
from impact_xval.experiments.measures.certificates import certificate_blocks
from impact_xval.experiments.measures.divergence import COMPARABLE
from impact_xval.experiments.measures.laws import LAWS_WITH_LAWS, one_vote, with_votes
from impact_xval.experiments.measures.summary import (
    FULL_PATHS,
    OWN_LAW,
    SUMMARISED,
    Frame,
    Summary,
)
from impact_xval.experiments.presentation.ladder_document import ladder_findings, ladder_section
from impact_xval.experiments.tables.document import (
    Block,
    Heading,
    Paragraph,
    Table,
)
from impact_xval.experiments.tables.numbers import number, percent

_CUTS = ("median", "p95", "max")
#: Longest table along an axis.
_ROWS = 40
#: What the agreement of an engine with its own law depends on.
LONGER_STEPS = (
    "An engine's distance from the law it was asked for grows with the step: docs/convergence.md tabulates it up to a "
    "tenth of the contact period."
)
_CUT_NAMES = ("median", "95th percentile", "maximum")


def build_document(summary: Summary) -> list[Block]:
    """Arrange the summary of a run."""
    return [
        Heading(f"Divergence from the state-transition model: {summary.config.name}", level=1),
        Paragraph(LAWS_WITH_LAWS),
        Paragraph(_what_was_run(summary)),
        Heading("What was found"),
        *(Paragraph(text) for text in findings(summary)),
        overall_table(summary),
        *certificate_blocks(summary.certificates),
        Heading("Where"),
        *(axis_table(summary, axis) for axis in AXES),
        worst_table(summary),
        *ladder_section(summary.ladder),
        Heading("State paths"),
        law_table(summary),
        path_table(summary),
        Heading("Marked cells"),
        Paragraph(_marked(summary)),
        marked_table(summary),
        Heading("Statuses"),
        status_table(summary),
        *([reason_table(summary)] if len(summary.reasons) else []),
        Heading("Every measure by axis"),
        *(detail_table(summary, axis) for axis in AXES),
    ]


def findings(summary: Summary) -> list[str]:
    """Say in plain words what the run found, most important first."""
    texts = [text for name in summary.solvers if (text := _finding(summary, name))]
    texts += [said] if texts and (said := one_vote(summary.solvers)) else []
    texts += _closest(summary)
    texts += ladder_findings(summary.ladder)
    return [*texts, _marked(summary)] if texts else ["No cell could be compared.", _marked(summary)]


def _what_was_run(summary: Summary) -> str:
    c = summary.config
    scale = f"m1 = {number(c.m1)} kg, k1 = {number(c.k1)} N/m, v0 = {number(c.v0)} m/s"
    gravity = f" and g = {number(c.gravity)} m/s^2" if c.scenario == "drop" else ", without gravity"
    return (
        f"{summary.n_cells} cells of scenario '{c.scenario}' at {scale}{gravity}; step fraction "
        f"{number(c.step_fraction)}, {c.mapping} mapping. D is the kinetic norm of the difference of the "
        "final velocities, sqrt((m1 dv1^2 + m2 dv2^2)/(m1 v0^2)); velocities are per |v0|, impulses per m1 "
        "|v0|. Unless said otherwise, marked cells are left out."
    )


def _finding(summary: Summary, name: str) -> str:
    d = summary.get(name, "velocity_divergence")
    if not d.n:
        return ""
    equal, full = summary.get(name, "states_equal"), summary.get(name, FULL_PATHS)
    worst = summary.worst[summary.worst.solver == name].iloc[0]
    medians = {
        value: summary.get(name, "velocity_divergence", "stiffness_ratio", value)["median"]
        for value in summary.levels["stiffness_ratio"].values
    }
    medians = {value: median for value, median in medians.items() if not math.isnan(median)}
    low, high = min(medians, key=lambda v: medians[v]), max(medians, key=lambda v: medians[v])
    where = (
        f" By k2/k1 its median is smallest, {number(medians[low])}, at {number(low)} and largest, "
        f"{number(medians[high])}, at {number(high)}."
        if low != high
        else ""
    )
    return (
        f"{name} diverges from the model by D = {number(d['median'])} (median), {number(d.p95)} (95th "
        f"percentile) and at most {number(d['max'])} over {d.n} cells; the most at {_where(worst)}, where it "
        f"ends with {_velocities(worst)}.{where} Its state path is the model's in {percent(equal['mean'])} "
        f"of the cells, and in {percent(full['mean'])} of the {full.n} in which the model took no limit"
        f"{_own_law(summary, name)}."
    )


def _own_law(summary: Summary, name: str) -> str:
    own = summary.get(name, OWN_LAW)
    if not own.n:
        return ""
    return (
        f"; it is that of {law_of(name)}, the exact solution of the law it is asked for, in "
        f"{percent(own['mean'])} of {own.n} cells"
    )


def _where(row: Frame) -> str:
    return ", ".join(f"{label} = {number(row[axis])}" for axis, label in AXES.items())


def _velocities(row: Frame) -> str:
    return f"dv1 = {number(row.dv1)}, dv2 = {number(row.dv2)} per |v0|"


def _closest(summary: Summary) -> list[str]:
    """Compare the engines with the exact solver of the law they were asked for, at the step of the run."""
    texts = []
    step = f"At the step of this run, {number(summary.config.step_fraction)} of the fastest contact period,"
    pairs = [(row, *pair) for row in summary.between.itertuples() for pair in _both_ways(row)]
    for row, name, law in pairs:
        if law_of(name) != law:
            continue
        naively = ", by the naive mapping" if summary.config.mapping == "naive" or is_naive(name) else ""
        model = summary.get(name, "velocity_divergence")["median"]
        texts.append(
            f"{step} D between {name} and {law}, the exact solver of the law it was asked for{naively}, is "
            f"{number(row.median)} (median) and at most {number(row.max)} over {row.n} cells, beside "
            f"{number(model)} (median) between {name} and the model."
        )
    return [*texts, LONGER_STEPS] if texts else []


def _both_ways(row: Frame) -> tuple[tuple[str, str], tuple[str, str]]:
    return (row.solver, row.other), (row.other, row.solver)


def _marked(summary: Summary) -> str:
    more = [
        f"{name} in {n}"
        for name in summary.solvers
        if (n := int(summary.get(name, "velocity_divergence", cells="marked").n) - summary.n_marked) > 0
    ]
    return (
        f"{summary.n_marked} of {summary.n_cells} cells are marked and kept apart: next to them the model's outcome "
        "jumps in the parameters, where a compression nearly ends or nearly does not, or it depends on a cut-off. "
        f"Rows of a solver are marked beyond these where its exact law jumps: {', '.join(more) or 'none'}. The column "
        "marked says which and why."
    )


def overall_table(summary: Summary) -> Table:
    """Tabulate every measure by solver."""
    rows = []
    for name in summary.solvers:
        for measure, label in SUMMARISED.items():
            row = summary.get(name, measure)
            rows.append((law_of(name), name, label, str(int(row.n)), *(number(row[cut]) for cut in _CUTS)))
    caption = (
        "Divergence of each solver from the model, by the law it was asked for, all cells but the marked ones "
        "(velocities per |v0|, impulses and distances of impulse curves per m1 |v0|, sizes)"
    )
    return Table(
        with_votes(caption, summary.solvers),
        ("law", "solver", "measure", "cells", *_CUT_NAMES),
        rows,
        text_columns=3,
    )


def _shown(summary: Summary, axis: str) -> tuple[list[float], str]:
    """Values of an axis that tables show, and what a caption says where that is not all of them."""
    levels = summary.levels[axis]
    step = -(-len(levels.values) // _ROWS)
    shown = levels.values[::step]
    note = f" ({len(shown)} of {len(levels.values)} values; all are in summary.csv)" if step > 1 else ""
    if levels.edges is not None:
        note += f" (in bins of {AXES[axis]}, named by their middle)"
    return shown, note


def axis_table(summary: Summary, axis: str) -> Table:
    """Tabulate D along one axis, a row a value."""
    rows = []
    values, note = _shown(summary, axis)
    for value in values:
        cells = [number(value)]
        for name in summary.solvers:
            row = summary.get(name, "velocity_divergence", axis, value)
            cells.append(" / ".join(number(row[cut], 2) for cut in _CUTS) if row.n else "-")
        rows.append(cells)
    return Table(
        with_votes(
            f"D by {AXES[axis]}: median / 95th percentile / maximum over the other axes{note}",
            summary.solvers,
        ),
        (AXES[axis], *summary.solvers),
        rows,
    )


def detail_table(summary: Summary, axis: str) -> Table:
    """Tabulate every measure along one axis, a row a value and solver."""
    rows = []
    values, note = _shown(summary, axis)
    for value in values:
        for name in summary.solvers:
            stats = [summary.get(name, measure, axis, value) for measure in SUMMARISED]
            cells = [" / ".join(number(row[cut], 2) for cut in _CUTS) if row.n else "-" for row in stats]
            rows.append(
                (number(value), name, *cells, percent(summary.get(name, FULL_PATHS, axis, value)["mean"]))
            )
    caption = f"Every measure by {AXES[axis]}: median / 95th percentile / maximum, and the share of equal paths{note}"
    return Table(
        with_votes(caption, summary.solvers),
        (AXES[axis], "solver", *SUMMARISED.values(), "equal paths"),
        rows,
        text_columns=2,
        detail=True,
    )


def worst_table(summary: Summary) -> Table:
    """Tabulate the cells with the largest D."""
    order = summary.worst.solver.map(summary.solvers.index)
    rows = [
        (
            str(row["solver"]),
            *(str(row[key] or "-") for key in ("model_states_compared", "states_compared")),
            str(row["cell"]),
            *(number(row[axis]) for axis in AXES),
            number(row["velocity_divergence"]),
            number(row["dv1"]),
            number(row["dv2"]),
        )
        for _, row in summary.worst.loc[order.sort_values(kind="stable").index].iterrows()
    ]
    header = ("solver", "model's path", "solver's path", "cell", *AXES.values(), "D", "dv1", "dv2")
    caption = with_votes("The cells that diverge most, by solver, marked cells left out", summary.solvers)
    return Table(caption, header, _compact(rows), 3)


def _compact(rows: list[tuple[str, ...]]) -> Sequence[Sequence[str]]:
    """Shorten state paths to their digits: S1 S3 S4 becomes 134."""
    return [
        (row[0], row[1].replace("S", "").replace(" ", ""), row[2].replace("S", "").replace(" ", ""), *row[3:])
        for row in rows
    ]


def law_table(summary: Summary) -> Table:
    """Tabulate how often state paths are the model's, and how often that of the exact solver of the same law."""
    rows = []
    for name in summary.solvers:
        shares = [summary.get(name, share) for share in ("states_equal", FULL_PATHS, OWN_LAW)]
        law = law_of(name) if shares[-1].n else "-"
        rows.append((name, law, *(f"{percent(row['mean'])} of {row.n}" if row.n else "-" for row in shares)))
    share = number(summary.config.shortest_state)
    return Table(
        f"Cells with the same state path, every path without states held for less than {share} of the shorter "
        "contact period: as the model, as the model where it took no limit, as the exact solver of its own law",
        ("solver", "own law", "model's path", "model took no limit", "own law's path"),
        rows,
        text_columns=2,
    )


def path_table(summary: Summary) -> Table:
    """Tabulate how often the state paths agree."""
    rows = []
    values, note = _shown(summary, "stiffness_ratio")
    for value in values:
        shares = [summary.get(n, FULL_PATHS, "stiffness_ratio", value)["mean"] for n in summary.solvers]
        rows.append((number(value), *map(percent, shares)))
    rows.append(("all", *(percent(summary.get(name, FULL_PATHS)["mean"]) for name in summary.solvers)))
    return Table(
        f"Share of cells whose state path equals the model's, by k2/k1, where the model took no limit{note}",
        ("k2/k1", *summary.solvers),
        rows,
    )


def marked_table(summary: Summary) -> Table:
    """Tabulate D in the cells kept apart."""
    rows = []
    for name in summary.solvers:
        row = summary.get(name, "velocity_divergence", cells="marked")
        equal = summary.get(name, "states_equal", cells="marked")
        cuts = (number(row[cut]) for cut in _CUTS)
        rows.append((law_of(name), name, str(int(row.n)), *cuts, percent(equal["mean"])))
    header = ("law", "solver", "cells", *_CUT_NAMES, "equal paths")
    return Table("D in the marked cells, by the law asked for", header, rows, text_columns=2)


def status_table(summary: Summary) -> Table:
    """Count the statuses."""
    columns = list(summary.statuses.columns)
    columns = [
        *(name for name in COMPARABLE if name in columns),
        *(n for n in columns if n not in COMPARABLE),
    ]
    rows = [
        (str(name), *(str(row[column]) for column in columns)) for name, row in summary.statuses.iterrows()
    ]
    return Table(f"Cells by solver and status ({REFERENCE} is the model)", ("solver", *columns), rows)


def reason_table(summary: Summary) -> Table:
    """Tabulate why there is no result, the most frequent reasons first."""
    shown = summary.reasons.head(10)
    rows = [(row.solver, row.status, row.reason, str(row.n)) for row in shown.itertuples()]
    more = len(summary.reasons) - len(shown)
    caption = "Why cells have no result" + (f" (and {more} reasons more, in cells.parquet)" if more else "")
    return Table(caption, ("solver", "status", "reason", "cells"), rows, text_columns=3)
