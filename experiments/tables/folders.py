"""Folders of runs: whether one may be written to, looked at before anything is, and whether its run is finished."""

from __future__ import annotations

import contextlib
import shlex
import tempfile
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from impact_xval.experiments.config.axes import AXES
from impact_xval.experiments.config.cells import Cells, experiment_cells, listed
from impact_xval.experiments.config.errors import UserError
from impact_xval.experiments.config.experiment import Config
from impact_xval.experiments.tables.lock import LOCK
from impact_xval.experiments.tables.store import FINISHED, MANIFEST, DamagedManifestError, RunFolder
from impact_xval.experiments.tables.streams import column, replaced_by


def missing(root: Path) -> list[Path]:
    """Return the folders that must be made for `root` to be there, `root` first."""
    return [path for path in (root, *root.parents) if not path.exists()]


def open_folder(root: Path) -> tuple[RunFolder, bool]:
    """Check that a run may write to a folder, and create it.

    Parameters
    ----------
    root : Path
        The folder.

    Returns
    -------
    folder : RunFolder
    continued : bool
        Whether a run is there.

    Raises
    ------
    UserError
        If the folder holds something else, or cannot be written to.
    """
    folder, new = RunFolder(root), missing(root)
    try:
        entries = sorted(entry.name for entry in root.iterdir()) if not new else []
        # What a run leaves that was killed before its first line of work.
        started = folder.parts.is_dir() and not any(folder.parts.iterdir())
    except NotADirectoryError:
        raise UserError(f"--out {root}: is a file; legal: a new or empty folder") from None
    except OSError as error:
        raise UserError(f"--out {root}: cannot be read: {error.strerror}") from None
    # A run that lost its manifest is continued from its parts.
    continued = MANIFEST in entries or folder.has_parts()
    ours = (LOCK, *(["parts"] if started else []))
    foreign = [name for name in entries if replaced_by(name) != MANIFEST and name not in ours]
    if continued:
        try:
            folder.manifest()
        except DamagedManifestError:
            if not folder.parts.is_dir():  # without parts, nothing is lost
                raise
    elif foreign:
        raise UserError(f"--out {root}: not empty ({foreign[0]}) and not a run; legal: a new or empty folder")
    try:
        folder.parts.mkdir(parents=True, exist_ok=True)
        for directory in (root, folder.parts):
            tempfile.TemporaryFile(dir=directory).close()
    except OSError as error:
        discard(folder, new)
        raise UserError(f"--out {root}: cannot be written to: {error.strerror}") from None
    return folder, continued


def discard(folder: RunFolder, new: Iterable[Path]) -> None:
    """Remove what was made for a run that was refused, unless something was kept there.

    Parameters
    ----------
    folder : RunFolder
    new : iterable of Path
        Folders that were not there before (`missing`).
    """
    there = {path.name for path in folder.root.iterdir()} if folder.root.is_dir() else set()
    ours = (folder.parts.rmdir, (folder.root / LOCK).unlink) if there <= {"parts", LOCK} else ()
    for remove in (*ours, *(path.rmdir for path in new)):
        with contextlib.suppress(OSError):  # it holds something, or was never made
            remove()


def finished(root: Path) -> RunFolder:
    """Return the folder of a run whose tables are complete; its report may be missing.

    Raises
    ------
    UserError
        If they are not.
    """
    if not root.is_dir():
        raise UserError(f"{root}: no such folder; legal: the folder of a run")
    folder = RunFolder(root)
    if folder.manifest()["state"] not in FINISHED:
        raise UserError(
            f"{root}: the run is not finished; continue it with impact-xval run --resume --out {shlex.quote(str(root))}"
        )
    return folder


def finished_collisions(root: Path) -> RunFolder:
    """Return the folder of a finished run of two balls.

    Raises
    ------
    UserError
        As `finished`, and where it is a run of columns.
    """
    folder = finished(root)
    if folder.config().column is not None:
        raise UserError(f"{root}: a run of columns of N balls; legal: a run of collisions of two balls")
    return folder


def new_folder(root: Path) -> None:
    """Make the folder of a command that does not continue what it finds there.

    Raises
    ------
    UserError
        If it holds anything, is a file, or cannot be made or read.
    """
    try:
        root.mkdir(parents=True, exist_ok=True)
        empty = next(root.iterdir(), None) is None
    except FileExistsError:
        raise UserError(f"--out {root}: is a file; legal: a new or empty folder") from None
    except OSError as error:
        raise UserError(f"--out {root}: cannot be written to: {error.strerror}") from None
    if not empty:
        raise UserError(f"--out {root}: not empty; legal: a new or empty folder")


def cells_of_run(folder: RunFolder, config: Config) -> Cells:
    """Return the cells of a finished run; those of a list as its table has them, wherever their file is now."""
    if config.cells is None:
        return experiment_cells(config)
    path = folder.table_path("cells.parquet")
    return listed(config, np.column_stack([column(path, name)[:: len(config.solvers)] for name in AXES]))
