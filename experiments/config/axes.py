"""The four parameters of an experiment: what is legal, axes of a grid, and boxes that are sampled."""

from __future__ import annotations

import math
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, field_validator

from impact_xval.experiments.config.errors import short
from impact_xval.model.inputs import E1, E2, MASS_RATIO, STIFFNESS_RATIO, Legal

#: The parameters that decide an impact, and how a reader knows them.
AXES = {"stiffness_ratio": "k2/k1", "mass_ratio": "m2/m1", "e1": "e1", "e2": "e2"}

#: What is legal on each; the definition is the model's.
LEGAL = {legal.name: legal for legal in (STIFFNESS_RATIO, MASS_RATIO, E1, E2)}

#: An axis is a list of numbers, or one of ``{"log": [lo, hi, n]}`` and ``{"linear": [lo, hi, n]}``.
Axis = list[float] | dict[str, list[int | float]]

#: A range is a number, or one of ``{"log": [lo, hi]}`` and ``{"linear": [lo, hi]}``.
Range = float | dict[str, list[int | float]]

#: More cells than this are refused: the tables of such a run would not fit on an ordinary disk.
MAX_CELLS = 10_000_000

#: Longest axis; its values are held in memory and hashed.
MAX_VALUES = 100_000

_AXIS = "a list of numbers, {log = [lo, hi, n]} or {linear = [lo, hi, n]}"
_RANGE = "a number, {log = [lo, hi]} or {linear = [lo, hi]}"


def value_problem(legal: Legal, value: Any) -> str | None:
    """Write what is wrong with one value of a parameter as ``value; legal: range``, or return None."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return f"{short(value)} is not a number; legal: {legal.text}"
    try:
        number = float(value)
    except OverflowError:
        return f"{short(value)} leaves double precision; legal: {legal.text}"
    return None if legal.includes(number) else f"{short(value)}; legal: {legal.text}"


def axis_problem(legal: Legal, axis: Any) -> str | None:
    """Write what is wrong with an axis as read from a file, or return None."""
    if isinstance(axis, dict):
        return _spacing_problem(legal, axis, _AXIS, counted=True) or _equal_values(axis)
    if not isinstance(axis, list):
        return f"{short(axis)}; legal: {_AXIS}"
    if not axis:
        return "[] is empty; legal: one value or more"
    if len(axis) > MAX_VALUES:
        return f"a list of {len(axis)} values; legal: 1 to {MAX_VALUES}"
    problem = next(filter(None, (value_problem(legal, value) for value in axis)), None)
    if problem:
        return problem
    seen: set[float] = set()
    for value in map(float, axis):
        if value in seen:
            return f"{short(axis)} holds {value!r} more than once; legal: each value once"
        seen.add(value)
    return None


def _range_problem(legal: Legal, value: Any) -> str | None:
    """Write what is wrong with a range as read from a file, or return None."""
    if isinstance(value, dict):
        return _spacing_problem(legal, value, _RANGE, counted=False)
    return (
        value_problem(legal, value) if isinstance(value, int | float) else f"{value!r:.60}; legal: {_RANGE}"
    )


def _spacing_problem(legal: Legal, spacing: dict[str, Any], notation: str, *, counted: bool) -> str | None:
    """Write what is wrong with ``{log = [lo, hi]}`` or ``{linear = [lo, hi]}``, `counted` with n values, or None."""
    if len(spacing) != 1 or next(iter(spacing)) not in ("log", "linear"):
        return f"{short(spacing)}; legal: {notation}"
    ((kind, entries),) = spacing.items()
    shown = f"{{{kind} = {short(entries)}}}"
    if not isinstance(entries, list) or len(entries) != 2 + counted:
        return f"{shown}; legal: {{{kind} = [lo, hi{', n' if counted else ''}]}}"
    lo, hi, *rest = entries
    problem = value_problem(legal, lo) or value_problem(legal, hi)
    if problem:
        return problem
    for count in rest:
        if isinstance(count, bool) or not isinstance(count, int) or not 2 <= count <= MAX_VALUES:
            return f"{shown}: n = {short(count)}; legal: a whole number from 2 to {MAX_VALUES}"
    if not lo < hi < math.inf:
        return f"{shown}: lo = {lo!r}, hi = {hi!r}; legal: lo < hi, both finite"
    if kind == "log" and lo <= 0:
        return f"{shown}: lo = {lo!r}; legal: lo > 0 on a logarithmic axis"
    return None


def _equal_values(axis: dict[str, list[int | float]]) -> str | None:
    """Write that an axis of legal spacing has values that double precision does not tell apart."""
    ((kind, (lo, hi, count)),) = axis.items()
    if np.all(np.diff(_spaced(kind, lo, hi, int(count))) > 0):
        return None
    shown = f"{{{kind} = {short([lo, hi, count])}}}"
    return f"{shown}: {count} values between {lo!r} and {hi!r} are not all different; legal: fewer values"


def expand_axis(axis: Axis) -> list[float]:
    """Values of a legal axis, in the order given."""
    if isinstance(axis, dict):
        ((kind, (lo, hi, count)),) = axis.items()
        return _spaced(kind, lo, hi, int(count)).tolist()
    return [float(value) for value in axis]


def axis_length(axis: Axis) -> int:
    """Count the values of a legal axis, without making them."""
    return int(next(iter(axis.values()))[2]) if isinstance(axis, dict) else len(axis)


def _spaced(kind: str, lo: float, hi: float, count: int) -> NDArray[np.float64]:
    if kind == "linear":
        return np.linspace(lo, hi, count)
    # Fourteen digits make the round values of a logarithmic axis round again (0.1, not 0.09999999999999999).
    values = np.geomspace(lo, hi, count)
    digits = 13 - np.floor(np.log10(values)).astype(int)
    rounded = np.array([round(value, n) for value, n in zip(values.tolist(), digits.tolist(), strict=True)])
    rounded[0], rounded[-1] = lo, hi
    return rounded


class Strict(BaseModel):
    """A table of a configuration: no unknown keys, no conversion of types."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)


