"""A run that is killed, again and again, ends with the tables of one that was left alone."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from impact_xval.experiments.tables.store import TABLES
from tests.waiting import wait_until

ROOT = Path(__file__).parents[3]
CONFIG = """
scenario = "impact"
solvers = ["kelvin-voigt", "mujoco"]
step_fraction = 0.005
chunk_size = 3
[convergence]
enabled = false
[grid]
stiffness_ratio = {log = [0.02, 30, 24]}
mass_ratio = [1.0]
e1 = [0.7]
e2 = [0.6]
"""


@pytest.mark.slow
def test_five_kills_change_no_byte(tmp_path):
    """SIGKILL to the run and all that it started, each time one more part is there, wherever that finds it."""
    (tmp_path / "c.toml").write_text(CONFIG)
    command = [sys.executable, "-m", "tests.experiments.runner", str(tmp_path / "c.toml")]
    subprocess.run([*command, str(tmp_path / "whole"), "--workers", "1"], cwd=ROOT, check=True)
    cut = [*command, str(tmp_path / "cut"), "--workers", "2"]
    for parts in range(1, 6):
        with subprocess.Popen(cut, cwd=ROOT, start_new_session=True) as process:
            wait_until(lambda: process.poll() is not None or len(_parts(tmp_path / "cut")) >= parts)  # noqa: B023
            os.killpg(process.pid, signal.SIGKILL)
        assert len(_parts(tmp_path / "cut")) >= parts
    done = subprocess.run(cut, cwd=ROOT, check=True, capture_output=True, text=True)
    assert " of 8 parts are there and whole" in done.stdout
    whole, found = (
        {name: (tmp_path / root / name).read_bytes() for name in TABLES} for root in ("whole", "cut")
    )
    assert found == whole


def _parts(root):
    return list((root / "parts").glob("0*"))
