"""Configuration of an experiment: the validated content of its TOML file.

Every key has a default, so an empty file is the built-in experiment. `load_config` reads a file, and `parse_config`
validates values that are given as a dictionary. Almost every other module of `experiments` takes the `Config` that they
return.
"""

from __future__ import annotations

import hashlib
import itertools
import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Literal, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import AfterValidator, Field, ValidationInfo, field_validator, model_validator

from impact_xval.compliant_baselines.states import SHORTEST_STATE
from impact_xval.experiments.config.arrangements import CHAIN_AXES, ChainGrid, ChainSetup
from impact_xval.experiments.config.axes import (
    AXES,
    KEPT,
    LEGAL,
    RATIO_OF,
    SI_AXES,
    Axes,
    Axis,
    Sample,
    Strict,
    at_most_field,
    expand_axis,
    legal_field,
    positive_field,
    table_field,
    whole_field,
)
from impact_xval.experiments.config.errors import UserError, hint, is_table, read_toml, shorten, validate
from impact_xval.experiments.config.graphs import GRAPH_AXES, GraphGrid, named_graph
from impact_xval.experiments.config.renamed import EXPERIMENT_KEYS, rename_keys
from impact_xval.model.inputs import GRAZING_THRESHOLD, LEGAL_CUTOFF, V0, Cutoff, legal_cutoff

#: Keys that decide which cells are computed. An experiment has at most one of these keys. If it has none of them, its
#: cells are those of the built-in grid.
DESIGNS = ("grid", "sample", "cells", "chain", "graph")

#: Kind of the cells of an experiment, the same for all of them: two balls on a table, a chain of N balls, or a contact
#: graph.
CellKind = Literal["pair", "chain", "graph"]

#: Axes by which the cells of each kind are grouped, each with its name in tables and figures.
AXES_OF: Mapping[CellKind, Mapping[str, str]] = {"pair": AXES, "chain": CHAIN_AXES, "graph": GRAPH_AXES}

#: Word for the cells of each kind, in the plural.
NOUN_OF: Mapping[CellKind, str] = {"pair": "cells", "chain": "chains", "graph": "graphs"}

#: Keys on which no row of the tables depends. The path of a file of cells is among these keys, because the identity of
#: a chunk contains the values in the file and not the place of the file.
COSMETIC = ("name", "workers", "figure_cell", "figure_chain", "cells")

#: Name of the model. Every other solver is compared with the model, and the model is part of every run.
REFERENCE = "state-transition"

_NAME = "1 to 100 printable characters"

_Values = TypeVar("_Values")


def _check_known(names: list[str], info: ValidationInfo) -> list[str]:
    if info.context != KEPT and (problem := solvers_problem(names)):
        raise ValueError(problem)
    return names


Solvers = Annotated[
    list[str], AfterValidator(_check_known), Field(description="a list of names of solvers, each once")
]


class Cell(Strict):
    """Ratios and restitutions of one collision of two balls, which decide the outcome of an impact (Theorem 5)."""

    stiffness_ratio: float = legal_field(LEGAL["stiffness_ratio"], 1.0)
    mass_ratio: float = legal_field(LEGAL["mass_ratio"], 2 / math.sqrt(3))
    e1: float = legal_field(LEGAL["e1"], 0.9)
    e2: float = legal_field(LEGAL["e2"], 0.7)


