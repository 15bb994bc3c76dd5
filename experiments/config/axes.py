"""Parameters of an experiment: their legal values, the axes of grids and chains, and the boxes of samples.

The modules of this package that define tables of the TOML file (`experiment`, `arrangements`, `graphs`) use the classes
and fields here.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Annotated, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationInfo, model_validator

from impact_xval.experiments.config.errors import is_list, is_table, shorten
from impact_xval.model.collision import MAX_BALLS
from impact_xval.model.inputs import E1, E2, EXPONENT, MASS_RATIO, STIFFNESS_RATIO, Legal

#: Parameters that decide the outcome of an impact of two balls, each with its name in tables and figures.
AXES = {"stiffness_ratio": "k2/k1", "mass_ratio": "m2/m1", "e1": "e1", "e2": "e2"}

#: Validation context of an experiment that is read from the folder of its run. In this context a solver may be missing
#: in the installation, and a name of version 0.4 causes no warning.
KEPT = "kept"

#: Quantities in SI units that a grid may have as axes, with their units.
SI_AXES = {"m1": "kg", "m2": "kg", "k1": "N/m", "k2": "N/m"}

#: Numerator and denominator of each ratio.
RATIO_OF = {"stiffness_ratio": ("k2", "k1"), "mass_ratio": ("m2", "m1")}

_LEAST, _LARGEST = math.ulp(0.0), float(np.finfo(float).max)

#: Legal values on each axis of pairs and of chains.
LEGAL = {
    legal.name: legal
    for legal in (
        STIFFNESS_RATIO,
        MASS_RATIO,
        E1,
        E2,
        Legal("balls", 1, MAX_BALLS, f"a whole number from 2 (a stack: 1) to {MAX_BALLS}"),
        Legal("strike", 1, MAX_BALLS - 1, "a whole number from 1 to balls - 1, of a cradle only"),
        EXPONENT,
        Legal("mass_taper", _LEAST, _LARGEST, "a finite number > 0 (m_(i+1)/m_i)"),
        Legal("stiffness_taper", _LEAST, _LARGEST, "a finite number > 0 (k_(i+1)/k_i)"),
        Legal("gap", 0.0, _LARGEST, "a finite number >= 0 (m)"),
        E1._replace(name="e"),
        Legal("m1", _LEAST, _LARGEST, "a finite number > 0 (kg)"),
        Legal("m2", _LEAST, _LARGEST, "a finite number > 0 (kg)"),
        Legal("k1", _LEAST, _LARGEST, "a finite number > 0 (N/m)"),
        Legal("k2", 0.0, math.inf, "from 0 to inf (N/m)"),
    )
}
#: Axes whose values are whole numbers.
_WHOLE = ("balls", "strike")

#: Largest number of cells of an experiment. The tables of a larger experiment would not fit on an ordinary disk.
MAX_CELLS = 10_000_000

#: Largest number of values on an axis that is given by its two ends and a number of values. The limit is needed because
#: all values are kept in memory and hashed.
_MAX_VALUES = 100_000

# A function that returns a field is annotated with the type of the field's value. `Field` of pydantic is annotated in
# the same way.
_Whole = TypeVar("_Whole", bound=int | None)
_Model = TypeVar("_Model", bound=BaseModel)

_AXIS = "a number, a list of them (one or more), {log = [lo, hi, n]} or {linear = [lo, hi, n]}"
_RANGE = "a number, {log = [lo, hi]} or {linear = [lo, hi]}"


def _legal_numbers(legal: Legal, values: Sequence[object]) -> list[float]:
    """Return the values as numbers; a ValueError names the first value that is not a legal number."""
    numbers: list[float] = []
    for value in values:
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise ValueError(f"{shorten(value)} is not a number; legal: {legal.text}")
        if not legal.includes(value) or (legal.name in _WHOLE and value != int(value)):
            raise ValueError(f"{shorten(value)}; legal: {legal.text}")
        numbers.append(value)
    return numbers


def _check_ends(legal: Legal, spacing: object, lo: object, hi: object, *, is_log: bool) -> None:
    low, high = _legal_numbers(legal, [lo, hi])
    if not low < high < math.inf:
        raise ValueError(f"{shorten(spacing)}: lo = {lo!r}, hi = {hi!r}; legal: lo < hi, both finite")
    if is_log and not (low > 0 and math.isfinite(high / low)):
        ends = "lo > 0 and hi/lo finite on a logarithmic axis"
        raise ValueError(f"{shorten(spacing)}: lo = {lo!r}; legal: {ends}")


def _spacing_entries(value: object, count: int) -> list[object] | None:
    """Return the entries of the list in a table ``{log = [...]}`` or ``{linear = [...]}``.

    Return None if the value is no such table, or if the number of entries is not `count`.
    """
    if not is_table(value) or [*value] not in (["log"], ["linear"]):
        return None
    (entries,) = value.values()
    return entries if is_list(entries) and len(entries) == count else None


def _legal_axis(value: object, info: ValidationInfo) -> object:
    """Return the axis that a field holds; a ValueError says what is illegal about it (`legal_axis`)."""
    return legal_axis(LEGAL[str(info.field_name)], value)


def legal_axis(legal: Legal, value: object) -> object:
    """Return an axis as a list of numbers, or unchanged if it is a table with the ends of the axis.

    A ValueError says what is illegal about the axis.
    """
    if (entries := _spacing_entries(value, 3)) is not None and is_table(value):
        lo, hi, n = entries
        is_log = "log" in value
        _check_ends(legal, value, lo, hi, is_log=is_log)
        if type(n) is not int or not 2 <= n <= _MAX_VALUES:
            raise ValueError(f"{shorten(value)}: n = {shorten(n)}; legal: whole, from 2 to {_MAX_VALUES}")
        spaced = expand_axis({"log" if is_log else "linear": [*_legal_numbers(legal, [lo, hi]), n]})
        _check_each_once(value, _legal_numbers(legal, spaced))
        return value
    if is_table(value) or value == []:
        raise ValueError(f"{shorten(value)}; legal: {_AXIS}")
    values = value if is_list(value) else [value]
    _check_each_once(values, _legal_numbers(legal, values))
    return values


def _check_each_once(axis: object, numbers: list[float]) -> None:
    if len(set(numbers)) < len(numbers):
        twice = next(number for number in numbers if numbers.count(number) > 1)
        raise ValueError(f"{shorten(axis)} holds {twice!r} more than once; legal: each value once")


def _legal_range(value: object, info: ValidationInfo) -> object:
    """Return the range of a sample if it is legal; a ValueError says what is illegal about it."""
    legal = LEGAL[str(info.field_name)]
    if (entries := _spacing_entries(value, 2)) is not None and is_table(value):
        lo, hi = entries
        _check_ends(legal, value, lo, hi, is_log="log" in value)
    elif isinstance(value, int | float):
        _legal_numbers(legal, [value])
    else:
        raise ValueError(f"{shorten(value)}; legal: {_RANGE}")
    return value


#: Axis after validation: a list of values, ``{"log": [lo, hi, n]}`` or ``{"linear": [lo, hi, n]}``.
GivenAxis = list[float] | dict[str, list[int | float]]

#: Field for an axis, which may also be a single number. `LEGAL` has the legal values by the name of the field.
Axis = Annotated[GivenAxis, BeforeValidator(_legal_axis)]

#: Field for the range of a parameter in a sample: a number, ``{"log": [lo, hi]}`` or ``{"linear": [lo, hi]}``.
Range = Annotated[float | dict[str, list[int | float]], BeforeValidator(_legal_range)]


def expand_axis(axis: GivenAxis) -> list[float]:
    """Return the values of a legal axis, in the order given."""
    if isinstance(axis, list):
        return list(axis)
    ((kind, (lo, hi, n)),) = axis.items()
    if kind == "linear":
        return np.linspace(lo, hi, int(n)).tolist()
    # Values are rounded to fourteen digits. A logarithmic axis then has the value 0.1 instead of 0.09999999999999999.
    inner = [float(f"{value:.14g}") for value in np.geomspace(lo, hi, int(n))[1:-1]]
    return [float(lo), *inner, float(hi)]


class Strict(BaseModel):
    """Table of a configuration in which unknown keys and values of a wrong type are errors."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)


