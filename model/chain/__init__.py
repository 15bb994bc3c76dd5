"""Chains: N balls in a line under any contact law, in time and event by event (docs/chains.md).

- `following`: chains as arrays, through the kernel and back in SI units. `kernel`: follows one chain to its end.
- `record`: types that cross modules: endings, inputs, logs, the record of a result.
- `laws`: the contact laws as data. `state`: the contacts that the laws change.
- `series`, `power_law`: the motion between events. `event`, `roots`: the first event.
- `logs`: points of paths and sets of active contacts. `rigid`: which contacts count as rigid.
- `drop`: when a drop is over. `grazing`: the distance from a jump of the outcome.

Needs `model.compiled`, and phases and thresholds of `model.pair`. Used by `model.solving` and by
`compliant_baselines.references`.
"""