class Grid(Axes):
    """Axes of a grid of pairs; the first axis varies slowest.

    `e` gives both restitutions the same values. `m2` and `k2` are in SI units and replace the ratios m2/m1 and k2/k1.
    `m1` and `k1` replace the values above the tables of the file.
    """

    stiffness_ratio: Axis = Field(default={"log": [1e-3, 1e3, 13]})
    k1: Axis | None = Field(None)
    k2: Axis | None = Field(None)
    mass_ratio: Axis = Field(default=[0.5, 2 / math.sqrt(3), 2.0])
    m1: Axis | None = Field(None)
    m2: Axis | None = Field(None)
    e1: Axis = Field(default=[0.5, 0.7, 0.9, 1.0])
    e2: Axis = Field(default=[0.5, 0.7, 0.9, 1.0])
    e: Axis | None = Field(None)

    @model_validator(mode="after")
    def _check_ties(self) -> Grid:
        for name in ("e1", "e2"):
            if self.e is not None and name in self.model_fields_set:
                raise ValueError(f"e is given with {name}; legal: e for both, or e1 and e2")
        for ratio, (quantity, _) in RATIO_OF.items():
            if getattr(self, quantity) is not None and ratio in self.model_fields_set:
                raise ValueError(f"{quantity} is given with {ratio}; legal: one of both")
        return self

    @property
    def replaced_axes(self) -> set[str]:
        """Names of the axes that are not used because other axes are given in their place."""
        ratios = {ratio for ratio, (quantity, _) in RATIO_OF.items() if getattr(self, quantity) is not None}
        return ratios if self.e is None else {*ratios, "e1", "e2"}

    @property
    def in_si(self) -> list[str]:
        """Names of the axes that are given in SI units."""
        return [name for name in SI_AXES if getattr(self, name) is not None]

    def varied(self) -> dict[str, list[float]]:
        """Return the values of every axis in use; the last axis varies fastest. `e` counts as one axis."""
        axes = ((name, axis) for name, axis in self if axis is not None)
        return {name: expand_axis(axis) for name, axis in axes if name not in self.replaced_axes}

    def axes(self) -> dict[str, list[float]]:
        """Return the values of every parameter, with `e1` and `e2` in the place of `e`."""
        return split_restitution(self.varied())


def _extremes(values: list[float]) -> list[float]:
    return sorted({min(values), max(values)})


def _check_ratios(
    ratio: str, quantity: str, ratios: list[float], values: list[float], unit: str, scale: float
) -> None:
    """Raise a ValueError if a ratio of a quantity in SI units is illegal, or over- or underflows.

    `ratios` are the values of `quantity`, such as k2, divided by `scale`. `scale` is the value of `unit`, such as k1.
    """
    for value, made in zip(values, ratios, strict=True):
        limit = value == 0 or math.isinf(value)
        if not LEGAL[ratio].includes(made) or (not limit and (made == 0 or math.isinf(made))):
            given = f"{quantity} = {value!r} with {unit} = {scale!r}: {ratio} = {made!r}"
            raise ValueError(f"{given}; legal: {LEGAL[ratio].text}, within double precision")


def split_restitution(values: Mapping[str, _Values]) -> dict[str, _Values]:
    """Return values by parameter, with `e1` and `e2` in the place of `e` if `e` is one of the parameters."""
    others = {name: each for name, each in values.items() if name != "e"}
    return others | ({"e1": values["e"], "e2": values["e"]} if "e" in values else {})


class ConvergenceTable(Strict):
    """Settings of the additional runs of an engine at shorter time steps.

    From these runs the engine's limit at a step of zero is extrapolated in every cell.
    """

    enabled: bool = Field(True, description="true or false")
    tolerance: float = at_most_field(1e-3, 1, "of |v0|")
    halvings: int = whole_field(4, 0, 10, " (of the step)")


