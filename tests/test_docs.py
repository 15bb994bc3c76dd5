"""Every block of code of the pages and every example runs; the site is built without a warning.

A comment directly above a block says how it is run, ``<!-- test: ... -->``, one line each:

``skip: REASON``      it is not run; ``pytest tests/test_docs.py -m '' -rs`` lists these
``exhaustive``        run by the exhaustive test of its page only
``needs MODULE``      run where the module can be imported
``exit N [N ...]``    exit code of each of its commands; by default 0
``instead A => B``    B stands for A, so that it takes seconds
``file NAME``         it is a file, there before the first block is run
``append NAME``       its lines go to the end of a file
``plugin``            it names the solvers of a distribution, which is there before the first block is run
``prints``            each of its lines is printed by the block before it, spaces aside

``prepare NAME ...`` anywhere in a page lays out what its commands are given (`PREPARED`), and
``python elsewhere: TEST`` says which test runs the page's Python.
"""

import importlib.util
import json
import math
import os
import re
import shutil
import subprocess
import sys
import tomllib
from contextlib import redirect_stdout
from dataclasses import dataclass
from io import StringIO
from pathlib import Path
from typing import Any

import pytest

from impact_xval.experiments.config.configuration import Config, parse_config
from impact_xval.experiments.config.errors import UserError
from impact_xval.model.collision import STATUSES
from tests.compliant_baselines.third_party import install
from tests.experiments.hypothesis.test_command import SMALL

