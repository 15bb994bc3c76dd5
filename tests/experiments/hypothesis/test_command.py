"""The command: what it writes, and what it says of what it cannot do."""

import json
import re
import tomllib

import pandas as pd
import pytest

from impact_xval.experiments.commands.cli import main
from impact_xval.experiments.hypothesis.cases import CASES
from impact_xval.experiments.hypothesis.config import parse
from impact_xval.experiments.hypothesis.run import run_hypothesis
from impact_xval.experiments.hypothesis.tables import class_frame, outcome_frame

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
    '[[point]]\ncase = "zero-early"\nmass_ratio = 4.0\ne1 = 0.9\ne2 = 0.7': [
        "point[1]",
        "outside zero-early",
    ],
    '[[point]]\ncase = "zero"\nmass_ratio = 1.0': ["point[1].case = 'zero'", "zero-early"],
    '[[point]]\ncase = "infinity"': ["point[1].mass_ratio", "missing"],
    "contrast = [1e5, 10]": ["contrast = [100000.0, 10.0]", "lo < hi"],
    "contrast = ['a', 10]": ["contrast", "'a'", "lo < hi"],
    "engine_contrast = [0, 10]": ["engine_contrast", "1 < lo < hi <= 1e6"],
    "solvers = ['mujoko']": ["solvers", "'mujoko'", "did you mean 'mujoco'"],
    "contrasts = [1, 2]": ["contrasts", "unknown key", "contrast"],
    "[map]\nsise = 3": ["map.sise", "unknown key", "size"],
    "[map]\nstiffness_ratio = [2, 10]": ["map.stiffness_ratio", "lo < 1 < hi"],
    "[map]\nrestitutions = [[0.9, 0.7], [0.9, 0.0]]": ["map.restitutions[2][2] = 0.0", "from 0.02 to 1"],
    "[columns]\nballs = [3, 7]": [
        "columns.balls = [3, 7]; legal: [least, largest] whole numbers from 4 to 12"
    ],
    "seed = 1.5": ["seed = 1.5", "a whole number from 0 to 2^32"],
    "points = 3\nsteps = 3": ["points = 3", "and 1 more"],
    "points =": ["not TOML"],
}


def test_bad_input_is_one_line_and_writes_nothing(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for text, words in ({None: ["no such file"]} | BAD).items():
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


def test_it_writes_the_page_its_tables_and_its_figures(done):
    tables = {"verdicts.csv", "points.csv", "columns.csv", "columns.parquet", "outcomes.parquet"}
    assert {"report.html", "manifest.json", "maps.parquet", *tables} <= {path.name for path in done.iterdir()}
    page = (done / "hypothesis.md").read_text()
    for figure in re.findall(r"\(figures/(.+?)\)", page):
        assert (done / "figures" / figure).is_file()
        assert (done / "figures" / figure.replace(".png", ".pdf")).is_file()
    manifest = json.loads((done / "manifest.json").read_text())
    assert manifest["configuration"]["points"] == 6


def test_every_point_is_in_the_tables_the_given_one_included(done):
    points = pd.read_csv(done / "points.csv")
    counts = points.groupby(["case", "solver"]).size()
    assert len(counts) == 3 * len(CASES)
    assert counts["zero-late", "bistiffness"] == 7
    assert counts["zero-early", "bistiffness"] == 6
    given = points[(points.case == "zero-late") & (points.solver == "state-transition")].iloc[-1]
    assert given.closed_form_v1 == pytest.approx(0.45203, abs=1e-5)  # printed in the supplement
    outcomes = pd.read_parquet(done / "outcomes.parquet")
    assert (outcomes.status != "").all()
    assert outcomes[outcomes.status.isin(["ok", "limit"])][["v1", "v2", "distance"]].notna().all(axis=None)


def test_the_numbers_of_the_page_are_those_of_the_tables(done):
    page = (done / "hypothesis.md").read_text()
    verdicts = pd.read_csv(done / "verdicts.csv")
    for row in verdicts[(verdicts["class"] == "all") & (verdicts.verdict == "supported")].itertuples():
        assert f"| {row.solver} | supported ({row.n_supported} of {row.points} points, " in page
        assert f"rate {row.rate:.2f} (" in page
    assert not re.search(r"\bnan\b|\bNone\b(?! of this)", page)
    late = verdicts[(verdicts.case == "zero-late") & (verdicts["class"] == "all")].set_index("solver")
    assert late.verdict.to_dict() == {
        "state-transition": "supported",
        "bistiffness": "refuted",
        "kelvin-voigt": "refuted",
    }


def test_columns_are_in_the_page_and_in_the_tables(done):
    page = (done / "hypothesis.md").read_text()
    verdicts = pd.read_csv(done / "columns.csv")
    wholes = verdicts[verdicts["class"] == "all"]
    assert len(wholes) == 12 * 3
    for row in wholes.itertuples():
        start = f"| {row.arrangement} | {row.stiff_contact} |"
        line = next(x for x in page.splitlines() if x.startswith(start))
        assert f" {row.verdict} (" in line
    together = wholes[~wholes.meets & (wholes.solver != "kelvin-voigt")]
    assert (together.n_refuted == 0).all()
    dashpots = wholes[~wholes.meets & (wholes.solver == "kelvin-voigt")]
    assert (dashpots.verdict == "refuted").all()
    assert (dashpots.missed_prediction_largest < 1e-2 * dashpots.offset_largest).all()
    outcomes = pd.read_parquet(done / "columns.parquet")
    assert len(outcomes) == 12 * 3 * 3 * 17
    assert (outcomes.reason[outcomes.status != "ok"] != "").all()
    assert (outcomes.final_velocities.map(len) == outcomes.masses.map(len)).all()


@pytest.mark.nightly
def test_too_short_a_range_is_undecided_in_every_solver():
    config = parse({**tomllib.loads(SMALL), "contrast": [10, 1e3], "plastic_contrast": [10, 1e3]}, "test")
    verdicts = class_frame(run_hypothesis(config, isolate=False))
    assert set(verdicts.verdict) == {"undecided"}
    assert verdicts.reason.str.contains("extend the range of contrasts").all()


@pytest.mark.nightly
def test_results_do_not_depend_on_the_number_of_workers():
    data = {
        "points": 6,
        "solvers": ["mujoco"],
        "engine_contrast": [10, 30],
        "engine_plastic_contrast": [10, 30],
    }
    data |= {"steps": 20, "map": {"size": 4, "engine_size": 3, "restitutions": [[0.9, 0.7]]}}
    first, second = (outcome_frame(run_hypothesis(parse(data, "test"), workers=n)) for n in (1, 2))
    pd.testing.assert_frame_equal(first, second)
