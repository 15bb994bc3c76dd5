"""A real Dask cluster of two worker processes on loopback: the same bytes, whatever happens to its workers."""

import contextlib
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import psutil
import pyarrow.parquet as pq
import pytest

from impact_xval.experiments.commands.cli import main
from impact_xval.experiments.tables.store import TABLES
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

    def __init__(self, folder, environment=None, protocol="tcp"):
        self.file = folder / "scheduler.json"
        self.environment = os.environ | {"PYTHONPATH": str(ROOT)} | (environment or {})
        self.scheduler = self._start(
            "scheduler", "--host", f"{protocol}://127.0.0.1", "--port", "0", "--scheduler-file", self.file
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


def _start(*command, **how):
    return subprocess.Popen(
        [sys.executable, "-m", *map(str, command)],
        cwd=ROOT,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        **how,
    )


def _run(config, out, *more):
    process = _start("tests.experiments.runner", config, out, *more)
    said, error = process.communicate(timeout=300)
    assert process.returncode == 0, error
    return said


def _tables(root):
    return {name: (root / name).read_bytes() for name in TABLES}


@pytest.fixture(scope="module")
def config(tmp_path_factory):
    path = tmp_path_factory.mktemp("config") / "c.toml"
    path.write_text(CONFIG)
    return path


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory, config):
    root = tmp_path_factory.mktemp("undisturbed") / "run"
    _run(config, root, "--workers", "1")
    return _tables(root)


@pytest.mark.nightly
@pytest.mark.parametrize("workers", ["2", "4"])
def test_processes_change_no_byte(tmp_path, config, undisturbed, workers):
    _run(config, tmp_path / "a", "--workers", workers)
    assert _tables(tmp_path / "a") == undisturbed


@pytest.mark.nightly
def test_a_cluster_changes_no_byte(tmp_path, config, undisturbed, cluster):
    said = _run(config, tmp_path / "a", "--scheduler", cluster.address)
    assert f"Dask cluster at {cluster.address}: " in said
    assert _tables(tmp_path / "a") == undisturbed
    manifest = json.loads((tmp_path / "a/manifest.json").read_text())
    assert manifest["sessions"][0]["where"] == cluster.address


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
    _, error = process.communicate(timeout=300)
    assert process.returncode == 0, error
    assert _tables(tmp_path / "a") == undisturbed


@pytest.mark.nightly
def test_ctrl_c_ends_it_and_leaves_no_process(tmp_path, config, undisturbed, cluster):
    command = (
        "impact_xval",
        "run",
        config,
        "--out",
        tmp_path / "a",
        "--scheduler",
        cluster.address,
    )
    process = _start(*command)
    wait_until(lambda: process.poll() is not None or len(list(tmp_path.glob("a/parts/0*"))) >= 3)
    process.send_signal(signal.SIGINT)
    _, error = process.communicate(timeout=300)
    assert process.returncode == 1
    assert "Traceback" not in error
    assert f"--resume --scheduler {cluster.address}" in error
    wait_until(lambda: not _sandboxes(cluster))
    _run(config, tmp_path / "a", "--scheduler", cluster.address)
    assert _tables(tmp_path / "a") == undisturbed


def _sandboxes(cluster):
    found = []
    for worker in cluster.workers:
        for child in psutil.Process(worker.pid).children(recursive=True):
            with contextlib.suppress(psutil.NoSuchProcess):
                if "impact_xval.experiments.sweep.sandbox" in " ".join(child.cmdline()):
                    found.append(child)
    return found


@pytest.mark.nightly
def test_a_crash_on_a_cluster_is_a_row(tmp_path):
    """A cluster that a run starts for itself, and a solver that dies of two cells."""
    script = (
        "import sys; from pathlib import Path; from impact_xval.experiments.config.configuration import load_config\n"
        "from impact_xval.experiments.sweep.run import run_sweep; from tests.experiments import faulty\n"
        "if __name__ == '__main__':\n"
        "    run_sweep(load_config(sys.argv[1]), Path(sys.argv[2]), scheduler='local', workers=2,"
        " resolve=faulty.faulty)\n"
    )
    (tmp_path / "script.py").write_text(script)
    (tmp_path / "c.toml").write_text(
        "scenario = 'impact'\nsolvers = ['mujoco']\nchunk_size = 3\n[grid]\n"
        "stiffness_ratio = [0.5, 1.0, 2.0]\nmass_ratio = [1.5]\ne1 = [0.9, 0.901]\ne2 = [0.7]\n"
    )
    subprocess.run(
        [sys.executable, str(tmp_path / "script.py"), str(tmp_path / "c.toml"), str(tmp_path / "a")],
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        check=True,
        capture_output=True,
    )
    rows = pq.read_table(tmp_path / "a/cells.parquet").to_pylist()
    assert [(r["e1"], r["status"]) for r in rows if r["solver"] == "mujoco"] == [
        (0.9, "ok"),
        (0.901, "crashed"),
    ] * 3


@pytest.mark.nightly
def test_a_cluster_of_its_own_listens_on_loopback_only(tmp_path, config):
    """Everything that the run and its processes listen on, from the start of the run to its end."""
    process = _start("tests.experiments.runner", config, tmp_path / "a", "--scheduler", "local")
    heard = set()
    while process.poll() is None:
        with contextlib.suppress(psutil.NoSuchProcess):
            main = psutil.Process(process.pid)
            for each in (main, *main.children(recursive=True)):
                with contextlib.suppress(psutil.NoSuchProcess):
                    heard |= {c.laddr.ip for c in each.net_connections() if c.status == psutil.CONN_LISTEN}
        time.sleep(0.05)
    _, error = process.communicate()
    assert process.returncode == 0, error
    assert heard == {"127.0.0.1"}


