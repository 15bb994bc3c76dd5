"""Many outcomes of one solver as arrays: `Outcomes`, and the impulses that follow from velocities.

Needs `model.outcome`, `model.status`, `model.states` and `model.path`. Every solver of arrays returns `Outcomes`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from impact_xval.model.arrays import Booleans, Floats, Integers
from impact_xval.model.collisions import Collisions
from impact_xval.model.outcome import Outcome
from impact_xval.model.path import Paths
from impact_xval.model.states import States
from impact_xval.model.status import IS_RESULT, STATUSES, Ending, Status, first_endings, reason_texts_of


def total_impulses(collisions: Collisions, velocities: Floats, fallen: ArrayLike = 0.0) -> Floats:
    """Return the impulses of all contacts in N s, shape (n, C), that led to given final velocities.

    The velocities are in m/s, shape (n, N). `fallen`, shape (n,) or (), is the speed in m/s that gravity has added to
    free balls.
    """
    changes = velocities - collisions.velocities + np.reshape(fallen, (-1, 1))
    return np.cumsum(collisions.masses * changes, axis=1)[:, : collisions.stiffnesses.shape[1]]


@dataclass(frozen=True, slots=True, eq=False)
class Outcomes(Sequence[Outcome]):
    """Outcomes of n collisions of N balls each by one solver, as arrays. Item `[i]` is the `Outcome` of collision i.

    Attributes
    ----------
    solver : str
        Name of the solver.
    velocities, impulses : ndarray, shapes (n, N) and (n, C)
        Final velocities in m/s, and total impulses in N s; NaN where there is no result.
    status : ndarray of uint8, shape (n,)
        Indices into the tuple `STATUSES`; `statuses` are the texts.
    reason, mark : ndarray of int, shape (n,)
        Indices into `reason_texts` and `mark_texts`, whose first sentence is empty. `reasons` and `marks` are the
        sentences.
    n_states, n_events : ndarray of int, shape (n,)
        Numbers of states and of events of each collision.
    grazing_margin : ndarray, shape (n,)
        How near each collision is to a jump of the model's outcome; NaN where it is not known.
    states : States or None
        States of all collisions; None if they were not recorded.
    diagnostics : dict of str to ndarray, shape (n,)
        Further numbers by name; NaN where an outcome does not state the number.
    paths : Paths or None
        Velocities, impulses and forces during the collisions; None if they were not recorded.
    """

    solver: str
    velocities: Floats
    impulses: Floats
    status: NDArray[np.uint8]
    reason: NDArray[np.int32]
    reason_texts: tuple[str, ...]
    mark: NDArray[np.int32]
    mark_texts: tuple[str, ...]
    n_states: Integers
    n_events: Integers
    grazing_margin: Floats
    states: States | None = None
    diagnostics: dict[str, Floats] = field(default_factory=dict[str, Floats])
    paths: Paths | None = None

    @property
    def v1(self) -> Floats:
        """Velocities of ball 1, in m/s."""
        return self.velocities[..., 0]

    @property
    def v2(self) -> Floats:
        """Velocities of ball 2, in m/s."""
        return self.velocities[..., 1]

    @property
    def impulse1(self) -> Floats:
        """Impulses of contact 1, in N s."""
        return self.impulses[..., 0]

    @property
    def impulse2(self) -> Floats:
        """Impulses of contact 2, in N s."""
        return self.impulses[..., 1]

    @property
    def statuses(self) -> NDArray[np.str_]:
        """Status of each outcome as a text. The texts are computed on demand: they take more memory than all arrays."""
        return np.array(STATUSES)[self.status]

    @property
    def reasons(self) -> NDArray[np.object_]:
        """Sentence that explains the status, for each outcome; empty if there is nothing to explain."""
        return np.array(self.reason_texts, dtype=object)[self.reason]

    @property
    def marked(self) -> Booleans:
        """True where an outcome has a mark, a sentence in `marks` that warns of it."""
        return self.mark > 0

    @property
    def marks(self) -> NDArray[np.object_]:
        """Sentence that warns of an outcome near a jump or a cut-off, for each outcome; else empty."""
        return np.array(self.mark_texts, dtype=object)[self.mark]

    @property
    def has_result(self) -> Booleans:
        """True where the velocities and impulses of an outcome are a result."""
        return IS_RESULT[self.status]

    @classmethod
    def of(
        cls,
        solver: str,
        collisions: Collisions,
        velocities: Floats,
        endings: Sequence[Ending],
        *,
        fallen: ArrayLike = 0.0,
        n_states: ArrayLike = 0,
        n_events: ArrayLike = 0,
        grazing_margin: ArrayLike = math.nan,
        states: States | None = None,
        diagnostics: dict[str, Floats] | None = None,
        paths: Paths | None = None,
    ) -> Outcomes:
        """Build outcomes without marks from final velocities in m/s and from the ways in which collisions may end.

        A collision gets the first ending whose condition is true for it. `fallen` is the speed in m/s that gravity has
        added to free balls.
        """
        n = len(collisions)
        status, reason = first_endings(endings, n)
        return cls(
            solver=solver,
            velocities=velocities,
            impulses=total_impulses(collisions, velocities, fallen),
            status=status,
            reason=reason,
            reason_texts=reason_texts_of(endings),
            mark=np.zeros(n, np.int32),
            mark_texts=("",),
            n_states=np.broadcast_to(n_states, n).astype(np.int64),
            n_events=np.broadcast_to(n_events, n).astype(np.int64),
            grazing_margin=np.array(np.broadcast_to(grazing_margin, n), float),
            states=states,
            diagnostics=diagnostics or {},
            paths=paths,
        )

    @classmethod
    def failures(cls, solver: str, collisions: Collisions, status: Status, reason: str) -> Outcomes:
        """Return the outcomes of a solver that gave no result for any collision, all with one reason."""
        return cls.of(solver, collisions, np.nan * collisions.masses, [Ending(True, status, reason)])

    def with_marks(self, sentences: NDArray[np.object_]) -> Outcomes:
        """Return the outcomes with new marks: one sentence per outcome, which is empty if the outcome is not marked."""
        marked = np.flatnonzero(sentences != "")
        mark = np.zeros(len(self), np.int32)
        mark[marked] = 1 + np.arange(marked.size)
        return replace(self, mark=mark, mark_texts=("", *sentences[marked]))

    def __len__(self) -> int:
        return len(self.velocities)

    @overload
    def __getitem__(self, index: int) -> Outcome: ...
    @overload
    def __getitem__(self, index: slice) -> list[Outcome]: ...
    def __getitem__(self, index: int | slice) -> Outcome | list[Outcome]:
        if isinstance(index, slice):
            return [self[i] for i in range(len(self))[index]]
        i = range(len(self))[index]
        has_paper_names = self.velocities.shape[1] == self.impulses.shape[1] == 2
        states: tuple[str, ...] = ()
        if self.states is not None and self.n_states[i]:
            states = self.states.names(i, has_paper_names)
        margin = float(self.grazing_margin[i])
        diagnostics = {name: float(values[i]) for name, values in self.diagnostics.items()}
        return Outcome(
            solver=self.solver,
            velocities=tuple(self.velocities[i].tolist()),
            impulses=tuple(self.impulses[i].tolist()),
            states=states,
            status=STATUSES[int(self.status[i])],  # pyright: ignore[reportArgumentType]
            reason=self.reason_texts[int(self.reason[i])],
            grazing_margin=None if math.isnan(margin) else margin,
            mark=self.mark_texts[int(self.mark[i])],
            n_events=int(self.n_events[i]),
            diagnostics={name: value for name, value in diagnostics.items() if not math.isnan(value)},
            path=None if self.paths is None else self.paths[i],
        )


@dataclass(frozen=True, slots=True, eq=False)
class GridOutcomes:
    """Outcomes of a grid of collisions of two balls on a table. Item `[i, j, ...]` is the `Outcome` of one collision.

    All arrays have the shape of the grid. Velocities and impulses have one more axis, of length 2, at the end.

    Attributes
    ----------
    flat : Outcomes
        The outcomes in one row, in which the index of the last axis of the grid changes fastest.
    shape : tuple of int
        The shape of the grid.
    """

    flat: Outcomes
    shape: tuple[int, ...]

    @property
    def v1(self) -> Floats:
        """Velocities of ball 1, in m/s."""
        return self.velocities[..., 0]

    @property
    def v2(self) -> Floats:
        """Velocities of ball 2, in m/s."""
        return self.velocities[..., 1]

    @property
    def impulse1(self) -> Floats:
        """Impulses of contact 1, in N s."""
        return self.impulses[..., 0]

    @property
    def impulse2(self) -> Floats:
        """Impulses of contact 2, in N s."""
        return self.impulses[..., 1]

    def __getitem__(self, index: int | tuple[int, ...]) -> Outcome:
        return self.flat[int(np.arange(len(self.flat)).reshape(self.shape)[index])]

    @property
    def velocities(self) -> Floats:
        """Velocities in m/s; NaN where there is no result."""
        return self.flat.velocities.reshape(*self.shape, 2)

    @property
    def impulses(self) -> Floats:
        """Impulses in N s; NaN where there is no result."""
        return self.flat.impulses.reshape(*self.shape, 2)

    @property
    def statuses(self) -> NDArray[np.str_]:
        """Status of each outcome as a text, such as 'ok'."""
        return self.flat.statuses.reshape(self.shape)

    @property
    def reasons(self) -> NDArray[np.object_]:
        """Sentence that explains the status, for each outcome; empty if there is nothing to explain."""
        return self.flat.reasons.reshape(self.shape)

    @property
    def has_result(self) -> Booleans:
        """True where the velocities and impulses of an outcome are a result."""
        return self.flat.has_result.reshape(self.shape)

    @property
    def marked(self) -> Booleans:
        """True where an outcome has a mark, a sentence in `marks` that warns of it."""
        return self.flat.marked.reshape(self.shape)

    @property
    def marks(self) -> NDArray[np.object_]:
        """Sentence that warns of an outcome near a jump or a cut-off, for each outcome; else empty."""
        return self.flat.marks.reshape(self.shape)

    @property
    def n_states(self) -> Integers:
        """Number of states of each collision; 0 where states were not recorded."""
        return self.flat.n_states.reshape(self.shape)

    @property
    def n_events(self) -> Integers:
        """Number of events of each collision."""
        return self.flat.n_events.reshape(self.shape)

    @property
    def grazing_margin(self) -> Floats:
        """Grazing margin of each outcome, as in `Outcome`; NaN where it is not known."""
        return self.flat.grazing_margin.reshape(self.shape)

    @property
    def diagnostics(self) -> dict[str, Floats]:
        """Further numbers by name; NaN where an outcome does not state the number."""
        return {name: values.reshape(self.shape) for name, values in self.flat.diagnostics.items()}
