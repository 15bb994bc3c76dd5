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

import numpy as np
import pandas as pd

from impact_xval.compliant_baselines import get_solver
from impact_xval.compliant_baselines.contract.registry import engine_free_names, kind_of
from impact_xval.experiments.hypothesis import cases, judging, mechanism, predictions, solvers, verdicts
from impact_xval.experiments.hypothesis.cases import BY_KEY, CASES, LOSSY
from impact_xval.experiments.hypothesis.figures import map_name, write_figures
from impact_xval.experiments.hypothesis.maps import LEVELS, share_within
from impact_xval.experiments.hypothesis.mechanism import POINTS, Mechanism
from impact_xval.experiments.hypothesis.run import DRAWN, DRAWN_CONTRAST, Results
from impact_xval.experiments.hypothesis.tables import (
    class_frame,
    map_frame,
    mechanism_frame,
    need_frame,
    outcome_frame,
    point_frame,
)
from impact_xval.experiments.hypothesis.verdicts import CaseResult, Group
from impact_xval.experiments.measures.laws import voters
from impact_xval.experiments.presentation.pages import html_of, latex_of, render
from impact_xval.experiments.sweep.executors import available_cores
from impact_xval.experiments.tables.store import write_json, write_text
from impact_xval.experiments.tables.streams import replacing
from impact_xval.model import Collision, solve
from impact_xval.model.collision import RESULT_STATUSES

PAGE, TITLE = "hypothesis.md", "impact-xval: does an infinitely stiff pair act as one body?"

MODEL, LAW_IN_TIME = "state-transition", "bistiffness"

#: Another impact law in the frame of the model.
OTHER_LAW = "liu-zhao-brogliato"

#: Solvers under the fixed-configuration assumption: the model, however it is solved, and the other law.
FROZEN = tuple(name for name in engine_free_names() if kind_of(name) == "model")

#: A verdict, and the one that another design gives (None: that of the fit a decade before).
Move = tuple[CaseResult, Group, Group | None]


def write_all(results: Results, root: Path, seconds: float) -> Path:
    """Write everything into a folder; give the path of the page."""
    versions = {"impact-xval": version("impact-xval"), "Python": platform.python_version()}
    versions |= {name: get_solver(name).version() for name in results.solvers if name != MODEL}
    needed, classes = need_frame(results), class_frame(results)
    texts = {"verdicts": classes, "points": point_frame(results), "mechanism": mechanism_frame(results)}
    for name, frame in (texts | {"contrast-needed": needed}).items():
        with replacing(root / f"{name}.csv") as temporary:
            frame.to_csv(temporary, index=False, lineterminator="\n")
    for name, frame in (("outcomes", outcome_frame(results)), ("maps", map_frame(results))):
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
    chosen = needed[(needed.e1 == e1) & (needed.e2 == e2) & needed.mass_ratio.isin([0.5, 1.0, 5.0])]
    facts = {
        **summary(results),
        **_why(results),
        **_instead(classes, results),
        **_sureness(results),
        "mapping": _mapping(results),
        "no_limit": _no_limit(results) if results.branches else None,
        "verdicts": results.verdicts,
        "lossy": _supported_lossy(results),
        "far": verdicts.FAR,
        "refuting_share": verdicts.REFUTING_SHARE,
        "judging": judging,
        "design": cases,
        "together": predictions.TOGETHER,
        "least_error": solvers.LEAST_ERROR,
        "drawn": {key: POINTS[key] for key in DRAWN},
        "drawn_contrast": DRAWN_CONTRAST,
        "e1": e1,
        "e2": e2,
        "needed": list(chosen.itertuples()),
        "shares": {name: _shares_within(results, name, e1, e2) for name in results.solvers},
        "maps": {map_name(*pair): pair for pair in results.mapped},
        "redrawn": results.redrawn,
        "unavailable": results.unavailable,
        "costly": list(dict.fromkeys(s.solver.name for s in results.series if s.solver.costly)),
    }
    numbered = {name: {"number": i} for i, name in enumerate(figures, start=1)}
    return render("hypothesis.md.j2", facts=facts, figures=numbered, versions=versions)


def summary(results: Results) -> dict[str, Any]:
    """Facts of the abstract: verdicts of the model, and those that all laws that act in time share."""
    others = voters(name for name in results.solvers if name not in FROZEN)
    agreed: dict[str, dict[str, tuple[float, float]]] = {"refuted": {}, "supported": {}, "undecided": {}}
    mixed = []
    for case in CASES:
        found = [one for one in results.verdicts if one.case == case and one.solver in others]
        same = {one.whole.verdict for one in found}
        if same == {"refuted"} or same == {"supported"}:
            agreed[same.pop()][case.key] = _range(one.whole.share for one in found)
        elif others:
            mixed.append(case.key)
    model = [found for found in results.verdicts if found.solver == MODEL]
    held = [found.whole.share for found in model if found.whole.verdict == "supported"]
    return {
        "config": results.config,
        "cases": CASES,
        "solvers": results.solvers,
        "laws": len(voters(results.solvers)),
        "model": model,
        "model_share": _range(held or [math.nan]),
        "agreed": agreed,
        "mixed": mixed,
        "branches": results.branches,
    }


