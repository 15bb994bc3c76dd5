"""The compiled kernel of contact graphs: it follows each graph from first touch to the end of its collision.

Python calls `follow_graphs`, which follows many graphs. `collide` follows one graph, window by window. Over a window
every rate of compression and every force is a polynomial in time (`graph.motion`). So the first event of the window is
found with certainty (`graph.event`). The law states how an event changes its contact (`graph.law`). The collision is
over when no contact is active and no bodies approach.

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

#: If the contacts have less than this share of the energy of impact left, they are all taken to be at rest.
COLLAPSED = 1e-30

#: Largest gain of kinetic energy that is taken for rounding, as a share of the energy of impact. The model's law never
#: makes energy.
GAIN = 1e-9


@kernel_helper
def begin(c, matrices, graphs, graph):
    """Set all contacts of a graph to their state at first touch.

    No contact is active yet. The start rule (`graph.law`) makes contacts active at the beginning of the first window.
    """
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
    """Return whether the collision is over: no contact is active, and no bodies approach.

    The forces of rigid contacts are not tested, because they vanish with the forces of all other contacts.
    """
    for i in range(c.size):
        contact = c[i]
        if is_compliant(contact.phase) and (contact.F > 0 or contact.w != 0):
            return False
        if contact.w > 0:
            return False
    return True


@kernel_helper
def energy_left(c, W):
    """Return the sum of kinetic and strain energies of all contacts that are active or whose bodies approach."""
    total = 0.0
    for i in range(c.size):
        contact = c[i]
        if W[i, i] > 0 and (is_compliant(contact.phase) or contact.w > 0):
            total += 0.5 * contact.w * contact.w / W[i, i] + strain_energy(contact)
    return total


@kernel_helper
def end_held(c, W):
    """Deactivate the active contacts that rigid contacts keep at rest. Return their strain energy, which is lost.

    The rate of such a contact is 0 and stays 0, so its bodies are jammed: all forces are in balance for ever.
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
    """Deactivate all active contacts, and set their rates to 0.

    The function returns their strain energy, which is lost, and whether a contact among them has a restitution below 1.
    """
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
    """Apply the event of contact i, and return its `EventKind` and the strain energy that it loses.

    `watched` is the function of the contact that has reached zero, and `energy` is the energy of impact. `result` notes
    whether the contact became rigid.
    """
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
    """Return the set of contacts that carry force, rigid contacts included; bit i stands for contact i."""
    contacts = np.uint64(0)
    for i in range(c.size):
        if c[i].phase != GraphPhase.INACTIVE:
            contacts |= np.uint64(1) << np.uint64(i)
    return contacts


@kernel_helper
def log_event(log, row, time, kind, contact, active):
    """Write an event into a row of the log, if the log has this row, and return the number of the next row."""
    if row < log.size:
        log[row].time, log[row].kind, log[row].contact, log[row].active = time, kind, contact, active
    return row + 1


@kernel_helper
def log_active(log, row, time, logged, active):
    """Write the set of active contacts into the log, and return the number of the next row.

    `logged` is the time of the last event in the log. If `time` is the same, the set is written into the row of that
    event. If `time` is later, the set gets a row of its own, of the kind LOADED.
    """
    if time > logged:
        return log_event(log, row, time, EventKind.LOADED, -1, active)
    if row <= log.size:
        log[row - 1].active = active
    return row


@kernel_helper
def collide(c, matrices, energy, most_windows, log, first_row, result):
    """Follow a graph from first touch to the end of its collision.

    The function returns the strain energy that was lost in contacts, and the number of the next row of the log. All
    fields of `result`, a record of `graph.record.GRAPH_RESULT`, are filled in except `energy_residual`.
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
    """Follow the collisions of n graphs with C contacts each. Python calls no other compiled function of this module.

    Parameters
    ----------
    c : recarray of `graph.state.GRAPH_CONTACT`, shape (C,)
        Working memory for the contacts of one graph; overwritten.
    matrices : Matrices
        Working memory for the matrices of one graph; overwritten.
    graphs : Graphs
        The graphs, scaled so that all values are about 1.
    most_windows : int
        Largest number of windows of a graph. A graph that needs more is given up.
    log : recarray of `graph.record.EVENT`
        Events of all graphs, one graph after another. Events beyond the size of the log are dropped, but are counted
        in `n_rows` of the results.
    ends : GraphEnds
        Filled in. Its results have to be zeros before the call.
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