@pytest.mark.nightly
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal_while_a_cluster_of_its_own_starts_is_one_line(tmp_path, config, number):
    """To the whole group, as of a terminal: to the run, the workers and what else Dask has started."""
    command = "impact_xval", "run", config, "--out", tmp_path / "a", "--scheduler", "local", "--workers", "2"
    process = _start(*command, start_new_session=True)
    main = psutil.Process(process.pid)
    # The command, its resource tracker, two workers.
    wait_until(lambda: process.poll() is not None or len(main.children(recursive=True)) >= 4)
    os.killpg(process.pid, number)
    _, error = process.communicate(timeout=300)
    assert process.returncode == 1
    (line,) = error.splitlines()
    assert line.startswith("impact-xval: interrupted; ")
    assert f"to continue: impact-xval run {config} --out {tmp_path / 'a'} --resume" in line
    wait_until(lambda: not _of_group(process.pid))


@pytest.mark.nightly
def test_a_worker_that_dies_while_a_cluster_of_its_own_starts_is_one_line(tmp_path, config):
    process = _start("impact_xval", "run", config, "--out", tmp_path / "a", "--scheduler", "local")
    worker = None
    while process.poll() is None and worker is None:
        with contextlib.suppress(psutil.NoSuchProcess):
            for each in psutil.Process(process.pid).children(recursive=True):
                if "spawn_main" in " ".join(each.cmdline()):
                    worker = each
    worker.kill()
    _, error = process.communicate(timeout=300)
    assert process.returncode == 1
    (line,) = error.splitlines()
    assert line.startswith("impact-xval: no Dask cluster has started: ")
    assert "to continue: " in line


def _of_group(number):
    found = []
    for process in psutil.process_iter():
        with contextlib.suppress(psutil.NoSuchProcess, ProcessLookupError):
            if os.getpgid(process.pid) == number:
                found.append(process)
    return found


def _certificates(folder):
    """Make an authority and a certificate of it, for scheduler, workers and client; the settings of Dask for them."""
    made = {name: str(folder / name) for name in ("ca.pem", "ca.key", "our.pem", "our.key", "our.csr")}
    new = ["openssl", "req", "-newkey", "rsa:2048", "-nodes"]
    sign = ["openssl", "x509", "-req", "-days", "2", "-CAcreateserial"]
    for command in (
        [*new, "-x509", "-days", "2", "-subj", "/CN=ours", "-keyout", made["ca.key"], "-out", made["ca.pem"]],
        [*new, "-subj", "/CN=cluster", "-keyout", made["our.key"], "-out", made["our.csr"]],
        [
            *sign,
            "-in",
            made["our.csr"],
            "-CA",
            made["ca.pem"],
            "-CAkey",
            made["ca.key"],
            "-out",
            made["our.pem"],
        ],
    ):
        subprocess.run(command, check=True, capture_output=True)
    tls = "DASK_DISTRIBUTED__COMM__TLS__"
    return {
        "DASK_DISTRIBUTED__COMM__REQUIRE_ENCRYPTION": "True",
        f"{tls}CA_FILE": made["ca.pem"],
        **{f"{tls}{role}__CERT": made["our.pem"] for role in ("SCHEDULER", "WORKER", "CLIENT")},
        **{f"{tls}{role}__KEY": made["our.key"] for role in ("SCHEDULER", "WORKER", "CLIENT")},
    }


@pytest.mark.nightly
@pytest.mark.skipif(shutil.which("openssl") is None, reason="needs openssl")
def test_a_cluster_with_certificates_takes_only_who_has_one(tmp_path, config, undisturbed, monkeypatch):
    ours, theirs = tmp_path / "ours", tmp_path / "theirs"
    for folder in (ours, theirs):
        folder.mkdir()
    settings = _certificates(ours)
    made = Cluster(tmp_path, settings, "tls")
    try:
        assert made.address.startswith("tls://127.0.0.1:")
        for address, environment in (
            (made.address, {}),
            (made.address, _certificates(theirs)),
            (made.address.replace("tls", "tcp"), {}),
        ):
            command = [sys.executable, "-m", "impact_xval", "run", config, "--out", tmp_path / "a"]
            done = subprocess.run(
                [*map(str, command), "--scheduler", address],
                cwd=ROOT,
                env=os.environ | environment,
                capture_output=True,
                text=True,
                check=False,
                timeout=300,
            )
            assert done.returncode == 2, done.stderr
            assert f"--scheduler {address}: no Dask scheduler answers there" in done.stderr
            assert "Traceback" not in done.stderr
        for name, value in settings.items():
            monkeypatch.setenv(name, value)
        _run(config, tmp_path / "b", "--scheduler", made.address)
        assert _tables(tmp_path / "b") == undisturbed
    finally:
        made.stop()


def test_no_scheduler_is_one_line_and_leaves_nothing(tmp_path, capsys, monkeypatch):
    (tmp_path / "c.toml").write_text("solvers = ['state-transition']")
    monkeypatch.chdir(tmp_path)
    assert main(["run", "c.toml", "--scheduler", "nonsense"]) == 2
    error = capsys.readouterr().err
    assert "--scheduler nonsense: no Dask scheduler answers there" in error
    assert "legal: 'local', or an address such as tcp://host:8786 or" in error
    assert error.count("\n") == 1
    assert [path.name for path in tmp_path.iterdir()] == ["c.toml"]
