"""A real Dask cluster of two worker processes on loopback: the same bytes, whatever happens to its workers."""

import contextlib
import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import psutil
import pyarrow.parquet as pq
import pytest

from impact_xval.experiments.commands.cli import main
from impact_xval.experiments.sweep import dask_cluster
from tests.experiments.conftest import tables_of
from tests.waiting import wait_until

ROOT = Path(__file__).parents[3]

CONFIG = """
scenario = "drop"
solvers = ["kelvin-voigt", "mujoco"]
step_fraction = 0.01
chunk_size = 3
[grid]
stiffness_ratio = {log = [0.02, 50, 20]}
mass_ratio = [1.0, 2.0]
e1 = [0.7, 0.9]
e2 = [0.8]
"""


class Cluster:
    """A scheduler and its workers, each a process of its own, started as a user would."""

    def __init__(self, folder):
        self.file = folder / "scheduler.json"
        self.environment = os.environ | {"PYTHONPATH": str(ROOT)}
        self.scheduler = self._start(
            "scheduler", "--host", "tcp://127.0.0.1", "--port", "0", "--scheduler-file", self.file
        )
        self.workers = []
        try:
            self.address = self._address()
        except BaseException:
            self.stop()
            raise
        self.workers += [self.add_worker() for _ in range(2)]

    def _address(self):
        """Wait for the scheduler's file, which is there before anything is written to it."""
        address = []

        def written():
            with contextlib.suppress(FileNotFoundError, json.JSONDecodeError, KeyError):
                address.append(json.loads(self.file.read_text())["address"])
            return address

        wait_until(written)
        return address[0]

    def _start(self, *arguments):
        return subprocess.Popen(
            [sys.executable, "-m", "dask", *map(str, arguments), "--no-dashboard"],
            env=self.environment,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )

    def add_worker(self):
        return self._start("worker", self.address, "--nthreads", "1", "--nworkers", "1")

    def stop(self):
        processes = []
        for each in (*self.workers, self.scheduler):
            with contextlib.suppress(psutil.NoSuchProcess):
                process = psutil.Process(each.pid)
                processes += [process, *process.children(recursive=True)]
        for process in processes:
            with contextlib.suppress(psutil.NoSuchProcess):
                process.kill()
        for each in (*self.workers, self.scheduler):
            each.wait()


@pytest.fixture(scope="module")
def cluster(tmp_path_factory):
    made = Cluster(tmp_path_factory.mktemp("cluster"))
    yield made
    made.stop()


def _start(*command):
    return subprocess.Popen(
        [sys.executable, "-m", *map(str, command)],
        cwd=ROOT,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def _run(config, out, *more):
    process = _start("tests.experiments.runner", config, out, *more)
    _, error = process.communicate(timeout=300)
    assert process.returncode == 0, error


@pytest.fixture(scope="module")
def config(tmp_path_factory):
    path = tmp_path_factory.mktemp("config") / "c.toml"
    path.write_text(CONFIG)
    return path


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory, config):
    root = tmp_path_factory.mktemp("undisturbed") / "run"
    _run(config, root, "--workers", "1")
    return tables_of(root)


@pytest.mark.nightly
def test_a_worker_of_the_cluster_that_dies_costs_nothing(tmp_path, config, undisturbed, cluster):
    process = _start("tests.experiments.runner", config, tmp_path / "a", "--scheduler", cluster.address)
    wait_until(lambda: process.poll() is not None or len(list(tmp_path.glob("a/parts/0*"))) >= 5)
    victim = cluster.workers.pop(0)
    whole = psutil.Process(victim.pid)
    for each in [*whole.children(recursive=True), whole]:
        with contextlib.suppress(psutil.NoSuchProcess):
            each.kill()
    victim.wait()
    cluster.workers.append(cluster.add_worker())
    said, error = process.communicate(timeout=300)
    assert process.returncode == 0, error
    assert f"Dask cluster at {cluster.address}: " in said
    assert tables_of(tmp_path / "a") == undisturbed
    manifest = json.loads((tmp_path / "a/manifest.json").read_text())
    assert manifest["sessions"][0]["where"] == cluster.address


@pytest.mark.nightly
def test_ctrl_c_ends_it_and_leaves_no_process(tmp_path, config, undisturbed, cluster):
    out = ["--out", tmp_path / "a", "--scheduler", cluster.address]
    process = _start("impact_xval", "run", config, *out)
    wait_until(lambda: process.poll() is not None or len(list(tmp_path.glob("a/parts/0*"))) >= 3)
    process.send_signal(signal.SIGINT)
    _, error = process.communicate(timeout=300)
    assert process.returncode == 1
    assert "Traceback" not in error
    assert f"--resume --scheduler {cluster.address}" in error
    wait_until(lambda: not _sandboxes(cluster))
    _run(config, tmp_path / "a", "--scheduler", cluster.address)
    assert tables_of(tmp_path / "a") == undisturbed


def _sandboxes(cluster):
    found = []
    for worker in cluster.workers:
        for child in psutil.Process(worker.pid).children(recursive=True):
            with contextlib.suppress(psutil.NoSuchProcess):
                if "impact_xval.experiments.sweep.sandbox" in " ".join(child.cmdline()):
                    found.append(child)
    return found


@pytest.mark.nightly
def test_a_crash_on_a_cluster_is_a_row(tmp_path, cluster):
    (tmp_path / "c.toml").write_text(
        "scenario = 'impact'\nsolvers = ['mujoco']\nchunk_size = 3\n[grid]\n"
        "stiffness_ratio = [0.5, 1.0, 2.0]\nmass_ratio = [1.5]\ne1 = [0.9, 0.903]\ne2 = [0.7]\n"
    )
    _run(tmp_path / "c.toml", tmp_path / "a", "--scheduler", cluster.address, "--faulty")
    rows = pq.read_table(tmp_path / "a/cells.parquet").to_pylist()
    assert [(r["e1"], r["status"]) for r in rows if r["solver"] == "mujoco"] == [
        (0.9, "ok"),
        (0.903, "crashed"),
    ] * 3


def test_no_scheduler_is_one_line_and_leaves_nothing(tmp_path, capsys, monkeypatch):
    pytest.importorskip("distributed")
    monkeypatch.setattr(dask_cluster, "_ANSWER", 0.5)
    (tmp_path / "c.toml").write_text("solvers = ['state-transition']")
    monkeypatch.chdir(tmp_path)
    for address in ("nonsense", "tcp://127.0.0.1:1"):
        assert main(["run", "c.toml", "--scheduler", address]) == 2
        error = capsys.readouterr().err
        assert f"--scheduler {address}: no Dask scheduler answers there" in error
        assert error.count("\n") == 1
    assert [path.name for path in tmp_path.iterdir()] == ["c.toml"]
