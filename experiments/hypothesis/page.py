"""The page of a run, the other files of its folder, and what the command prints at the end."""

from __future__ import annotations

import math
import platform
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from importlib.metadata import version
from pathlib import Path
from typing import Any

import pandas as pd
from markupsafe import Markup
from rich.console import Console

from impact_xval.compliant_baselines.registry import engine_free_names, kind_of
from impact_xval.experiments.hypothesis import cases, judging, mechanism, solvers, tables, verdicts
from impact_xval.experiments.hypothesis.cases import CASES
from impact_xval.experiments.hypothesis.figures import map_name, write_figures
from impact_xval.experiments.hypothesis.mechanism import Mechanism
from impact_xval.experiments.hypothesis.run import DRAWN_CONTRAST, Results
from impact_xval.experiments.hypothesis.verdicts import CaseResult, Group
from impact_xval.experiments.measures.laws import voters
from impact_xval.experiments.presentation.document import Block, Figure, Section, Table
from impact_xval.experiments.presentation.html import page_of
from impact_xval.experiments.presentation.terminal import show
from impact_xval.experiments.presentation.words import LAWS_WITH_LAWS, named, one_vote
from impact_xval.experiments.sweep.pool import available_cores
from impact_xval.experiments.tables.folder import write_json, write_text
from impact_xval.experiments.tables.numbers import listed, number, percent, short
from impact_xval.experiments.tables.parquet import replacing
from impact_xval.model.collision import RESULT_STATUSES

TITLE = "Does an infinitely stiff pair act as one body?"

MODEL, LAW_IN_TIME, OTHER_LAW = "state-transition", "bistiffness", "liu-zhao-brogliato"

#: Solvers with frozen positions: the model, and another impact law in its frame.
FROZEN = tuple(name for name in engine_free_names() if kind_of(name) == "model")

#: Titles of a table of the motion of a stiff pair, and what they mean.
_MOTION = ("separation", "relative speed", "rate", "collides again")
_MOTION_IS = (
    "After the instant of equal velocities, at the highest contrast: separation at that instant per largest "
    "compression of the soft contact; largest relative speed per |v0|, and the rate at which it falls; next collision, "
    "after half periods of the soft contact, at a speed per |v0|"
)

#: The level, in per cent, and the mass ratios of the table of contrasts that are needed.
_LEVEL, _MASSES = 5, (0.5, 1.0, 5.0)


def write_all(results: Results, root: Path, seconds: float) -> Path:
    """Write everything into a folder; give the path of the page."""
    versions = {"impact-xval": version("impact-xval"), "Python": platform.python_version()}
    versions |= {name: results.versions[name] for name in results.solvers if name != MODEL}
    frames = {
        "verdicts.csv": tables.class_frame(results),
        "points.csv": tables.point_frame(results),
        "mechanism.csv": tables.mechanism_frame(results),
        "columns.csv": tables.column_class_frame(results),
        "contrast-needed.csv": tables.need_frame(results),
        "outcomes.parquet": tables.outcome_frame(results),
        "maps.parquet": results.maps,
        "columns.parquet": tables.column_outcome_frame(results),
    }
    for name, frame in frames.items():
        with replacing(root / name) as temporary:
            if name.endswith("csv"):
                frame.to_csv(temporary, index=False, lineterminator="\n")
            else:
                frame.to_parquet(temporary, index=False, compression="zstd")
    write_figures(results, root / "figures")
    write_text(root / "report.html", page_of(TITLE, blocks_of(results, frames, versions), root / "figures"))
    machine = {"system": platform.system(), "processor": platform.processor() or platform.machine()}
    manifest = {
        "format": "impact-xval hypothesis, format 1",
        "configuration": results.config.model_dump(mode="json"),
        "versions": versions,
        "unavailable": results.unavailable,
        "machine": machine | {"cores": available_cores()},
        "seconds": {name: round(s, 1) for name, s in (results.seconds | {"total": seconds}).items()},
    }
    write_json(root / "manifest.json", manifest)
    return root / "report.html"


