"""What a run has done, what failed and why, and how fast it goes: read from its folder, while it runs or after."""

from __future__ import annotations

import time
from collections import Counter
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from impact_xval.experiments.config.errors import UserError
from impact_xval.experiments.measures.aggregates import reasons_of
from impact_xval.experiments.tables.lock import running
from impact_xval.experiments.tables.store import PART, RunFolder, count_statuses
from impact_xval.experiments.tables.streams import blocks

_COLUMNS = ("solver", "status", "reason")


@dataclass(frozen=True, slots=True)
class RunStatus:
    """State of a run.

    Attributes
    ----------
    state : str
        ``complete``, ``running``, or ``stopped``: nobody works on it.
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
    cells, chunks = (_count(root, manifest, key) for key in ("cells", "chunks"))
    owner = running(root)
    if manifest.get("state") == "complete" and owner is None:
        return _complete(folder, manifest, cells, chunks)
    return _under_way(folder, manifest, cells, chunks, str(owner or ""))


def _complete(folder: RunFolder, manifest: dict[str, Any], cells: int, chunks: int) -> RunStatus:
    path = folder.root / "cells.parquet"
    try:
        failed = reasons_of(blocks(path, _COLUMNS, whole_cells=False))
        statuses = folder.statuses()
    except (OSError, pa.ArrowException):
        raise UserError(f"{path}: damaged or missing; impact-xval run --resume writes it again") from None
    return RunStatus(
        state="complete",
        owner="",
        cells=cells,
        cells_done=cells,
        parts=chunks,
        parts_done=chunks,
        parts_damaged=0,
        statuses=statuses,
        reasons=failed,
        rate=_last_rate(manifest, cells, chunks),
        seconds_left=None,
    )


def _under_way(folder: RunFolder, manifest: dict[str, Any], cells: int, chunks: int, owner: str) -> RunStatus:
    done, damaged, since, recent = 0, 0, _started(manifest), 0
    statuses: Counter[tuple[str, str]] = Counter()
    failed: Counter[tuple[str, str, str]] = Counter()
    last = since
    seen: set[int] = set()
    for path in sorted(folder.parts.iterdir()) if folder.parts.is_dir() else []:
        match = PART.fullmatch(path.name)
        if match is None or int(match[1]) in seen:
            continue
        try:
            table = pq.read_table(path, columns=[*_COLUMNS, "cell"])
            stamp = path.stat().st_mtime
        except (OSError, pa.ArrowException, KeyError):
            damaged += 1
            continue
        seen.add(int(match[1]))
        n = len(set(table.column("cell").to_pylist()))
        done += n
        if stamp >= since:
            recent, last = recent + n, max(last, stamp)
        for solver, counts in count_statuses([table]).items():
            for status, count in counts.items():
                statuses[solver, status] += count
        for solver, status, reason, count in reasons_of([table]):
            failed[solver, status, reason] += count
    elapsed = (time.time() if owner else last) - since
    rate = recent / elapsed if recent and elapsed > 0 else None
    by_solver: dict[str, dict[str, int]] = {}
    for (solver, status), count in statuses.items():
        by_solver.setdefault(solver, {})[status] = count
    return RunStatus(
        state="running" if owner else "stopped",
        owner=owner,
        cells=cells,
        cells_done=min(done, cells),
        parts=chunks,
        parts_done=len(seen),
        parts_damaged=damaged,
        statuses=by_solver,
        reasons=sorted(((*key, n) for key, n in failed.items()), key=lambda row: (-row[3], row[:3])),
        rate=rate,
        seconds_left=(cells - done) / rate if rate and owner else None,
    )


def _count(root: Path, manifest: dict[str, Any], key: str) -> int:
    value = manifest.get(key)
    if not isinstance(value, int) or isinstance(value, bool) or value < 0:
        raise UserError(f"{root}: manifest.json: {key} = {value!r}; legal: a whole number")
    return value


def _started(manifest: dict[str, Any]) -> float:
    try:
        return datetime.fromisoformat(str(manifest.get("started"))).timestamp()
    except ValueError:
        return time.time()


def _last_rate(manifest: dict[str, Any], cells: int, chunks: int) -> float | None:
    """Cells per second of the last session that computed anything."""
    for session in reversed(manifest.get("sessions", [])):
        computed, seconds = session.get("parts_computed"), session.get("wall_time_s")
        if computed and seconds:
            return computed / chunks * cells / seconds
    return None