class Axes(Strict):
    """Table of axes that make the cells of an experiment; the first axis varies slowest."""

    @model_validator(mode="after")
    def _affordable(self) -> Axes:
        if self.count() > MAX_CELLS:
            raise ValueError(f"the axes make {self.count()} cells; legal: 1 to {MAX_CELLS}")
        return self

    def varied(self) -> Mapping[str, Sequence[float | str]]:
        """Return the values of every axis that the table gives. The values of an axis are numbers or names."""
        return {name: expand_axis(axis) for name, axis in self if axis is not None}

    def count(self) -> int:
        """Return the number of cells that the axes make."""
        return math.prod(map(len, self.varied().values()))


def whole_field(default: _Whole, low: int, high: int, what: str = "") -> _Whole:
    """Return a field for whole numbers from `low` to `high`.

    The description of the legal values ends with the text `what`.
    """
    return Field(default, ge=low, le=high, description=f"a whole number from {low} to {high}{what}")


def positive_field(default: float, unit: str) -> float:
    """Return a field for finite numbers greater than 0."""
    return Field(default, gt=0, allow_inf_nan=False, description=f"a finite number > 0 ({unit})")


def at_most_field(default: float, high: float, what: str) -> float:
    """Return a field for numbers greater than 0 and at most `high`."""
    return Field(default, gt=0, le=high, description=f"greater than 0, at most {high:g} ({what})")


