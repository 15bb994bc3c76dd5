"""Everything a user can get wrong: one line that names field, value and legal range, exit code 2, no file."""

import json

import pytest

from impact_xval.experiments.commands.cli import main

BELOW_ONE = "from 0 to 1"
CONFIGS = {
    "no tolerance": (
        "[convergence]\ntolerance = 0",
        ["convergence.tolerance", "0", "greater than 0, at most 1"],
    ),
    "halvings": ("[convergence]\nhalvings = -1", ["convergence.halvings", "-1", "from 0 to 10"]),
    "misspelt convergence": (
        "[convergence]\nhalving = 3",
        ["convergence.halving", "did you mean 'halvings'", "enabled, tolerance, halvings"],
    ),
    "negative stiffness ratio": (
        "[grid]\nstiffness_ratio = [1, -1]",
        ["grid.stiffness_ratio", "-1", "0 to inf"],
    ),
    "nan on an axis": ("[grid]\nstiffness_ratio = [nan]", ["grid.stiffness_ratio", "nan", "0 to inf"]),
    "infinite mass ratio": ("[grid]\nmass_ratio = [inf]", ["grid.mass_ratio", "inf", "a finite number > 0"]),
    "zero mass ratio": ("[grid]\nmass_ratio = [0.0]", ["grid.mass_ratio", "0.0", "a finite number > 0"]),
    "e1 above one": ("[grid]\ne1 = [0.5, 1.5]", ["grid.e1", "1.5", BELOW_ONE]),
    "e2 below zero": ("[grid]\ne2 = [-0.1]", ["grid.e2", "-0.1", BELOW_ONE]),
    "text on an axis": ("[grid]\ne2 = ['half']", ["grid.e2", "half", "not a number", BELOW_ONE]),
    "truth on an axis": ("[grid]\ne2 = [true]", ["grid.e2", "True", "not a number"]),
    "number for an axis": ("[grid]\ne1 = 0.5", ["grid.e1", "0.5", "a list of numbers", "linear"]),
    "empty axis": ("[grid]\ne1 = []", ["grid.e1", "empty", "one value or more"]),
    "duplicate on an axis": (
        "[grid]\ne1 = [0.5, 0.7, 0.5]",
        ["grid.e1", "0.5", "more than once", "each value once"],
    ),
    "duplicate by type": ("[grid]\ne1 = [1, 1.0]", ["grid.e1", "1.0 more than once"]),
    "unknown spacing": ("[grid]\ne1 = {cubic = [0, 1, 3]}", ["grid.e1", "cubic", "log = [lo, hi, n]"]),
    "two spacings": (
        "[grid]\ne1 = {log = [0.1, 1, 3], linear = [0, 1, 3]}",
        ["grid.e1", "linear = [lo, hi, n]"],
    ),
    "short range": ("[grid]\ne1 = {linear = [0, 1]}", ["grid.e1", "[0, 1]", "[lo, hi, n]"]),
    "reversed range": ("[grid]\ne1 = {linear = [1, 0, 3]}", ["grid.e1", "lo = 1, hi = 0", "lo < hi"]),
    "zero on a log axis": (
        "[grid]\nstiffness_ratio = {log = [0, 1, 3]}",
        ["grid.stiffness_ratio", "lo = 0", "lo > 0"],
    ),
    "infinity on a range": (
        "[grid]\nstiffness_ratio = {log = [1, inf, 3]}",
        ["grid.stiffness_ratio", "both finite"],
    ),
    "one point on a range": ("[grid]\ne1 = {linear = [0, 1, 1]}", ["grid.e1", "n = 1", "from 2 to"]),
    "broken count": ("[grid]\ne1 = {linear = [0, 1, 2.5]}", ["grid.e1", "n = 2.5", "a whole number"]),
    "huge axis": ("[grid]\ne1 = {linear = [0, 1, 1000000000000]}", ["grid.e1", "1000000000000", "from 2 to"]),
    "huge number": (f"[grid]\nmass_ratio = [1{'0' * 400}]", ["grid.mass_ratio", "double precision"]),
    "huge grid": (
        "[grid]\ne1 = {linear = [0, 1, 9000]}\ne2 = {linear = [0, 1, 9000]}",
        ["grid", "cells", "1 to 10000000"],
    ),
    "too fine a range": ("[grid]\ne1 = {linear = [1e-323, 3e-323, 99]}", ["grid.e1", "fewer values"]),
    "grid and column": (
        "[grid]\n[column]",
        ["grid and column are given", "legal: one of grid, sample, cells, column"],
    ),
    "column of too many balls": (
        "[column]\nballs = 1001",
        ["column.balls = 1001", "from 2 (a stack: 1) to 1000"],
    ),
    "column of one ball": ("[column]\nballs = [1, 3]", ["column: balls = 1", "from 2 to 1000, for a cradle"]),
    "stack of no ball": ("[column]\narrangement = 'stack'\nballs = 0", ["column.balls = 0", "a stack: 1"]),
    "column of half a ball": (
        "[column]\nballs = {linear = [2, 5, 3]}",
        ["column.balls = 3.5", "a whole number from 2"],
    ),
    "negative gap": ("[column]\ngap = [0.0, -1e-5]", ["column.gap = -1e-05", "a finite number >= 0 (m)"]),
    "e of columns": ("[column]\ne = {linear = [0.5, 1.5, 3]}", ["column.e", "1.5", BELOW_ONE]),
    "exponent of columns": ("[column]\nexponent = 0.5", ["column.exponent = 0.5", "1.5: Hertz) to 3"]),
    "taper of columns": ("[column]\nmass_taper = [0.0]", ["column.mass_taper = 0.0", "> 0 (m_(i+1)/m_i)"]),
    "far tapered column": (
        "[column]\nballs = 10\nstiffness_taper = [1, 1e200]",
        ["column.stiffness_taper = 1e+200", "power 9", "k1 = 100000000.0 times that", "finite numbers > 0"],
    ),
    "arrangement": (
        "[column]\narrangement = ['chain', 'pile']",
        ["column.arrangement = 'pile'", "'chain', 'cradle', 'drop' or 'stack'"],
    ),
    "arrangement twice": (
        "[column]\narrangement = ['chain', 'chain']",
        ["column.arrangement = ['chain', 'chain']", "each once"],
    ),
    "all strike": ("[column]\nballs = [3, 4]\nstrike = [1, 3]", ["strike = 3", "from 1 to 2, for 3 balls"]),
    "strike of a drop": (
        "[column]\narrangement = 'drop'\nstrike = 1",
        ["strike = 1", "none without a cradle"],
    ),
    "too many columns": (
        "[column]\ne = {linear = [0, 1, 9000]}\ngap = {linear = [0, 1, 9000]}",
        ["column", "2916000000 columns", "1 to 10000000"],
    ),
    "columns fall": (
        "scenario = 'drop'\n[column]",
        ["scenario = 'drop'", "without gravity", "legal with column: 'impact'"],
    ),
    "gravity of columns": ("gravity = 3.0\n[column]", ["gravity is given with column", "legal: none"]),
    "figure cell of columns": (
        "[column]\n[figure_cell]",
        ["figure_cell is given with column", "figure_column"],
    ),
    "figure column of cells": ("[figure_column]", ["figure_column is given without column", "figure_cell"]),
    "figure column": ("[column]\n[figure_column]\nballs = 1", ["figure_column.balls = 1", "from 2 to 1000"]),
    "search of columns": ("[column]\n[search]", ["search and column", "collisions of two balls"]),
    "unknown axis of columns": ("[column]\nball = 3", ["column.ball = 3", "did you mean 'balls'"]),
    "unknown axis": (
        "[grid]\nmas_ratio = [1]",
        ["grid.mas_ratio", "unknown key", "did you mean 'mass_ratio'", "e1"],
    ),
    "unknown key": ("gravitiy = 9.81", ["gravitiy", "9.81", "unknown key", "did you mean 'gravity'"]),
    "unknown key far from any": ("zzz = 1", ["zzz", "unknown key", "legal: name"]),
    "scenario": ("scenario = 'throw'", ["scenario", "'throw'", "'impact' or 'drop'"]),
    "gravity": ("gravity = 0", ["gravity = 0", "a finite number > 0"]),
    "gravity is nan": ("gravity = nan", ["gravity = nan", "a finite number > 0"]),
    "m1": ("m1 = -1.0", ["m1 = -1.0", "a finite number > 0 (kg)"]),
    "m1 is text": ("m1 = '1'", ["m1 = '1'", "a finite number > 0 (kg)"]),
    "k1": ("k1 = inf", ["k1 = inf", "a finite number > 0 (N/m)"]),
    "v0 upwards": ("v0 = 1.0", ["v0 = 1.0", "a finite number < 0"]),
    "step fraction": ("step_fraction = 0.5", ["step_fraction = 0.5", "at most 0.1"]),
    "max steps": ("max_steps = 0", ["max_steps = 0", "a whole number >= 1"]),
    "shortest state": ("shortest_state = 0.5", ["shortest_state = 0.5", "from 0 to 0.1 (of the shorter"]),
    "shortest state is nan": ("shortest_state = nan", ["shortest_state = nan", "from 0 to 0.1"]),
    "key of version 0.2.0": ("min_run = 3", ["min_run = 3: of version 0.2.0", "legal: shortest_state"]),
    "mapping": ("mapping = 'none'", ["mapping = 'none'", "'calibrated' or 'naive'"]),
    "cut-off": ("stiffness_ratio_cutoff = 1", ["stiffness_ratio_cutoff = 1", "greater than 1, up to inf"]),
    "cut-off is another word": (
        "stiffness_ratio_cutoff = 'none'",
        ["stiffness_ratio_cutoff = 'none'", "or 'exact'"],
    ),
    "cut-off is nan": ("stiffness_ratio_cutoff = nan", ["stiffness_ratio_cutoff = nan", "greater than 1"]),
    "workers": ("workers = 0", ["workers = 0", "a whole number from 1 to 4096"]),
    "chunk size": ("chunk_size = -3", ["chunk_size = -3", "a whole number from 1"]),
    "threshold": ("grazing_threshold = 2.0", ["grazing_threshold = 2.0", "from 0 to 1"]),
    "no solver": ("solvers = []", ["solvers", "empty", "state-transition"]),
    "unknown solver": ("solvers = ['mujoko']", ["solvers", "'mujoko'", "did you mean 'mujoco'", "legal:"]),
    "solver twice": ("solvers = ['mujoco', 'mujoco']", ["solvers", "'mujoco'", "each solver once"]),
    "solvers is text": ("solvers = 'mujoco'", ["solvers = 'mujoco'", "a list of names"]),
    "solver is a number": ("solvers = [1]", ["solvers.0 = 1", "a list of names"]),
    "empty name": ("name = ''", ["name = ''", "1 to 100 printable"]),
    "name of two lines": ('name = "a\\nb"', ["name", "a\\nb", "printable"]),
    "grid is a list": ("grid = [1]", ["grid = [1]", "a table of axes"]),
    "figure cell": ("[figure_cell]\ne1 = 2.0", ["figure_cell.e1 = 2.0", BELOW_ONE]),
    "figure cell is nan": (
        "[figure_cell]\nstiffness_ratio = nan",
        ["figure_cell.stiffness_ratio = nan", "0 to inf"],
    ),
    "figure cell key": ("[figure_cell]\nq = 2.0", ["figure_cell.q", "unknown key", "legal: stiffness_ratio"]),
    "k2 overflows": (
        "k1 = 1e300\n[grid]\nstiffness_ratio = [1e200]",
        ["stiffness_ratio = 1e+200", "double precision"],
    ),
    "m2 underflows": (
        "m1 = 1e-300\n[grid]\nmass_ratio = [1e-200]",
        ["mass_ratio = 1e-200", "double precision"],
    ),
    "gravity number": (
        "v0 = -1e-300\nk1 = 1e-100",
        ["v0 = -1e-300", "k1 = 1e-100", "= inf leaves double precision", "legal: a finite number > 0"],
    ),
    "gravity number of a sample": (
        "v0 = -1e200\ngravity = 1e-50\n[sample]\nmass_ratio = {log = [1e-300, 1.0]}",
        ["v0 = -1e+200", "mass_ratio = 1e-300", "= 0.0 leaves double precision"],
    ),
    "no impulse": (
        "scenario = 'impact'\nm1 = 1e-200\nv0 = -1e-200",
        ["m1 = 1e-200 times |v0| = 1e-200 leaves double precision", "legal: a finite product > 0"],
    ),
    "malformed TOML": ("gravity = 9.81\nm1 = = 2", ["not TOML", "line 2"]),
    "key twice": ("m1 = 1\nm1 = 2\nv0 = -1", ["not TOML", "overwrite"]),
    "deep nesting": ("a = " + "[" * 100_000, ["not TOML"]),
    "long whole number": ("m1 = " + "1" * 5000, ["not TOML"]),
    "two mistakes": ("m1 = -1\nv0 = 1", ["m1 = -1", "and 1 more"]),
}


