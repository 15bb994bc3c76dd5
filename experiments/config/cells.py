"""Some cells of an experiment as arrays: what a chunk is."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from impact_xval.model.collision import Collision


@dataclass(frozen=True, slots=True, eq=False)
class Block:
    """Some cells.

    Attributes
    ----------
    index : ndarray of int, shape (n,)
        Positions in the experiment, from 0.
    parameters : dict of str to ndarray, shape (n,)
        Columns of the tables that a cell has whatever its solver, in their order.
    collisions : sequence of Collision
        `Collisions` where all are of one kind.
    """

    index: NDArray[np.int64]
    parameters: dict[str, NDArray[Any]]
    collisions: Sequence[Collision]

    def __len__(self) -> int:
        return len(self.index)

    def __getitem__(self, place: slice) -> Block:
        parameters = {name: values[place] for name, values in self.parameters.items()}
        return Block(self.index[place], parameters, self.collisions[place])