def show_verdicts(console: Console, results: Results) -> None:
    """Print the verdicts, a row a limit and verdict."""
    rows = []
    for case in CASES:
        for verdict in ("supported", "refuted", "undecided"):
            found = [r for r in results.verdicts if r.case == case and r.whole.verdict == verdict]
            points = (f"{named(r.solver)} {r.whole.counts[verdict]}/{r.whole.points}" for r in found)
            rows += [(case.key, verdict, ", ".join(points))] if found else []
    caption = "Does an infinitely stiff pair act as one body? Verdicts, and points at which they are reached"
    table = Table(("limit", "verdict", "solvers"), rows, caption, text=3)
    show(console, ["", table, _columns_as_one(results), LAWS_WITH_LAWS])


def blocks_of(results: Results, frames: Mapping[str, Any], versions: Mapping[str, str]) -> list[Block]:
    """Build the page from the results, the frames of `write_all` and versions."""
    question = (
        "The supplement of Jia, Mason and Erdmann (Multiple Impacts: A State Transition Diagram Approach, IJRR 32(1), "
        "2013) derives its limiting cases from a hypothesis: if one of two contacts is infinitely stiffer than the "
        "other, its bodies act as one once they reach the same velocity, and the rest is a single impact with the "
        f"third body. This run approaches {len(CASES)} limits with {len(results.solvers)} solvers of "
        f"{len(voters(results.solvers))} laws, at {results.config.points} collisions or more for each limit. A limit "
        "is supported where the final velocities approach its closed form, and refuted where they approach another "
        "value."
    )
    unfolded = [_verdicts(results), *_why(results), *_columns(results)]
    folded = [
        _details(results, frames["verdicts.csv"]),
        _stiff_enough(results, frames["contrast-needed.csv"]),
    ]
    folded += [*_more(results), _sureness(results), _method(results, versions)]
    return [question, LAWS_WITH_LAWS, *unfolded, *folded]


def _verdicts(results: Results) -> Section:
    found = {(one.solver, one.case): one for one in results.verdicts}
    rows = [(named(name), *(_cell(results, found[name, case]) for case in CASES)) for name in results.solvers]
    caption = (
        "Verdict, and the points at which it is reached. Below it, of a supported limit the rate r at which D, the "
        "distance from the closed form, falls as contrast^-r, median and range over the points; of a refuted one the "
        f"range of D. {one_vote(results.solvers, name=True)}"
    )
    header = ("solver", *(case.key for case in CASES))
    return Section("Verdicts", [" ".join(_answer(results)), Table(header, rows, caption, text=len(header))])


def _cell(results: Results, found: CaseResult) -> Markup:
    whole = found.whole
    rates = _span(whole.rates, ".2f")
    more = {
        "supported": f"{whole.rate:.2f} ({rates})" if "to" in rates else rates,
        "refuted": f"D {_span(whole.offsets)}",
        "undecided": "within its error" if whole.agrees else "",
    }
    verdict = "no limit" if _limitless(results, found) else whole.verdict
    return Markup("{}, {}<br>{}").format(verdict, _reached(whole), more[whole.verdict])


def _limitless(results: Results, found: CaseResult) -> bool:
    """Whether this is the model where it has no limit (`mechanism`)."""
    here = (found.solver, found.case.key, found.whole.verdict) == (MODEL, "zero-early", "undecided")
    open_ones = [group.name for group in found.classes if group.verdict == "undecided"]
    return here and bool(results.branches) and open_ones == ["only e1 = 1"]


