"""The command: what it writes, and what it says of what it cannot do."""

import contextlib
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

BAD = {
    "a point outside its regime": (
        '[[point]]\ncase = "zero-early"\nmass_ratio = 4.0\ne1 = 0.9\ne2 = 0.7',
        ["point[1]", "outside zero-early", "e1 m2/m1 below 1", "name the regime"],
    ),
    "an unknown limit": (
        '[[point]]\ncase = "zero"\nmass_ratio = 1.0',
        ["point[1].case = 'zero'", "zero-early"],
    ),
    "a point without a mass": ('[[point]]\ncase = "infinity"', ["point[1].mass_ratio", "missing"]),
    "a range the wrong way": ("contrast = [1e5, 10]", ["contrast = [100000.0, 10.0]", "lo < hi"]),
    "a range from nothing": ("engine_contrast = [0, 10]", ["engine_contrast", "1 < lo < hi <= 1e6"]),
    "no number": ("contrast = ['a', 10]", ["contrast", "'a'", "lo < hi"]),
    "too few points": ("points = 3", ["points = 3", "from 6 to 500"]),
    "an unknown solver": ("solvers = ['mujoko']", ["solvers", "'mujoko'", "did you mean 'mujoco'"]),
    "an unknown key": ("contrasts = [1, 2]", ["contrasts", "unknown key", "contrast"]),
    "an unknown key of the map": ("[map]\nsise = 3", ["map.sise", "unknown key", "size"]),
    "a map without 1": ("[map]\nstiffness_ratio = [2, 10]", ["map.stiffness_ratio", "lo < 1 < hi"]),
    "a misspelt key": ("point = []\nstep = 50", ["step = 50: unknown key", "did you mean 'steps'?"]),
    "a misspelt key of a point": (
        "[[point]]\ncase = 'infinity'\nmas_ratio = 1.0\nmass_ratio = 1.0",
        [
            "point[1].mas_ratio",
            "did you mean 'mass_ratio'?",
            "legal: case, mass_ratio, e1, e2, stiffness_ratio",
        ],
    ),
    "a map of engines beyond them": (
        "[map]\nengine_stiffness_ratio = [1e-9, 1e3]",
        ["map.engine_stiffness_ratio = [1e-09, 1000.0]", "1e-6 <= lo < 1 < hi <= 1e6"],
    ),
    "a restitution too small": (
        "[map]\nrestitutions = [[0.9, 0.7], [0.9, 0.0]]",
        ["map.restitutions[2][2] = 0.0", "1 to 6 pairs [e1, e2], from 0.02 to 1"],
    ),
    "two mistakes": ("points = 3\nsteps = 3", ["points = 3", "and 1 more"]),
    "no file": (None, ["no such file"]),
    "an unknown key with the name of a type": ("float = 3", ["float = 3: unknown key"]),
    "no TOML": ("points =", ["not TOML"]),
}