def _fails(capsys, arguments, expected):
    assert main(arguments) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.startswith("impact-xval: ")
    assert captured.err.count("\n") == 1, captured.err
    for text in expected:
        assert text in captured.err, captured.err


@pytest.mark.parametrize("case", CONFIGS)
def test_configuration(case, tmp_path, capsys):
    text, expected = CONFIGS[case]
    path = tmp_path / "bad.toml"
    path.write_text(text, encoding="utf-8")
    out = tmp_path / "out"
    _fails(capsys, ["run", str(path), "--out", str(out)], ["bad.toml", *expected])
    assert not out.exists()


def test_configuration_file_itself(tmp_path, capsys):
    out = ["--out", str(tmp_path / "out")]
    latin = tmp_path / "latin.toml"
    latin.write_bytes("name = 'é'".encode("latin-1"))
    _fails(capsys, ["run", str(latin), *out], ["latin.toml", "not UTF-8"])
    _fails(capsys, ["run", str(tmp_path), *out], [str(tmp_path), "is a directory"])
    _fails(capsys, ["run", str(tmp_path / "none.toml"), *out], ["none.toml", "no such file"])
    _fails(capsys, ["run", str(latin / "below"), *out], ["latin.toml/below", "cannot be read"])
    assert sorted(tmp_path.iterdir()) == [latin]


