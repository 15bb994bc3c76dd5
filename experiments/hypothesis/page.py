"""The page of a run and the folder it is in: the facts that its template is given, and everything that is written."""

from __future__ import annotations

import math
import platform
from collections import Counter
from collections.abc import Iterable, Mapping
from importlib.metadata import version
from itertools import pairwise
from pathlib import Path
from typing import Any

import pandas as pd
from rich.console import Console
from rich.table import Table
from rich.text import Text

from impact_xval.compliant_baselines.registry import engine_free_names, kind_of
from impact_xval.experiments.hypothesis import (
    cases,
    columns,
    judging,
    mechanism,
    predictions,
    solvers,
    verdicts,
)
from impact_xval.experiments.hypothesis.cases import BY_KEY, CASES, LOSSY, plastic_outcome
from impact_xval.experiments.hypothesis.columns import ColumnResult, missed
from impact_xval.experiments.hypothesis.figures import map_name, write_figures
from impact_xval.experiments.hypothesis.mechanism import POINTS, Mechanism
from impact_xval.experiments.hypothesis.run import DRAWN, DRAWN_CONTRAST, Results
from impact_xval.experiments.hypothesis.tables import (
    class_frame,
    column_class_frame,
    column_outcome_frame,
    mechanism_frame,
    need_frame,
    outcome_frame,
    point_frame,
)
from impact_xval.experiments.hypothesis.verdicts import CaseResult, Group
from impact_xval.experiments.measures.laws import voters
from impact_xval.experiments.presentation.page.html import html_of
from impact_xval.experiments.presentation.pages import latex_of, phrase, render
from impact_xval.experiments.presentation.terminal import print_line
from impact_xval.experiments.sweep.pool import available_cores
from impact_xval.experiments.tables.folder import write_json, write_text
from impact_xval.experiments.tables.parquet import replacing
from impact_xval.model.collision import RESULT_STATUSES

#: The template of what is printed of verdicts.
WORDS = "hypothesis_words.md.j2"

PAGE, TITLE = "hypothesis.md", "impact-xval: does an infinitely stiff pair act as one body?"

MODEL, LAW_IN_TIME = "state-transition", "bistiffness"

#: Another impact law in the frame of the model.
OTHER_LAW = "liu-zhao-brogliato"

#: Solvers under the fixed-configuration assumption: the model, however it is solved, and the other law.
FROZEN = tuple(name for name in engine_free_names() if kind_of(name) == "model")

#: A verdict, and the one that another fit or another design gives.
Move = tuple[CaseResult, Group, Group | None]


def write_all(results: Results, root: Path, seconds: float) -> Path:
    """Write everything into a folder; give the path of the page."""
    versions = {"impact-xval": version("impact-xval"), "Python": platform.python_version()}
    versions |= {name: results.versions[name] for name in results.solvers if name != MODEL}
    needed, classes = need_frame(results), class_frame(results)
    texts = {"verdicts": classes, "points": point_frame(results), "mechanism": mechanism_frame(results)}
    texts["columns"] = column_class_frame(results)
    for name, frame in (texts | {"contrast-needed": needed}).items():
        with replacing(root / f"{name}.csv") as temporary:
            frame.to_csv(temporary, index=False, lineterminator="\n")
    tables = {
        "outcomes": outcome_frame(results),
        "maps": results.maps,
        "columns": column_outcome_frame(results),
    }
    for name, frame in tables.items():
        with replacing(root / f"{name}.parquet") as temporary:
            frame.to_parquet(temporary, index=False, compression="zstd")
    page = build_page(results, write_figures(results, root / "figures"), versions, classes, needed)
    blocks = page.split("\n\n")
    tables = [f"{caption}\n\n{table}" for caption, table in pairwise(blocks) if table.startswith("|")]
    markdown = "\n\n".join(["# Hypothesis: tables", *tables]) + "\n"
    write_text(root / "tables.md", markdown)
    write_text(root / "tables.tex", latex_of(markdown, details=True))
    write_text(root / PAGE, page)
    write_text(root / "report.html", html_of(page, TITLE, root))
    write_json(
        root / "manifest.json",
        {
            "format": "impact-xval hypothesis, format 1",
            "configuration": results.config.model_dump(mode="json"),
            "versions": versions,
            "unavailable": results.unavailable,
            "machine": {
                "system": platform.system(),
                "processor": platform.processor() or platform.machine(),
                "cores": available_cores(),
            },
            "seconds": {
                name: round(value, 1) for name, value in (results.seconds | {"total": seconds}).items()
            },
        },
    )
    return root / PAGE


