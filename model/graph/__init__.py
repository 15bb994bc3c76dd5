"""Contact graphs: bodies of any kind that meet at once, in exact event-driven motion (docs/graphs.md).

- `solving`: `solve_graph` and `solve_graphs`, given a Delassus matrix. `collision`: `GraphCollision`, given bodies and
  contacts. `named`: graphs by name. `outcome`: what they return.
- `law`: what is watched of a contact, and what its events do. `motion`: the motion between events, and the start rule.
  `event`: the certified first event. `rigid`: contacts that are rigid. `grazing`: the distance from a jump.
- `kernel`: follows a graph to its end. `state`: a graph under way. `record`: types that cross the kernel's boundary.

With `model.chain` it shares what is the same for both: the order and the length of power series and their evaluation
(`chain.series`), and the certified first root of a polynomial (`chain.roots`).
"""
