"""The model of two balls on a table in closed form: the diagram of states S1 to S4.

One collision takes about a microsecond.

- `kernel`: the diagram. `kernel.collide_all` is the only kernel that Python calls. `following`: calls it in threads.
- `record`: types that cross modules: states, endings, ratios, options, logs, the record of a result.
- `motion`: the exact motion inside a state. `lone`: states with a single active contact. `law`: the effect of an event.
- `events`: the certified first event in S1. `roots`: its tools. `ringing`: a short cut for a contact that rings.
- `limits`: closed forms of limiting cases. `grazing`: the distance from a jump of the outcome.
- `path`: points of the motion.

Needs `model.compiled` and `model.inputs`. Used by `model.solving`; `model.chain` shares phases and thresholds.
"""
