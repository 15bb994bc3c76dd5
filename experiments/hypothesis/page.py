"""The page of a test, the other files of its folder, and what the command prints at the end."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from markupsafe import Markup
from rich.console import Console

from impact_xval.compliant_baselines.registry import engine_free_names, is_engine, kind_of
from impact_xval.experiments.hypothesis import cases, judging, verdicts
from impact_xval.experiments.hypothesis.cases import CASES, Frame
from impact_xval.experiments.hypothesis.figures import CAPTION, write_figure
from impact_xval.experiments.hypothesis.run import Results
from impact_xval.experiments.measures.laws import voters
from impact_xval.experiments.presentation.document import Block, Figure, Section, Table
from impact_xval.experiments.presentation.html import page_of
from impact_xval.experiments.presentation.terminal import show
from impact_xval.experiments.presentation.words import LAWS_WITH_LAWS, begun, named, one_vote
from impact_xval.experiments.tables.folder import write_text
from impact_xval.experiments.tables.numbers import listed, number, percent, short
from impact_xval.experiments.tables.parquet import replacing
from impact_xval.model.collision import RESULT_STATUSES

TITLE = "Does an infinitely stiff pair act as one body?"

MODEL, LAW_IN_TIME = "state-transition", "bistiffness"

#: Solvers with frozen positions: the model, and another impact law in its frame.
FROZEN = tuple(name for name in engine_free_names() if kind_of(name) == "model")

#: What makes the pair one body, by the verdicts of the model, and of its impact law with positions that move.
_MECHANISM = {
    ("supported", "supported"): "stiffness makes the pair one body, whether positions are frozen or move",
    ("supported", "refuted"): "frozen positions make the pair one body: where they move, it parts again",
    ("no limit", "refuted"): "frozen positions make the pair one body, but for what rings for ever",
}


def write_all(results: Results, root: Path) -> Path:
    """Write everything into the folder of a test; give the path of the page."""
    frames = {
        "verdicts.csv": results.verdicts,
        "points.csv": results.points,
        "columns.csv": results.columns,
        "outcomes.parquet": results.outcomes,
        "columns.parquet": results.column_outcomes,
    }
    for name, frame in frames.items():
        with replacing(root / name) as temporary:
            if name.endswith("csv"):
                frame.to_csv(temporary, index=False, lineterminator="\n")
            else:
                frame.to_parquet(temporary, index=False, compression="zstd")
    write_figure(results, root / "figures")
    write_text(root / "report.html", page_of(TITLE, blocks_of(results), root / "figures"))
    return root / "report.html"


def show_verdicts(console: Console, results: Results) -> None:
    """Print the verdicts, a row a limit and verdict."""
    rows = []
    for (case, verdict), found in _wholes(results).groupby(["case", "verdict"], sort=False):
        points = (f"{named(row.solver)} {reached(row, '/')}" for row in found.itertuples())
        rows.append((case, verdict, ", ".join(points)))
    caption = f"{TITLE} Verdicts, and points at which they are reached"
    table = Table(("limit", "verdict", "solvers"), rows, caption, text=3)
    show(console, ["", table, _columns_as_one(results), LAWS_WITH_LAWS])


def blocks_of(results: Results) -> list[Block]:
    """Build the page."""
    question = (
        "The supplement of Jia, Mason and Erdmann (Multiple Impacts: A State Transition Diagram Approach, IJRR 32(1), "
        "2013) derives its limiting cases from a hypothesis: if one of two contacts is infinitely stiffer than the "
        "other, its bodies act as one once they reach the same velocity, and the rest is a single impact with the "
        f"third body. This run approaches {len(CASES)} limits with {len(results.solvers)} solvers of "
        f"{len(voters(results.solvers))} laws, at {results.config.points} collisions or more for each limit. A limit "
        "is supported where the final velocities approach its closed form, and refuted where they approach another "
        "value."
    )
    sections = [_verdicts(results), _why(results), _columns(results)]
    return [
        question,
        LAWS_WITH_LAWS,
        *filter(None, sections),
        _classes(results),
        _sureness(results),
        _method(results),
    ]


def _wholes(results: Results) -> Frame:
    return results.verdicts[results.verdicts["class"] == "all"]


def _verdicts(results: Results) -> Section:
    found = {(row.solver, row.case): row for row in _wholes(results).itertuples()}
    rows = [(named(name), *(_cell(found[name, case.key]) for case in CASES)) for name in results.solvers]
    level = percent(verdicts.CLOSE)
    caption = (
        "Verdict, and the points at which it is reached. Below it, of a supported limit the rate r at which D, the "
        "distance from the closed form, falls as contrast^-r, median and 95 % interval of the median over the points; "
        f"of a refuted one the range of D. Last, the contrast from which on D stays within {level}, median over the "
        f"points. {one_vote(results.solvers)}"
    )
    header = ("solver", *(case.key for case in CASES))
    table = Table(header, rows, caption, text=len(header))
    return Section("Verdicts", [" ".join(_answer(results)), table, Figure("distance", CAPTION)])


def _cell(row: Any) -> Markup:
    low, high = (format(end, ".2f") for end in (row.rate_low, row.rate_high))
    rate = f"r {row.rate:.2f}" + (f" ({low} to {high})" if low != high else "")
    offsets = f"D {span((row.offset_least, row.offset_largest))}"
    more = {"supported": rate, "refuted": offsets}.get(
        row.verdict, "within its error" if row.within_error else ""
    )
    close = f"from {short(row.close_from, 1)}" if row.close_from < float("inf") else "never"
    return Markup("{}, {}<br>{}<br>{}").format(row.verdict, reached(row), more, close)


def _answer(results: Results) -> Iterator[str]:
    """Say what the model does, and what all laws with positions share."""
    wholes = _wholes(results)
    model = list(wholes[wholes.solver == MODEL].itertuples())
    if model:
        held = sum(one.verdict == "supported" for one in model)
        yield f"The model supports the hypothesis in {held} of {len(model)} limits."
    for one in (one for one in model if one.verdict != "supported"):
        yield f"In {one.case} its verdict is: {one.verdict}, at {reached(one)} points."
    if any(one.verdict == "no limit" for one in model):
        yield (
            "There e1 = 1 and e2 < 1, and the united balls ring for ever: depending on the phase, the compression of "
            "the table contact ends n times, and the balls leave with e2^(n-1) times the velocities of the closed form."
        )
    others = voters(name for name in results.solvers if name not in FROZEN)
    ways = {"refuted": "all refute it in", "supported": "all support it in", "undecided": "are undecided in"}
    shared: dict[str, list[str]] = {}
    for case, found in wholes[wholes.solver.isin(others)].groupby("case", sort=False):
        one = found.verdict.unique()
        shared.setdefault(ways.get(one[0], "differ in") if len(one) == 1 else "differ in", []).append(
            str(case)
        )
    if shared:
        laws = "; ".join(f"{way} {listed(keys)}" for way, keys in shared.items())
        yield f"The {len(others)} laws with positions {laws}."


def _why(results: Results) -> Section | None:
    """Say what makes the pair one body: what the law of the model does where positions move."""
    wholes = _wholes(results)
    by: dict[Any, Any] = {
        (row.case, row.solver): row for row in wholes[wholes.solver.isin([MODEL, LAW_IN_TIME])].itertuples()
    }
    rows = []
    for case in CASES:
        pair = [by[key] for key in ((case.key, MODEL), (case.key, LAW_IN_TIME)) if key in by]
        if len(pair) == 2:
            words = tuple(f"{one.verdict}, {reached(one)}" for one in pair)
            why = _MECHANISM.get((pair[0].verdict, pair[1].verdict), "the verdicts show no mechanism")
            rows.append((case.key, *words, why))
    said = (
        "Exact bistiffness has the impact law of the model, and positions: a contact acts again when its gap closes. "
        "Beside the model it shows what frozen positions do."
    )
    header = ("limit", *(begun(named(name)) for name in (MODEL, LAW_IN_TIME)), "what makes the pair one body")
    return Section("Why", [said, Table(header, rows, text=4)]) if rows else None


def _columns(results: Results) -> Section | None:
    """Compare columns of N balls with those in which the stiff pair is welded."""
    if results.columns.empty:
        return None
    design, wholes = results.config.columns, results.columns[results.columns["class"] == "all"]
    said = (
        f"One contact of a column of {span(design.balls)} balls becomes infinitely stiffer than all others. The same "
        "solver solves the column in which that pair is welded: one body of the mass and momentum of both, or part "
        "of the table. Bodies that meet at first have an impact of their own, which welding leaves out."
    )
    open_ones = wholes[wholes.n_undecided > 0].groupby(["arrangement", "stiff_contact"], sort=False)
    places = (f"{'/'.join(at)} ({listed(map(named, found.solver))})" for at, found in open_ones)
    rows = [
        (
            named(row.solver),
            "meet" if row.meets else "one velocity",
            *(f"{n} of {row.points}" for n in (row.n_supported, row.n_refuted)),
            span((row.least_rate, row.largest_rate), ".2f") if row.n_supported else "-",
            span((row.offset_least, row.offset_largest)) if row.n_refuted else "-",
        )
        for row in over_places(results).sort_values("meets", kind="stable").itertuples()
    ]
    header = ("solver", "bodies at first", "supported", "refuted", "rates", "D")
    caption = "Columns over all places. D: of the limits of refuted columns, from the welded column"
    undecided = f"Undecided columns: {'; '.join(places) or 'none'}."
    return Section("Columns of N balls", [said, Table(header, rows, caption, text=2), undecided])


def over_places(results: Results) -> Frame:
    """Count columns by solver, and by whether the bodies of the pair meet at first."""
    wholes = results.columns[results.columns["class"] == "all"]
    how = dict.fromkeys(["points", "n_supported", "n_refuted"], "sum")
    how |= {"least_rate": "min", "largest_rate": "max", "offset_least": "min", "offset_largest": "max"}
    return wholes.groupby(["solver", "meets"], sort=False).agg(how).reset_index()


def _columns_as_one(results: Results) -> str:
    """Say at how many columns a pair that has one velocity at first moves as one; empty without columns."""
    if results.columns.empty:
        return ""
    found = over_places(results)
    said = (
        f"{named(row.solver)} {row.n_supported} of {row.points}" for row in found[~found.meets].itertuples()
    )
    return f"Columns whose stiff pair has one velocity at first, and moves as one: {', '.join(said)}."


def _classes(results: Results) -> Section:
    """Show which classes have another verdict than their limit."""
    wholes = {(row.case, row.solver): row.verdict for row in _wholes(results).itertuples()}
    together: dict[tuple[str, str, str], list[str]] = {}
    for row in results.verdicts.rename(columns={"class": "kind"}).itertuples():
        if row.kind != "all" and row.verdict != wholes[row.case, row.solver]:
            word = "within error" if row.within_error else row.verdict
            together.setdefault((row.case, f"{row.kind}: {reached(row)}", word), []).append(named(row.solver))
    rows = [(*key, listed(names)) for key, names in together.items()]
    caption = "Classes of points, by which contacts are elastic, with another verdict than their limit"
    return Section(
        "Classes", [Table(("limit", "class", "verdict", "solvers"), rows, caption, text=4)], folded=True
    )


def _sureness(results: Results) -> Section:
    """Say how engines compare with their law, and what is left out."""
    outcomes = results.outcomes
    blocks: list[Block] = []
    for name in filter(is_engine, results.solvers):
        found = outcomes[(outcomes.solver == name) & outcomes.limit_distance.notna()]
        if len(found):
            away, within = found.limit_distance, (found.error >= found.limit_distance).mean()
            blocks.append(
                f"{named(name)}, in the limit dt -> 0, differs from the exact solver of its law by "
                f"{short(away.median(), 1)} |v0| in the median of {len(found)} outcomes, by {short(away.max(), 1)} at "
                f"most; {percent(within)} lie within its own error estimate."
            )
    lost = outcomes[~outcomes.status.isin(RESULT_STATUSES)].groupby(["solver", "status"], sort=False).size()
    words = [f"{n} of {named(solver)} ({status})" for (solver, status), n in lost.items()]
    blocks.append(
        f"Of {len(outcomes)} outcomes {int(outcomes.grazing.sum())} lie beside a grazing jump and are left out of "
        f"every fit; not converged, or without a result, are {listed(words) or 'none'}."
    )
    blocks += [f"Not tested: {named(name)} ({why})." for name, why in results.unavailable.items()]
    return Section("How sure the verdicts are", blocks, folded=True)


def _method(results: Results) -> Section:
    c = results.config
    rows = [(case.key, case.title, case.variable, case.regime, case.source) for case in CASES]
    said = [
        f"Each limit has {c.points} points of a scrambled Sobol sequence (seed {c.seed}): m2/m1 from "
        f"{span(cases.MASS_RATIO)}, inelastic e from {span(cases.RESTITUTION)}, fixed shares of elastic contacts, in "
        f"the plastic limits k2/k1 from {span(cases.STIFFNESS_RATIO)}; none within {number(cases.MARGIN)} |v0| of a "
        f"border between regimes. Exact solvers run at {c.per_decade} contrasts a decade from {span(c.contrast)} "
        f"(plastic: {span(c.plastic_contrast)}), engines at {c.engine_per_decade} from {span(c.engine_contrast)} "
        f"(plastic: {span(c.engine_plastic_contrast)}), at {number(c.step_fraction)} of the period of the stiffer "
        f"contact and less, until the limit dt -> 0 is known to {number(c.tolerance)} |v0|.",
        f"The rate is the Theil-Sen slope of ln D over ln contrast in the last {number(c.fit_decades)} decades "
        f"(engines: {number(c.engine_fit_decades)}) above {number(judging.FLOOR_ERRORS)} errors of the solver; the "
        "limit L is that of v = L + A x^-s by least squares. A point is refuted if its series settles, L lies further "
        "from the closed form than three of its errors and a fifth of the last distances, and nothing in the last "
        "decade comes nearer than half of that; supported if the 95 % interval of the rate lies above "
        f"{number(judging.LEAST_RATE)}, D falls by {number(judging.LEAST_FALL)} from the first decade of the fit to "
        "the last, and the series settles without a jump. A class of points is refuted by "
        f"{percent(verdicts.REFUTING_SHARE)} of its points; supported by half of them if every other agrees with the "
        "closed form within its error; without a limit if half of them do not settle. Of the classes of a limit the "
        "worst counts.",
        "One dimension, no friction, no gravity, linear springs. A fit over finite contrasts cannot exclude a limit "
        "that sets in beyond them. The cut-off of the model at large stiffness ratios is off, since it inserts the "
        "closed form.",
        f"{'; '.join(f'{named(name)} {which}' for name, which in results.versions.items() if is_engine(name))}. The "
        "numbers of this page are in the CSV and Parquet files beside it, runs and provenance in its folders.",
    ]
    caption = "The limits, m1 = 1 and |v0| = 1. 1/e^2: an end of compression multiplies a stiffness by that"
    limits = Table(("limit", "title", "contrast", "regime", "closed form"), rows, caption, text=5)
    return Section("Method, limits and provenance", [limits, *said], folded=True)


def reached(row: Any, of: str = " of ") -> str:
    """Say at how many points a verdict is reached."""
    n = row.points - row.n_supported - row.n_refuted
    n = {"supported": row.n_supported, "refuted": row.n_refuted}.get(row.verdict, n)
    return f"{n}{of}{row.points}"


def span(values: Iterable[float], digits: str = "") -> str:
    """Write the least and the largest of some numbers, in few digits or as a format says."""
    values = list(values)
    low, high = (format(end, digits) if digits else short(end, 2) for end in (min(values), max(values)))
    return low if low == high else f"{low} to {high}"
