"""The page's words on what was asked and found; chosen by what the run found, every number in them the run's."""

from __future__ import annotations

from impact_xval.experiments.hypothesis.cases import CASES
from impact_xval.experiments.hypothesis.run import Results
from impact_xval.experiments.hypothesis.tables import group_points
from impact_xval.experiments.hypothesis.verdicts import CaseResult
from impact_xval.experiments.hypothesis.words import (
    FROZEN,
    MODEL,
    of_case,
    per_law,
    shares,
    span,
)
from impact_xval.experiments.measures.laws import one_vote, voters
from impact_xval.experiments.tables.numbers import listed


def abstract(results: Results) -> str:
    """Say the whole in a paragraph."""
    n = results.config.points
    others = voters(name for name in results.solvers if name not in FROZEN)
    text = (
        "The supplement of Jia, Mason and Erdmann (Multiple Impacts: A State Transition Diagram Approach, "
        "IJRR 32(1), 2013) rests its limiting cases on a hypothesis: if one of the two contacts is "
        "infinitely stiffer than the other, its two bodies act as one once they reach the same velocity, "
        f"and the rest of the collision is a single impact with the third body. We approached {len(CASES)} "
        f"limits with {len(results.solvers)} solvers of {len(voters(results.solvers))} laws, at {n} collisions or "
        "more for each limit. "
    )
    if asked := one_vote(results.solvers):
        text += f"{asked} "
    tested = [found for found in results.verdicts if found.solver == MODEL]
    if tested:
        supported = [found for found in tested if found.whole.verdict == "supported"]
        text += f"In the model itself the hypothesis is supported in {len(supported)} of {len(tested)} limits"
        text += f" ({shares(supported)} of each)" if supported else ""
        undecided = [found for found in tested if found.whole.verdict != "supported"]
        text += "".join(
            f", and {f.whole.verdict} in {f.case.key} ({f.case.title}) at the points of class "
            + listed(f"'{g.name}' ({group_points(g)})" for g in f.classes if g.verdict == f.whole.verdict)
            + (
                ", where it has no limit: its outcome depends on the phase of the stiff contact's ringing "
                "for ever"
                if results.branches
                else ""
            )
            for f in undecided
        )
        text += ". "
    agreed: dict[str, dict[str, str]] = {"refuted": {}, "supported": {}}
    for case in CASES:
        found = [one for one in results.verdicts if one.case == case and one.solver in others]
        for verdict, limits in agreed.items():
            if found and all(one.whole.verdict == verdict for one in found):
                limits[case.key] = f"{case.key} ({shares(found)})"
    failed, held = agreed["refuted"], agreed["supported"]
    if failed:
        text += f"Every law that acts in time refutes it in {listed(failed.values())}: there it goes to another limit. "
    if held:
        text += f"Every law that acts in time supports it in {listed(held.values())}. "
    mixed = [case.key for case in CASES if case.key not in (*held, *failed)]
    if mixed and others:
        text += f"In {listed(mixed)} the laws do not all come to the same verdict."
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
            parts.append(f"supported by {per_law(supported, _supports)}")
        refuted = of_case(results, case.key, "refuted")
        if refuted:
            parts.append(f"refuted by {per_law(refuted, _refutes)}")
        undecided = of_case(results, case.key, "undecided")
        if undecided:
            parts.append(f"undecided for {per_law(undecided, _leaves_open)}")
        texts.append(f"{case.title} ({case.key}): {'; '.join(parts) or 'not tested'}.")
    return texts


def _supports(result: CaseResult) -> str:
    rates = span([result.whole.least_rate, result.whole.largest_rate])
    return f"rate {result.whole.rate:.2f}, {rates} over the points; {group_points(result.whole)}"


def _refutes(result: CaseResult) -> str:
    except_for = [f"{g.name} ({group_points(g)})" for g in result.classes if g.verdict == "supported"]
    but = f", but supported for {listed(except_for)}" if except_for else ""
    return group_points(result.whole) + but


def _leaves_open(result: CaseResult) -> str:
    classes = [g for g in result.classes if g.verdict == "undecided" and not g.agrees] or [result.whole]
    return f"{listed(f'{g.name}, {group_points(g)}' for g in classes)}: {result.whole.reason}"
