"""N balls in a line under any contact law, in time and event by event (docs/columns.md).

`kernel` follows collisions, `laws` are the contact laws as data, `state` is what they change; `series` and `power_law`
move it between events, `roots` finds the next one, and `rest` says when a drop is over.

May import `model.compiled` and of `model.pair` the phases of a contact (`law`) and the least stake of a near miss
(`grazing.STAKE`); of the model only `model.columns.solving` imports this room.
"""
