"""Columns: the same model for N balls in a line, with or without a table below them (docs/columns.md).

`Column` is what is solved, `ColumnOutcome` what comes out; `solve_column` answers one, `solve_columns` many. The state
of a column is the set of contacts that act; for two balls on a table these are S1 to S4.

May import the modules beside this room (`collision`, `inputs`, `law`, `compiled`); none of them imports it.
"""
