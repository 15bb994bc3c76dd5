"""Names for the types of tables, rows and values in annotations, mostly for pandas objects."""

from __future__ import annotations

from typing import Any

#: A DataFrame or a Series of pandas. The type is `Any`. By the annotations of pandas, a selection from a DataFrame may
#: be a DataFrame or a Series, so that a type checker would reject correct code.
Frame = Any

#: A row of a DataFrame: a Series, or a named tuple from `DataFrame.itertuples`.
FrameRow = Any

#: A row of a table as plain values by column. A value is a number, a text, a bool, a list of these, or None.
Record = dict[str, Any]

#: A value of an axis of an experiment: a number, or a word such as the arrangement ``row``.
AxisValue = float | str