#: A value of the wrong type by field, and how an error names field and value, and begins with what is legal.
WRONG_TYPES = {
    "seed = 1.0": ("seed = 1.0", "a whole number from 0 to 2^32"),
    "points = '24'": ("points = '24'", "a whole number from 6 to 500"),
    "points = true": ("points = True", "a whole number from 6 to 500"),
    "solvers = 'mujoco'": ("solvers = 'mujoco'", "a list of names"),
    "solvers = [1]": ("solvers[1] = 1", "a list of names"),
    "contrast = 10": ("contrast = 10", "[lo, hi] with 1 < lo < hi <= 1e10"),
    "contrast = [10]": ("contrast", "[lo, hi] with 1 < lo < hi <= 1e10"),
    "contrast = [10, 100, 1000]": ("contrast = [10, 100, 1000]", "[lo, hi] with 1 < lo < hi <= 1e10"),
    "contrast = [10, true]": ("contrast[2] = True", "[lo, hi] with 1 < lo < hi <= 1e10"),
    "contrast = [10, nan]": ("contrast = [10.0, nan]", "[lo, hi] with 1 < lo < hi <= 1e10"),
    "plastic_contrast = 'wide'": ("plastic_contrast = 'wide'", "[lo, hi] with 1 < lo < hi <= 1e16"),
    "engine_contrast = ['10', 100]": ("engine_contrast[1] = '10'", "[lo, hi] with 1 < lo < hi <= 1e6"),
    "engine_plastic_contrast = {lo = 2}": ("engine_plastic_contrast = {'lo': 2}", "[lo, hi] with 1 < lo"),
    "per_decade = 8.0": ("per_decade = 8.0", "a whole number from 4 to 64"),
    "engine_per_decade = '2'": ("engine_per_decade = '2'", "a whole number from 2 to 16"),
    "fit_decades = '4'": ("fit_decades = '4'", "from 1 to 8"),
    "engine_fit_decades = true": ("engine_fit_decades = True", "from 1 to 8"),
    "steps = 100.0": ("steps = 100.0", "a whole number from 20 to 2000"),
    "cell_timeout = 'long'": ("cell_timeout = 'long'", "greater than 0, at most 1e6 (s of wall time)"),
    "workers = true": ("workers = True", "a whole number from 1 to 4096"),
    "map = 3": ("map = 3", "a table: size, engine_size, stiffness_ratio"),
    "map.size = '61'": ("map.size = '61'", "a whole number from 4 to 400"),
    "map.engine_size = 13.0": ("map.engine_size = 13.0", "a whole number from 3 to 60"),
    "map.stiffness_ratio = 'all'": ("map.stiffness_ratio = 'all'", "0 < lo < 1 < hi <= 1e12 (k2/k1)"),
    "map.engine_stiffness_ratio = 1": ("map.engine_stiffness_ratio = 1", "1e-6 <= lo < 1 < hi <= 1e6"),
    "map.mass_ratio = [true, 2]": ("map.mass_ratio[1] = True", "0 < lo < hi <= 1e12 (m2/m1)"),
    "map.restitutions = [0.9, 0.7]": ("map.restitutions[1] = 0.9", "a list of 1 to 6 pairs [e1, e2]"),
    "map.restitutions = [[0.9, '0.7']]": ("map.restitutions[1][2] = '0.7'", "a list of 1 to 6 pairs"),
    "point = 1": ("point = 1", "a list of tables: case, mass_ratio, e1, e2"),
    "point = [{case = 1, mass_ratio = 1.0}]": ("point[1].case = 1", "zero-apart, zero-early"),
    "point = [{case = 'infinity', mass_ratio = '1'}]": ("point[1].mass_ratio = '1'", "a finite number > 0"),
    "point = [{case = 'infinity', mass_ratio = 1, e1 = true}]": ("point[1].e1 = True", "from 0.02 to 1"),
}


@pytest.mark.parametrize("text", WRONG_TYPES)
def test_a_wrong_type_is_named_with_its_value_and_what_is_legal(text, tmp_path, capsys):
    (tmp_path / "h.toml").write_text(text)
    out = tmp_path / "out"
    assert main(["hypothesis", str(tmp_path / "h.toml"), "--out", str(out)]) == 2
    captured = capsys.readouterr()
    named, legal = WRONG_TYPES[text]
    assert captured.out == ""
    assert captured.err.count("\n") == 1
    assert f"h.toml: {named}" in captured.err
    assert f"legal: {legal}" in captured.err or f"legal: [lo, hi] with {legal}" in captured.err
    assert not out.exists()