def build_page(
    results: Results,
    figures: Iterable[str],
    versions: Mapping[str, str],
    classes: pd.DataFrame,
    needed: pd.DataFrame,
) -> str:
    """Write the page as Markdown, from the names of the figures and the frames of the verdicts and of the contrasts."""
    e1, e2 = results.config.map.restitutions[0]
    shown = needed[(needed.e1 == e1) & (needed.e2 == e2) & needed.mass_ratio.isin([0.5, 1.0, 5.0])]
    lossy = classes[classes["class"].isin(LOSSY) & (classes.verdict == "supported")]
    facts = {
        **summary(results),
        **_why(results),
        **_instead(classes, results),
        **_sureness(results),
        **_columns(results),
        "mapping": _mapping(results),
        "no_limit": _no_limit(results) if results.branches else None,
        "verdicts": results.verdicts,
        "by_case": {
            case.key: {found.solver: found for found in results.verdicts if found.case == case}
            for case in CASES
        },
        "lossy": lossy.groupby(["case", "n_supported", "points"], sort=False).solver.agg(list).to_dict(),
        "rule": verdicts,
        "judging": judging,
        "design": cases,
        "together": predictions.TOGETHER,
        "least_error": solvers.LEAST_ERROR,
        "drawn": {key: POINTS[key] for key in DRAWN},
        "drawn_contrast": DRAWN_CONTRAST,
        "e1": e1,
        "e2": e2,
        "needed": list(shown.itertuples()),
        "maps": {map_name(*pair): pair for pair in results.mapped},
        "unavailable": results.unavailable,
        "costly": list(dict.fromkeys(s.solver.name for s in results.series if s.solver.costly)),
    }
    numbered = {name: {"number": i} for i, name in enumerate(figures, start=1)}
    return render("hypothesis.md.j2", facts=facts, figures=numbered, versions=versions)


def summary(results: Results) -> dict[str, Any]:
    """Facts of the abstract: verdicts of the model, and those that all laws that act in time share."""
    others = voters(name for name in results.solvers if name not in FROZEN)
    agreed: dict[str, dict[str, list[float]]] = {"refuted": {}, "supported": {}}
    mixed = []
    for case in CASES:
        found = [one.whole for one in results.verdicts if one.case == case and one.solver in others]
        same = {group.verdict for group in found}
        if len(same) == 1 and "undecided" not in same:
            agreed[same.pop()][case.key] = [group.share for group in found]
        elif others:
            mixed.append(case.key)
    return {
        "config": results.config,
        "cases": CASES,
        "solvers": results.solvers,
        "laws": len(voters(results.solvers)),
        "model": [found for found in results.verdicts if found.solver == MODEL],
        "agreed": agreed,
        "mixed": mixed,
        "branches": results.branches,
    }


def _followed(results: Results, case: str, *, joined: bool = True) -> dict[str, tuple[Mechanism, Mechanism]]:
    """Mechanism of every solver in a limit at its lowest and its highest contrast, of those that join the pair."""
    found: dict[str, list[Mechanism]] = {}
    for one in results.mechanisms:  # of a solver by rising contrast
        if one.case == case and (one.joined or not joined):
            found.setdefault(one.solver, []).append(one)
    return {name: (each[0], each[-1]) for name, each in found.items()}


