"""Kernels are compiled by one process each: side by side, processes compile different ones, and none is done twice."""

import errno
import os
import subprocess
import sys

import pytest
from filelock import FileLock

from impact_xval.experiments.sweep import kernels
from impact_xval.experiments.sweep.kernels import Kernels, compile_once, kernels_of
from impact_xval.model.compiled import is_compiled
from impact_xval.model.diagram import collide

KERNELS = """
from numba import njit

@njit(cache=True)
def one(x):
    return x + 1

@njit(cache=True)
def other(x):
    return x + 2
"""

PROCESS = """
import sys, time
from pathlib import Path
import kernels
from impact_xval.experiments.sweep.kernels import Kernels, compile_once

def use(kernel):
    print(kernel.py_func.__name__, flush=True)
    Path(kernel.py_func.__name__).touch()
    until = time.monotonic() + 20
    while not (Path("one").exists() and Path("other").exists()) and time.monotonic() < until:
        time.sleep(0.01)
    kernel(1.0)

print("ready", flush=True)
sys.stdin.readline()
compile_once([Kernels(name, kernel := getattr(kernels, name), lambda k=kernel: use(k)) for name in ("one", "other")])
"""


def test_a_process_that_has_to_wait_compiles_what_comes_next(monkeypatch):
    done = []

    def compiled(some, alone):
        if some.name == "at which another process is":
            return len(done) == 2
        done.append(some.name)
        return True

    monkeypatch.setattr(kernels, "_compiled", compiled)
    names = "at which another process is", "free", "later"
    waited, free, later = (Kernels(name, None, print) for name in names)
    compile_once([waited, free], meanwhile=[later])
    assert done == ["free", "later"]
    done.clear()
    compile_once([free], meanwhile=[later])
    assert done == ["free"]


@pytest.mark.slow
def test_each_kernel_is_compiled_by_one_of_two_processes(tmp_path):
    (tmp_path / "kernels.py").write_text(KERNELS)
    path = os.pathsep.join([str(tmp_path), *filter(None, sys.path)])
    processes = [
        subprocess.Popen(
            [sys.executable, "-c", PROCESS],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            cwd=tmp_path,
            env=os.environ | {"PYTHONPATH": path, "NUMBA_CACHE_DIR": str(tmp_path / "cache")},
        )
        for _ in range(2)
    ]
    assert [process.stdout.readline() for process in processes] == ["ready\n"] * 2
    for process in processes:
        process.stdin.write("\n")
        process.stdin.flush()
    compiled = [process.communicate(timeout=60)[0].split() for process in processes]
    assert [process.returncode for process in processes] == [0, 0]
    assert sorted(compiled) == [["one"], ["other"]]


def test_a_kernel_counts_as_compiled_once_its_source_is_no_newer(tmp_path, monkeypatch):
    monkeypatch.setattr("impact_xval.model.compiled.cache_folder", lambda kernel: tmp_path)
    assert not is_compiled(collide)
    version = "{}{}".format(*sys.version_info)
    index = tmp_path / f"diagram.collide-1.py{version}.nbi"
    index.touch()
    assert is_compiled(collide)
    os.utime(index, (0, 0))
    assert not is_compiled(collide)
    index.rename(tmp_path / "diagram.collide-1.py27.nbi")
    assert not is_compiled(collide)


def test_engines_are_compiled_for_where_a_run_has_one():
    assert "engines" in [some.name for some in kernels_of(["state-transition", "mujoco"])]
    assert "engines" not in [some.name for some in kernels_of(["state-transition", "bistiffness"])]


def test_a_cache_without_space_costs_the_cache_only(tmp_path, monkeypatch):
    monkeypatch.setattr(kernels, "is_compiled", lambda kernel: False)
    monkeypatch.setattr(kernels, "cache_folder", lambda kernel: tmp_path)
    tries = []

    def use():
        tries.append(len(tries))
        if len(tries) < 4:  # numba has compiled one more kernel, which it cannot keep
            raise OSError(errno.ENOSPC, "No space left on device")

    compile_once([Kernels("some", None, use)])
    assert tries == [0, 1, 2, 3]


def test_a_process_that_is_halted_while_it_compiles_is_not_waited_for_for_ever(tmp_path, monkeypatch):
    monkeypatch.setattr(kernels, "is_compiled", lambda kernel: False)
    monkeypatch.setattr(kernels, "cache_folder", lambda kernel: tmp_path)
    monkeypatch.setattr(kernels, "_PATIENCE", 0.2)
    used = []
    with FileLock(tmp_path / "compiling-some.lock"):
        compile_once([Kernels("some", None, lambda: used.append(1))])
    assert used == [1]


def test_of_what_is_left_to_the_interpreter_nothing_is_missing():
    assert is_compiled(collide.py_func)
