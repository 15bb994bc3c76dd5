"""Sections of the page of a run: for two balls on a table, for chains of balls, and for contact graphs.

The functions here need the folder, the `Summary` and the captions of the figures of a finished run. `report` calls
them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping

import pandas as pd
from markupsafe import Markup

from impact_xval.compliant_baselines.registry import is_engine, kind_of
from impact_xval.experiments.config.axes import AXES
from impact_xval.experiments.config.errors import is_table
from impact_xval.experiments.config.experiment import AXES_OF, NOUN_OF, REFERENCE
from impact_xval.experiments.measures.aggregates import FULL_PATHS, OWN_LAW
from impact_xval.experiments.measures.ladder import CONTRIBUTIONS, cancelling_pair
from impact_xval.experiments.measures.summary import HONEST, Summary, load_divergence
from impact_xval.experiments.presentation import findings, words
from impact_xval.experiments.presentation.document import (
    Block,
    Figure,
    Piece,
    Section,
    Table,
    Value,
    fill_sentence,
)
from impact_xval.experiments.presentation.findings import (
    CUTS,
    D,
    compared_solvers,
    row_noun,
    solvers_of_sentences,
    statistic_value,
)
from impact_xval.experiments.presentation.html import render_template
from impact_xval.experiments.presentation.page.charts import LABELS, cells_piece, make_tiles
from impact_xval.experiments.presentation.page.opened import pack_cells
from impact_xval.experiments.presentation.pictures.figures import ACCEPTED, recommended_steps
from impact_xval.experiments.presentation.words import (
    MEANINGS,
    describe_restitution_product,
    describe_shared_laws,
    display_name,
    format_axis_value,
)
from impact_xval.experiments.tables.folder import RunFolder
from impact_xval.experiments.tables.frames import FrameRow
from impact_xval.experiments.tables.numbers import number, percent
from impact_xval.experiments.tables.parquet import read_column

#: Figures of a run: captions by name.
Captions = Mapping[str, str]

#: Largest number of reasons for missing results that the page shows.
_REASONS = 10

#: Text of the section on the limiting cases of the model.
_HYPOTHESIS = Markup(
    "The model has a limiting case if one contact is infinitely stiffer than the other: the two bodies of the stiff "
    "contact then move as one. Other collisions than these show whether other solvers have the same limiting case, and "
    "how fast they come near to it. The command <code>impact-xval hypothesis</code> solves such collisions, and writes "
    "a page with a verdict for every limiting case and solver."
)

#: Sentences about the contact laws of the solvers that most runs have, by the name of the solver.
_LAWS = {
    "kelvin-voigt": (
        "Exact Kelvin-Voigt is the exact solution for contacts that are springs with dashpots, the law of contacts in "
        "MuJoCo, PyBullet and Drake as set up here."
    ),
    "bistiffness": (
        "Exact bistiffness is the exact solution for contacts whose springs are stiffer during restitution than during "
        "compression. This is the restitution of the model, but bodies move during the collision."
    ),
}

#: Words of the page and their meanings.
GLOSSARY = (
    ("model", "the state-transition model of Jia, Mason and Erdmann, solved exactly"),
    (
        "S1, S2, S3, S4",
        "contact states: both contacts are active; only ball on table; only ball on ball; none",
    ),
    ("solver", "the model, a reference, or an engine"),
    ("reference", "the solution of a contact law in time without an engine, exact or with a stated error"),
    (
        "exact bistiffness",
        "springs that are stiffer in restitution than in compression: the model's restitution, with bodies that move",
    ),
    (
        "exact Kelvin-Voigt",
        "springs with dashpots, the law of contacts in MuJoCo, PyBullet and Drake as set up here",
    ),
    ("frozen positions", "the model's assumption that bodies do not move during the collision"),
    (
        "dissipation law",
        "the law by which a contact loses energy: by restitution in the model, by dashpots in engines",
    ),
    ("restitution e", "energetic restitution: a contact returns the fraction e² of the work of compression"),
    ("share", "the part of D that one cause accounts for; the shares of a cell sum to 100 %"),
    (
        "limit dt -> 0",
        "an engine's result extrapolated to a time step of zero, with an estimate of its error",
    ),
    ("marked", "a tiny change of a parameter flips the outcome; marked cells are in no statistic"),
    (
        "asymmetry",
        "the largest difference between a velocity and the mirrored velocity of the body's mirror image, per |v0|",
    ),
    ("closed-form (a status)", "the result is a closed form of the model for a limiting case, such as e = 0"),
)


def pack_opening_cells(_: object, folder: RunFolder) -> str:
    """Return the contents of the cells that a reader can open on the page of a finished run, compressed.

    The form is the one that `pack_cells` returns.
    """
    return pack_cells(folder, make_tiles(load_divergence(folder, folder.config())).places.cell.tolist())


def run_blocks(
    folder: RunFolder, summary: Summary, captions: Captions, cells: Callable[[], str]
) -> list[Block]:
    """Return the blocks of the page of a finished run.

    `cells` is a function that returns the compressed contents of the cells that a reader can open on the page. The
    function is not called if the page has no such cells.
    """
    kind, unit = summary.config.kind, row_noun(summary)[:-1]
    pair = kind == "pair"
    compared_names = compared_solvers(summary)
    answers = _answer_questions(summary, captions) if compared_names else [f"No {unit} could be compared."]
    along = [findings.axis_table(summary, axis) for axis in summary.axes]
    blocks: list[Block | None] = [
        _opening(summary),
        _advice_section(summary, captions) if pair and summary.ladder.solvers else None,
        Section("What was found", answers),
        Section(f"{unit} by {unit}".capitalize(), _cell_blocks(folder, summary, cells()))
        if compared_names
        else None,
        Section("Divergence by solver", [findings.overall_table(summary)]) if not pair else None,
        Section("All against all", [_pairwise_table(summary)]) if pair and compared_names else None,
        _causes_section(summary, captions) if kind != "graph" else None,
        _accuracy_section(summary),
        Section("Hypothesis", [_HYPOTHESIS]) if pair else None,
        _effective_section(folder),
        Section("By axis", ["All measures by all axes are in summary.csv.", *along], folded=True),
        _status_section(summary),
        _method_section(folder, summary),
        _glossary_section(summary),
        _provenance_section(folder),
    ]
    return [block for block in blocks if block is not None]


def _figure_blocks(captions: Captions, *names: str) -> list[Block]:
    """Return the blocks of figures; figures that were not drawn are left out."""
    return [Figure(name, captions[name]) for name in names if name in captions]


def _opening(summary: Summary) -> Piece:
    """Return the opening of the page, which says what was compared and shows the numbers to remember."""
    labels = AXES if summary.config.kind == "pair" else {}
    spans = {labels[axis]: x for axis, x in summary.axes.items() if axis in labels}
    return render_template(
        "opening.html.j2",
        s=summary,
        spans=[
            f"{label} from {format_axis_value(min(x))} to {format_axis_value(max(x))}"
            for label, x in spans.items()
        ],
        laws=" ".join(said for name, said in _LAWS.items() if name in summary.solvers),
        weightless=[name for name in summary.config.solvers if kind_of(name) == "model"],
        engines=any(map(is_engine, summary.solvers)),
        words=words,
        numbers=[*_numbers_to_remember(summary)],
    )


def _numbers_to_remember(summary: Summary) -> Iterator[tuple[Value | str, str]]:
    """Yield up to three numbers to remember, each with its text.

    For pairs and chains the numbers are about one engine: its median D from the model, its median distance from its own
    contact law, and the share of its largest cause. For graphs they are an engine's largest D and the largest
    asymmetry.
    """
    if summary.config.kind == "graph":
        for name in solvers_of_sentences(summary)[:1]:
            yield (
                statistic_value(summary, name, "max"),
                f"is the largest D between {display_name(name)} and the model",
            )
        name, (most, count) = max(
            summary.asymmetries.items(), key=lambda each: each[1][0], default=("", (0.0, 0))
        )
        if most > findings.SYMMETRIC:
            yield (
                Value(most, f"{name} largest asymmetry"),
                f"|v0| is the largest asymmetry of {display_name(name)}, in {count} symmetric "
                f"{findings.count_noun(count, 'graphs')}",
            )
        return
    for name in solvers_of_sentences(summary)[:1]:
        n = int(statistic_value(summary, name, "n").value)
        yield (
            statistic_value(summary, name),
            f"is the median D between {display_name(name)} and the model, over {n} "
            f"{findings.count_noun(n, row_noun(summary))}",
        )
    for name, law, median, _ in list(findings.distances_from_own_laws(summary))[:1]:
        if summary.config.kind == "pair":
            said = (
                f"is the median D between {display_name(name)} and its own contact law, {display_name(law)}"
            )
        else:
            said = (
                f"|v0| is the median difference in velocity between {display_name(name)}, extrapolated to a time step "
                f"of zero, and its own contact law, {display_name(law)}"
            )
        yield (
            median,
            said,
        )
    for name in summary.ladder.solvers[:1]:
        causes = findings.cause_shares(summary.ladder, name)
        if causes and cancelling_pair(summary.ladder.region(name).share) is None:
            cause, share = next(iter(causes.items()))
            (phrase,) = (c.phrase for c in CONTRIBUTIONS if c.name == cause)
            yield (
                share,
                f"of the mean D of {display_name(name)} comes from {phrase}. This share differs by region",
            )


def _advice_section(summary: Summary, captions: Captions) -> Section:
    """Return the section that says what to do with an engine."""
    engines, steps = recommended_steps(summary), 1 / summary.config.step_fraction
    said = render_template("advice.html.j2", engines=engines, steps=steps, accepted=ACCEPTED)
    return Section(
        "What to do with your engine", [said, *_figure_blocks(captions, "error-by-step")], beside=True
    )


def _answer_questions(summary: Summary, captions: Captions) -> list[Block]:
    """Return sections whose titles are questions, each with its answer and its figure."""
    if summary.config.kind == "graph":
        return _answer_questions_of_graphs(summary, captions)
    pair, names, engines = (
        summary.config.kind == "pair",
        solvers_of_sentences(summary),
        summary.ladder.solvers,
    )
    axis, over = ("stiffness_ratio", "stiffness") if pair else ("balls", "balls")
    sections: list[Block] = []

    def answer(question: str, sentences: Iterable[str], picture: str) -> None:
        said, figure = [*filter(None, sentences)], _figure_blocks(captions, picture)
        if said or figure:
            sections.append(Section(question, [*said, *figure], beside=bool(said and figure)))

    far = [findings.describe_distances(summary), describe_shared_laws(compared_solvers(summary))]
    answer("How far are the solvers from the model?", far, f"divergence-by-{over}")
    own_law = findings.describe_distances_from_own_laws(summary)
    answer("Do engines solve their own contact law?", own_law, "impulse-curves" if pair else "wave")
    why = [findings.describe_causes(summary, name, explain=name == engines[0]) for name in engines]
    answer("Why do engines differ from the model?", why, f"ladder-by-{over}")
    extremes = [_describe_extremes(summary, name, axis) for name in names]
    answer("Where are the differences large?", extremes, "trust-map" if pair else "velocities")
    if pair:
        orders = [_describe_state_order(summary, name) for name in names]
        answer("Do contacts open and close in the same order?", orders, "state-paths")
    return sections


def _answer_questions_of_graphs(summary: Summary, captions: Captions) -> list[Block]:
    """Return the sections, for a run of graphs, whose titles are questions, each with its answer and its figure."""
    names = compared_solvers(summary)
    over_stiffness = [_describe_extremes(summary, name, "stiffness_ratio") for name in names]
    over_angle = [_describe_extremes(summary, name, "angle") for name in names]
    asked: list[tuple[str, list[str], str]] = [
        (
            "How far are the solvers from the model?",
            [
                findings.describe_distances(summary),
                describe_shared_laws(compared_solvers(summary)),
                *over_stiffness,
            ],
            "divergence-by-stiffness",
        ),
        (
            "Why do solvers differ from the model?",
            [*findings.describe_why_graphs_differ(summary)],
            "divergence-by-restitution",
        ),
        ("Does the angle change the difference?", over_angle, "divergence-by-angle"),
        ("Does a symmetric scene stay symmetric?", [findings.describe_asymmetries(summary)], ""),
        (
            "Do engines solve their own contact law?",
            [*findings.describe_distances_from_own_laws(summary)],
            "",
        ),
    ]
    sections: list[Block] = []
    for question, sentences, picture in asked:
        said, figure = [*filter(None, sentences)], _figure_blocks(captions, picture)
        if said or figure:
            sections.append(Section(question, [*said, *figure], beside=bool(said and figure)))
    return sections


def _describe_extremes(summary: Summary, name: str, axis: str) -> str:
    """Say at which values of an axis a solver's median D is largest and smallest; empty if D does not change."""
    values = [(at, statistic_value(summary, name, axis=axis, at=at)) for at in summary.levels[axis].values]
    known = sorted((each for each in values if not math.isnan(each[1].value)), key=lambda each: each[1].value)
    if not known:
        return ""
    (low, least), (high, most) = known[0], known[-1]
    if least.value == most.value or (summary.config.kind == "graph" and most.value <= findings.ROUNDING):
        return ""
    return fill_sentence(
        "Along {axis}, {solver} has its largest median D ({most}) at {axis} = {high} and its smallest ({least}) at "
        "{axis} = {low}.",
        axis=LABELS[axis],
        solver=display_name(name),
        most=most,
        high=format_axis_value(high),
        least=least,
        low=format_axis_value(low),
    )


