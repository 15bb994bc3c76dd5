"""The references for N balls in a line: contact laws in time, with positions and gaps (docs/columns.md, section 7).

`solving.solve_column` answers one `Column` by one law. What a law watches of a contact is that of two balls
(`references.bistiffness_law`, `references.dashpot_law`); a column under way is the model's (`model.columns.chain`).
"""
