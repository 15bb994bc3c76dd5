"""Comparison of two finished runs of the same cells: the rows that moved, by solver and by cell.

A row is a cell and a solver. It moved where its status is another one, where a velocity per abs(v0) or D differs by
more than a tolerance, or where one run has such a number and the other has none.
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


@dataclass(frozen=True, slots=True)
class SolverChanges:
    """Changes of one solver between two runs."""

    #: Numbers of rows that were compared, that moved, and that have another status.
    compared: int
    moved: int
    statuses: int
    #: Largest change of a velocity per abs(v0), and of D, where both runs have a number.
    velocity: float
    divergence: float


class RowChange(NamedTuple):
    """Change of one row between two runs."""

    cell: int
    solver: str
    status_a: str
    status_b: str
    #: Largest change of a velocity per abs(v0), and that of D: infinite where one run alone has a number, 0 where
    #: neither has.
    velocity: float
    divergence: float


@dataclass(slots=True)
class RunComparison:
    """Changes between two runs that are larger than a tolerance."""

    tolerance: float
    #: By solver, in the order of the first run.
    solvers: dict[str, SolverChanges]
    #: The ten worst rows, the worst first.
    worst: list[RowChange]
    #: Solvers, and numbers of cells, that one run alone has.
    alone: list[str]
    cells_alone: list[int]
    #: Settings, and versions of solvers, that differ: both values by name.
    settings: dict[str, tuple[str, str]]
    versions: dict[str, tuple[str, str]]

    @property
    def moved(self) -> int:
        """Number of rows that moved."""
        return sum(changes.moved for changes in self.solvers.values())


def compare_runs(a: RunFolder, b: RunFolder, tolerance: float) -> RunComparison:
    """Compare two finished runs; a `UserError` says where a cell is not the same in both, or a table is damaged."""
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


#: What the cells of a kind are called.
_KINDS = {"pair": "collisions", "chain": "chains of N balls", "graph": "contact graphs"}

#: Settings that say nothing of what is compared: the cells are, one by one, and the solvers are named.
_ELSEWHERE = ("name", "workers", "grid", "sample", "cells", "chain", "graph", "solvers", "chunk_size")


def _differing(a: Mapping[str, object], b: Mapping[str, object]) -> dict[str, tuple[str, str]]:
    """Return the values of the keys that both have and in which they differ, as texts."""
    return {key: (str(a[key]), str(b[key])) for key in a if key in b and a[key] != b[key]}


def _read_compared_rows(run: RunFolder, solvers: Sequence[str]) -> Frame:
    """Read what is compared of a run: parameters, status, velocities and D of every cell and solver."""
    path = run.table_path("cells.parquet")
    names = pq.read_schema(path).names
    wanted = [
        *names[: names.index("status") + 1],
        *(name for name in names if re.fullmatch(r"v[1-9]\d*[xz]?", name)),
    ]
    chosen = [("solver", "in", list(solvers))]
    cells = pq.read_table(path, columns=wanted, filters=chosen).to_pandas()
    keys = ["cell", "solver"]
    path = run.table_path("divergence.parquet")
    d = pq.read_table(path, columns=[*keys, "velocity_divergence"], filters=chosen).to_pandas()
    return cells.merge(d, on=keys, how="left")


def _check_same_cells(a: RunFolder, b: RunFolder, rows: Frame) -> None:
    """Refuse two runs in which a cell of one number is not the same, to the last bit."""
    names = [name[:-2] for name in rows if name.endswith("_a")]
    for name in names[: names.index("status")]:
        x, y = rows[f"{name}_a"], rows[f"{name}_b"]
        differs = (x != y) & ~(x.isna() & y.isna())
        if differs.any():
            i = differs.idxmax()
            where = f"cell {rows.cell[i]}: {name} = {x[i]} in {a.root}, {y[i]} in {b.root}"
            raise UserError(f"{where}; legal: two runs of the same cells")


def _sizes_of_changes(rows: Frame, name: str) -> Frame:
    """Return the sizes of changes: 0 between equal numbers and where neither is there, infinite where one is not."""
    x, y = rows[f"{name}_a"], rows[f"{name}_b"]
    size = (x - y).abs().mask(x == y, 0.0)
    return size.mask(x.isna() & y.isna(), 0.0).mask(x.isna() ^ y.isna(), np.inf)
