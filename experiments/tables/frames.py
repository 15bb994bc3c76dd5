"""Types of what pandas holds: pandas states none that code could be checked against."""

from __future__ import annotations

from typing import Any

#: A DataFrame or a Series. The annotations of pandas are too wide: any selection may be either.
Frame = Any

#: A row of a DataFrame: a Series, or the named tuple that `itertuples` gives.
FrameRow = Any

#: A row of a table as plain values by column: a number, a text, a truth value, a list of these, or None.
Record = dict[str, Any]

#: A value of an axis: a number, or a word such as an arrangement.
AxisValue = float | str
