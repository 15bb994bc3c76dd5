"""What is installed owns one name: files of a user's own, called as our folders are, must not matter."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.compliant_baselines.third_party import install

ROOT = Path(__file__).parents[1]
OWN = "raise RuntimeError('a file of the user was imported')\n"
PLUGIN = """
from dataclasses import replace
from impact_xval.compliant_baselines.contract.state_transition import StateTransitionSolver


class Mine(StateTransitionSolver):
    name = "mine"

    def solve_many(self, collisions, settings=None):
        return [replace(outcome, v1=1.01 * outcome.v1) for outcome in super().solve_many(collisions, settings)]
"""
CONFIG = """
name = "own names"
solvers = ["state-transition", "mine"]
[grid]
stiffness_ratio = [0.5, 2.0]
mass_ratio = [1.0]
e1 = [0.8]
e2 = [0.6, 0.9]
"""

pytestmark = pytest.mark.exhaustive


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    """A folder that holds the files of the wheel that is built of the source distribution, as a release is."""
    folder, dist = tmp_path_factory.mktemp("wheel"), tmp_path_factory.mktemp("dist")
    subprocess.run([sys.executable, "-m", "build", "-o", dist, ROOT], check=True, capture_output=True)
    (built,) = dist.glob("*.whl")
    command = [sys.executable, "-m", "pip", "install", "-q", "--no-deps", "--target", folder, built]
    subprocess.run(command, check=True, capture_output=True)
    floors = {path.name for path in (folder / "impact_xval").iterdir() if path.is_dir()}
    assert floors >= {"model", "compliant_baselines", "experiments"}
    assert {path.name for path in folder.iterdir() if "dist-info" not in path.name} == {"bin", "impact_xval"}
    assert not any(path.is_symlink() for path in folder.rglob("*"))
    return folder


@pytest.fixture
def desk(tmp_path):
    """A folder of a user's, with a plug-in beside it."""
    for name in ("model", "compliant_baselines", "law"):
        tmp_path.joinpath(f"{name}.py").write_text(OWN)
    for name in ("experiments", "tests"):
        tmp_path.joinpath(name).mkdir()
        tmp_path.joinpath(name, "__init__.py").write_text(OWN)
    tmp_path.joinpath("experiment.toml").write_text(CONFIG)
    install(tmp_path / "plugins", "my-solver", {"mine": "my_solver:Mine"}, my_solver=PLUGIN)
    return tmp_path


@pytest.mark.parametrize("way", ["wheel", "editable", "checkout"])
@pytest.mark.parametrize("own_path", [True, False], ids=["own-folder-on-path", "own-folder-not-on-path"])
def test_names_of_a_user_do_not_matter(way, own_path, desk, request):
    ours = {"wheel": lambda: request.getfixturevalue("wheel"), "editable": str, "checkout": lambda: ROOT}[
        way
    ]()
    places = [str(place) for place in (desk / "plugins", ours) if str(place)]
    path = os.pathsep.join([*(["."] if own_path else []), *places])
    environment = {**os.environ, "PYTHONPATH": path}

    def run(*command):
        done = subprocess.run(command, cwd=desk, env=environment, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stdout + done.stderr
        return done.stdout

    (desk / "script.py").write_text(
        "import impact_xval, sys; from impact_xval import Collision, get_solver, solve\n"
        "print(impact_xval.__file__, solve(Collision(1.0, 1.0, 1.0, 1.0, 0.9, 0.9)).status, get_solver('mine').name)\n"
    )
    where, *rest = run(sys.executable, "script.py").split()
    assert rest == ["ok", "mine"]
    assert Path(where).is_relative_to(ours if way == "wheel" else ROOT)
    command = Path(sys.executable).with_name("impact-xval")
    run(command, "run", "experiment.toml", "--out", "out", "--workers", "2")
    if own_path:
        assert "mine" in run(command, "solvers")
        run(sys.executable, "-m", "impact_xval", "table", "out")
    assert (desk / "out" / "divergence.parquet").exists()


def test_nothing_but_the_package_is_importable_where_it_is_installed(tmp_path):
    code = "from importlib.util import find_spec; print([find_spec(n) for n in ('model', 'experiments', 'benchmarks')])"
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    done = subprocess.run(
        [sys.executable, "-c", code],
        cwd=tmp_path,
        env=environment,
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout.strip() == "[None, None, None]"