def test_output_folder(tmp_path, capsys):
    good = tmp_path / "good.toml"
    good.write_text("solvers = ['state-transition']")
    file = tmp_path / "file"
    file.write_text("mine")
    foreign = tmp_path / "foreign"
    foreign.mkdir()
    (foreign / "thesis.txt").write_text("mine")
    damaged = tmp_path / "damaged"
    damaged.mkdir()
    (damaged / "manifest.json").write_text("{")
    other = tmp_path / "other"
    other.mkdir()
    (other / "manifest.json").write_text('{"format": "another program"}')

    run = ["run", str(good), "--out"]
    _fails(capsys, [*run, str(file)], ["--out", "file", "is a file", "legal"])
    _fails(capsys, [*run, str(file / "below")], ["--out", "cannot be written to"])
    _fails(capsys, [*run, "/proc/impact-xval"], ["--out", "/proc/impact-xval", "cannot be written to"])
    for more in ([], ["--resume"]):
        _fails(capsys, [*run, str(foreign), *more], ["--out", "thesis.txt", "not a run"])
        _fails(capsys, [*run, str(damaged), *more], ["manifest.json", "damaged"])
        _fails(capsys, [*run, str(other), *more], ["manifest.json", "not the manifest"])
    assert [p.name for p in foreign.iterdir()] == ["thesis.txt"]
    assert file.read_text() == "mine"


