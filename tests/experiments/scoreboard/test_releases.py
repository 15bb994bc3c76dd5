"""The scoreboard with several versions of an engine: environments, changes between versions, and missing versions."""

import re
import sys
import sysconfig
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from packaging.requirements import Requirement

from impact_xval.experiments.scoreboard import environments, playing
from impact_xval.experiments.scoreboard.cases import CASE_SETUPS, USUAL
from impact_xval.experiments.scoreboard.environments import (
    NotInstalledError,
    find_reason,
    make_environment,
    read_requirement,
    solvers_by_distribution,
)
from impact_xval.experiments.scoreboard.releases import compare_releases, describe_releases, release_table

#: A script that pretends to be the installer uv. An environment that it makes sees the packages of this machine, but
#: states the requested version. Its Pymunk 7.8 dies as soon as it should work, its Pymunk 7.9 always iterates once, and
#: no version 99 exists.
UV = """#!{python}
import pathlib, sys, venv
folder = pathlib.Path({log!r}).parent
with open({log!r}, "a") as log:
    print(*sys.argv[1:], file=log)
if sys.argv[1] == "venv":
    venv.create(sys.argv[-1], symlinks=True)
    sys.exit()
name, _, version = next(word for word in sys.argv if word.startswith(("pymunk", "pybullet", "sapien"))).partition("==")
if version == "99":
    print("  × No solution found:\\n  ╰─▶ Because there is no version of pymunk==99", file=sys.stderr)
    sys.exit(1)
(site,) = pathlib.Path(sys.argv[sys.argv.index("--python") + 1]).parents[1].glob("lib/python*/site-packages")
(site / "here.pth").write_text({site!r})
(site / f"{{name}}-{{version}}.dist-info").mkdir(exist_ok=True)
(site / f"{{name}}-{{version}}.dist-info" / "METADATA").write_text(f"Name: {{name}}\\nVersion: {{version}}\\n")
program = {{
    "7.8": "import os, sys\\nif 'serve' in ' '.join(sys.orig_argv): os._exit(7)",
    "7.9": "import pymunk\\nreal = pymunk.Space.iterations\\n"
    "pymunk.Space.iterations = property(real.fget, lambda space, n: real.fset(space, 1))",
}}
(site / "sitecustomize.py").write_text(program.get(version, ""))
"""


@pytest.fixture
def uv(tmp_path, monkeypatch):
    """Put the script that pretends to be uv first on the path; return the file that records its calls."""
    log = tmp_path / "bin" / "calls"
    log.parent.mkdir()
    text = UV.format(python=sys.executable, log=str(log), site=sysconfig.get_paths()["purelib"])
    (log.parent / "uv").write_text(text)
    (log.parent / "uv").chmod(0o755)
    monkeypatch.setenv("PATH", str(log.parent))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return log


def answers_of(version, v, solver="mujoco", **other):
    """Return answers of an engine's version to two cases. The first case ends with the velocities `v`."""
    cases = {"cradle 1 on 2": v, "stack of 3": (0.1, 0.2, 0.3)}
    row = {"solver": solver, "version": version, "microseconds": 1.0, "e": 0.9, "arrangement": USUAL}
    row |= {"status": "ok", "reason": ""} | other
    rows = [row | {"case": case} | {f"v{i}": x for i, x in enumerate(own, 1)} for case, own in cases.items()]
    return pd.DataFrame(rows)


SAME, OTHER = (-0.1, -0.2, -0.6), (-0.1, -0.25, -0.6)


def test_versions_come_in_the_order_of_their_numbers_and_the_one_that_differs_is_marked():
    versions = {"3.10.0": OTHER, "3.9.0": SAME, "3.8.1": SAME, "4.0.0": OTHER}
    elsewhere = pd.concat([answers_of(version, v) for version, v in versions.items()])
    here = pd.concat([answers_of("4.1.0", OTHER), answers_of("9", SAME, solver="pymunk")])
    found = compare_releases(here, elsewhere)
    assert [(each.version, each.before, each.differs) for each in found] == [
        ("3.8.1", None, False),
        ("3.9.0", "3.8.1", False),
        ("3.10.0", "3.9.0", True),
        ("4.0.0", "3.10.0", False),
        ("4.1.0", "4.0.0", False),
    ]
    rows = {version: (count, cells) for _, version, count, *cells in release_table(found, []).rows}
    assert list(rows) == ["3.8.1", "3.9.0", "3.10.0 *", "4.0.0", "4.1.0"]
    assert rows["3.8.1"] == ("the first", ["-"] * len(CASE_SETUPS))
    asked = ["=" if case in ("cradle 1 on 2", "stack of 3") else "-" for case in CASE_SETUPS]
    assert rows["3.9.0"] == rows["4.0.0"] == ("0 of 2", asked)
    count, cells = rows["3.10.0 *"]
    assert (count, cells[list(CASE_SETUPS).index("cradle 1 on 2")]) == ("1 of 2", "0.05")
    assert set(cells) == {"0.05", "=", "-"}
    (sentence,) = describe_releases(found)
    assert (
        "3.10.0 moved 1 of 2 answers of 3.9.0, the farthest by 0.05 |v0| (cradle 1 on 2, e = 0.9" in sentence
    )


