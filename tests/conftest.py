"""Settings and fixtures of all tests.

Before any test runs, stale compiled kernels are removed, and signals are set so that Ctrl-C reaches the runs that tests
start.
"""

import signal
from collections import Counter
from contextlib import suppress
from pathlib import Path

import pytest
from hypothesis import HealthCheck, Phase, settings

import impact_xval

# Numba's cache notices changes in a kernel's own file but not in the files of functions it calls. Therefore all kernels
# that are older than the newest source are removed. The package holds the folders as links in a checkout, and as
# folders in an unpacked sdist.
folders = [Path(impact_xval.__file__).parent / floor for floor in ("model", "compliant_baselines")]
newest = max(source.stat().st_mtime for folder in folders for source in folder.rglob("*.py"))
for cached in (file for folder in folders for file in folder.rglob("*.nb[ic]")):
    with suppress(FileNotFoundError):  # another test session may remove the same file
        if cached.stat().st_mtime < newest:
            cached.unlink()

# A process that a shell started in the background ignores Ctrl-C, and under nohup also SIGHUP. All processes that it
# starts would do so, too.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)
if signal.getsignal(signal.SIGHUP) is signal.SIG_IGN:
    signal.signal(signal.SIGHUP, signal.SIG_DFL)

# By default Hypothesis tries the same examples on every machine. Nightly runs draw others (`--hypothesis-profile
# free`). There is no deadline for examples. Counterexamples are not shrunk, because shrinking a slow one took minutes.
for profile, fixed in (("fixed", True), ("free", False)):
    settings.register_profile(
        profile,
        derandomize=fixed,
        deadline=None,
        phases=(Phase.explicit, Phase.reuse, Phase.generate),
        suppress_health_check=[HealthCheck.too_slow],
        print_blob=True,
    )
settings.load_profile("fixed")


def pytest_collection_modifyitems(items):
    """Put files with many slow tests first, so that parallel workers end at about the same time."""
    marked = (item.path for item in items for name in ("slow", "nightly") if item.get_closest_marker(name))
    slow = Counter(marked)
    items.sort(key=lambda item: -slow[item.path])


def ended(typed):
    """Run a command, given as one string or as a list of words, and return its exit code."""
    from impact_xval.experiments.commands.cli import main

    return main(typed.split() if isinstance(typed, str) else [str(word) for word in typed])


@pytest.fixture
def command(capsys):
    """Return a function that runs a command, asserts its exit code (0 by default), and returns what it prints."""

    def command(words, ends=0):
        capsys.readouterr()
        assert ended(words) == ends, capsys.readouterr().err
        return capsys.readouterr().out

    return command


@pytest.fixture
def refused(capsys):
    """Return a function that asserts that a command is refused.

    The exit code must be 2, and the only output a single line that holds all given texts, in this order.
    """

    def refused(words, *says):
        assert ended(words) == 2, words
        out, err = capsys.readouterr()
        at_work = ("compiling the kernels", " ...")
        lines = [line for line in err.splitlines() if not any(each in line for each in at_work)]
        assert (out, len(lines)) == ("", 1), (words, err)
        assert lines[0].startswith("impact-xval: ")
        rest = lines[0]
        for text in says:
            assert text in rest, (words, lines[0])
            rest = rest.partition(text)[2]

    return refused
