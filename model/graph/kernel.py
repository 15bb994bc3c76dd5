"""The kernel of graphs: follows a graph from first touch to its end, window by window.

`follow_graphs` follows many graphs, and is the only kernel that Python calls; `collide` follows one graph. A segment is
the time with one set of active contacts. A segment consists of windows. Over a window every rate and every force is a
polynomial in time (`graph.motion`), so the first event is found with certainty (`graph.event`). The law tells what the
event does to its contact (`graph.law`). The collision is over when no contact is active and no bodies approach.

Used by `graph.solving`.
"""

from __future__ import annotations

from math import inf

import numpy as np

from impact_xval.model.compiled import kernel_entry, kernel_helper
from impact_xval.model.graph.event import first_event
from impact_xval.model.graph.grazing import near_misses
from impact_xval.model.graph.law import (
    GraphWatched,
    deactivate,
    end_compression,
    reactivate,
    restart_compression,
)
from impact_xval.model.graph.motion import place
from impact_xval.model.graph.record import EventKind, GraphEnding
from impact_xval.model.graph.rigid import eliminate, expand_with_rigid, make_rigid, ringing_ends
from impact_xval.model.graph.state import (
    GraphPhase,
    is_compliant,
    rounding_energy,
    still_rounding,
    strain_energy,
)

#: Share of the energy of impact below which all active contacts count as at rest.
COLLAPSED = 1e-30

#: Largest gain of energy, as a share of the energy of impact, that counts as rounding; no law makes energy.
GAIN = 1e-9


@kernel_helper
def begin(c, matrices, graphs, graph):
    """Put a graph at first touch: no contact is active yet, and the start rule decides (`graph.law`)."""
    for i in range(c.size):
        contact = c[i]
        contact.k, contact.e = graphs.stiffnesses[graph, i], graphs.restitutions[graph, i]
        contact.w, contact.F = graphs.rates[graph, i], 0.0
        contact.impulse, contact.reach = 0.0, 0.0
        contact.phase, contact.is_rigid = GraphPhase.INACTIVE, False
        for j in range(c.size):
            matrices.full[i, j] = graphs.delassus[graph, i, j]
    eliminate(c, matrices)


@kernel_helper
def is_over(c):
    """Return whether no contact is active and no bodies approach; rigid contacts alone carry no force."""
    for i in range(c.size):
        contact = c[i]
        if is_compliant(contact.phase) and (contact.F > 0 or contact.w != 0):
            return False
        if contact.w > 0:
            return False
    return True


@kernel_helper
def energy_left(c, W):
    """Return the energy of contacts that are active or whose bodies approach."""
    total = 0.0
    for i in range(c.size):
        contact = c[i]
        if W[i, i] > 0 and (is_compliant(contact.phase) or contact.w > 0):
            total += 0.5 * contact.w * contact.w / W[i, i] + strain_energy(contact)
    return total


@kernel_helper
def end_held(c, W):
    """End the active contacts that rigid contacts keep at rest, and return the strain energy that is dropped.

    The rigid contacts pressed in the last window, so all forces are in balance, and stay in balance for ever. The
    bodies are jammed.
    """
    dropped = 0.0
    for i in range(c.size):
        contact = c[i]
        if is_compliant(contact.phase) and W[i, i] <= 0:
            dropped += strain_energy(contact)
            contact.w = 0.0
            deactivate(contact)
    return dropped


@kernel_helper
def bring_to_rest(c):
    """End all active contacts; return the strain energy that is dropped, and whether one of them has e < 1."""
    dropped, is_lossy = 0.0, False
    for i in range(c.size):
        contact = c[i]
        if is_compliant(contact.phase):
            dropped += strain_energy(contact)
            is_lossy |= contact.e < 1
            deactivate(contact)
            contact.w = 0.0
    return dropped, is_lossy


@kernel_helper
def apply_event(c, W, i, watched, energy, result):
    """Apply the event of contact i; return its kind, and the energy that was lost."""
    contact = c[i]
    before, phase = strain_energy(contact), contact.phase
    if watched == GraphWatched.RATE:
        contact.w = 0.0
    if phase == GraphPhase.INACTIVE:
        reactivate(contact)
        return EventKind.RETURN, 0.0
    if phase == GraphPhase.RIGID:
        deactivate(contact)
        return EventKind.LOADED, 0.0
    if phase == GraphPhase.RESTITUTION and watched == GraphWatched.RATE:
        restart_compression(contact)
        return EventKind.RESTART, 0.0
    if watched == GraphWatched.FORCE or (contact.e > 0 and before <= rounding_energy(contact, energy)):
        deactivate(contact)
        return EventKind.END_OF_RESTITUTION, before
    becomes_rigid = False
    if contact.e == 0:
        result.plastic = becomes_rigid = True
    else:
        end_compression(contact)
        if contact.e < 1 and ringing_ends(c, W, i):
            result.runaway = becomes_rigid = True
    if becomes_rigid:
        make_rigid(contact)
    return EventKind.END_OF_COMPRESSION, before - strain_energy(contact)


