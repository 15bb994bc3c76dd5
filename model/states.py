"""Sequences of states of collisions: `States`, and the names of a set of active contacts.

A state is the set of contacts that carry force. Used by kernels, which log these sets, and by outcomes, which name
them.
"""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from impact_xval.model.arrays import Floats, Integers

#: Names of the states of two balls on a table, by the set of active contacts.
_STATE_OF_SET = ("S4", "S3", "S2", "S1")


def name_of_set(contacts: int, paper: bool) -> str:
    """Return the name of a set of active contacts, given as bits: bit i is contact i + 1.

    If `paper` is true, which is for two balls on a table, the name is the paper's, such as ``"S2"``. Otherwise the name
    lists the contacts, such as ``"1+3"``.
    """
    if paper:
        return _STATE_OF_SET[contacts]
    return "+".join(str(i + 1) for i in range(contacts.bit_length()) if contacts >> i & 1) or "-"


class States(NamedTuple):
    """The successive states of many collisions, one collision after another."""

    #: The sets of collision i are `sets[offsets[i] : offsets[i + 1]]`.
    offsets: Integers
    #: Sets of active contacts, shape (entries, words): bit i of word j is contact 64 j + i + 1.
    sets: NDArray[np.uint64]

    @classmethod
    def of(cls, counts: Floats | Integers, sets: NDArray[np.uint64]) -> States:
        """Make sequences of states from the number of states of each collision, shape (n,), and the log of all sets."""
        return cls(np.append(0, np.cumsum(counts)).astype(np.int64), sets)

    def texts(self) -> list[str]:
        """Return the states of each collision of two balls on a table as one text, such as ``"S1 S2 S4"``."""
        codes, offsets = self.sets[:, 0].astype(np.uint8).tobytes(), self.offsets.tolist()
        sequences = [codes[i:j] for i, j in pairwise(offsets)]
        texts = {sequence: " ".join(_STATE_OF_SET[bits] for bits in sequence) for sequence in set(sequences)}
        return [texts[sequence] for sequence in sequences]

    def names(self, index: int, paper: bool) -> tuple[str, ...]:
        """Return the names of the states of one collision, as `name_of_set` writes them."""
        rows = self.sets[self.offsets[index] : self.offsets[index + 1]]
        states = [sum(word << 64 * j for j, word in enumerate(row)) for row in rows.tolist()]
        names = {contacts: name_of_set(contacts, paper) for contacts in set(states)}
        return tuple(names[contacts] for contacts in states)
