"""The page's words on why: the relative motion, the limits it leads to, and whose doing that is."""

from __future__ import annotations

import math

from impact_xval.experiments.hypothesis import hard_contact, ringing
from impact_xval.experiments.hypothesis.cases import BY_KEY, CASES, Case
from impact_xval.experiments.hypothesis.mechanism import POINTS
from impact_xval.experiments.hypothesis.run import Results
from impact_xval.experiments.hypothesis.tables import (
    class_frame,
    group_points,
    said,
    short,
)
from impact_xval.experiments.hypothesis.verdicts import CaseResult
from impact_xval.experiments.hypothesis.words import (
    FROZEN,
    MODEL,
    OTHER_LAW,
    motion_at,
    of_case,
    per_law,
    said_of,
    span,
    verdict_of,
)
from impact_xval.experiments.measures.aggregates import Frame
from impact_xval.experiments.measures.laws import voters
from impact_xval.experiments.tables.numbers import listed, number, percent
from impact_xval.model import Collision, solve


def why(results: Results) -> list[str]:
    """Say what the trajectories show."""
    texts = []
    for case in ("zero-early", "zero-late"):
        high, low = motion_at(results, case), motion_at(results, case, highest=False)
        model = high.pop(MODEL, None)
        first = low.pop(MODEL, None)
        high.pop(OTHER_LAW, None)
        point = POINTS[case]
        where = f"m2/m1 = {number(point.mass_ratio)}, e1 = {point.e1:g}, e2 = {point.e2:g}"
        text = f"{BY_KEY[case].title} ({where}). "
        if model and first and model.largest_rate > 0:
            rate = -math.log(model.largest_rate / first.largest_rate) / math.log(
                model.contrast / first.contrast
            )
            text += (
                "The model lets a contact return as soon as its bodies approach. At the instant of equal "
                f"velocities the separation its own velocities imply is {short(model.gap_then, 2)} of the "
                "largest compression of the table contact, but there are no positions for it to appear in; "
                "the contact acts again at once, and from then on the relative speed is at most "
                f"{short(model.largest_rate, 2)} |v0| at a contrast of {short(model.contrast)} and falls "
                f"with it at the rate {rate:.2f}. "
            )
        apart = [m for m in high.values() if m.opens]
        if apart and len(apart) == len(high):
            change = [
                abs(m.largest_rate / low[m.solver].largest_rate - 1)
                for m in apart
                if low[m.solver].largest_rate > 0
            ]
            text += (
                f"By all {len(voters(m.solver for m in apart))} laws that act in time the balls are "
                f"{span([m.gap_then for m in apart])} of that compression apart at that instant, which is "
                "that of the largest gap: equal velocities are where a gap stops growing. They meet again "
                f"{span([m.again_after for m in apart])} half periods of the table contact later, at "
                f"{span([m.again_speed for m in apart])} |v0|, and part by their restitution. None of this "
                "shrinks with the contrast: the largest relative speed changes by at most "
                f"{percent(max(change))} from the lowest to the highest contrast followed."
            )
        elif high:
            laws = voters(high)
            parting = [name for name in laws if high[name].opens]
            text += f"By {len(parting)} of the {len(laws)} laws that act in time the balls part and collide again."
        texts.append(text)
    if (
        verdict_of(results, "bistiffness", "zero-late") == "refuted"
        and verdict_of(results, MODEL, "zero-late") == "supported"
    ):
        both = (
            f"in {case} {said_of(results, 'bistiffness', case)} by bistiffness and {said_of(results, MODEL, case)} by "
            "the model"
            for case in ("zero-early", "zero-late")
        )
        texts.append(
            "The bistiffness reference obeys the model's own impact law and differs from the model in "
            "nothing but that a contact returns when its gap has closed. The hypothesis is "
            f"{'; '.join(both)}. What makes the stiff pair one body where the model supports it is the frozen "
            "positions of the model, not the stiffness."
        )
    high, low = motion_at(results, "infinity"), motion_at(results, "infinity", highest=False)
    if high:
        laws = voters(high)
        closed = [name for name in laws if not high[name].opens]
        rates = [
            -math.log(m.largest_rate / low[name].largest_rate) / math.log(m.contrast / low[name].contrast)
            for name, m in high.items()
            if m.largest_rate > 0 and m.contrast > low[name].contrast
        ]
        text = (
            "Towards k2/k1 → infinity the stiff pair is B2 and the table, at rest from the start, and "
            f"contact 1 loads it gradually. By {len(closed)} of {len(laws)} laws it does not open before "
            f"the end; the largest speed of B2 is {span([m.largest_rate for m in high.values()])} |v0| at "
            f"the highest contrast followed, and falls at rates of {span(rates)}."
        )
        if not any(m.opens for m in high.values()) and min(rates) > 0:
            text += (
                " No gap, no second collision: here the pair does act as one body, and what the laws "
                "differ in is the restitution of contact 1 against it."
            )
        texts.append(text)
    high, low = (
        motion_at(results, "plastic-ball-ball"),
        motion_at(results, "plastic-ball-ball", highest=False),
    )
    if MODEL in high and "kelvin-voigt" in high:
        dash, law = high["kelvin-voigt"], high[MODEL]
        texts.append(
            "In the plastic limits the difference is when the pair becomes one. Under the impact law it is "
            "at the end of a whole compression: at e1 → 0 the ball-ball contact is then compressed by "
            f"{short(-law.gap_then, 2)} of the table contact's largest compression, at any contrast. A "
            "dashpot resists from the first touch: with kelvin-voigt that compression is "
            f"{short(-low['kelvin-voigt'].gap_then, 2)} at a contrast of "
            f"{short(low['kelvin-voigt'].contrast)} and {short(-dash.gap_then, 2)} at "
            f"{short(dash.contrast)}, on its way to none. The energy that the law stores and then loses is "
            "never stored."
        )
    return texts


