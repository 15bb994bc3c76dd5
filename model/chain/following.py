"""Collisions through the kernel of chains, as arrays: scaled to ratios, shared out to threads, and back in SI units."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from impact_xval.model.chain.kernel import GOING, HAPPENED, MADE_ENERGY, Followed, follow_chains
from impact_xval.model.chain.power_law import TOLERANCE, new_workspace
from impact_xval.model.chain.state import new_chain
from impact_xval.model.collision import Collisions, Floats, Outcomes, Paths, States, Status
from impact_xval.model.compiled import FEW_STATES, in_shares
from impact_xval.model.inputs import MASS_PRECISION

#: Pieces of segments after which a collision is given up.
MAX_PIECES = 1_000_000

#: Points of a path in each piece of a segment, as long as its log has no more numbers than this: 64 MB.
POINTS, LOG_NUMBERS = 9, 2**23

#: Collisions that a thread is given at once: some ten milliseconds of work.
SHARE = 512

#: Why there is no result of a collision that was left out, and of a chain that has more kinetic energy than before.
TOO_FAR_APART = (
    f"where one mass or stiffness exceeds {MASS_PRECISION:g} times another, squares of velocities are lost"
)
_MADE_ENERGY = "energy was made: double precision cannot follow masses and stiffnesses this far apart"


class Went(NamedTuple):
    """How collisions went, shape (n,) each; NaN where one was left out."""

    #: In m/s, shape (n, N).
    velocities: Floats
    #: By name what `chain.kernel.Followed` says; `time` and `fall` in s.
    numbers: dict[str, Floats]
    states: States | None

    @property
    def given_up(self) -> NDArray[np.bool_]:
        """Which collisions did not end."""
        return self.numbers["end"] == GOING

    @property
    def left_out(self) -> NDArray[np.bool_]:
        """Which collisions were not followed."""
        return np.isnan(self.numbers["end"])


@dataclass(frozen=True, slots=True, eq=False)
class Problem:
    """Collisions under a law, one of `chain.laws`, with frozen positions or not."""

    collisions: Collisions
    law: int
    #: What the law has of each contact, shape (n, C), in the units of the collision; a collision with one that is not
    #: finite is left out, as one of `too_far_apart`.
    dampings: Floats
    frozen: bool
    #: In m/s^2, shape (n,); above 0 only for two balls on a table.
    gravity: Floats
    #: Error of a step, where steps are taken.
    tolerance: float = TOLERANCE
    #: Pieces of segments after which a collision is given up.
    max_pieces: int = MAX_PIECES

    def follow(self, *, states: bool = True) -> Went:
        """Follow all of them to their ends."""
        c, cells, names = self.collisions, self._scaled(), Followed._fields
        n, contacts = c.stiffnesses.shape
        velocities = np.full(c.velocities.shape, np.nan)
        numbers = np.full((n, len(names)), np.nan)
        points, no_path = np.ones(n, np.int64), np.empty((0, 0))

        def follow(share: slice, sets: NDArray[np.uint64]) -> int:
            out = no_path, sets, velocities[share], numbers[share]
            self._collide([each[share] for each in cells], points[share], *out)
            return int(np.nansum(numbers[share, names.index("n_states")])) if states else 0

        words = max(1, -(-contacts // 64))
        sets = in_shares(follow, n, SHARE, FEW_STATES * states, words, np.uint64)
        time, speed = c.units
        found = dict(zip(names, numbers.T, strict=True))
        with np.errstate(over="ignore", invalid="ignore"):  # no fall has an end where nothing falls
            found |= {name: found[name] * time for name in ("time", "fall")}
        logged = States.of(np.nan_to_num(found["n_states"]), sets) if states else None
        return Went(velocities * speed[:, None], found, logged)

    def outcomes(
        self,
        solver: str,
        went: Went,
        lost: Sequence[tuple[NDArray[np.bool_], Status, str]],
        *,
        margin: Floats,
        diagnostics: dict[str, Floats],
        fallen: Floats | float = 0.0,
        paths: bool = False,
    ) -> Outcomes:
        """Say what became of all of them, which `went` so; `lost` are endings (`Outcomes.of`) without a result."""
        numbers, far = went.numbers, "unrepresentable"
        made = numbers["code"] >= MADE_ENERGY
        lost = [*lost, (went.left_out, far, TOO_FAR_APART), (made, far, _MADE_ENERGY)]
        there = ~np.any([condition for condition, _, _ in lost], axis=0)
        every = sum(HAPPENED)
        happened = np.nan_to_num(numbers["code"]).astype(int) & every
        limits: list[tuple[Any, Status, str]] = [
            (happened == some, "closed-form", "; ".join(why for bit, why in HAPPENED.items() if bit & some))
            for some in range(1, every + 1)
        ]
        drawn = None
        if paths:
            arrays = {name: getattr(self, name)[there] for name in ("collisions", "dampings", "gravity")}
            drawn = replace(self, **arrays).paths(numbers["pieces"][there]).spread(there)
        return Outcomes.of(
            solver,
            self.collisions,
            np.where(there[:, None], went.velocities, np.nan),
            [*lost, *limits],
            fallen=fallen,
            n_states=np.where(there, numbers["n_states"], 0),
            n_events=np.where(there, numbers["events"], 0),
            grazing_margin=np.where(there, margin, np.nan),
            states=went.states,
            diagnostics={name: np.where(there, values, np.nan) for name, values in diagnostics.items()},
            paths=drawn,
        )

    def paths(self, pieces: Floats) -> Paths:
        """Paths of all of them, given of how many pieces of segments each is (`follow`)."""
        c, (time, speed), g = self.collisions, self.collisions.units, self.gravity
        (n, balls), contacts = c.masses.shape, c.stiffnesses.shape[1]
        width = 1 + 2 * balls + contacts
        points = np.clip(LOG_NUMBERS // (pieces * width + 1), 1, POINTS).astype(np.int64)
        log = np.empty((int((pieces * points + 1).sum()), width))
        no_states, ends = np.empty((0, 1), np.uint64), np.empty((n, balls))
        numbers = np.full((n, len(Followed._fields)), np.nan)
        self._collide(self._scaled(), points, log, no_states, ends, numbers)
        went = Followed(*numbers.T)
        lengths = went.rows.astype(np.int64)
        offsets, of = np.append(0, np.cumsum(lengths)), np.repeat(np.arange(len(c)), lengths)
        log = log[: len(of)]
        # What leaves double precision is said of the outcome; without gravity a fall has no end.
        with np.errstate(over="ignore", invalid="ignore"):
            fallen = (g * time)[of] * np.minimum(log[:, 0], went.fall[of])
            aloft = (went.fall < went.time)[of] & (log[:, 0] >= went.fall[of])
            velocities, weight = log[:, 1 : 1 + balls] * speed[of, None], np.where(aloft, 0.0, g[of])
            changes = velocities - c.velocities[of] + fallen[:, None]
            pushes = log[:, 1 + balls : 1 + 2 * balls] * (speed / time)[of, None] + weight[:, None]
            impulses, forces = (
                np.cumsum(c.masses[of] * each, axis=1)[:, :contacts] for each in (changes, pushes)
            )
            acting = log[:, 1 + 2 * balls :] > 0
            return Paths(offsets, log[:, 0] * time[of], velocities, impulses, forces, acting)

    def _scaled(self) -> list[Any]:
        """Arguments of the kernel for each collision, in its units."""
        c, (time, speed) = self.collisions, self.collisions.units
        with np.errstate(over="ignore", under="ignore", invalid="ignore", divide="ignore"):
            masses, stiffnesses = (x / x[:, :1] for x in (c.masses, c.stiffnesses))
            drift = np.zeros(len(c))
            if not c.table:
                drift = (masses * c.velocities).sum(axis=1) / masses.sum(axis=1) / speed
            gaps, gravity = c.gaps / (speed * time)[:, None], self.gravity * time / speed
        masses[too_far_apart(c) | ~np.isfinite(self.dampings).all(axis=1)] = np.nan
        rates = c.compression_rates / speed[:, None]
        # Copied: the kernel would be compiled once more for arrays that are read-only.
        return [masses, stiffnesses, c.restitutions.copy(), self.dampings, rates, drift, gaps, gravity]

    def _collide(self, cells: list[Any], *log_and_out: Any) -> None:
        contacts = self.collisions.stiffnesses.shape[1]
        chain = new_chain(contacts, self.collisions.exponent, self.law, self.frozen)
        how = self.tolerance, self.max_pieces
        follow_chains(chain, new_workspace(contacts), *cells, *how, *log_and_out)


def too_far_apart(collisions: Collisions) -> NDArray[np.bool_]:
    """Whether masses or stiffnesses of a collision lie further apart than `MASS_PRECISION`."""
    found = np.zeros(len(collisions), bool)
    for values in (collisions.masses, collisions.stiffnesses):
        with np.errstate(over="ignore", invalid="ignore"):
            found |= ~(values.max(axis=1) <= MASS_PRECISION * values.min(axis=1))
            found |= ~np.isfinite(values).all(axis=1)
    return found