def _describe_state_order(summary: Summary, name: str) -> Markup:
    """Say how often a solver has the same sequence of contact states as the model.

    It also says how often the sequence equals that of the exact solver of the solver's own contact law.
    """
    sentence = fill_sentence(
        "{solver} has the same sequence of contact states as the model in {equal} of the {n} {cells} that the model "
        "solves without a closed form (closed forms end limiting cases, such as e = 0 or a stiffness ratio that "
        "grows without limit)",
        solver=display_name(name),
        cells=findings.count_noun(statistic_value(summary, name, "n", FULL_PATHS).value, "cells"),
        equal=statistic_value(summary, name, "mean", FULL_PATHS),
        n=statistic_value(summary, name, "n", FULL_PATHS),
    )
    own_law = statistic_value(summary, name, "mean", OWN_LAW)
    if not math.isnan(own_law.value):
        sentence += fill_sentence(
            ", and the same sequence as the exact solution of its own contact law in {own} of the cells",
            own=own_law,
        )
    return sentence + "."


def _cell_blocks(folder: RunFolder, summary: Summary, packed: str) -> list[Block]:
    """Return the map of the cells that a reader can open, and the table of the cells with the largest D."""
    tiles = make_tiles(load_divergence(folder, summary.config))
    opens, unit = set(tiles.places.cell), row_noun(summary)
    piece = cells_piece(tiles, summary.n_cells, packed, summary.config.solvers, summary.config.kind)
    button = Markup('<button type="button" data-cell="{0}">{0}</button>')
    axes = AXES_OF[summary.config.kind]
    order = summary.worst.solver.map(summary.solvers.index).sort_values(kind="stable").index
    rows = [
        (
            display_name(row["solver"]),
            button.format(row["cell"]) if row["cell"] in opens else row["cell"],
            *(format_axis_value(row[axis]) for axis in axes),
            number(row[D]),
        )
        for row in summary.worst.loc[order].to_dict("records")
    ]
    header = ["solver", "number" if unit[:-1] in axes else unit[:-1], *axes.values(), "D"]
    worst = Table(header, rows, f"The {unit} in which each solver has its largest D", text=2)
    return [piece, Section("Largest divergences", [worst], folded=True)]


