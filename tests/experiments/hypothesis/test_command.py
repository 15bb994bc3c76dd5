"""The command: what it writes, and what it says of what it cannot do."""

import re

import pandas as pd
import pytest

from impact_xval.experiments.commands.cli import main
from impact_xval.experiments.hypothesis.cases import CASES

SMALL = """
points = 6
solvers = ["state-transition", "bistiffness", "kelvin-voigt"]
contrast = [10, 1e6]
plastic_contrast = [10, 1e7]
per_decade = 4
[columns]
points = 3
balls = [4, 4]
contrast = [10, 1e5]
[map]
size = 8
restitutions = [[0.9, 0.7]]
[[point]]
case = "zero-late"
mass_ratio = 1.1547005383792517
e1 = 0.9
e2 = 0.7
"""

#: A mistake, and what its one line says.
BAD = {
    "[[point]]\ncase = 'zero-early'\nmass_ratio = 4.0\ne1 = 0.9\ne2 = 0.7": ["outside zero-early"],
    '[[point]]\ncase = "zero"\nmass_ratio = 1.0': ["point.0.case = 'zero'", "zero-early"],
    '[[point]]\ncase = "infinity"': ["point.0.mass_ratio", "missing"],
    "contrast = [1e5, 10]": ["contrast = [100000.0, 10.0]", "lo < hi"],
    "engine_contrast = [0, 10]": ["engine_contrast", "1 < lo < hi <= 1e6"],
    "solvers = ['mujoko']": ["solvers", "'mujoko'", "did you mean 'mujoco'"],
    "[map]\nsise = 3": ["map.sise", "unknown key", "size"],
    "[map]\nstiffness_ratio = [2, 10]": ["map.stiffness_ratio", "lo < 1 < hi"],
    "[map]\nrestitutions = [[0.9, 0.7], [0.9, 0.0]]": ["map.restitutions.1.1 = 0.0", "from 0.02 to 1"],
    "[columns]\nballs = [3, 7]": ["columns.balls = [3, 7]", "whole numbers from 4 to 12"],
    "seed = 1.5": ["seed = 1.5", "a whole number from 0 to 2^32"],
    "points = 3\nsteps = 3": ["points = 3", "and 1 more"],
    "points =": ["not TOML"],
}


def test_bad_input_is_one_line_and_writes_nothing(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for text, words in ({None: ["No such file"]} | BAD).items():
        if text is not None:
            (tmp_path / "h.toml").write_text(text)
        assert main(["hypothesis", "h.toml"]) == 2, text
        said = capsys.readouterr()
        assert said.out == "", text
        assert said.err.startswith("impact-xval: h.toml: "), text
        assert said.err.count("\n") == 1, text
        assert all(word in said.err for word in words), (text, said.err)
        assert not (tmp_path / "runs").exists(), text


def test_a_folder_that_holds_files_is_refused(tmp_path, capsys):
    (tmp_path / "mine.txt").write_text("precious")
    assert main(["hypothesis", "--out", str(tmp_path)]) == 2
    assert "not empty; legal: a new or empty folder" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["mine.txt"]


@pytest.fixture(scope="module")
def done(tmp_path_factory):
    root = tmp_path_factory.mktemp("hypothesis")
    (root / "h.toml").write_text(SMALL)
    assert main(["hypothesis", str(root / "h.toml"), "--out", str(root / "out"), "--workers", "1"]) == 0
    return root / "out"


def test_every_point_is_in_the_tables_the_given_one_included(done):
    points = pd.read_csv(done / "points.csv")
    counts = points.groupby(["case", "solver"]).size()
    assert len(counts) == 3 * len(CASES)
    assert (counts["zero-late", "bistiffness"], counts["zero-early", "bistiffness"]) == (7, 6)
    given = points[(points.case == "zero-late") & (points.solver == "state-transition")].iloc[-1]
    assert given.closed_form_v1 == pytest.approx(0.45203, abs=1e-5)  # printed in the supplement
    outcomes = pd.read_parquet(done / "outcomes.parquet")
    assert outcomes[outcomes.status.isin(["ok", "limit"])][["v1", "v2", "distance"]].notna().all(axis=None)


def test_the_page_shows_the_verdicts_of_the_tables(done):
    assert (done / "report.html").is_file()
    page = (done / "hypothesis.md").read_text()
    for figure in re.findall(r"\(figures/(.+?)\)", page):
        assert (done / "figures" / figure).is_file()
    verdicts = pd.read_csv(done / "verdicts.csv")
    for row in verdicts[(verdicts["class"] == "all") & (verdicts.verdict == "supported")].itertuples():
        assert f"| {row.solver} | supported ({row.n_supported} of {row.points} points, " in page
        assert f"rate {row.rate:.2f} (" in page
    late = verdicts[(verdicts.case == "zero-late") & (verdicts["class"] == "all")].set_index("solver")
    assert late.verdict.to_dict() == {
        "state-transition": "supported",
        "bistiffness": "refuted",
        "kelvin-voigt": "refuted",
    }
    wholes = pd.read_csv(done / "columns.csv").query("`class` == 'all'")
    assert len(wholes) == 12 * 3
    for row in wholes.itertuples():
        start = f"| {row.arrangement} | {row.stiff_contact} |"
        assert f" {row.verdict} (" in next(line for line in page.splitlines() if line.startswith(start))
    together = wholes[~wholes.meets]
    assert (together[together.solver == "kelvin-voigt"].verdict == "refuted").all()
    assert (together[together.solver != "kelvin-voigt"].n_refuted == 0).all()
