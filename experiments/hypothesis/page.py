"""Presentation of a test of the hypothesis: its page with a figure, its tables as files, and the command's last lines.

The command `impact-xval hypothesis` calls this module with the results of `run.judge_runs`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from markupsafe import Markup
from rich.console import Console

from impact_xval.compliant_baselines.registry import description_of, is_engine, one_solver_per_law
from impact_xval.experiments.hypothesis.judging import CLOSE
from impact_xval.experiments.hypothesis.run import LIMITING_CASES, ROUNDING, HypothesisResults
from impact_xval.experiments.presentation.document import Block, Figure, Section, Table
from impact_xval.experiments.presentation.html import render_page
from impact_xval.experiments.presentation.style import save_figure, styled_figure
from impact_xval.experiments.presentation.terminal import print_blocks
from impact_xval.experiments.presentation.words import (
    LAWS_WITH_LAWS,
    describe_shared_laws,
    display_name,
    look_of,
)
from impact_xval.experiments.tables.folder import write_text
from impact_xval.experiments.tables.frames import Frame, FrameRow
from impact_xval.experiments.tables.numbers import compact_number, join_words, percent
from impact_xval.experiments.tables.parquet import replacing
from impact_xval.model.status import RESULT_STATUSES

TITLE = "Does an infinitely stiff pair act as one body?"

MODEL, LAW_IN_TIME = "state-transition", "bistiffness"

#: Statements in HTML about what makes the stiff pair one body. A key consists of two verdicts: the verdict on the model
#: and the verdict on bistiffness. Bistiffness is the impact law of the model with positions that move.
_MECHANISM = {
    ("supported", "supported"): "stiffness, whether<br>positions are frozen<br>or move",
    ("supported", "refuted"): "frozen positions:<br>if they move,<br>the pair parts again",
    ("no limit", "refuted"): "frozen positions,<br>unless contacts ring<br>for ever",
}


#: Explanations of the headers of columns and rows on the page. `registry` explains the solvers.
_LIMITING_CASES = {
    "zero-apart": "k2/k1 → 0, ball on ball infinitely stiffer than the table: the balls part at once, for good",
    "zero-early": "k2/k1 → 0: the balls meet again and are one body while the table contact is still compressed",
    "zero-late": "k2/k1 → 0: the balls meet again and are one body while the table contact restores",
    "infinity": "k2/k1 → ∞, the table infinitely stiffer than ball on ball: the lower ball is part of the table",
    "plastic-ball-ball": "e1 → 0: in restitution the contact of the balls is infinitely stiff, by the factor 1/e1^2",
    "plastic-ball-table": "e2 → 0: in restitution the table contact is infinitely stiff, by the factor 1/e2^2",
}
_MEANINGS = {
    "solver": "what solved the collisions: an exact law, or an engine",
    "made one body by": "what makes the pair one body, by the verdicts on the model and on exact bistiffness",
    "limiting case": "one of the six cases that are reached as the contrast grows",
    "elastic contacts": "which contacts of the points have e = 1; if e1 or e2 → 0, whether the other contact has e = 1",
    "bodies at first": "whether the bodies of the stiff contact first meet with different velocities, or have the same",
    "supported": "number of chains, of all, whose D from the welded chain falls as a power of the contrast",
    "refuted": "number of chains, of all, that go to another outcome than the welded chain",
    "rates": "least and largest r of the supported chains, whose D falls as contrast^-r",
    "D": "distance from the closed form or from the welded chain: its kinetic norm over that of the incoming motion",
    "contrast": "how many times stiffer one contact is than the others; it goes to infinity",
    "regime": "which collisions of two balls go to that limiting case",
    "name": "header of a column or a row",
    "meaning": "what the header stands for",
}


def write_hypothesis(results: HypothesisResults, root: Path) -> Path:
    """Write the tables, the figure and the page of a test into its folder; return the path of the page."""
    for name in ("verdicts", "points", "chains"):
        write_text(root / f"{name}.csv", getattr(results, name).to_csv(index=False, lineterminator="\n"))
    for name, frame in {"outcomes": results.outcomes, "chains": results.chain_outcomes}.items():
        with replacing(root / f"{name}.parquet") as temporary:
            frame.to_parquet(temporary, index=False, compression="zstd")
    (root / "figures").mkdir(exist_ok=True)
    _draw_distances(results, root / "figures")
    write_text(root / "report.html", render_page(TITLE, _blocks(results), root / "figures"))
    return root / "report.html"


def show_verdicts(console: Console, results: HypothesisResults) -> None:
    """Print the verdicts on the terminal, with the number of points that reach each verdict."""
    table = _verdict_grid(
        _rows_of_class_all(results.verdicts), {"solver": "solver"}, "case", _format_verdict, TITLE
    )
    print_blocks(console, ["", table, *_chains_as_one(results), LAWS_WITH_LAWS])


def _blocks(results: HypothesisResults) -> list[Block]:
    """Return the content of the page: the question, the answers, a table, a figure, and sections with details."""
    question = (
        "The supplement of Jia, Mason and Erdmann (IJRR 32(1), 2013) derives its limiting cases from a hypothesis: if "
        "one of two contacts is infinitely stiffer than the other, its bodies act as one once they reach the same "
        f"velocity, and the rest is a single impact with the third body. {len(results.solvers)} solvers of "
        f"{len(one_solver_per_law(results.solvers))} laws approach {len(LIMITING_CASES)} limiting cases, each at "
        f"{results.config.points} collisions or more. Supported: final velocities approach the closed form. "
        "Refuted: they approach other velocities."
    )
    held = _rows_of_class_all(results.verdicts).query("solver == @MODEL and verdict == 'supported'")
    answers = list(_chains_as_one(results))
    if MODEL in results.solvers:
        answers.insert(0, f"The model supports it in {len(held)} of {len(LIMITING_CASES)} limiting cases.")
    figure = Figure(
        "distance",
        "D over the contrast, the median over the points at which no contact with a fixed e is elastic. Open markers: "
        "engines, in the limit dt -> 0. A line that levels out goes to another outcome",
    )
    return [
        question,
        " ".join(answers),
        _verdict_table(results),
        figure,
        LAWS_WITH_LAWS,
        _names_section(results),
        _details_section(results),
        _method_section(results),
    ]


def _names_section(results: HypothesisResults) -> Section:
    """Return the section of the page that explains the headers of columns and rows, and the solvers."""
    solvers = {display_name(name): f"{description_of(name)} (solver {name})" for name in results.solvers}
    rows = [*_LIMITING_CASES.items(), *solvers.items(), *_MEANINGS.items()]
    return Section("What the names mean", [Table(("name", "meaning"), rows, text=2)], folded=True)


def _verdict_grid(
    rows: Frame, index: Mapping[str, str], columns: str, cell: Callable[[FrameRow], str], caption: str = ""
) -> Table:
    """Return a table with one verdict per cell.

    The first columns of the table name its lines. They are the columns of `rows` that are the keys of `index`; the
    values of `index` are their headers. The table has one more column for each value that `rows` has in the column
    named `columns`. `cell` returns the verdict of a row as text.
    """
    cells = rows.assign(cell=[cell(row) for row in rows.itertuples()])
    grid = cells.pivot_table("cell", [*index], columns, aggfunc="first", sort=False, observed=True)
    lines = [(display_name(name), *line) for name, *line in grid.reset_index().itertuples(index=False)]
    header = (*index.values(), *map(display_name, grid))
    return Table(header, lines, caption, text=len(header))


def _format_verdict(row: FrameRow) -> str:
    """Write a verdict and the number of points that reach it, such as ``supported 20/24``."""
    return f"{row.verdict} {getattr(row, f'n_{row.verdict}', row.n_undecided)}/{row.points}"


def _rows_of_class_all(table: Frame) -> Frame:
    """Return the verdicts on all points of each limiting case.

    The verdicts on single classes of points are not returned.
    """
    return table[table["class"] == "all"]


def _chains_as_one(results: HypothesisResults) -> Iterator[str]:
    """Yield a sentence that counts, for each solver, the chains in which the stiff pair moves as one body.

    Only those chains are counted in which the two bodies of the stiff pair have the same velocity at first. If there
    are no such chains, nothing is yielded.
    """
    places = count_chains(results)
    counts = [
        f"{display_name(solver)} {supported}" for solver, first, supported, *_ in places if first != "meet"
    ]
    if counts:
        yield f"Chains whose stiff pair has one velocity at the start, and moves as one: {', '.join(counts)}."


def _verdict_table(results: HypothesisResults) -> Table:
    """Return the table of verdicts, with one row per solver and one column per limiting case.

    Bistiffness is the model's law with positions that move. The row below it says what makes the pair one body.
    """
    wholes = _rows_of_class_all(results.verdicts)
    caption = (
        "Verdict, number of points at which it is reached, and the contrast from which on D is at most "
        f"{percent(CLOSE)}, the median over the points. D is the distance from the closed form. Below a verdict "
        "“supported” stands the rate r with which D falls as contrast^-r, its median and 95 % interval; below "
        "“refuted” the range of D. Exact bistiffness has the model's law, and positions that move. "
        f"{describe_shared_laws(results.solvers)}"
    )
    table = _verdict_grid(wholes, {"solver": "solver"}, "case", _format_cell, caption)
    rows = [(name, *map(Markup, cells)) for name, *cells in table.rows]
    if {MODEL, LAW_IN_TIME} <= {*results.solvers}:
        pairs = zip(*(wholes[wholes.solver == one].verdict for one in (MODEL, LAW_IN_TIME)), strict=True)
        made_one = ("made one body by", *(Markup(_MECHANISM.get(pair, "-")) for pair in pairs))
        rows.insert(results.solvers.index(LAW_IN_TIME) + 1, made_one)
    return replace(table, rows=rows)


def _format_cell(row: FrameRow) -> str:
    """Return the HTML of a verdict, with the contrast above which D is small, and the rate or the range of D."""
    more = "within its error" if row.within_error else ""
    if row.verdict == "supported":
        low, high = (format(end, ".2f") for end in (row.rate_low, row.rate_high))
        more = f"r {row.rate:.2f}" + (f" ({low}–{high})" if low != high else "")
    elif row.verdict == "refuted":
        more = f"D {format_range((row.offset_least, row.offset_largest))}"
    close = f"≥{compact_number(row.close_from, 1)}" if row.close_from < float("inf") else "never"
    return f"{_format_verdict(row)} {close}<br>{more}"


def _draw_distances(results: HypothesisResults, folder: Path) -> None:
    """Draw the distance D from the closed form over the contrast, with one line per solver."""
    usable: Frame = results.outcomes.query("used and `class`.str.endswith('lossy')")
    with styled_figure(11.0, 4.8) as figure:
        axes = figure.subplots(2, 3)
        for ax, case in zip(axes.flat, LIMITING_CASES, strict=True):
            for name in results.solvers:
                outcomes = usable[(usable["case"] == case.key) & (usable.solver == name)]
                by_contrast = outcomes.groupby("contrast").distance.agg(["median", "size"])
                has_most_points = by_contrast["size"] > outcomes.point.nunique() / 2
                is_above_rounding = by_contrast["median"] >= ROUNDING
                median = by_contrast["median"].where(has_most_points & is_above_rounding)
                style = look_of(name)
                (line,) = ax.loglog(median.index, median, color=style.color, label=display_name(name))
                if is_engine(name):
                    line.set(linestyle="none", marker=style.marker, markerfacecolor="none")
                else:
                    line.set(linestyle=style.dash)
            ax.set_xlabel(f"contrast {case.variable} (-)")
            ax.set_title(case.key, fontsize=8.5)
        for ax in axes[:, 0]:
            ax.set_ylabel("D (-)")
        figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=5)
    save_figure(figure, folder, "distance")


def _details_section(results: HypothesisResults) -> Section:
    """Return the section of the page with the verdicts on classes of points and on chains of N balls."""
    classes = results.verdicts[results.verdicts["class"] != "all"]
    lines = {"case": "limiting case", "class": "elastic contacts"}
    of_points = _verdict_grid(classes, lines, "solver", _format_verdict)
    balls = format_range(results.config.chains.balls)
    caption = (
        f"Chains of {balls} balls, in which one contact becomes infinitely stiff. They are compared with chains in "
        "which its two bodies are welded: one body, or part of the table. D: from refuted chains to the welded chains"
    )
    rows = [(display_name(solver), *row) for solver, *row in count_chains(results)]
    header = ("solver", "bodies at first", "supported", "refuted", "rates", "D")
    of_chains = Table(header, rows, caption, text=2)
    return Section("Classes of points, chains of N balls", [of_points, of_chains], folded=True)


def count_chains(results: HypothesisResults) -> Iterator[tuple[str, ...]]:
    """Yield the rows of the table of chains.

    Each solver has one row for chains whose stiff pair meets at first, and one row for all other chains.

    A row has the numbers of supported and refuted chains, the range of rates, and the range of D.
    """
    if results.chains.empty:
        return
    for (solver, meets), rows in _rows_of_class_all(results.chains).groupby(["solver", "meets"], sort=False):
        sums = rows[["n_supported", "n_refuted", "points"]].sum()
        counts = (f"{n} of {sums.points}" for n in (sums.n_supported, sums.n_refuted))
        rates = (
            format_range((rows.least_rate.min(), rows.largest_rate.max()), ".2f") if sums.n_supported else "-"
        )
        distances = (
            format_range((rows.offset_least.min(), rows.offset_largest.max())) if sums.n_refuted else "-"
        )
        yield solver, "meet" if meets else "one velocity", *counts, rates, distances


def _method_section(results: HypothesisResults) -> Section:
    """Return the section on limiting cases, unused outcomes, and the distance of engines from exact laws."""
    outcomes = results.outcomes
    caption = (
        "The limiting cases, with m1 = 1 and |v0| = 1. The end of compression multiplies a stiffness by 1/e^2"
    )
    cases = Table(
        ("limiting case", "contrast", "regime"), [case[:3] for case in LIMITING_CASES], caption, text=3
    )
    lost = outcomes[~outcomes.status.isin(RESULT_STATUSES)].groupby(["solver", "status"], sort=False).size()
    words = join_words(f"{n} of {display_name(solver)} ({status})" for (solver, status), n in lost.items())
    said = [
        f"The design is hypothesis.toml beside this page (seed {results.config.seed}); docs/hypothesis.md says how "
        "points are drawn, how verdicts are reached, and what is not shown.",
        f"Of {len(outcomes)} outcomes {int(outcomes.grazing.sum())} lie next to a jump where a contact grazes, and no "
        f"fit uses them. Outcomes that did not converge or have no result: {words or 'none'}.",
    ]
    for name, version in results.versions.items():
        away = outcomes[outcomes.solver == name].limit_distance
        said.append(
            f"{display_name(name)} {version}: in the limit dt -> 0 it differs from the exact solver of its law by "
            f"{compact_number(away.median(), 1)} |v0| in the median, by {compact_number(away.max(), 1)} at most."
            if name in results.solvers
            else f"{display_name(name)}: {version}"
        )
    return Section("Method, limiting cases and provenance", [cases, *said], folded=True)


def format_range(values: Sequence[float], digits: str = "") -> str:
    """Write the range of numbers, such as ``0.1 to 2``. Ends have two digits, or the format `digits`."""
    low, high = (
        format(end, digits) if digits else compact_number(end, 2) for end in (min(values), max(values))
    )
    return low if low == high else f"{low} to {high}"
