"""Contact graphs whose contacts have a depth: springs and dashpots in time, along fixed normals (docs/theory.md, 7).

- `law`: the laws, the rules by which a contact begins and returns, and ties. `state`: the record of a contact.
- `motion`: the motion between events, and the start rule. `event`: the certified first event.
- `rigid`: contacts whose running stiffness runs away. `kernel`: follows graphs to their ends.
- `following`: passes arrays of graphs through the kernel, and returns SI units.

Chains have the same laws (`chain.laws`).
"""
