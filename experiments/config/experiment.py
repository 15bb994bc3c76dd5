"""An experiment as a validated TOML file.

Every key has a default, so an empty file is the built-in experiment. An illegal file gives one line that
names the file, the field, the value and what is legal (`load_config`, which raises `UserError`).
"""

from __future__ import annotations

import hashlib
import json
import math
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field, field_validator, model_validator

from impact_xval.compliant_baselines.states import SHORTEST_STATE
from impact_xval.experiments.config.arrangements import COLUMN_LEGAL, Arranged, ColumnTable
from impact_xval.experiments.config.axes import (
    LEGAL,
    MAX_CELLS,
    Axis,
    Sample,
    Strict,
    axis_length,
    axis_problem,
    expand_axis,
    whole,
)
from impact_xval.experiments.config.errors import (
    FieldName,
    dotted,
    hint,
    read_toml,
    short,
    validated,
)
from impact_xval.experiments.config.plain import plain_values, revive
from impact_xval.model.inputs import GRAZING_THRESHOLD, LEGAL_CUTOFF, Cutoff, legal_cutoff

#: What says which cells are computed; an experiment has one of them, without any the built-in grid.
DESIGNS = ("grid", "sample", "cells", "column")

#: Keys on which no row depends. The cells of a list are part of the identity of each chunk, wherever their file lies.
COSMETIC = ("name", "workers", "figure_cell", "figure_column", "cells")

#: The solver every other one is compared with; part of every run.
REFERENCE = "state-transition"

_Name = Annotated[str, Field(description="1 to 100 printable characters", min_length=1, max_length=100)]


def _parameter(name: str, default: float) -> Any:
    legal = LEGAL[name]
    return Field(default, ge=legal.low, le=legal.high, description=legal.text)


def _positive(default: float, unit: str) -> Any:
    return Field(default, gt=0, allow_inf_nan=False, description=f"a finite number > 0 ({unit})")


def _axis(name: str, default: Axis) -> Any:
    return Field(default, description=LEGAL[name].text)


class Cell(Strict):
    """One collision by its ratios; the numbers that decide an impact (Theorem 5)."""

    stiffness_ratio: float = _parameter("stiffness_ratio", 1.0)
    mass_ratio: float = _parameter("mass_ratio", 2 / math.sqrt(3))
    e1: float = _parameter("e1", 0.9)
    e2: float = _parameter("e2", 0.7)


class Grid(Strict):
    """Axes of the grid: each a list of numbers, ``{log = [lo, hi, n]}`` or ``{linear = [lo, hi, n]}``."""

    stiffness_ratio: Axis = _axis("stiffness_ratio", {"log": [1e-3, 1e3, 13]})
    mass_ratio: Axis = _axis("mass_ratio", [0.5, 2 / math.sqrt(3), 2.0])
    e1: Axis = _axis("e1", [0.5, 0.7, 0.9, 1.0])
    e2: Axis = _axis("e2", [0.5, 0.7, 0.9, 1.0])

    @field_validator(*LEGAL, mode="before")
    @classmethod
    def _legal_axis(cls, value: object, info: Any) -> object:
        problem = axis_problem(LEGAL[info.field_name], value)
        if problem:
            raise ValueError(problem)
        return value

    @model_validator(mode="after")
    def _affordable(self) -> Grid:
        cells = math.prod(self.lengths().values())
        if cells > MAX_CELLS:
            raise ValueError(f"the axes make {cells} cells; legal: 1 to {MAX_CELLS}")
        return self

    def axes(self) -> dict[str, list[float]]:
        """Values of every axis, in the order of the grid: the last axis varies fastest."""
        return {name: expand_axis(getattr(self, name)) for name in type(self).model_fields}

    def lengths(self) -> dict[str, int]:
        """Count the values of every axis, without making them."""
        return {name: axis_length(getattr(self, name)) for name in type(self).model_fields}


class ConvergenceTable(Strict):
    """How far engines are followed towards a step of zero, cell by cell."""

    enabled: bool = Field(True, description="true or false")
    tolerance: float = Field(1e-3, gt=0, le=1, description="greater than 0, at most 1 (of |v0|)")
    halvings: int = whole(4, 0, 10, " (of the step)")