def _range(values: Iterable[float]) -> tuple[float, float]:
    values = list(values)
    return min(values), max(values)


def _supported_lossy(results: Results) -> dict[tuple[str, int, int], list[str]]:
    """Solvers that are supported on the class drawn in the figure of the distance, by limit and points."""
    found: dict[tuple[str, int, int], list[str]] = {}
    for result in results.verdicts:
        for group in result.classes:
            if group.name in LOSSY and group.verdict == "supported":
                found.setdefault((result.case.key, group.counts["supported"], group.points), []).append(
                    result.solver
                )
    return found


def _followed(results: Results, case: str) -> dict[str, tuple[Mechanism, Mechanism]]:
    """Mechanism of every solver in a limit at its lowest and its highest contrast."""
    found: dict[str, list[Mechanism]] = {}
    for one in sorted(results.mechanisms, key=lambda m: m.contrast):
        if one.case == case and one.joined:
            found.setdefault(one.solver, []).append(one)
    return {name: (each[0], each[-1]) for name, each in found.items()}


def _why(results: Results) -> dict[str, Any]:
    at_rest, plastic = _followed(results, "infinity"), _followed(results, "plastic-ball-ball")
    closed = [name for name in voters(at_rest) if not at_rest[name][1].opens]
    rates = [rate for low, high in at_rest.values() if not math.isnan(rate := high.rate_since(low))]
    pairs = [
        (results.verdict(LAW_IN_TIME, case), results.verdict(MODEL, case))
        for case in ("zero-early", "zero-late")
    ]
    law, model = pairs[1]
    decides = law and model and (law.whole.verdict, model.whole.verdict) == ("refuted", "supported")
    return {
        "parting": [_parting(results, case) for case in ("zero-early", "zero-late")],
        "frozen_decides": pairs if decides else [],
        "at_rest": at_rest
        and {
            "closed": len(closed),
            "laws": len(voters(at_rest)),
            "speeds": [high.largest_rate for _, high in at_rest.values()],
            "rates": rates,
            "one_body": not any(high.opens for _, high in at_rest.values()) and min(rates, default=0.0) > 0,
        },
        "plastic": {
            "model": plastic[MODEL][1],
            "low": plastic["kelvin-voigt"][0],
            "high": plastic["kelvin-voigt"][1],
        }
        if MODEL in plastic and "kelvin-voigt" in plastic
        else None,
        "motions": _motions(results),
    }


def _parting(results: Results, case: str) -> dict[str, Any]:
    """Facts of the motion of the balls in one limit of k2/k1 -> 0."""
    followed = _followed(results, case)
    first, model = followed.pop(MODEL, (None, None))
    followed.pop(OTHER_LAW, None)
    laws = voters(followed)
    high = [high for _, high in followed.values()]
    changes = [abs(b.largest_rate / a.largest_rate - 1) for a, b in followed.values() if a.largest_rate > 0]
    return {
        "case": BY_KEY[case],
        "point": POINTS[case],
        "model": model if model and model.largest_rate > 0 else None,
        "rate": model.rate_since(first) if model and first else math.nan,
        "laws": len(laws),
        "parting": len([name for name in laws if followed[name][1].opens]),
        "all_part": bool(high) and all(m.opens for m in high),
        "gaps": [m.gap_then for m in high],
        "again": [m.again_after for m in high],
        "speeds": [m.again_speed for m in high],
        "change": max(changes, default=math.nan),
    }


def _motions(results: Results) -> list[tuple[Mechanism, float]]:
    """List by limit and solver the mechanism at the highest contrast followed, and the rate since the lowest."""
    rows = []
    for key in (key for key in POINTS if key != "zero-apart"):
        for name in results.solvers:
            found = [m for m in results.mechanisms if (m.case, m.solver) == (key, name)]
            if found:
                low, high = (pick(found, key=lambda m: m.contrast) for pick in (min, max))
                rows.append((high, high.rate_since(low)))
    return rows


def _instead(classes: pd.DataFrame, results: Results) -> dict[str, Any]:
    rows: list[Any] = list(classes[(classes["class"] == "all") & (classes.n_refuted > 0)].itertuples())
    predicted = [row for row in rows if not math.isnan(row.missed_prediction_largest)]
    exact = {result.solver for result in results.verdicts if result.kind == "exact"}
    kept = [row for row in predicted if row.solver in exact]
    engines = dict.fromkeys(row.solver for row in predicted if row.solver not in exact)
    return {
        "refuted_rows": rows,
        "engine_predictions": {name: [row for row in predicted if row.solver == name] for name in engines},
        "predicted": kept
        and {
            "pairs": len(kept),
            "within": len([row for row in kept if row.missed_prediction_largest < 1e-3]),
            "worst": max(kept, key=lambda row: row.missed_prediction_largest),
        },
    }


