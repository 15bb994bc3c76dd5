"""What must hold before any test runs: no stale compiled kernel, and Ctrl-C that reaches the runs that tests start."""

import signal
from contextlib import suppress
from pathlib import Path

# Numba keys its cache by a kernel's own file, not by those it calls: drop what a later edit made stale.
for package in ("model", "compliant_baselines", "experiments"):
    folder = Path(__file__).parents[1] / package
    newest = max(source.stat().st_mtime for source in folder.glob("*.py"))
    for cached in (folder / "__pycache__").glob("*.nb[ic]"):
        with suppress(FileNotFoundError):  # another test session does the same
            if cached.stat().st_mtime < newest:
                cached.unlink()

# Begun in the background of a shell, this process ignores Ctrl-C, and so would all that it starts.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)
