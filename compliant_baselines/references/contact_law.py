"""What the contact laws have in common: the modes of a contact, what may be watched of it, and its events.

A law gives the driver two things. A table `WATCHED`, of shape (modes, 3): of a contact in a mode, the sign with which
its force, its penetration and its rate of compression are positive until their event, or 0 where one is not watched.
And a function `change`: what a contact is after an event.
"""

from __future__ import annotations

from numba import njit

#: Laws, as the driver knows them.
BISTIFFNESS, KELVIN_VOIGT, HUNT_CROSSLEY, COMPRESSION_DASHPOT = 0, 1, 2, 3
#: Those of columns of N balls, by name.
COLUMN_LAWS = {
    "bistiffness": BISTIFFNESS,
    "kelvin-voigt": KELVIN_VOIGT,
    "kelvin-voigt-textbook": KELVIN_VOIGT,
    "hunt-crossley": HUNT_CROSSLEY,
    "compression-dashpot": COMPRESSION_DASHPOT,
}

#: Modes of a contact. OPEN: its bodies are apart; SLACK: they overlap without force; the others carry force. HELD is no
#: mode but the row of an OPEN contact in `WATCHED` where positions are frozen.
OPEN, SLACK, LOADED, COMPRESSION, RESTITUTION, HELD = 0, 1, 2, 3, 4, 5
N_MODES = 6

#: What may be watched of a contact; NOTHING where nothing happened.
FORCE, GAP, RATE, NOTHING = 0, 1, 2, -1

#: Events; 0 is none.
END_OF_COMPRESSION, RESTART_OF_COMPRESSION, END_OF_RESTITUTION, RETURN, LIMIT = 1, 2, 3, 4, 5


#: Decorator of the parts that the driver is put together from. They are inlined, and count no references to the table
#: of coefficients that is handed from one to the next: that took a fifth of the time of a collision. What they call
#: does not count either, so that none of it can make an array.
_OPTIONS = {"cache": True, "error_model": "numpy", "forceinline": True, "_nrt": False}
part = njit(**_OPTIONS)


@part
def carries(mode):
    """Whether a contact carries force."""
    return mode > SLACK


@part
def state_of(mode1, mode2):
    """Tell the number of the state, 1 to 4, from which contacts carry force."""
    if carries(mode1):
        return 1 if carries(mode2) else 3
    return 2 if carries(mode2) else 4


@part
def event_of(before, after):
    """Event by which a contact goes from one mode to another; 0 where its force neither ends, returns nor turns."""
    if carries(before) != carries(after):
        return RETURN if carries(after) else END_OF_RESTITUTION
    if before == COMPRESSION:
        return END_OF_COMPRESSION
    return RESTART_OF_COMPRESSION if before == RESTITUTION else 0
