"""Outcomes of cells by one solver as arrays, and how far they lie from the model's: the measures, all dimensionless."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import zip_longest
from typing import Any

import numpy as np
from numpy.typing import NDArray

from impact_xval.compliant_baselines.registry import exact_solver_for
from impact_xval.compliant_baselines.states import comparable_states
from impact_xval.experiments.config.experiment import REFERENCE
from impact_xval.model.arrays import Floats
from impact_xval.model.collision import Collision
from impact_xval.model.collisions import Collisions
from impact_xval.model.kinetic import kinetic_norm
from impact_xval.model.outcome import Outcome
from impact_xval.model.outcomes import Outcomes
from impact_xval.model.path import Paths
from impact_xval.model.status import RESULT_STATUSES

Texts = NDArray[np.object_]

#: Diagnostics in m/s; tables and JSON state them per abs(v0).
_VELOCITY = re.compile(r"v\d+_limit|limit_error|velocity_error|regularisation|rest_speed")


@dataclass(frozen=True, slots=True, eq=False)
class Results:
    """Outcomes of n cells by one solver, of up to N balls; NaN where a cell has fewer, and where nothing is known."""

    velocities: Floats
    impulses: Floats
    status: Texts
    reason: Texts
    mark: Texts
    differences: Texts
    #: State sequences of two balls on a table, as the solver gives them and as they are compared; else empty.
    states: list[str]
    compared: list[str]
    n_states: NDArray[np.int64]
    n_events: NDArray[np.int64]
    margin: Floats
    #: Velocities per abs(v0), times in s.
    diagnostics: dict[str, Floats]
    #: Of two balls on a table.
    paths: Paths | None

    @property
    def there(self) -> NDArray[np.bool_]:
        """Where the numbers are a result."""
        return np.isin(self.status.astype(str), RESULT_STATUSES)

    def diagnostic(self, name: str) -> Floats:
        """Return a diagnostic; NaN where no outcome states it."""
        return self.diagnostics.get(name, np.full(len(self.status), np.nan))


def results_of(
    outcomes: Sequence[Outcome], speed: Floats, balls: int, contacts: int, shortest: Floats | None
) -> Results:
    """Make arrays of outcomes at speeds abs(v0) in m/s.

    Of two balls on a table `shortest` is the time for which a state must be held to count, in s (`states`); else None.
    """
    found = _of_arrays(outcomes, shortest) if isinstance(outcomes, Outcomes) else _of_list(outcomes)
    for name in ("status", "reason", "mark", "differences"):
        found[name] = np.array(found[name], dtype=object)
    for name, wide in (("velocities", balls), ("impulses", contacts)):
        found[name] = _padded(found[name], wide)
    found["diagnostics"] = {
        name: x / speed if _VELOCITY.fullmatch(name) else x for name, x in found["diagnostics"].items()
    }
    if shortest is None:
        return Results(**found | {"compared": [""] * len(speed), "paths": None})
    given = found["paths"]
    paths = given if isinstance(given, Paths) else Paths.of(given or [None] * len(speed), balls, contacts)
    # Without a path, on which alone the times are, states stay as they are.
    both = zip(comparable_states(paths, shortest), found["states"], strict=True)
    return Results(**found | {"compared": [text or own for text, own in both], "paths": paths})


def _of_arrays(outcomes: Outcomes, shortest: Floats | None) -> dict[str, Any]:
    named = shortest is not None and outcomes.states is not None
    return {
        "velocities": outcomes.velocities,
        "impulses": outcomes.impulses,
        "status": outcomes.statuses,
        "reason": outcomes.reasons,
        "mark": outcomes.marks,
        "differences": [""] * len(outcomes),
        "states": outcomes.states.texts() if named and outcomes.states else [""] * len(outcomes),
        "n_states": outcomes.n_states,
        "n_events": outcomes.n_events,
        "margin": outcomes.grazing_margin,
        "diagnostics": outcomes.diagnostics,
        "paths": outcomes.paths,
    }


def _of_list(outcomes: Sequence[Outcome]) -> dict[str, Any]:
    stated = dict.fromkeys(name for each in outcomes for name in each.diagnostics)
    alike = ("velocities", "impulses", "status", "reason", "differences")
    return {
        **{name: [getattr(each, name) for each in outcomes] for name in alike},
        "mark": [each.mark for each in outcomes],
        "states": [" ".join(each.states) for each in outcomes],
        "n_states": np.array([len(each.states) for each in outcomes], np.int64),
        "n_events": np.array([each.n_events for each in outcomes], np.int64),
        "margin": np.array([each.grazing_margin for each in outcomes], float),  # NaN for None
        "diagnostics": {
            name: np.array([each.diagnostics.get(name) for each in outcomes], float) for name in stated
        },
        "paths": [each.path for each in outcomes],
    }


def _padded(rows: Any, wide: int) -> Floats:
    """Numbers of each row, NaN where there are fewer."""
    if isinstance(rows, np.ndarray) and rows.shape[1] == wide:
        return rows
    found = np.full((len(rows), wide), np.nan)
    for row, values in zip(found, rows, strict=True):
        row[: len(values)] = values
    return found


def masses_and_starts(collisions: Sequence[Collision], balls: int) -> tuple[Floats, Floats]:
    """Masses in kg and velocities at first touch in m/s, shape (n, N), NaN where a cell has fewer balls."""
    if isinstance(collisions, Collisions):
        return _padded(collisions.masses, balls), _padded(collisions.velocities, balls)
    masses, velocities = ([getattr(c, name) for c in collisions] for name in ("masses", "velocities"))
    return _padded(masses, balls), _padded(velocities, balls)


def norms(masses: Floats, differences: Floats, starts: Floats) -> Floats:
    """D: kinetic norms, over balls, of differences of velocities over those of the velocities at first touch."""
    with np.errstate(over="ignore", invalid="ignore"):
        return kinetic_norm(masses, differences) / kinetic_norm(masses, starts)


def divergence(
    masses: Floats, starts: Floats, speed: Floats, model: Results, other: Results
) -> dict[str, Any]:
    """Compare a solver's results with the model's: by name every measure of `schema.MEASURES`, other minus model.

    NaN or None where one of the two has no result. Masses in kg and starts, velocities at first touch in m/s, are of
    shape (n, N); speed is abs(v0), of shape (n,).
    """
    both = model.there & other.there
    absent = ~both
    dv = np.where(both[:, None], other.velocities - model.velocities, np.nan)
    di = np.where(both[:, None], other.impulses - model.impulses, np.nan)
    found: dict[str, Any] = {
        "velocity_divergence": np.where(absent, np.nan, norms(masses, dv, starts)),
        **{f"dv{i}": x / speed for i, x in enumerate(dv.T, 1)},
        **{f"dimpulse{i}": x / (masses[:, 0] * speed) for i, x in enumerate(di.T, 1)},
        "largest_dv": np.max(np.abs(dv), axis=1, where=~np.isnan(dv), initial=0.0) / speed,
        "dretained_energy": retained_energy(masses, starts, other) - retained_energy(masses, starts, model),
    }
    found["largest_dv"][absent] = found["dretained_energy"][absent] = np.nan
    if model.paths is None or other.paths is None:
        return found
    pairs = list(zip(model.compared, other.compared, strict=True))
    sequences = {texts: [text.split() for text in texts] for texts in set(pairs)}
    known = {texts: (a == b, part_at(a, b), edit_distance(a, b)) for texts, (a, b) in sequences.items()}
    states = [known[texts] if there else (None,) * 3 for texts, there in zip(pairs, both, strict=True)]
    names = "states_equal", "states_differ_at", "states_edit_distance"

    def curves(paths: Paths) -> Floats:
        units = np.repeat(masses[:, 0] * speed, np.diff(paths.offsets))
        # Contiguous: for any other layout the kernel would be compiled once more.
        return np.ascontiguousarray(paths.impulses / units[:, None])

    # Here, for the import of numba takes longer than all else that one collision's D asks for.
    from impact_xval.experiments.measures.hausdorff import distances

    one, two = model.paths, other.paths
    apart = distances(curves(one), curves(two), one.offsets, two.offsets)
    found |= zip(names, np.array(states, dtype=object).reshape(-1, 3).T, strict=True)
    return found | {"impulse_curve_distance": np.where(both, apart, np.nan)}


def retained_energy(masses: Floats, starts: Floats, results: Results) -> Floats:
    """Kinetic energy after the collision over that before it, shape (n,)."""
    return norms(masses, results.velocities, starts) ** 2


def retained_momentum(masses: Floats, starts: Floats, results: Results) -> Floats:
    """Momentum after the collision over that before it, shape (n,), with its sign.

    It is 1 without a table, and negative where balls that fell leave a table upwards.
    """
    weights = masses / np.nanmax(masses, axis=1, keepdims=True)
    with np.errstate(all="ignore"):  # there may be no momentum before
        after, before = (np.nansum(weights * v, axis=1) for v in (results.velocities, starts))
        return np.where(np.isnan(results.velocities).all(axis=1), np.nan, after / before)


def part_at(a: Sequence[str], b: Sequence[str]) -> int | None:
    """Position, from 1, of the first state that only one of two sequences has there; None if they are equal."""
    pairs = enumerate(zip_longest(a, b), start=1)
    return next((position for position, (x, y) in pairs if x != y), None)


def edit_distance(a: Sequence[str], b: Sequence[str]) -> int:
    """Least number of insertions, deletions and substitutions that turn a into b (Levenshtein)."""
    row = list(range(len(b) + 1))
    for i, x in enumerate(a, start=1):
        diagonal, row[0] = row[0], i
        for j, y in enumerate(b, start=1):
            diagonal, row[j] = row[j], min(row[j] + 1, row[j - 1] + 1, diagonal + (x != y))
    return row[-1]


def measures_of(collision: Collision, outcomes: Mapping[str, Outcome]) -> dict[str, dict[str, float]]:
    """Measure the outcomes of one collision by several solvers: measures of `schema`, beside their scaled diagnostics.

    NaN where there is nothing to measure.
    """
    balls, contacts = len(collision.masses), len(collision.stiffnesses)
    masses, starts = masses_and_starts([collision], balls)
    speed, measured = np.abs(starts).max(axis=1), {}
    results = {name: results_of([each], speed, balls, contacts, None) for name, each in outcomes.items()}
    for name, found in results.items():
        model, exact = results.get(REFERENCE), results.get(exact_solver_for(name, "calibrated"))
        measures = {"retained_energy": retained_energy(masses, starts, found)}
        measures["retained_momentum"] = retained_momentum(masses, starts, found)
        if model is not None:
            measures |= divergence(masses, starts, speed, model, found)
        if exact is not None:
            limit = [found.diagnostic(f"v{i}_limit") for i in range(1, 1 + balls)]
            measures["limit_distance"] = np.abs(np.transpose(limit) - exact.velocities / speed).max(axis=1)
        known = {key: [np.nan] for key in ("velocity_divergence", "limit_distance", "limit_error")}
        measured[name] = {key: float(x[0]) for key, x in (known | found.diagnostics | measures).items()}
    return measured