def _pairwise_table(summary: Summary) -> Table:
    """Return the table of D between every two solvers, which fills the part above its diagonal."""
    names = [REFERENCE, *summary.solvers]
    known: dict[frozenset[str], FrameRow] = {
        frozenset((row["solver"], row["other"])): row for row in summary.between.to_dict("records")
    }
    known |= {frozenset((REFERENCE, name)): summary.get(name, D) for name in summary.solvers}

    def cell(a: str, b: str) -> str:
        row = known.get(frozenset((a, b)))
        if row is None or not row["n"]:
            return "-"
        median, most = (Value(row[cut], f"{a} from {b} {cut}") for cut in ("median", "max"))
        return fill_sentence("{median} ({most})", median=median, most=most)

    rows = [
        (display_name(a), *[""] * place, *(cell(a, b) for b in names[place + 1 :]))
        for place, a in enumerate(names[:-1])
    ]
    caption = (
        "Median D between every two solvers, with the largest D in brackets, over the cells that both solvers solved. "
        "Marked cells are left out"
    )
    return Table(["", *map(display_name, names[1:])], rows, caption)


def _causes_section(summary: Summary, captions: Captions) -> Section:
    """Return the section on the causes of divergence."""
    ladder = summary.ladder
    if not ladder.solvers:
        return Section("Causes", ["No engine has a result, so there is no difference to explain."])
    several = "three causes" if ladder.orders == "six" else "two causes"
    said = (
        "An engine differs from the model in several things at once (causes). To find the effect of each cause, exact "
        "solutions lead from the model to the engine's own contact law by one change at a time. The order of the first "
        f"{several} matters, so all {ladder.orders} orders are computed and averaged. In every cell the changes sum "
        "exactly to the difference between the engine and the model. The share of a cause is the component of its "
        "change along this whole difference, divided by D. The share over a region is the sum of these components over "
        "the sum of D. Shares sum to 100 %. A cause that brings the engine nearer to the model has a negative share."
    )
    header = ["cause", "from", "to", "in words"]
    rows = [(c.label, c.before, c.after, MEANINGS.get(c.name, "")) for c in ladder.present]
    figures = _figure_blocks(captions, "ladder-by-restitution", "ladder-by-chain")
    details = Section("Causes in detail", [Table(header, rows, text=4), *figures], folded=True)
    return Section("Causes", [said, findings.region_table(ladder, display_name), details])