def instead(results: Results) -> list[str]:
    """Say where the solvers go that refute the hypothesis."""
    frame: Frame = class_frame(results)
    frame = frame[(frame["class"] == "all") & frame.missed_prediction_largest.notna()]
    exact = [r.solver for r in results.verdicts if r.kind == "exact"]
    texts = [
        "In real time contacts act in sequence when one is much stiffer. From that alone, and from what "
        "restitution each law shows, the limits follow without a simulation. For k2/k1 → 0 let v11 = (e1 "
        "m2 - 1)/(1 + m2) and v21 = -(1 + e1)/(1 + m2) (supplement, (11), (12); m1 = 1, |v0| = 1) and u = "
        "-e2 v21. If v11 ≥ 0, B2 leaves the table with u before it can reach B1; if u exceeds v11 they "
        "collide once more, and v1 = v11 + m2 (1 + e1) (u - v11)/(1 + m2), v2 = u - (1 + e1) (u - v11)/(1 "
        "+ m2): a sequence of three single impacts. If v11 is negative, B1 lands on B2 while the table "
        "contact is loaded; the limit is then a rigid ball-ball contact that opens and closes above the "
        "soft table contact, solved by its closed-form pieces, with the balls as one body once they are "
        f"pressed together at less than {short(hard_contact.TOGETHER, 1)} |v0|.",
        "For k2/k1 → infinity v1 is the restitution of contact 1 against m1 and v2 = 0. For e1 → 0 by a "
        "dashpot both balls move as one body of mass m1 + m2 and speed |v0|/(1 + m2) from the first touch "
        "and leave with the restitution of contact 2 against that mass; for e2 → 0 by a dashpot B2 never "
        "moves, as for k2/k1 → infinity. A linear dashpot of damping ratio zeta, mapped with the mass M "
        "and working against m, restores e(zeta sqrt(M/m)) (Schwager and Poeschel, Granular Matter 9:465, "
        "2007, for a contact that cannot pull).",
    ]
    kept: Frame = frame[frame.solver.isin(exact)]
    if len(kept):
        worst = kept.loc[kept.missed_prediction_largest.idxmax()]
        within = kept[kept.missed_prediction_largest < 1e-3]
        texts.append(
            f"Of {len(kept)} pairs of an exact solver and a limit that it refutes and for which there is a "
            f"prediction, the extrapolated limits of {len(within)} lie within 1e-3 of it at every point; "
            f"the largest difference, {short(worst.missed_prediction_largest, 2)}, is that of "
            f"{worst.solver} in {worst.case}, whose limits are extrapolated with errors of up to "
            f"{short(worst.limit_error_largest, 2)}."
        )
    engines: Frame = frame[~frame.solver.isin(exact)]
    for name in dict.fromkeys(engines.solver):
        rows = engines[engines.solver == name].itertuples()
        texts.append(
            f"{name} was asked for Kelvin-Voigt contacts. Where it refutes the hypothesis its extrapolated "
            "limits come as near as this to the prediction for them, at every refuted point: "
            + listed(
                f"{row.case} {short(row.missed_prediction_largest, 1)} ({row.n_refuted} of {row.points} points, "
                f"{percent(row.share_refuted)})"
                for row in rows
            )
            + "."
        )
    return texts


