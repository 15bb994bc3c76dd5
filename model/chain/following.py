"""Collisions through the kernel of chains, as arrays: scaled to ratios, shared out to threads, and back in SI units."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from impact_xval.model.chain.kernel import (
    ACTS,
    COLLAPSE,
    GOING,
    MADE_ENERGY,
    PLASTIC,
    RUNAWAY,
    UNITED,
    Followed,
    follow_chains,
)
from impact_xval.model.chain.power_law import TOLERANCE, new_workspace
from impact_xval.model.chain.state import new_chain
from impact_xval.model.collision import Collisions, Floats, Outcomes, Paths, States, Status
from impact_xval.model.compiled import in_shares
from impact_xval.model.inputs import MASS_PRECISION

#: Pieces of segments after which a collision is given up.
MAX_PIECES = 1_000_000

#: Points of a path in each piece of a segment, as long as its log has no more numbers than this: 64 MB.
POINTS, LOG_NUMBERS = 9, 2**23

#: Collisions that a thread is given at once: some ten milliseconds of work.
SHARE = 512

#: Why outcomes of chains are limits, by the bit of the kernel's code.
HAPPENED = {
    PLASTIC: "closed form of e = 0: the bodies of a contact that ended compression are one from there on",
    RUNAWAY: "the running stiffness of a contact runs away: its bodies are one from where it is rigid to rounding",
    COLLAPSE: "bodies come to rest together after infinitely many events",
}

#: Why there is no result of a collision that was left out, and of a chain that has more kinetic energy than before.
TOO_FAR_APART = (
    f"where one mass or stiffness exceeds {MASS_PRECISION:g} times another, squares of velocities are lost"
)
_MADE_ENERGY = "energy was made: double precision cannot follow masses and stiffnesses this far apart"


class Went(NamedTuple):
    """How collisions went.

    Attributes
    ----------
    velocities : ndarray, shape (n, N)
        In m/s; NaN where a collision was left out.
    numbers : dict of str to ndarray, shape (n,)
        What `chain.kernel.Followed` says; `time` and `fall` in s; NaN where a collision was left out.
    states : States or None
    """

    velocities: Floats
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
    """Collisions under a law.

    Attributes
    ----------
    collisions : Collisions
    law : int
        One of `chain.laws`.
    dampings : ndarray, shape (n, C)
        What the law has of each contact, in the units of the collision; a collision with one that is not finite is left
        out, as one of `too_far_apart`.
    frozen : bool
        Whether positions are frozen.
    gravity : ndarray, shape (n,)
        In m/s^2; above 0 only for two balls on a table.
    tolerance : float
        Error of a step, where steps are taken.
    max_pieces : int
        Pieces of segments after which a collision is given up.
    """

    collisions: Collisions
    law: int
    dampings: Floats
    frozen: bool
    gravity: Floats
    tolerance: float = TOLERANCE
    max_pieces: int = MAX_PIECES

    def follow(self, *, states: bool = True) -> Went:
        """Follow all of them to their ends."""
        c, cells, names = self.collisions, self._scaled(), list(Followed._fields)
        n, contacts = c.stiffnesses.shape
        velocities = np.full(c.velocities.shape, np.nan)
        numbers = np.full((n, len(names)), np.nan)
        words, no_log = max(1, -(-contacts // 64)), np.empty((0, 0))

        def follow(share: slice, *log: Any) -> int:
            out = velocities[share], numbers[share], *log
            self._collide([each[share] for each in cells], 1, no_log, out)
            return int(np.nansum(numbers[share, names.index("n_states")]))

        sets, starts = in_shares(follow, n, SHARE, states, words)
        time, speed = c.units
        found = dict(zip(names, numbers.T, strict=True))
        with np.errstate(over="ignore", invalid="ignore"):  # no fall has an end where nothing falls
            found |= {name: found[name] * time for name in ("time", "fall")}
        logged = States.of(np.nan_to_num(found["n_states"]), sets, starts, time) if states else None
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
            (happened == some, "limit", "; ".join(why for bit, why in HAPPENED.items() if bit & some))
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
        c, cells = self.collisions, self._scaled()
        (n, balls), contacts = c.masses.shape, c.stiffnesses.shape[1]
        width = 1 + 2 * balls + contacts
        each = np.clip(LOG_NUMBERS // (pieces * width + 1), 1, POINTS)
        numbers, unused = np.full((n, len(Followed._fields)), np.nan), np.empty(0)
        logs = [np.empty((0, width))]
        for i, j in pairwise(
            sorted({0, *(np.flatnonzero(np.diff(each)) + 1).tolist(), n})
        ):  # as many points each
            log = np.empty((int((pieces[i:j] * each[i] + 1).sum()), width))
            out = np.empty((j - i, balls)), numbers[i:j], np.empty((0, 1), np.uint64), unused
            self._collide([x[i:j] for x in cells], int(each[i]), log, out)
            logs.append(log[: int(numbers[i:j, 9].sum())])
        return self._unscaled(np.concatenate(logs), Followed(*numbers.T))

    def _unscaled(self, log: Floats, went: Followed) -> Paths:
        """Turn rows of the kernel's log into paths in SI units."""
        c, (time, speed), g = self.collisions, self.collisions.units, self.gravity
        balls, contacts = c.masses.shape[1], c.stiffnesses.shape[1]
        lengths = went.rows.astype(np.int64)
        offsets, of = np.append(0, np.cumsum(lengths)), np.repeat(np.arange(len(c)), lengths)
        flags = log[:, 1 + 2 * balls :]
        acting = (flags == ACTS) | ((flags == UNITED) & (flags == ACTS).any(axis=1, keepdims=True))
        acting[offsets[1:][lengths > 0] - 1] = False
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

    def _collide(self, cells: list[Any], points: int, log: Floats, out: tuple[Any, ...]) -> None:
        c, contacts = self.collisions, self.collisions.stiffnesses.shape[1]
        chain = new_chain(contacts, c.exponent, self.law, self.frozen)
        arguments: list[Any] = [chain, new_workspace(contacts), *cells, self.tolerance, self.max_pieces]
        follow_chains(*arguments, points, log, *out)


def too_far_apart(collisions: Collisions) -> NDArray[np.bool_]:
    """Whether masses or stiffnesses of a collision lie further apart than `MASS_PRECISION`."""
    found = np.zeros(len(collisions), bool)
    for values in (collisions.masses, collisions.stiffnesses):
        with np.errstate(over="ignore", invalid="ignore"):
            found |= ~(values.max(axis=1) <= MASS_PRECISION * values.min(axis=1))
            found |= ~np.isfinite(values).all(axis=1)
    return found
