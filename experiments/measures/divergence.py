"""How far one outcome lies from another: the measures, all dimensionless."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from impact_xval.experiments.measures.hausdorff import hausdorff
from impact_xval.experiments.tables.schema import MEASURES
from impact_xval.model.collision import RESULT_STATUSES, Collision, Outcome, Path
from impact_xval.model.kinetic import kinetic_norm


def divergence(
    collision: Collision, model: Outcome, other: Outcome, paths: tuple[Sequence[str], Sequence[str]]
) -> dict[str, Any]:
    """Compare a solver's outcome with the model's.

    Parameters
    ----------
    collision : Collision
        The collision both solved.
    model, other : Outcome
        Differences are other minus model.
    paths : tuple of two sequences of str
        State paths of the model and of the other, through one filter (`states`).

    Returns
    -------
    dict
        A value for every name in `schema.MEASURES`; all None where one of the two has no result, and
        ``curve_distance`` None where one of them carries no path.
    """
    if model.status not in RESULT_STATUSES or other.status not in RESULT_STATUSES:
        return dict.fromkeys(MEASURES)
    speed = abs(collision.v0)
    impulse = collision.m1 * speed
    dv1, dv2 = (other.v1 - model.v1) / speed, (other.v2 - model.v2) / speed
    return {
        "velocity_divergence": velocity_divergence(collision, model, other),
        "dv1": dv1,
        "dv2": dv2,
        "dimpulse1": (other.impulse1 - model.impulse1) / impulse,
        "dimpulse2": (other.impulse2 - model.impulse2) / impulse,
        "dretained_energy": other.retained_energy(collision) - model.retained_energy(collision),
        "states_equal": tuple(paths[0]) == tuple(paths[1]),
        "states_part_at": part_at(*paths),
        "states_edit_distance": edit_distance(*paths),
        "curve_distance": curve_distance(model.path, other.path, impulse),
    }


def velocity_divergence(collision: Collision, model: Outcome, other: Outcome) -> float | None:
    """D of two balls: the kinetic norm of the difference of final velocities, per abs(v0), dimensionless.

    None where one of the two has no result.
    """
    if model.status not in RESULT_STATUSES or other.status not in RESULT_STATUSES:
        return None
    speed = abs(collision.v0)
    dv1, dv2 = (other.v1 - model.v1) / speed, (other.v2 - model.v2) / speed
    return float(kinetic_norm(collision.mass_ratio, dv1, dv2))


def part_at(a: Sequence[str], b: Sequence[str]) -> int | None:
    """Position, from 1, of the first state in which two sequences differ; None if they are equal.

    Where one is the beginning of the other, it is the position after the shorter one's end.
    """
    for position, (x, y) in enumerate(zip(a, b, strict=False), start=1):
        if x != y:
            return position
    return None if len(a) == len(b) else min(len(a), len(b)) + 1


def edit_distance(a: Sequence[str], b: Sequence[str]) -> int:
    """Least number of insertions, deletions and substitutions that turn a into b (Levenshtein)."""
    row = list(range(len(b) + 1))
    for i, x in enumerate(a, start=1):
        diagonal, row[0] = row[0], i
        for j, y in enumerate(b, start=1):
            diagonal, row[j] = row[j], min(row[j] + 1, row[j - 1] + 1, diagonal + (x != y))
    return row[-1]


def curve_distance(a: Path | None, b: Path | None, impulse: float) -> float | None:
    """Symmetric Hausdorff distance of two impulse curves in the (I1, I2) plane.

    Parameters
    ----------
    a, b : Path or None
        None gives None.
    impulse : float
        Unit of the result, in N s.
    """
    if a is None or b is None:
        return None
    curves = [np.column_stack([curve.impulse1, curve.impulse2]) / impulse for curve in (a, b)]
    return hausdorff(curves[0], curves[1])