def _answer(results: Results) -> Iterator[str]:
    """Say what the model does, and what all laws with positions share."""
    model = [one for one in results.verdicts if one.solver == MODEL]
    if model:
        held = sum(one.whole.verdict == "supported" for one in model)
        yield f"The model supports the hypothesis in {held} of {len(model)} limits."
    for one in (one for one in model if one.whole.verdict != "supported"):
        verdict = "it has no limit" if _limitless(results, one) else f"it is {one.whole.verdict}"
        yield f"In {one.case.key} {verdict} at {_reached(one.whole)} points."
        if _limitless(results, one):
            yield (
                "There e1 = 1 and e2 < 1, and the united balls ring for ever: depending on the phase, the compression "
                "of the table contact ends n times, and the balls leave with e2^(n-1) times the velocities of the "
                "closed form."
            )
    others = voters(name for name in results.solvers if name not in FROZEN)
    ways = {"refuted": "all refute it in", "supported": "all support it in", "undecided": "are undecided in"}
    shared: dict[str, list[str]] = {}
    for case in CASES if others else ():
        same = {one.whole.verdict for one in results.verdicts if one.case == case and one.solver in others}
        shared.setdefault(ways[same.pop()] if len(same) == 1 else "differ in", []).append(case.key)
    if shared:
        laws = "; ".join(f"{way} {listed(keys)}" for way, keys in shared.items())
        yield f"The {len(others)} laws with positions {laws}."


def _why(results: Results) -> Iterator[Section]:
    """Say how the stiff pair moves by the law of the model in time, and show it."""
    said = [
        "Exact bistiffness has the impact law of the model, and positions: a contact acts again when its gap closes."
    ]
    for case in ("zero-early", "zero-late"):
        law, model = results.verdict(LAW_IN_TIME, case), results.verdict(MODEL, case)
        if law and model and (law.whole.verdict, model.whole.verdict) == ("refuted", "supported"):
            said.append(
                f"In {case} the frozen positions of the model make the pair one body, not its stiffness."
            )
    motions = {case: _followed(results, case.key).get(LAW_IN_TIME) for case in CASES}
    found = {case: motion for case, motion in motions.items() if motion}
    blocks: list[Block] = [
        " ".join(said),
        *(f"{case.key} ({case.title}): {_pair(*motion)}" for case, motion in found.items()),
    ]
    if results.motions:
        drawn = (
            f"The stiff pair at a contrast of {number(DRAWN_CONTRAST)}. Top: relative velocity, positive where it "
            "separates. Bottom: separation; of the model the one that its velocities imply. Dots: equal velocities."
        )
        blocks.append(Figure("relative-motion", drawn))
    rows = [(case.key, *_motion_of(*motion)) for case, motion in found.items() if motion[1].joined]
    blocks.append(Table(("bistiffness", *_MOTION), rows, _MOTION_IS))
    if found:
        yield Section("Why", blocks, beside=True)


def _followed(results: Results, case: str) -> dict[str, tuple[Mechanism, Mechanism]]:
    """Mechanism of every solver in a limit at its lowest and its highest contrast."""
    found: dict[str, list[Mechanism]] = {}
    for one in results.mechanisms:  # of a solver by rising contrast
        if one.case == case:
            found.setdefault(one.solver, []).append(one)
    return {name: (each[0], each[-1]) for name, each in found.items()}


def _pair(low: Mechanism, high: Mechanism) -> str:
    if not high.joined:
        return "the balls never return to one velocity, and no pair forms."
    falls = high.rate_since(low) >= judging.LEAST_RATE
    if high.opens and not falls:
        return "the pair is open at equal velocities; the speed of its next collision does not fall with the contrast."
    start = "opens again, but its" if high.opens else "stays closed; its"
    return f"the pair {start} relative speed {'falls' if falls else 'does not fall'} with the contrast."


def _motion_of(low: Mechanism, high: Mechanism) -> tuple[str, ...]:
    """Cells of a table with the titles `_MOTION`."""
    again = "at once" if high.at_once else "-"
    if high.opens:
        again = f"{high.again_after:.2f} at {short(round(high.again_speed, 9), 2)}"
    rate = f"{round(high.rate_since(low), 2) + 0.0:.2f}"
    return short(high.gap_then), short(high.largest_rate), rate, again


def _over_places(results: Results) -> tuple[Any, Any]:
    """Verdicts on columns by place, and by solver and whether the bodies of the pair meet at first."""
    frame: Any = tables.column_class_frame(results)
    frame = frame[frame["class"] == "all"]
    sums = dict.fromkeys(["points", "n_supported", "n_refuted"], "sum")
    ends = {"least_rate": "min", "largest_rate": "max", "offset_least": "min", "offset_largest": "max"}
    how = sums | ends | {"missed_prediction_largest": "max"}
    return frame, frame.groupby(["solver", "meets"], sort=False).agg(how)


