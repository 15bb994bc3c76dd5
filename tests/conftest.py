"""What must hold before any test runs: no stale compiled kernel, and Ctrl-C that reaches the runs that tests start."""

import signal
from collections import Counter
from contextlib import suppress
from pathlib import Path

# Numba keys its cache by a kernel's own file, not by those it calls: drop what a later edit made stale.
folders = [Path(__file__).parents[1] / floor for floor in ("model", "compliant_baselines")]
newest = max(source.stat().st_mtime for folder in folders for source in folder.rglob("*.py"))
for cached in (file for folder in folders for file in folder.rglob("*.nb[ic]")):
    with suppress(FileNotFoundError):  # another test session does the same
        if cached.stat().st_mtime < newest:
            cached.unlink()

# Begun in the background of a shell, this process ignores Ctrl-C, under nohup SIGHUP, and so would all that it starts.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)
if signal.getsignal(signal.SIGHUP) is signal.SIG_IGN:
    signal.signal(signal.SIGHUP, signal.SIG_DFL)


def pytest_collection_modifyitems(items):
    """Files with the most slow tests come first, so that workers side by side end at about the same time."""
    marked = (item.path for item in items for name in ("slow", "nightly") if item.get_closest_marker(name))
    slow = Counter(marked)
    items.sort(key=lambda item: -slow[item.path])