def mapping(results: Results) -> list[str]:
    """Tell what compliance does from what a mapping does."""
    texts = [
        "A refutation can be the doing of motion in time, or of a dashpot that does not restore the e it "
        "was asked for. The bistiffness reference tells them apart, since its restitution depends on "
        "neither mass nor speed."
    ]
    for case in CASES:
        refuted = {r.solver for r in of_case(results, case.key, "refuted")} - {OTHER_LAW}
        law = verdict_of(results, "bistiffness", case.key)
        linear = [n for n in results.solvers if n.startswith("kelvin-voigt")]
        if not law or not linear:
            continue
        if law == "refuted" and case.plastic:
            found = results.verdict("bistiffness", case.key)
            texts.append(f"{case.key}: {_returns(found) if found else ''} {_mapping_because(case)}")
        elif law == "refuted":
            texts.append(
                f"{case.key}: bistiffness refutes the hypothesis too ({_points(results, 'bistiffness', case)}), "
                + ("as do all mappings of a dashpot" if refuted >= set(linear) else "as do some mappings")
                + ": the gap is the cause, whatever the law."
            )
        elif refuted:
            found = [r for r in of_case(results, case.key, "refuted") if r.solver in refuted]
            good = [n for n in results.solvers if n not in refuted and n not in (*FROZEN, "bistiffness")]
            kept = [r for n in good if (r := results.verdict(n, case.key))]
            texts.append(
                f"{case.key}: by bistiffness the hypothesis is {said_of(results, 'bistiffness', case.key)}; the "
                "refutations are those of "
                + per_law(found, lambda r: group_points(r.whole))
                + (f", whereas it is not refuted by {per_law(kept, lambda r: said(r.whole))}" if kept else "")
                + f". {_mapping_because(case)}"
            )
    return texts


def _points(results: Results, solver: str, case: Case) -> str:
    found = results.verdict(solver, case.key)
    return group_points(found.whole) if found else ""


def _returns(found: CaseResult) -> str:
    """Say at which points bistiffness refutes a plastic limit: those where a contact of the model returns."""
    counts: dict[str, tuple[int, int]] = dict.fromkeys(("refuted", "supported", "undecided"), (0, 0))
    for result in found.points:
        kappa, mu, e1, e2 = result.point.ratios(found.case, math.inf)
        states = solve(Collision.from_ratios(kappa, mu, e1, e2), stiffness_ratio_cutoff=math.inf).states
        n, returns = counts[result.judgement.verdict]
        counts[result.judgement.verdict] = (n + 1, returns + (states.count("S1") > 1))
    return (
        f"bistiffness refutes the hypothesis at {group_points(found.whole)}. In "
        f"the model a contact returns at {counts['refuted'][1]} of these, and at {counts['supported'][1]} "
        f"of the {counts['supported'][0]} at which it is supported. Where none returns, the two have the same "
        "motion."
    )


