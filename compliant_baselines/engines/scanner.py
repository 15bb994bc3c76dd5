"""Compiled reading of an engine's steps: it finds the active contacts of each step, and the end of the collision.

The docstring of `engines.stepping` explains the rules. Steps are read in windows of many steps. A record of `MEMORY`
keeps what the next window needs to know.
"""

from __future__ import annotations

import math
from enum import IntEnum

import numpy as np

from impact_xval.compliant_baselines.engines.event_free_steps import (
    BALL_BALL,
    BALL_TABLE,
    b2_has_settled,
    both_balls_have_settled,
    strict_helper,
    strict_kernel,
)

#: Largest number of contacts of a scene. A set of contacts is stored as the bits of an integer.
MOST_CONTACTS = 60


class RunEnd(IntEnum):
    """State of a run after its last step: it goes on, is over, or was ended before it is over."""

    #: The collision goes on.
    GOING = 0
    #: Over: the balls are apart, and off the table if there is one.
    APART = 1
    #: Over: B1 has left B2, and B2 has settled on the table.
    B2_SETTLED = 2
    #: Over: both balls have settled, B2 on the table and B1 on B2.
    BOTH_SETTLED = 3
    #: A number is not finite, or the engine has raised an error.
    BROKEN = 4
    #: Given up: all balls are in flight, and would only meet after the last step that is allowed.
    IN_FLIGHT = 5
    #: The first flight of a drop begins, and the run goes on without gravity.
    FIRST_FLIGHT = 6


class FlightPhase(IntEnum):
    """State of the first flight of a drop."""

    #: The flight has not begun.
    BEFORE = 0
    #: The flight goes on.
    DURING = 1
    #: The flight is over, because a gap has closed again.
    ENDED = 2


#: Record that `scan` keeps from one window of steps to the next.
#:
#: * ``active``: the contacts that were active in the last step, as bits
#: * ``met_at_speed``: the contacts whose bodies will meet at a speed when they become active, as bits. These are all
#:   contacts that were open at first or have ceased to be active.
#: * ``n_steps``: number of steps so far
#: * ``starts``, ``starts_together``: the sums of these names in `stepping.Run`
#: * ``last_pulls``: for each contact, the change of the relative velocity in m/s by its pull in the last step, or 0
#: * ``lead``, ``lead_contact``: a number of steps and a contact, of the event that came nearest to starting or
#:   preventing the first flight. If the flight began, this contact closed ``lead`` steps after its beginning. If not,
#:   this contact had closed -``lead`` steps before the other contact opened. The number of steps is infinite before the
#:   first event of this kind.
#: * ``flight_phase``, ``flight_start``: a `FlightPhase`, and the number of steps before the first flight
#: * ``closed``, ``closed_at``: for each contact, 1 if its gap is closed, and the step at which it last closed
MEMORY = np.dtype(
    (
        np.record,
        [
            ("active", "i8"),
            ("met_at_speed", "i8"),
            ("n_steps", "f8"),
            ("starts", "f8"),
            ("starts_together", "f8"),
            ("last_pulls", "f8", MOST_CONTACTS),
            ("lead", "f8"),
            ("lead_contact", "i8"),
            ("flight_phase", "i8"),
            ("flight_start", "f8"),
            ("closed", "i8", 2),
            ("closed_at", "f8", 2),
        ],
    )
)


@strict_helper
def _is_finite(v, x, row):  # pragma: no cover (compiled)
    """Return True if all velocities and heights after a step are finite."""
    finite = True
    for ball in range(v.shape[1]):
        finite = finite and math.isfinite(v[row, ball]) and math.isfinite(x[row, ball])
    return finite


@strict_helper
def _inverse_mass(masses, contact):  # pragma: no cover (compiled)
    """Return the inverse reduced mass of the bodies of a contact, in 1/kg."""
    inverse = 1 / masses[contact]
    if contact + 1 < masses.size:
        inverse += 1 / masses[contact + 1]
    return inverse