class Config(Strict):
    """An experiment: what is computed, by which solvers and how."""

    #: Keys of earlier versions, and what there is instead.
    replaced: ClassVar[dict[str, str]] = {
        "min_run": "of version 0.2.0; legal: shortest_state, a share of the shorter contact period "
        "(3 steps of 0.001: 0.0025); a run that has it must be computed again, in another folder"
    }

    name: _Name = "default"
    scenario: Literal["impact", "drop"] = Field("drop", description="'impact' or 'drop'")
    gravity: float = _positive(9.81, "m/s^2")
    m1: float = _positive(1.0, "kg")
    k1: float = _positive(1e8, "N/m")
    v0: float = Field(
        -1.0, lt=0, allow_inf_nan=False, description="a finite number < 0 (m/s, up is positive)"
    )
    solvers: list[str] = Field(
        [REFERENCE, "bistiffness", "kelvin-voigt", "mujoco", "pybullet"],
        description="a list of names of solvers, each once",
    )
    step_fraction: float = Field(
        1e-3, gt=0, le=0.1, description="greater than 0, at most 0.1 (of a contact period)"
    )
    max_steps: int = Field(2_000_000, ge=1, le=10**12, description="a whole number >= 1")
    shortest_state: float = Field(
        SHORTEST_STATE, ge=0, le=0.1, description="from 0 to 0.1 (of the shorter contact period)"
    )
    mapping: Literal["calibrated", "naive"] = Field("calibrated", description="'calibrated' or 'naive'")
    stiffness_ratio_cutoff: Cutoff = Field("exact", description=LEGAL_CUTOFF)
    grazing_threshold: float = Field(GRAZING_THRESHOLD, ge=0, le=1, description="from 0 to 1")
    cell_timeout: float = Field(
        300.0, gt=0, le=1e6, allow_inf_nan=False, description="greater than 0, at most 1e6 (s of wall time)"
    )
    chunk_size: int | None = whole(None, 1, 100_000, " (cells)")
    workers: int | None = whole(None, 1, 4096)
    grid: Grid = Field(default_factory=Grid, description="a table of axes")
    sample: Sample | None = Field(None, description="a table: method, n, seed and ranges")
    cells: str | None = Field(None, min_length=1, description="the path of a CSV or Parquet file")
    column: ColumnTable | None = Field(
        None, description=f"a table of axes: arrangement, {', '.join(COLUMN_LEGAL)}"
    )
    convergence: ConvergenceTable = Field(
        default_factory=lambda: ConvergenceTable.model_validate({}),
        description="a table: enabled, tolerance, halvings",
    )
    figure_cell: Cell = Field(
        default_factory=Cell,
        description="a table: stiffness_ratio, mass_ratio, e1, e2",
    )
    figure_column: Arranged = Field(
        default_factory=lambda: Arranged.model_validate({}),
        description=f"a table: {', '.join(Arranged.model_fields)}",
    )

    @model_validator(mode="before")
    @classmethod
    def _columns_have_no_gravity(cls, data: Any) -> Any:
        if isinstance(data, dict) and data.get("column") is not None:
            return {"scenario": "impact"} | data
        return data

    @field_validator("name")
    @classmethod
    def _printable(cls, value: str) -> str:
        if not value.isprintable() or not value.strip():
            raise ValueError(f"{value!r}; legal: 1 to 100 printable characters")
        return value

    @field_validator("stiffness_ratio_cutoff", mode="plain")
    @classmethod
    def _cutoff(cls, value: Any) -> Cutoff:
        # Not the union's own validation: it would tell one mistake twice, once for each type.
        if not legal_cutoff(value):
            raise ValueError(f"{short(value)}; legal: {LEGAL_CUTOFF}")
        return "exact" if value == "exact" else float(value)

    @field_validator("solvers")
    @classmethod
    def _known_solvers(cls, value: list[str]) -> list[str]:
        problem = solvers_problem(value)
        if problem:
            raise ValueError(problem)
        # The reference leads, asked for or not: without it there is nothing to diverge from.
        return [REFERENCE, *(name for name in value if name != REFERENCE)]

    @model_validator(mode="after")
    def _within_double_precision(self) -> Config:
        ratios = self._ratios()
        for name, values in ratios.items():
            found = self.product_problem(name, values)
            if found:
                raise ValueError(found[1])
        if not 0 < self.m1 * abs(self.v0) < math.inf:
            raise ValueError(
                f"m1 = {self.m1!r} times |v0| = {abs(self.v0)!r} leaves double precision; "
                "legal: a finite product > 0 (the unit of impulses)"
            )
        for ratio in ratios["mass_ratio"]:
            problem = self.gravity_problem(ratio)
            if problem:
                raise ValueError(problem)
        return self

    def product_problem(self, name: str, ratios: ArrayLike) -> tuple[int, str] | None:
        """Find the first ratio whose mass or stiffness leaves double precision.

        Parameters
        ----------
        name : {"stiffness_ratio", "mass_ratio"}
        ratios : array_like, shape (n,)

        Returns
        -------
        tuple of int and str, or None
            Its place, and what is wrong with it.
        """
        base = self.k1 if name == "stiffness_ratio" else self.m1
        values = np.asarray(ratios, dtype=np.float64)
        with np.errstate(over="ignore", under="ignore"):
            products = values * base
        bad = (values > 0) & np.isfinite(values) & ~((products > 0) & np.isfinite(products))
        if not bad.any():
            return None
        first = int(np.argmax(bad))
        return first, (
            f"{name} = {float(values[first])!r} times {base!r} = {float(products[first])!r} leaves double precision; "
            "legal: a finite product > 0"
        )

    def _ratios(self) -> dict[str, list[float]]:
        """Ratios of the figures' cell and of the cells known so far: those of a list are read later."""
        ends = self.sample.ends() if self.sample is not None else {}
        # The built-in grid stands beside other designs too, and nothing computes it there.
        axes = self.grid.axes() if self.sample is None and self.cells is None and self.column is None else {}
        return {
            name: [
                *axes.get(name, []),
                getattr(self.figure_cell, name),
                *ends.get(name, ()),
            ]
            for name in ("stiffness_ratio", "mass_ratio")
        }

    @model_validator(mode="after")
    def _one_design(self) -> Config:
        given = [
            name for name in DESIGNS if name in self.model_fields_set and getattr(self, name) is not None
        ]
        if len(given) > 1:
            raise ValueError(f"{' and '.join(given)} are given; legal: one of {', '.join(DESIGNS)}")
        return self

    @model_validator(mode="after")
    def _of_one_kind(self) -> Config:
        if self.column is None:
            if "figure_column" in self.model_fields_set:
                raise ValueError("figure_column is given without column; legal: figure_cell")
            return self
        if "figure_cell" in self.model_fields_set:
            raise ValueError("figure_cell is given with column; legal: figure_column")
        if "gravity" in self.model_fields_set:
            raise ValueError(
                "gravity is given with column; legal: none, columns of N balls are solved without it"
            )
        if self.scenario != "impact":
            raise ValueError(
                f"scenario = {self.scenario!r}: columns of N balls are solved without gravity; "
                "legal with column: 'impact'"
            )
        problem = self.column.taper_problem(self.m1, self.k1)
        if problem:
            raise ValueError(problem)
        return self

    def gravity_number(self, m2: ArrayLike) -> NDArray[np.float64]:
        """Return g/(abs(v0) omega1), omega1 = sqrt(k1 (1/m1 + 1/m2)), of lower balls of m2 kg; 0 without gravity."""
        m2 = np.asarray(m2, float)
        if self.scenario == "impact":
            return np.zeros(m2.shape)
        with np.errstate(over="ignore", divide="ignore", invalid="ignore"):
            reduced_mass = self.m1 / (1 + self.m1 / m2)
            return self.gravity / (abs(self.v0) * np.sqrt(self.k1 / reduced_mass))

    def gravity_problem(self, mass_ratio: float) -> str | None:
        """Say that the gravity number at a mass ratio leaves double precision, or return None."""
        number = float(self.gravity_number(self.m1 * mass_ratio))
        if self.scenario == "impact" or 0 < number < math.inf:
            return None
        return (
            f"v0 = {self.v0!r}, with gravity = {self.gravity!r}, k1 = {self.k1!r}, m1 = {self.m1!r} and mass_ratio = "
            f"{mass_ratio!r}: g/(|v0| sqrt(k1 (1/m1 + 1/m2))) = {number!r} leaves double precision; "
            "legal: a finite number > 0"
        )

    def canonical(self) -> dict[str, Any]:
        """Return the configuration as plain JSON values; an infinity is the text ``"inf"``."""
        plain = plain_values(self.model_dump())
        of_others = ("column", "figure_column") if self.column is None else ("grid", "figure_cell", "gravity")
        if self.sample is not None or self.cells is not None:
            of_others = (*of_others, "grid")
        return {key: value for key, value in plain.items() if key not in of_others}

    def identity(self) -> str:
        """Hash of everything the cells' results depend on; not of names, figures or the number of workers."""
        plain = self.canonical()
        for cosmetic in COSMETIC:
            plain.pop(cosmetic, None)
        if "grid" in plain:
            plain["grid"] = plain_values(self.grid.axes())
        if self.column is not None:
            plain["column"] = [[name, self.column.axes(name)] for name in self.column.arrangement]
        return hashlib.sha256(json.dumps(plain, sort_keys=True).encode()).hexdigest()


