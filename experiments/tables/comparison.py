"""What moved between two finished runs of the same cells, by solver and by cell.

Both are read block by block, so that tables larger than the memory can be compared. A row is a cell and a solver. It
moved where its status is another one, where a velocity per abs(v0) or D differs by more than a tolerance, or where one
run has such a number and the other has none.
"""

from __future__ import annotations

import heapq
import math
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from impact_xval.experiments.config.errors import UserError
from impact_xval.experiments.config.experiment import REFERENCE
from impact_xval.experiments.tables.schema import LINE_PARAMETERS, LINES, PARAMETERS
from impact_xval.experiments.tables.store import RunFolder, layout_of
from impact_xval.experiments.tables.streams import blocks

Floats = NDArray[np.float64]

#: Rows that are listed as the worst.
LISTED = 10


@dataclass(slots=True)
class SolverChanges:
    """What became of the rows of one solver.

    Attributes
    ----------
    compared, moved, statuses : int
        Cells of both runs, those that moved, and those whose status is another one.
    velocity, divergence : float
        Largest change of a velocity per abs(v0), and of D, where both runs have a number.
    """

    compared: int = 0
    moved: int = 0
    statuses: int = 0
    velocity: float = 0.0
    divergence: float = 0.0


@dataclass(frozen=True, slots=True, order=True)
class Moved:
    """A row that moved; the worst is the largest.

    Attributes
    ----------
    status_changed : bool
    velocity, divergence : float
        Changes, infinite where one run alone has a number, 0 where neither has.
    before_it : int
        Minus the number of the cell, so that of equal rows the first is the worst.
    solver, status_a, status_b : str
    """

    status_changed: bool
    velocity: float
    divergence: float
    before_it: int
    solver: str
    status_a: str
    status_b: str

    @property
    def cell(self) -> int:
        """Number of the cell."""
        return -self.before_it


@dataclass(slots=True)
class Comparison:
    """What moved between two runs.

    Attributes
    ----------
    tolerance : float
        Changes above it count.
    solvers : dict
        Changes by solver, in the order of the first run.
    worst : list of Moved
        The worst rows, the worst first, at most `LISTED`.
    alone : list of str
        Solvers that one run alone has; nothing is compared of them.
    settings, versions : dict
        Of configurations and solvers, what differs: both values by name.
    """

    tolerance: float
    solvers: dict[str, SolverChanges]
    worst: list[Moved] = field(default_factory=list)
    alone: list[str] = field(default_factory=list)
    settings: dict[str, tuple[str, str]] = field(default_factory=dict)
    versions: dict[str, tuple[str, str]] = field(default_factory=dict)

    @property
    def moved(self) -> int:
        """Number of rows that moved."""
        return sum(each.moved for each in self.solvers.values())


def compare(a: RunFolder, b: RunFolder, tolerance: float) -> Comparison:
    """Compare two finished runs.

    Parameters
    ----------
    a, b : RunFolder
        Of two finished runs, of collisions or of columns of N balls both.
    tolerance : float
        Of velocities per abs(v0), and of D; 0 or more.

    Raises
    ------
    UserError
        If their cells are not the same, or a table is missing or damaged; one line that says where.
    """
    configs = a.config(), b.config()
    layout = layout_of(configs[0])
    if layout is not layout_of(configs[1]):
        kinds = ["columns of N balls" if layout_of(each) is LINES else "collisions" for each in configs]
        raise UserError(
            f"{a.root}: a run of {kinds[0]}, {b.root}: of {kinds[1]}; legal: two runs of one kind"
        )
    here, there = (set(each.solvers) for each in configs)
    both = [name for name in configs[0].solvers if name in there]
    plain, manifests = [each.canonical() for each in configs], (a.manifest(), b.manifest())
    found = Comparison(
        tolerance,
        {name: SolverChanges() for name in both},
        alone=sorted(here ^ there),
        settings=_differing(
            {key: value for key, value in plain[0].items() if key not in _ELSEWHERE}, plain[1]
        ),
        versions=_differing(manifests[0]["versions"], manifests[1]["versions"]),
    )
    lines = layout is LINES
    parameters = LINE_PARAMETERS if lines else PARAMETERS
    velocities = ("velocities",) if lines else ("v1", "v2")
    streams = []
    for folder in (a, b):
        cells = folder.table_path("cells.parquet", layout.cells)
        streams.append(blocks(cells, [*parameters, "solver", "status", *velocities]))
        divergence = folder.table_path("divergence.parquet", layout.divergence)
        streams.append(blocks(divergence, ["cell", "solver", "velocity_divergence"]))
    worst: list[Moved] = []
    for rows_a, away_a, rows_b, away_b in _in_step(streams):
        for name in both:
            mine, yours = _of(rows_a, name), _of(rows_b, name)
            _check_same(a, b, mine, yours, parameters)
            d = [_numbers(_of(away, name), "velocity_divergence") for away in (away_a, away_b)]
            if name == REFERENCE:
                d = [np.zeros(len(mine))] * 2
            moved = _count(found.solvers[name], name, mine, yours, velocities, _change(*d), tolerance)
            worst = heapq.nlargest(LISTED, [*worst, *moved])
    found.worst = worst
    return found


#: Settings that say nothing of what is compared: the cells are, one by one, and the solvers are named.
_ELSEWHERE = ("name", "workers", "grid", "sample", "cells", "column", "solvers", "chunk_size")


