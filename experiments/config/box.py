"""A box of parameters: each axis a number, or a range that is searched or sampled evenly or in its logarithm."""

from __future__ import annotations

import math
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, field_validator

from impact_xval.experiments.config.axes import (
    AXES,
    LEGAL,
    MAX_CELLS,
    spacing_problem,
    value_problem,
)

#: A number, or one of ``{"log": [lo, hi]}`` and ``{"linear": [lo, hi]}``.
Range = float | dict[str, list[int | float]]

_NOTATION = "a number, {log = [lo, hi]} or {linear = [lo, hi]}"
_MEANT = f"{_NOTATION}; "


class Box(BaseModel):
    """Ranges of the four parameters."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)

    stiffness_ratio: Range = Field({"log": [1e-3, 1e3]}, description=_MEANT + LEGAL["stiffness_ratio"])
    mass_ratio: Range = Field({"log": [0.5, 2.0]}, description=_MEANT + LEGAL["mass_ratio"])
    e1: Range = Field({"linear": [0.5, 1.0]}, description=_MEANT + LEGAL["e1"])
    e2: Range = Field({"linear": [0.5, 1.0]}, description=_MEANT + LEGAL["e2"])

    @field_validator(*AXES, mode="before")
    @classmethod
    def _legal_range(cls, value: object, info: Any) -> object:
        problem = _range_problem(info.field_name, value)
        if problem:
            raise ValueError(problem)
        return value

    def ranges(self) -> dict[str, Range]:
        """Range of every parameter, in the order of a grid's axes."""
        return {name: getattr(self, name) for name in Box.model_fields}

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


class Sample(Box):
    """Cells drawn from a box."""

    method: Literal["sobol", "latin-hypercube", "random"] = Field(
        "sobol", description="'sobol', 'latin-hypercube' or 'random'"
    )
    n: int = Field(1024, ge=1, le=MAX_CELLS, description=f"a whole number from 1 to {MAX_CELLS} (cells)")
    seed: int = Field(0, ge=0, le=2**63 - 1, description="a whole number >= 0")


class Search(Box):
    """What is searched for its largest divergence: a box, a solver and a measure."""

    solver: str = Field("mujoco", description="the name of a solver")
    measure: Literal["velocity_divergence", "dv1", "dv2", "dretained_energy", "curve_distance"] = Field(
        "velocity_divergence",
        description="'velocity_divergence', 'dv1', 'dv2', 'dretained_energy' or 'curve_distance'",
    )
    population: int = Field(64, ge=8, le=10_000, description="a whole number from 8 to 10000 (cells)")
    generations: int = Field(30, ge=1, le=10_000, description="a whole number from 1 to 10000")
    seed: int = Field(0, ge=0, le=2**63 - 1, description="a whole number >= 0")


def _ends(range_: Range) -> tuple[float, float]:
    if isinstance(range_, dict):
        ((lo, hi),) = range_.values()
        return float(lo), float(hi)
    return float(range_), float(range_)


def _between(lo: float, hi: float, u: NDArray[np.float64]) -> NDArray[np.float64]:
    """Place shares of the way from lo to hi evenly in the logarithm."""
    if math.isfinite(hi / lo):
        return lo * (hi / lo) ** u
    # Logarithms round otherwise than the quotient, whose digits are in the identity of every sampled run.
    return np.exp(math.log(lo) + u * (math.log(hi) - math.log(lo)))


def _range_problem(name: str, value: Any) -> str | None:
    """Say what is wrong with a range as ``value; legal: range``, or return None."""
    if not isinstance(value, dict):
        if isinstance(value, int | float):
            return value_problem(name, value)
        return f"{value!r:.60}; legal: {_NOTATION}"
    return spacing_problem(name, value, _NOTATION, counted=False)
