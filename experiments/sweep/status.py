"""State of a run, read from the folder of the run, with the numbers of its results and failures so far.

The run may be in progress, stopped or complete. The command ``show`` uses this module.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from impact_xval.experiments.measures.summary import count_reasons
from impact_xval.experiments.tables.folder import (
    COMPLETE,
    Tally,
    is_written_to,
    run_folder,
    statuses_of,
    tally,
)


@dataclass(frozen=True, slots=True)
class RunStatus:
    """State of a run and counts of its cells, parts and statuses.

    Attributes
    ----------
    state : str
        ``complete``; ``running`` while a process writes to the folder; or ``stopped``, if the run is incomplete and no
        process writes to the folder.
    cells, cells_done : int
        Number of cells of the experiment, and number of cells that are computed.
    parts, parts_done, parts_damaged : int
        A part is a file of rows that the run writes. Number of all parts, of parts that are complete, and of parts that
        cannot be read.
    statuses : dict
        Number of rows by solver and status.
    reasons : list of tuple
        Solver, status, reason, and number of rows with these three, the most frequent first.
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
    """Read the state of a run from its folder; raise a `UserError` if its manifest or experiment is damaged."""
    folder = run_folder(root)
    manifest, writing = folder.manifest(), is_written_to(root)
    folder.config()
    cells, chunks = manifest["cells"], manifest["chunks"]
    if manifest["state"] == COMPLETE and not writing:
        outcomes = folder.tally()
        return RunStatus(
            state="complete",
            cells=cells,
            cells_done=cells,
            parts=chunks,
            parts_done=chunks,
            parts_damaged=0,
            statuses=statuses_of(outcomes),
            reasons=count_reasons(outcomes),
        )
    outcomes = Tally()
    done = damaged = 0
    parts = folder.named_parts(range(chunks), manifest["identity"])
    for path in parts.values():
        try:
            table = pq.ParquetFile(path).read(columns=["solver", "status", "reason", "cell"])
        except (OSError, pa.ArrowException):
            damaged += 1
            continue
        done += len(table.column("cell").unique())
        outcomes += tally([table])
    return RunStatus(
        state="running" if writing else "stopped",
        cells=cells,
        cells_done=done,
        parts=chunks,
        parts_done=len(parts) - damaged,
        parts_damaged=damaged,
        statuses=statuses_of(outcomes),
        reasons=count_reasons(outcomes),
    )
