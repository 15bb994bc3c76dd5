"""Solution of many chains, as arrays in SI units.

`Problem` holds the collisions, their law and the options of a solution. It scales all values to about 1, calls the
compiled kernel in threads, and converts the result, a `ChainResult`, back to SI units.

Needs `chain.kernel`. Used by `model.solving` and by `compliant_baselines.references`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from impact_xval.model.arrays import Booleans, Floats, Records, zero_records
from impact_xval.model.chain.kernel import MOST_WORK, follow_chains
from impact_xval.model.chain.laws import Law
from impact_xval.model.chain.power_law import TOLERANCE, new_workspace
from impact_xval.model.chain.record import RESULT, ChainEnding, ChainLogs, ChainOptions, Chains
from impact_xval.model.chain.state import new_chain
from impact_xval.model.collisions import Collisions
from impact_xval.model.compiled import STATE_ROWS, run_in_threads
from impact_xval.model.inputs import MASS_PRECISION
from impact_xval.model.outcomes import Outcomes
from impact_xval.model.path import Paths
from impact_xval.model.states import States
from impact_xval.model.status import Ending

#: Largest number of windows of a collision. A collision that needs more is given up.
MAX_WINDOWS = 1_000_000

#: Number of points that the path of a collision has in each window, and largest number of floats in the log of one path
#: (64 MB). A path that would need more floats gets fewer points in each window.
POINTS, LOG_NUMBERS = 9, 2**23

#: Number of collisions that a thread follows in one call of the kernel: about ten milliseconds of work.
SHARE = 512

#: Sentences for chains without a result: for chains that were not followed, and for chains that gained kinetic energy.
TOO_FAR_APART = (
    f"where one mass or stiffness exceeds {MASS_PRECISION:g} times another, squares of velocities are lost"
)
_GAINED_ENERGY = "energy was made: double precision cannot follow masses and stiffnesses this far apart"

#: Sentences for chains that were solved by a closed form.
PLASTIC_REASON = "closed form of e = 0: the bodies of a contact move as one once its compression has ended"
RUNAWAY_REASON = (
    "the running stiffness of a contact grows without bound: "
    "its bodies move as one once rounding hides its compression"
)
COLLAPSE_REASON = "bodies come to rest together after infinitely many events"

_NO_PATH = np.empty((0, 0))


class ChainResult(NamedTuple):
    """Result of the kernel of chains for n collisions."""

    #: Final velocities in m/s, shape (n, N); NaN where a collision was skipped.
    velocities: Floats
    #: Records of `chain.record.RESULT`, shape (n,). Their fields `time` and `fall` are in s.
    records: Records
    #: Successive sets of active contacts; None if they were not recorded.
    states: States | None

    @property
    def given_up(self) -> Booleans:
        """True for each collision that was given up: after too many windows, or because an event could not be found."""
        return self.records["ending"] == ChainEnding.UNFINISHED

    @property
    def skipped(self) -> Booleans:
        """True for each collision that was not followed: its parameters are too far apart for double precision."""
        return self.records["ending"] == ChainEnding.SKIPPED

    @property
    def gained_energy(self) -> Booleans:
        """True for each collision that ended with more energy than it had at first, because of rounding."""
        return self.records["ending"] == ChainEnding.GAINED_ENERGY


@dataclass(frozen=True, slots=True, eq=False)
class Problem:
    """Collisions of chains with one law of contact, and the options of their solution."""

    collisions: Collisions
    law: Law
    #: Damping b of each contact in the scaled units of its collision, shape (n, C) (`chain.laws`). A collision is not
    #: followed if a damping is not finite, or if its masses or stiffnesses are too far apart.
    dampings: Floats
    #: Whether gaps are ignored, as in the model: a contact that has opened returns as soon as its bodies approach.
    frozen: bool
    #: Gravity in m/s^2, shape (n,); above 0 only for two balls on a table.
    gravity: Floats
    #: Largest error of a step of integration, for laws whose motion is integrated in steps.
    tolerance: float = TOLERANCE
    #: Largest number of windows of a collision. A collision that needs more is given up.
    max_windows: int = MAX_WINDOWS

    @property
    def most_windows(self) -> int:
        """Largest number of windows that the kernel follows: `max_windows`, or less if there are many contacts."""
        other_contacts = self.collisions.stiffnesses.shape[1] - 1
        return min(self.max_windows, -(-MOST_WORK // other_contacts)) if other_contacts else self.max_windows

    def follow(self, *, states: bool = True) -> ChainResult:
        """Follow all collisions to their ends. If `states` is true, record the successive sets of active contacts."""
        c = self.collisions
        n, contacts = len(c), c.stiffnesses.shape[1]
        chains = self._scaled(np.ones(n, dtype=np.int64))
        velocities = np.full(c.velocities.shape, np.nan)
        records = zero_records(n, RESULT)

        def follow_share(share: slice, sets: NDArray[np.uint64]) -> int:
            records[share] = 0
            part = chains.take(share)
            self._follow(part, ChainLogs(_NO_PATH, sets), velocities[share], records[share])
            return int(records["n_states"][share].sum()) if states else 0

        sets = run_in_threads(
            follow_share,
            n,
            share=SHARE,
            log_rows=STATE_ROWS if states else 0,
            row_shape=(max(1, -(-contacts // 64)),),
            log_type=np.dtype(np.uint64),
        )
        time_unit, speed = c.units
        with np.errstate(over="ignore", invalid="ignore"):  # `fall` is infinite without gravity
            records["time"] *= time_unit
            records["fall"] *= time_unit
        logged = States.of(records["n_states"], sets) if states else None
        return ChainResult(velocities * speed[:, None], records, logged)

    def outcomes(
        self,
        solver: str,
        result: ChainResult,
        failures: Sequence[Ending],
        *,
        margin: Floats,
        diagnostics: dict[str, Floats],
        fallen: Floats | float = 0.0,
        paths: bool = False,
    ) -> Outcomes:
        """Build outcomes from the kernel's result.

        Parameters
        ----------
        solver
            Name of the solver.
        result
            Result of `follow`.
        failures
            Ways to end without a result, such as too many windows. This function adds two more: chains that were not
            followed, and chains that gained energy.
        margin, diagnostics
            Grazing margins and diagnostics. They become NaN for collisions without a result.
        fallen
            Speed in m/s that gravity has added to free balls.
        paths
            Whether outcomes have paths: velocities, impulses and forces during the collision.
        """
        failures = [
            *failures,
            Ending(result.skipped, "unrepresentable", TOO_FAR_APART),
            Ending(result.gained_energy, "unrepresentable", _GAINED_ENERGY),
        ]
        has_result = np.ones(len(self.collisions), bool)
        for failure in failures:
            has_result &= ~np.asarray(failure.condition)
        recorded = None
        if paths:
            recorded = self._rows(has_result).paths(result.records["n_windows"][has_result])
            recorded = recorded.scatter(has_result)
        return Outcomes.of(
            solver,
            self.collisions,
            np.where(has_result[:, None], result.velocities, np.nan),
            [*failures, *closed_forms(result.records)],
            fallen=fallen,
            n_states=np.where(has_result, result.records["n_states"], 0),
            n_events=np.where(has_result, result.records["n_events"], 0),
            grazing_margin=np.where(has_result, margin, np.nan),
            states=result.states,
            diagnostics={name: np.where(has_result, values, np.nan) for name, values in diagnostics.items()},
            paths=recorded,
        )

    def paths(self, n_windows: NDArray[np.int64]) -> Paths:
        """Follow all collisions once more, and return their velocities, impulses and forces in time.

        `n_windows` holds the number of windows of each collision, which `follow` has counted. It determines how many
        points fit into the log.
        """
        c, g = self.collisions, self.gravity
        time_unit, speed = c.units
        (n, balls), contacts = c.masses.shape, c.stiffnesses.shape[1]
        width = 1 + 2 * balls + contacts
        points = np.clip(LOG_NUMBERS // (n_windows * width + 1), 1, POINTS).astype(np.int64)
        log = np.empty((int((n_windows * points + 1).sum()), width))
        records = zero_records(n, RESULT)
        logs = ChainLogs(log, np.empty((0, 1), np.uint64))
        self._follow(self._scaled(points), logs, np.empty((n, balls)), records)
        lengths: NDArray[np.int64] = records["n_points"]
        time, fall = records["time"], records["fall"]
        offsets = np.append(0, np.cumsum(lengths))
        row: NDArray[np.int64] = np.repeat(np.arange(n, dtype=np.int64), lengths)
        log = log[: len(row)]
        # The status of an outcome reports numbers that exceed double precision. Without gravity `fall` is infinite.
        with np.errstate(over="ignore", invalid="ignore"):
            fallen = (g * time_unit)[row] * np.minimum(log[:, 0], fall[row])
            is_aloft = (fall < time)[row] & (log[:, 0] >= fall[row])
            weight = np.where(is_aloft, 0.0, g[row])
            velocities = log[:, 1 : 1 + balls] * speed[row, None]
            changes = velocities - c.velocities[row] + fallen[:, None]
            pushes = log[:, 1 + balls : 1 + 2 * balls] * (speed / time_unit)[row, None] + weight[:, None]
            impulses = np.cumsum(c.masses[row] * changes, axis=1)[:, :contacts]
            forces = np.cumsum(c.masses[row] * pushes, axis=1)[:, :contacts]
            active = log[:, 1 + 2 * balls :] > 0
            return Paths(offsets, log[:, 0] * time_unit[row], velocities, impulses, forces, active)

    def _rows(self, rows: Booleans) -> Problem:
        """Return the problem with only the collisions in which `rows`, shape (n,), is true."""
        return replace(
            self, collisions=self.collisions[rows], dampings=self.dampings[rows], gravity=self.gravity[rows]
        )

    def _scaled(self, points: NDArray[np.int64]) -> Chains:
        """Return the input of the kernel: each collision scaled so that its values are about 1."""
        c = self.collisions
        time_unit, speed = c.units
        with np.errstate(over="ignore", under="ignore", invalid="ignore", divide="ignore"):
            masses, stiffnesses = c.masses / c.masses[:, :1], c.stiffnesses / c.stiffnesses[:, :1]
            drifts = np.zeros(len(c))
            if not c.table:
                drifts = (masses * c.velocities).sum(axis=1) / masses.sum(axis=1) / speed
            gaps, gravities = c.gaps / (speed * time_unit)[:, None], self.gravity * time_unit / speed
        masses[too_far_apart(c) | ~np.isfinite(self.dampings).all(axis=1)] = np.nan
        return Chains(
            masses=masses,
            stiffnesses=stiffnesses,
            restitutions=c.restitutions.copy(),  # numba would compile the kernel once more for read-only arrays
            dampings=self.dampings,
            rates=c.compression_rates / speed[:, None],
            gaps=gaps,
            drifts=drifts,
            gravities=gravities,
            points=points,
        )

    def _follow(
        self, chains: Chains, logs: ChainLogs, velocities: Floats, records: NDArray[np.record]
    ) -> None:
        """Follow the chains with the kernel, which fills in the logs, the velocities and the records."""
        contacts = self.collisions.stiffnesses.shape[1]
        chain = new_chain(contacts, self.collisions.exponent, self.law, self.frozen)
        options = ChainOptions(self.tolerance, self.max_windows)
        follow_chains(chain, new_workspace(contacts), chains, options, logs, velocities, records)


def closed_forms(records: Records) -> list[Ending]:
    """Return one ending for each combination of closed forms with which a chain may have been solved."""
    endings: list[Ending] = []
    for plastic, runaway, collapse in product((False, True), repeat=3):
        parts = [(plastic, PLASTIC_REASON), (runaway, RUNAWAY_REASON), (collapse, COLLAPSE_REASON)]
        if plastic or runaway or collapse:
            condition = (
                (records["plastic"] == plastic)
                & (records["runaway"] == runaway)
                & (records["collapse"] == collapse)
            )
            reason = "; ".join(text for is_used, text in parts if is_used)
            endings.append(Ending(condition, "closed-form", reason))
    return endings


def too_far_apart(collisions: Collisions) -> Booleans:
    """Return True for each collision in which masses or stiffnesses differ by more than the factor `MASS_PRECISION`."""
    beyond = np.zeros(len(collisions), bool)
    for values in (collisions.masses, collisions.stiffnesses):
        with np.errstate(over="ignore", invalid="ignore"):
            beyond |= ~(values.max(axis=1) <= MASS_PRECISION * values.min(axis=1))
            beyond |= ~np.isfinite(values).all(axis=1)
    return beyond