def _why(results: Results) -> dict[str, Any]:
    at_rest, plastic = _followed(results, "infinity"), _followed(results, "plastic-ball-ball")
    united = ("zero-early", "zero-late")
    pairs = [(results.verdict(LAW_IN_TIME, case), results.verdict(MODEL, case)) for case in united]
    law, model = pairs[1]
    decides = law and model and (law.whole.verdict, model.whole.verdict) == ("refuted", "supported")
    rates = [high.rate_since(low) for low, high in at_rest.values()]
    return {
        "parting": [_parting(results, case) for case in united],
        "frozen_decides": pairs if decides else [],
        "at_rest": _high(at_rest) | {"rates": [rate for rate in rates if not math.isnan(rate)]},
        "plastic": plastic if {MODEL, "kelvin-voigt"} <= plastic.keys() else None,
        "motions": [
            ends
            for key in POINTS
            if key != "zero-apart"
            for ends in _followed(results, key, joined=False).values()
        ],
    }


def _high(followed: Mapping[str, tuple[Mechanism, Mechanism]]) -> dict[str, Any]:
    """Mechanisms at the highest contrast: of every solver, and of one solver a law."""
    return {
        "high": [high for _, high in followed.values()],
        "laws": [followed[name][1] for name in voters(followed)],
    }


def _parting(results: Results, case: str) -> dict[str, Any]:
    """Facts of the motion of the balls in one limit of k2/k1 -> 0."""
    followed = _followed(results, case)
    model = followed.pop(MODEL, None)
    followed.pop(OTHER_LAW, None)
    changes = [abs(b.largest_rate / a.largest_rate - 1) for a, b in followed.values() if a.largest_rate > 0]
    return {
        "case": BY_KEY[case],
        "point": POINTS[case],
        "model": model if model and model[1].largest_rate > 0 else None,
        "change": max(changes, default=math.nan),
        **_high(followed),
    }


def _instead(classes: pd.DataFrame, results: Results) -> dict[str, Any]:
    rows: list[Any] = list(classes[(classes["class"] == "all") & (classes.n_refuted > 0)].itertuples())
    predicted = [row for row in rows if not math.isnan(row.missed_prediction_largest)]
    exact = {result.solver for result in results.verdicts if result.kind == "exact"}
    engines = dict.fromkeys(row.solver for row in predicted if row.solver not in exact)
    return {
        "refuted_rows": rows,
        "predicted": [row for row in predicted if row.solver in exact],
        "engine_predictions": {name: [row for row in predicted if row.solver == name] for name in engines},
    }


def _mapping(results: Results) -> list[dict[str, Any]]:
    """Tell by bistiffness the refutations of motion in time from those of a mapping, limit by limit."""
    found = []
    linear = {name for name in results.solvers if name.startswith("kelvin-voigt")}
    for case in CASES:
        law = results.verdict(LAW_IN_TIME, case.key)
        of_case = [v for v in results.verdicts if v.case == case and v.solver != OTHER_LAW]
        refuted = [v for v in of_case if v.whole.verdict == "refuted"]
        others = [v for v in of_case if v not in refuted and v.solver not in (*FROZEN, LAW_IN_TIME)]
        if not law or not linear or not refuted:
            continue
        found.append(
            {
                "case": case,
                "law": law,
                "returns": _returns(law) if case.plastic else None,
                "all_dashpots": {v.solver for v in refuted} >= linear,
                "refuted": refuted,
                "others": others,
            }
        )
    return found


def _returns(found: CaseResult) -> Counter[str]:
    """Count by verdict the points of a plastic limit at which a contact of the model returns."""
    counts: Counter[str] = Counter()
    for result in found.whole.members:
        states = plastic_outcome(found.case, result.point).states
        counts[result.judgement.verdict] += states.count("S1") > 1
    return counts


