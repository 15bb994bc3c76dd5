"""Cells of an experiment: the collisions that are solved, numbered from 0.

The cells come from a grid, a sample (`scipy.stats.qmc`), a file with a list, or the axes of chains or contact graphs.
The same configuration always gives the same cells. They are made in blocks, so that ten million cells are never in
memory at once.

`experiment_cells` needs a validated `Config`. The package `sweep` solves the cells that it returns.
"""

from __future__ import annotations

import hashlib
import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa
import pyarrow.csv as pacsv
import pyarrow.parquet as pq
from numpy.typing import NDArray

from impact_xval.compliant_baselines.registry import is_engine
from impact_xval.experiments.config.arrangements import ChainSetup, chain_setup_values
from impact_xval.experiments.config.axes import AXES, LEGAL, MAX_CELLS, RATIO_OF, Sample
from impact_xval.experiments.config.errors import UserError
from impact_xval.experiments.config.experiment import Cell, Config, split_restitution
from impact_xval.experiments.config.graphs import GRAPH_AXES, named_graph
from impact_xval.model.collision import Collision
from impact_xval.model.collisions import Collisions
from impact_xval.model.graph.collision import GraphCollision

if TYPE_CHECKING:
    from scipy.stats import qmc

#: Columns by name, each an array of shape (n,). The dtype is not fixed here, because a column may hold numbers or
#: texts.
ColumnArrays = dict[str, NDArray[Any]]

#: Numbers of cells in a chunk. `_CHUNK`: pairs with an engine among the solvers; `_CHAINS_CHUNK`: chains or graphs with
#: an engine. Such a chunk is a few seconds of work. `_QUICK_CHUNK`: the largest number if no engine is among the
#: solvers. With it a million cells make a thousand parts, the files with the rows of one chunk each.
_CHUNK, _CHAINS_CHUNK, _QUICK_CHUNK = 16, 4, 1024

#: Largest number of chunks of a run. With more cells, the chunks become larger.
_MOST_CHUNKS = 10_000


@dataclass(frozen=True, slots=True)
class CellBlock:
    """Block of consecutive cells of an experiment."""

    #: Number of each cell in the experiment, shape (n,).
    index: NDArray[np.int64]
    #: Parameters of the cells by name, shape (n,) each. The names are columns of the tables (`tables.schema`).
    parameters: ColumnArrays
    #: Collision of each cell, as a `Collisions` if the number of balls, the table and the exponent are the same in all
    #: cells. Empty for contact graphs.
    collisions: Sequence[Collision]
    #: Contact graph of each cell; empty for pairs and chains.
    graphs: Sequence[GraphCollision] = ()

    def __len__(self) -> int:
        return len(self.index)

    def __getitem__(self, place: slice) -> CellBlock:
        parameters = {name: values[place] for name, values in self.parameters.items()}
        return CellBlock(self.index[place], parameters, self.collisions[place], self.graphs[place])