def test_a_version_without_an_answer_is_a_row_with_its_reason_and_the_next_is_held_against_the_one_before():
    broken = answers_of("3.2.0", (np.nan,) * 3, status="unavailable", reason="it is too old").assign(
        v1=np.nan
    )
    lost = answers_of("3.4.0", (np.nan,) * 3, status="timeout", reason="too long")
    lost.loc[1, "status"] = "ok"
    elsewhere = pd.concat([broken, answers_of("3.3.0", SAME), lost, answers_of("3.1.0", SAME)])
    found = compare_releases(elsewhere.head(0), elsewhere)
    assert [(each.version, each.before, each.reason) for each in found] == [
        ("3.1.0", None, ""),
        ("3.2.0", None, "it is too old"),
        ("3.3.0", "3.1.0", ""),
        ("3.4.0", "3.3.0", ""),
    ]
    error = NotInstalledError(Requirement("mujoco==99"), "there is none")
    *_, changed, missing = release_table(found, [error]).rows
    assert changed[3 + list(CASE_SETUPS).index("cradle 1 on 2")] == "!"
    assert missing[:3] == ("mujoco", "mujoco==99", "not installed: there is none")
    (sentence,) = describe_releases(found)
    assert sentence.endswith(
        "3.4.0 moved 1 of 2 answers of 3.3.0, none of them with velocities from both versions."
    )


def test_an_engine_that_is_not_installed_here_is_no_version():
    here = answers_of("", (np.nan,) * 3, status="unavailable", reason="it is not installed").assign(v1=np.nan)
    elsewhere = pd.concat([answers_of("1", SAME), answers_of("2", OTHER)])
    assert [(each.version, each.differs) for each in compare_releases(here, elsewhere)] == [
        ("1", False),
        ("2", True),
    ]


def test_engines_that_answer_the_same_are_said_together():
    elsewhere = [answers_of(version, SAME, solver) for solver in ("dart", "mujoco") for version in ("1", "2")]
    said = describe_releases(compare_releases(elsewhere[0].head(0), pd.concat(elsewhere)))
    assert said == [
        "MuJoCo (mapped) answers the same in mujoco 1 and 2.",
        "DART answers the same in dartpy 1 and 2.",
    ]


def test_what_is_no_requirement_of_an_engine_is_refused_in_a_line(refused, uv):
    for text, *said in (
        ("mujoco=3.3", "--with 'mujoco=3.3'", "no requirement", "mujoco==3.3.7"),
        ("", "--with ''", "no requirement"),
        ("numpy==2.0", "--with 'numpy==2.0'", "no engine is distributed as 'numpy'", "dartpy"),
        ("dart==6.16", "--with 'dart==6.16'", "did you mean 'dartpy'?"),
    ):
        refused(["scoreboard", "--with", "pymunk==7", "--with", text], *said)
    refused(["scoreboard", "--solver", "dart", "--with", "pymunk==7"], "no --solver", "legal: pymunk")
    assert not uv.exists()  # the installer was not called
    assert read_requirement("PyMunk[dev]>=7,<8").name == "pymunk"


def test_every_engine_has_a_distribution():
    assert solvers_by_distribution()["rapier3d"] == ["rapier", "rapier:default"]
    assert {"mujoco", "mujoco:default", "mujoco-naive"} < {*solvers_by_distribution()["mujoco"]}


@pytest.mark.parametrize(
    ("printed", "reason"),
    [
        (
            "ERROR: Could not find a version that satisfies the requirement mujoco==99 (from versions: 2.2.0, 2.2.1)\n"
            "ERROR: No matching distribution found for mujoco==99",
            "Could not find a version that satisfies the requirement mujoco==99",
        ),
        (
            "WARNING: Retrying ...\nERROR: Could not find a version that satisfies the requirement mujoco==3.3.7 "
            "(from versions: none)\nERROR: No matching distribution found for mujoco==3.3.7",
            "Could not find a version that satisfies the requirement mujoco==3.3.7 (no version at all: is there a "
            "network?)",
        ),
        (
            "error: Failed to fetch: `https://pypi.org/simple/mujoco/`\n  Caused by: dns error",
            "error: Failed to fetch: `https://pypi.org/simple/mujoco/` Caused by: dns error",
        ),
        ("", "the installer says nothing"),
    ],
)
def test_the_reason_is_what_the_installer_says(printed, reason):
    assert find_reason(printed) == reason


def test_where_nothing_can_be_installed_that_is_all_that_is_said(refused, uv, tmp_path):
    refused(
        ["scoreboard", "--with", "pymunk==99", "--out", tmp_path / "out"],
        "--with 'pymunk==99': No solution found: Because there is no version of pymunk==99",
    )
    assert not (tmp_path / "out").exists()
    assert [path.suffix for path in environments.environments_folder().iterdir()] == [".lock"]


