"""Wrong configurations, lists of cells and folders: one line names field, value and legal range; no file is written."""

import json

import pytest

from impact_xval.experiments.config.experiment import load_config
from impact_xval.experiments.tables.folder import FORMAT

BELOW_ONE = "from 0 to 1"
#: Text of a configuration, and parts of the message.
CONFIGS = [
    ("[grid]\nstiffness_ratio = [1, -1]", ["grid.stiffness_ratio", "-1", "0 to inf"]),
    ("[grid]\ne2 = ['half']", ["grid.e2", "half", "not a number", BELOW_ONE]),
    ("[grid]\ne1 = []", ["grid.e1 = []", "a list of them (one or more)", "linear"]),
    ("[grid]\ne1 = [0.5, 0.7, 0.5]", ["grid.e1", "0.5", "more than once", "each value once"]),
    ("[grid]\nmas_ratio = [1]", ["grid.mas_ratio", "unknown key", "did you mean 'mass_ratio'", "e1"]),
    ("grid = [1]", ["grid = [1]", "a table: stiffness_ratio"]),
    ("[grid]\ne1 = {cubic = [0, 1, 3]}", ["grid.e1", "cubic", "log = [lo, hi, n]"]),
    ("[grid]\ne1 = {linear = [1, 0, 3]}", ["grid.e1", "lo = 1, hi = 0", "lo < hi"]),
    ("[grid]\nstiffness_ratio = {log = [0, 1, 3]}", ["grid.stiffness_ratio", "lo = 0", "lo > 0"]),
    ("[grid]\nstiffness_ratio = {log = [1, inf, 3]}", ["grid.stiffness_ratio", "both finite"]),
    ("[grid]\ne1 = {linear = [0, 1, 1]}", ["grid.e1", "n = 1", "from 2 to"]),
    ("[grid]\ne1 = {linear = [0, 1, 9000]}\ne2 = {linear = [0, 1, 9000]}", ["grid", "1 to 10000000"]),
    ("[sample]\nn = 0", ["sample.n = 0", "a whole number from 1"]),
    ("[sample]\ne1 = [0, 1]", ["sample.e1 = [0, 1]", "a number, {log = [lo, hi]}"]),
    ("[sample]\ne1 = {linear = [0, 1, 3]}", ["sample.e1", "[0, 1, 3]", "{linear = [lo, hi]}"]),
    ("[sample]\nstiffness_ratio = {log = [1e-300, 1e300]}", ["sample.stiffness_ratio", "hi/lo finite"]),
    ("[grid]\n[chain]", ["grid and chain are given", "legal: one of grid, sample, cells, chain"]),
    ("[chain]\n[graph]", ["chain and graph are given", "legal: one of grid, sample, cells, chain, graph"]),
    ("[graph]\nname = ['box']", ["graph.name = ['box']", "'bridge' or 'rack', or a list of them"]),
    ("[graph]\nname = 'corner'\nangle = 180", ["graph.angle = 180", "more than 0 and less than 180"]),
    ("[graph]\nangle = [30, 90]", ["graph: angle = 90 of bernoulli", "from 30 to less than 90 degrees"]),
    ("[graph]\nname = 'rack'\nangle = 30", ["graph: angle is given", "with bernoulli, corner, bridge"]),
    ("[graph]\nballs = [3, 4]", ["graph.balls = 4", "3, 6 or 10"]),
    ("[graph]\nstiffness_ratio = 0", ["graph.stiffness_ratio = 0", "a number > 0"]),
    ("[graph]\nmass_ratio = inf", ["graph.mass_ratio = inf", "a number > 0"]),
    ("[graph]\ne = 1.5", ["graph.e = 1.5", BELOW_ONE]),
    ("k1 = 1e300\n[graph]\nname = 'corner'\nstiffness_ratio = 1e100", ["graph: corner with", "k1 = 1e+300"]),
    ("scenario = 'drop'\n[graph]", ["scenario = 'drop'", "graphs have no gravity; legal: 'impact'"]),
    ("[graph]\n[figure_chain]", ["figure_chain is given with graph", "legal: none"]),
    ("[chain]\nballs = 1001", ["chain.balls = 1001", "from 2 (a stack: 1) to 1000"]),
    ("[chain]\nballs = [1, 3]", ["chain: balls = 1", "from 2 to 1000, for a cradle"]),
    ("[chain]\nballs = {linear = [2, 5, 3]}", ["chain.balls = 3.5", "a whole number from 2"]),
    ("[chain]\narrangement = ['heap']", ["chain.arrangement = ['heap']", "'pile' or 'stack'"]),
    ("[chain]\nballs = [3, 4]\nstrike = [1, 3]", ["strike = 3", "from 1 to 2, for 3 balls"]),
    ("[chain]\narrangement = 'pile'\nstrike = 1", ["chain: strike = [1.0]", "none without a cradle"]),
    ("scenario = 'drop'\n[chain]", ["scenario = 'drop'", "no gravity; legal: 'impact'"]),
    ("[chain]\n[figure_cell]", ["figure_cell is given with chain", "figure_chain"]),
    ("gravity = 9.81\n[chain]", ["gravity is given with chain", "legal: none"]),
    ("[figure_chain]", ["figure_chain is given without chain", "figure_cell"]),
    ("m1 = '1'", ["m1 = '1'", "a finite number > 0 (kg)"]),
    ("k1 = inf", ["k1 = inf", "a finite number > 0 (N/m)"]),
    ("v0 = -1e-300\ngravity = 1e300", ["v0 = -1e-300, gravity = 1e+300", "a finite number > 0"]),
    ("k1 = 1e300\n[sample]\nstiffness_ratio = {log = [1, 1e200]}", ["= 1e+200 with", "k1 = 1e+300"]),
    ("m1 = -1\nv0 = 1", ["m1 = -1", "and 1 more"]),
    ("gravitiy = 9.81", ["gravitiy", "9.81", "unknown key", "did you mean 'gravity'"]),
    ("zzz = 1", ["zzz", "unknown key", "legal: name"]),
    ("scenario = 'throw'", ["scenario", "'throw'", "'impact' or 'drop'"]),
    ("step_fraction = 0.21", ["step_fraction = 0.21", "at most 0.2"]),
    ("e1 = 0.5", ["e1 = 0.5: unknown key (it belongs in [grid]); legal: name"]),
    ("[grid]\ne = [0.5]\ne1 = [0.5]", ["grid", "e is given with e1", "e for both"]),
    ("[grid]\nm2 = [1.0]\nmass_ratio = [1.0]", ["grid", "m2 is given with mass_ratio", "one of both"]),
    ("[grid]\nk2 = 1e8\nstiffness_ratio = 1", ["grid", "k2 is given with stiffness_ratio", "one of both"]),
    ("m1 = 2.0\n[grid]\nm1 = [1.0, 2.0]", ["m1 is given above every [table] and in [grid]", "one of both"]),
    ("[grid]\nm2 = [1.0, inf]", ["grid.m2 = inf", "a finite number > 0 (kg)"]),
    ("[grid]\nk1 = 0", ["grid.k1 = 0", "a finite number > 0 (N/m)"]),
    ("[grid]\nk2 = -1", ["grid.k2 = -1", "from 0 to inf (N/m)"]),
    ("[grid]\nm1 = [1e-200, 1]\nm2 = 1e200", ["m2 = 1e+200 with m1 = 1e-200", "mass_ratio = inf"]),
    ("[grid]\nk1 = 1e-200\nk2 = 1e-320\nm1 = 1e200", ["k1 = 1e-200", "precision"]),
    ("max_steps = 0", ["max_steps = 0", "a whole number >= 1"]),
    ("shortest_state = 0.5", ["shortest_state = 0.5", "from 0 to 0.1 (of the shorter"]),
    ("mapping = 'none'", ["mapping = 'none'", "'calibrated' or 'naive'"]),
    ("stiffness_ratio_cutoff = 1", ["stiffness_ratio_cutoff = 1", "greater than 1, up to inf"]),
    ("stiffness_ratio_cutoff = 'none'", ["stiffness_ratio_cutoff = 'none'", "or 'exact'"]),
    ("workers = 0", ["workers = 0", "a whole number from 1 to 4096"]),
    ("grazing_threshold = 2.0", ["grazing_threshold = 2.0", "from 0 to 1"]),
    ('name = "a\\nb"', ["name", "a\\nb", "printable"]),
    ("[figure_cell]\ne1 = 2.0", ["figure_cell.e1 = 2.0", BELOW_ONE]),
    ("[convergence]\ntolerance = 0", ["convergence.tolerance", "0", "greater than 0, at most 1"]),
    ("[convergence]\nhalvings = -1", ["convergence.halvings", "-1", "from 0 to 10"]),
    ("solvers = []", ["solvers", "empty", "state-transition"]),
    ("solvers = ['mujoko']", ["solvers", "'mujoko'", "did you mean 'mujoco'", "legal:"]),
    ("solvers = ['mujoco', 'mujoco']", ["solvers", "'mujoco'", "each solver once"]),
    ("solvers = 'mujoco'", ["solvers = 'mujoco'", "a list of names"]),
    ("gravity = 9.81\nm1 = = 2", ["not TOML", "line 2"]),
    ("name = " + "[" * 3000 + "]" * 3000, ["nested too deeply", "at most 20 levels"]),
    ("name = " + "{a = " * 2000 + "1" + "}" * 2000, ["nested too deeply", "at most 20 levels"]),
    ("name." + "a." * 3000 + "a = 1", ["name.a.a", "is nested too deeply", "at most 20 levels"]),
    (f"stiffness_ratio_cutoff = {'9' * 400}", ["stiffness_ratio_cutoff = 1.000e+400", "64 bits"]),
    (f"[grid]\nstiffness_ratio = {'9' * 400}", ["grid.stiffness_ratio = 1.000e+400", "up to 1.7e308"]),
    (f"[grid]\nk2 = {{log = [1, -{'9' * 400}, 3]}}", ["grid.k2.log.1 = -1.000e+400", "64 bits"]),
    ("[grid]\nk2 = {linear = [1, 9223372036854775808, 3]}", ["grid.k2.linear.1 = 9.223e+18", "64 bits"]),
    (f"[sample]\nstiffness_ratio = {{linear = [1, 0x{'f' * 4000}]}}", ["linear.1 = ", "e+4816", "64 bits"]),
]


