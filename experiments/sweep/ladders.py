"""The ladders of a run, a few cells at a time in sandboxes: whatever one costs is the status of its rows."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future, wait
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.csv as pacsv

from impact_xval.experiments.measures.ladder_table import LADDER, Ladders, engines_of
from impact_xval.experiments.sweep.sandbox import FaultError, Sandbox, SandboxError, in_halves, last_line
from impact_xval.experiments.tables.streams import blocks, replacing, table_writer

#: Cells of one call; one with a ratio far from 1 may take some seconds.
CELLS = 32
#: Seconds for one call; not the limit of a run's solvers, for these are references in closed form, and tables must not
#: depend on how busy a machine is.
_LIMIT = 600.0
#: Seconds between two lines that say how far it is.
_SAY = 20.0


def write_ladder(
    root: Path,
    executor: Any,
    kind: Ladders,
    *,
    say: Callable[[str], None] = lambda line: None,
) -> None:
    """Write a table of ladders, as Parquet and, without its lists, as CSV, from the table of cells in a folder.

    Parameters
    ----------
    root : Path
        Holds ``cells.parquet``, sorted by cell, and gets the table.
    executor
        One of `sweep.executors`, whatever the context of its sandboxes.
    kind : Ladders
        Of which kind the cells are.
    say : callable
        Given a line about how far it is, and about every cell whose ladder failed.
    """
    path = root / LADDER
    plain = pa.schema([field for field in kind.schema if not pa.types.is_list(field.type)])
    with (
        table_writer(path, kind.schema) as table,
        replacing(path.with_suffix(".csv")) as text,
        pacsv.CSVWriter(str(text), plain) as csv,
    ):
        for rows, failures in _in_order(executor, _calls(root / "cells.parquet", kind), say):
            for failure in failures:
                say(failure)
            table.add(rows)
            csv.write_table(rows.select(plain.names))


def _calls(path: Path, kind: Ladders) -> Iterator[tuple[Ladders, pa.Table]]:
    """Cut a table of cells into calls of `_ladders`; cells without an engine need none."""
    for block in blocks(path, kind.read):
        starts = _starts(block)
        for first in range(0, len(starts) - 1, CELLS):
            ends = starts[first : first + CELLS + 1]
            # A slice would be sent with all that it was cut from.
            cells = block.take(np.arange(ends[0], ends[-1]))
            if len(engines_of(cells)):
                yield kind, cells


def _starts(cells: pa.Table) -> list[int]:
    """Where the rows of each cell begin, and where the last ones end."""
    return [*np.unique(cells["cell"].to_numpy(), return_index=True)[1].tolist(), len(cells)]


def _in_order(
    executor: Any, calls: Iterator[tuple[Ladders, pa.Table]], say: Callable[[str], None]
) -> Iterator[tuple[pa.Table, list[str]]]:
    """Give the answers in the order of the calls, of which a bounded number is handed out."""
    pending: deque[Future[tuple[pa.Table, list[str]]]] = deque()
    done = 0
    while True:
        while len(pending) < 4 * executor.workers and (call := next(calls, None)) is not None:
            pending.append(executor.submit(_ladders, *call))
        if not pending:
            return
        while not wait([pending[0]], _SAY).done:
            say(f"ladders of {done} cells are made")
        rows, failures = pending.popleft().result()
        done += len(rows["cell"].unique())
        yield rows, failures


def _ladders(sandbox: Sandbox, kind: Ladders, cells: pa.Table) -> tuple[pa.Table, list[str]]:
    """Make the ladders of some cells; a line for each cell whose ladder failed."""
    starts, failures = _starts(cells), []

    def rows_of(place: slice) -> pa.Table:
        return cells.slice(starts[place.start], starts[place.stop] - starts[place.start])

    def call(place: slice) -> pa.Table:
        try:
            return sandbox.call(_rows, kind, rows_of(place), timeout=_LIMIT)
        except SandboxError as error:
            raise FaultError("crashed", last_line(str(error))) from None

    def failed(place: slice, fault: FaultError) -> pa.Table:
        rows = rows_of(place)
        failures.append(f"cell {rows['cell'][0]} has no ladder: {fault.reason}")
        return kind.failed(rows, fault.status, f"ladder: {fault.reason}")

    return pa.concat_tables(in_halves(call, len(starts) - 1, failed)), failures


def _rows(_: object, kind: Ladders, cells: pa.Table) -> pa.Table:
    return kind.rows(cells)