def _columns(results: Results) -> Iterator[Section]:
    """Compare columns of N balls with those in which the stiff pair is welded."""
    if results.columns:
        least, most = results.config.columns.balls
        said = (
            f"One contact of a column of {least} to {most} balls becomes infinitely stiffer than all others. The same "
            "solver solves the column in which that pair is welded: one body of the mass and momentum of both, or part "
            "of the table. Bodies that meet at first have an impact of their own, which welding leaves out."
        )
        by_place = _over_places(results)[0].query("n_undecided > 0").groupby(["arrangement", "stiff_contact"])
        places = (f"{'/'.join(at)} ({listed(map(named, found.solver))})" for at, found in by_place)
        undecided = f"Undecided columns: {'; '.join(places) or 'none'}."
        yield Section("Columns of N balls", [said, f"{_columns_as_one(results)} {undecided}"])


def _columns_as_one(results: Results) -> str:
    """Say at how many columns a pair that has one velocity at first moves as one; empty without columns."""
    if not results.columns:
        return ""
    rows: Any = _over_places(results)[1].xs(False, level="meets").itertuples()
    said = []
    for row in rows:
        rates = f" (rates {_span((row.least_rate, row.largest_rate), '.2f')})" if row.n_supported else ""
        said.append(f"{named(row.Index)} {row.n_supported} of {row.points}{rates}")
    return f"Columns whose stiff pair has one velocity at first, and moves as one: {', '.join(said)}."


def _details(results: Results, classes: pd.DataFrame) -> Section:
    """Show how distances fall, which classes differ, where refuted series go, and what a solver's law predicts."""
    drawn = (
        "D = sqrt((m1 dv1^2 + m2 dv2^2)/(m1 v0^2)) from the closed form: median over the points whose other contacts "
        "are lossy. Open markers: engines, extrapolated to dt -> 0. Dotted: the fitted power law and its exponent. A "
        "line that levels out goes to another limit."
    )
    together: dict[tuple[str, str, str], list[str]] = {}
    for one in results.verdicts:
        words: dict[str, list[str]] = {}
        for group in one.differing:
            words.setdefault(group.word, []).append(f"{group.name}: {_reached(group)}")
        for word, names in words.items():
            together.setdefault((one.case.key, "; ".join(names), word), []).append(named(one.solver))
    rows = [(*key, listed(names)) for key, names in together.items()]
    caption = "Classes of points, by which contacts are elastic, with another verdict than their limit"
    differing = Table(("limit", "class", "verdict", "solvers"), rows, caption, text=4)
    refuted: Any = classes[(classes["class"] == "all") & (classes.n_refuted > 0)].itertuples()
    rows = [
        (
            row.case,
            named(row.solver),
            row.prediction or "-",
            f"{row.n_refuted} of {row.points}",
            _span((row.offset_least, row.offset_largest)),
            short(row.missed_prediction_largest, 1),
        )
        for row in refuted
    ]
    caption = (
        "Refuted points, D of their limits from the closed form, and the largest distance of these limits from what "
        "the law of the solver predicts without a simulation"
    )
    header = ("limit", "solver", "prediction", "refuted", "D", "off prediction")
    predicted = Table(header, rows, caption, text=3)
    return Section("Verdicts in detail", [Figure("distance", drawn), differing, predicted], folded=True)


def _stiff_enough(results: Results, needed: pd.DataFrame) -> Section:
    e1, e2 = results.config.map.restitutions[0]
    here: Any = needed[(needed.e1 == e1) & (needed.e2 == e2) & needed.mass_ratio.isin(_MASSES)]
    contrasts = here.groupby("solver")[f"contrast_{_LEVEL}pct"].agg(list)
    rows = [(named(name), *(short(x, 2) for x in contrasts[name])) for name in results.solvers]
    header = ("solver", *(f"{side}, {mass:g}" for side in ("k2 < k1", "k2 > k1") for mass in _MASSES))
    caption = (
        f"Contrast from which on D stays within {_LEVEL} %, by side and m2/m1, at e1 = {number(e1)}, e2 = "
        f"{number(e2)}. contrast-needed.csv has other levels, mass ratios and restitutions."
    )
    drawn = "D from the closed form of the nearer limit at e1 = {:g}, e2 = {:g}. White: no result, or beyond the map."
    maps = [Figure(map_name(*pair), drawn.format(*pair)) for pair in results.mapped]
    return Section("How stiff is stiff enough", [Table(header, rows, caption), *maps], folded=True)