def _accuracy_section(summary: Summary) -> Section:
    """Return the section on the accuracy of results: extrapolated limits, missing results, and marked cells."""
    closed_forms = summary.statuses.loc[REFERENCE].get("closed-form", 0)
    said = [
        "Nothing is random, so a repeated run gives the same numbers. An engine simulates every collision with several "
        "time steps. The results are extrapolated to a time step of zero (the limit dt -> 0), with an estimate of the "
        "error. All other sections show D at the time step of the run.",
        *(f"{each}." for each in findings.describe_unsolved(summary)),
        *(
            [
                f"In {closed_forms} {findings.count_noun(closed_forms, row_noun(summary))} the result of the model is "
                "a closed form of a limiting case."
            ]
            if closed_forms
            else []
        ),
        findings.describe_counted_cells(summary),
    ]
    header = [
        "solver",
        "own contact law",
        "converged",
        "error order",
        "step error",
        "estimated error of the limit",
    ]
    header += [
        "limit's distance from the law",
        "largest regularisation",
        f"limits within {number(HONEST)} estimated errors of the law",
    ]
    rows = [
        (
            display_name(row["solver"]),
            display_name(row["asked"] or "-"),
            f"{row['converged']} of {row['n']}",
            number(row["order"], 2),
            *(
                " / ".join(number(row[f"{kind}_{cut}"], 2) for cut in ("median", "max"))
                for kind in ("step", "error", "asked")
            ),
            number(row["regularisation"], 2),
            percent(row["honest"]),
        )
        for row in summary.estimates.to_dict("records")
    ]
    caption = (
        "Limits dt -> 0 of engines, compared with the exact solution of their own contact law. Errors and distances "
        "are velocities per |v0|, the largest of all balls. Entries are median / maximum over cells"
    )
    return Section("How sure is it?", [Markup(" ").join(said), Table(header, rows, caption, text=3)])