@pytest.mark.parametrize(("text", "expected"), CONFIGS)
def test_a_wrong_configuration_is_one_line_that_names_field_value_and_range(
    text, expected, tmp_path, refused
):
    (tmp_path / "bad.toml").write_text(text, encoding="utf-8")
    out = tmp_path / "out"
    refused(["run", tmp_path / "bad.toml", "--out", out], "bad.toml", *expected)
    assert not out.exists()


def test_a_configuration_that_cannot_be_read_is_one_line(tmp_path, refused):
    out = ["--out", tmp_path / "out"]
    latin = tmp_path / "latin.toml"
    latin.write_bytes("name = 'é'".encode("latin-1"))
    refused(["run", latin, *out], "latin.toml", "not UTF-8")
    refused(["run", tmp_path, *out], str(tmp_path), "Is a directory")
    refused(["run", tmp_path / "none.toml", *out], "none.toml", "No such file")
    assert sorted(tmp_path.iterdir()) == [latin]


def test_a_file_that_begins_with_a_byte_order_mark_is_read(tmp_path):
    (tmp_path / "marked.toml").write_text("k1 = 5.0", encoding="utf-8-sig")
    assert load_config(tmp_path / "marked.toml").k1 == 5


HEADER = "stiffness_ratio,mass_ratio,e1,e2\n"
LISTS = [
    ("", ["no such file"]),
    ("stiffness_ratio,mass_ratio,e1\n1,1,1\n", ["column e2 is missing", "legal: columns"]),
    (HEADER, ["0 rows", "legal: 1 to"]),
    (HEADER + "1,1,1,half\n", ["e2 is not a column of numbers"]),
    (HEADER + "1,1,1,1\n1,,1,1\n", ["row 2: mass_ratio is empty"]),
    (HEADER + "1,1,1,1\n1,1,1.5,1\n", ["row 2: e1 = 1.5", BELOW_ONE]),
    (HEADER + "1,inf,1,1\n", ["row 1: mass_ratio = inf"]),
    (HEADER + "1,1,1,1\n1e305,1,1,1\n", ["row 2: stiffness_ratio = 1e+305", "precision"]),
    (HEADER + "1,1e-320,1,1\n", ["row 1: mass_ratio = 1e-320", "gravity = 9.81", "precision"]),
    (HEADER + "1,1\n", ["cannot be read"]),
    ("PAR1 and no more", ["cannot be read"]),
]


