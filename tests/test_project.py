"""The project itself: README and pages are true, versions agree. Style and types are checked by `.ci/run`."""

import ast
import math
import re
import subprocess
import tomllib
from pathlib import Path

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

import impact_xval
from impact_xval.compliant_baselines.engines.scene import Scene
from impact_xval.compliant_baselines.mapping import (
    damping_ratio,
    drake_side,
    mujoco_contact,
    restitution,
    textbook_damping_ratio,
)
from impact_xval.compliant_baselines.solver import Settings
from impact_xval.model import Collision

ROOT = Path(__file__).parents[1]
#: The three folders of code. The package holds them as links in a checkout, and as folders in an unpacked sdist.
FLOORS = [
    Path(impact_xval.__file__).parent / name for name in ("model", "compliant_baselines", "experiments")
]


def _command(marker):
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    (found,) = re.findall(rf"<!-- {marker} command -->\n```sh\n(.*)\n```", text)
    return found


def test_the_readme_has_two_commands_of_one_line_and_continuous_integration_runs_that_of_tests():
    for marker, last in (("run", "impact-xval run"), ("test", "pytest")):
        command = _command(marker)
        assert command.startswith("python3 -m venv .venv && ")
        assert command.endswith(last)
    script = (ROOT / ".ci/run").read_text(encoding="utf-8")
    extract = re.search(r"command=\$\((.*)\)\n", script)
    assert extract
    found = subprocess.run(["bash", "-c", extract[1]], cwd=ROOT, capture_output=True, text=True, check=True)
    assert found.stdout.strip() == _command("test")
    # the tests that the other command leaves out run nightly
    assert "pytest -m nightly" in (ROOT / ".ci/nightly").read_text(encoding="utf-8")
    assert (ROOT / ".ci/run").stat().st_mode & 0o111


def test_the_lock_file_holds_a_version_that_is_allowed_of_every_dependency():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    locked = {}
    for line in (ROOT / "requirements.lock").read_text(encoding="utf-8").splitlines():
        name, _, rest = line.partition("==")
        locked.setdefault(canonicalize_name(name.partition("[")[0]), []).append(rest.partition(" ;")[0])
    extras = (text for group in project["optional-dependencies"].values() for text in group)
    for needed in map(Requirement, (*project["dependencies"], *extras)):
        if needed.name != project["name"]:
            assert all(needed.specifier.contains(v) for v in locked[canonicalize_name(needed.name)]), needed


def test_the_citation_has_the_version_of_the_project():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert f"\nversion: {project['version']}\n" in (ROOT / "CITATION.cff").read_text(encoding="utf-8")


def test_checks_before_a_commit_are_those_of_continuous_integration():
    hooks = re.findall(r"entry: (.*)", (ROOT / ".pre-commit-config.yaml").read_text(encoding="utf-8"))
    script = (ROOT / ".ci/run").read_text(encoding="utf-8")
    assert script.split('step "style and types"\n')[1].split("\n\n")[0].splitlines() == hooks


def test_links_of_the_readme_lead_somewhere():
    for page in ROOT.glob("*.md"):  # links on other pages are checked when the site is built
        for target in re.findall(r"\]\(([^)#:]+)(?:#[^)]*)?\)", page.read_text(encoding="utf-8")):
            assert (page.parent / target).exists(), f"{page.name}: {target}"


def test_sections_that_docstrings_cite_are_there():
    found = []
    for folder in (*FLOORS, ROOT / "tests", ROOT / "benchmarks"):
        for file in folder.rglob("*.py"):
            # a citation may be split between two lines
            text = re.sub(r"\s*\n[ #]*", " ", file.read_text(encoding="utf-8"))
            found += [(file.name, *cited) for cited in re.findall(r"docs/([a-z-]+\.md), section (\d+)", text)]
    assert found
    for name, page, number in found:
        text = (ROOT / "docs" / page).read_text(encoding="utf-8")
        assert re.search(rf"^## {number}\. ", text, re.M), (name, page, number)


def test_the_worked_example_of_the_mapping_page_is_what_the_mapping_gives():
    text = (ROOT / "docs/mapping.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| (.*) \|$", text.split("<!-- worked example -->\n")[1].split("\n\n")[0], re.M)
    table = {name: cells for name, *cells in (row.split(" | ") for row in rows[1:])}
    pair = Scene.of(Collision.two_balls(1.0, 2 / math.sqrt(3), 1e8, 1e8, 0.9, 0.7), Settings()).contacts

    def words(*values):
        return " ".join(repr(float(f"{value:.12g}")) for value in values)

    for i, (c, e, drake) in enumerate(zip(pair, (0.9, 0.7), map(drake_side, pair), strict=True)):
        textbook = textbook_damping_ratio(e)
        expected = {
            "M, kg": f"{c.mass:.6g}",
            "ζ": f"{damping_ratio(e):.6g}",
            "c, N s/m": f"{c.c:.6g}",
            "period 2 π sqrt(M/k), s": f"{c.period:.6g}",
            "duration, s": f"{c.duration:.6g}",
            "MuJoCo `solref`": words(*mujoco_contact(c).solref),
            "PyBullet stiffness, damping": words(c.k, c.c),
            "Drake relaxation time, s": words(drake.dissipation),
            "textbook ζ, and the e it has": f"{textbook:.6g}, {restitution(textbook):.6g}",
        }
        assert {name: table[name][i] for name in expected} == expected


def test_every_module_of_the_model_and_of_the_baselines_is_checked_strictly_but_those_with_kernels():
    records_calls_of_engines = "paste.py"
    package = Path(impact_xval.__file__).parent
    tools = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]
    strict = {
        path
        for pattern in tools["pyright"]["strict"]
        for path in [*ROOT.glob(pattern), *package.glob(pattern)]
    }

    def is_strict(path):
        return not strict.isdisjoint((path, *path.parents))

    def has_kernels(path):
        nodes = ast.walk(ast.parse(path.read_bytes()))
        arguments = [a for node in nodes if isinstance(node, ast.FunctionDef) for a in node.args.args]
        return any(a.annotation is None and a.arg not in ("self", "cls") for a in arguments)

    for folder in ("", "model/**/", "compliant_baselines/**/"):
        for path in package.glob(f"{folder}*.py"):
            is_untyped = has_kernels(path) or path.name == records_calls_of_engines
            assert is_strict(path) != is_untyped, path
