"""The references for N balls in a line: contact laws in time, with positions and gaps (docs/columns.md, section 7).

`solving.solve_column` answers one `Column` by one law of `model.chain`.
"""
