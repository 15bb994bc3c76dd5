"""N balls in a line under any contact law, in time and event by event (docs/columns.md).

`following` takes and gives arrays. `kernel` follows collisions, `laws` are the contact laws as data, `state` is what
they change; `series` and `power_law` move it between events, `roots` finds the next one, `rest` says when a drop ends.
"""
