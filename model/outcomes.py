"""Many outcomes of one solver as arrays: `Outcomes`, and the impulses that follow from velocities.

Needs `model.outcome`, `model.status`, `model.states` and `model.path`. Returned by every solver of arrays.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from impact_xval.model.arrays import Booleans, Floats, Integers
from impact_xval.model.collisions import Collisions
from impact_xval.model.outcome import Outcome
from impact_xval.model.path import Paths
from impact_xval.model.states import States
from impact_xval.model.status import IS_RESULT, STATUSES, Ending, Status, first_endings, reasons_of


def total_impulses(collisions: Collisions, velocities: Floats, fallen: ArrayLike = 0.0) -> Floats:
    """Return the impulses in N s, shape (n, C), that led to final velocities in m/s, shape (n, N).

    `fallen`, shape (n,) or (), is the speed in m/s that gravity has added to free balls.
    """
    changes = velocities - collisions.velocities + np.reshape(fallen, (-1, 1))
    return np.cumsum(collisions.masses * changes, axis=1)[:, : collisions.stiffnesses.shape[1]]


@dataclass(frozen=True, slots=True, eq=False)
class Outcomes(Sequence[Outcome]):
    """Outcomes of n collisions of one number of balls by one solver, as arrays; `[i]` is an `Outcome`.

    Attributes
    ----------
    solver : str
    velocities, impulses : ndarray, shapes (n, N) and (n, C)
        In m/s and N s; NaN where there is no result.
    status : ndarray of uint8, shape (n,)
        Indices into `STATUSES`; `statuses` are the texts.
    reason, mark : ndarray of int, shape (n,)
        Indices into `reasons` and `marks`, whose first sentence is empty.
    n_states, n_events : ndarray of int, shape (n,)
    grazing_margin : ndarray, shape (n,)
        As in `Outcome`; NaN where it is not known.
    states : States or None
        None where states were not recorded.
    diagnostics : dict of str to ndarray, shape (n,)
        NaN where an outcome does not state the number.
    paths : Paths or None
        None where paths were not recorded.
    """

    solver: str
    velocities: Floats
    impulses: Floats
    status: NDArray[np.uint8]
    reason: NDArray[np.int32]
    reasons: tuple[str, ...]
    mark: NDArray[np.int32]
    marks: tuple[str, ...]
    n_states: Integers
    n_events: Integers
    grazing_margin: Floats
    states: States | None = None
    diagnostics: dict[str, Floats] = field(default_factory=dict[str, Floats])
    paths: Paths | None = None

    v1 = property(lambda self: self.velocities[..., 0], doc="Velocities of ball 1, in m/s.")
    v2 = property(lambda self: self.velocities[..., 1], doc="Velocities of ball 2, in m/s.")
    impulse1 = property(lambda self: self.impulses[..., 0], doc="Impulses of contact 1, in N s.")
    impulse2 = property(lambda self: self.impulses[..., 1], doc="Impulses of contact 2, in N s.")

    @property
    def statuses(self) -> NDArray[np.str_]:
        """Statuses as texts; computed on demand, because they take more room than all other arrays."""
        return np.array(STATUSES)[self.status]

    @property
    def marked(self) -> NDArray[np.object_]:
        """Sentences that mark outcomes, as in `Outcome`; empty for outcomes that are not marked."""
        return np.array(self.marks, dtype=object)[self.mark]

    @property
    def has_result(self) -> Booleans:
        """Whether the numbers of each outcome are a result."""
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
        **more: Any,
    ) -> Outcomes:
        """Build outcomes, none marked, from final velocities in m/s and the endings that collisions may have.

        The first ending whose condition holds counts (`first_endings`). `fallen` is the speed that gravity has added
        (`total_impulses`). Further fields are passed on.
        """
        n = len(collisions)
        status, reason = first_endings(endings, n)
        return cls(
            solver=solver,
            velocities=velocities,
            impulses=total_impulses(collisions, velocities, fallen),
            status=status,
            reason=reason,
            reasons=reasons_of(endings),
            mark=np.zeros(n, np.int32),
            marks=("",),
            n_states=np.broadcast_to(n_states, n).astype(np.int64),
            n_events=np.broadcast_to(n_events, n).astype(np.int64),
            grazing_margin=np.array(np.broadcast_to(grazing_margin, n), float),
            **more,
        )

    @classmethod
    def failures(cls, solver: str, collisions: Collisions, status: Status, reason: str) -> Outcomes:
        """Return the outcomes of a solver that gave no result of any collision, all with one reason."""
        return cls.of(solver, collisions, np.nan * collisions.masses, [Ending(True, status, reason)])

    def with_marks(self, sentences: NDArray[np.object_]) -> Outcomes:
        """Return the outcomes with other marks, given as sentences of shape (n,); the empty text marks nothing."""
        marked = np.flatnonzero(sentences != "")
        mark = np.zeros(len(self), np.int32)
        mark[marked] = 1 + np.arange(marked.size)
        return replace(self, mark=mark, marks=("", *sentences[marked]))

    def reshape(self, shape: tuple[int, ...]) -> Outcomes:
        """Return the outcomes with arrays of a leading shape, such as the shape of a grid; `[i]` needs flat arrays."""
        values = {field.name: getattr(self, field.name) for field in fields(self)}
        arrays: dict[str, Any] = {name: x for name, x in values.items() if isinstance(x, np.ndarray)}
        reshaped = {name: x.reshape(shape + x.shape[1:]) for name, x in arrays.items()}
        diagnostics = {name: x.reshape(shape) for name, x in self.diagnostics.items()}
        return replace(self, **reshaped, diagnostics=diagnostics)

    def __len__(self) -> int:
        return len(self.velocities)

    def __getitem__(self, index: int | slice) -> Any:
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
            reason=self.reasons[int(self.reason[i])],
            grazing_margin=None if math.isnan(margin) else margin,
            marked=self.marks[int(self.mark[i])],
            n_events=int(self.n_events[i]),
            diagnostics={name: value for name, value in diagnostics.items() if not math.isnan(value)},
            path=None if self.paths is None else self.paths[i],
        )