@strict_helper
def _compression_rate(v, row, contact):  # pragma: no cover (compiled)
    """Return the speed in m/s at which the bodies of a contact approach."""
    if contact + 1 < v.shape[1]:
        return v[row, contact + 1] - v[row, contact]
    return -v[row, contact]


@strict_helper
def _gap(x, row, contact):  # pragma: no cover (compiled)
    """Return the gap of a contact in m."""
    if contact + 1 < x.shape[1]:
        return x[row, contact] - x[row, contact + 1]
    return x[row, contact]


@strict_helper
def _note_forces(v, x, row, before, masses, numbers, memory):  # pragma: no cover (compiled)
    """Record and return the contacts that are active in a step, as bits; impulses follow from the balance of momentum.

    The force of a contact that may pull passes through zero while its bodies overlap. Such a contact stays active.
    """
    gravity_change = numbers.gravity * numbers.step
    impulse, noise, active = 0.0, 0.0, np.int64(0)
    # Changes of the relative velocity at the contact above: by its impulse in this step, and the same number if the
    # contact begins in this step, else 0.
    change_above, start_above = 0.0, 0.0
    for contact in range(numbers.contacts):
        old, new = before[contact] if row == 0 else v[row - 1, contact], v[row, contact]
        impulse += masses[contact] * (new - old + gravity_change)
        noise += numbers.rounding * masses[contact] * (abs(new) + abs(old) + gravity_change)
        bit = 1 << contact
        change, start = 0.0, 0.0
        carries = impulse > noise
        if numbers.pulls:
            goes_on = memory.active & bit and _gap(x, row, contact) < 0
            carries = carries or impulse < -noise or goes_on
        if carries:
            active |= bit
            change = impulse * _inverse_mass(masses, contact)
            begins = not memory.active & bit
            if begins and memory.met_at_speed & bit:
                start = change
                memory.starts += start
        elif memory.active & bit:
            memory.met_at_speed |= bit
            # The force of a contact that pulled jumps to zero at its end, at an arbitrary instant within the step.
            memory.starts += memory.last_pulls[contact]
        memory.last_pulls[contact] = max(-change, 0.0)
        if start > 0 or start_above > 0:
            memory.starts_together += min(change, change_above)
        change_above, start_above = change, start
    memory.active = active
    return active


@strict_helper
def _time_to_meeting(v, x, row, contacts):  # pragma: no cover (compiled)
    """Return the time in s until bodies in free flight meet; infinite if all of them part."""
    soonest = np.inf
    for contact in range(contacts):
        rate = _compression_rate(v, row, contact)
        if rate > 0:
            soonest = min(soonest, max(_gap(x, row, contact), 0.0) / rate)
    return soonest


@strict_helper
def _bodies_approach(v, row, contacts):  # pragma: no cover (compiled)
    """Return True if the bodies of at least one contact approach."""
    approach = False
    for contact in range(contacts):
        approach = approach or _compression_rate(v, row, contact) > 0
    return approach


@strict_helper
def _note_gap(memory, contact, closed, other_closed):  # pragma: no cover (compiled)
    """Record if a gap is closed, and by how many steps this event starts or prevents the first flight."""
    now, was_closed = memory.n_steps, memory.closed[contact] > 0
    lead, lead_contact = np.inf, contact
    if closed and not was_closed:
        memory.closed_at[contact] = now
        if memory.flight_phase == FlightPhase.DURING:
            lead = now - memory.flight_start
            memory.flight_phase = FlightPhase.ENDED
    elif was_closed and not closed and other_closed:
        lead, lead_contact = memory.closed_at[1 - contact] - now, 1 - contact
    if abs(lead) < abs(memory.lead):
        memory.lead = lead
        memory.lead_contact = lead_contact
    memory.closed[contact] = 1 if closed else 0


