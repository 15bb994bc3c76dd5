"""The project itself: style, types, and that the README says what is so."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


def _run(*command):
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.parametrize("arguments", [["check"], ["format", "--check"]])
def test_style(arguments):
    folders = ("model", "compliant_baselines", "experiments", "tests", "benchmarks")
    _run(sys.executable, "-m", "ruff", *arguments, *folders)


@pytest.mark.slow
def test_types():
    _run(sys.executable, "-m", "pyright", "--pythonpath", sys.executable)


def _command(marker):
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    (found,) = re.findall(rf"<!-- {marker} command -->\n```sh\n(.*)\n```", text)
    return found


def test_the_readme_has_two_commands_of_one_line():
    for marker, last in (("run", "impact-xval run"), ("test", "pytest -m 'slow or not slow'")):
        command = _command(marker)
        assert command.startswith("python3 -m venv .venv && ")
        assert command.endswith(last)


def test_continuous_integration_runs_the_test_command_of_the_readme():
    script = (ROOT / ".ci/run").read_text(encoding="utf-8")
    extract = re.search(r"command=\$\((.*)\)\n", script)
    assert extract
    found = subprocess.run(["bash", "-c", extract[1]], cwd=ROOT, capture_output=True, text=True, check=True)
    assert found.stdout.strip() == _command("test")
    assert (ROOT / ".ci/run").stat().st_mode & 0o111


def test_every_file_of_a_run_is_in_the_readme():
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    tables = ("cells.parquet", "divergence.parquet", "curves.parquet", "ladder.parquet", "summary.md")
    for name in (*tables, "manifest.json", "report.html", "figures/", "parts/"):
        assert f"`{name}`" in text
