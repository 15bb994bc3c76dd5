"""The cells of an experiment: a grid, a sample (`scipy.stats.qmc`), a list from a file, chains, or contact graphs.

They are numbered and deterministic, and made block by block: ten million of them are never in memory at once.
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

#: Values of columns by name, shape (n,). A column is of numbers or of texts, so that its dtype is open.
ColumnArrays = dict[str, NDArray[Any]]

#: Cells of a chunk where an engine is among the solvers, a few seconds of work with their estimates: of two balls; of
#: chains and graphs. Without an engine at most so many; a million cells then make a thousand parts.
_CHUNK, _CHAINS_CHUNK, _QUICK_CHUNK = 16, 4, 1024

#: The number of chunks from which they become larger instead of more.
_MOST_CHUNKS = 10_000


@dataclass(frozen=True, slots=True)
class CellBlock:
    """Consecutive cells of an experiment."""

    #: Number of each cell in the experiment.
    index: NDArray[np.int64]
    #: Parameters of the cells by name, shape (n,): the columns of a pair, a chain or a graph in `schema`.
    parameters: ColumnArrays
    #: What is solved; a `Collisions` where all are of one kind. Empty in an experiment of graphs.
    collisions: Sequence[Collision]
    #: What is solved in an experiment of graphs; else empty.
    graphs: Sequence[GraphCollision] = ()

    def __len__(self) -> int:
        return len(self.index)

    def __getitem__(self, place: slice) -> CellBlock:
        parameters = {name: values[place] for name, values in self.parameters.items()}
        return CellBlock(self.index[place], parameters, self.collisions[place], self.graphs[place])


@dataclass(frozen=True, slots=True)
class ExperimentCells:
    """The cells of an experiment, in order, and their chunks."""

    config: Config
    count: int
    #: Gives the ratios, or the axes of chains, of a range of cells by their names, shape (n,) each.
    values: Callable[[range], ColumnArrays]
    #: SHA-256 of cells that are listed, to the last bit.
    digest: str = ""

    def __len__(self) -> int:
        return self.count

    def block(self, indices: range) -> CellBlock:
        """Make the cells of a range of indices."""
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
        """Cells of a chunk: as configured, or by whether an engine is among the solvers."""
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
        """Return the indices of the cells of a chunk."""
        size = self.chunk_size
        return range(number * size, min((number + 1) * size, len(self)))


def experiment_cells(config: Config) -> ExperimentCells:
    """Return the cells of an experiment of any kind; a `UserError` says what is wrong with a file of them."""
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
    """Return cells in any order; `values` are their ratios in the order of `AXES`, shape (n, 4)."""

    def of(indices: range) -> ColumnArrays:
        return dict(zip(AXES, values[indices.start : indices.stop].T, strict=True))

    return ExperimentCells(config, len(values), of, hashlib.sha256(values.tobytes()).hexdigest())


def collision_of(config: Config, cell: Cell) -> Collision:
    """Give a cell the masses, stiffnesses and velocity of an experiment."""
    m1, k1 = config.scales["m1"], config.scales["k1"]
    m2, k2 = m1 * cell.mass_ratio, k1 * cell.stiffness_ratio
    return Collision.two_balls(m1, m2, k1, k2, cell.e1, cell.e2, config.v0)


def _cells_of_grids(config: Config, grids: Sequence[Mapping[str, Sequence[float | str]]]) -> ExperimentCells:
    """Go through the axes of one grid after the other, the last axis fastest.

    Stiffness ratios (or numbers of balls) vary slowest, so that neighbouring cells need about the same number of steps.
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
    # The corners of the table have been validated, and no other chain is illegal where they are legal.
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
    """Return a sequence of scrambled Sobol points in the unit cube.

    SciPy before 1.15 has no argument `rng`; later versions take `seed` too, though it is not in their signature.
    """
    from scipy.stats import qmc

    return qmc.Sobol(dimensions, seed=generator)  # pyright: ignore[reportCallIssue]


def draw(sample: Sample) -> NDArray[np.float64]:
    """Draw cells from a box, shape (n, 4): scrambled Sobol points, the beginning of a power of two of them."""
    n, d = sample.n, len(sample.free())
    unit = np.empty((n, 0))
    if d:
        sequence = sobol_sequence(d, np.random.default_rng(sample.seed))
        unit = sequence.random_base2(math.ceil(math.log2(n)))[:n]
    return sample.place(unit)


def read_cells(path: Path) -> NDArray[np.float64]:
    """Read cells from a file, one a row; columns other than those of `AXES` are ignored.

    A `UserError` names the file, the column, the row (from 1, a header not counted) and what is legal.
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
            cells[:, i] = table.column(name).cast(pa.float64()).to_numpy()  # what is empty becomes NaN
        except pa.ArrowException:
            kind = table.column(name).type
            raise UserError(f"{path}: {name} is not a column of numbers ({kind})") from None
        illegal = np.flatnonzero(~((cells[:, i] >= LEGAL[name].low) & (cells[:, i] <= LEGAL[name].high)))
        if illegal.size:
            value = table.column(name)[illegal[0]].as_py()
            shown = "is empty" if value is None else f"= {value!r}"
            raise UserError(f"{path}: row {illegal[0] + 1}: {name} {shown}; legal: {LEGAL[name].text}")
    return cells
