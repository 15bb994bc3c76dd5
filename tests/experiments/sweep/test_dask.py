"""Runs on a real Dask cluster of two worker processes: tables are the same, whatever happens to a worker."""

import psutil
import pytest

from impact_xval.experiments.config.errors import InterruptedRunError
from impact_xval.experiments.config.experiment import parse_config
from impact_xval.experiments.sweep import pool
from impact_xval.experiments.sweep.run import run_sweep
from tests.experiments.conftest import tables_of
from tests.waiting import wait_until


@pytest.mark.nightly
def test_neither_an_interrupt_nor_a_worker_that_dies_changes_a_byte(tmp_path):
    """The tables equal those of an undisturbed run to the byte, after an interruption and the death of a worker.

    The interrupted run leaves no process on the cluster. The run that continues it loses a worker.
    """
    distributed = pytest.importorskip("distributed")
    cells = {"sample": {"n": 80, "seed": 1}, "chunk_size": 3}
    config = parse_config({"solvers": ["kelvin-voigt", "mujoco"], "step_fraction": 0.01} | cells)
    undisturbed = tables_of(run_sweep(config, tmp_path / "undisturbed", workers=1).folder.root)

    def workers():
        return [psutil.Process(each.pid) for each in cluster.workers.values() if each.pid is not None]

    def interrupt(done, total, line):
        if done >= 9:
            assert any(each.children() for each in workers())
            raise KeyboardInterrupt

    def kill(done, total, line):
        if done >= 30 and not killed:
            killed.append(workers()[0])
            killed[0].kill()

    killed = []
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, host="127.0.0.1", dashboard_address=None
    ) as cluster:
        with pytest.raises(InterruptedRunError):
            run_sweep(config, tmp_path / "a", scheduler=cluster.scheduler_address, progress=interrupt)
        wait_until(lambda: not any(each.children() for each in workers()))
        run_sweep(config, tmp_path / "a", scheduler=cluster.scheduler_address, progress=kill)
    assert killed
    assert tables_of(tmp_path / "a") == undisturbed


def test_no_scheduler_is_one_line_and_leaves_nothing(tmp_path, refused, monkeypatch):
    pytest.importorskip("distributed")
    monkeypatch.setattr(pool, "_TO_CONNECT", 0.5)
    (tmp_path / "c.toml").write_text("solvers = ['state-transition']")
    monkeypatch.chdir(tmp_path)
    for address in ("nonsense", "tcp://127.0.0.1:1"):
        refused(
            f"run c.toml --scheduler {address}", f"--scheduler {address}: no Dask scheduler answers there"
        )
    assert [path.name for path in tmp_path.iterdir()] == ["c.toml"]
