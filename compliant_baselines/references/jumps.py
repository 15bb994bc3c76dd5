"""How near a collision is to a jump of the outcome of its exact law, found by changing its parameters a little.

The outcome of a law in time is a function of k2/k1, m2/m1, e1, e2 and, in a drop, of gravity. It has jumps:

* bistiffness, where an end of compression nearly does not happen: it loses (1 - e^2) of an energy, or does not;
* any law in a drop, where the first flight nearly does not happen, or a ball that has left comes down again just before
  the other one is at rest. Without gravity a law of forces alone has none: its motion is continuous in all of them, and
  so is what is left when its balls part; but it may be as steep, and is marked then too.

Next to one an engine cannot be held to the exact outcome, since all that a finite step does moves it across. A cell is
*marked* where a relative change of one parameter, either way, moves a velocity per abs(v0) by more than `JUMPS` says;
smooth outcomes move by less than three times the change over the default box (`benchmarks/limits.py jumps`). The mark
says which parameter and how far. A limit dt -> 0 is marked too where gravity ended in a first flight at its shortest
step and does not under the exact law, or the other way round: by what gravity does in one contact of the balls, 1e-3
|v0| or so, the two are then different collisions. So it is where B2 comes to rest on the table at that step, and leaves
it under the exact law, or the other way round.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from math import isfinite

import numpy as np
from numpy.typing import NDArray

from impact_xval.compliant_baselines.contract.solver import Settings
from impact_xval.compliant_baselines.references.batch import ReferenceBatch
from impact_xval.model.collision import Collision, Outcome

Floats = NDArray[np.float64]

#: Relative changes of a parameter that are tried, and the change of a velocity per abs(v0) from which on it is a jump.
#: To a restitution an engine's finest step does more than a thousandth.
JUMPS = {1e-3: 0.01, 4e-3: 0.02}

#: What is changed, as arguments of a batch, and how a reader knows it.
CHANGED = ("k2/k1", "m2/m1", "e1", "e2", "gravity")

#: Position in `CHANGED` and relative change of every try.
TRIED = tuple((i, sign * size) for i in range(len(CHANGED)) for size in JUMPS for sign in (1, -1))


def jumps(
    batch: Callable[..., ReferenceBatch], *cells: Floats
) -> tuple[Floats, NDArray[np.intp], ReferenceBatch]:
    r"""Change every parameter a little and see how far the outcome moves.

    Parameters
    ----------
    batch : callable
        A law, such as `kelvin_voigt_batch`.
    *cells : five ndarray, shape (n,)
        k2/k1, m2/m1, e1, e2 and the gravity number.

    Returns
    -------
    excess : ndarray, shape (n,)
        The largest change of a velocity over what `JUMPS` says: above 1 it is a jump. Infinite if a change leaves no
        result, NaN where the cell itself has none.
    which : ndarray of int, shape (n,)
        Which of `TRIED` gives it.
    exact : ReferenceBatch
        The outcomes themselves.
    """
    base = batch(*cells)
    solved = ~np.isnan(base.v1)  # one that was given up may have taken a second, and would at every try
    excess = np.where(solved, 0.0, np.full((len(TRIED), base.v1.size), np.nan))
    there = [values[solved] for values in cells]
    for n, (i, change) in enumerate(TRIED):
        if not np.any(there[i]):
            continue  # no gravity, or no outcome
        others = list(there)
        most = 1.0 if CHANGED[i] in ("e1", "e2") else np.finfo(float).max
        with np.errstate(over="ignore"):
            others[i] = np.minimum(there[i] * (1 + change), most)
        other = batch(*others)
        away = np.maximum(abs(other.v1 - base.v1[solved]), abs(other.v2 - base.v2[solved]))
        excess[n, solved] = np.where(np.isnan(away), np.inf, away) / JUMPS[abs(change)]
    return excess.max(axis=0), np.argmax(excess, axis=0), base


def mark(
    outcomes: Sequence[Outcome],
    collisions: Sequence[Collision],
    settings: Settings,
    law: str,
    batch: Callable[..., ReferenceBatch],
    ends: Mapping[int, tuple[bool, bool]] | None = None,
) -> list[Outcome]:
    """Mark the outcomes that lie beside a jump of their exact law.

    Parameters
    ----------
    outcomes, collisions : sequence
        Of a solver that has the law or was asked for it.
    settings : Settings
        Under which they were solved.
    law : str
        Name of the law.
    batch : callable
        What solves it.
    ends : dict, optional
        Of outcomes by their position whether the run that decides on them had a first flight, and whether B2 came to
        rest on the table.
    """
    there = [i for i, outcome in enumerate(outcomes) if isfinite(outcome.v1)]
    marked = list(outcomes)
    if not settings.mark or not there:
        return marked
    some = [collisions[i] for i in there]
    gravity = settings.gravity if settings.scenario == "drop" else 0.0
    cells = np.array(
        [(c.stiffness_ratio, c.mass_ratio, c.e1, c.e2, c.gravity_number(gravity)) for c in some]
    ).T
    excess, which, exact = jumps(batch, *cells)
    exact_ends = (exact.fall < exact.duration).tolist(), np.isin(exact.end, ("rest", "stuck")).tolist()
    for i, over, tried, *end in zip(there, excess.tolist(), which.tolist(), *exact_ends, strict=True):
        if over > 1:
            parameter, change = TRIED[tried]
            far = over * JUMPS[abs(change)]
            says = f"a change of {change:g} in {CHANGED[parameter]} moves the exact outcome of {law} by {far:.2g} |v0|"
            marked[i] = replace(outcomes[i], marked=says)
        elif ends and gravity and (own := ends.get(i, (*end,))) != (*end,):
            which_end = 0 if own[0] != end[0] else 1
            one, other = (f"exact {law}", "the engine") if end[which_end] else ("the engine", f"exact {law}")
            says = (
                f"gravity ends in a first flight of {one}, and {other} has none",
                f"by {one} the lower ball comes to rest on the table, and by {other} it leaves",
            )
            marked[i] = replace(outcomes[i], marked=says[which_end])
    return marked