def _more(results: Results) -> Iterator[Section]:
    """Show the motion of the pair by every solver, outcomes of the model without a limit, and columns by place."""
    followed = ((case.key, *each) for case in CASES for each in _followed(results, case.key).items())
    rows = [(case, named(solver), *_motion_of(*both)) for case, solver, both in followed if both[1].joined]
    table = Table(("limit", "solver", *_MOTION), rows, _MOTION_IS, text=2)
    yield Section("The stiff pair by every solver", [table], folded=True)
    if results.branches:
        worst = max(abs(b.measured - b.predicted) / max(b.uncertainty, 1e-9) for b in results.branches)
        point = max(results.branches, key=lambda b: b.measured).point
        drawn = (
            f"e1 = 1. Left: v1 of the model against the contrast at m2/m1 = {number(point.mass_ratio)}, e2 = "
            f"{number(point.e2)}. Right: share of contrasts with n = 2 ends of compression, counted (bars: 95 %), and "
            "the closed form max(0, 1 - |n - 1 - r|), r = (sqrt(q^2 - 1) - arccos(1/q))/pi, q^2 = (3 - m2)/(m2 (1 + "
            f"m2)), m1 = 1. Over {mechanism.COUNT} contrasts from {_span(mechanism.RANGE)} they differ by {worst:.1f} "
            "half-widths of the interval at most."
        )
        yield Section("The model without a limit", [Figure("no-limit", drawn)], folded=True)
    if results.columns:
        found: Any = _over_places(results)[1].reset_index().sort_values("meets", kind="stable").itertuples()
        rows = [
            (
                named(row.solver),
                "meet" if row.meets else "one velocity",
                *(f"{n} of {row.points}" for n in (row.n_supported, row.n_refuted)),
                _span((row.offset_least, row.offset_largest)),
                number(row.missed_prediction_largest, 2),
            )
            for row in found
        ]
        header = ("solver", "bodies at first", "supported", "refuted", "D", "off own dashpots")
        caption = (
            "D from the welded column. Off own dashpots: from the welded one whose dashpots are as they were"
        )
        drawn = (
            "D from the welded column against the stiffness of the contact over the stiffest other one: median over "
            "the lossy columns of a place. A line that levels out goes to another limit."
        )
        blocks = [Table(header, rows, caption, text=2), Figure("columns", drawn)]
        yield Section("Columns by place", blocks, folded=True)


def _sureness(results: Results) -> Section:
    """Say what another fit changes, how engines are checked, and what is left out."""
    shifted = [(one, one.whole.shifted) for one in results.verdicts if one.whole.shifted]
    moved = [
        f"{named(one.solver)} in {one.case.key}, {one.whole.verdict} to {then.verdict}"
        for one, then in shifted
        if one.whole.verdict != then.verdict
    ]
    fits = f"Fits a decade earlier change {len(moved)} of {len(shifted)} verdicts"
    blocks: list[Block] = [f"{fits}{': ' if moved else ''}{'; '.join(moved)}."]
    for name, found in results.control.items():
        blocks.append(
            f"{named(name)}, extrapolated to dt -> 0, differs from the exact solver of its law by "
            f"{short(found.distance.median(), 1)} in the median of {len(found)} outcomes, by "
            f"{short(found.distance.max(), 1)} at most; {percent((3 * found.error >= found.distance).mean())} lie "
            "within three of its own error estimates."
        )
    statuses = Counter((s.solver.name, status) for s in results.series for status in s.outcomes.status)
    lost = [
        f"{n} of {named(who)} ({what})" for (who, what), n in statuses.items() if what not in RESULT_STATUSES
    ]
    grazing = sum(point.grazing for one in results.verdicts for point in one.whole.members)
    blocks.append(
        f"Of {statuses.total()} outcomes {grazing} lie beside a grazing jump and are left out of every fit; without a "
        f"result are {listed(lost) or 'none'}."
    )
    blocks += [f"Not tested: {named(name)} ({why})." for name, why in results.unavailable.items()]
    return Section("How sure the verdicts are", blocks, folded=True)


