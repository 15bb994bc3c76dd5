"""Findings of a run, in sentences and tables that the page and the terminal share.

The functions here need the `Summary` of a finished run. The page of a run, `report` and the terminal call them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from typing import TypeVar

import numpy as np
from markupsafe import Markup

from impact_xval.compliant_baselines.engines.convergence import NO_HELP
from impact_xval.compliant_baselines.registry import (
    exact_solver_for,
    is_engine,
    kind_of,
    law_name_of,
    stated_law,
)
from impact_xval.compliant_baselines.rigid.laws import LAWS as RIGID_LAWS
from impact_xval.experiments.config.arrangements import CHAIN_AXES
from impact_xval.experiments.config.axes import AXES
from impact_xval.experiments.config.experiment import NOUN_OF, REFERENCE
from impact_xval.experiments.config.graphs import GRAPH_AXES
from impact_xval.experiments.measures.aggregates import FULL_PATHS
from impact_xval.experiments.measures.ladder import CONTRIBUTIONS, cancelling_pair
from impact_xval.experiments.measures.summary import LadderSummary, Summary
from impact_xval.experiments.presentation.document import Block, Table, Value, fill_sentence
from impact_xval.experiments.presentation.words import (
    LAWS_WITH_LAWS,
    MEANINGS,
    capitalise_first,
    describe_cell,
    describe_scenario,
    describe_shared_laws,
    display_name,
    format_axis_value,
)
from impact_xval.experiments.tables.frames import AxisValue, Frame, FrameRow
from impact_xval.experiments.tables.numbers import join_words, number, percent

_Value = TypeVar("_Value")

#: Statistics of a measure, in the order in which tables show them.
CUTS = ("median", "p95", "max")

#: Name of the measure D in the statistics of a run.
D = "velocity_divergence"

#: Largest number that rounding alone can make, for D and for a difference of velocities per abs(v0).
ROUNDING = 1e-12

#: Largest asymmetry, per abs(v0), of a solver that counts as keeping the symmetry of a scene. Engines in single
#: precision round by 1e-7, which adds up to about 1e-6. A solver that handles contacts one after the other breaks a
#: symmetry by about 0.1.
SYMMETRIC = 1e-5

#: Rigid laws that rigid engines were found to follow.
NAMED_RIGID_LAWS = ("newton-restitution", "plastic-then-restitution", "sequential-top")

#: Largest number of rows of a table along an axis.
_ROWS = 40

#: Labels of contributions, by name.
LABELS = {c.name: c.label for c in CONTRIBUTIONS}

#: Labels of the axes of pairs, chains and graphs, by name.
LABELS_OF_AXES = AXES | CHAIN_AXES | GRAPH_AXES


def row_noun(summary: Summary) -> str:
    """Return the plural noun for the rows of a run: ``cells``, ``chains`` or ``graphs``."""
    return NOUN_OF[summary.config.kind]


def count_noun(n: float, plural: str) -> str:
    """Return the noun that follows a number: the plural, or after 1 the plural without its last letter."""
    return plural[:-1] if n == 1 else plural


def statistic_value(
    summary: Summary,
    solver: str,
    statistic: str = "median",
    measure: str = D,
    axis: str = "all",
    at: AxisValue = "",
) -> Value:
    """Return a statistic of a measure as a `Value`, whose key is its place in ``summary.csv``."""
    row = summary.get(solver, measure, axis, at)
    key = f"{solver} {measure} {statistic}" + ("" if axis == "all" else f" {axis}={at}")
    digits = 0 if measure.startswith("states_equal") and statistic == "mean" else 3
    return Value(float(row[statistic]), key, digits)


def thin_out(values: Sequence[_Value]) -> Sequence[_Value]:
    """Return the values of an axis that a table shows: all values, or every second, third, ... if there are many."""
    return values[:: -(-len(values) // _ROWS)] if values else values


def compared_solvers(summary: Summary) -> list[str]:
    """List the solvers that are compared with the model in at least one cell."""
    return [name for name in summary.solvers if summary.get(name, D)["n"]]


def solvers_of_sentences(summary: Summary) -> list[str]:
    """List the solvers that sentences name: the compared engines, or without engines all compared solvers."""
    names = compared_solvers(summary)
    return [name for name in names if is_engine(name)] or names


def describe_row(summary: Summary, row: FrameRow) -> str:
    """Return a description of a row: the values of its axes.

    The description of a chain begins with the arrangement, the description of a graph with its name. Both leave out
    axes that have only one value in the whole run.
    """
    if summary.config.kind == "pair":
        return describe_cell(row)
    if summary.config.kind == "graph":
        known = [axis for axis in summary.axes if axis != "graph" and not math.isnan(row[axis])]
        return ", ".join([row.graph, *(f"{GRAPH_AXES[axis]} = {number(row[axis])}" for axis in known)])
    strike = f", {row.strike:g} striking" if row.arrangement == "cradle" else ""
    axes = [axis for axis in summary.axes if axis not in ("arrangement", "balls", "strike")]
    settings = "".join(f", {CHAIN_AXES[axis]} = {number(row[axis])}" for axis in axes)
    return f"the {row.arrangement} of {row.balls} balls{strike}{settings}"


def row_of_largest_d(summary: Summary, solver: str) -> FrameRow:
    """Return the row of `Summary.worst` in which a solver has its largest D."""
    return summary.worst[summary.worst.solver == solver].iloc[0]


def describe_distances(summary: Summary) -> Markup:
    """Say for each solver how large its median and its largest D from the model are."""
    return Markup(" ").join(
        fill_sentence(
            "The median D of {solver} from the model is {median}, over {n} {unit}. Its largest D is {most}, at "
            "{where}.",
            unit=count_noun(statistic_value(summary, name, "n").value, row_noun(summary)),
            solver=display_name(name),
            median=statistic_value(summary, name),
            n=statistic_value(summary, name, "n"),
            most=statistic_value(summary, name, "max"),
            where=describe_row(summary, row_of_largest_d(summary, name)),
        )
        for name in solvers_of_sentences(summary)
    )


def distances_from_own_laws(summary: Summary) -> Iterator[tuple[str, str, Value, Value]]:
    """Yield each engine with the exact solver of its contact law, and the median and largest distance of the two.

    For two balls the distance is D. For chains and graphs the distance is a difference in velocity, per abs(v0),
    between the exact solver and the engine's limit at a time step of zero.
    """
    if summary.config.kind == "pair":
        for row in summary.between.to_dict("records"):
            for name, law in ((row["solver"], row["other"]), (row["other"], row["solver"])):
                if exact_solver_for(name, summary.config.mapping) == law != name:
                    median, most = (Value(row[cut], f"{name} from {law} {cut}") for cut in ("median", "max"))
                    yield name, law, median, most
        return
    for row in summary.estimates.to_dict("records"):
        if row["held"]:
            name, law = row["solver"], row["asked"]
            key = f"{name} limit from {law}"
            median, most = (Value(row[f"asked_{cut}"], f"{key} {cut}") for cut in ("median", "max"))
            yield name, law, median, most


def describe_distances_from_own_laws(summary: Summary) -> list[Markup]:
    """Say for each engine how near it is to the exact solution of its own contact law."""
    near = (
        "The D between {solver} and the exact solution of its own contact law ({law}) has the median {median} and the "
        "maximum {most}."
    )
    if summary.config.kind != "pair":
        near = (
            "Extrapolated to a time step of zero, {solver} differs from the exact solution of its own contact law "
            "({law}) by {median} |v0| (median) and by at most {most} |v0|."
        )
    laws = {
        exact_solver_for(name, summary.config.mapping)
        for name in solvers_of_sentences(summary)
        if is_engine(name)
    }
    missing = sorted(laws - {"", *summary.solvers})
    if missing:
        line = (
            "This run does not show how well engines solve their own contact law, because the exact solution of that "
            "law was not run. It needs {laws} among its solvers."
        )
        return [fill_sentence(line, laws=", ".join(missing))]
    return [
        fill_sentence(
            near,
            solver=display_name(name),
            law=display_name(law),
            median=median,
            most=most,
        )
        for name, law, median, most in distances_from_own_laws(summary)
    ]


def cause_shares(
    ladder: LadderSummary, solver: str, axis: str = "all", at: AxisValue = math.nan
) -> dict[str, Value | str]:
    """Return the share of each cause in an engine's mean D over a region, by name of the cause, the largest first.

    If two large causes cancel, the result has a text in place of the share for each of these two causes. The text says
    that the cause is cancelled.
    """
    region = ladder.region(solver, axis, at)
    key = "mean" if axis == "all" else f"mean {axis}={at}"
    causes = region[region["max"] > 0]  # without gravity, the contribution ``gravity`` is 0 in all cells
    largest = causes.share.abs().sort_values(ascending=False, kind="stable").index
    return {
        name: _describe_cancelling(region, name)
        or Value(region.share[name], f"{solver} share_{name} {key}", 0)
        for name in largest
    }


def _describe_cancelling(region: Frame, name: str) -> str:
    """Return a text with the size of a cause that another large cause cancels; empty for other causes."""
    cancels = name in region.index[list(cancelling_pair(region.share) or ())]
    return f"cancelled (size {number(region['mean'][name])})" if cancels else ""


def describe_causes(summary: Summary, solver: str, most: int = 2, *, explain: bool = False) -> Markup:
    """Say which causes an engine's mean D has.

    The text names the largest causes, at most `most` of them. It also says how the share of the largest cause differs
    between regions of the grid. With `explain` the text explains each cause in brackets.
    """
    ladder = summary.ladder
    whole = ladder.region(solver)
    total = Value(whole.total.iloc[0], f"{solver} mean D of the ladders")
    if total.value == 0:
        return fill_sentence(
            "{solver} ends where the model does, so there is no difference to explain.",
            solver=display_name(solver),
        )
    causes_by_share = cause_shares(ladder, solver)
    parts = [
        fill_sentence("{label} {share}", share=share, label=LABELS[name])
        + (f" ({MEANINGS[name]})" if explain and name in MEANINGS else "")
        for name, share in list(causes_by_share.items())[:most]
    ]
    return fill_sentence(
        "Over the {n} {unit} in which all causes are known, the mean D of {solver} is {total}. {largest}: {causes}."
        "{by_region}",
        solver=display_name(solver),
        total=total,
        n=Value(float(whole.n.max()), f"{solver} ladders n"),
        unit=count_noun(whole.n.max(), row_noun(summary)),
        largest="Its largest cause" if len(parts) == 1 else "Its largest causes",
        causes=Markup(", ").join(parts),
        by_region=_describe_regions(ladder, solver, next(iter(causes_by_share))),
    )


def _describe_regions(ladder: LadderSummary, solver: str, name: str) -> str:
    """Say how the share of a cause differs between regions of the grid; empty if fewer than two regions have one."""
    by_region = {
        label: cause_shares(ladder, solver, *place).get(name) for label, place in ladder.regions.items()
    }
    parts = [
        fill_sentence("{share} where {label}", share=share, label=label)
        for label, share in by_region.items()
        if share
    ]
    if len(parts) < 2:
        return ""
    cause, regions = LABELS[name], Markup(", ").join(parts)
    return fill_sentence(" The share of {cause} differs by region: {regions}.", cause=cause, regions=regions)


def describe_asymmetries(summary: Summary) -> Markup:
    """Say which solvers keep the mirror symmetry of symmetric graphs, and how far the other solvers break it.

    The text is empty if the run has no symmetric graph.
    """
    known = summary.asymmetries
    groups: dict[bool, list[str]] = {True: [], False: []}
    for name in (REFERENCE, *summary.solvers):
        if name in known:
            groups[known[name][0] <= SYMMETRIC].append(name)
    sentences: list[Markup] = []
    if groups[True]:
        count = int(max(known[name][1] for name in groups[True]))
        largest = max(groups[True], key=lambda name: known[name][0])
        precision = "to rounding"
        if known[largest][0] > ROUNDING:
            precision = fill_sentence(
                "to {most} |v0| or better", most=Value(known[largest][0], f"{largest} largest asymmetry")
            )
        names = capitalise_first(join_words(map(display_name, groups[True])))
        verb = "keeps" if len(groups[True]) == 1 else "keep"
        sentences.append(
            fill_sentence(
                "{names} {verb} the mirror symmetry of a scene {precision}, in {count} symmetric {graphs}.",
                names=names,
                verb=verb,
                precision=precision,
                count=count,
                graphs=count_noun(count, "graphs"),
            )
        )
    for name in groups[False]:
        most, count = known[name]
        sentences.append(
            fill_sentence(
                "{solver} breaks the mirror symmetry of a scene: in {count} symmetric {graphs}, velocities differ from "
                "those of the mirror image by up to {most} |v0|.",
                solver=capitalise_first(display_name(name)),
                most=Value(most, f"{name} largest asymmetry"),
                count=count,
                graphs=count_noun(count, "graphs"),
            )
        )
    return Markup(" ").join(sentences)


def describe_why_graphs_differ(summary: Summary) -> list[Markup]:
    """Say why solvers of graphs differ from the model.

    The reasons are the stiffness of contacts, the loss of energy, and the motion of bodies during the collision.
    """
    names = compared_solvers(summary)
    levels = summary.levels["e"].values
    said: list[Markup] = []
    blind = [name for name in names if not knows_stiffness(name)]
    if blind:
        said.append(
            fill_sentence(
                "{names} {know} not use the stiffness of contacts. {their} D changes with k2/k1 only because the "
                "outcome of the model changes.",
                names=capitalise_first(join_words(map(display_name, blind))),
                know="does" if len(blind) == 1 else "do",
                their="Its" if len(blind) == 1 else "Their",
            )
        )
    elastic, least = (summary.levels["e"].values[i] for i in np.argsort(levels)[[-1, 0]])
    for name in (each for each in names if each not in blind and elastic == 1 and elastic != least):
        most = statistic_value(summary, name, "max", axis="e", at=elastic)
        sentence = "At e = 1 contacts are plain springs, so {solver} has the contact law of the model. "
        if most.value <= ROUNDING:
            sentence += "There its velocities equal those of the model."
        elif is_engine(name):
            sentence += (
                "There its D is at most {most}. D is not 0 because of the time step, and because in {solver} bodies "
                "move during the collision."
            )
        else:
            sentence += (
                "There its D is at most {most}, only because in {solver} bodies move during the collision."
            )
        if law_name_of(name) == "bistiffness":
            sentence += (
                " {solver} has the contact law of the model at e = {least} too: D is at most {damped}."
            )
        else:
            sentence += (
                " At e = {least} its D is at most {damped}, because its contacts lose energy by another law."
            )
        said.append(
            fill_sentence(
                sentence,
                solver=display_name(name),
                most=most,
                least=number(float(least)),
                damped=statistic_value(summary, name, "max", axis="e", at=least),
            )
        )
    return [*said, *describe_nearest_rigid_laws(summary)]


def describe_nearest_rigid_laws(summary: Summary) -> list[Markup]:
    """Say for each rigid engine in a run of graphs which rigid law of the run is nearest to the engine."""
    engines = [name for name in compared_solvers(summary) if is_engine(name) and not knows_stiffness(name)]
    distances = summary.from_rigid_laws
    if engines and distances.empty:
        line = "This run has no rigid law. To see which law {engines} {follow}, add {laws} to the solvers."
        return [
            fill_sentence(
                line,
                laws=join_words(NAMED_RIGID_LAWS),
                engines=join_words(map(display_name, engines)),
                follow="follows" if len(engines) == 1 else "follow",
            )
        ]
    sentences: list[Markup] = []
    for name in engines:
        of_engine: Frame = distances[distances.solver == name]
        if of_engine.empty:
            continue
        nearest = of_engine.sort_values("max", kind="stable").iloc[0]
        key = f"{name} from {nearest.law}"
        sentences.append(
            fill_sentence(
                "The rigid law in this run that is nearest to {solver} is {law}. In the median, their velocities "
                "differ by {median} |v0|. The largest difference is {most} |v0|.",
                law=display_name(nearest.law),
                solver=display_name(name),
                median=Value(nearest["median"], f"{key} median"),
                most=Value(nearest["max"], f"{key} max"),
            )
        )
    return sentences


def knows_stiffness(name: str) -> bool:
    """Return whether a solver uses the stiffness of contacts: rigid engines and rigid laws do not."""
    return kind_of(name) != "rigid" and name not in RIGID_LAWS


def describe_unsolved(summary: Summary) -> list[str]:
    """Say for each solver in how many cells it has no result, by status, and the most frequent reason.

    If shorter time steps may help in some cell, a last sentence names the settings that shorten them.
    """
    sentences = []
    for name in (REFERENCE, *summary.solvers):
        reasons = summary.reasons[summary.reasons.solver == name]
        if reasons.empty:
            continue
        numbers = reasons.groupby("status", sort=False).n.sum()
        counts = ", ".join(f"{n} {status}" for status, n in numbers.items())
        cells = f"{reasons.n.sum()} of {summary.n_cells} {count_noun(summary.n_cells, row_noun(summary))}"
        sentences.append(
            f"{capitalise_first(display_name(name))} has no result in {cells} ({counts}). The most frequent reason: "
            f"{reasons.reason.iloc[0]}"
        )
    return [*sentences, *_describe_shorter_steps(summary)]


def _describe_shorter_steps(summary: Summary) -> list[str]:
    """Say which settings shorten the time steps of engines; empty if shorter steps can help no unconverged result."""
    reasons = summary.reasons.reason[summary.reasons.status == "unconverged"]
    # The condition is true also if there is no unconverged result.
    if reasons.str.contains(NO_HELP, regex=False).all():
        return []
    config = summary.config
    halvings = f", or more halvings under [convergence] (now {config.convergence.halvings}, at most 10)"
    return [
        f"Shorter time steps may help where results are unconverged: set a smaller step_fraction (now "
        f"{number(config.step_fraction)}){halvings if config.convergence.enabled else ''}"
    ]


def describe_counted_cells(summary: Summary) -> str:
    """Say which cells the statistics count, and how many cells they leave out because these are marked."""
    noun = row_noun(summary)
    beyond = join_words(
        f"in {n} more {count_noun(n, noun)} for {display_name(name)}"
        for name, n in summary.marked_beyond.items()
    )
    said = (
        f"Statistics of a solver are over the {noun} that both it and the model solved. So those of two solvers "
        f"can be over different {noun}. They leave out marked {noun}, in which a tiny change of a parameter flips the "
        f"outcome. The outcome of the model is marked in {summary.n_marked} of {summary.n_cells} {noun}."
    )
    if beyond:
        said += f" Only the outcome of the solver is marked {beyond}."
    if len(summary.ladder.statistics):
        said += (
            f" Causes of D are given only for {noun} in which no exact solution on the way from the model to the "
            "engine is marked."
        )
    return said


def axis_table(summary: Summary, axis: str) -> Table:
    """Return the table of D along an axis, one row per value of the axis and one column per solver."""
    levels, label = summary.levels[axis], LABELS_OF_AXES[axis]
    values = thin_out(levels.values)

    def cell(name: str, value: AxisValue) -> str:
        row = summary.get(name, D, axis, value)
        return " / ".join(number(row[cut], 2) for cut in CUTS) if row["n"] else "-"

    caption = f"D by {label}. An entry is median / 95th percentile / maximum over the other axes"
    if len(values) < len(levels.values):
        caption += f" ({len(values)} of {len(levels.values)} values; all are in summary.csv)"
    if levels.edges is not None:
        caption += f" (in bins of {label}, named by their middle)"
    rows = [(format_axis_value(value), *(cell(name, value) for name in summary.solvers)) for value in values]
    return Table([label, *map(display_name, summary.solvers)], rows, caption)


def region_table(ladder: LadderSummary, called: Callable[[str], str] = str) -> Table:
    """Return the table that shows which share each cause has in the mean D of an engine, by region of the grid.

    A share depends on the order in which the causes are taken. Its range over all orders follows the share. `called`
    returns the name of a solver for a reader.
    """
    rows: list[tuple[object, ...]] = []
    has_cancelling_pair = False
    for solver in ladder.solvers:
        for label, place in {"all": ("all", math.nan), **ladder.regions}.items():
            region = ladder.region(solver, *place)
            if len(region):
                has_cancelling_pair |= cancelling_pair(region.share) is not None
                known = (int(region.n.max()), number(region.total.iloc[0]))
                rows.append(
                    (called(solver), label, *known, *(_share_text(region, c.name) for c in ladder.present))
                )
    header = ["solver", "region", "cells", "mean D", *(c.label for c in ladder.present)]
    caption = (
        "Causes of the mean D of each engine, as shares of it. In brackets: the range over the "
        f"{ladder.orders} orders in which causes can be switched on"
    )
    if has_cancelling_pair:
        caption += ". Two large causes that cancel have no share; their sizes are measured like D"
    return Table(header, rows, caption, text=2)


def _share_text(region: Frame, name: str) -> str:
    """Return the text of the share of a cause in a region, or a dash if the region does not have the cause."""
    if name not in region.index:
        return "-"
    share, low, high = map(percent, region.loc[name, ["share", "low", "high"]])
    apart = f" ({low.removesuffix(' %')} to {high.removesuffix(' %')})" if low != high else ""
    return _describe_cancelling(region, name) or share + apart


def overall_table(summary: Summary) -> Table:
    """Return the table with the distance of each solver from the model, one row per solver, for one screen."""
    last = {"same path": lambda name: percent(summary.get(name, FULL_PATHS)["mean"])}
    if summary.config.kind == "graph":
        last = {
            str(graph): lambda name, graph=graph: number(summary.get(name, D, "graph", graph)["median"])
            for graph in summary.levels["graph"].values
        }
    elif summary.config.kind == "chain":
        last = {
            f"N = {n:g}": lambda name, n=n: number(summary.get(name, D, "balls", n)["median"])
            for n in thin_out(summary.levels["balls"].values)
        }
    rows = []
    for name in summary.solvers:
        row = summary.get(name, D)
        apart = summary.n_cells - row["n"] - summary.get(name, D, cells="marked")["n"]
        known = (int(row["n"]), *(number(row[cut]) for cut in CUTS), *(cell(name) for cell in last.values()))
        rows.append((stated_law(name) or "-", name, *known, int(apart)))
    header = ["law", "solver", row_noun(summary), "median D", "95 %", "max", *last, "not compared"]
    caption = (
        f"Divergence D from the model, by contact law, {describe_scenario(summary.config)}. "
        f"{describe_shared_laws(compared_solvers(summary))}"
    ).strip()
    if "same path" in last:
        caption += (
            ' "same path" counts only cells that the model solves without a closed form. It is the share of these '
            "cells in which the contacts open and close in the same order as in the model."
        )
    return Table(header, rows, caption, text=2)


def summary_blocks(summary: Summary) -> list[Block]:
    """Return the findings of a run, short enough for one screen of a terminal."""
    blocks: list[Block] = [overall_table(summary)]
    if not compared_solvers(summary):
        blocks.append("Nothing could be compared.")
    places: dict[str, list[str]] = {}
    for name in compared_solvers(summary):
        row = row_of_largest_d(summary, name)
        places.setdefault(f"{describe_row(summary, row)} (cell {row.cell})", []).append(name)
    blocks += [
        f"{capitalise_first(join_words(map(display_name, names)))} {'has its' if len(names) == 1 else 'have their'} "
        f"largest D at {place}."
        for place, names in places.items()
    ]
    blocks += describe_distances_from_own_laws(summary)
    engines = summary.ladder.solvers
    blocks += describe_nearest_rigid_laws(summary) if summary.config.kind == "graph" else []
    blocks += [describe_causes(summary, name, 3, explain=name == engines[0]) for name in engines]
    blocks += [said] if (said := describe_asymmetries(summary)) else []
    return [*blocks, *describe_unsolved(summary), describe_counted_cells(summary), LAWS_WITH_LAWS]
