"""Contact graphs with laws over time: springs and dashpots whose contacts have a depth (docs/theory.md, section 7).

The depths are measured along normals that stay fixed.

- `following`: `solve_timed_graphs` solves arrays of graphs in SI units.
- `law`: the laws, and the rules by which a contact becomes active and inactive. `state`: the record of a contact.
- `motion`: the power series of the motion between events. `event`: the search for the first event.
- `rigid`: contacts that become infinitely stiff. `kernel`: the compiled loop over events.

The laws themselves are those of chains (`chain.laws`).
"""
