"""The four axes of an experiment: their names, what is legal on them, and how their values are written."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

#: The parameters that decide an impact, and how a reader knows them.
AXES = {"stiffness_ratio": "k2/k1", "mass_ratio": "m2/m1", "e1": "e1", "e2": "e2"}

#: An axis is a list of numbers, or one of ``{"log": [lo, hi, n]}`` and ``{"linear": [lo, hi, n]}``.
Axis = list[float] | dict[str, list[int | float]]

#: More cells than this are refused: the tables of such a run would not fit on an ordinary disk.
MAX_CELLS = 10_000_000

#: Longest axis; its values are held in memory and hashed.
MAX_VALUES = 100_000

_NOTATION = "a list of numbers, {log = [lo, hi, n]} or {linear = [lo, hi, n]}"

#: Legal values by axis, for a reader.
LEGAL = {
    "stiffness_ratio": "from 0 to inf (k2/k1)",
    "mass_ratio": "finite numbers > 0 (m2/m1)",
    "e1": "from 0 to 1",
    "e2": "from 0 to 1",
}


def axis_problem(name: str, axis: Any) -> str | None:
    """Say what is wrong with an axis as ``value; legal: range``, or return None.

    Parameters
    ----------
    name : str
        ``stiffness_ratio``, ``mass_ratio``, ``e1`` or ``e2``.
    axis : object
        As read from the file.
    """
    if isinstance(axis, dict):
        return spacing_problem(name, axis, _NOTATION) or _equal_values(axis)
    if not isinstance(axis, list):
        return f"{_short(axis)}; legal: {_NOTATION}"
    if not axis:
        return "[] is empty; legal: one value or more"
    if len(axis) > MAX_VALUES:
        return f"a list of {len(axis)} values; legal: 1 to {MAX_VALUES}"
    for value in axis:
        problem = value_problem(name, value)
        if problem:
            return problem
    seen: set[float] = set()
    for value in map(float, axis):
        if value in seen:
            return f"{_short(axis)} holds {value!r} more than once; legal: each value once"
        seen.add(value)
    return None


def spacing_problem(name: str, spacing: dict[str, Any], notation: str, *, counted: bool = True) -> str | None:
    """Say what is wrong with ``{log = [lo, hi, n]}`` or ``{linear = [lo, hi, n]}``, or return None.

    Parameters
    ----------
    name : str
        The axis.
    spacing : dict
        As read from the file.
    notation : str
        What is legal in its place.
    counted : bool
        Whether it ends with a number of values.
    """
    if len(spacing) != 1 or next(iter(spacing)) not in ("log", "linear"):
        return f"{_short(spacing)}; legal: {notation}"
    ((kind, entries),) = spacing.items()
    shown = f"{{{kind} = {_short(entries)}}}"
    if not isinstance(entries, list) or len(entries) != 2 + counted:
        return f"{shown}; legal: {{{kind} = [lo, hi{', n' if counted else ''}]}}"
    lo, hi, *rest = entries
    problem = value_problem(name, lo) or value_problem(name, hi)
    if problem:
        return problem
    for count in rest:
        if isinstance(count, bool) or not isinstance(count, int) or not 2 <= count <= MAX_VALUES:
            return f"{shown}: n = {_short(count)}; legal: a whole number from 2 to {MAX_VALUES}"
    if not lo < hi < math.inf:
        return f"{shown}: lo = {lo!r}, hi = {hi!r}; legal: lo < hi, both finite"
    if kind == "log" and lo <= 0:
        return f"{shown}: lo = {lo!r}; legal: lo > 0 on a logarithmic axis"
    return None


def _equal_values(axis: dict[str, list[int | float]]) -> str | None:
    """Say that an axis of legal spacing has values that double precision does not tell apart."""
    ((kind, (lo, hi, count)),) = axis.items()
    if np.all(np.diff(_spaced(kind, lo, hi, int(count))) > 0):
        return None
    shown = f"{{{kind} = {_short([lo, hi, count])}}}"
    return f"{shown}: {count} values between {lo!r} and {hi!r} are not all different; legal: fewer values"


def is_legal(name: str, values: Any) -> Any:
    """Whether values are legal on an axis, one by one: a truth for a number, an array for an array."""
    if name == "stiffness_ratio":
        return values >= 0
    if name == "mass_ratio":
        return (values > 0) & (values < math.inf)
    return (values >= 0) & (values <= 1)


def value_problem(name: str, value: Any) -> str | None:
    """Say what is wrong with one value of an axis, or return None."""
    legal = LEGAL[name]
    if isinstance(value, bool) or not isinstance(value, int | float):
        return f"{_short(value)} is not a number; legal: {legal}"
    try:
        number = float(value)
    except OverflowError:
        return f"{_short(value)} leaves double precision; legal: {legal}"
    return None if is_legal(name, number) else f"{_short(value)}; legal: {legal}"


def expand_axis(axis: Axis) -> list[float]:
    """Values of a legal axis, in the order given."""
    if isinstance(axis, dict):
        ((kind, (lo, hi, count)),) = axis.items()
        return _spaced(kind, lo, hi, int(count)).tolist()
    return [float(value) for value in axis]


def _spaced(kind: str, lo: float, hi: float, count: int) -> np.ndarray:
    if kind == "linear":
        return np.linspace(lo, hi, count)
    # Fourteen digits make the round values of a logarithmic axis round again (0.1, not 0.09999999999999999).
    values = np.geomspace(lo, hi, count)
    digits = 13 - np.floor(np.log10(values)).astype(int)
    rounded = np.array(
        [round(value, int(digit)) for value, digit in zip(values.tolist(), digits, strict=True)]
    )
    rounded[0], rounded[-1] = lo, hi
    return rounded


def _short(value: object, limit: int = 60) -> str:
    text = repr(value)
    return text if len(text) <= limit else text[: limit - 3] + "..."