@dataclass(frozen=True, slots=True)
class ExperimentCells:
    """All cells of an experiment in order, and their division into chunks."""

    config: Config
    count: int
    #: Function that returns the values of the n cells in a range, by the name of the axis, each of shape (n,).
    values: Callable[[range], ColumnArrays]
    #: SHA-256 of all values of the cells if they come from a sample or a file; otherwise an empty text.
    digest: str = ""

    def __len__(self) -> int:
        return self.count

    def block(self, indices: range) -> CellBlock:
        """Return the cells of a range of numbers as a block."""
        config, parameters = self.config, self.values(indices)
        collisions: Sequence[Collision] = ()
        graphs: Sequence[GraphCollision] = ()
        for name in ("m1", "k1", "v0"):
            parameters.setdefault(name, np.full(len(indices), getattr(config, name)))
        if config.kind == "graph":
            graphs = _make_graphs(parameters)
        elif config.kind == "pair":
            parameters = split_restitution(parameters)
            for ratio, (quantity, unit) in RATIO_OF.items():
                if quantity in parameters:
                    parameters[ratio] = parameters[quantity] / parameters[unit]
                else:
                    parameters[quantity] = parameters[unit] * parameters[ratio]
            collisions = _make_pairs(parameters)
        else:
            collisions = _make_chains(parameters)
            parameters["balls"] = parameters["balls"].astype(int)
        return CellBlock(np.arange(indices.start, indices.stop), parameters, collisions, graphs)

    def __getitem__(self, index: int) -> Collision:
        if not 0 <= index < len(self):
            raise IndexError(f"cell {index} of {len(self)}")
        return self.block(range(index, index + 1)).collisions[0]

    @property
    def chunk_size(self) -> int:
        """Number of cells in a chunk.

        It is the number in the configuration, if the configuration has one. Otherwise chunks are smaller if an engine
        is among the solvers.
        """
        if self.config.chunk_size is not None:
            return self.config.chunk_size
        usual = _CHUNK if self.config.kind == "pair" else _CHAINS_CHUNK
        if not any(map(is_engine, self.config.solvers)):
            usual = max(_CHUNK, min(_QUICK_CHUNK, len(self) // 64))
        return max(usual, -(-len(self) // _MOST_CHUNKS))

    def chunks(self) -> int:
        """Return the number of chunks."""
        return -(-len(self) // self.chunk_size)

    def chunk(self, number: int) -> range:
        """Return the range of the numbers of the cells in a chunk."""
        size = self.chunk_size
        return range(number * size, min((number + 1) * size, len(self)))


def experiment_cells(config: Config) -> ExperimentCells:
    """Return the cells of an experiment of any kind.

    A `UserError` is raised if the experiment has an illegal file of cells.
    """
    if config.chain is not None:
        table = config.chain
        return _cells_of_grids(
            config, [{"arrangement": [name], **table.axes(name)} for name in table.arrangement]
        )
    if config.graph is not None:
        grid = config.graph
        return _cells_of_grids(config, [{"graph": [name], **grid.axes(name)} for name in grid.name])
    if config.sample is not None:
        return cells_from_ratios(config, draw(config.sample))
    if config.cells is not None:
        values = read_cells(Path(config.cells))
        problem = config.beyond_precision(*values.T[:2])
        if problem:
            raise UserError(f"{config.cells}: row {problem[0] + 1}: {problem[1]}")
        return cells_from_ratios(config, values)
    return _cells_of_grids(config, [config.grid.varied()])


def cells_from_ratios(config: Config, values: NDArray[np.float64]) -> ExperimentCells:
    """Return cells that are given by a list of their values.

    `values` has shape (n, 4): a row for each cell, with k2/k1, m2/m1, e1 and e2, the order of `AXES`.
    """

    def of(indices: range) -> ColumnArrays:
        return dict(zip(AXES, values[indices.start : indices.stop].T, strict=True))

    return ExperimentCells(config, len(values), of, hashlib.sha256(values.tobytes()).hexdigest())


def collision_of(config: Config, cell: Cell) -> Collision:
    """Return the collision of a cell in SI units, with the mass m1, stiffness k1 and velocity v0 of an experiment."""
    m1, k1 = config.scales["m1"], config.scales["k1"]
    m2, k2 = m1 * cell.mass_ratio, k1 * cell.stiffness_ratio
    return Collision.two_balls(m1, m2, k1, k2, cell.e1, cell.e2, config.v0)


def _cells_of_grids(config: Config, grids: Sequence[Mapping[str, Sequence[float | str]]]) -> ExperimentCells:
    """Return the cells of one or more grids, one grid after the other.

    A grid holds the values of each axis, by the name of the axis. The last axis varies fastest. The first axis, which
    is the stiffness ratio or the number of balls, varies slowest. Neighbouring cells then need about the same number of
    time steps.
    """
    axes = [{name: np.array(axis) for name, axis in grid.items()} for grid in grids]
    shapes = [tuple(map(len, grid.values())) for grid in grids]
    ends = [0, *itertools.accumulate(map(math.prod, shapes))]

    def of(indices: range) -> ColumnArrays:
        pieces = []
        for grid, shape, start, stop in zip(axes, shapes, ends, ends[1:], strict=False):
            inside = range(max(indices.start, start), min(indices.stop, stop))
            if inside:
                places = np.unravel_index(np.arange(inside.start, inside.stop) - start, shape)
                pieces.append({name: grid[name][place] for name, place in zip(grid, places, strict=True)})
        return {name: np.concatenate([piece[name] for piece in pieces]) for name in pieces[0]}

    return ExperimentCells(config, ends[-1], of)


def _make_pairs(cells: ColumnArrays) -> Collisions:
    pairs = ("m1", "m2"), ("k1", "k2"), ("e1", "e2")
    m, k, e = (np.column_stack([cells[name] for name in pair]) for pair in pairs)
    v = np.column_stack([cells["v0"], np.zeros(len(m))])
    return Collisions(m, k, e, v, True, np.zeros_like(k))


def _make_chains(cells: ColumnArrays) -> Sequence[Collision]:
    numbers = {
        {"m1": "m", "k1": "k"}.get(name, name): values.tolist()
        for name, values in cells.items()
        if name != "arrangement"
    }
    rows = zip(*numbers.values(), strict=True)
    setups = (
        chain_setup_values(arrangement, dict(zip(numbers, row, strict=True)))
        for arrangement, row in zip(cells["arrangement"].tolist(), rows, strict=True)
    )
    # The chains are not validated here. The chains at the ends of all axes have been validated already. If they are
    # legal, all chains between them are legal too.
    chains = [ChainSetup.model_construct(None, **setup).collision() for setup in setups]
    kinds = {(len(chain.masses), chain.table, chain.exponent) for chain in chains}
    return Collisions.of(chains) if len(kinds) == 1 else chains


def _make_graphs(cells: ColumnArrays) -> list[GraphCollision]:
    axes = [name for name in GRAPH_AXES if name != "graph"]
    rows = zip(*(cells[name].tolist() for name in (*axes, "m1", "k1", "v0")), strict=True)
    return [
        named_graph(name, dict(zip(axes, numbers, strict=True)), m1, k1, v0)
        for name, (*numbers, m1, k1, v0) in zip(cells["graph"].tolist(), rows, strict=True)
    ]


def sobol_sequence(dimensions: int, generator: np.random.Generator) -> qmc.Sobol:
    """Return a sequence of scrambled Sobol points in the unit cube with this number of dimensions.

    The generator is passed as `seed`, because SciPy before 1.15 has no argument `rng`. Later versions accept `seed`
    too, although it is not in their signature.
    """
    from scipy.stats import qmc

    return qmc.Sobol(dimensions, seed=generator)  # pyright: ignore[reportCallIssue]


def draw(sample: Sample) -> NDArray[np.float64]:
    """Return the values of cells that are drawn from the box of a sample, shape (n, 4).

    The cells are the first n points of a scrambled Sobol sequence. The length of the sequence is the smallest power of
    two that is at least n.
    """
    n, d = sample.n, len(sample.free())
    unit = np.empty((n, 0))
    if d:
        sequence = sobol_sequence(d, np.random.default_rng(sample.seed))
        unit = sequence.random_base2(math.ceil(math.log2(n)))[:n]
    return sample.place(unit)


def read_cells(path: Path) -> NDArray[np.float64]:
    """Return the values of cells from a CSV or Parquet file, shape (n, 4), in the order of `AXES`.

    The file has one row for each cell; columns that are not in `AXES` are ignored. If a value is illegal, a `UserError`
    names the file, the row, the column and the legal values. Rows count from 1, without the header.
    """
    try:
        if path.suffix.lower() in (".parquet", ".pq"):
            table = pq.read_table(path, columns=[name for name in AXES if name in pq.read_schema(path).names])
        else:
            table = pacsv.read_csv(path)
    except (pa.ArrowException, OSError, UnicodeDecodeError) as error:
        raise UserError(f"{path}: cannot be read: {error!s:.160}; legal: a CSV or Parquet file") from None
    missing = [name for name in AXES if name not in table.column_names]
    if missing:
        legal = f"columns {', '.join(AXES)} (others are ignored)"
        raise UserError(f"{path}: column {missing[0]} is missing; legal: {legal}")
    if not 1 <= table.num_rows <= MAX_CELLS:
        raise UserError(f"{path}: {table.num_rows} rows; legal: 1 to {MAX_CELLS}")
    cells = np.empty((table.num_rows, len(AXES)))
    for i, name in enumerate(AXES):
        try:
            cells[:, i] = table.column(name).cast(pa.float64()).to_numpy()  # an empty field becomes NaN
        except pa.ArrowException:
            kind = table.column(name).type
            raise UserError(f"{path}: {name} is not a column of numbers ({kind})") from None
        illegal = np.flatnonzero(~((cells[:, i] >= LEGAL[name].low) & (cells[:, i] <= LEGAL[name].high)))
        if illegal.size:
            value = table.column(name)[illegal[0]].as_py()
            shown = "is empty" if value is None else f"= {value!r}"
            raise UserError(f"{path}: row {illegal[0] + 1}: {name} {shown}; legal: {LEGAL[name].text}")
    return cells
