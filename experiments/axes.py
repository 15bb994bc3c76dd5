"""One axis of a grid: its notation, what is legal on it, and its values."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

#: An axis is a list of numbers, or one of ``{"log": [lo, hi, n]}`` and ``{"linear": [lo, hi, n]}``.
Axis = list[float] | dict[str, list[int | float]]

#: More cells than this are refused: the tables of such a run would not fit on an ordinary disk.
MAX_CELLS = 10_000_000

#: Longest axis; its values are held in memory and hashed.
MAX_VALUES = 100_000

_NOTATION = "a list of numbers, {log = [lo, hi, n]} or {linear = [lo, hi, n]}"

#: Legal values by axis: closed or open ends, and whether infinity is a value.
_RANGES = {
    "stiffness_ratio": (lambda x: x >= 0, "from 0 to inf (k2/k1)"),
    "mass_ratio": (lambda x: 0 < x < math.inf, "finite numbers > 0 (m2/m1)"),
    "e1": (lambda x: 0 <= x <= 1, "from 0 to 1"),
    "e2": (lambda x: 0 <= x <= 1, "from 0 to 1"),
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
        return _range_problem(name, axis)
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


def _range_problem(name: str, axis: dict[str, Any]) -> str | None:
    if len(axis) != 1 or next(iter(axis)) not in ("log", "linear"):
        return f"{_short(axis)}; legal: {_NOTATION}"
    ((kind, triple),) = axis.items()
    shown = f"{{{kind} = {_short(triple)}}}"
    if not isinstance(triple, list) or len(triple) != 3:
        return f"{shown}; legal: {{{kind} = [lo, hi, n]}}"
    lo, hi, count = triple
    problem = value_problem(name, lo) or value_problem(name, hi)
    if problem:
        return problem
    if isinstance(count, bool) or not isinstance(count, int) or not 2 <= count <= MAX_VALUES:
        return f"{shown}: n = {_short(count)}; legal: a whole number from 2 to {MAX_VALUES}"
    if not lo < hi < math.inf:
        return f"{shown}: lo = {lo!r}, hi = {hi!r}; legal: lo < hi, both finite"
    if kind == "log" and lo <= 0:
        return f"{shown}: lo = {lo!r}; legal: lo > 0 on a logarithmic axis"
    values = _spaced(kind, lo, hi, count)
    if np.any(np.diff(values) <= 0):
        return f"{shown}: {count} values between {lo!r} and {hi!r} are not all different; legal: fewer values"
    return None


def value_problem(name: str, value: Any) -> str | None:
    """Say what is wrong with one value of an axis, or return None."""
    inside, legal = _RANGES[name]
    if isinstance(value, bool) or not isinstance(value, int | float):
        return f"{_short(value)} is not a number; legal: {legal}"
    try:
        number = float(value)
    except OverflowError:
        return f"{_short(value)} leaves double precision; legal: {legal}"
    return None if inside(number) else f"{_short(value)}; legal: {legal}"


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