@strict_helper
def _note_gaps(memory, ball_ball_closed, ball_table_closed):  # pragma: no cover (compiled)
    """Record which gaps of a drop are closed, and if a first flight begins or ends."""
    _note_gap(memory, 0, ball_ball_closed, ball_table_closed)
    _note_gap(memory, 1, ball_table_closed, ball_ball_closed)
    if memory.flight_phase == FlightPhase.BEFORE and not (ball_ball_closed or ball_table_closed):
        memory.flight_phase = FlightPhase.DURING
        memory.flight_start = memory.n_steps


@strict_helper
def _end_of_drop(active, v, x, row, masses, numbers):  # pragma: no cover (compiled)
    """Return the state of a drop of two balls after a step; `active` are the active contacts of this step, as bits."""
    v1, v2, x1, x2 = v[row, 0], v[row, 1], x[row, 0], x[row, 1]
    b1_leaves = not active & BALL_BALL and x1 >= x2 and v1 >= v2
    b2_leaves = not active & BALL_TABLE and x2 >= 0 and v2 >= 0
    if b1_leaves and b2_leaves:
        return RunEnd.APART
    if b1_leaves and v1 >= 0 and b2_has_settled(v2, x2, masses, numbers, 1.0):
        return RunEnd.B2_SETTLED
    if active == 0 and x1 >= x2 >= 0:
        return RunEnd.FIRST_FLIGHT
    if active == BALL_BALL | BALL_TABLE and both_balls_have_settled(v1, v2, x1, x2, masses, numbers, 1.0):
        return RunEnd.BOTH_SETTLED
    return RunEnd.GOING


@strict_helper
def _end_without_gravity(active, v, x, row, contacts, time_left):  # pragma: no cover (compiled)
    """Return the state of a run without gravity after a step.

    `time_left` is the time in s that remains until the last step that is allowed.
    """
    if active != 0:
        return RunEnd.GOING
    if not _bodies_approach(v, row, contacts):
        return RunEnd.APART
    if _time_to_meeting(v, x, row, contacts) > time_left:
        return RunEnd.IN_FLIGHT
    return RunEnd.GOING


@strict_kernel
def scan(v, x, before, masses, scene_numbers, steps_left, active, memory):  # pragma: no cover (compiled)
    """Go through a window of steps until the collision is over.

    Parameters
    ----------
    v, x
        Velocities in m/s and heights in m after each step, shape (n, N).
    before
        Velocities in m/s before the first step, shape (N,).
    masses
        Masses in kg, shape (N,).
    scene_numbers
        One record of `event_free_steps.SCENE_NUMBERS`, shape (1,).
    steps_left
        Number of steps that may be taken after this window.
    active
        Filled with the contacts that are active in each step, as bits; shape (n,).
    memory
        One record of `MEMORY`, shape (1,), which is updated.

    Returns
    -------
    The number of steps that belong to the collision, and the `RunEnd` after the last of them. The `RunEnd` is returned
    as an integer, because compiled code takes 30 microseconds to return a member of an enumeration.
    """
    numbers, record = scene_numbers[0], memory[0]
    g = numbers.gravity
    for row in range(v.shape[0]):
        if not _is_finite(v, x, row):
            return row, RunEnd.BROKEN.value
        active[row] = _note_forces(v, x, row, before, masses, numbers, record)
        record.n_steps += 1
        if g > 0 or record.flight_phase == FlightPhase.DURING:
            _note_gaps(record, x[row, 0] < x[row, 1], x[row, 1] < 0)
        if g > 0:
            end = _end_of_drop(active[row], v, x, row, masses, numbers)
        else:
            time_left = (v.shape[0] - row + steps_left) * numbers.step
            end = _end_without_gravity(active[row], v, x, row, numbers.contacts, time_left)
        if end != RunEnd.GOING:
            return row + 1, end.value
    return v.shape[0], RunEnd.GOING.value
