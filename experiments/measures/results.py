"""Outcomes of cells by one solver as arrays, whoever solved them: what rows are made of."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from impact_xval.compliant_baselines.states import compared_states
from impact_xval.model.collision import RESULT_STATUSES, Collision, Collisions, Outcome, Outcomes, Paths

Floats = NDArray[np.float64]
Texts = NDArray[np.object_]

#: Diagnostics in m/s; tables and JSON state them per abs(v0).
_VELOCITY = re.compile(r"v\d+_limit|limit_error|velocity_error|regularisation|rest_speed")


@dataclass(frozen=True, slots=True, eq=False)
class Results:
    """Outcomes of n cells by one solver, of up to N balls; NaN where a cell has fewer, and where nothing is known.

    Attributes
    ----------
    states, compared : list of str
        State sequences of two balls on a table, as the solver gives them and as they are compared; else empty.
    diagnostics : dict of str to ndarray, shape (n,)
        Velocities per abs(v0), times in s.
    paths : Paths or None
        Of two balls on a table.
    """

    velocities: Floats
    impulses: Floats
    status: Texts
    reason: Texts
    mark: Texts
    differences: Texts
    states: list[str]
    compared: list[str]
    n_states: NDArray[np.int64]
    n_events: NDArray[np.int64]
    margin: Floats
    diagnostics: dict[str, Floats]
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
    both = zip(compared_states(paths, shortest), found["states"], strict=True)
    return Results(**found | {"compared": [text or own for text, own in both], "paths": paths})


def scaled_diagnostics(outcome: Outcome, speed: float) -> dict[str, float]:
    """Return the diagnostics of an outcome as those of `Results`."""
    return {
        name: value / speed if _VELOCITY.fullmatch(name) and value is not None else value
        for name, value in outcome.diagnostics.items()
    }


def _of_arrays(outcomes: Outcomes, shortest: Floats | None) -> dict[str, Any]:
    named = shortest is not None and outcomes.states is not None
    return {
        "velocities": outcomes.velocities,
        "impulses": outcomes.impulses,
        "status": outcomes.statuses,
        "reason": np.array(outcomes.reasons, dtype=object)[outcomes.reason],
        "mark": outcomes.marked,
        "differences": [""] * len(outcomes),
        "states": outcomes.states.texts() if named and outcomes.states else [""] * len(outcomes),
        "n_states": outcomes.n_states,
        "n_events": outcomes.n_events,
        "margin": outcomes.grazing_margin,
        "diagnostics": outcomes.diagnostics,
        "paths": outcomes.paths,
    }


def _of_list(outcomes: Sequence[Outcome]) -> dict[str, Any]:
    def numbers(values: Iterable[float | None]) -> Floats:
        return np.array([np.nan if value is None else value for value in values], float)

    names = dict.fromkeys(name for each in outcomes for name in each.diagnostics)
    return {
        "velocities": [each.velocities for each in outcomes],
        "impulses": [each.impulses for each in outcomes],
        "status": [each.status for each in outcomes],
        "reason": [each.reason for each in outcomes],
        "mark": [each.marked for each in outcomes],
        "differences": [each.differences for each in outcomes],
        "states": [" ".join(each.states) for each in outcomes],
        "n_states": np.array([len(each.states) for each in outcomes], np.int64),
        "n_events": np.array([each.n_events for each in outcomes], np.int64),
        "margin": numbers(each.grazing_margin for each in outcomes),
        "diagnostics": {name: numbers(each.diagnostics.get(name) for each in outcomes) for name in names},
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