class Config(Strict):
    """Configuration of an experiment: which cells are solved, by which solvers, and with which settings."""

    name: str = Field("default", description=_NAME)
    scenario: Literal["impact", "drop"] = Field("drop", description="'impact' or 'drop'")
    gravity: float = positive_field(9.81, "m/s^2")
    m1: float = positive_field(1.0, "kg")
    k1: float = positive_field(1e8, "N/m")
    v0: float = legal_field(V0, -1.0)
    solvers: Solvers = Field([REFERENCE, "bistiffness", "kelvin-voigt", "mujoco", "pybullet"])
    step_fraction: float = at_most_field(1e-3, 0.2, "of a contact period")
    max_steps: int = Field(2_000_000, ge=1, le=10**12, description="a whole number >= 1")
    shortest_state: float = Field(
        SHORTEST_STATE, ge=0, le=0.1, description="from 0 to 0.1 (of the shorter contact period)"
    )
    mapping: Literal["calibrated", "naive"] = Field("calibrated", description="'calibrated' or 'naive'")
    stiffness_ratio_cutoff: Cutoff = Field("exact", description=LEGAL_CUTOFF)
    grazing_threshold: float = Field(GRAZING_THRESHOLD, ge=0, le=1, description="from 0 to 1")
    measures: Literal["all", "velocities"] = Field(
        "all",
        description="'all', or 'velocities' (without impulse curves, marks and ladders; several times faster)",
    )
    cell_timeout: float = at_most_field(300.0, 1e6, "s of wall time")
    chunk_size: int | None = whole_field(None, 1, 100_000, " (cells)")
    workers: int | None = whole_field(None, 1, 4096)
    grid: Grid = table_field(Grid)
    sample: Sample | None = Field(None, description="a table: n, seed and ranges")
    cells: str | None = Field(None, min_length=1, description="the path of a CSV or Parquet file")
    chain: ChainGrid | None = Field(None, description=f"a table: {', '.join(ChainGrid.model_fields)}")
    graph: GraphGrid | None = Field(None, description=f"a table: {', '.join(GraphGrid.model_fields)}")
    convergence: ConvergenceTable = table_field(ConvergenceTable)
    figure_cell: Cell = table_field(Cell)
    figure_chain: ChainSetup = table_field(ChainSetup)

    @model_validator(mode="before")
    @classmethod
    def _only_pairs_have_gravity(cls, data: object, info: ValidationInfo) -> object:
        data = rename_keys(data, EXPERIMENT_KEYS, warn=info.context != KEPT)
        if is_table(data) and (data.get("chain") is not None or data.get("graph") is not None):
            return {"scenario": "impact", **data}
        return data

    @field_validator("name")
    @classmethod
    def _printable(cls, value: str) -> str:
        if not value.isprintable() or not value.strip() or len(value) > 100:
            raise ValueError(f"{shorten(value)}; legal: {_NAME}")
        return value

    @field_validator("stiffness_ratio_cutoff", mode="before")
    @classmethod
    def _cutoff(cls, value: object) -> object:
        # This validator runs before the validation of pydantic, which would report one mistake twice, once for each
        # type of the union.
        if not legal_cutoff(value):
            raise ValueError(f"{shorten(value)}; legal: {LEGAL_CUTOFF}")
        return value

    @field_validator("solvers")
    @classmethod
    def _reference_first(cls, value: list[str]) -> list[str]:
        # The model is added if the file does not name it: other solvers are compared with it.
        return [REFERENCE, *(name for name in value if name != REFERENCE)]

    @model_validator(mode="after")
    def _one_design(self) -> Config:
        given = self.model_fields_set
        designs = [name for name in DESIGNS if name in given and getattr(self, name) is not None]
        for name in self.grid.in_si:
            if name in given:
                raise ValueError(f"{name} is given above every [table] and in [grid]; legal: one of both")
        if len(designs) > 1:
            raise ValueError(f"{' and '.join(designs)} are given; legal: one of {', '.join(DESIGNS)}")
        with_or_without = "without chain" if self.kind == "pair" else f"with {self.kind}"
        for name, legal in self._keys_of_others().items():
            if name in given:
                raise ValueError(f"{name} is given {with_or_without}; legal: {legal}")
        if self.kind != "pair" and self.scenario != "impact":
            raise ValueError(
                f"scenario = {self.scenario!r}: {NOUN_OF[self.kind]} have no gravity; legal: 'impact'"
            )
        if "gravity" in given and self.scenario == "impact":
            raise ValueError(f"gravity = {self.gravity:g}: scenario = 'impact' has none; legal: with 'drop'")
        return self

    def _keys_of_others(self) -> dict[str, str]:
        """Return the keys that only other kinds of cells may have, each with a text that says what is legal instead."""
        match self.kind:
            case "pair":
                return {"figure_chain": "figure_cell"}
            case "chain":
                return {"figure_cell": "figure_chain", "gravity": "none, chains are solved without it"}
            case "graph":
                none = "none, no single graph is drawn"
                without = "none, graphs are solved without it"
                return {"figure_cell": none, "figure_chain": none, "gravity": without}

    @model_validator(mode="after")
    def _computable(self) -> Config:
        # If the experiment has a sample, a file, chains or graphs, the built-in grid is neither computed nor checked.
        ends: dict[str, list[float]] = {}
        if self.cells is None and self.kind == "pair":
            ends = self.grid.axes() if self.sample is None else self.sample.ends()
        for m1, k1 in itertools.product(
            *(_extremes(ends.get(name, [own])) for name, own in self.scales.items())
        ):
            below = {"m1": m1, "k1": k1}
            ratios: list[list[float]] = []
            for ratio, (quantity, unit) in RATIO_OF.items():
                if quantity in ends:
                    values = [value / below[unit] for value in ends[quantity]]
                    _check_ratios(ratio, quantity, values, ends[quantity], unit, below[unit])
                else:
                    values = ends.get(ratio, [])
                ratios.append([*values, getattr(self.figure_cell, ratio)])
            if found := self.beyond_precision(*ratios, m1=m1, k1=k1):
                raise ValueError(found[1])
        for corner in self.chain.corners() if self.chain else ():
            validate(ChainSetup, corner | {"m": self.m1, "k": self.k1, "v0": self.v0}, "chain")
        for name, numbers in self.graph.corners() if self.graph else ():
            try:
                named_graph(name, numbers, self.m1, self.k1, self.v0)
            except ValueError as error:
                scales = f"m1 = {self.m1!r}, k1 = {self.k1!r}, v0 = {self.v0!r}"
                raise ValueError(f"graph: {name} with {scales}: {error}") from None
        return self

    @property
    def kind(self) -> CellKind:
        """Kind of every cell of the experiment."""
        return "chain" if self.chain is not None else "graph" if self.graph is not None else "pair"

    @property
    def scales(self) -> dict[str, float]:
        """Mass m1 in kg and stiffness k1 in N/m of the one pair of balls that the figures show.

        They are the first values of the axes m1 and k1 if the grid has these axes. Otherwise they are the values that
        the file gives above its tables.
        """
        axes = self.grid.axes() if "grid" in self.model_fields_set else {}
        return {name: axes[name][0] if name in axes else getattr(self, name) for name in ("m1", "k1")}

    def beyond_precision(
        self,
        stiffness_ratios: ArrayLike,
        mass_ratios: ArrayLike,
        m1: float | None = None,
        k1: float | None = None,
    ) -> tuple[int, str] | None:
        """Find the first ratio with which a number of a cell over- or underflows; return its index and a message.

        Return None if there is no such ratio. m1 is in kg and k1 in N/m. By default m1 and k1 of the experiment are
        used.
        """
        k, m = np.asarray(stiffness_ratios, float), np.asarray(mass_ratios, float)
        m1, k1 = self.m1 if m1 is None else m1, self.k1 if k1 is None else k1
        v0 = np.array([self.v0])
        with np.errstate(over="ignore", under="ignore"):
            numbers = [
                ("stiffness_ratio", k, "k2", k1 * k),
                ("mass_ratio", m, "m2", m1 * m),
                ("v0", v0, "m1 |v0|", m1 * abs(v0)),
            ]
            if self.scenario == "drop":
                number = self.gravity_number(m1 * m, m1, k1)
                numbers.append(("mass_ratio", m, "g/(|v0| sqrt(k1 (1/m1 + 1/m2)))", number))
        for name, given, what, made in numbers:
            limit = (given == 0) | np.isinf(given)
            for i in np.flatnonzero(~limit & ~((made > 0) & np.isfinite(made)))[:1].tolist():
                scales = f"m1 = {m1!r}, k1 = {k1!r}, v0 = {self.v0!r}, gravity = {self.gravity!r}"
                wrong = f"{name} = {float(given[i])!r} with {scales}: {what} = {float(made[i])!r}"
                return i, f"{wrong} leaves double precision; legal: a finite number > 0"
        return None

    def gravity_number(self, m2: ArrayLike, m1: ArrayLike, k1: ArrayLike) -> NDArray[np.float64]:
        """Return the gravity number g/(abs(v0) omega1) of pairs, with omega1 = sqrt(k1 (1/m1 + 1/m2)).

        omega1 is the frequency of contact 1, between the balls. The number is 0 without gravity. Masses are in kg, k1
        in N/m.
        """
        m2, m1, k1 = (np.asarray(each, float) for each in (m2, m1, k1))
        if self.scenario == "impact":
            return np.zeros(m2.shape)
        with np.errstate(over="ignore", divide="ignore", invalid="ignore"):
            reduced_mass = m1 / (1 + m1 / m2)
            return self.gravity / (abs(self.v0) * np.sqrt(k1 / reduced_mass))

    def size(self) -> str:
        """Return a text that tells the number of cells, and the number of values on each axis.

        The text says of an axis if it has its default values. The text is empty for a sample and for a file of cells.
        """
        if self.sample is not None or self.cells is not None:
            return ""
        table = self.chain or self.graph or self.grid
        axes = (
            f"{len(values)} of {name}" + ("" if name in table.model_fields_set else " (default)")
            for name, values in table.varied().items()
        )
        return f"{table.count()} {NOUN_OF[self.kind]}; values on each axis: {', '.join(axes)}"

    def _as_written(self) -> dict[str, object]:
        """Return the values of all keys that apply to this experiment, in the form that they have in a TOML file."""
        left_out: dict[str, set[str] | bool] = (
            {"grid": self.grid.replaced_axes} if self.grid.replaced_axes else {}
        )
        if self.graph is not None and self.graph.unused_axes:
            left_out["graph"] = self.graph.unused_axes
        of_others = {"grid", "figure_cell", "figure_chain", "gravity"}
        of_others -= {
            "pair": {"grid", "figure_cell", "gravity"},
            "chain": {"figure_chain"},
            "graph": set[str](),
        }[self.kind]
        of_others |= {name for name in self.grid.in_si if name in ("m1", "k1")}
        if self.sample is not None or self.cells is not None:
            of_others.add("grid")
        if self.scenario == "impact":
            of_others.add("gravity")
        return self.model_dump(exclude=left_out | dict.fromkeys(of_others, True), exclude_none=True)

    def canonical(self) -> dict[str, object]:
        """Return the configuration as plain JSON values, with the text ``"inf"`` for infinity."""
        return _plain(self._as_written())

    def toml(self) -> str:
        """Return the configuration as the text of a TOML file; the path of a file of cells is absolute in it."""
        import tomli_w

        listed = {} if self.cells is None else {"cells": str(Path(self.cells).resolve())}
        return tomli_w.dumps(self._as_written() | listed)

    def identity(self) -> str:
        """Return a hash of all keys that the results of cells depend on.

        Keys such as the name, the figures and the number of workers (`COSMETIC`) do not change the hash.
        """
        plain = {key: value for key, value in self.canonical().items() if key not in COSMETIC}
        if "grid" in plain:
            plain["grid"] = _plain(self.grid.varied())
        if self.chain is not None:
            plain["chain"] = [[name, self.chain.axes(name)] for name in self.chain.arrangement]
        if self.graph is not None:
            plain["graph"] = _plain({name: self.graph.axes(name) for name in self.graph.name})
        return hashlib.sha256(json.dumps(plain, sort_keys=True).encode()).hexdigest()


