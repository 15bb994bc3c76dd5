"""A solver of one's own is written as the page shows it, and keeps the contract as it is."""

import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from impact_xval.experiments.commands.cli import main
from tests.compliant_baselines.third_party import install

ROOT = Path(__file__).parents[3]
PAGE = (ROOT / "docs/adding-a-solver.md").read_text(encoding="utf-8")


def test_it_writes_what_the_page_shows(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["new-solver", "tiny"]) == 0
    assert capsys.readouterr().out == "tiny: pip install -e tiny, then impact-xval conform tiny\n"
    shown = re.findall(r"^```(?:python|toml)\n((?:.*\n)*?)```$", PAGE, re.M)
    for name in ("tiny_engine.py", "pyproject.toml", "test_tiny_engine.py"):
        assert (tmp_path / "tiny" / name).read_text(encoding="utf-8") in shown, name


@pytest.mark.parametrize("name", ["", "Tiny", "1st", "a_b", "a--b", "-a", "a" * 41, "../x", "mujoco"])
def test_other_names_are_refused_in_a_line(tmp_path, monkeypatch, capsys, name):
    monkeypatch.chdir(tmp_path)
    assert main(["new-solver", "--", name]) == 2
    assert re.fullmatch(r"impact-xval: NAME = .*; legal: .*\n", capsys.readouterr().err)
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_holds_something_is_left_alone(tmp_path, capsys):
    (tmp_path / "mine").write_text("mine")
    assert main(["new-solver", "tiny", "--out", str(tmp_path)]) == 2
    assert "not empty (mine)" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["mine"]


@pytest.mark.slow
def test_what_is_written_keeps_the_contract_once_installed(tmp_path):
    assert main(["new-solver", "my-own", "--out", str(tmp_path / "package")]) == 0
    project = tomllib.loads((tmp_path / "package/pyproject.toml").read_text(encoding="utf-8"))
    points = project["project"]["entry-points"]["impact_xval.solvers"]
    text = (tmp_path / "package/my_own_engine.py").read_text(encoding="utf-8")
    install(tmp_path / "site", project["project"]["name"], points, my_own_engine=text)
    done = subprocess.run(
        [sys.executable, "-m", "impact_xval", "conform", "my-own"],
        capture_output=True,
        text=True,
        cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": str(tmp_path / "site")},
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert "FAILED" not in done.stdout