def whole(default: int | None, low: int, high: int, what: str = "") -> Any:
    """Give a field of whole numbers, and say what is legal."""
    return Field(default, ge=low, le=high, description=f"a whole number from {low} to {high}{what}")


_SEED = Field(0, ge=0, le=2**63 - 1, description="a whole number >= 0")


def _range(default: Range, name: str) -> Any:
    return Field(default, description=f"{_RANGE}; {LEGAL[name].text}")


class Sample(Strict):
    """Cells drawn from a box: each parameter a number, or a range taken evenly or evenly in its logarithm."""

    stiffness_ratio: Range = _range({"log": [1e-3, 1e3]}, "stiffness_ratio")
    mass_ratio: Range = _range({"log": [0.5, 2.0]}, "mass_ratio")
    e1: Range = _range({"linear": [0.5, 1.0]}, "e1")
    e2: Range = _range({"linear": [0.5, 1.0]}, "e2")
    method: Literal["sobol", "latin-hypercube", "random"] = Field(
        "sobol", description="'sobol', 'latin-hypercube' or 'random'"
    )
    n: int = whole(1024, 1, MAX_CELLS, " (cells)")
    seed: int = _SEED

    @field_validator(*AXES, mode="before")
    @classmethod
    def _legal_range(cls, value: object, info: Any) -> object:
        problem = _range_problem(LEGAL[info.field_name], value)
        if problem:
            raise ValueError(problem)
        return value

    def ranges(self) -> dict[str, Range]:
        """Range of every parameter, in the order of a grid's axes."""
        return {name: getattr(self, name) for name in AXES}

    def ends(self) -> dict[str, tuple[float, float]]:
        """Least and greatest value of every parameter."""
        return {name: _ends(range_) for name, range_ in self.ranges().items()}

    def free(self) -> list[str]:
        """Names of the parameters that are ranges."""
        return [name for name, range_ in self.ranges().items() if isinstance(range_, dict)]

    def place(self, unit: NDArray[np.float64]) -> NDArray[np.float64]:
        """Place points of the unit cube in the box.

        Parameters
        ----------
        unit : ndarray, shape (n, d)
            A column for each free parameter, from 0 to 1.

        Returns
        -------
        ndarray, shape (n, 4)
            Stiffness ratio, mass ratio, e1, e2.
        """
        columns = iter(unit.T)
        placed = np.empty((len(unit), 4))
        for i, range_ in enumerate(self.ranges().values()):
            if not isinstance(range_, dict):
                placed[:, i] = range_
                continue
            lo, hi = _ends(range_)
            u = next(columns)
            inside = _between(lo, hi, u) if "log" in range_ else lo + (hi - lo) * u
            placed[:, i] = np.clip(inside, lo, hi)
        return placed


def _ends(range_: Range) -> tuple[float, float]:
    lo, hi = next(iter(range_.values())) if isinstance(range_, dict) else (range_, range_)
    return float(lo), float(hi)


def _between(lo: float, hi: float, u: NDArray[np.float64]) -> NDArray[np.float64]:
    """Place shares of the way from lo to hi evenly in the logarithm."""
    if math.isfinite(hi / lo):
        return lo * (hi / lo) ** u
    # Logarithms round otherwise than the quotient, whose digits are in the identity of every sampled run.
    return np.exp(math.log(lo) + u * (math.log(hi) - math.log(lo)))
