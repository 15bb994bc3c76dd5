"""The configuration of a test of the hypothesis, as a validated TOML file; the empty file is the built-in one."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import tomli_w
from numpy.typing import NDArray
from pydantic import Field, field_validator, model_validator

from impact_xval.compliant_baselines.registry import solver_names
from impact_xval.experiments.config.axes import Strict, at_most, table, whole
from impact_xval.experiments.config.errors import read_toml, short, validated
from impact_xval.experiments.config.experiment import solvers_problem
from impact_xval.experiments.hypothesis.cases import BY_KEY, Point, outside, point_of

#: TOML has lists only: they may stand for pairs, whose numbers are no less strict for it.
_Range = Annotated[tuple[float, float], Field(strict=False)]
_Restitution = Annotated[float, Field(ge=0.02, le=1, description="from 0.02 to 1")]
_Pair = Annotated[tuple[_Restitution, _Restitution], Field(strict=False)]
_CaseName = Literal[
    "zero-apart", "zero-early", "zero-late", "infinity", "plastic-ball-ball", "plastic-ball-table"
]


#: Models and references beside the solvers of every run.
LAWS = ("kelvin-voigt-anchored", "kelvin-voigt-textbook", "hunt-crossley", "liu-zhao-brogliato")

#: What a range must be, by its field: contrasts end where double precision does, or what a user can wait for.
_RANGES: dict[str, Callable[[float, float], bool]] = {
    "contrast": lambda low, high: 1 < low < high <= 1e10,
    "plastic_contrast": lambda low, high: 1 < low < high <= 1e16,
    "engine_contrast": lambda low, high: 1 < low < high <= 1e6,
    "engine_plastic_contrast": lambda low, high: 1 < low < high <= 1e6,
}


class _WithRanges(Strict):
    @field_validator(*_RANGES, check_fields=False)
    @classmethod
    def _legal(cls, value: _Range, info: Any) -> _Range:
        if not _RANGES[info.field_name](*value):
            raise ValueError(f"{short(list(value))}; legal: {cls.model_fields[info.field_name].description}")
        return value


class ColumnsConfig(_WithRanges):
    """The columns of N balls."""

    points: int = whole(6, 3, 100, " (columns at each place; every third is elastic)")
    balls: tuple[int, int] = Field(
        (4, 7), strict=False, description="[least, largest] whole numbers from 4 to 12"
    )
    contrast: _Range = Field(
        (1e1, 1e6), description="[lo, hi] with 1 < lo < hi <= 1e10 (of the stiff contact)"
    )
    per_decade: int = whole(4, 4, 64, " (contrasts in a decade)")
    fit_decades: float = Field(3.0, ge=1, le=8, description="from 1 to 8 (decades of a fit)")

    @field_validator("balls")
    @classmethod
    def _few(cls, value: tuple[int, int]) -> tuple[int, int]:
        if not 4 <= value[0] <= value[1] <= 12:
            raise ValueError(f"{list(value)}; legal: {cls.model_fields['balls'].description}")
        return value


class GivenPoint(Strict):
    """A point of the design that is given, not drawn."""

    case: _CaseName = Field(description=", ".join(BY_KEY))
    mass_ratio: float = Field(gt=0, allow_inf_nan=False, description="a finite number > 0 (m2/m1)")
    e1: _Restitution = 1.0
    e2: _Restitution = 1.0
    stiffness_ratio: float = Field(
        1.0, gt=0, allow_inf_nan=False, description="a finite number > 0 (k2/k1 of a plastic limit)"
    )

    @model_validator(mode="after")
    def _inside(self) -> GivenPoint:
        problem = outside(BY_KEY[self.case], self.point())
        if problem:
            raise ValueError(problem)
        return self

    def point(self) -> Point:
        """Return the point; what goes to its limit in this case is NaN."""
        return point_of(BY_KEY[self.case], self.mass_ratio, self.e1, self.e2, self.stiffness_ratio)


class HypothesisConfig(_WithRanges):
    """A test of the hypothesis."""

    seed: int = Field(1, ge=0, le=2**32, description="a whole number from 0 to 2^32")
    points: int = whole(24, 6, 500, " (points of each limit)")
    solvers: list[str] = Field(
        default_factory=lambda: [*solver_names(), *LAWS], description="a list of names of solvers, each once"
    )
    contrast: _Range = Field((1e1, 1e8), description="[lo, hi] with 1 < lo < hi <= 1e10 (k1/k2 or k2/k1)")
    plastic_contrast: _Range = Field((1e1, 1e12), description="[lo, hi] with 1 < lo < hi <= 1e16 (1/e^2)")
    engine_contrast: _Range = Field(
        (10**0.5, 10**3.5), description="[lo, hi] with 1 < lo < hi <= 1e6 (k1/k2 or k2/k1)"
    )
    engine_plastic_contrast: _Range = Field(
        (1e2, 1e5), description="[lo, hi] with 1 < lo < hi <= 1e6 (1/e^2)"
    )
    per_decade: int = whole(8, 4, 64, " (contrasts in a decade)")
    engine_per_decade: int = whole(2, 2, 16, " (contrasts in a decade)")
    fit_decades: float = Field(4.0, ge=1, le=8, description="from 1 to 8 (decades of a fit)")
    engine_fit_decades: float = Field(2.0, ge=1, le=8, description="from 1 to 8 (decades of a fit)")
    step_fraction: float = at_most(5e-3, 0.1, "of the stiffer contact's period")
    tolerance: float = at_most(3e-4, 1, "of |v0|")
    halvings: int = whole(3, 0, 10, " (of the step)")
    cell_timeout: float = at_most(300.0, 1e6, "s of wall time")
    workers: int | None = whole(None, 1, 4096)
    columns: ColumnsConfig = table(ColumnsConfig)
    point: list[GivenPoint] = Field(
        [], description="a list of tables: case, mass_ratio, e1, e2, for a plastic limit stiffness_ratio"
    )

    @field_validator("solvers")
    @classmethod
    def _known(cls, value: list[str]) -> list[str]:
        problem = solvers_problem(value)
        if problem:
            raise ValueError(problem)
        return value

    def toml(self) -> str:
        """Return the configuration as the text of a TOML file."""
        return tomli_w.dumps(self.model_dump(mode="json", exclude_none=True))

    def given(self, case: str) -> list[Point]:
        """Return the points given for a case."""
        return [given.point() for given in self.point if given.case == case]


def spaced(ends: tuple[float, float], per_decade: int) -> NDArray[np.float64]:
    """Return contrasts from the upper end down, so many in a decade: to the lower end, or next above it.

    Windows of whole decades end on contrasts then.
    """
    low, high = map(math.log10, ends)
    steps = (high - low) * per_decade
    whole = round(steps)
    if not math.isclose(steps, whole, rel_tol=1e-9):
        whole = math.floor(steps)
        low = high - whole / per_decade
    return np.logspace(low, high, whole + 1)


def load(path: Path | None) -> HypothesisConfig:
    """Read a configuration; without a path, the built-in one.

    Raises
    ------
    UserError
        If it cannot be read or is illegal: one line with file, field, value and what is legal.
    """
    return parse({} if path is None else read_toml(path), str(path) if path else "built-in hypothesis")


def parse(data: dict[str, Any], where: str) -> HypothesisConfig:
    """Validate a configuration given as plain values; as `load`."""
    return validated(HypothesisConfig, data, where)