def _method(results: Results, versions: Mapping[str, str]) -> Section:
    c = results.config
    rows = [(case.key, case.title, case.variable, case.regime, case.source) for case in CASES]
    costly = listed(dict.fromkeys(named(s.solver.name) for s in results.series if s.solver.costly))
    said = [
        f"Each limit has {c.points} points of a scrambled Sobol sequence (seed {c.seed}): m2/m1 from "
        f"{_span(cases.MASS_RATIO)}, inelastic e from {_span(cases.RESTITUTION)}, fixed shares of elastic contacts, in "
        f"the plastic limits k2/k1 from {_span(cases.STIFFNESS_RATIO)}; none within {number(cases.MARGIN)} |v0| of a "
        f"border between regimes. Exact solvers run at {c.per_decade} contrasts a decade from {_span(c.contrast)} "
        f"(plastic: {_span(c.plastic_contrast)}), engines at {c.engine_per_decade} from {_span(c.engine_contrast)} "
        f"(plastic: {_span(c.engine_plastic_contrast)}), at 1/{c.steps}, 1/{2 * c.steps} and 1/{4 * c.steps} of the "
        "period of the stiffer contact, extrapolated to dt -> 0 by Richardson's table. Its next term is their error, "
        f"at least {short(solvers.LEAST_ERROR)}."
        + (f" {costly}: a third of the steps, a decade less." if costly else ""),
        f"The rate is the Theil-Sen slope of ln D over ln contrast in the last {number(c.fit_decades)} decades "
        f"(engines: {number(c.engine_fit_decades)}) above {number(judging.FLOOR_ERRORS)} errors of the solver; the "
        "limit L is that of v = L + A x^-s by least squares. A point is refuted if its series settles, L lies further "
        "from the closed form than three of its errors and a fifth of the last distances, and nothing in the last "
        "decade comes nearer than half of that; supported if the 95 % interval of the rate lies above "
        f"{number(judging.LEAST_RATE)}, D falls by {number(judging.LEAST_FALL)} from the first decade of the fit to "
        "the last, and the series settles without a jump. A class of points is refuted by "
        f"{percent(verdicts.REFUTING_SHARE)} of its points; supported by half of them if every other agrees with the "
        "closed form within its error. Of the classes of a limit the worst counts.",
        "One dimension, no friction, no gravity, linear springs. A fit over finite contrasts cannot exclude a limit "
        "that sets in beyond them. The cut-off of the model at large stiffness ratios is off, since it inserts the "
        "closed form; beyond a running ratio of 1e30 it takes over all the same, and that is part of the error of the "
        "model.",
        f"{'; '.join(f'{name} {which}' for name, which in versions.items())}. The numbers of this page are in the CSV "
        "and Parquet files beside it.",
    ]
    caption = "The limits, m1 = 1 and |v0| = 1. 1/e^2: an end of compression multiplies a stiffness by that"
    limits = Table(("limit", "title", "contrast", "regime", "closed form"), rows, caption, text=5)
    return Section("Method, limits and provenance", [limits, *said], folded=True)


def _reached(group: Group) -> str:
    """Say at how many points the verdict of a group is reached."""
    return f"{group.counts[group.verdict]} of {group.points}"


def _span(values: Iterable[float], digits: str = "") -> str:
    """Write the least and the largest of some numbers, in few digits or as a format says."""
    values = list(values) or [math.nan]
    low, high = (format(end, digits) if digits else short(end, 2) for end in (min(values), max(values)))
    return low if low == high else f"{low} to {high}"