@kernel_helper
def active_set(c):
    """Return the set of active contacts: bit i stands for contact i. A rigid contact counts while it presses."""
    contacts = np.uint64(0)
    for i in range(c.size):
        if c[i].phase != GraphPhase.INACTIVE:
            contacts |= np.uint64(1) << np.uint64(i)
    return contacts


@kernel_helper
def log_event(log, row, time, kind, contact, active):
    """Write an event if the log has room for it, and return the next row."""
    if row < log.size:
        log[row].time, log[row].kind, log[row].contact, log[row].active = time, kind, contact, active
    return row + 1


@kernel_helper
def log_active(log, row, time, logged, active):
    """Write the set of contacts that are active from the last event on, and return the next row.

    `logged` is the time of the last event. A later change of the set is an event of its own.
    """
    if time > logged:
        return log_event(log, row, time, EventKind.LOADED, -1, active)
    if row <= log.size:
        log[row - 1].active = active
    return row


@kernel_helper
def collide(c, matrices, energy, most_windows, log, first_row, result):
    """Follow a graph from first touch to its end; return the energy that was lost in contacts, and the next row.

    All fields of `result` are filled in except `energy_residual` (`graph.record.GRAPH_RESULT`).
    """
    ending, events, windows = GraphEnding.UNFINISHED, 0, 0
    margin, loss, time = inf, 0.0, 0.0
    row = log_event(log, first_row, time, EventKind.START, -1, np.uint64(0))
    logged, logged_set = time, np.uint64(0)
    while True:
        still_rounding(c, matrices.W, energy)
        held = end_held(c, matrices.W)
        loss += held
        result.collapse |= held > 0
        if 0 < energy_left(c, matrices.W) <= COLLAPSED * energy:
            dropped, is_lossy = bring_to_rest(c)
            loss += dropped
            result.collapse |= is_lossy
            row = log_event(log, row, time, EventKind.COLLAPSE, -1, np.uint64(0))
            logged, events = time, events + 1
        if is_over(c):
            ending = GraphEnding.FREE
            break
        if windows == most_windows:
            break
        windows += 1
        h = expand_with_rigid(c, matrices)
        if h < 0:
            ending = GraphEnding.RIGID_UNDECIDED
            break
        active = active_set(c)
        if active != logged_set or time == logged:
            row = log_active(log, row, time, logged, active)
            logged, logged_set = time, active
        event = first_event(c)
        if event.x < 0:
            ending = GraphEnding.SEARCH_FAILED
            break
        x = min(event.x, 1.0)
        if x > 0:
            place(c, x, h)
            margin = near_misses(c, matrices, x, h, energy, margin)
            time += x * h
        if event.contact >= 0:
            kind, lost = apply_event(c, matrices.W, event.contact, event.watched, energy, result)
            loss += lost
            events += 1
            row = log_event(log, row, time, kind, event.contact, np.uint64(0))
            logged = time
    if ending == GraphEnding.FREE and (logged_set != 0 or time == logged):
        row = log_active(log, row, time, logged, np.uint64(0))
    result.ending, result.n_events, result.n_windows = ending, events, windows
    result.n_rows, result.margin, result.time = row - first_row, margin, time
    return loss, row


@kernel_entry
def follow_graphs(c, matrices, graphs, most_windows, log, ends):
    """Follow graphs of one number of contacts, in units of about 1; the only kernel that Python calls.

    Parameters
    ----------
    c : recarray of `graph.state.GRAPH_CONTACT`, shape (C,)
        Overwritten.
    matrices : Matrices
        Overwritten.
    graphs : Graphs
    most_windows : int
        Windows after which a graph is given up.
    log : recarray of `graph.record.EVENT`
        Filled in as far as there is room; `n_rows` of the results also counts the rows without room.
    ends : GraphEnds
        Filled in; the results are zeros before.
    """
    row = np.int64(0)
    for graph in range(graphs.rates.shape[0]):
        result, energy = ends.results[graph], graphs.energies[graph]
        begin(c, matrices, graphs, graph)
        loss, row = collide(c, matrices, energy, most_windows, log, row, result)
        taken_up = 0.0
        for i in range(c.size):
            ends.impulses[graph, i], ends.rates[graph, i] = c[i].impulse, c[i].w
            taken_up += 0.5 * c[i].impulse * (graphs.rates[graph, i] + c[i].w)
        result.energy_residual = (taken_up - loss) / energy
        if result.ending == GraphEnding.FREE and not taken_up >= -GAIN * energy:
            result.ending = GraphEnding.GAINED_ENERGY
