"""Two runs into one folder: the second refuses; a run that died blocks nobody."""

import signal
import subprocess
import sys

import pytest

from impact_xval.experiments.commands.cli import main
from impact_xval.experiments.tables.lock import holding, running

pytestmark = pytest.mark.smoke

_HOLD = (
    "import sys, time; from pathlib import Path; from impact_xval.experiments.tables.lock import holding\n"
    "with holding(Path(sys.argv[1])):\n    print('held', flush=True); time.sleep(600)"
)


@pytest.fixture
def other(tmp_path):
    """Another process that holds the folder."""
    process = subprocess.Popen(
        [sys.executable, "-c", _HOLD, str(tmp_path)], stdout=subprocess.PIPE, text=True
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "held\n"
    yield process
    process.kill()
    process.communicate()


def test_the_second_run_refuses(tmp_path, other, capsys):
    (tmp_path / "c.toml").write_text("solvers = ['state-transition']")
    before = sorted(path.name for path in tmp_path.iterdir())
    for more in ([], ["--resume"]):
        assert main(["run", str(tmp_path / "c.toml"), "--out", str(tmp_path), *more]) == 2
        error = capsys.readouterr().err
        assert error.count("\n") == 1
        assert f"--out {tmp_path}: another run writes there" in error
    assert sorted(path.name for path in tmp_path.iterdir()) == before


def test_a_killed_run_blocks_nobody(tmp_path, other):
    other.send_signal(signal.SIGKILL)
    other.wait()
    with holding(tmp_path):
        assert running(tmp_path)
    assert not running(tmp_path)