def legal_field(legal: Legal, default: float) -> float:
    """Return a field for numbers in a legal range."""
    return Field(default, ge=legal.low, le=legal.high, description=legal.text)


def table_field(model: type[_Model]) -> _Model:
    """Return a field for a table whose keys all have defaults."""
    return Field(default_factory=model, description=f"a table: {', '.join(model.model_fields)}")


class Sample(Strict):
    """Cells that are drawn from a box by a Sobol sequence.

    A parameter of the sample is a number or a range. In a range, the parameter or its logarithm is evenly distributed.
    """

    stiffness_ratio: Range = Field(default={"log": [1e-3, 1e3]})
    mass_ratio: Range = Field(default={"log": [0.5, 2.0]})
    e1: Range = Field(default={"linear": [0.5, 1.0]})
    e2: Range = Field(default={"linear": [0.5, 1.0]})
    n: int = whole_field(1024, 1, MAX_CELLS, " (cells)")
    seed: int = Field(0, ge=0, le=2**63 - 1, description="a whole number >= 0")

    def ends(self) -> dict[str, list[float]]:
        """Return a list of the least and the greatest value of every parameter.

        If a parameter of the sample is a number, its list holds only this number.
        """
        given: dict[str, Range] = {name: getattr(self, name) for name in AXES}
        return {name: [*next(iter(x.values()))] if isinstance(x, dict) else [x] for name, x in given.items()}

    def free(self) -> list[str]:
        """Return the names of the parameters that are ranges."""
        return [name for name, ends in self.ends().items() if len(ends) > 1]

    def place(self, unit: NDArray[np.float64]) -> NDArray[np.float64]:
        """Map points of the unit cube to points of the box.

        `unit` has one column for each parameter that is a range. The result has shape (n, 4), in the order of `AXES`.
        """
        placed = {name: np.full(len(unit), ends[0], float) for name, ends in self.ends().items()}
        for name, u in zip(self.free(), unit.T, strict=True):
            ((kind, (lo, hi)),) = getattr(self, name).items()
            inside = lo * (hi / lo) ** u if kind == "log" else lo + (hi - lo) * u
            placed[name] = np.clip(inside, lo, hi)
        return np.column_stack(list(placed.values()))