def _mapping_because(case: Case) -> str:
    match case.key:
        case "infinity":
            return (
                "Against a B2 that cannot give way contact 1 works against m1, so a dashpot mapped with "
                "the reduced mass of the pair restores more than e1; mapped with m1 it restores e1."
            )
        case "zero-apart":
            return (
                "Each contact acts alone here. The first impact is that of the free pair, whose reduced "
                "mass is the right one; m1 is not, the textbook's zeta belongs to a contact that may pull, "
                "and the restitution of Hunt and Crossley depends on the speed, which is |v0| in the first "
                "impact only."
            )
        case _:
            return (
                "An infinite dashpot joins its bodies at once, not after a compression: no mass mends that."
            )


def no_limit(results: Results) -> list[str]:
    """Say where the model has no limit, and why."""
    if not results.branches:
        return [
            "Not tested: the model is not among the solvers, or no point has e1 = 1 and a lossy table "
            "contact in zero-early."
        ]
    worst = max(abs(b.measured - b.predicted) / max(b.uncertainty, 1e-9) for b in results.branches)
    neither = max(b.elsewhere for b in results.branches)
    light = any(ringing.mean_more_ends(b.point.mass_ratio) > 1 for b in results.branches)
    found = results.verdict(MODEL, "zero-early")
    groups = [g for g in found.classes if g.name == "only e1 = 1"] if found else []
    counts = groups[0].counts if groups else {}
    texts = [
        "With e1 = 1 the united balls ring for ever: the stiff contact's relative speed vanishes as the "
        "root of the contrast, but so does its period. Where the table contact ends its compression, v2 "
        "rises through zero as tau + q sin(tau) does, with q = m1 F2(return)/(m2 F2(end)), and by the "
        "supplement's E22 and E2max q^2 = (3 - m2)/(m2 (1 + m2)) at m1 = 1. That exceeds 1 exactly where "
        "m2 < m1, that is in the whole regime: depending on the phase of the ringing v2 rises once, or "
        "rises, falls and rises again, more often the lighter B2 is. A further rise is a further end of "
        "compression, which costs the contact another factor e2^2 of its energy, whatever the contrast. The "
        "phase never settles, so the outcome accumulates at e2^(n-1) v for the n ends that occur, v being "
        "the closed form, and has no limit. With r = (sqrt(q^2 - 1) - arccos(1/q))/pi, n occurs in the "
        "share 1 - |n - 1 - r| of the phases, or never where that is negative: once or twice where r is "
        "below 1, which is where m2/m1 > 0.121 (q < 4.603), and always twice or more below that.",
        f"The fit says so without knowing it: {counts.get('undecided', 0)} of {sum(counts.values())} points "
        f"({percent(counts.get('undecided', 0) / max(1, sum(counts.values())))}) of that class are undecided because "
        f"they do not settle. Over {ringing.COUNT} contrasts from "
        f"{short(ringing.RANGE[0])} to {short(ringing.RANGE[1])}, drawn at random, the share of two ends "
        f"differs from that by at most {worst:.1f} times its 95 % half-width, and at most "
        f"{percent(neither)} of the outcomes lie at neither v nor e2 v"
        + (", where a B2 lighter than 0.121 m1 makes more than two ends." if light else "."),
    ]
    other = results.verdict(OTHER_LAW, "zero-early")
    if other:
        rate = f" at the rate {other.whole.rate:.2f}" if other.whole.verdict == "supported" else ""
        texts.append(
            f"The law of Liu, Zhao and Brogliato ({OTHER_LAW}) shares the model's frozen positions, but loses "
            "nothing more in a repeated compression. Under it the verdict on the same limit is: "
            f"{said(other.whole)}{rate}."
        )
    return texts
