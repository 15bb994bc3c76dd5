"""The page of a run, section by section, of two balls on a table and of columns of balls."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

from markupsafe import Markup

from impact_xval.experiments.config.arrangements import COLUMN_AXES
from impact_xval.experiments.config.axes import AXES
from impact_xval.experiments.config.experiment import REFERENCE
from impact_xval.experiments.measures.aggregates import FULL_PATHS, OWN_LAW
from impact_xval.experiments.measures.ladder import cancelling
from impact_xval.experiments.measures.summary import Summary, load_divergence
from impact_xval.experiments.presentation import findings
from impact_xval.experiments.presentation.document import (
    Block,
    Figure,
    Section,
    Table,
    Value,
    say,
    together,
)
from impact_xval.experiments.presentation.findings import D, compared, subjects, unit_of, value_of
from impact_xval.experiments.presentation.page import evidence
from impact_xval.experiments.presentation.page.charts import LABELS, cells_piece, tiles_of
from impact_xval.experiments.presentation.page.opened import packed_cells
from impact_xval.experiments.presentation.pictures.figures import ACCEPTED, recommended
from impact_xval.experiments.presentation.words import named, one_vote
from impact_xval.experiments.tables.folder import RunFolder
from impact_xval.experiments.tables.numbers import number

#: Figures of a run: captions by name.
Captions = Mapping[str, str]

#: A command.
_CODE = Markup("<code>{}</code>")

_HYPOTHESIS = say(
    "The model has a limit of its own: where one contact is infinitely stiffer than the other, its two bodies move as "
    "one. Whether solvers go there, and how fast, other collisions than these show: {command} solves them, and writes "
    "a page with a verdict for every limit and solver.",
    command=_CODE.format("impact-xval hypothesis"),
)


def cells_that_open(_: object, folder: RunFolder) -> str:
    """Collect what the page of a finished run shows of the cells that open on it (`packed_cells`)."""
    return packed_cells(folder, tiles_of(load_divergence(folder, folder.config())).places.cell.tolist())


def blocks_of(
    folder: RunFolder, summary: Summary, captions: Captions, cells: Callable[[], str]
) -> list[Block]:
    """Return the page of a finished run; `cells` gives what the cells show that open, and is asked where any does."""
    pair, unit = summary.config.column is None, unit_of(summary)[:-1]
    blocks: list[Block] = [evidence.opening(summary, _numbers(summary))]
    if pair and summary.ladder.solvers:
        blocks.append(_advice(summary, captions))
    if compared(summary):
        blocks.append(Section("What was found", _found(summary, captions)))
        blocks.append(Section(f"{unit} by {unit}".capitalize(), _cells(folder, summary, cells())))
    else:
        blocks.append(Section("What was found", [f"No {unit} could be compared."]))
    if not pair:
        blocks.append(Section("Divergence by solver", [findings.overall_table(summary)]))
    elif compared(summary):
        blocks.append(Section("All against all", [_matrix(summary)]))
    along = [findings.along_axis(summary, axis) for axis in summary.axes]
    blocks += [
        evidence.causes(summary, _figures(captions, "ladder-by-restitution", "ladder-by-column")),
        evidence.sureness(summary),
        *([Section("Hypothesis", [_HYPOTHESIS])] if pair else []),
        evidence.effective(folder),
        Section("By axis", ["All measures by all axes are in summary.csv.", *along], folded=True),
        evidence.unsolved(summary),
        evidence.method(folder, summary),
        evidence.glossary(summary),
        evidence.provenance(folder),
    ]
    return blocks


def _figures(captions: Captions, *names: str) -> list[Block]:
    """Return those of some figures that were drawn."""
    return [Figure(name, captions[name]) for name in names if name in captions]


def _numbers(summary: Summary) -> Iterator[tuple[Value, str]]:
    """Give up to three numbers to remember: how far, how near to what was asked for, and why."""
    unit = unit_of(summary)
    for name in subjects(summary)[:1]:
        n = int(value_of(summary, name, "n").value)
        yield value_of(summary, name), f"is the median D of {named(name)} from the model, of {n} {unit}"
    for name, law, median, _ in list(findings.asked(summary))[:1]:
        what = "D" if summary.config.column is None else "distance of the limit dt -> 0, per |v0|,"
        yield median, f"is the median {what} of {named(name)} from {named(law)}, the law it was set to"
    for name in summary.ladder.solvers[:1]:
        causes = findings.shares(summary, name)
        if causes and cancelling(summary.ladder.region(name).share) is None:
            cause, share = next(iter(causes.items()))
            label = findings.LABELS[cause]
            yield share, f"of {named(name)}'s mean D is due to {label}; by region it differs"


def _advice(summary: Summary, captions: Captions) -> Section:
    """Say what a reader should do with an engine."""
    example = "impact-xval contact --engine mujoco --masses 1 0.5 --restitution 0.7 --stiffness 1e6"
    blocks: list[Block] = [
        say(
            "Look for traps: {command} lists the contacts of a scene with what is known to go wrong.",
            command=_CODE.format("impact-xval inspect scene.xml"),
        ),
        say(
            "Map a stiffness and a restitution to the engine's own parameters, checked by a simulated drop: {command}.",
            command=_CODE.format(example),
        ),
    ]
    if steps := recommended(summary):
        said = (
            "Choose the step by the faster contact, whose period is 2 pi sqrt(M/k) with M the reduced mass of its "
            "bodies (with the table, the mass of the ball)."
        )
        blocks.append(together([said, *(_step(summary, name, step) for name, step in steps.items())]))
    blocks.append(
        "No smaller step removes the rest of the distance from the model: the sections below show what it is, and "
        "where it matters."
    )
    blocks += _figures(captions, "error-by-step")
    return Section("What to do with your engine", blocks, beside=True)


def _step(summary: Summary, name: str, step: float) -> Markup:
    """Say which step keeps the error of an engine small."""
    known = summary.estimates.set_index("solver").loc[name]
    return say(
        "At {run} steps a period {solver} is off by {median} |v0| (median; 95 % of the cells: less than {p95}); for an "
        "error below {accepted} |v0| in 95 % of the cells take about {n} steps a period (extrapolated).",
        run=number(1 / summary.config.step_fraction),
        solver=named(name),
        median=Value(known.step_median, f"{name} step median"),
        p95=Value(known.step_p95, f"{name} step p95"),
        accepted=ACCEPTED,
        n=Value(1 / step, f"{name} steps a period"),
    )


def _found(summary: Summary, captions: Captions) -> list[Block]:
    """Return the findings: questions, the sentences that answer them, each with its picture."""
    pair, there, engines = summary.config.column is None, subjects(summary), summary.ladder.solvers
    axis, over = ("stiffness_ratio", "stiffness") if pair else ("balls", "balls")
    far = [findings.how_far(summary), one_vote(summary.solvers)]
    asked = findings.as_asked(summary)
    why = [findings.causes(summary, name, explain=name == engines[0]) for name in engines]
    extremes = [_extremes(summary, name, axis) for name in there]
    found: list[tuple[str, Sequence[str], str]] = [
        ("How far are they from the model?", far, f"divergence-by-{over}"),
        ("Do engines do what they were asked for?", asked, "impulse-curves" if pair else "wave"),
        ("Then why do they diverge?", why, f"ladder-by-{over}"),
        ("Where does it matter?", extremes, "trust-map" if pair else "velocities"),
    ]
    if pair:
        orders = [_order(summary, name) for name in there]
        found.append(("Do contacts open and close in the same order?", orders, "state-paths"))
    sections: list[Block] = []
    for title, sentences, name in found:
        said, picture = [*filter(None, sentences)], _figures(captions, name)
        if said or picture:
            sections.append(Section(title, [*said, *picture], beside=bool(said and picture)))
    return sections


def _extremes(summary: Summary, name: str, axis: str) -> str:
    """Say where along an axis the median D is largest and smallest."""
    values = [(at, value_of(summary, name, axis=axis, at=at)) for at in summary.levels[axis].values]
    known = sorted((each for each in values if not math.isnan(each[1].value)), key=lambda each: each[1].value)
    (low, least), (high, most) = known[0], known[-1]
    if least.value == most.value:
        return ""
    return say(
        "By {axis} the median D of {solver} is largest, {most}, at {high}, and smallest, {least}, at {low}.",
        axis=LABELS[axis],
        solver=named(name),
        most=most,
        high=number(high),
        least=least,
        low=number(low),
    )


def _order(summary: Summary, name: str) -> Markup:
    """Say how often a solver passes through the states of the model, and of its own law."""
    said = say(
        "{solver} passes through the contact states of the model in {equal} of the {n} cells in which the "
        "model needed no limiting case",
        solver=named(name),
        equal=value_of(summary, name, "mean", FULL_PATHS),
        n=value_of(summary, name, "n", FULL_PATHS),
    )
    own = value_of(summary, name, "mean", OWN_LAW)
    if not math.isnan(own.value):
        said += say(", and through those of the exact law it was asked for in {own}", own=own)
    return said + "."


def _cells(folder: RunFolder, summary: Summary, packed: str) -> list[Block]:
    """Lay out the map whose cells open, and the cells with the largest D."""
    tiles = tiles_of(load_divergence(folder, summary.config))
    opens = tiles.places.cell.tolist()
    piece = cells_piece(tiles, summary.n_cells, packed, summary.config.solvers)
    button = Markup('<button type="button" data-cell="{0}">{0}</button>')
    axes = AXES if summary.config.column is None else COLUMN_AXES
    order = summary.worst.solver.map(summary.solvers.index).sort_values(kind="stable").index
    rows = [
        (
            named(row["solver"]),
            button.format(row["cell"]) if row["cell"] in opens else row["cell"],
            *(row[axis] if isinstance(row[axis], str) else number(row[axis]) for axis in axes),
            number(row[D]),
        )
        for row in summary.worst.loc[order].to_dict("records")
    ]
    unit = unit_of(summary)
    header = ["solver", unit[:-1], *axes.values(), "D"]
    worst = Table(header, rows, f"The {unit} with the largest D of every solver", text=2)
    return [piece, Section("Largest divergences", [worst], folded=True)]


def _matrix(summary: Summary) -> Table:
    """Lay out D between every two solvers."""
    names = [REFERENCE, *summary.solvers]
    known: dict[frozenset[str], Any] = {
        frozenset((row["solver"], row["other"])): row for row in summary.between.to_dict("records")
    }
    known |= {frozenset((REFERENCE, name)): summary.get(name, D) for name in summary.solvers}

    def cell(a: str, b: str) -> str:
        if names.index(a) >= names.index(b):
            return ""  # it stands on the other side
        row = known.get(frozenset((a, b)))
        if row is None or not row["n"]:
            return "-"
        median, most = (Value(row[cut], f"{a} from {b} {cut}") for cut in ("median", "max"))
        return say("{median} ({most})", median=median, most=most)

    rows = [(named(a), *(cell(a, b) for b in names[1:])) for a in names[:-1]]
    caption = "Median D (largest D) between every two solvers, over the cells that both solved, marked ones left out"
    return Table(["", *map(named, names[1:])], rows, caption)
