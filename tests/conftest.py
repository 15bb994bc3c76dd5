"""What must hold before any test runs: no stale compiled kernel, and Ctrl-C that reaches the runs that tests start."""

import signal
from collections import Counter
from contextlib import suppress
from pathlib import Path

import pytest
from hypothesis import HealthCheck, Phase, settings

import impact_xval

# Numba keys its cache by a kernel's own file, not by those it calls: drop what a later edit made stale.
# The package holds the folders under any layout: in the checkout as links, in an unpacked sdist as they are.
folders = [Path(impact_xval.__file__).parent / floor for floor in ("model", "compliant_baselines")]
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

# The suite tries the same examples on every machine; nightly draws others (`--hypothesis-profile free`). How fast
# examples are drawn does not matter. A counterexample is printed as it was drawn: shrinking a slow one took minutes.
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
    """Files with the most slow tests come first, so that workers side by side end at about the same time."""
    marked = (item.path for item in items for name in ("slow", "nightly") if item.get_closest_marker(name))
    slow = Counter(marked)
    items.sort(key=lambda item: -slow[item.path])


def ended(typed):
    """Exit code of a command, typed as one string or a list of words."""
    from impact_xval.experiments.commands.cli import main

    return main(typed.split() if isinstance(typed, str) else [str(word) for word in typed])


@pytest.fixture
def command(capsys):
    """Run a command; what it prints, once it has ended with 0 or as is said."""

    def command(words, ends=0):
        capsys.readouterr()
        assert ended(words) == ends, capsys.readouterr().err
        return capsys.readouterr().out

    return command


@pytest.fixture
def refused(capsys):
    """Require of a command exit code 2, and a single line that holds all that is said, in this order."""

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