def solvers_problem(names: list[str]) -> str | None:
    """Say what is wrong with a list of solver names, or return None."""
    from impact_xval.compliant_baselines import solver_names

    known = list(solver_names(on_request=True))
    for name in names:
        if name not in known:
            return f"{name!r} is not a solver{hint(name, known)}; legal: {', '.join(known)}"
        if names.count(name) > 1:
            return f"{name!r} is listed more than once; legal: each solver once"
    return None if names else f"[] is empty; legal: one or more of {', '.join(known)}"


def load_config(path: Path | str) -> Config:
    """Read an experiment from a TOML file.

    Raises
    ------
    UserError
        If the file cannot be read or holds anything illegal; one line with file, field, value and legal
        range.
    """
    path = Path(path)
    data = read_toml(path)
    if isinstance(data.get("cells"), str) and data["cells"]:
        data["cells"] = str(path.parent / data["cells"])  # beside the file that names it
    return parse_config(data, where=str(path))


def parse_config(data: dict[str, Any], where: str = "configuration", name: FieldName = dotted) -> Config:
    """Validate an experiment given as plain values.

    Parameters
    ----------
    data : dict
        As a TOML file holds it.
    where : str
        What an error begins with; the empty text leaves it out.
    name : callable
        How an error names a field.

    Raises
    ------
    UserError
        If anything is illegal.
    """
    return validated(Config, data, where, name)


def from_canonical(plain: dict[str, Any], where: str) -> Config:
    """Undo `Config.canonical`."""
    return parse_config(revive(plain), where)