def _mapping(results: Results) -> list[dict[str, Any]]:
    """Tell by bistiffness the refutations of motion in time from those of a mapping, limit by limit."""
    found = []
    linear = {name for name in results.solvers if name.startswith("kelvin-voigt")}
    for case in CASES:
        law = results.verdict(LAW_IN_TIME, case.key)
        of_case = {v.solver: v for v in results.verdicts if v.case == case and v.solver != OTHER_LAW}
        refuted = [v for v in of_case.values() if v.whole.verdict == "refuted"]
        names = {v.solver for v in refuted}
        if not law or not linear or not refuted:
            continue
        others = [v for v in of_case.values() if v.solver not in (*names, *FROZEN, LAW_IN_TIME)]
        found.append(
            {
                "case": case,
                "law": law,
                "returns": _returns(law) if case.plastic else None,
                "all_dashpots": names >= linear,
                "refuted": refuted,
                "others": others,
            }
        )
    return found


def _returns(found: CaseResult) -> dict[str, tuple[int, int]]:
    """Count by verdict the points of a plastic limit, and those at which a contact of the model returns."""
    counts: dict[str, tuple[int, int]] = dict.fromkeys(("refuted", "supported", "undecided"), (0, 0))
    for result in found.points:
        kappa, mu, e1, e2 = result.point.ratios(found.case, math.inf)
        states = solve(Collision.from_ratios(kappa, mu, e1, e2), stiffness_ratio_cutoff=math.inf).states
        n, returns = counts[result.judgement.verdict]
        counts[result.judgement.verdict] = (n + 1, returns + (states.count("S1") > 1))
    return counts


def _no_limit(results: Results) -> dict[str, Any]:
    found = results.verdict(MODEL, "zero-early")
    counts = next((g.counts for g in found.classes if g.name == "only e1 = 1"), {}) if found else {}
    undecided, points = counts.get("undecided", 0), sum(counts.values())
    branches = results.branches
    return {
        "undecided": undecided,
        "points": points,
        "share": undecided / max(1, points),
        "count": mechanism.COUNT,
        "range": mechanism.RANGE,
        "worst": max(abs(b.measured - b.predicted) / max(b.uncertainty, 1e-9) for b in branches),
        "neither": max(b.elsewhere for b in branches),
        "light": any(mechanism.mean_more_ends(b.point.mass_ratio) > 1 for b in branches),
        "drawn": max(branches, key=lambda b: b.measured),
        "other_law": results.verdict(OTHER_LAW, "zero-early"),
    }


def _shares_within(results: Results, name: str, e1: float, e2: float) -> list[list[str]] | None:
    """Shares of a map within 1, 5 and 20 % in per cent, for a soft table and for a soft ball-ball contact."""
    found = next((m for m in results.maps if (m.solver, m.e1, m.e2) == (name, e1, e2)), None)
    return found and [
        [f"{100 * share_within(found, level, soft_table=soft):.0f}" for level in LEVELS]
        for soft in (True, False)
    ]


def _sureness(results: Results) -> dict[str, Any]:
    """Facts on what another fit and another design change, on the engines' control, and on what is left out."""
    counted = voters(results.solvers)
    shiftable = [r for r in results.verdicts if r.shiftable]
    mine = [r for r in shiftable if r.solver in counted]
    others = [r for r in shiftable if r.solver not in counted]
    groups: list[Move] = [(r, g, None) for r in mine for g in r.classes]
    again: list[Move] = [
        (r, r.whole, results.redrawn[key])
        for r in results.verdicts
        if (key := (r.solver, r.case.key, "all")) in results.redrawn
    ]

    def whole(chosen: list[CaseResult]) -> list[Move]:
        return [(r, r.whole, None) for r in chosen if r.whole.verdict != r.whole.shifted]

    lost = Counter(
        (s.solver.name, str(status))
        for s in results.series
        for status in s.outcomes.status
        if status not in RESULT_STATUSES
    )
    return {
        "moved": {
            "verdicts": whole(mine),
            "of_verdicts": len(mine),
            "classes": [move for move in groups if move[1].verdict != move[1].shifted],
            "of_classes": len(groups),
            "others": whole(others),
            "of_others": len(others),
            "redrawn": [move for move in again if move[2] and move[1].verdict != move[2].verdict],
            "of_redrawn": len(again),
        },
        "control": [_control(name, *rows[1:]) for name, rows in results.control.items()],
        "outcomes": sum(s.outcomes.v1.size for s in results.series),
        "grazing": sum(p.grazing for r in results.verdicts for p in r.points),
        "lost": lost,
    }


def _control(solver: str, away: np.ndarray, own: np.ndarray) -> dict[str, Any]:
    known = np.isfinite(away) & np.isfinite(own)
    D = away[known]
    return {
        "solver": solver,
        "outcomes": D.size,
        "median": float(np.median(D)),
        "most": float(np.quantile(D, 0.95)),
        "largest": float(D.max()),
        "within": float(np.mean(3 * own[known] >= D)),
    }