def _effective_section(folder: RunFolder) -> Section:
    """Return the section on solvers whose effective parameters differ from the requested parameters."""
    rows = pd.read_parquet(folder.table_path("cells.parquet"), columns=["solver", "differences"]).dropna()
    sentences: list[Block] = [
        f"{display_name(str(name))} uses other numbers than requested in {len(differences)} "
        f"{findings.count_noun(len(differences), NOUN_OF[folder.config().kind])}. In the first of them: "
        f"{differences.iloc[0]}."
        for name, differences in rows.groupby("solver").differences
    ]
    said = "Stiffness, damping, restitution and time step are read back from an engine after they were set."
    none = "All of them are as requested, to the precision of the numbers in the engine."
    product = describe_restitution_product(folder.config().solvers)
    return Section("Requested and effective", [said, *(sentences or [none]), *([product] if product else [])])


def _status_section(summary: Summary) -> Section:
    """Return the section that counts results by status.

    It also shows the reasons for missing results, and D in marked cells.
    """
    statuses, unit, more = summary.statuses, row_noun(summary), len(summary.reasons) - _REASONS
    counts = [(display_name(name), *row) for name, *row in statuses.itertuples()]
    reasons = [(display_name(name), *rest) for name, *rest in summary.reasons.head(_REASONS).to_numpy()]
    marked = [
        (display_name(name), int(row["n"]), *(number(row[cut]) for cut in CUTS))
        for name in summary.solvers
        if (row := summary.get(name, D, cells="marked"))["n"]
    ]
    why = f"Why {unit} have no result" + (
        f" ({more} more {findings.count_noun(more, 'reasons')} in cells.parquet)" if more > 0 else ""
    )
    tables = [
        Table(["solver", *statuses], counts, f"{unit} by solver and status".capitalize()),
        Table(["solver", "status", "reason", unit], reasons, why, text=3),
        Table(["solver", unit, "median", "95 %", "max"], marked, f"D in the marked {unit}"),
    ]
    return Section("Marked and unsolved", tables, folded=True)