ROOT = Path(__file__).parents[1]
PAGES = (ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md")))
EXAMPLES = sorted((ROOT / "examples").glob("*.py"))
NOTEBOOKS = sorted((ROOT / "examples").glob("*.ipynb"))
LANGUAGES = ("sh", "python")

#: Eight cells of the built-in solvers.
EXPERIMENT = """
[grid]
stiffness_ratio = [0.01, 0.1, 1.0, 40.0]
mass_ratio = [1.1547]
e1 = [0.9]
e2 = [0.7, 0.9]
"""
#: Files that commands of the pages are given; ``my-run`` and ``runs/default`` are the run of ``my-experiment.toml``.
PREPARED = {
    "my-experiment.toml": EXPERIMENT,
    "my.toml": SMALL,
    "my-search.toml": '[search]\nsolver = "kelvin-voigt"\npopulation = 8\ngenerations = 2\n',
    "my-columns.toml": '[column]\narrangement = "cradle"\nballs = [3]\ne = [0.9]\nstiffness_taper = [1.0]\n',
    "robot.urdf": """<robot name="ball"><link name="ball">
<inertial><mass value="1"/><inertia ixx="0.004" ixy="0" ixz="0" iyy="0.004" iyz="0" izz="0.004"/></inertial>
<collision><geometry><sphere radius="0.1"/></geometry></collision></link></robot>""",
}
RUNS = ("my-run", "runs/default")

#: Directives of a whole page.
OF_PAGE = ("prepare ", "python elsewhere: ")

_BLOCK = re.compile(r"((?:^<!-- .* -->\n)*)^```(\w*)\n((?:.*\n)*?)```$", re.M)
_DIRECTIVE = re.compile(r"<!-- test: (.*) -->")


@dataclass(frozen=True)
class Block:
    """A block of a page, and what the comments above it say."""

    page: str
    line: int
    language: str
    text: str
    directives: tuple[str, ...]
    elsewhere: bool = False

    def said(self, name):
        """Return what follows a directive, a list."""
        return [
            each[len(name) :].lstrip(": ")
            for each in self.directives
            if each.split(":")[0].split()[0] == name
        ]

    @property
    def runs(self):
        return self.language in LANGUAGES and not self.said("skip") and not self.said("file")

    def __str__(self):
        return f"{self.page}:{self.line}"


def blocks_of(page):
    text = page.read_text(encoding="utf-8")
    elsewhere = re.findall(r"<!-- test: python elsewhere: (.*) -->", text)
    found = []
    for match in _BLOCK.finditer(text):
        directives, other = _DIRECTIVE.findall(match[1]), match[2] == "python" and bool(elsewhere)
        if other:
            directives = [f"skip: {elsewhere[0]}"]
        line = text.count("\n", 0, match.start(2)) + 1
        found.append(Block(page.name, line, match[2], match[3], tuple(directives), other))
    return found


BLOCKS = {page: blocks_of(page) for page in PAGES}
SKIPPED = [block for blocks in BLOCKS.values() for block in blocks if block.said("skip")]


def pages_with(exhaustive):
    """Pages with blocks to run: the exhaustive test of a page runs all, the other one those that are not marked."""
    return [
        pytest.param(page, id=page.name)
        for page, blocks in BLOCKS.items()
        if any(block.runs and (bool(block.said("exhaustive")) == exhaustive) for block in blocks)
    ]


@pytest.fixture(scope="module")
def tools(tmp_path_factory):
    """A folder of programs: the command and the interpreter of this checkout."""
    folder = tmp_path_factory.mktemp("bin")
    for name, arguments in (("impact-xval", "-m impact_xval "), ("python", "")):
        program = folder / name
        program.write_text(f'#!/bin/sh\nexec "{sys.executable}" {arguments}"$@"\n', encoding="utf-8")
        program.chmod(0o755)
    return folder


class Desk:
    """Where the blocks of one page are run, one after the other."""

    def __init__(self, folder, tools):
        self.folder, self.names, self.printed = folder, {"__name__": "__main__"}, ""
        path = os.pathsep.join((str(folder), str(ROOT), os.environ.get("PYTHONPATH", "")))
        self.environment = os.environ | {
            "PATH": f"{tools}{os.pathsep}{os.environ['PATH']}",
            "PYTHONPATH": path,
            "COLUMNS": "200",
        }

    def shell(self, command, codes):
        # One command after the other where their exit codes are given, else all of them as they stand.
        parts = re.sub(r"\\\n\s*", " ", command).strip().splitlines() if codes else [command]
        self.printed = ""
        for part, code in zip(parts, codes or [0], strict=True):
            done = subprocess.run(
                ["bash", "-euo", "pipefail", "-c", part],
                cwd=self.folder,
                env=self.environment,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                text=True,
                check=False,
            )
            self.printed += done.stdout
            assert done.returncode == code, f"{part}\n{done.stdout}"

    def python(self, code, where):
        said = StringIO()
        with redirect_stdout(said):
            exec(compile(code, where, "exec"), self.names)
        self.printed = said.getvalue()

    def compare(self, block):
        lines = {_plain(line) for line in self.printed.splitlines()}
        for line in block.text.splitlines():
            if "pybullet" not in line or importlib.util.find_spec("pybullet"):
                assert _plain(line) in lines, f"{block}: {line}\nis not in\n{self.printed}"


def _plain(line):
    return " ".join(line.split())


@pytest.fixture(scope="module")
def finished(tools, tmp_path_factory):
    """The finished run of `EXPERIMENT`."""
    folder = tmp_path_factory.mktemp("finished")
    folder.joinpath("my-experiment.toml").write_text(EXPERIMENT, encoding="utf-8")
    Desk(folder, tools).shell("impact-xval run my-experiment.toml --out my-run", [])
    return folder / "my-run"


def run_page(page, exhaustive, folder, tools, request):
    desk, blocks = Desk(folder, tools), BLOCKS[page]
    for name in " ".join(
        re.findall(r"<!-- test: prepare (.*) -->", page.read_text(encoding="utf-8"))
    ).split():
        if name in RUNS:
            shutil.copytree(request.getfixturevalue("finished"), folder / name)
        else:
            folder.joinpath(name).write_text(PREPARED[name], encoding="utf-8")
    for block in blocks:
        for name in block.said("file"):
            folder.joinpath(name).write_text(block.text, encoding="utf-8")
        if block.said("plugin"):
            ((_, points),) = tomllib.loads(block.text)["project"]["entry-points"].items()
            install(folder, "a-plug-in", points)
    ran = False
    for block in blocks:
        if block.said("append") and ran:
            with folder.joinpath(*block.said("append")).open("a", encoding="utf-8") as file:
                file.write(block.text)
        elif block.said("prints") and ran:
            desk.compare(block)
        elif block.runs:
            missing = [name for name in block.said("needs") if importlib.util.find_spec(name) is None]
            ran = not missing and (exhaustive or not block.said("exhaustive"))
            if not ran:
                continue
            text = block.text
            for each in block.said("instead"):
                old, _, new = each.partition(" => ")
                assert old in text, f"{block}: nothing to replace: {old}"
                text = text.replace(old, new)
            if block.language == "sh":
                desk.shell(text, [int(code) for codes in block.said("exit") for code in codes.split()])
            else:
                desk.python(text, str(block))


@pytest.fixture
def desk_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    return tmp_path


@pytest.mark.slow
@pytest.mark.parametrize("page", pages_with(exhaustive=False))
def test_the_blocks_of_a_page_run(page, desk_folder, tools, request):
    run_page(page, False, desk_folder, tools, request)


@pytest.mark.exhaustive
@pytest.mark.parametrize("page", pages_with(exhaustive=True))
def test_all_blocks_of_a_page_run(page, desk_folder, tools, request):
    run_page(page, True, desk_folder, tools, request)


@pytest.mark.slow
@pytest.mark.parametrize("block", SKIPPED, ids=str)
def test_a_block_that_is_not_run_says_why(block):
    (reason,) = block.said("skip")
    assert len(reason.split()) > 3
    for test in re.findall(r"tests/[\w/]+\.py", reason):
        assert (ROOT / test).exists()
    pytest.skip(reason)


def test_directives_are_known_and_stand_above_a_block():
    known = {"skip", "exhaustive", "needs", "exit", "instead", "file", "append", "plugin", "prints"}
    for page, blocks in BLOCKS.items():
        of_blocks = [each for block in blocks for each in block.directives if not each.startswith(OF_PAGE)]
        assert {each.split(":")[0].split()[0] for each in of_blocks} <= known, page.name
        written = _DIRECTIVE.findall(page.read_text(encoding="utf-8"))
        of_page = [each for each in written if each.startswith(OF_PAGE)]
        elsewhere = [block for block in blocks if block.language == "python" and block.elsewhere]
        assert len(written) == len(of_blocks) + len(of_page) - len(elsewhere), page.name


@pytest.mark.slow
@pytest.mark.parametrize("example", EXAMPLES, ids=lambda path: path.name)
def test_an_example_runs(example, tmp_path, tools):
    Desk(tmp_path, tools).shell(f"python {example}", [])


@pytest.mark.slow
@pytest.mark.parametrize("notebook", NOTEBOOKS, ids=lambda path: path.name)
def test_a_notebook_prints_what_it_shows(notebook, desk_folder, tools):
    import matplotlib

    matplotlib.use("Agg")
    desk = Desk(desk_folder, tools)
    for number, cell in enumerate(json.loads(notebook.read_text(encoding="utf-8"))["cells"]):
        if cell["cell_type"] == "code":
            desk.python("".join(cell["source"]), f"{notebook.name}, cell {number}")
            shown = [each for each in cell["outputs"] if each["output_type"] == "stream"]
            assert desk.printed == "".join(line for each in shown for line in each["text"]), f"cell {number}"


def _parity():
    spec = importlib.util.spec_from_file_location("parity", ROOT / "docs/hooks/parity.py")
    assert spec
    assert spec.loader
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.slow
def test_the_table_of_solvers_is_what_they_answer():
    from impact_xval.compliant_baselines import get_solver, solver_names
    from impact_xval.compliant_baselines.contract.registry import is_ours

    parity, page = _parity(), (ROOT / "docs/parity.md").read_text(encoding="utf-8")
    head, _, *rows = re.findall(r"^\| (.*) \|$", page.split("<!-- parity -->\n")[1], re.M)
    assert tuple(head.split(" | ")) == parity.HEAD
    names = [name for name in solver_names(on_request=True) if is_ours(name)]
    assert [row.split(" | ")[0] for row in rows] == [f"`{name}`" for name in names]
    here = [(name, row) for name, row in zip(names, rows, strict=True) if not get_solver(name).unavailable()]
    assert len(here) > 10
    for name, row in here:
        assert tuple(row.split(" | ")) == parity.row(name)


#: Tables of which the schema of a configuration and the code that validates it think alike.
LEGAL = (
    {},
    {"grid": {"e1": [0.0, 1.0], "stiffness_ratio": [0.0, math.inf], "mass_ratio": {"log": [0.5, 2.0, 3]}}},
    {"stiffness_ratio_cutoff": 1e5},
    {"stiffness_ratio_cutoff": "exact"},
    {"sample": {"e2": 0.9, "stiffness_ratio": {"log": [0.1, 10.0]}}},
    {
        "column": {
            "arrangement": "cradle",
            "balls": 5,
            "exponent": 1.5,
            "e": [0.9],
            "gap": {"linear": [0.0, 1.0, 3]},
        }
    },
    {"column": {"arrangement": ["drop", "stack"], "balls": [2, 3]}},
)
ILLEGAL = (
    {"grid": {"e1": [2.0]}},
    {"grid": {"e1": []}},
    {"grid": {"e1": 0.9}},
    {"grid": {"e1": [0.9, 0.9]}},
    {"grid": {"e1": {"log": [0.1, 1.0]}}},
    {"grid": {"e1": {"lin": [0.1, 1.0, 3]}}},
    {"grid": {"mass_ratio": [0.0]}},
    {"grdi": {}},
    {"m1": -1.0},
    {"stiffness_ratio_cutoff": "never"},
    {"stiffness_ratio_cutoff": 1.0},
    {"sample": {"e2": [0.9]}},
    {"sample": {"e2": 1.1}},
    {"column": {"arrangement": "circle"}},
    {"column": {"arrangement": []}},
    {"column": {"e": 1.5}},
)


@pytest.mark.parametrize("data", [*LEGAL, *ILLEGAL], ids=str)
def test_the_schema_of_a_configuration_takes_what_the_code_takes(data):
    jsonschema = pytest.importorskip(
        "jsonschema", reason="needs the extra docs: pip install 'impact-xval[docs]'"
    )
    validator = jsonschema.Draft202012Validator(Config.model_json_schema())
    assert validator.is_valid(data) == (data in LEGAL)
    if data in LEGAL:
        parse_config(data)
    else:
        with pytest.raises(UserError):
            parse_config(data)


def test_every_page_is_in_the_navigation():
    nav = (ROOT / "mkdocs.yml").read_text(encoding="utf-8").partition("\nnav:\n")[2]
    named = re.findall(r"([\w/-]+\.md)$", nav, re.M)
    pages = {path.relative_to(ROOT / "docs").as_posix() for path in (ROOT / "docs").rglob("*.md")}
    assert sorted(named) == sorted(pages)


@pytest.mark.parametrize("page", ["which-command.md", "commands.md"])
def test_every_command_is_named(page):
    import typer.main

    from impact_xval.experiments.commands.cli import app

    text = (ROOT / "docs" / page).read_text(encoding="utf-8")
    group: Any = typer.main.get_command(app)
    missing = [name for name in group.commands if not re.search(rf"`(impact-xval )?{name}[ `]", text)]
    assert missing == []


def test_every_status_has_a_row():
    text = (ROOT / "docs/statuses.md").read_text(encoding="utf-8")
    assert sorted(re.findall(r"^\| `(\w+)` \| ", text, re.M)) == sorted(STATUSES)


@pytest.mark.slow
def test_the_site_is_built_without_a_warning(tmp_path):
    for module in ("material", "mkdocstrings"):
        pytest.importorskip(module, reason="needs the extra docs: pip install 'impact-xval[docs]'")
    done = subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", tmp_path / "site"],
        cwd=ROOT,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert "WARNING -" not in done.stderr
    pages = {
        path.relative_to(tmp_path / "site").as_posix(): path.read_text(encoding="utf-8")
        for path in (tmp_path / "site").rglob("*.html")
    }
    for page in (ROOT / "docs").glob("*.md"):
        assert f"{page.stem}.html" in pages
    for name, text in pages.items():
        # Nothing is fetched from a network, and every marker of a generated text is filled in.
        assert re.findall(r'<(?:script|img|iframe)[^>]* src="?(?:https?:)?//', text) == [], name
        assert re.findall(r'<link[^>]* rel="?(?:stylesheet|preconnect)[^>]*https?://', text) == [], name
        assert "generated: " not in text, name
    for command in ("compare-runs", "scoreboard", "solve"):
        assert f'id="{command}"' in pages["command-reference.html"]
    schema = json.loads((tmp_path / "site/configuration.schema.json").read_text(encoding="utf-8"))
    assert all(f"<code>{key}</code>" in pages["configuration.html"] for key in schema["properties"])