@pytest.mark.parametrize("command", ["table", "figures", "report"])
def test_folder_of_no_run(command, tmp_path, capsys):
    _fails(capsys, [command, str(tmp_path / "none")], ["none", "no such folder"])
    _fails(capsys, [command, str(tmp_path)], ["no manifest.json", "legal: the folder of a run"])
    manifest = {
        **{
            "format": "impact-xval run, format 1",
            "state": "running",
            "cells": 1,
            "chunks": 1,
            "sessions": [],
        },
        **{key: {} for key in ("configuration", "versions", "libraries", "machine")},
        **dict.fromkeys(("started", "identity", "seeds"), ""),
    }
    (tmp_path / "manifest.json").write_text(json.dumps(manifest))
    _fails(capsys, [command, str(tmp_path)], ["not finished", "--resume"])


CELL = {"--stiffness-ratio": "1", "--mass-ratio": "1", "--e1": "0.9", "--e2": "0.7"}
RATIOS = [word for pair in CELL.items() for word in pair]
OPTIONS = {
    "negative ratio": ({"--stiffness-ratio": "-1"}, ["--stiffness-ratio = -1", "0 to inf"]),
    "nan ratio": ({"--stiffness-ratio": "nan"}, ["--stiffness-ratio = nan", "0 to inf"]),
    "text for a ratio": ({"--stiffness-ratio": "stiff"}, ["--stiffness-ratio = 'stiff'", "0 to inf"]),
    "zero mass": ({"--mass-ratio": "0"}, ["--mass-ratio = 0", "a finite number > 0"]),
    "infinite mass": ({"--mass-ratio": "inf"}, ["--mass-ratio = inf", "a finite number > 0"]),
    "e1": ({"--e1": "1.01"}, ["--e1 = 1.01", BELOW_ONE]),
    "e2": ({"--e2": "-0.5"}, ["--e2 = -0.5", BELOW_ONE]),
    "scenario": ({"--scenario": "throw"}, ["--scenario = 'throw'", "'impact' or 'drop'"]),
    "mapping": ({"--mapping": "x"}, ["--mapping = 'x'", "'calibrated' or 'naive'"]),
    "step": ({"--step-fraction": "0"}, ["--step-fraction = 0", "at most 0.1"]),
    "v0": ({"--v0": "0"}, ["--v0 = 0", "a finite number < 0"]),
    "m1": ({"--m1": "0"}, ["--m1 = 0", "a finite number > 0"]),
    "k1": ({"--k1": "-1"}, ["--k1 = -1", "a finite number > 0"]),
    "gravity": ({"--gravity": "-9"}, ["--gravity = -9", "a finite number > 0"]),
    "gravity of an impact": (
        {"--gravity": "500"},
        ["--gravity = 500", "--scenario impact, which has no gravity; legal: --scenario drop"],
    ),
    "cut-off": ({"--cutoff": "0.5"}, ["--cutoff = 0.5", "greater than 1"]),
    "cut-off is another word": (
        {"--cutoff": "none"},
        ["--cutoff = 'none'", "greater than 1, up to inf, or 'exact'"],
    ),
    "solver": ({"--solver": "bullet"}, ["--solver 'bullet'", "did you mean 'pybullet'", "legal:"]),
    "no impulse": ({"--m1": "1e-200", "--v0": "-1e-200"}, ["--m1", "times |v0| = 1e-200", "product > 0"]),
    "overflow": ({"--stiffness-ratio": "1e305"}, ["--stiffness-ratio", "1e+305", "double precision"]),
}


