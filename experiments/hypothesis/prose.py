"""The words of the page. Sentences are chosen by what the run found, and every number in them is the run's."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Sequence

import numpy as np

from experiments.findings import number, percent
from experiments.hypothesis import design, hard_contact, judging, ringing, subjects
from experiments.hypothesis.cases import BY_KEY, CASES, Case
from experiments.hypothesis.maps import LEVELS, share_within
from experiments.hypothesis.mechanism import POINTS, Mechanism
from experiments.hypothesis.run import Results
from experiments.hypothesis.tables import class_frame, short
from experiments.hypothesis.verdicts import REFUTING_SHARE, CaseResult

MODEL = "state-transition"


def listed(words: Iterable[str]) -> str:
    """Join words as a list in a sentence."""
    words = list(words)
    return " and ".join([", ".join(words[:-1]), words[-1]] if len(words) > 1 else words)


def span(values: Sequence[float], digits: int = 2) -> str:
    """Write the range of some numbers, or the one number."""
    low, high = short(min(values), digits), short(max(values), digits)
    return low if low == high else f"{low} to {high}"


def of_case(results: Results, case: str, verdict: str) -> list[CaseResult]:
    """Verdicts of one kind on a limit."""
    return [r for r in results.verdicts if r.case.key == case and r.whole.verdict == verdict]


def abstract(results: Results) -> str:
    """Say the whole in a paragraph."""
    n = results.config.points
    others = [name for name in results.solvers if name != MODEL]
    text = (
        "The supplement of Jia, Mason and Erdmann (Multiple Impacts: A State Transition Diagram Approach, IJRR 32(1), "
        "2013) rests its limiting cases on a hypothesis: if one of the two contacts is infinitely stiffer than the other, "
        "its two bodies act as one once they reach the same velocity, and the rest of the collision is a single impact "
        f"with the third body. We approached {len(CASES)} limits with {len(results.solvers)} solvers, at {n} collisions "
        "or more for each limit. "
    )
    model = {case.key: results.verdict(MODEL, case.key) for case in CASES}
    by = Counter(found.whole.verdict for found in model.values() if found)
    if by:
        text += f"In the model itself the hypothesis is supported in {by['supported']} of {sum(by.values())} limits"
        undecided = [f for f in model.values() if f and f.whole.verdict != "supported"]
        text += "".join(
            f", and {f.whole.verdict} in {f.case.key}, at the points with "
            f"{listed(g.name for g in f.classes if g.verdict == f.whole.verdict)}"
            for f in undecided
        )
        text += ". "
    held = [case.key for case in CASES if others and all(_verdict(results, o, case.key) == "supported" for o in others)]
    failed = [case.key for case in CASES if others and all(_verdict(results, o, case.key) == "refuted" for o in others)]
    if failed:
        text += f"Every solver that moves in time refutes it in {listed(failed)}. "
    if held:
        text += f"Every such solver supports it in {listed(held)}. "
    mixed = [case.key for case in CASES if case.key not in (*held, *failed)]
    if mixed and others:
        text += f"In {listed(mixed)} the answer depends on the law of the contact."
    return text


def _verdict(results: Results, solver: str, case: str) -> str:
    found = results.verdict(solver, case)
    return found.whole.verdict if found else ""


def question() -> list[str]:
    """Say what was asked, and of what."""
    return [
        "A ball B1 (mass m1) falls with speed |v0| onto a ball B2 (mass m2) that rests on a fixed table. Contact 1 is ball "
        "on ball (stiffness k1, restitution e1), contact 2 ball on table (k2, e2); there is no friction and no gravity. "
        "For each limit below the hypothesis gives the final velocities v1 and v2 in closed form. We ask of every solver "
        "whether its own final velocities go there as the contrast grows, at what rate, and, if not, where they go.",
        "The limits are: "
        + "; ".join(f"{case.key}: {case.title} ({case.regime}; {case.source})" for case in CASES)
        + ". The contrast is k1/k2 in the first three, k2/k1 in the fourth, and 1/e^2 in the plastic ones, because an "
        "end of compression multiplies the stiffness by that (supplement, 3.3). In the model its cut-off at large "
        "stiffness ratios is switched off: with it the closed form would be put in by hand.",
    ]


def by_limit(results: Results) -> list[str]:
    """Give a paragraph to each limit."""
    texts = []
    for case in CASES:
        parts = []
        supported = of_case(results, case.key, "supported")
        if supported:
            rates = [f"{r.solver} (rate {r.whole.rate:.2f}, points {span([r.whole.least_rate, r.whole.largest_rate])})" for r in supported]
            parts.append(f"supported by {listed(rates)}")
        refuted = of_case(results, case.key, "refuted")
        if refuted:
            named = []
            for r in refuted:
                except_for = [g.name for g in r.classes if g.verdict == "supported"]
                but = f", but supported for {listed(except_for)}" if except_for else ""
                off = span([r.whole.offset[0], r.whole.offset[2]])
                named.append(f"{r.solver} (off by {off}, at {r.whole.counts.get('refuted', 0)} of {len(r.points)} points{but})")
            parts.append(f"refuted by {listed(named)}")
        undecided = of_case(results, case.key, "undecided")
        if undecided:
            named = [f"{r.solver} ({listed(_open_classes(r))}: {r.whole.reason})" for r in undecided]
            parts.append(f"undecided for {listed(named)}")
        texts.append(f"{case.title} ({case.key}): {'; '.join(parts) or 'not tested'}.")
    return texts


def _open_classes(result: CaseResult) -> list[str]:
    return [g.name for g in result.classes if g.verdict == "undecided" and not g.agrees] or ["all"]


def _at(results: Results, case: str, *, highest: bool = True) -> dict[str, Mechanism]:
    """Mechanism of every solver in a limit at its highest (or lowest) contrast."""
    found: dict[str, Mechanism] = {}
    for m in sorted(results.mechanisms, key=lambda m: m.contrast if highest else -m.contrast):
        if m.case == case and m.joined:
            found[m.solver] = m
    return found


def why(results: Results) -> list[str]:
    """Say what the trajectories show."""
    texts = []
    for case in ("zero-early", "zero-late"):
        high, low = _at(results, case), _at(results, case, highest=False)
        model = high.pop(MODEL, None)
        first = low.pop(MODEL, None)
        point = POINTS[case]
        where = f"m2/m1 = {number(point.mass_ratio)}, e1 = {point.e1:g}, e2 = {point.e2:g}"
        text = f"{BY_KEY[case].title} ({where}). "
        if model and first and model.largest_rate > 0:
            rate = -math.log(model.largest_rate / first.largest_rate) / math.log(model.contrast / first.contrast)
            text += (
                "The model lets a contact return as soon as its bodies approach. At the instant of equal velocities the "
                f"separation its own velocities imply is {short(model.gap_then, 2)} of the largest compression of the table "
                "contact, but there are no positions for it to appear in; the contact acts again at once, and from then "
                f"on the relative speed is at most {short(model.largest_rate, 2)} |v0| at a contrast of "
                f"{short(model.contrast)} and falls with it at the rate {rate:.2f}. "
            )
        apart = [m for m in high.values() if m.opens]
        if apart and len(apart) == len(high):
            change = [abs(m.largest_rate / low[m.solver].largest_rate - 1) for m in apart if low[m.solver].largest_rate > 0]
            text += (
                f"In all {len(apart)} solvers that move in time the balls are {span([m.gap_then for m in apart])} of that "
                "compression apart at that instant, which is that of the largest gap: equal velocities are where a gap "
                f"stops growing. They meet again {span([m.again_after for m in apart])} half periods of the table contact "
                f"later, at {span([m.again_speed for m in apart])} |v0|, and part by their restitution. None of this "
                f"shrinks with the contrast: the largest relative speed changes by at most {percent(max(change))} from the "
                "lowest to the highest contrast followed."
            )
        elif high:
            text += f"Of the {len(high)} solvers that move in time, {len(apart)} part and collide again."
        texts.append(text)
    if _verdict(results, "bistiffness", "zero-late") == "refuted" and _verdict(results, MODEL, "zero-late") == "supported":
        texts.append(
            "The bistiffness reference obeys the model's own impact law and differs from the model in nothing but that a "
            "contact returns when its gap has closed. It refutes the hypothesis in these two regimes while the model "
            "supports it: what makes the stiff pair one body there is the frozen positions of the model, not the stiffness."
        )
    high, low = _at(results, "infinity"), _at(results, "infinity", highest=False)
    if high:
        closed = [m for m in high.values() if not m.opens]
        rates = [
            -math.log(m.largest_rate / low[name].largest_rate) / math.log(m.contrast / low[name].contrast)
            for name, m in high.items()
            if m.largest_rate > 0 and m.contrast > low[name].contrast
        ]
        texts.append(
            "Towards k2/k1 -> infinity the stiff pair is B2 and the table, at rest from the start, and contact 1 loads it "
            f"gradually. In {len(closed)} of {len(high)} solvers it does not open before the end; the largest speed of B2 is "
            f"{span([m.largest_rate for m in high.values()])} |v0| at the highest contrast followed, and falls at rates of "
            f"{span(rates)}. No gap, no second collision: here the pair does act as one body, and what the solvers "
            "disagree about is the restitution of contact 1 against it."
        )
    high, low = _at(results, "plastic-ball-ball"), _at(results, "plastic-ball-ball", highest=False)
    if MODEL in high and "kelvin-voigt" in high:
        dash, law = high["kelvin-voigt"], high[MODEL]
        texts.append(
            "In the plastic limits the difference is when the pair becomes one. Under the impact law it is at the end of a "
            f"whole compression: at e1 -> 0 the ball-ball contact is then compressed by {short(-law.gap_then, 2)} of the "
            "table contact's largest compression, at any contrast. A dashpot resists from the first touch: with "
            f"kelvin-voigt that compression is {short(-low['kelvin-voigt'].gap_then, 2)} at a contrast of "
            f"{short(low['kelvin-voigt'].contrast)} and {short(-dash.gap_then, 2)} at {short(dash.contrast)}, on its way to "
            "none. The energy that the law stores and then loses is never stored."
        )
    return texts


def instead(results: Results) -> list[str]:
    """Say where the solvers go that refute the hypothesis."""
    frame = class_frame(results)
    frame = frame[(frame["class"] == "all") & frame.missed_prediction_largest.notna()]
    exact = [r.solver for r in results.verdicts if r.kind == "exact"]
    texts = [
        "In real time contacts act in sequence when one is much stiffer. From that alone, and from what restitution each "
        "law shows, the limits follow without a simulation. For k2/k1 -> 0 let v11 = (e1 m2 - 1)/(1 + m2) and "
        "v21 = -(1 + e1)/(1 + m2) (supplement, (11), (12); m1 = 1, |v0| = 1) and u = -e2 v21. If v11 >= 0, B2 leaves the "
        "table with u before it can reach B1; if u > v11 they collide once more, and v1 = v11 + m2 (1 + e1) (u - v11)/"
        "(1 + m2), v2 = u - (1 + e1) (u - v11)/(1 + m2): a sequence of three single impacts. If v11 < 0, B1 lands on B2 "
        "while the table contact is loaded; the limit is then a rigid ball-ball contact that opens and closes above the "
        "soft table contact, solved by its closed-form pieces, with the balls as one body once they are pressed together "
        f"at less than {short(hard_contact.TOGETHER, 1)} |v0|.",
        "For k2/k1 -> infinity v1 is the restitution of contact 1 against m1 and v2 = 0. For e1 -> 0 by a dashpot both "
        "balls move as one body of mass m1 + m2 and speed |v0|/(1 + m2) from the first touch and leave with the "
        "restitution of contact 2 against that mass; for e2 -> 0 by a dashpot B2 never moves, as for k2/k1 -> infinity. A "
        "linear dashpot of damping ratio zeta, mapped with the mass M and working against m, restores e(zeta sqrt(M/m)) "
        "(Schwager and Poeschel, Granular Matter 9:465, 2007, for a contact that cannot pull).",
    ]
    kept = frame[frame.solver.isin(exact)]
    if len(kept):
        worst = kept.loc[kept.missed_prediction_largest.idxmax()]
        within = kept[kept.missed_prediction_largest < 1e-3]
        texts.append(
            f"Of {len(kept)} pairs of an exact solver and a limit that it refutes and for which there is a prediction, the "
            f"extrapolated limits of {len(within)} lie within 1e-3 of it at every point; the largest difference, "
            f"{short(worst.missed_prediction_largest, 2)}, is that of {worst.solver} in {worst.case}, whose limits are "
            f"extrapolated with errors of up to {short(worst.limit_error_largest, 2)}."
        )
    engines = frame[~frame.solver.isin(exact)]
    if len(engines):
        texts.append(
            "Of the engines, "
            + listed(f"{r.solver} in {r.case} comes within {short(r.missed_prediction_largest, 1)}" for r in engines.itertuples())
            + " of the prediction for Kelvin-Voigt contacts, at its refuted points."
        )
    return texts


def mapping(results: Results) -> list[str]:
    """Tell what compliance does from what a mapping does."""
    texts = [
        "A refutation can be the doing of motion in time, or of a dashpot that does not restore the e it was asked for. "
        "The bistiffness reference tells them apart, since its restitution depends on neither mass nor speed."
    ]
    for case in CASES:
        refuted = {r.solver for r in of_case(results, case.key, "refuted")}
        law = _verdict(results, "bistiffness", case.key)
        linear = [n for n in results.solvers if n.startswith("kelvin-voigt")]
        if not law or not linear:
            continue
        if law == "refuted":
            texts.append(
                f"{case.key}: bistiffness refutes the hypothesis too, "
                + ("as do all mappings of a dashpot: " if refuted >= set(linear) else "as do some mappings: ")
                + _bistiffness_because(results, case)
            )
        elif refuted:
            offs = {r.solver: r.whole.offset for r in of_case(results, case.key, "refuted")}
            good = [n for n in results.solvers if n not in refuted and n not in (MODEL, "bistiffness")]
            texts.append(
                f"{case.key}: bistiffness supports it; the refutations are those of "
                + listed(f"{n} (off by up to {short(o[2], 2)})" for n, o in offs.items())
                + (f", whereas {listed(good)} {'does' if len(good) == 1 else 'do'} not refute it" if good else "")
                + f". {_mapping_because(case)}"
            )
    return texts


def _bistiffness_because(results: Results, case: Case) -> str:
    if not case.plastic:
        return "the gap is the cause, whatever the law."
    found = results.verdict("bistiffness", case.key)
    counts = found.whole.counts if found else {}
    return (
        f"at {counts.get('refuted', 0)} of {len(found.points) if found else 0} points, those where the pair that is to stick "
        "meets the third body again over a gap."
    )


def _mapping_because(case: Case) -> str:
    match case.key:
        case "infinity":
            return (
                "Against a B2 that cannot give way contact 1 works against m1, so a dashpot mapped with the reduced mass of "
                "the pair restores more than e1; mapped with m1 it restores e1."
            )
        case "zero-apart":
            return (
                "Each contact acts alone here. The first impact is that of the free pair, whose reduced mass is the right "
                "one; m1 is not, the textbook's zeta belongs to a contact that may pull, and the restitution of Hunt and "
                "Crossley depends on the speed, which is |v0| in the first impact only."
            )
        case _:
            return "An infinite dashpot joins its bodies at once, not after a compression: no choice of mass mends that."


def no_limit(results: Results) -> list[str]:
    """Say where the model has no limit, and why."""
    if not results.branches:
        return ["Not tested: the model is not among the solvers, or no point has e1 = 1 and e2 < 1 in zero-early."]
    worst = max(abs(b.measured - b.predicted) / max(b.uncertainty, 1e-9) for b in results.branches)
    neither = max(b.elsewhere for b in results.branches)
    found = results.verdict(MODEL, "zero-early")
    groups = [g for g in found.classes if g.name == "e1 = 1, e2 < 1"] if found else []
    counts = groups[0].counts if groups else {}
    return [
        "With e1 = 1 the united balls ring for ever: the stiff contact's relative speed vanishes as the root of the "
        "contrast, but so does its period. Where the table contact ends its compression, v2 rises through zero as "
        "tau + q sin(tau) does, with q = m1 F2(return)/(m2 F2(end)), and by the supplement's E22 and E2max q^2 = "
        "(3 - m2)/(m2 (1 + m2)) at m1 = 1. That exceeds 1 exactly where m2 < m1, that is in the whole regime: depending on "
        "the phase of the ringing v2 rises once, or rises, falls and rises again. A second rise is a second end of "
        "compression, which costs the contact another factor e2^2 of its energy, whatever the contrast. The phase never "
        "settles, so the outcome accumulates at v and at e2 v, v being the closed form, and has no limit.",
        f"The fit says so without knowing it: {counts.get('undecided', 0)} of {sum(counts.values())} points of that class are "
        f"undecided because they do not settle. Over {ringing.COUNT} contrasts from {short(ringing.RANGE[0])} to "
        f"{short(ringing.RANGE[1])}, drawn at random, the share of second ends differs from (sqrt(q^2 - 1) - arccos(1/q))/pi by "
        f"at most {worst:.1f} times its 95 % half-width, and at most {percent(neither)} of the outcomes lie at neither value.",
    ]


def stiff_enough(results: Results) -> list[str]:
    """Say how far the hypothesis can be used at finite contrast."""
    e1, e2 = results.config.map.restitutions[0]
    config = results.config.map
    texts = [
        "The maps show, over k2/k1 and m2/m1, how far each solver ends from the closed form of the nearer limit. A user who "
        "would like to treat a stiff pair as one body can read off where that costs less than 1, 5 or 20 % of the kinetic "
        f"norm of the impact. At e1 = {e1:g}, e2 = {e2:g} the shares of the map within these bounds are, for the soft table "
        f"contact (k2/k1 from {short(config.stiffness_ratio[0])} to 1, m2/m1 from {short(config.mass_ratio[0])} to "
        f"{short(config.mass_ratio[1])}): "
        + "; ".join(_shares(results, name, e1, e2, soft_table=True) for name in results.solvers)
        + "; and for the soft ball-ball contact: "
        + "; ".join(_shares(results, name, e1, e2, soft_table=False) for name in results.solvers)
        + ". Engines have a smaller map, see the figure."
    ]
    return texts


def _shares(results: Results, name: str, e1: float, e2: float, *, soft_table: bool) -> str:
    found = next((m for m in results.maps if (m.solver, m.e1, m.e2) == (name, e1, e2)), None)
    if found is None:
        return f"{name} none"
    return f"{name} " + "/".join(f"{100 * share_within(found, level, soft_table=soft_table):.0f}" for level in LEVELS) + " %"


def sureness(results: Results) -> list[str]:
    """Say how robust the verdicts are."""
    groups = [(r, g) for r in results.verdicts for g in r.classes]
    moved = [f"{r.solver} in {r.case.key}, {g.name}: {g.verdict} to {g.shifted}" for r, g in groups if g.verdict != g.shifted]
    whole = [r for r in results.verdicts if r.whole.verdict != r.whole.shifted]
    again = [
        (r, results.redrawn[r.solver, r.case.key, "all"])
        for r in results.verdicts
        if (r.solver, r.case.key, "all") in results.redrawn
    ]
    changed = [f"{r.solver} in {r.case.key}: {r.whole.verdict} to {word}" for r, word in again if r.whole.verdict != word]
    texts = [
        f"Fits a decade earlier change {len(whole)} of {len(results.verdicts)} verdicts on a solver and a limit"
        + (f" ({listed(f'{r.solver} in {r.case.key}: {r.whole.verdict} to {r.whole.shifted}' for r in whole)})" if whole else "")
        + f", and {len(moved)} of {len(groups)} verdicts on a class of points"
        + (f" ({'; '.join(moved)})" if moved else "")
        + f". A design drawn with the seed {results.config.seed + 1} changes {len(changed)} of {len(again)} verdicts of the "
        "solvers without a step" + (f" ({'; '.join(changed)})" if changed else "") + "."
    ]
    for name, rows in results.control.items():
        away, own = rows[1], rows[2]
        known = np.isfinite(away) & np.isfinite(own)
        texts.append(
            f"{name}, extrapolated to no step, differs from the exact column of its own law (kelvin-voigt) by "
            f"{short(float(np.median(away[known])), 1)} in the median of {int(known.sum())} outcomes, by "
            f"{short(float(np.quantile(away[known], 0.95)), 1)} at the 95th percentile and by {short(float(away[known].max()), 1)} "
            f"at most; {percent(float(np.mean(away[known] <= 3 * own[known])))} lie within three of its own error estimates. It is "
            "a check of the engine, and no independent vote on the law."
        )
    grazing = sum(p.grazing for r in results.verdicts for p in r.points)
    total = sum(s.answers.v1.size for s in results.series)
    lost = Counter(
        (s.subject.name, str(status)) for s in results.series for status in s.answers.status if status not in ("ok", "limit")
    )
    texts.append(
        f"Of {total} outcomes {grazing} lie beside a grazing jump of the model and are left out of every fit"
        + (
            "; without a result are " + listed(f"{n} of {name} ({status})" for (name, status), n in lost.items())
            if lost
            else "; none is without a result"
        )
        + "."
    )
    if results.unavailable:
        texts.append("Not tested: " + "; ".join(f"{n} ({why})" for n, why in results.unavailable.items()) + ".")
    return texts


def method(results: Results) -> list[str]:
    """Say how it was done."""
    c = results.config
    return [
        f"Design. Each limit has {c.points} points drawn by a scrambled Sobol sequence (seed {c.seed}): m2/m1 from "
        f"{design.MASS_RATIO[0]:g} to {design.MASS_RATIO[1]:g}, logarithmically; inelastic e from {design.RESTITUTION[0]:g} to "
        f"{design.RESTITUTION[1]:g}; fixed shares of points with e1 = 1, e2 = 1 or both; in the plastic limits k2/k1 from "
        f"{design.STIFFNESS_RATIO[0]:g} to {design.STIFFNESS_RATIO[1]:g}. Points nearer than {design.MARGIN:g} |v0| to a border "
        "between regimes are not drawn.",
        f"Series. Solvers without a step are asked at {c.per_decade} contrasts a decade from {short(c.contrast[0])} to "
        f"{short(c.contrast[1])} (plastic: to {short(c.plastic_contrast[1])}), engines at {c.engine_per_decade} a decade from "
        f"{short(c.engine_contrast[0])} to {short(c.engine_contrast[1])} (plastic: {short(c.engine_plastic_contrast[0])} to "
        f"{short(c.engine_plastic_contrast[1])}). Engines run at steps of 1/{c.steps}, 1/{2 * c.steps} and 1/{4 * c.steps} of the "
        "period of the stiffer contact and are extrapolated to none by Richardson's table; the next term of that table is "
        f"their error, with at least {short(1e-5)} (MuJoCo {short(subjects.REGULARISATION['mujoco'])}, its smallest impedance).",
        f"Verdicts. The rate is the Theil-Sen slope of ln D over ln contrast in the last {c.fit_decades:g} decades "
        f"({c.engine_fit_decades:g} for engines) above {judging.FLOOR_ERRORS:g} errors of the solver, with its 95 % interval. "
        "The limit is that of v = L + A x^-s by least squares. A point refutes the hypothesis if its series settles, L lies "
        "further from the closed form than three of its errors and a fifth of the last distances, and nothing in the last "
        f"decade comes nearer than half of that; it supports it if the interval of the rate lies above {judging.LEAST_RATE:g} "
        "and the series settles without a jump; else it is undecided. A class of points (by which contacts are elastic) is "
        f"refuted by {percent(REFUTING_SHARE)} of its points; supported by half of them if every other agrees with the closed "
        "form within its error; else undecided. Over the classes of a limit the worst counts. Rates of a class are the "
        "median over its supported points, with a bootstrap interval.",
    ]


def limits(results: Results) -> list[str]:
    """Say what it does not show."""
    return [
        "One dimension, no friction, no gravity, two contacts. Linear springs: a Hertzian stiffness would change the rates. "
        "Fits over finite contrasts cannot exclude a limit that sets in beyond them; limits are stated with the error of "
        "their extrapolation. Verdicts hold for points away from the borders between regimes, where the closed forms meet.",
        "Where the running stiffness ratio of the model leaves double precision (beyond 1e30, after many ends of compression) "
        "its closed form takes over even with the cut-off off; the energy this drops is part of the error that every "
        "outcome of the model carries here. MuJoCo, PyBullet and Drake, in so far as they are tested, were given the same "
        "springs and dashpots: they test one law, not three.",
    ]
