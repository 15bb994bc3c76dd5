"""A real Dask cluster of two worker processes on loopback: the same bytes, whatever happens to its workers."""

import contextlib

import psutil
import pytest

from impact_xval.experiments.commands.cli import main
from impact_xval.experiments.config.errors import InterruptedRunError
from impact_xval.experiments.config.experiment import parse_config
from impact_xval.experiments.sweep import dask_cluster
from impact_xval.experiments.sweep.run import run_sweep
from tests.experiments.conftest import tables_of
from tests.waiting import wait_until

GRID = {"stiffness_ratio": {"log": [0.02, 50, 20]}, "mass_ratio": [1.0, 2.0], "e1": [0.7, 0.9], "e2": [0.8]}
CONFIG = parse_config(
    {"solvers": ["kelvin-voigt", "mujoco"], "step_fraction": 0.01, "chunk_size": 3, "grid": GRID}
)


@pytest.fixture(scope="module")
def cluster():
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, host="127.0.0.1", dashboard_address=None
    ) as made:
        yield made


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory):
    return tables_of(run_sweep(CONFIG, tmp_path_factory.mktemp("undisturbed") / "run", workers=1).root)


def _workers(cluster):
    return [psutil.Process(worker.pid) for worker in cluster.workers.values() if worker.pid is not None]


@pytest.mark.nightly
def test_a_worker_of_the_cluster_that_dies_costs_nothing(tmp_path, undisturbed, cluster):
    killed = []

    def kill(done, total, line):
        if done >= 15 and not killed:
            killed.append(_workers(cluster)[0])
            killed[0].kill()

    folder = run_sweep(CONFIG, tmp_path / "a", scheduler=cluster.scheduler_address, progress=kill)
    assert killed
    assert tables_of(tmp_path / "a") == undisturbed
    assert folder.manifest()["sessions"][0]["where"] == cluster.scheduler_address


@pytest.mark.nightly
def test_an_interrupted_run_leaves_no_process_and_goes_on_to_the_same_bytes(tmp_path, undisturbed, cluster):
    address = cluster.scheduler_address

    def interrupt(done, total, line):
        if done >= 9:
            raise KeyboardInterrupt

    with pytest.raises(InterruptedRunError):
        run_sweep(CONFIG, tmp_path / "a", scheduler=address, progress=interrupt)
    wait_until(lambda: not _sandboxes(cluster))
    run_sweep(CONFIG, tmp_path / "a", scheduler=address)
    assert tables_of(tmp_path / "a") == undisturbed


def _sandboxes(cluster):
    found = []
    for child in (child for worker in _workers(cluster) for child in worker.children(recursive=True)):
        with contextlib.suppress(psutil.NoSuchProcess):
            if "impact_xval.experiments.sweep.sandbox" in " ".join(child.cmdline()):
                found.append(child)
    return found


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
