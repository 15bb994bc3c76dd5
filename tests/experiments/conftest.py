import shutil
from pathlib import Path

import pytest

from impact_xval.experiments.config.experiment import parse_config
from impact_xval.experiments.presentation.report import present_run
from impact_xval.experiments.sweep.run import present_once, run_sweep
from tests.experiments import fakes
from tests.model.conftest import compiled_kernels  # noqa: F401

SMALL = {
    "name": "small",
    "scenario": "impact",
    "solvers": ["mujoco", "pybullet"],
    "chunk_size": 4,
    "grid": {"stiffness_ratio": [0.5, 1.0, 2.0], "mass_ratio": [1.0, 1.5], "e1": [0.5, 0.9], "e2": [0.7]},
}

CHAINS = {
    "name": "few chains",
    "solvers": ["bistiffness", "kelvin-voigt", "mujoco"],
    "chain": {"arrangement": ["cradle", "pile"], "balls": [2, 3, 4], "e": [0.6, 0.9], "exponent": [1.0, 1.5]}
    | {"stiffness_taper": 1.0},
    "figure_chain": {"balls": 4, "e": 0.8},
}

#: Text with HTML and scripts that pages, tables and LaTeX must show unchanged.
HOSTILE = "</script><script>document.title = 'taken'</script><img src=x onerror=\"document.title='taken'\">"


def tables_of(root):
    return {path.name: path.read_bytes() for path in root.iterdir() if path.suffix in (".csv", ".parquet")}


def swept(root, resolve=fakes.shifted, **changes):
    """Run `SMALL` with some keys changed in this process, and return its folder; None removes a key."""
    data = {key: value for key, value in (SMALL | changes).items() if value is not None}
    return run_sweep(parse_config(data), root, isolate=False, resolve=resolve).folder


def resumed(root, config=None, present=None, **how):
    """Continue a run in this process and return the lines that it reported.

    By default the run is `SMALL`, solved by `fakes.shifted`.
    """
    said, config = [], config or parse_config(SMALL)
    how = {"resolve": fakes.shifted, "progress": lambda done, total, line: said.append(line)} | how
    result = run_sweep(config, root, isolate=False, to_be_presented=present is not None, **how)
    if present is not None:
        present_once(result, present, isolate=False)
    return said


@pytest.fixture(scope="session")
def engine_run(tmp_path_factory):
    """Folder of a small run of MuJoCo and two exact laws, with its page. Tests must not change it."""
    root = tmp_path_factory.mktemp("engines") / "a run"
    solvers = ["kelvin-voigt", "bistiffness", "mujoco"]
    settings = {"solvers": solvers, "scenario": "drop", "v0": -2.0, "name": HOSTILE}
    present_once(run_sweep(parse_config(SMALL | settings), root, to_be_presented=True), present_run)
    return root


@pytest.fixture(scope="session")
def chain_run(tmp_path_factory):
    """Folder of a small run of chains, with its page. Engines refuse half of the chains. Tests must not change it."""
    root = tmp_path_factory.mktemp("chains") / "run"
    result = run_sweep(parse_config(CHAINS), root, isolate=False, to_be_presented=True)
    present_once(result, present_run, isolate=False)
    return root


@pytest.fixture(scope="session")
def fake_run(tmp_path_factory):
    """A small run of an engine that is 0.01 m/s off and of a missing engine. Tests must not change it."""
    return swept(tmp_path_factory.mktemp("fakes") / "run")


@pytest.fixture
def run(fake_run, tmp_path):
    """A copy of the folder of `fake_run`, which a test may change."""
    return Path(shutil.copytree(fake_run.root, tmp_path / "run"))