@pytest.mark.parametrize(
    "command",
    [["export-scene", *RATIOS], ["map", "--e1", "0.9", "--e2", "0.7", "--scenario", "impact"]],
    ids=lambda command: command[0],
)
def test_gravity_is_for_a_drop_only(command, tmp_path, capsys):
    out = tmp_path / "out"
    _fails(
        capsys,
        [*command, "--gravity", "9.81", "--out", str(out)],
        ["--gravity = 9.81", "legal: --scenario drop"],
    )
    assert not out.exists()


@pytest.mark.parametrize("case", OPTIONS)
def test_solve_options(case, capsys):
    changed, expected = OPTIONS[case]
    arguments = [word for pair in (CELL | changed).items() for word in pair]
    _fails(capsys, ["solve", *arguments], expected)


CRADLE = {
    "balls": ({"--balls": "1"}, ["--balls = 1", "from 2 to 1000, for a cradle"]),
    "too many balls": ({"--balls": "1001"}, ["--balls = 1001", "from 2 to 1000, for a cradle"]),
    "no ball": (
        {"--balls": "0", "--arrangement": "stack"},
        ["--balls = 0", "from 1 to 1000, for a stack"],
    ),
    "half a ball": ({"--balls": "2.5"}, ["--balls = '2.5'", "a whole number from 2"]),
    "all strike": ({"--strike": "5"}, ["--strike = 5", "from 1 to 4, for 5 balls"]),
    "none strikes": ({"--strike": "0"}, ["--strike = 0", "from 1 to 4, for 5 balls"]),
    "strike in words": ({"--strike": "two"}, ["--strike = 'two'", "a whole number from 1 to balls - 1"]),
    "strike of a chain": (
        {"--strike": "1", "--arrangement": "chain"},
        ["--strike = 1", "none for a chain"],
    ),
    "e": ({"--e": "1.01"}, ["--e = 1.01", BELOW_ONE]),
    "e below zero": ({"--e": "-0.1"}, ["--e = -0.1", BELOW_ONE]),
    "exponent": ({"--exponent": "0.5"}, ["--exponent = 0.5", "from 1 (linear contacts; 1.5: Hertz) to 3"]),
    "gap": ({"--gap": "-1e-5"}, ["--gap = -1e-05", "a finite number >= 0 (m)"]),
    "nothing meets": ({"--v0": "1"}, ["--v0 = 1.0", "a finite number < 0 (m/s, up is positive)"]),
    "arrangement": ({"--arrangement": "tower"}, ["'tower'", "'chain', 'cradle', 'drop' or 'stack'"]),
    "taper": ({"--mass-taper": "0"}, ["--mass-taper = 0.0", "a finite number > 0 (m_(i+1)/m_i)"]),
    "far tapered": ({"--mass-taper": "1e200"}, ["--mass-taper = 1e+200", "power 4", "finite numbers > 0"]),
    "hard": (
        {"--k": "1e300", "--stiffness-taper": "1e10"},
        ["--stiffness-taper = 1", "k = 1e+300 times that", "finite numbers > 0"],
    ),
    "stiffness": ({"--k": "0"}, ["--k = 0.0", "a finite number > 0 (N/m^p)"]),
    "no impulse": ({"--m": "1e-200", "--v0": "-1e-200"}, ["--v0 = -1e-200", "m = 1e-200", "product > 0"]),
    "step": ({"--step-fraction": "1"}, ["--step-fraction = 1.0", "at most 0.1"]),
    "mapping": ({"--mapping": "x"}, ["--mapping = 'x'", "'calibrated' or 'naive'"]),
    "solver": ({"--solver": "bullet"}, ["--solver 'bullet'", "did you mean 'pybullet'", "legal:"]),
    "two mistakes": ({"--e": "2", "--gap": "-1"}, ["--e = 2.0", "(and 1 more)"]),
}


