"""The compiled kernel of chains: it follows each chain from first touch to the end of its collision.

Python calls `follow_chains`, which follows many chains. `collide` follows one chain, window by window. Over a window
every rate of compression and every deformation is a polynomial in time (`chain.series`, `chain.power_law`). So the
first event of the window is found with certainty (`chain.event`). The law states how an event changes its contact
(`chain.laws`).

If positions are frozen, as in the model, the collision is over when no contact is active. If positions move, it is over
when no contact is active and no gap will close.

**Simultaneous events** are applied one after another, in the order of the contacts' numbers. Any order would give the
same result, because an event changes only its own contact, and no rate. The force of a linear dashpot may jump at an
event. This changes accelerations, but no other contact.

Used by `chain.following`. The sweeps of experiments compile this kernel before they start.
"""

from __future__ import annotations

from enum import IntEnum
from math import inf, isnan, nan
from typing import NamedTuple

import numpy as np

from impact_xval.model.chain import laws
from impact_xval.model.chain.drop import QUIET, drop_ending, fall_time, in_flight, over_within
from impact_xval.model.chain.event import first_event
from impact_xval.model.chain.grazing import near_misses
from impact_xval.model.chain.laws import Law, Watched, equilibrium_depth, has_dashpot, has_series, is_active
from impact_xval.model.chain.logs import log_points, log_set
from impact_xval.model.chain.power_law import ORDER_OF_STEP, advance, interpolate, refine_event, step
from impact_xval.model.chain.record import ChainEnding, Setup
from impact_xval.model.chain.rigid import rests_rigidly, ringing_ends
from impact_xval.model.chain.series import ORDER, expand, expand_product, place, window_length
from impact_xval.model.chain.state import (
    begin,
    bring_to_rest,
    energy_left,
    kinetic_energy,
    rounding_energy,
    still_rounding,
    strain_energy,
    unite,
    write_velocities,
)
from impact_xval.model.compiled import inlined_helper, kernel_entry, kernel_helper
from impact_xval.model.pair.law import Phase

#: If the contacts have at most this share of the energy of impact left, their bodies are taken to be at rest.
COLLAPSED = 1e-30

#: Largest product of the number of windows and the number of contacts minus 1. A chain that reaches it is given up,
#: after about a second.
MOST_WORK = 1_000_000

#: Largest relative gain of kinetic energy that is taken for rounding; no law makes energy. In 20,000 chains, whose
#: masses and stiffnesses differed by factors of at most 1e12, the largest gain was 1.2e-11 for p = 1.5, and 3e-14 for p
#: = 1 and 3.
GAIN = 1e-9

#: The numbers 0 and 1, to be passed as arguments. For a literal 0 or 1 Numba would compile the called function once
#: more.
ZERO, ONE = np.int64(0), np.int64(1)

#: Length of the first step of integration for power laws, in units in which masses, stiffnesses and velocities are
#: about 1.
FIRST_STEP = 1e-3


class Action(IntEnum):
    """Action that the kernel takes next with a chain."""

    END = 0  # stop, because the collision is over
    FLY = 1  # move the bodies without forces until a gap closes
    FOLLOW = 2  # move the bodies under forces to the first event


class Window(NamedTuple):
    """Window that was followed to its first event, or to its end without an event.

    A window is a time over which polynomials give the motion: one power series, or one step of integration.
    """

    #: Length of the window in time.
    h: float
    #: Share of the window that was followed; below 0 if the event could not be found.
    x: float
    #: Number of the contact that has the event, from 0; -1 without an event.
    contact: int
    #: The function that is zero at the event, one of `Watched`.
    watched: int
    #: Length of the step to try in the next window.
    next_step: float


@kernel_helper
def next_action(c, n):
    """Return the next action of a chain without gravity, the contact whose gap closes first, and the time until then.

    The returned contact and time have a meaning only if the action is FLY. An active contact at rest without
    deformation carries no force, so it does not prevent a flight.
    """
    first, first_contact = inf, -1
    for i in range(n):
        contact = c[i]
        if is_active(contact) and (contact.delta > 0 or contact.w != 0):
            return Action.FOLLOW, -1, 0.0
        if not contact.frozen and contact.w > 0 and max(0.0, -contact.delta / contact.w) < first:
            first, first_contact = max(0.0, -contact.delta / contact.w), i
    if first_contact < 0:
        return Action.END, first_contact, 0.0
    return Action.FLY, first_contact, first


@kernel_helper
def fly(c, n, h, work):
    """Move all bodies without forces for a time h: deformations change at constant rates."""
    for i in range(n):
        contact = c[i]
        work[i].rates[0] = contact.w
        contact.delta += h * contact.w
        if contact.phase == Phase.SLACK and contact.delta <= 0:
            contact.phase = Phase.INACTIVE


