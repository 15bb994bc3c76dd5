"""Chains: N balls in a line with any contact law, followed in time from event to event (docs/chains.md).

- `following`: solves arrays of chains in SI units. `kernel`: the compiled loop over events.
- `record`: types that the kernel shares with Python: endings, inputs, logs, and the record of a result.
- `laws`: the contact laws. `state`: the record of a contact, and functions for energies and loads.
- `series`: the motion between events of linear contacts. `power_law`: the motion by laws such as Hertz's.
- `event`: the search for the first event. `roots`: the certified first root of a polynomial.
- `logs`: logs of the motion and of the sets of active contacts. `rigid`: when a contact is treated as infinitely stiff.
- `drop`: when a fall with gravity is over. `grazing`: how near a collision is to a jump of its outcome.

Needs `model.compiled`, and from `model.pair` the phases of a contact and thresholds. Used by `model.solving` and by
`compliant_baselines.references`.
"""
