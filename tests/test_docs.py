"""Pages of the documentation: their code runs, their commands print what is shown, and the site builds."""

import json
import re
import shlex
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree

import pytest
import typer

from impact_xval.compliant_baselines import get_solver
from impact_xval.experiments.commands.cli import app, main
from impact_xval.experiments.config.experiment import load_config
from impact_xval.experiments.hypothesis.config import load_hypothesis_config as load_hypothesis
from impact_xval.experiments.hypothesis.own import load_own_collision
from tests.browser import opened

ROOT = Path(__file__).parents[1]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]

#: Blocks of code on all pages: page, language, code, and the output that is shown directly below, if any.
BLOCKS = [
    (page.relative_to(ROOT).as_posix(), *block)
    for page in PAGES
    for block in re.findall(
        r"^```(\w+)\n(.*?)^```$(?:\n\n```text\n(.*?)^```$)?", page.read_text(encoding="utf-8"), re.M | re.S
    )
]

#: Pages with Python code other than examples. The examples have tests of their own.
PYTHON = sorted({page for page, language, code, _ in BLOCKS if language == "python" and "--8<--" not in code})

#: Solvers whose engine may be missing on a machine.
OPTIONAL = ("dart", "pymunk", "rapier", "sapien", "pybullet", "newton")

#: A number that is not a part of a word.
NUMBER = r"(?<![\w.])-?\d+\.?\d*(?:e[+-]?\d+)?(?![\w.])"

#: A small run instead of the run that the pages make with --quick. It is as small as the commands of the pages allow.
RUN = """
solvers = ["bistiffness", "kelvin-voigt", "mujoco"]
scenario = "impact"
convergence = {enabled = false}
[grid]
stiffness_ratio = {log = [0.1, 10, 4]}
mass_ratio = [0.5, 2]
e1 = [0.5, 0.9]
e2 = [0.5, 0.9]
"""


def blocks(language):
    """Return page, code and shown output of all blocks in a language, as parameters of a test."""
    found = [pytest.param(*rest, id=page) for page, each, *rest in BLOCKS if each == language]
    assert found
    return found


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Make a folder with the examples, and with a run where the pages have one."""
    folder = tmp_path_factory.mktemp("docs")
    folder.joinpath("examples").symlink_to(ROOT / "examples")
    folder.joinpath("small.toml").write_text(RUN, encoding="utf-8")
    assert main(["run", str(folder / "small.toml"), "--out", str(folder / "runs/quick")]) == 0
    return folder


def commands(code):
    """List the words of each `impact-xval` command in a block of shell code."""
    lines = [shlex.split(line, comments=True) for line in code.replace("\\\n", " ").splitlines()]
    return [words[1:] for words in lines if words and words[0].endswith("impact-xval")]


def skip_without(code):
    asked = code.replace("newton-restitution", "")  # newton-restitution is a law and no engine
    missing = [name for name in OPTIONAL if name in asked and get_solver(name).unavailable()]
    if missing:
        pytest.skip(f"not installed: {', '.join(missing)}")


@pytest.mark.parametrize(("code", "shown"), blocks("sh"))
def test_commands_have_options_that_are_legal(code, shown):
    group = typer.main.get_command(app)
    for name, *arguments in commands(code):
        group.commands[name].make_context(name, arguments).close()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("code", "shown"), [each for each in blocks("sh") if each.values[1] and "run " not in each.values[0]]
)
def test_commands_print_what_is_shown(code, shown, folder, capsys, monkeypatch):
    skip_without(code)
    monkeypatch.chdir(folder)
    capsys.readouterr()
    for words in commands(code):
        assert main(words) in (0, 3), words
    _held(shown, capsys.readouterr().out)


@pytest.mark.slow
@pytest.mark.parametrize("page", PYTHON)
def test_code_runs_and_prints_what_is_shown(page, folder, capsys, monkeypatch):
    monkeypatch.chdir(folder)
    names = {}
    for name, language, code, shown in BLOCKS:
        if (name, language) == (page, "python") and "--8<--" not in code:
            skip_without(code)
            capsys.readouterr()
            exec(code, names)
            _held(shown, capsys.readouterr().out)


def test_formulas_are_ones_that_the_site_can_show():
    """The converter of the site knows every command in a formula, and no formula ends a cell of a table."""
    from latex2mathml.converter import convert

    blocks_of_formulas = [(page, code) for page, language, code, _ in BLOCKS if language == "math"]
    inline = [
        (page.name, formula)
        for page in PAGES
        for formula in re.findall(r"\$`([^`]+)`\$", page.read_text(encoding="utf-8"))
    ]
    assert blocks_of_formulas
    assert inline
    for page, formula in blocks_of_formulas + inline:
        shown = ElementTree.fromstring(convert(formula))
        assert "\\" not in "".join(shown.itertext()), (page, formula)
    rows = [row for page in PAGES for row in re.findall(r"^\|.*", page.read_text(encoding="utf-8"), re.M)]
    for formula in re.findall(r"\$`([^`]+)`\$", "\n".join(rows)):
        assert "|" not in formula, formula


@pytest.mark.parametrize(("code", "shown"), blocks("toml"))
def test_experiments_are_legal(code, shown, tmp_path):
    path = tmp_path / "experiment.toml"
    path.write_text(code, encoding="utf-8")
    if "masses = " in code:
        assert load_own_collision(path) is not None
    else:
        (load_hypothesis if "contrast" in code else load_config)(path)


def _held(shown, printed):
    """Assert that every shown line was printed, with equal words and with numbers within 1 % or 1e-5."""
    lines = [line.split() for line in printed.splitlines()]
    for line in shown.splitlines():
        assert any(_alike(line.split(), words) for words in lines), line


def _alike(one, two):
    words = [[re.sub(NUMBER, "#", word) for word in line] for line in (one, two)]
    numbers = [[float(each) for each in re.findall(NUMBER, " ".join(line))] for line in (one, two)]
    return words[0] == words[1] and numbers[0] == pytest.approx(numbers[1], rel=1e-2, abs=1e-5)


@pytest.mark.nightly
def test_the_site_builds_without_a_warning(tmp_path):
    built = subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", tmp_path],
        cwd=ROOT,
        capture_output=True,
        text=True,
    )
    assert built.returncode == 0, built.stderr
    schema = json.loads(tmp_path.joinpath("experiment.schema.json").read_text(encoding="utf-8"))
    assert "step_fraction" in schema["properties"]
    assert "step_fraction" in tmp_path.joinpath("configuration.html").read_text(encoding="utf-8")
    assert "solve_batch" in tmp_path.joinpath("api/solving.html").read_text(encoding="utf-8")
    theory = tmp_path.joinpath("theory.html").read_text(encoding="utf-8")
    assert "<math" in theory
    assert "$`" not in theory
    address = tmp_path.joinpath("theory.html").as_uri()
    # the page loads its own files, which are in the same folder
    with opened(address, width=1200, offline=False) as page:
        assert page.locator(".md-sidebar--primary").bounding_box()["x"] >= 0  # the navigation is visible
        fetched = page.evaluate("performance.getEntriesByType('resource').map(entry => entry.name)")
    assert all(name.startswith("file:") for name in fetched), fetched