def _no_limit(results: Results) -> dict[str, Any]:
    found, branches = results.verdict(MODEL, "zero-early"), results.branches
    classes = {group.name: group for group in found.classes} if found else {}
    return {
        "group": classes.get("only e1 = 1"),
        "count": mechanism.COUNT,
        "range": mechanism.RANGE,
        "worst": max(abs(b.measured - b.predicted) / max(b.uncertainty, 1e-9) for b in branches),
        "neither": max(b.elsewhere for b in branches),
        "light": any(b.more_ends for b in branches),
        "drawn": max(branches, key=lambda b: b.measured),
        "other_law": results.verdict(OTHER_LAW, "zero-early"),
    }


def _columns(results: Results) -> dict[str, Any]:
    """Facts on columns: verdicts by place, and what each solver does with pairs that do not meet at first."""
    names = list(dict.fromkeys(one.solver for one in results.columns))
    by_place: dict[Any, dict[str, ColumnResult]] = {}
    for one in results.columns:
        by_place.setdefault(one.place, {})[one.solver] = one
    return {
        "column_solvers": names,
        "column_drawn": columns,
        "column_places": by_place,
        "column_together": {name: _pooled(results, name, meets=False) for name in names},
        "column_meeting": {name: _pooled(results, name, meets=True) for name in names},
    }


def _pooled(results: Results, solver: str, *, meets: bool) -> dict[str, Any]:
    """Verdicts of a solver over all places at which the pair meets at first, or does not."""
    wholes = [r.whole for r in results.columns if r.solver == solver and r.place.meets == meets]
    counts: Counter[str] = Counter()
    for group in wholes:
        counts.update(group.counts)
    return {
        "counts": counts,
        "points": counts.total(),
        "rates": [rate for group in wholes for rate in group.rates],
        "offsets": [offset for group in wholes for offset in group.offsets],
        "missed": [one for group in wholes for one in missed(group)],
        "elastic_refuted": sum(
            group.counts["refuted"]
            for r in results.columns
            if r.solver == solver and r.place.meets == meets
            for group in r.classes
            if group.name == "elastic"
        ),
    }


def _sureness(results: Results) -> dict[str, Any]:
    """Facts on what another fit and another design change, on the engines' control, and on what is left out."""
    counted = voters(results.solvers)
    mine = [r for r in results.verdicts if r.solver in counted]
    others = [r for r in results.verdicts if r.solver not in counted]
    lost = Counter(
        (s.solver.name, status)
        for s in results.series
        for status in s.outcomes.status
        if status not in RESULT_STATUSES
    )
    return {
        "moved": {
            "verdicts": _moved((r, r.whole, r.whole.shifted) for r in mine),
            "classes": _moved((r, g, g.shifted) for r in mine for g in r.classes),
            "others": _moved((r, r.whole, r.whole.shifted) for r in others),
        },
        "control": results.control,
        "outcomes": sum(len(s.outcomes) for s in results.series),
        "grazing": sum(p.grazing for r in results.verdicts for p in r.whole.members),
        "lost": lost,
    }


def _moved(compared: Iterable[Move]) -> dict[str, Any]:
    """Which verdicts another fit changes, of how many that it gives."""
    found = [(result, group, other) for result, group, other in compared if other]
    return {"changed": [one for one in found if one[1].verdict != one[2].verdict], "of": len(found)}


def show_verdicts(console: Console, results: Results) -> None:
    """Print the verdicts, one row a limit and solver, grouped by law."""
    shown = Table("limit", "law", "solver", "verdict", box=None, pad_edge=False)
    for found in results.verdicts:
        verdict = phrase(WORDS, "verdict", found)
        shown.add_row(*map(Text, (found.case.key, found.law, found.solver, verdict)))
    print_line(console, "")
    console.print(shown)
    print_line(console, "")
    print_line(console, phrase("table.md.j2", "laws_with_laws"))
    print_line(console, phrase(WORDS, "abstract", summary(results)))
