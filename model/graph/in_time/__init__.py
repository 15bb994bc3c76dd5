"""Contact graphs whose contacts have a depth: springs and dashpots in time, along fixed normals (docs/theory.md, 7).

- `law`: the laws, when a contact begins and returns, and ties. `state`: a graph under way.
- `motion`: the motion between events, and the start rule. `event`: the certified first event.
- `rigid`: a contact whose running stiffness runs away. `kernel`: follows a graph to its end.
- `following`: graphs as arrays, and back in SI units.

The laws themselves are those of chains (`chain.laws`).
"""