def _method_section(folder: RunFolder, summary: Summary) -> Section:
    """Return the section on the method and on what the comparison leaves out."""
    span: list[str] = []
    if summary.config.scenario == "drop":
        values = read_column(folder.table_path("cells.parquet"), "gravity_number")
        span = [number(value, 2) for value in (values.min(), values.max())]
    said = render_template(
        "method.html.j2", c=summary.config, gravity_number=" to ".join(dict.fromkeys(span))
    )
    return Section("Method", [said], folded=True)


def _glossary_section(summary: Summary) -> Section:
    """Return the section with the glossary and the names of solvers in tables and commands."""
    left_out = {
        "pair": ("asymmetry",),
        "chain": ("S1", "asymmetry"),
        "graph": ("S1", "share", "dissipation law"),
    }
    absent = left_out[summary.config.kind]
    rows = [(word, f"{meaning}.") for word, meaning in GLOSSARY if not word.startswith(absent)]
    names = [(display_name(name), name) for name in summary.config.solvers]
    tables = [
        Table(["word", "meaning"], rows, text=2),
        Table(["solver", "in tables and commands"], names, text=2),
    ]
    return Section("Glossary", tables, folded=True)


def _provenance_section(folder: RunFolder) -> Section:
    """Return the section that lists the entries of the manifest of a run.

    It leaves out the counts of statuses, which have a section of their own, and the state of the run, which is not
    complete when its page is written.
    """
    entries = {key: value for key, value in folder.manifest().items() if key not in ("statuses", "state")}
    rows = [*_flatten(entries)]
    return Section("Provenance", [Table(["what", "value"], rows, text=2)], folded=True)


def _flatten(value: object, *names: str) -> Iterator[tuple[str, object]]:
    """Yield the values of nested tables and lists, each with the names of the keys that lead to it."""
    if isinstance(value, list):
        value = {str(place): item for place, item in enumerate(value, 1)}
    if not is_table(value):
        yield " ".join(names), value
        return
    for name, item in value.items():
        yield from _flatten(item, *names, name)
