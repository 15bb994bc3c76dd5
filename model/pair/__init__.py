"""The model of two balls on a table in closed form: the diagram of states S1 to S4, a microsecond a collision.

- `kernel`: the diagram; `kernel.collide_all` is the only function that Python calls.
- `record`: types that cross modules: states, endings, cells, options, the record of a result.
- `motion`: the exact motion inside a state. `law`: what an event does to its contact.
- `events`: the certified first event in S1; `roots` are its tools; `ringing` is its short cut.
- `limits`: closed forms of limiting cases. `grazing`: the distance from a jump of the outcome.
- `path`: points of the motion.

Needs `model.compiled` and `model.inputs`. Used by `model.solving`; `model.chain` shares phases and thresholds.
"""
