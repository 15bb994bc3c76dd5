"""What is written of a fit: tables, figures, the page in Markdown and in HTML, and what a terminal shows."""

from __future__ import annotations

import platform
import shutil
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from impact_xval.experiments.config.errors import UserError
from impact_xval.experiments.fit.engines import EngineAnswers, answers_of
from impact_xval.experiments.fit.evidence import PARTS, Evidence
from impact_xval.experiments.fit.figures import draw_fit
from impact_xval.experiments.fit.fitting import OUT, FitResult, Fitted
from impact_xval.experiments.fit.next_experiment import mass_ratios
from impact_xval.experiments.fit.trials import GRAVITY
from impact_xval.experiments.presentation.page.html import html_of
from impact_xval.experiments.presentation.pages import phrase, render
from impact_xval.experiments.presentation.style import save
from impact_xval.experiments.sweep.sandbox import exists
from impact_xval.experiments.tables.numbers import number, percent
from impact_xval.experiments.tables.store import write_json, write_text
from impact_xval.experiments.tables.streams import temporary_name

FORMAT = "impact-xval fit, format 1"
PAGE = "fit.html"

_WORDS = "fit_words.md.j2"
#: AIC above the least within which laws are said to be rivals.
_RIVAL = 4.0
#: Lines on rows that a terminal shows.
_LISTED = 10


def write_fit(root: Path, result: FitResult, source: str, seconds: float) -> dict[str, Any]:
    """Write all that was found into a folder, the page last, once all of it is written under another name.

    Parameters
    ----------
    root : Path
        An empty folder.
    result : FitResult
    source : str
        Where the data are from.
    seconds : float
        That the fit took.

    Returns
    -------
    dict
        What the templates show.
    """
    temporary = root / temporary_name("fit")
    try:
        facts = _write(temporary, result, source, seconds)
        for path in sorted(temporary.iterdir(), key=lambda path: path.name == PAGE):
            if (root / path.name).exists():
                raise UserError(f"--out {root}: {path.name} came there meanwhile; legal: a folder of its own")
            path.rename(root / path.name)
    finally:
        shutil.rmtree(temporary, ignore_errors=True)
        for path in root.glob(".tmp-*-fit"):
            process = path.name.split("-")[1]
            if process.isdigit() and not exists(int(process)):  # what a killed one left
                shutil.rmtree(path, ignore_errors=True)
    return facts


def _write(root: Path, result: FitResult, source: str, seconds: float) -> dict[str, Any]:
    figures = root / "figures"
    figures.mkdir(parents=True)
    captions = {}
    for name, figure, caption in draw_fit(result):
        save(figure, figures, name)
        captions[name] = caption
    facts = facts_of(result) | _page_facts(result, source, seconds) | {"figures": captions}
    for name, table in (
        ("parameters", result.parameters),
        ("predictions", result.predictions),
        ("evidence", result.evidence),
    ):
        table.to_csv(root / f"{name}.csv", index=False, lineterminator="\n")
    result.predictions.to_parquet(root / "predictions.parquet", index=False, compression="zstd")
    write_text(root / "fit.md", render("fit.md.j2", page=False, **facts))
    page = render("fit.md.j2", page=True, **facts)
    write_text(root / PAGE, html_of(page, "impact-xval: which law explains these data", figures))
    write_json(root / "fit.json", {"format": FORMAT, **dict(facts["provenance"])})
    return facts


def facts_of(result: FitResult) -> dict[str, Any]:
    """Collect what a terminal, a notebook and the page show."""
    t, best, weights = result.trials, result.best, result.weights
    evidence = best.evidence
    rivals = [each.law.name for each in result.fitted[1:] if each.evidence.aic <= evidence.aic + _RIVAL]
    return {
        "verdict_facts": (
            best.law.name,
            float(weights[0]),
            evidence.explains,
            evidence.probability,
            rivals if evidence.explains else [],
        ),
        "best": best.law.name,
        "n_trials": len(t.rows),
        "measured": t.measured,
        "evidence": [
            (
                each.law.name,
                *_evidence(each.evidence),
                percent(float(weight)),
                number(each.evidence.left_out, 4),
            )
            for each, weight in zip(result.fitted, weights, strict=True)
        ],
        "parameters": _parameters(best),
        "cannot": _cannot(best),
        "next": _next(result),
        "problems": list(t.problems),
        "left_out": t.left_out,
        "skipped": list(result.skipped.items()),
        "most": _LISTED,
    }


