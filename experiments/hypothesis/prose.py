"""The page's words on what was asked and found; chosen by what the run found, every number in them the run's."""

from __future__ import annotations

from collections import Counter

from experiments.hypothesis.cases import CASES
from experiments.hypothesis.run import Results
from experiments.hypothesis.verdicts import CaseResult
from experiments.hypothesis.words import FROZEN, MODEL, listed, of_case, span, verdict_of


def abstract(results: Results) -> str:
    """Say the whole in a paragraph."""
    n = results.config.points
    others = [name for name in results.solvers if name not in FROZEN]
    text = (
        "The supplement of Jia, Mason and Erdmann (Multiple Impacts: A State Transition Diagram Approach, "
        "IJRR 32(1), 2013) rests its limiting cases on a hypothesis: if one of the two contacts is "
        "infinitely stiffer than the other, its two bodies act as one once they reach the same velocity, "
        f"and the rest of the collision is a single impact with the third body. We approached {len(CASES)} "
        f"limits with {len(results.solvers)} solvers, at {n} collisions or more for each limit. "
    )
    model = {case.key: results.verdict(MODEL, case.key) for case in CASES}
    by = Counter(found.whole.verdict for found in model.values() if found)
    if by:
        text += f"In the model itself the hypothesis is supported in {by['supported']} of {sum(by.values())} limits"
        undecided = [f for f in model.values() if f and f.whole.verdict != "supported"]
        text += "".join(
            f", and {f.whole.verdict} in {f.case.key} ({f.case.title}) at the points of class "
            f"'{listed(g.name for g in f.classes if g.verdict == f.whole.verdict)}'"
            + (
                ", where it has no limit: its outcome depends on the phase of the stiff contact's ringing "
                "for ever"
                if results.branches
                else ""
            )
            for f in undecided
        )
        text += ". "
    held = [
        case.key
        for case in CASES
        if others and all(verdict_of(results, o, case.key) == "supported" for o in others)
    ]
    failed = [
        case.key
        for case in CASES
        if others and all(verdict_of(results, o, case.key) == "refuted" for o in others)
    ]
    if failed:
        text += f"Every solver that moves in time refutes it in {listed(failed)}: it goes to another limit. "
    if held:
        text += f"Every such solver supports it in {listed(held)}. "
    mixed = [case.key for case in CASES if case.key not in (*held, *failed)]
    if mixed and others:
        text += f"In {listed(mixed)} the answer depends on the law of the contact."
    return text


def question() -> list[str]:
    """Say what was asked, and of what."""
    return [
        "A ball B1 (mass m1) falls with speed |v0| onto a ball B2 (mass m2) that rests on a fixed table. "
        "Contact 1 is ball on ball (stiffness k1, restitution e1), contact 2 ball on table (k2, e2); there "
        "is no friction and no gravity. For each limit below the hypothesis gives the final velocities v1 "
        "and v2 in closed form. We ask of every solver whether its own final velocities go there as the "
        "contrast grows, at what rate, and, if not, where they go.",
        "Each limit is approached along one number, its contrast, that goes to infinity: the ratio of the "
        "stiffnesses, or, in the plastic limits, 1/e^2, because an end of compression multiplies the "
        "stiffness by that (supplement, 3.3). A rate r means that the distance from the closed form falls "
        "as the contrast to the -r. In the model its cut-off at large stiffness ratios is switched off: "
        "with it the closed form would be put in by hand.",
    ]


def by_limit(results: Results) -> list[str]:
    """Give a paragraph to each limit."""
    texts = []
    for case in CASES:
        parts = []
        supported = of_case(results, case.key, "supported")
        if supported:
            rates = [
                f"{r.solver} (rate {r.whole.rate:.2f}, points "
                f"{span([r.whole.least_rate, r.whole.largest_rate])})"
                for r in supported
            ]
            parts.append(f"supported by {listed(rates)}")
        refuted = of_case(results, case.key, "refuted")
        if refuted:
            named = []
            for r in refuted:
                except_for = [g.name for g in r.classes if g.verdict == "supported"]
                but = f", but supported for {listed(except_for)}" if except_for else ""
                off = span([r.whole.offset[0], r.whole.offset[2]])
                named.append(
                    f"{r.solver} (off by {off}, at {r.whole.counts.get('refuted', 0)} of {len(r.points)} "
                    f"points{but})"
                )
            parts.append(f"refuted by {listed(named)}")
        undecided = of_case(results, case.key, "undecided")
        if undecided:
            named = [f"{r.solver} ({listed(_open_classes(r))}: {r.whole.reason})" for r in undecided]
            parts.append(f"undecided for {listed(named)}")
        texts.append(f"{case.title} ({case.key}): {'; '.join(parts) or 'not tested'}.")
    return texts


def _open_classes(result: CaseResult) -> list[str]:
    return [g.name for g in result.classes if g.verdict == "undecided" and not g.agrees] or ["all"]
