"""Chains: N balls in a line under any contact law, followed in time from event to event (docs/chains.md).

- `following`: passes arrays of chains through the kernel, and returns SI units. `kernel`: follows chains to their ends.
- `record`: types that cross modules: endings, inputs, logs, the record of a result.
- `laws`: the contact laws as data. `state`: the record of a contact, and the energies and loads of a chain.
- `series`, `power_law`: the motion between events. `event`, `roots`: the first event.
- `logs`: logs of paths and of active contacts. `rigid`: which contacts count as rigid.
- `drop`: when a drop is over. `grazing`: the distance from a jump of the outcome.

Needs `model.compiled`, and phases and thresholds of `model.pair`. Used by `model.solving` and by
`compliant_baselines.references`.
"""