def _differing(a: dict[str, object], b: dict[str, object]) -> dict[str, tuple[str, str]]:
    return {key: (str(a[key]), str(b[key])) for key in a if key in b and a[key] != b[key]}


#: Rows of a table that has none left.
_NONE = pa.table({"cell": pa.array([], pa.int64()), "solver": pa.array([], pa.string())})


def _in_step(streams: list[Iterator[pa.Table]]) -> Iterator[list[pa.Table]]:
    """Give the rows of the same cells of several tables, wherever their blocks are cut.

    Where one has no rows left the others give theirs, which is then for the caller to refuse.
    """
    held = [_NONE] * len(streams)
    while True:
        held = [
            rest if len(rest) else next(stream, _NONE) for rest, stream in zip(held, streams, strict=True)
        ]
        ends = [rest.column("cell")[-1].as_py() for rest in held if len(rest)]
        if not ends:
            return
        cuts = [int(np.searchsorted(rest.column("cell").to_numpy(), min(ends), "right")) for rest in held]
        yield [rest.slice(0, cut) for rest, cut in zip(held, cuts, strict=True)]
        held = [rest.slice(cut) for rest, cut in zip(held, cuts, strict=True)]


def _of(table: pa.Table, solver: str) -> pa.Table:
    return table.filter(pc.field("solver") == solver)


def _numbers(table: pa.Table, name: str) -> Floats:
    if name not in table.column_names:
        return np.empty(0)
    return table.column(name).cast(pa.float64()).to_numpy().astype(float)


def _check_same(a: RunFolder, b: RunFolder, mine: pa.Table, yours: pa.Table, names: tuple[str, ...]) -> None:
    """Refuse two runs whose cells are not the same, to the last bit."""
    legal = "legal: two runs of the same cells"
    if len(mine) != len(yours):
        rows, shorter = (mine, b) if len(mine) > len(yours) else (yours, a)
        numbers = set((yours if rows is mine else mine).column("cell").to_pylist())
        first = next(cell for cell in rows.column("cell").to_pylist() if cell not in numbers)
        raise UserError(f"{shorter.root}: has no cell {first}, which the other run has; {legal}")
    for name in names:
        if mine.column(name).equals(yours.column(name)):
            continue
        pairs = zip(mine.column(name).to_pylist(), yours.column(name).to_pylist(), strict=True)
        for row, (x, y) in enumerate(pairs):
            if x != y:
                cell = mine.column("cell")[row].as_py()
                raise UserError(f"cell {cell}: {name} = {x!r} in {a.root}, {y!r} in {b.root}; {legal}")


def _count(
    changes: SolverChanges,
    solver: str,
    mine: pa.Table,
    yours: pa.Table,
    velocities: tuple[str, ...],
    divergence: Floats,
    tolerance: float,
) -> list[Moved]:
    """Count the rows of a solver, and give the worst of those that moved."""
    speed = np.abs(_numbers(mine, "v0"))
    velocity = np.max([_change_of(mine, yours, name) for name in velocities], axis=0, initial=0.0) / speed
    statuses = [table.column("status").to_pylist() for table in (mine, yours)]
    other = np.array([x != y for x, y in zip(*statuses, strict=True)], dtype=bool)
    moved = other | (velocity > tolerance) | (divergence > tolerance)
    changes.compared += len(mine)
    changes.moved += int(moved.sum())
    changes.statuses += int(other.sum())
    changes.velocity = max(changes.velocity, float(velocity[np.isfinite(velocity)].max(initial=0.0)))
    changes.divergence = max(changes.divergence, float(divergence[np.isfinite(divergence)].max(initial=0.0)))
    places = np.flatnonzero(moved)
    worst_first = np.lexsort((places, -divergence[places], -velocity[places], ~other[places]))
    cells = mine.column("cell").to_numpy()
    return [
        Moved(
            bool(other[i]),
            float(velocity[i]),
            float(divergence[i]),
            -int(cells[i]),
            solver,
            statuses[0][i],
            statuses[1][i],
        )
        for i in places[worst_first][:LISTED]
    ]


def _change_of(mine: pa.Table, yours: pa.Table, name: str) -> Floats:
    """Return the size of the change of a column of numbers, the largest of each row where it holds lists."""
    if not pa.types.is_list(mine.schema.field(name).type):
        return _change(_numbers(mine, name), _numbers(yours, name))
    lists = zip(mine.column(name).to_pylist(), yours.column(name).to_pylist(), strict=True)
    return np.array([_change_of_lists(x, y) for x, y in lists])


def _change_of_lists(x: list[float | None] | None, y: list[float | None] | None) -> float:
    if x is None or y is None or len(x) != len(y):
        return 0.0 if x == y else math.inf
    arrays = (np.array([math.nan if v is None else v for v in each], dtype=float) for each in (x, y))
    return float(_change(*arrays).max(initial=0.0))


def _change(x: Floats, y: Floats) -> Floats:
    """Return the sizes of changes: 0 between equal numbers and where neither is there, infinite where one is not."""
    missing_x, missing_y = np.isnan(x), np.isnan(y)
    with np.errstate(invalid="ignore"):
        size = np.where(x == y, 0.0, np.abs(x - y))
    return np.where(missing_x & missing_y, 0.0, np.where(missing_x ^ missing_y, math.inf, size))
