"""How far the outcomes of one collision lie from one another, and what they keep; all dimensionless."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from impact_xval.compliant_baselines.solver import MappingName
from impact_xval.experiments.config.experiment import REFERENCE
from impact_xval.experiments.measures.divergence import velocity_divergence
from impact_xval.experiments.measures.laws import exact_for
from impact_xval.model.collision import RESULT_STATUSES, Collision, Outcome


@dataclass(frozen=True, slots=True)
class Measures:
    """Of the outcome of one solver; None where there is nothing to measure.

    Attributes
    ----------
    velocity_divergence : float or None
        D of N balls from the model's outcome, sqrt(sum m_i dv_i^2 / sum m_i v_i0^2).
    limit_distance : float or None
        Of an engine's limit dt -> 0 from the exact solver of the law it was asked for, the largest difference of a
        velocity per speed of impact; None with the naive mapping, whose contacts are not those asked for.
    limit_error : float or None
        The error of that limit as the engine's runs estimate it, likewise.
    retained_energy, retained_momentum : float or None
        Kinetic energy and momentum after the collision over those before it.
    """

    velocity_divergence: float | None = None
    limit_distance: float | None = None
    limit_error: float | None = None
    retained_energy: float | None = None
    retained_momentum: float | None = None


def measures_of(
    column: Collision, outcomes: Mapping[str, Outcome], mapping: MappingName = "calibrated"
) -> dict[str, Measures]:
    """Measure the outcomes of a column by several solvers; nothing of those without a result.

    Parameters
    ----------
    column : Collision
    outcomes : mapping of str to Outcome
        By solver.
    mapping : str
        That engines were given.
    """
    results = {name: each for name, each in outcomes.items() if each.status in RESULT_STATUSES}
    model, speed = results.get(REFERENCE), max(map(abs, column.velocities))
    measured = dict.fromkeys(outcomes, Measures())
    for name, outcome in results.items():
        exact = results.get(exact_for(name, mapping))
        limit, error = _limit(outcome), outcome.diagnostics.get("limit_error")
        distance = None
        if exact is not None and limit is not None:
            distance = largest_difference(limit, exact.velocities) / speed
        measured[name] = Measures(
            None if model is None else velocity_divergence(column, model, outcome),
            distance,
            None if error is None else error / speed,
            outcome.retained_energy(column),
            outcome.retained_momentum(column),
        )
    return measured


def largest_difference(some: Sequence[float], others: Sequence[float]) -> float:
    """Largest difference of a velocity, in their unit."""
    return max(abs(a - b) for a, b in zip(some, others, strict=True))


def _limit(outcome: Outcome) -> list[float] | None:
    """Velocities in the limit dt -> 0, in m/s; None from a solver that states none."""
    names = [f"v{i}_limit" for i in range(1, 1 + len(outcome.velocities))]
    stated = [outcome.diagnostics[name] for name in names if name in outcome.diagnostics]
    return stated if len(stated) == len(names) else None
