"""The page's words on how far it can be used, how sure it is, how it was done, and what it does not show."""

from __future__ import annotations

from collections import Counter

import numpy as np

from impact_xval.experiments.hypothesis import design, judging, subjects
from impact_xval.experiments.hypothesis.maps import LEVELS, share_within
from impact_xval.experiments.hypothesis.run import Results
from impact_xval.experiments.hypothesis.tables import said, short
from impact_xval.experiments.hypothesis.verdicts import REFUTING_SHARE, CaseResult
from impact_xval.experiments.measures.laws import voters
from impact_xval.experiments.tables.numbers import listed, percent
from impact_xval.model.collision import RESULT_STATUSES


def stiff_enough(results: Results) -> list[str]:
    """Say how far the hypothesis can be used at finite contrast."""
    e1, e2 = results.config.map.restitutions[0]
    config = results.config.map
    texts = [
        "The maps show, over k2/k1 and m2/m1, how far each solver ends from the closed form of the nearer "
        "limit. A user who would like to treat a stiff pair as one body can read off where that costs less "
        f"than 1, 5 or 20 % of the kinetic norm of the impact. At e1 = {e1:g}, e2 = {e2:g} the shares of "
        "the map within these bounds are, for the soft table contact (k2/k1 from "
        f"{short(config.stiffness_ratio[0])} to 1, m2/m1 from {short(config.mass_ratio[0])} to "
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
    return (
        f"{name} "
        + "/".join(f"{100 * share_within(found, level, soft_table=soft_table):.0f}" for level in LEVELS)
        + " %"
    )


def sureness(results: Results) -> list[str]:
    """Say how robust the verdicts are."""
    counted = voters(results.solvers)
    shiftable = [r for r in results.verdicts if r.shiftable and r.solver in counted]
    groups = [(r, g) for r in shiftable for g in r.classes]
    moved = [
        f"{r.solver} in {r.case.key}, {g.name}: {said(g)} to {said(g, shifted=True)}"
        for r, g in groups
        if g.verdict != g.shifted
    ]
    whole = [r for r in shiftable if r.whole.verdict != r.whole.shifted]
    others = [r for r in results.verdicts if r.shiftable and r.solver not in counted]
    others_moved = [r for r in others if r.whole.verdict != r.whole.shifted]
    again = [
        (r, results.redrawn[r.solver, r.case.key, "all"])
        for r in results.verdicts
        if (r.solver, r.case.key, "all") in results.redrawn
    ]
    changed = [
        f"{r.solver} in {r.case.key}: {said(r.whole)} to {said(group)}"
        for r, group in again
        if r.whole.verdict != group.verdict
    ]
    texts = [
        f"Fits a decade earlier change {len(whole)} of {len(shiftable)} verdicts on a law and a limit"
        + (f" ({'; '.join(map(_moved, whole))})" if whole else "")
        + f", and {len(moved)} of {len(groups)} verdicts on a class of points"
        + (f" ({'; '.join(moved)})" if moved else "")
        + (
            f"; of {len(others)} verdicts on further solvers that were asked for a law counted already, "
            f"{len(others_moved)}" + (f" ({'; '.join(map(_moved, others_moved))})" if others_moved else "")
            if others
            else ""
        )
        + f". A design drawn with the seed {results.config.seed + 1} changes {len(changed)} of {len(again)} "
        "verdicts of the solvers without a step" + (f" ({'; '.join(changed)})" if changed else "") + "."
    ]
    for name, rows in results.control.items():
        away, own = rows[1], rows[2]
        known = np.isfinite(away) & np.isfinite(own)
        texts.append(
            f"{name}, extrapolated to no step, differs from the exact column of its own law (kelvin-voigt) "
            f"by {short(float(np.median(away[known])), 1)} in the median of {int(known.sum())} outcomes, by "
            f"{short(float(np.quantile(away[known], 0.95)), 1)} at the 95th percentile and by "
            f"{short(float(away[known].max()), 1)} at most; "
            f"{percent(float(np.mean(away[known] <= 3 * own[known])))} lie within three of its own error "
            "estimates. It is a check of the engine, and no independent vote on the law."
        )
    grazing = sum(p.grazing for r in results.verdicts for p in r.points)
    total = sum(s.answers.v1.size for s in results.series)
    lost = Counter(
        (s.subject.name, str(status))
        for s in results.series
        for status in s.answers.status
        if status not in RESULT_STATUSES
    )
    texts.append(
        f"Of {total} outcomes {grazing} lie beside a grazing jump of the model and are left out of every fit"
        + (
            "; without a result are "
            + listed(f"{n} of {name} ({status})" for (name, status), n in lost.items())
            if lost
            else "; none is without a result"
        )
        + "."
    )
    if results.unavailable:
        texts.append(
            "Not tested: " + "; ".join(f"{n} ({why})" for n, why in results.unavailable.items()) + "."
        )
    return texts


def _moved(result: CaseResult) -> str:
    return f"{result.solver} in {result.case.key}: {said(result.whole)} to {said(result.whole, shifted=True)}"


def _costly(results: Results) -> str:
    """Say which engines had less."""
    named = list(dict.fromkeys(s.subject.name for s in results.series if s.subject.costly))
    if not named:
        return ""
    return (
        f" {listed(named)}, whose steps cost ten times as much, had a third of the steps, a decade less of "
        "contrast, and one coarser map."
    )


def method(results: Results) -> list[str]:
    """Say how it was done."""
    c = results.config
    return [
        f"Design. Each limit has {c.points} points drawn by a scrambled Sobol sequence (seed {c.seed}): "
        f"m2/m1 from {design.MASS_RATIO[0]:g} to {design.MASS_RATIO[1]:g}, logarithmically; inelastic e "
        f"from {design.RESTITUTION[0]:g} to {design.RESTITUTION[1]:g}; fixed shares of points with e1 = 1, "
        f"e2 = 1 or both; in the plastic limits k2/k1 from {design.STIFFNESS_RATIO[0]:g} to "
        f"{design.STIFFNESS_RATIO[1]:g}. Points nearer than {design.MARGIN:g} |v0| to a border between "
        "regimes are not drawn.",
        f"Series. Solvers without a step are asked at {c.per_decade} contrasts a decade from "
        f"{short(c.contrast[0])} to {short(c.contrast[1])} (plastic: to {short(c.plastic_contrast[1])}), "
        f"engines at {c.engine_per_decade} a decade from {short(c.engine_contrast[0])} to "
        f"{short(c.engine_contrast[1])} (plastic: {short(c.engine_plastic_contrast[0])} to "
        f"{short(c.engine_plastic_contrast[1])}). Engines run at steps of 1/{c.steps}, 1/{2 * c.steps} and "
        f"1/{4 * c.steps} of the period of the stiffer contact and are extrapolated to none by Richardson's "
        f"table; the next term of that table is their error, with at least {short(subjects.LEAST_ERROR)}."
        + _costly(results),
        f"Verdicts. The rate is the Theil-Sen slope of ln D over ln contrast in the last {c.fit_decades:g} "
        f"decades ({c.engine_fit_decades:g} for engines) above {judging.FLOOR_ERRORS:g} errors of the "
        "solver, with its 95 % interval. The limit is that of v = L + A x^-s by least squares. A point "
        "refutes the hypothesis if its series settles, L lies further from the closed form than three of "
        "its errors and a fifth of the last distances, and nothing in the last decade comes nearer than "
        f"half of that; it supports it if the interval of the rate lies above {judging.LEAST_RATE:g}, the "
        f"distance falls by {judging.LEAST_FALL:g} from the first to the last decade of the fit, and the "
        "series settles without a jump; else it is undecided. A class of points (by which contacts are "
        f"elastic) is refuted by {percent(REFUTING_SHARE)} of its points; supported by half of them if "
        "every other agrees with the closed form within its error; else undecided. So a refuted class is one in "
        "which the limit does not hold everywhere; at how many points it fails, and by how much, is said beside "
        "every verdict. Over the classes of a "
        "limit the worst counts. Rates of a class are the median over its supported points, with a "
        "bootstrap interval.",
    ]


def limits(results: Results) -> list[str]:
    """Say what it does not show."""
    return [
        "One dimension, no friction, no gravity, two contacts. Linear springs: a Hertzian stiffness would "
        "change the rates. Fits over finite contrasts cannot exclude a limit that sets in beyond them; "
        "limits are stated with the error of their extrapolation. Verdicts hold for points away from the "
        "borders between regimes, where the closed forms meet.",
        "Where the running stiffness ratio of the model leaves double precision (beyond 1e30, after many "
        "ends of compression) its closed form takes over even with the cut-off off; the energy this drops "
        "is part of the error that every outcome of the model carries here. MuJoCo, PyBullet and Drake, in "
        "so far as they are tested, were given the same springs and dashpots: they test one law, not three.",
    ]
