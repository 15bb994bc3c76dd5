"""Two balls on a table: the state transition diagram S1-S4 in closed form, a microsecond a collision.

`kernel` is the diagram, `motion` what happens inside a state, `law` what an event does to its contact. `events` and
`roots` find the first event, `limits` are closed forms of limiting cases, `grazing` is the distance from a jump, `path`
are points of the motion. Python calls `kernel.collide_all` only.
"""