def _plain(table: Mapping[str, object]) -> dict[str, object]:
    """Return a table as plain JSON values, with the text ``"inf"`` for infinity."""
    return json.loads(json.dumps(table), parse_constant=lambda _: "inf")


def solvers_problem(names: list[str]) -> str | None:
    """Return a message that says what is wrong with a list of solver names, or None if the list is legal."""
    from impact_xval.compliant_baselines import solver_names

    known = list(solver_names(on_request=True))
    for name in names:
        if name not in known:
            return f"{name!r} is not a solver{hint(name, known)}; legal: {', '.join(known)}"
        if names.count(name) > 1:
            return f"{name!r} is listed more than once; legal: each solver once"
    return None if names else f"[] is empty; legal: one or more of {', '.join(known)}"


def load_config(path: Path | str, context: str = "") -> Config:
    """Return the experiment that a TOML file describes.

    If the file gives no name, the experiment has the name of the file.

    The context is `KEPT` if the file belongs to the folder of a run. If a value is illegal, a `UserError` names the
    file, the field, the value and the legal values.
    """
    path = Path(path)
    data = {"name": path.stem, **read_toml(path)}
    cells = data.get("cells")
    if isinstance(cells, str) and cells:
        data["cells"] = str(path.parent / cells)  # the path is relative to the folder of the TOML file
        if context != KEPT and not (path.parent / cells).is_file():
            raise UserError(f"{path}: cells = {data['cells']!r}: no such file; legal: a CSV or Parquet file")
    return validate(Config, data, str(path), context=context)


def parse_config(data: Mapping[str, object], where: str = "configuration") -> Config:
    """Return the experiment with the given keys and values, which have the form that they have in a TOML file.

    If a value is illegal, a `UserError` says what is legal. Its message begins with the text `where`.
    """
    return validate(Config, data, where)
