"""Comparison of two finished runs of the same cells, for the command `impact-xval compare`.

A row holds the result of one solver in one cell. A row is said to have moved if

* the two runs have different statuses in it,
* a final velocity per abs(v0), or the divergence D from the model, differs by more than a tolerance, or
* only one of the two runs has such a velocity or D.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import pyarrow.parquet as pq

from impact_xval.experiments.config.errors import UserError
from impact_xval.experiments.tables.folder import RunFolder
from impact_xval.experiments.tables.frames import Frame
from impact_xval.experiments.tables.parquet import read_table


@dataclass(frozen=True, slots=True)
class SolverChanges:
    """Changes of the results of one solver between two runs."""

    #: Number of rows that were compared, number of rows that moved, and number of rows whose status changed.
    compared: int
    moved: int
    statuses: int
    #: Largest change of a velocity per abs(v0), and largest change of D, over the rows in which both runs have a
    #: number.
    velocity: float
    divergence: float


class RowChange(NamedTuple):
    """Change of one row between two runs. A row holds the result of one solver in one cell."""

    cell: int
    solver: str
    status_a: str
    status_b: str
    #: Largest change of a velocity per abs(v0), and change of D. A change is infinite where only one run has the
    #: number, and 0 where neither run has it.
    velocity: float
    divergence: float


@dataclass(slots=True)
class RunComparison:
    """Changes between two runs that are larger than a tolerance."""

    tolerance: float
    #: Changes of each solver that both runs have, in the order of the first run.
    solvers: dict[str, SolverChanges]
    #: The ten rows that changed most. Rows with another status come first, then rows with the largest changes.
    worst: list[RowChange]
    #: Names of the solvers that only one of the two runs has, and numbers of the cells that only one run has.
    alone: list[str]
    cells_alone: list[int]
    #: Settings and versions of solvers that differ between the runs. For each name, the two values.
    settings: dict[str, tuple[str, str]]
    versions: dict[str, tuple[str, str]]

    @property
    def moved(self) -> int:
        """Number of rows that moved."""
        return sum(changes.moved for changes in self.solvers.values())


def compare_runs(a: RunFolder, b: RunFolder, tolerance: float) -> RunComparison:
    """Return the changes between two finished runs of the same cells.

    Raises
    ------
    UserError
        If the runs are of different kinds, a cell differs between the runs, or a table is damaged.
    """
    config_a, config_b = a.config(), b.config()
    kinds = [_KINDS[config.kind] for config in (config_a, config_b)]
    if kinds[0] != kinds[1]:
        raise UserError(
            f"{a.root}: a run of {kinds[0]}, {b.root}: of {kinds[1]}; legal: two runs of one kind"
        )
    both = [name for name in config_a.solvers if name in config_b.solvers]
    of_a, of_b = _read_compared_rows(a, both), _read_compared_rows(b, both)
    rows = of_a.merge(of_b, on=["cell", "solver"], suffixes=("_a", "_b"))
    _check_same_cells(a, b, rows)
    velocities = sorted(name[:-2] for name in rows if re.fullmatch(r"v[1-9]\d*[xz]?_a", name))
    speed = rows.v0_a.abs()
    rows["velocity"] = np.max(
        [_sizes_of_changes(rows, name) / speed for name in velocities], axis=0, initial=0.0
    )
    rows["divergence"] = _sizes_of_changes(rows, "velocity_divergence")
    rows["other"] = rows.status_a != rows.status_b
    rows["moved"] = rows.other | (rows.velocity > tolerance) | (rows.divergence > tolerance)
    changes = (
        rows.replace({"velocity": np.inf, "divergence": np.inf}, 0.0)
        .groupby("solver")
        .agg(
            compared=("cell", "size"),
            moved=("moved", "sum"),
            statuses=("other", "sum"),
            velocity=("velocity", "max"),
            divergence=("divergence", "max"),
        )
    )
    worst = rows[rows.moved].sort_values(
        ["other", "velocity", "divergence", "cell"], ascending=[False, False, False, True], kind="stable"
    )
    settings = ({k: v for k, v in c.canonical().items() if k not in _ELSEWHERE} for c in (config_a, config_b))
    return RunComparison(
        tolerance,
        {name: SolverChanges(**numbers) for name, numbers in changes.loc[both].to_dict("index").items()},
        worst=[RowChange(*row) for row in worst[[*RowChange._fields]].head(10).itertuples(index=False)],
        alone=sorted({*config_a.solvers} ^ {*config_b.solvers}),
        cells_alone=np.setxor1d(of_a.cell, of_b.cell).tolist(),
        settings=_differing(*settings),
        versions=_differing(a.manifest()["versions"], b.manifest()["versions"]),
    )


#: Words for the cells of a run in messages, by the kind of the cells.
_KINDS = {"pair": "collisions", "chain": "chains of N balls", "graph": "contact graphs"}

#: Settings whose differences are not listed. Some of these settings choose the cells and the solvers, which are
#: compared separately. The others do not influence any result.
_ELSEWHERE = ("name", "workers", "grid", "sample", "cells", "chain", "graph", "solvers", "chunk_size")


def _differing(a: Mapping[str, object], b: Mapping[str, object]) -> dict[str, tuple[str, str]]:
    """Return the keys whose values differ between two mappings, with both values as texts.

    Only keys that both mappings have are compared.
    """
    return {key: (str(a[key]), str(b[key])) for key in a if key in b and a[key] != b[key]}


def _read_compared_rows(run: RunFolder, solvers: Sequence[str]) -> Frame:
    """Read the columns of a run that a comparison needs: parameters, status, velocities and D of every row."""
    path = run.table_path("cells.parquet")
    names = pq.read_schema(path).names
    wanted = [
        *names[: names.index("status") + 1],
        *(name for name in names if re.fullmatch(r"v[1-9]\d*[xz]?", name)),
    ]
    chosen = [("solver", "in", list(solvers))]
    cells = read_table(path, wanted, chosen).to_pandas()
    keys = ["cell", "solver"]
    path = run.table_path("divergence.parquet")
    d = read_table(path, [*keys, "velocity_divergence"], chosen).to_pandas()
    return cells.merge(d, on=keys, how="left")


def _check_same_cells(a: RunFolder, b: RunFolder, rows: Frame) -> None:
    """Raise a `UserError` if a cell of both runs has a parameter that differs between the runs in any bit."""
    names = [name[:-2] for name in rows if name.endswith("_a")]
    for name in names[: names.index("status")]:
        x, y = rows[f"{name}_a"], rows[f"{name}_b"]
        differs = (x != y) & ~(x.isna() & y.isna())
        if differs.any():
            i = differs.idxmax()
            where = f"cell {rows.cell[i]}: {name} = {x[i]} in {a.root}, {y[i]} in {b.root}"
            raise UserError(f"{where}; legal: two runs of the same cells")


def _sizes_of_changes(rows: Frame, name: str) -> Frame:
    """Return the absolute change of a column between two runs in every row.

    A change is 0 where neither run has the number, and infinite where only one run has it.
    """
    x, y = rows[f"{name}_a"], rows[f"{name}_b"]
    size = (x - y).abs().mask(x == y, 0.0)
    return size.mask(x.isna() & y.isna(), 0.0).mask(x.isna() ^ y.isna(), np.inf)