@pytest.mark.parametrize("case", CRADLE)
def test_cradle_options(case, capsys):
    changed, expected = CRADLE[case]
    _fails(capsys, ["cradle", *(word for pair in changed.items() for word in pair)], expected)


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["sovle"], ["sovle", "--help"]),
        (["solve", "--stiffness-ratio", "1"], ["Missing option", "--help"]),
        (["solve", "--no-such"], ["--no-such"]),
        (["table"], ["Missing argument", "DIR"]),
        (["run", "a.toml", "b.toml"], ["b.toml"]),
        (["run", "--workers", "0"], ["--workers = '0'", "a whole number from 1 to 4096"]),
        (["run", "--workers", "two"], ["--workers = 'two'", "a whole number from 1 to 4096"]),
        (["run", "--workers", "9" * 5000], ["--workers = '999", "a whole number from 1 to 4096"]),
        (["search", "--solver", ""], ["--solver", "'' is not a solver", "legal: state-transition"]),
        (["conform", "bullet"], ["SOLVER 'bullet'", "did you mean 'pybullet'", "legal: state-transition"]),
        (["export-scene", *RATIOS, "--scenario", ""], ["--scenario = ''", "'impact' or 'drop'"]),
        (
            ["map", *RATIOS[4:], "--k1", "1e-300", "--m1", "1e300"],
            ["--gravity, --m1", "inf", "a finite number"],
        ),
        (["map", *RATIOS[4:], "--k1", "1e300", "--m1", "1e-300"], ["= 0.0 leaves", "a finite number > 0"]),
        (["--versoin"], ["--versoin"]),
    ],
)
def test_usage(arguments, expected, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    _fails(capsys, arguments, expected)
    assert not list(tmp_path.iterdir())


READING = ("run", "search", "hypothesis", "doctor", "status", "table", "figures", "report", "ladder")
WRITING = {
    "run": [],
    "search": [],
    "hypothesis": [],
    "calibrate": [],
    "map": RATIOS[4:],
    "export-scene": RATIOS,
}


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("", "the empty text"),
        ("x" * 300, "File name too long"),
        ("a\0b", "null byte"),
        ("a\udcff", "not UTF-8"),
    ],
)
def test_what_is_no_path(text, why, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for command in READING:
        _fails(capsys, [command, text], [f" = '{text[:1]}", why, "legal: a path"])
    for command, more in WRITING.items():
        _fails(capsys, [command, *more, "--out", text], ["--out = '", why, "legal: a path"])
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("command", WRITING)
def test_a_file_where_a_folder_is_to_be_written(command, capsys, tmp_path):
    file = tmp_path / "file"
    file.write_text("mine")
    for out in (file, file / "below"):
        assert main([command, *WRITING[command], "--out", str(out)]) == 2
        captured = capsys.readouterr()
        lines = [line for line in captured.err.splitlines() if "compiling" not in line]
        assert len(lines) == 1
        assert lines[0].startswith(f"impact-xval: --out {out}")
        assert captured.out == ""
    assert file.read_text() == "mine"
    assert list(tmp_path.iterdir()) == [file]
