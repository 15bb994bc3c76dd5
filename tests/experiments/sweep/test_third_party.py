"""Solvers of other distributions that harm their process, in real runs: each costs its own cells, and nothing else."""

import json
import os
import subprocess
import sys
import time
from pathlib import Path

import psutil
import pyarrow.compute as pc
import pyarrow.parquet as pq
import pytest

from tests.experiments import hostile_plugins as plugins

ROOT = Path(__file__).parents[3]
_OURS = ["state-transition", "kelvin-voigt", "mujoco"]
_CELLS = [0.9, 0.7, plugins.STRUCK]


def _environment(site):
    return os.environ | {"PYTHONPATH": os.pathsep.join([str(site), str(ROOT)])}


def _python(site, *arguments):
    """Run a module of Python where the solvers of a folder are installed."""
    return subprocess.run(
        [sys.executable, "-m", *map(str, arguments)],
        env=_environment(site),
        capture_output=True,
        check=False,
        timeout=900,
    )


def _laid_down(folder, kinds, cell_timeout):
    """Write an experiment with solvers of some kinds; where these are installed, and the command that runs it."""
    plugins.lay_down(folder / "site", kinds)
    (folder / "c.toml").write_text(
        f"scenario = 'impact'\nsolvers = {[*_OURS[1:], *kinds, plugins.GOOD]}\nchunk_size = 2\n"
        f"step_fraction = 0.01\ncell_timeout = {cell_timeout}\n[grid]\nstiffness_ratio = [1.5]\n"
        f"mass_ratio = [1.5]\ne1 = {_CELLS}\ne2 = [0.7]\n"
    )
    return folder / "site", ("tests.experiments.runner", folder / "c.toml", folder / "run")


def _run(folder, kinds, cell_timeout, *options):
    site, command = _laid_down(folder, kinds, cell_timeout)
    return folder / "run", _python(site, *command, *options)


def _rows(root, *names):
    """Rows of some solvers, every number to the last bit."""
    rows = pq.read_table(root / "cells.parquet", filters=pc.field("solver").isin(names)).to_pylist()
    assert len(rows) == len(_CELLS) * len(names)
    return list(map(repr, rows))


@pytest.fixture(scope="module")
def alone(tmp_path_factory):
    root, done = _run(tmp_path_factory.mktemp("alone"), {}, 60)
    assert done.returncode == 0, done.stderr.decode()
    return root


def _contained(folder, kinds, cell_timeout, alone, *options):
    root, done = _run(folder, kinds, cell_timeout, *options)
    assert done.returncode == 0, done.stderr.decode()
    said = (done.stdout + done.stderr).decode()
    assert [letter for letter in set(said) if not (letter.isprintable() or letter in "\n\t")] == []
    assert len(said) < 500_000
    assert _rows(root, *_OURS, plugins.GOOD) == _rows(alone, *_OURS, plugins.GOOD)
    for row in pq.read_table(root / "cells.parquet").to_pylist():
        if row["solver"] in kinds:
            _is_as_expected(row, kinds[row["solver"]])
    _none_left(folder / "site")


def _is_as_expected(row, kind):
    found = row["solver"], row["status"], row["reason"]
    if kind.place == "solving" and row["e1"] != plugins.STRUCK:
        assert row["status"] in ("ok", "limit"), found
        return
    assert row["status"] in kind.statuses, found
    assert row["status"] in ("ok", "limit") or kind.says in row["reason"], found


def _none_left(site):
    until = time.monotonic() + 10
    while left := [
        p for p in psutil.process_iter(["cmdline"]) if str(site) in " ".join(p.info["cmdline"] or ())
    ]:
        assert time.monotonic() < until, left
        time.sleep(0.1)


@pytest.mark.slow
def test_one_that_cannot_be_asked_what_it_is_is_unavailable(tmp_path, alone):
    _contained(tmp_path, plugins.SPEECHLESS, 6, alone, "--workers", "1")