def test_without_uv_pip_is_asked(tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setenv("PIP_NO_INDEX", "1")
    monkeypatch.setenv("PIP_FIND_LINKS", str(tmp_path))
    with pytest.raises(
        NotInstalledError, match=r"requirement pymunk==7\.0 \(no version at all: is there a net"
    ):
        make_environment(Requirement("pymunk==7.0"))


def test_an_environment_that_was_not_finished_is_made_anew(uv):
    made = make_environment(Requirement("pymunk==7.5"))
    assert (made.distribution, made.version) == ("pymunk", "7.5")
    make_environment(Requirement("pymunk==7.5"))
    # two calls: one made the environment, one installed the packages
    assert len(uv.read_text().splitlines()) == 2
    (made.python.parents[1] / "environment.json").unlink()
    make_environment(Requirement("pymunk==7.5"))
    assert len(uv.read_text().splitlines()) == 4


@pytest.mark.parametrize(
    ("old", "new", "unstated"),
    [("pybullet==3.2.6", "pybullet==3.2.7", "numpy<2"), ("sapien==3.0.2", "sapien==3.0.3", "setuptools<81")],
)
def test_what_older_wheels_need_and_do_not_state_is_installed(old, new, unstated, uv):
    make_environment(Requirement(old))
    _, first, second = uv.read_text().splitlines()
    assert second == f"{first} {unstated}"
    make_environment(Requirement(new))
    assert len(uv.read_text().splitlines()) == 5
    assert uv.read_text().count(unstated) == 1


def test_versions_are_asked_in_their_environments_and_one_that_dies_costs_its_rows(
    uv, tmp_path, monkeypatch, capsys
):
    pytest.importorskip("pymunk")
    from impact_xval.experiments.commands.cli import main

    monkeypatch.setattr(playing, "CASES", {("pile, k2/k1 = 1", 1.0): None})
    monkeypatch.setattr(playing, "exact_law_names", lambda: ("newton-restitution", "poisson-restitution"))
    # an environment has no compiled kernels yet, and one case does not need them
    monkeypatch.setenv("NUMBA_DISABLE_JIT", "1")
    asked = [word for version in ("7.9", "7.7", "99", "7.8") for word in ("--with", f"pymunk=={version}")]
    words = ["scoreboard", "--solver", "pymunk", "--workers", "1", "--out", str(tmp_path / "out"), *asked]
    assert main(words) == 2
    printed = capsys.readouterr()
    (line,) = printed.err.splitlines()
    assert line.startswith("impact-xval: --with 'pymunk==99': No solution found")
    rows = pd.read_parquet(tmp_path / "out" / "releases.parquet")
    assert [*rows.version.unique()] == ["7.9", "7.7", "7.8"]
    usual = rows[rows.arrangement == USUAL].set_index("version")
    assert (usual.v1["7.7"], usual.v2["7.7"]) == pytest.approx((1.0, 0.0), abs=1e-12)
    assert abs(usual.v1["7.9"] - 1.0) > 0.1
    assert usual.reason["7.8"] == "its process died: exit code 7"
    page = re.sub(' class="[a-z]+"', "", (tmp_path / "out" / "report.html").read_text())
    for text in (printed.out, page):
        assert "What releases changed" in text
    for cells in (("7.8", "no answer: its process died: exit code 7"), ("7.9 *", "5 of 7")):
        assert "".join(f"<td>{cell}</td>" for cell in ("Pymunk", *cells)) in page
    assert "not installed: No solution found" in page
    # The same command continues with the answers that exist.
    (tmp_path / "out" / "report.html").unlink()
    calls = len(uv.read_text().splitlines())
    assert main(words) == 2
    assert (tmp_path / "out" / "report.html").exists()
    assert len(uv.read_text().splitlines()) == calls + 2  # the installation that failed is tried again


@pytest.mark.nightly
def test_pip_installs_two_versions_that_are_asked(tmp_path, monkeypatch, command):
    monkeypatch.setenv("PATH", "/usr/bin:/bin")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    words = ["scoreboard", "--solver", "mujoco", "--workers", "1", "--out", tmp_path / "out"]
    assert "What releases changed" in command([*words, "--with", "mujoco==3.3.7", "--with", "mujoco==4.0.0"])
    rows = pd.read_parquet(tmp_path / "out" / "releases.parquet")
    pair = rows[(rows.case == "pile, k2/k1 = 1") & (rows.e == 0.9) & (rows.arrangement == USUAL)]
    assert [*pair.version] == ["3.3.7", "4.0.0"]
    assert np.ptp(pair[["v1", "v2"]].to_numpy(), axis=0) == pytest.approx((0.0, 0.0), abs=1e-6)
    # packages that are not imported are not installed
    assert not list(Path(tmp_path / "cache").rglob("pandas"))