@pytest.mark.parametrize("name", BAD)
def test_bad_input_is_one_line_and_writes_nothing(name, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    text, words = BAD[name]
    if text is not None:
        (tmp_path / "h.toml").write_text(text)
    assert main(["hypothesis", "h.toml"]) == 2
    error = capsys.readouterr().err.strip()
    assert error.startswith("impact-xval: h.toml: ")
    assert "\n" not in error
    for word in words:
        assert word in error
    assert not (tmp_path / "runs").exists()


def test_a_folder_that_holds_files_is_refused(tmp_path, capsys):
    (tmp_path / "mine.txt").write_text("precious")
    assert main(["hypothesis", "--out", str(tmp_path)]) == 2
    assert "not empty; legal: a new or empty folder" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["mine.txt"]


@pytest.fixture(scope="module")
def done(tmp_path_factory):
    root = tmp_path_factory.mktemp("hypothesis")
    (root / "h.toml").write_text(SMALL)
    with (root / "said.txt").open("w", encoding="utf-8") as said, contextlib.redirect_stdout(said):
        assert main(["hypothesis", str(root / "h.toml"), "--out", str(root / "out"), "--workers", "1"]) == 0
    return root / "out"


def test_the_page_begins_with_one_table_of_verdicts(done):
    page = (done / "hypothesis.md").read_text()
    first = page.partition("## Verdicts\n")[2].partition("\n![")[0]
    header, _, *rows = (line.strip("| ").split(" | ") for line in first.splitlines() if line.startswith("|"))
    frame = pd.read_csv(done / "verdicts.csv")
    whole = frame[frame["class"] == "all"].set_index(["case", "solver"])
    assert [row[0] for row in rows] == [case.key for case in CASES]
    assert header[2:] == list(dict.fromkeys(frame.solver))
    for row in rows:
        for name, said in zip(header[2:], row[2:], strict=True):
            found = whole.loc[(row[0], name)]
            counted = found.n_refuted if found.verdict == "undecided" else found[f"n_{found.verdict}"]
            assert said.startswith(f"{found.verdict}, {100 * counted / found.points:.1f} %")
            assert ("rate" in said) == (found.verdict == "supported")
            if "rate" in said:
                assert float(said.rpartition(" ")[2]) == pytest.approx(found["rate"], abs=0.006)


def test_what_is_not_for_everyone_is_folded(done):
    page = (done / "report.html").read_text(encoding="utf-8")
    open_part, _, folded = page.partition('<details class="section">')
    assert re.findall(r'<h2 id="([^"]*)">', open_part) == ["contents", "verdicts", "limit-by-limit"]
    assert folded.count("</h2></summary>") == page.count('<details class="section">') > 8
    assert page.count("<details") == page.count("</details>")


def test_it_says_what_is_left(done):
    lines = done.with_name("said.txt").read_text(encoding="utf-8").splitlines()
    counts = [line for line in lines if " cells after " in line]
    assert "left" not in counts[0]  # one piece of work has no pace
    assert len(counts) > 5
    assert all(" left at this rate" in line for line in counts[1:])


def test_it_writes_the_page_its_tables_and_its_figures(done):
    names = {path.name for path in done.iterdir()}
    assert names == {
        "hypothesis.md",
        "report.html",
        "tables.md",
        "tables.tex",
        "verdicts.csv",
        "points.csv",
        "mechanism.csv",
        "contrast-needed.csv",
        "columns.csv",
        "columns.parquet",
        "outcomes.parquet",
        "maps.parquet",
        "manifest.json",
        "figures",
    }
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
    for row in verdicts[verdicts["class"] == "all"].itertuples():
        assert f"| {row.solver} |" in page
        if row.verdict == "supported":
            at = f"| {row.solver} | supported ({row.n_supported} of {row.points} points, "
            assert re.search(rf"\| {row.case} \| .+ {re.escape(at)}.+ %\), rate {row.rate:.2f} \(", page)
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
        line = next(
            x for x in page.splitlines() if x.startswith(f"| {row.arrangement} | {row.stiff_contact} |")
        )
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


def test_without_a_solver_of_columns_their_tables_are_empty(tmp_path):
    (tmp_path / "h.toml").write_text(
        "points = 6\nsolvers = ['hunt-crossley']\ncontrast = [10, 1e3]\nplastic_contrast = [10, 1e3]\n[map]\nsize = 4\n"
    )
    assert (
        main(["hypothesis", str(tmp_path / "h.toml"), "--out", str(tmp_path / "out"), "--workers", "1"]) == 0
    )
    assert "In columns" not in (tmp_path / "out/hypothesis.md").read_text()
    assert pd.read_parquet(tmp_path / "out/columns.parquet").empty


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
