"""N balls in a line under any contact law, in time and event by event (docs/columns.md).

`kernel` follows one collision, `laws` are its contact laws as data, `state` is what it changes; `series` and
`power_law` move it between events, and `roots` finds the next one.

May import `model.compiled` and `pair.law`; of the model only `model.columns.solving` imports this room.
"""