@pytest.mark.parametrize(("text", "expected"), LISTS)
def test_a_wrong_list_of_cells_is_one_line(text, expected, tmp_path, refused):
    path = tmp_path / ("cells.parquet" if text.startswith("PAR1") else "cells.csv")
    if text:
        path.write_text(text)
    (tmp_path / "c.toml").write_text(f"cells = '{path.name}'")
    field = [] if text else ["c.toml: cells = "]
    refused(["run", tmp_path / "c.toml", "--out", tmp_path / "out"], *field, path.name, *expected)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("name", ["show", "report"])
def test_what_is_shown_of_a_run_needs_a_finished_one(name, tmp_path, refused):
    refused([name, tmp_path / "none"], "none", "no such folder")
    refused([name, __file__], __file__, "a file; legal: the folder of a run")
    refused([name, tmp_path], "no manifest.json", "legal: the folder of a run")
    texts, tables = ("name", "reference", "identity"), ("versions", "libraries", "machine")
    manifest = dict.fromkeys(texts, "") | {name: {} for name in tables} | {"cells": 1, "chunks": 1}
    manifest |= {"format": FORMAT, "state": "running", "sessions": []}
    (tmp_path / "manifest.json").write_text(json.dumps(manifest))
    refused(["report", tmp_path], "not finished", "to continue: impact-xval run --out")


def test_a_folder_that_cannot_be_written_is_one_line_and_a_file_in_its_place_stays(refused, tmp_path):
    refused("run --out /proc/impact-xval", "/proc/impact-xval", "cannot be written")
    file = tmp_path / "file"
    file.write_text("mine")
    cell = "scene --stiffness-ratio 1 --mass-ratio 1 --e1 0.9 --e2 0.7"
    for words in (["run"], ["hypothesis"], cell.split()):
        for out in (file, file / "below"):
            refused([*words, "--out", out], f"--out {out}")
        refused([*words, "--out", ""], "--out = '", "legal: a path")
    assert file.read_text() == "mine"
    assert list(tmp_path.iterdir()) == [file]
