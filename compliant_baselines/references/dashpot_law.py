"""Contacts of spring and dashpot: what they watch of a contact, and what they apply.

Contact i pushes with F_i = max(0, k_i p_i + D_i) while its bodies overlap, p_i > 0, without memory: that is
what an engine computes step by step (docs/theory.md, section 7). The dashpot's share D_i is one of two laws:

* `KELVIN_VOIGT`: D = c p';
* `HUNT_CROSSLEY`, on a linear spring: D = a k p p'.

That makes three modes of a contact, with G = k p + c p', or 1 + a p' for the product law, whose sign is
that of F:

    OPEN     p <= 0, no force        -> LOADED where the gap has closed, p = 0 rising
    LOADED   p > 0 and G > 0         -> SLACK where G falls to 0, OPEN where p does
    SLACK    p > 0 and G < 0: none   -> LOADED where G rises through 0, OPEN where p falls to 0

A linear dashpot pushes from the first touch (F = c p' at p = 0) and is spent before its bodies are apart. A
slack contact becomes loaded again without having opened when the third body pushes its bodies together.
Without a dashpot the force ends where the bodies part: the contact is never slack.

`COMPRESSION_DASHPOT` is another: D = c max(0, p'). The force k p + D is positive as long as the bodies overlap, and
the modes are those of the bistiffness law, of one stiffness:

    OPEN          p <= 0, no force -> COMPRESSION where the gap has closed, p = 0 rising
    COMPRESSION   p rising         -> RESTITUTION at p' = 0, same force
    RESTITUTION   p falling        -> COMPRESSION at p' = 0, or OPEN at p = 0
"""

from __future__ import annotations

import numpy as np

from impact_xval.compliant_baselines.references.contact_law import (
    COMPRESSION,
    FORCE,
    GAP,
    HELD,
    KELVIN_VOIGT,
    LOADED,
    N_MODES,
    OPEN,
    RATE,
    RESTITUTION,
    SLACK,
    part,
)

KELVIN_VOIGT_WATCHED = np.zeros((N_MODES, 3))
KELVIN_VOIGT_WATCHED[OPEN, GAP] = KELVIN_VOIGT_WATCHED[HELD, RATE] = -1
KELVIN_VOIGT_WATCHED[LOADED, FORCE] = 1
KELVIN_VOIGT_WATCHED[SLACK, FORCE], KELVIN_VOIGT_WATCHED[SLACK, GAP] = -1, 1

HUNT_CROSSLEY_WATCHED = KELVIN_VOIGT_WATCHED.copy()
HUNT_CROSSLEY_WATCHED[LOADED, GAP] = 1


COMPRESSION_WATCHED = np.zeros((N_MODES, 3))
COMPRESSION_WATCHED[OPEN, GAP] = COMPRESSION_WATCHED[HELD, RATE] = -1
COMPRESSION_WATCHED[COMPRESSION, RATE] = 1
COMPRESSION_WATCHED[RESTITUTION, GAP], COMPRESSION_WATCHED[RESTITUTION, RATE] = 1, -1


@part
def change_of_compression(mode, what):
    """Mode of a contact after an event, its dashpot acting in compression only."""
    if mode == COMPRESSION:
        return RESTITUTION
    return OPEN if mode == RESTITUTION and what == GAP else COMPRESSION


@part
def change(mode, what, never_slack):
    """Mode of a contact after an event."""
    if what == FORCE and mode == LOADED:
        return OPEN if never_slack else SLACK
    return OPEN if what == GAP and mode != OPEN else LOADED


@part
def fill_force(table, row, degree, law, position, rate, k, c, rest):
    """Fill in G as a row of the table, from its rows of p - `rest` and of p'; k and c of the contact."""
    if law == KELVIN_VOIGT:
        for j in range(degree + 1):
            table[row, j] = k * table[position, j] + c * table[rate, j]
        table[row, 0] += k * rest
    else:
        for j in range(degree + 1):
            table[row, j] = c * table[rate, j]
        table[row, 0] += 1.0
