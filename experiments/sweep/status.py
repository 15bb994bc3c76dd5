"""What a run has done, and what failed and why: read from its folder, while it runs or after."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from impact_xval.experiments.measures.summary import reasons_of
from impact_xval.experiments.tables.folder import Tally, run_folder, running, statuses_of, tally


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
