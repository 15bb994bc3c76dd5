"""The model of two balls on a table, solved in closed form between events: the diagram of states S1 to S4.

In S1 both contacts are active, in S2 only the contact of ball 2 with the table, in S3 only the contact of both balls,
and in S4 none. One collision takes about a microsecond.

- `kernel`: the compiled loop over the states of a collision. `following`: calls the kernel in threads.
- `record`: types that the kernel shares with Python: states, endings, inputs, logs, and the record of a result.
- `motion`: the exact motion in a state. `lone`: states with a single active contact. `law`: the effect of an event.
- `events`: the search for the first event in S1. `roots`: roots and bounds of the watched functions. `ringing`: a quick
  way to the next event of a stiff contact that oscillates.
- `limits`: closed forms of limiting cases, such as an infinitely stiff contact.
- `grazing`: how near a collision is to a jump of its outcome. `path`: logs of the motion.

Needs `model.compiled` and `model.inputs`. Used by `model.solving`. `model.chain` uses its phases and thresholds.
"""