@pytest.mark.slow
def test_one_that_changes_its_interpreter_changes_no_other_row(tmp_path, alone):
    _contained(tmp_path, plugins.CHANGING, 30, alone, "--workers", "2")


@pytest.mark.slow
def test_one_that_leaves_something_behind_costs_its_cells(tmp_path, alone):
    _contained(tmp_path, plugins.LEAVING, 10, alone, "--workers", "1")


@pytest.mark.slow
def test_one_that_kills_its_caller_costs_its_cell(tmp_path, alone):
    _contained(tmp_path, plugins.KILLING, 10, alone, "--workers", "1")


@pytest.mark.parametrize(
    ("dies", "says"),
    [
        ("", "asked what it is, it gave no answer: its process died: SIGKILL"),
        ("once", "None"),  # which may have been anybody's doing
    ],
)
def test_one_that_kills_whoever_asks_what_it_is_does_not_kill_the_main_process(tmp_path, dies, says):
    kill = plugins.SECRETIVE["asker-killer"]
    once = f"m = {str(tmp_path / 'died')!r}; os.path.exists(m) or (open(m, 'w').close(), {kill.does})"
    plugins.lay_down(tmp_path, {"asker-killer": kill._replace(does=once) if dies else kill})
    code = (
        "from impact_xval.compliant_baselines import get_solver\n"
        "from impact_xval.experiments.sweep.third_party import contained\n"
        "print(contained(get_solver, 30)('asker-killer').unavailable())"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], env=_environment(tmp_path), capture_output=True, text=True, check=False
    )
    assert done.stdout.startswith(says), done.stderr


@pytest.mark.slow
def test_its_process_does_not_outlive_a_killed_run(tmp_path):
    site, run = _laid_down(tmp_path, {}, 60)
    process = subprocess.Popen(
        [sys.executable, "-m", *run], env=_environment(site), stdout=subprocess.DEVNULL
    )
    while not list(tmp_path.glob("run/parts/0*")):
        assert process.poll() is None
        time.sleep(0.01)
    process.kill()
    process.wait()
    _none_left(site)


@pytest.mark.slow
def test_so_it_is_on_a_cluster(tmp_path, alone):
    kinds = {name: (plugins.SPEECHLESS | plugins.CHANGING)[name] for name in ("import-leave", "builtins")}
    _contained(tmp_path, kinds, 10, alone, "--scheduler", "local", "--workers", "2")


@pytest.mark.slow
def test_commands_that_call_one_solver_say_what_it_did(tmp_path):
    names = ("import-leave", "unavailable-segfault", "collision", "once-dead")
    plugins.lay_down(
        tmp_path, {name: (plugins.SPEECHLESS | plugins.CHANGING | plugins.LEAVING)[name] for name in names}
    )
    listed = _python(tmp_path, "impact_xval", "solvers")
    assert listed.returncode == 0
    assert "its process died: exit code 0" in " ".join(listed.stdout.decode().split())
    ratios = ("--stiffness-ratio", "2", "--mass-ratio", "1", "--e1", plugins.STRUCK, "--e2", "0.7", "--json")
    chosen = [option for name in (*names, plugins.GOOD) for option in ("--solver", name)]
    solved = _python(tmp_path, "impact_xval", "solve", *ratios, *chosen)
    assert solved.returncode == 0
    assert [one["status"] for one in json.loads(solved.stdout)] == [
        *2 * ["unavailable"],
        *2 * ["crashed"],
        "ok",
        "ok",  # the model, which is added
    ]
    assert _python(tmp_path, "impact_xval", "conform", "import-leave").returncode == 2
    conform = _python(tmp_path, "impact_xval", "conform", "once-dead", "--law", "none")
    assert conform.returncode == 1
    assert b"FAILED  refuses with a reason: its process died: SIGABRT" in conform.stdout
    assert b"passed  leaves no trace" in conform.stdout
