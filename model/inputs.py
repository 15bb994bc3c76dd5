"""Legal values of a collision's parameters, of the ratios on which it depends (Theorem 5), and of the cut-off.

`Legal` is a legal range with its text for messages, and the constants are the ranges of all parameters. `checked_array`
checks arrays, and `legal_cutoff` checks a cut-off.

Used by `model.collision`, by `model.solving` and by the experiments' configuration.
"""

from __future__ import annotations

import math
from numbers import Real
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

#: Grazing margin below which a result gets a mark, a sentence that warns that it is near a jump of the outcome.
#: `benchmarks/grazing.py` measures how well this number separates collisions that jump from collisions that do not.
GRAZING_THRESHOLD = 5e-5


class Legal(NamedTuple):
    """Legal range of a parameter, including both ends, and the text that describes it in messages."""

    name: str
    low: float
    high: float
    text: str

    def includes(self, value: float) -> bool:
        """Return whether a number is legal; NaN is not."""
        return self.low <= value <= self.high

    def number(self, value: object) -> float:
        """Return a value as a float; a ValueError names the parameter, the value and the legal range."""
        if isinstance(value, bool) or not isinstance(value, Real) or math.isnan(float(value)):
            raise ValueError(f"{self.name} = {value!r}: not a number")
        if not self.includes(float(value)):
            raise ValueError(f"{self.name} = {float(value)!r}; legal: {self.text}")
        return float(value)


_LEAST, _LARGEST = math.ulp(0.0), float(np.finfo(float).max)

E1, E2 = (Legal(name, 0.0, 1.0, "from 0 to 1") for name in ("e1", "e2"))
V0 = Legal("v0", -_LARGEST, -_LEAST, "a finite number < 0 (m/s, up is positive)")
STIFFNESS_RATIO = Legal("stiffness_ratio", 0.0, math.inf, "from 0 to inf (k2/k1)")
MASS_RATIO = Legal("mass_ratio", _LEAST, _LARGEST, "a finite number > 0 (m2/m1)")

#: Legal ranges of the parameters of two balls on a table, and of the ratios on which their outcome depends (Theorem 5).
TWO_BALLS = (
    *(Legal(name, _LEAST, _LARGEST, "a finite number > 0 (kg)") for name in ("m1", "m2")),
    *(Legal(name, 0.0, math.inf, "from 0 to inf (N/m)") for name in ("k1", "k2")),
    *(E1, E2, V0),
)
RATIOS = (STIFFNESS_RATIO, MASS_RATIO, E1, E2)

#: Legal ranges of the fields of N balls in a line, and of the stiffnesses of two balls on a table.
LINE = (
    Legal("masses", _LEAST, _LARGEST, "finite numbers > 0 (kg)"),
    Legal("stiffnesses", _LEAST, _LARGEST, "finite numbers > 0 (N/m)"),
    Legal("restitutions", 0.0, 1.0, "from 0 to 1"),
    Legal("velocities", -_LARGEST, _LARGEST, "finite numbers (m/s, up is positive)"),
    Legal("gaps", 0.0, _LARGEST, "finite numbers >= 0 (m)"),
)
STIFFNESSES_WITH_LIMITS = Legal("stiffnesses", 0.0, math.inf, "numbers from 0 to inf (N/m)")

#: Legal range of the exponent p of the contact forces F = k delta^p.
EXPONENT = Legal("exponent", 1.0, 3.0, "from 1 (linear contacts; 1.5: Hertz) to 3")

#: Mass ratios outside [1/x, x], where x is this number, are refused: squared velocities would exceed double precision.
MASS_PRECISION = 1e150

#: Cut-off of the running stiffness ratio: a number, or ``exact`` for the outcome without a cut-off (`model.solve`).
Cutoff = float | Literal["exact"]
LEGAL_CUTOFF = "greater than 1, up to inf, or 'exact'"

#: Cut-off that section 3.4 of the supplement uses.
SUPPLEMENT_CUTOFF = 1e5


def legal_cutoff(value: object) -> bool:
    """Return whether a value is a legal cut-off: a number greater than 1, or ``exact``."""
    if isinstance(value, str):
        return value == "exact"
    return isinstance(value, Real) and float(value) > 1


def checked_array(legal: Legal, values: ArrayLike) -> NDArray[np.float64]:
    """Return values as an array; a ValueError names the parameter, its first illegal value, its row and its range."""
    try:
        array = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError):
        raise ValueError(f"{legal.name} = {values!r}: not an array of numbers; legal: {legal.text}") from None
    # If a value is NaN, both extremes are NaN, and no comparison with NaN is true.
    if array.size and not (array.min() >= legal.low and array.max() <= legal.high):
        bad = np.argwhere(~((array >= legal.low) & (array <= legal.high)))[0]
        row = f" in row {bad[0]}" if array.ndim else ""
        raise ValueError(f"{legal.name} = {float(array[tuple(bad)])!r}{row}; legal: {legal.text}")
    return array