@kernel_helper
def follow_series(c, n, next_step, work):
    """Follow a chain of linear contacts through a window to its first event, and return the window."""
    h = window_length(c, n, work)
    if h == inf:
        h = fall_time(c, n)
    if c[0].law == Law.HUNT_CROSSLEY:
        h = expand_product(c, n, h, work)
    else:
        expand(c, n, h, work)
    event = first_event(c, n, h, work)
    contact, x = event.contact, min(event.x, 1.0)
    is_damped_drop = n == 2 and c[1].g > 0 and has_dashpot(c[0])
    if is_damped_drop and x > 0:
        over = over_within(c, n, x, work)
        if over < x:
            contact, x = -1, over
    place(c, n, x, work)
    return Window(h, x, contact, event.watched, next_step)


@kernel_helper
def follow_step(c, n, first_step, tolerance, work):
    """Follow a chain whose forces obey a power law through a window to its first event, and return the window.

    The window is one step of integration. If an event lies inside the step, the step is computed again with a shorter
    length, so that it ends at the event.
    """
    h, next_step = advance(c, n, first_step, tolerance, work)
    contact, watched = -1, 0
    while True:
        event = first_event(c, n, h, work)
        if event.contact < 0:
            return Window(h, 1.0, contact, watched, next_step)
        if event.x < 0:
            return Window(h, event.x, event.contact, event.watched, next_step)
        x, happens = refine_event(c, n, h, event.x, event.contact, event.watched, event.sign, work)
        work[event.contact].ruled_out[event.watched] = 1
        if happens:
            # The step now ends with this event. The polynomial is only approximate, so another event may come earlier.
            contact, watched, h = event.contact, event.watched, x * h
            if h == 0:
                return Window(h, 0.0, contact, watched, next_step)
            interpolate(c, n, h, work)
        else:
            step(c, n, h, work)


@kernel_helper
def follow(c, n, first_step, tolerance, work):
    """Follow a chain through a window to its first event, and return the window."""
    for i in range(n):
        for watched in range(4):
            work[i].ruled_out[watched] = 0
    if has_series(c[0]):
        return follow_series(c, n, first_step, work)
    return follow_step(c, n, first_step, tolerance, work)


@kernel_helper
def apply_event(c, n, i, watched, energy, result):
    """Apply the event of contact i. If it makes the contact rigid, unite the bodies of the contact.

    `watched` is the function that has reached zero, and `energy` is the energy of impact. The function returns the
    number of remaining contacts and the strain energy that was lost.
    """
    contact = c[i]
    before = strain_energy(contact)
    becomes_rigid = False
    if watched >= Watched.RATE:
        contact.w = 0.0
    if watched == Watched.TURN:
        pass
    elif has_dashpot(contact):
        laws.apply_dashpot_event(contact, watched)
    elif contact.phase == Phase.INACTIVE:
        laws.reactivate(contact)
    elif contact.phase == Phase.RESTITUTION and watched == Watched.RATE:
        laws.restart_compression(contact)
    elif watched == Watched.GAP or (contact.e > 0 and before <= rounding_energy(contact, energy)):
        laws.deactivate(contact)
    elif contact.e == 0:
        result.plastic = True
        becomes_rigid = True
    else:
        laws.end_compression(contact)
        may_run_away = contact.law == Law.STATE_TRANSITION and contact.e < 1
        if may_run_away and ringing_ends(c, n, i):
            result.runaway = True
            becomes_rigid = True
    if becomes_rigid:
        return unite(c, n, i), before
    return n, before - strain_energy(contact)


@kernel_helper
def unite_resting(c, n, energy, result):
    """Unite the bodies of each contact that `rests_rigidly`, and return the number of remaining contacts."""
    for i in range(n - 1, -1, -1):
        if rests_rigidly(c, n, i, energy):
            n = unite(c, n, i)
            result.runaway = True
    return n


@kernel_helper
def end_gravity(c, n):
    """Switch gravity off, and measure the deformation at the table from the surface instead of from equilibrium."""
    last = c[n - 1]
    last.delta += equilibrium_depth(last)
    last.g = 0.0


