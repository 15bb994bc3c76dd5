"""What a run has done, and what failed and why: read from its folder, while it runs or after."""

from __future__ import annotations

import math
import threading
from array import array
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from impact_xval.compliant_baselines.registry import law_of
from impact_xval.experiments.config.experiment import REFERENCE
from impact_xval.experiments.measures.laws import in_order_of_laws
from impact_xval.experiments.measures.summary import reasons_of
from impact_xval.experiments.tables.folder import Tally, run_folder, running, statuses_of, tally

#: Columns of a row that `Medians` are made of.
MEDIAN_COLUMNS = ["solver", "velocity_divergence", "marked"]


@dataclass(frozen=True, slots=True)
class RunStatus:
    """State of a run: ``complete``, ``running``, or ``stopped``, where nobody works on what is to be completed.

    Reasons are solver, status, reason and number of rows, the most frequent first.
    """

    state: str
    cells: int
    cells_done: int
    parts: int
    parts_done: int
    parts_damaged: int
    statuses: dict[str, dict[str, int]]
    reasons: list[tuple[str, str, str, int]]


def status_of(root: Path) -> RunStatus:
    """Read the state of a run from its folder."""
    folder = run_folder(root)
    manifest, writing = folder.manifest(), running(root)
    cells, chunks = manifest["cells"], manifest["chunks"]
    if manifest["state"] == "complete" and not writing:
        outcomes, state, counts = folder.tally(), "complete", (cells, cells, chunks, chunks, 0)
        return RunStatus(state, *counts, statuses_of(outcomes), reasons_of(outcomes))
    outcomes, done, damaged = Tally(), 0, 0
    parts = folder.named_parts(range(chunks), manifest["identity"])
    for path in parts.values():
        try:
            table = pq.ParquetFile(path).read(columns=["solver", "status", "reason", "cell"])
        except (OSError, pa.ArrowException):
            damaged += 1
            continue
        done += len(table.column("cell").unique())
        outcomes += tally([table])
    counts = cells, done, chunks, len(parts) - damaged, damaged
    state = "running" if writing else "stopped"
    return RunStatus(state, *counts, statuses_of(outcomes), reasons_of(outcomes))


class Medians:
    """Median D of every solver over the rows that have come so far, marked rows left out as in every table."""

    def __init__(self, solvers: Iterable[str]) -> None:
        names = (name for name in in_order_of_laws(solvers) if name != REFERENCE)
        self._found = {name: array("d") for name in names}
        self._medians = {name: (0, math.nan) for name in self._found}
        self._lock = threading.Lock()

    def add(self, rows: pa.Table) -> None:
        """Add rows with the columns `MEDIAN_COLUMNS`; safe from any thread."""
        rows = rows.filter(pc.field("marked").is_null() & pc.field("velocity_divergence").is_valid())
        for name, found in self._found.items():
            some = rows.filter(pc.field("solver") == name).column("velocity_divergence").to_numpy()
            with self._lock:
                found.frombytes(some.tobytes())

    def rows(self) -> list[tuple[str, str, int, float]]:
        """Law, solver, number of cells and median D of those solvers that have any; solvers of one law together."""
        for name, found in self._found.items():
            if len(found) > self._medians[name][0]:
                with self._lock:
                    values = np.array(found)
                self._medians[name] = len(values), float(np.median(values, overwrite_input=True))
        return [(law_of(name) or "-", name, n, median) for name, (n, median) in self._medians.items() if n]
