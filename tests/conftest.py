"""Numba keys its cache by a kernel's own file, not by those it calls: drop what a later edit made stale."""

from contextlib import suppress
from pathlib import Path

for package in ("model", "compliant_baselines", "experiments"):
    folder = Path(__file__).parents[1] / package
    newest = max(source.stat().st_mtime for source in folder.glob("*.py"))
    for cached in (folder / "__pycache__").glob("*.nb[ic]"):
        with suppress(FileNotFoundError):  # another test session does the same
            if cached.stat().st_mtime < newest:
                cached.unlink()