@inlined_helper
def collide(c, work, setup, options, logs, first_row, first_set, result):
    """Follow a chain from first touch to the end of its collision.

    The function returns the number of remaining contacts and the strain energy that was lost. All fields of `result`, a
    record of `chain.record.RESULT`, are filled in except `energy_share`. The motion is logged from row `first_row` on,
    and sets of active contacts from row `first_set` on.
    """
    n = work.size
    frozen, dashpot, law = c[0].frozen, has_dashpot(c[0]), c[0].law
    takes_steps = not has_series(c[0])
    degree = ORDER_OF_STEP if takes_steps else ORDER
    gravity, energy = setup.gravity, setup.energy
    ending = ChainEnding.UNFINISHED
    events, windows, quiet = 0, 0, 0
    margin, loss = inf, 0.0
    time, fall = 0.0, inf
    next_step = FIRST_STEP
    row, set_row = first_row, first_set
    while True:
        if law <= Law.LIU_ZHAO_BROGLIATO and 0 < energy_left(c, n) <= COLLAPSED * energy:
            dropped, is_lossy = bring_to_rest(c, n)
            loss += dropped
            if is_lossy:
                result.collapse = True
        action, event_contact, h = Action.FOLLOW, -1, 0.0
        if gravity > 0:
            ending = drop_ending(c, n, quiet > 0 and quiet % QUIET == 0)
            if ending == ChainEnding.UNFINISHED and in_flight(c, n):
                end_gravity(c, n)
                gravity, fall = 0.0, time
        if gravity == 0:
            action, event_contact, h = next_action(c, n)
            ending = ChainEnding.FREE if action == Action.END else ChainEnding.UNFINISHED
        if ending != ChainEnding.UNFINISHED:
            break
        if windows == options.max_windows or windows * (work.size - 1) >= MOST_WORK:
            break
        windows, quiet = windows + 1, quiet + 1
        if action == Action.FLY:
            fly(c, n, h, work)
            x, last_power = 1.0, ZERO
            watched = Watched.RATE if frozen else Watched.GAP
        else:
            window = follow(c, n, next_step, options.tolerance, work)
            h, x = window.h, window.x
            event_contact, watched = window.contact, window.watched
            next_step, last_power = window.next_step, degree
            if x < 0:
                break  # the event could not be found: the chain is given up, and `ending` stays UNFINISHED
            if not dashpot:
                margin = near_misses(c, n, degree, x, h, energy, margin, work)
        if x > 0:
            for i in range(work.size):
                work[i].force_is_zero = False
            set_row = log_set(c, n, work, logs.sets, first_set, set_row)
            row = log_points(c, n, work, last_power, x, h, time, setup, setup.points, logs.path, row)
        time += x * h
        if event_contact >= 0:
            was_active = is_active(c[event_contact])
            n, lost = apply_event(c, n, event_contact, watched, energy, result)
            loss += lost
            if dashpot:
                work[event_contact].force_is_zero = watched == Watched.FORCE
            # When bodies that overlapped without force part, no force changes. So this is not counted among the events.
            changes_forces = not dashpot or is_active(c[event_contact]) != was_active
            if watched != Watched.TURN and changes_forces:
                events, quiet = events + 1, 0
        still_rounding(c, n, energy)
        if takes_steps and law == Law.STATE_TRANSITION:
            n = unite_resting(c, n, energy, result)
    if ending != ChainEnding.UNFINISHED:
        if ending != ChainEnding.FREE:
            set_row = log_set(c, n, work, logs.sets, first_set, set_row)
        set_row = log_set(c, ZERO, work, logs.sets, first_set, set_row)
    for i in range(n):
        work[i].rates[0] = c[i].w
    row = log_points(c, n, work, ZERO, 0.0, 1.0, time, setup, ONE, logs.path, row)  # the end of the motion
    result.ending = ending
    result.n_events, result.n_windows = events, windows
    result.n_points, result.n_states = row - first_row, set_row - first_set
    result.margin = margin
    result.time, result.fall = time, min(fall, time)
    return n, loss


@kernel_entry
def follow_chains(c, work, chains, options, logs, velocities, results):
    """Follow the collisions of n chains with N balls each. Python calls no other compiled function of this module.

    Parameters
    ----------
    c : recarray of `chain.state.CONTACT`, shape (C + 1,)
        Working memory for the contacts of one chain. The fields `law`, `p` and `frozen` are read, and all other fields
        are overwritten.
    work : recarray of `chain.power_law.WORK`, shape (C,)
        Working memory for polynomials and steps; overwritten.
    chains : Chains
        The chains, scaled so that all values are about 1.
    options : ChainOptions
    logs : ChainLogs
        Filled in for one chain after another.
    velocities : ndarray, shape (n, N)
        Final velocities; filled in for all chains that are followed. A chain whose first mass is NaN is not followed.
    results : recarray of `chain.record.RESULT`, shape (n,)
        Filled in. All fields have to be zeros before the call.
    """
    row, set_row = ZERO, ZERO
    for i in range(chains.masses.shape[0]):
        result = results[i]
        if isnan(chains.masses[i, 0]):
            result.ending = ChainEnding.SKIPPED
            result.margin = result.energy_share = result.time = result.fall = nan
            continue
        drift, gravity = chains.drifts[i], chains.gravities[i]
        begin(
            c,
            chains.masses[i],
            chains.stiffnesses[i],
            chains.restitutions[i],
            chains.dampings[i],
            chains.rates[i],
            chains.gaps[i],
            gravity,
        )
        energy = write_velocities(c, work.size, chains.masses, drift, velocities, i)
        most_energy = (1 + GAIN) * kinetic_energy(c, work.size)
        for j in range(work.size):
            contact = c[j]
            contact.length = (energy * (contact.p + 1) / contact.k) ** (1 / (contact.p + 1))
            work[j].force_is_zero = False
        setup = Setup(energy, drift, gravity, chains.points[i])
        n, loss = collide(c, work, setup, options, logs, row, set_row, result)
        energy_after = write_velocities(c, n, chains.masses, drift, velocities, i)
        result.energy_share = (loss + energy_after) / energy
        if result.ending == ChainEnding.FREE and gravity == 0 and not kinetic_energy(c, n) <= most_energy:
            result.ending = ChainEnding.GAINED_ENERGY
        row += result.n_points
        set_row += result.n_states
