"""What a run has done, what failed and why, and how fast it goes: read from its folder, while it runs or after."""

from __future__ import annotations

import math
import os
import threading
import time
from array import array
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from impact_xval.compliant_baselines.registry import law_of
from impact_xval.experiments.config.errors import UserError
from impact_xval.experiments.config.experiment import REFERENCE
from impact_xval.experiments.measures.aggregates import reasons_of
from impact_xval.experiments.measures.laws import in_order_of_laws
from impact_xval.experiments.tables.files import open_regular
from impact_xval.experiments.tables.lock import running
from impact_xval.experiments.tables.store import PART, RunFolder, Tally, statuses_of, tally

#: Columns of a row that `Medians` are made of.
MEDIAN_COLUMNS = ["solver", "velocity_divergence", "marked"]

#: Seconds that are said to be left, at most: a clock that jumped makes any number of them.
_LONGEST = 1e9


@dataclass(frozen=True, slots=True)
class RunStatus:
    """State of a run.

    Attributes
    ----------
    state : str
        ``complete``, ``running``, or ``stopped``: nobody works on it, and its parts, tables or report are to be
        completed.
    owner : str
        Who works on it, "" if nobody does.
    cells, cells_done : int
        Of the experiment, and those whose rows are kept.
    parts, parts_done, parts_damaged : int
        Chunks of cells, those whose rows are kept, and files that cannot be read (they are computed again).
    statuses : dict
        Count of every status by solver.
    reasons : list of (str, str, str, int)
        Solver, status, reason and number of rows, the most frequent first.
    rate : float or None
        Cells per second of this session (of the last, if it is over).
    seconds_left : float or None
        At this rate, while it runs.
    """

    state: str
    owner: str
    cells: int
    cells_done: int
    parts: int
    parts_done: int
    parts_damaged: int
    statuses: dict[str, dict[str, int]]
    reasons: list[tuple[str, str, str, int]]
    rate: float | None
    seconds_left: float | None


def status_of(root: Path) -> RunStatus:
    """Read the state of a run from its folder.

    Raises
    ------
    UserError
        If the folder is not that of a run.
    """
    if not root.is_dir():
        raise UserError(f"{root}: no such folder; legal: the folder of a run")
    folder = RunFolder(root)
    manifest = folder.manifest()
    cells, chunks = manifest["cells"], manifest["chunks"]
    owner = running(root)
    if manifest["state"] == "complete" and owner is None:
        return _complete(folder, manifest, cells, chunks)
    return _under_way(folder, manifest, cells, chunks, str(owner or ""))


def _complete(folder: RunFolder, manifest: dict[str, Any], cells: int, chunks: int) -> RunStatus:
    try:
        outcomes = folder.tally()
    except (OSError, pa.ArrowException):
        path = folder.root / "cells.parquet"
        raise UserError(f"{path}: damaged or missing; impact-xval run --resume writes it again") from None
    rate = _last_rate(manifest, cells, chunks)
    counts = (cells, cells, chunks, chunks, 0)
    return RunStatus("complete", "", *counts, statuses_of(outcomes), reasons_of(outcomes), rate, None)


def _under_way(folder: RunFolder, manifest: dict[str, Any], cells: int, chunks: int, owner: str) -> RunStatus:
    done, damaged, recent = 0, 0, 0
    since = last = _started(manifest)
    outcomes: Tally = Counter()
    seen: set[int] = set()
    for path in sorted(folder.parts.glob("*")):
        match = PART.fullmatch(path.name)
        if match is None or int(match[1]) in seen:
            continue
        try:
            with open_regular(path) as file:
                table = pq.read_table(file, columns=["solver", "status", "reason", "cell"])
                stamp = os.fstat(file.fileno()).st_mtime
        except (OSError, pa.ArrowException, KeyError):
            damaged += 1
            continue
        seen.add(int(match[1]))
        n = len(table.column("cell").unique())
        done += n
        if stamp >= since:
            recent, last = recent + n, max(last, stamp)
        outcomes += tally([table])
    elapsed = (time.time() if owner else last) - since
    rate = recent / elapsed if recent and elapsed > 0 else None
    left = min((cells - done) / rate, _LONGEST) if rate and owner else None
    state, counts = "running" if owner else "stopped", (cells, min(done, cells), chunks, len(seen), damaged)
    return RunStatus(state, owner, *counts, statuses_of(outcomes), reasons_of(outcomes), rate, left)


def _started(manifest: dict[str, Any]) -> float:
    try:
        return datetime.fromisoformat(manifest["started"]).timestamp()
    except (ValueError, OverflowError):
        return time.time()


def _last_rate(manifest: dict[str, Any], cells: int, chunks: int) -> float | None:
    """Cells per second of the last session that computed anything."""
    for session in reversed(manifest["sessions"]):
        computed, seconds = session.get("parts_computed"), session.get("wall_time_s")
        if computed and seconds and seconds >= 1e-3:  # as it is written
            return computed / chunks * cells / seconds
    return None


class Medians:
    """Median D of every solver over the rows that have come so far, marked rows left out as in every table.

    Parameters
    ----------
    solvers : iterable of str
        Of the run.
    """

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