def _evidence(evidence: Evidence) -> tuple[str, ...]:
    values = (evidence.chi2, evidence.probability, evidence.aic, evidence.bic)
    return str(evidence.free), *(
        number(value, digits) for value, digits in zip(values, (4, 2, 5, 5), strict=True)
    )


def _power(parameter: str, value: float) -> float:
    return 10.0**value if parameter == "log_k" else value


def _called(parameter: str) -> str:
    return {"log_k": "k2/k1", "e": "e1 = e2"}.get(parameter, parameter)


def _parameters(each: Fitted) -> list[tuple[str, str, str]]:
    rows = []
    for at, name in enumerate(each.law.parameters):
        interval, value = each.interval(name), number(_power(name, float(each.best[at])), 4)
        if interval is not None:
            ends = (_power(name, interval.low), _power(name, interval.high))
            words = phrase(_WORDS, "interval_words", *ends, interval.open_low, interval.open_high)
        else:
            words = "-" if np.isnan(each.objective.fixed[at]) else "known"
        rows.append((_called(name), value, words))
    return rows


def _cannot(each: Fitted) -> list[str]:
    """Say which parameters the data leave open."""
    lines = []
    for interval in each.intervals:
        name = interval.parameter
        ends = (_power(name, interval.low), _power(name, interval.high))
        if interval.open_low or interval.open_high:
            lines.append(
                phrase(_WORDS, "cannot", _called(name), *ends, interval.open_low, interval.open_high)
            )
        if interval.pieces > 1:
            lines.append(phrase(_WORDS, "pieces", _called(name), interval.pieces))
    return lines


def _next(result: FitResult) -> list[str]:
    lines = []
    if result.apart:
        first = result.apart[0]
        lines.append(phrase(_WORDS, "next_apart", first.laws, first.mass_ratio, first.apart))
    if result.narrows is not None:
        lines.append(phrase(_WORDS, "next_stiffness", result.best.law.name, *result.narrows))
    return lines


def _page_facts(result: FitResult, source: str, seconds: float) -> dict[str, Any]:
    """Collect what the page alone shows."""
    t, answers = result.trials, answers_of(result)
    rows = result.predictions[result.predictions.law == result.best.law.name]
    ratios = mass_ratios(t)
    return {
        "source": source,
        "n_groups": len(set(t.groups)),
        "parts": PARTS,
        "all_parameters": [(each.law.name, *row) for each in result.fitted for row in _parameters(each)],
        "out": OUT,
        "trials": [_trial(row) for row in rows.itertuples(index=False, name=None)],
        "apart": [
            (*each.laws, number(each.mass_ratio), number(each.apart)) for each in result.apart[:_LISTED]
        ],
        "tried": (float(ratios[0]), float(ratios[-1])),
        "engines": [
            (a.solver, a.version or "-", a.answered, number(a.chi2, 4), a.reason or "-") for a in answers
        ],
        "engines_law": answers[0].law if answers else "",
        "engine_header": ["trial", "v1 measured", "v2 measured"]
        + [f"v{i} {a.solver}" for a in answers for i in (1, 2)],
        "engine_rows": _engine_rows(result, answers),
        "ignored": list(t.ignored),
        "heights": t.heights,
        "gravity": GRAVITY,
        "provenance": [
            ("made by", "impact-xval fit"),
            ("data", source),
            ("impact-xval", version("impact-xval")),
            ("finished", datetime.now(UTC).isoformat(timespec="seconds")),
            ("seconds", round(seconds, 1)),
            ("engines", {a.solver: a.version for a in answers}),
            ("libraries", {name: version(name) for name in ("numpy", "scipy", "numba", "pandas")}),
            ("python", platform.python_version()),
        ],
    }


def _trial(row: tuple[Any, ...]) -> tuple[str, ...]:
    """Give a row of predictions without its law, its place and the standard errors."""
    _, _, name, group, ratio, v1, fitted1, _, residual1, v2, fitted2, _, residual2 = row
    numbers = (ratio, v1, fitted1, residual1, v2, fitted2, residual2)
    return name, group, *(number(value, 4) for value in numbers)


def _engine_rows(result: FitResult, answers: list[EngineAnswers]) -> list[tuple[str, ...]]:
    t = result.trials
    measured = (np.where(np.isfinite(sd), v * t.speed, np.nan) for v, sd in ((t.v1, t.sd1), (t.v2, t.sd2)))
    columns = [*measured, *(v for a in answers for v in (a.v1, a.v2))]
    return [(name, *(number(float(column[at]), 4) for column in columns)) for at, name in enumerate(t.names)]
