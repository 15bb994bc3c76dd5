"""Words and numbers that the sections of the page share."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence

from impact_xval.compliant_baselines.contract.registry import engine_free_names, kind_of
from impact_xval.experiments.hypothesis.mechanism import Mechanism
from impact_xval.experiments.hypothesis.run import Results
from impact_xval.experiments.hypothesis.tables import said, short
from impact_xval.experiments.hypothesis.verdicts import CaseResult
from impact_xval.experiments.measures.laws import by_law
from impact_xval.experiments.tables.numbers import listed, percent

MODEL = "state-transition"

#: Another impact law in the frame of the model.
OTHER_LAW = "liu-zhao-brogliato"

#: Solvers whose positions are frozen: the model, however it is solved, and the other law.
FROZEN = tuple(name for name in engine_free_names() if kind_of(name) == "model")


def span(values: Sequence[float], digits: int = 2) -> str:
    """Write the range of some numbers, or the one number."""
    low, high = short(min(values), digits), short(max(values), digits)
    return low if low == high else f"{low} to {high}"


def shares(found: Iterable[CaseResult]) -> str:
    """Say at how many of their points solvers reach the verdict they share, on one limit or on several."""
    each = [one.whole.counts.get(one.whole.verdict, 0) / len(one.points) for one in found]
    low, high = percent(min(each)), percent(max(each))
    return f"at {low if low == high else f'{low} to {high}'} of the points"


def per_law(found: Sequence[CaseResult], say: Callable[[CaseResult], str]) -> str:
    """List solvers with what is to be said of each: a law at a time, those asked for the same law behind its first."""
    by_name = {one.solver: one for one in found}
    parts = []
    for first, *others in by_law(by_name).values():
        rest = listed(f"{name}, {say(by_name[name])}" for name in others)
        same = f"; asked for the same law: {rest}" if rest else ""
        parts.append(f"{first} ({say(by_name[first])}{same})")
    return listed(parts)


def of_case(results: Results, case: str, verdict: str) -> list[CaseResult]:
    """Verdicts of one kind on a limit."""
    return [r for r in results.verdicts if r.case.key == case and r.whole.verdict == verdict]


def said_of(results: Results, solver: str, case: str) -> str:
    """Verdict of a solver on a limit, with its points; empty if it was not tested."""
    found = results.verdict(solver, case)
    return said(found.whole) if found else ""


def verdict_of(results: Results, solver: str, case: str) -> str:
    """Verdict of a solver on a limit; empty if it was not tested."""
    found = results.verdict(solver, case)
    return found.whole.verdict if found else ""


def motion_at(results: Results, case: str, *, highest: bool = True) -> dict[str, Mechanism]:
    """Mechanism of every solver in a limit at its highest (or lowest) contrast."""
    found: dict[str, Mechanism] = {}
    for m in sorted(results.mechanisms, key=lambda m: m.contrast if highest else -m.contrast):
        if m.case == case and m.joined:
            found[m.solver] = m
    return found
