"""What a test of the hypothesis is asked to do, as a validated TOML file; the empty file is the built-in one."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator, model_validator

from experiments.config import read_toml, solvers_problem
from experiments.errors import UserError
from experiments.hypothesis.cases import BY_KEY, Point
from experiments.hypothesis.design import outside
from experiments.hypothesis.subjects import default_names

_Range = tuple[float, float]
_Restitution = Annotated[float, Field(ge=0.02, le=1)]
_CaseName = Literal[
    "zero-apart", "zero-early", "zero-late", "infinity", "plastic-ball-ball", "plastic-ball-table"
]

#: What is legal, by field: errors quote it.
LEGAL = {
    "seed": "a whole number from 0 to 2^32",
    "points": "a whole number from 6 to 500 (points of each limit)",
    "solvers": "a list of names of solvers, each once",
    "contrast": "[lo, hi] with 1 < lo < hi <= 1e10 (k1/k2 or k2/k1)",
    "plastic_contrast": "[lo, hi] with 1 < lo < hi <= 1e16 (1/e^2)",
    "engine_contrast": "[lo, hi] with 1 < lo < hi <= 1e6",
    "engine_plastic_contrast": "[lo, hi] with 1 < lo < hi <= 1e6",
    "per_decade": "a whole number from 4 to 64 (contrasts in a decade)",
    "engine_per_decade": "a whole number from 2 to 16 (contrasts in a decade)",
    "fit_decades": "from 1 to 8 (decades of a fit)",
    "engine_fit_decades": "from 1 to 8 (decades of a fit)",
    "steps": "a whole number from 20 to 2000 (steps in a period of the stiffer contact)",
    "workers": "a whole number from 1 to 4096",
    "map": "a table: size, engine_size, stiffness_ratio, mass_ratio, restitutions",
    "size": "a whole number from 4 to 400 (cells along each axis)",
    "engine_size": "a whole number from 3 to 60 (cells along each axis)",
    "stiffness_ratio": "[lo, hi] with 0 < lo < 1 < hi (k2/k1); of a point: a finite number > 0",
    "engine_stiffness_ratio": "[lo, hi] with 1e-6 <= lo < 1 < hi <= 1e6 (k2/k1)",
    "mass_ratio": "[lo, hi] with 0 < lo < hi (m2/m1); of a point: a finite number > 0",
    "restitutions": "a list of 1 to 6 pairs [e1, e2], from 0.02 to 1",
    "point": "a list of tables: case, mass_ratio, e1, e2, for a plastic limit stiffness_ratio",
    "case": ", ".join(BY_KEY),
    "e1": "from 0.02 to 1",
    "e2": "from 0.02 to 1",
}


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


def _ordered(name: str, value: _Range, low: float, high: float) -> _Range:
    if not low < value[0] < value[1] <= high:
        raise ValueError(f"{list(value)!r}; legal: {LEGAL[name]}")
    return value


class MapConfig(_Strict):
    """The maps of where the hypothesis is good enough."""

    size: int = Field(61, ge=4, le=400)
    engine_size: int = Field(13, ge=3, le=60)
    stiffness_ratio: _Range = (1e-6, 1e6)
    engine_stiffness_ratio: _Range = (1e-3, 1e3)
    mass_ratio: _Range = (0.05, 20.0)
    restitutions: list[tuple[_Restitution, _Restitution]] = Field(
        [(0.9, 0.7), (1.0, 1.0), (0.5, 0.5)], min_length=1, max_length=6
    )

    @field_validator("stiffness_ratio", "engine_stiffness_ratio", "mass_ratio")
    @classmethod
    def _ranges(cls, value: _Range, info: Any) -> _Range:
        _ordered(info.field_name, value, 0.0, 1e12)
        if info.field_name != "mass_ratio" and not value[0] < 1 < value[1]:
            raise ValueError(f"{list(value)!r}; legal: {LEGAL[info.field_name]}")
        return value


class GivenPoint(_Strict):
    """A point of the design that is given, not drawn."""

    case: _CaseName
    mass_ratio: float = Field(gt=0, allow_inf_nan=False)
    e1: _Restitution = 1.0
    e2: _Restitution = 1.0
    stiffness_ratio: float = Field(1.0, gt=0, allow_inf_nan=False)

    @model_validator(mode="after")
    def _inside(self) -> GivenPoint:
        problem = outside(BY_KEY[self.case], self.point())
        if problem:
            raise ValueError(problem)
        return self

    def point(self) -> Point:
        """Return the point; what goes to its limit in this case is NaN."""
        case = BY_KEY[self.case]
        if not case.plastic:
            return Point(self.mass_ratio, self.e1, self.e2)
        e1, e2 = (math.nan, self.e2) if case.stiff == 1 else (self.e1, math.nan)
        return Point(self.mass_ratio, e1, e2, self.stiffness_ratio)


class HypothesisConfig(_Strict):
    """A test of the hypothesis."""

    seed: int = Field(1, ge=0, le=2**32)
    points: int = Field(24, ge=6, le=500)
    solvers: list[str] = Field(default_factory=default_names)
    contrast: _Range = (1e1, 1e8)
    plastic_contrast: _Range = (1e1, 1e12)
    engine_contrast: _Range = (10**0.5, 10**3.5)
    engine_plastic_contrast: _Range = (1e2, 1e5)
    per_decade: int = Field(8, ge=4, le=64)
    engine_per_decade: int = Field(2, ge=2, le=16)
    fit_decades: float = Field(4.0, ge=1, le=8)
    engine_fit_decades: float = Field(2.0, ge=1, le=8)
    steps: int = Field(100, ge=20, le=2000)
    workers: int | None = Field(None, ge=1, le=4096)
    map: MapConfig = Field(default_factory=lambda: MapConfig.model_validate({}))
    point: list[GivenPoint] = []

    @field_validator("contrast", "plastic_contrast", "engine_contrast", "engine_plastic_contrast")
    @classmethod
    def _ranges(cls, value: _Range, info: Any) -> _Range:
        highest = {"contrast": 1e10, "plastic_contrast": 1e16}
        return _ordered(info.field_name, value, 1.0, highest.get(info.field_name, 1e6))

    @field_validator("solvers")
    @classmethod
    def _known(cls, value: list[str]) -> list[str]:
        problem = solvers_problem(value)
        if problem:
            raise ValueError(problem)
        return value

    def given(self, case: str) -> list[Point]:
        """Return the points given for a case."""
        return [given.point() for given in self.point if given.case == case]


def load(path: Path | None) -> HypothesisConfig:
    """Read a configuration; without a path, the built-in one.

    Raises
    ------
    UserError
        If it cannot be read or is illegal: one line with file, field, value and what is legal.
    """
    return parse({} if path is None else read_toml(path), str(path) if path else "built-in hypothesis")


def parse(data: dict[str, Any], where: str) -> HypothesisConfig:
    """Validate a configuration given as plain values.

    Raises
    ------
    UserError
        If anything is illegal.
    """
    try:
        return HypothesisConfig.model_validate(data)
    except ValidationError as error:
        problems = error.errors(include_url=False)
        more = f" (and {len(problems) - 1} more)" if len(problems) > 1 else ""
        raise UserError(f"{where}: {_one_line(problems[0])}{more}") from None


def _one_line(problem: Any) -> str:
    location = [
        part for part in problem["loc"] if isinstance(part, int) or part in LEGAL or len(problem["loc"]) == 1
    ]
    location = list(problem["loc"]) if problem["type"] == "extra_forbidden" else location
    name = "".join(
        f"[{part + 1}]" if isinstance(part, int) else f".{part}" for part in location
    ).removeprefix(".")
    named = [part for part in location if isinstance(part, str)]
    if problem["type"] == "value_error":
        return (
            f"{name} = {problem['ctx']['error']}"
            if named[-1:] != ["point"]
            else f"{name}: {problem['ctx']['error']}"
        )
    value = repr(problem["input"])
    value = value if len(value) <= 60 else value[:57] + "..."
    if problem["type"] == "extra_forbidden":
        owner = {"map": MapConfig, "point": GivenPoint}.get(str(location[0]), HypothesisConfig)
        known = list((owner if len(location) > 1 else HypothesisConfig).model_fields)
        return f"{name} = {value}: unknown key; legal: {', '.join(known)}"
    if problem["type"] == "missing":
        return f"{name}: missing; legal: {LEGAL.get(named[-1], '')}"
    return f"{name} = {value}; legal: {LEGAL.get(named[-1] if named else '', problem['msg'])}"
