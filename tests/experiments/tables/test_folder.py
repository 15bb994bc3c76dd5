"""Folders of runs: only one run writes, damage loses nothing else, and other folders are refused with one line."""

import json
import math
import re
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from impact_xval.experiments.config import cells
from impact_xval.experiments.config.cells import experiment_cells
from impact_xval.experiments.config.errors import UserError
from impact_xval.experiments.config.experiment import load_config, parse_config
from impact_xval.experiments.tables.folder import CONFIGURATION, is_written_to, lock_for_writing
from tests.experiments.conftest import SMALL, resumed, tables_of
from tests.waiting import wait_until


def hold(root):
    with lock_for_writing(Path(root), experiment_cells(parse_config({}))):
        time.sleep(60)


def _entries(root):
    return {
        str(path.relative_to(root)): path.read_bytes()
        for path in sorted(root.rglob("*"))
        if path.is_file() and not path.name.startswith(".lock")
    }


@pytest.mark.smoke
def test_the_second_run_refuses_and_a_killed_one_blocks_nobody(tmp_path, refused):
    script = f"from {__name__} import hold; hold({str(tmp_path / 'a')!r})"
    other = subprocess.Popen([sys.executable, "-c", script])
    # The other run writes its experiment after it has locked the folder. A run that is killed in between leaves nothing
    # to continue.
    wait_until(lambda: (tmp_path / "a" / CONFIGURATION).exists() and is_written_to(tmp_path / "a"))
    refused(["run", "--out", tmp_path / "a"], f"--out {tmp_path / 'a'}: another run writes there")
    other.kill()
    other.wait()
    assert not is_written_to(tmp_path / "a")
    with lock_for_writing(tmp_path / "a", experiment_cells(parse_config({}))) as (folder, continued):
        assert is_written_to(folder.root)
        assert continued


def test_what_is_no_run_is_one_line_and_is_left_as_it_is(tmp_path, refused):
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine/notes.txt").write_text("mine")
    for name, text in (("old", '{"format": "impact-xval run, format 1"}'), ("damaged", "{")):
        (tmp_path / name).mkdir()
        (tmp_path / name / "manifest.json").write_text(text)
    before = _entries(tmp_path)
    for name, says in (
        ("mine", "not empty (notes.txt) and not a run"),
        ("old", "format = 'impact-xval run, format 1'; legal: 'impact-xval run, format 4'"),
        ("damaged", "manifest.json: damaged"),
    ):
        refused(["run", "--quick", "--out", tmp_path / name], says)
    assert _entries(tmp_path) == before


@pytest.mark.parametrize(
    "data",
    [
        {},
        {"stiffness_ratio_cutoff": math.inf, "grid": {"stiffness_ratio": [0, math.inf]}, "name": "inf"},
        {"grid": {"stiffness_ratio": [1.0, 2.0], "mass_ratio": [1.0], "e": [0.5, 0.9]}},
        {"sample": {"n": 7, "seed": 3, "stiffness_ratio": math.inf}, "workers": 2},
        {"chain": {"arrangement": "cradle", "balls": [3], "strike": [1, 2], "e": {"linear": [0.5, 1.0, 3]}}},
    ],
    ids=["default", "grid", "tied", "sample", "chains"],
)
def test_the_experiment_in_the_folder_is_that_which_was_asked_for(data, tmp_path):
    config = parse_config(data)
    with lock_for_writing(tmp_path / "a", experiment_cells(config)) as (folder, _):
        folder.write_config(config)
        assert folder.config() == load_config(folder.root / "experiment.toml") == config
        assert folder.config().identity() == config.identity()


def test_another_experiment_is_refused_with_what_differs(run):
    before = _entries(run)
    with pytest.raises(UserError, match=r"step_fraction = 0.001 there, 0.01 now"):
        resumed(run, parse_config(SMALL | {"step_fraction": 1e-2}))
    assert _entries(run) == before


@pytest.mark.parametrize("lost", ["tail", "all"])
@pytest.mark.parametrize(
    "words", ["run --out DIR", "show DIR", "report DIR", "scene DIR 0", "compare DIR DIR"]
)
def test_an_experiment_that_lost_keys_is_not_taken_for_another(run, refused, words, lost):
    path = run / CONFIGURATION
    path.write_text(path.read_text().partition("[grid]")[0] if lost == "tail" else "")
    before = _entries(run)
    refused([str(run) if word == "DIR" else word for word in words.split()], str(path), "the run was begun")
    assert _entries(run) == before


@pytest.mark.parametrize("by", ["file", "sample"])
def test_other_cells_of_the_same_experiment_are_refused(tmp_path, monkeypatch, by):
    header, file = "stiffness_ratio,mass_ratio,e1,e2\n", tmp_path / "cells.csv"
    file.write_text(header + "1,1,0.9,0.7\n")
    ranges = {"stiffness_ratio": {"log": [0.5, 2.0]}, "mass_ratio": 1.0, "e1": 0.9, "e2": 0.7}
    design = {"cells": str(file)} if by == "file" else {"sample": {"n": 1, **ranges}}
    config = parse_config({key: value for key, value in SMALL.items() if key != "grid"} | design)
    resumed(tmp_path / "a", config)
    before = _entries(tmp_path / "a")
    file.write_text(header + "1,1,0.9,0.8\n")
    monkeypatch.setattr(cells, "draw", lambda sample: np.array([[1.0, 1.0, 0.9, 0.7]]))
    with pytest.raises(
        UserError, match=f"other cells than those of .*{by if by == 'sample' else 'cells.csv'}"
    ):
        resumed(tmp_path / "a", config)
    assert _entries(tmp_path / "a") == before


#: Values that replace a key of a manifest, and texts that replace the whole manifest; None removes the key.
DAMAGES = [
    *({name: None} for name in ("state", "cells", "chunks", "identity", "versions", "sessions", "name")),
    {"state": "paused"},
    {"state": 7},
    {"cells": "12"},
    {"chunks": 10**18},
    {"versions": ["1"]},
    {"sessions": {}},
    {"format": ["impact-xval run, format 4"]},
    "[" * 100_000 + "]" * 100_000,
    "[]",
    "null",
]


@pytest.mark.parametrize("damage", DAMAGES, ids=lambda damage: str(damage)[:30])
def test_a_manifest_that_is_incomplete_is_damaged_and_the_run_writes_it_again(run, fake_run, refused, damage):
    path = run / "manifest.json"
    whole = json.loads(path.read_text())
    if isinstance(damage, dict):
        kept = {key: value for key, value in (whole | damage).items() if value is not None}
        damage = json.dumps(kept)
    path.write_text(damage)
    for words in ("show DIR", "report DIR", "compare DIR DIR"):
        refused([str(run) if word == "DIR" else word for word in words.split()], f"{path}: damaged", "again")
    resumed(run)
    again = json.loads(path.read_text())
    assert again["state"] == "complete"
    assert again["identity"] == whole["identity"]
    assert tables_of(run) == tables_of(fake_run.root)


def test_files_of_the_user_in_the_folder_stay(run):
    (run / "mine").mkdir()
    names = ("notes.txt", ".tmp-notes", "parts/.tmp-notes", "mine/cells.parquet")
    for name in names:
        (run / name).write_text("mine")
    resumed(run)
    assert all((run / name).read_text() == "mine" for name in names)


@pytest.mark.parametrize("kept", [0, 300], ids=["missing", "cut"])
def test_a_damaged_manifest_strands_no_part(run, kept, command, refused):
    before, manifest = tables_of(run), (run / "manifest.json").read_bytes()
    (run / "manifest.json").unlink()
    if kept:
        (run / "manifest.json").write_bytes(manifest[:kept])
    refused(["report", run])
    assert any("3 of 3 parts are already computed" in line for line in resumed(run))
    assert tables_of(run) == before
    command(["show", run])


def test_shards_in_any_order_make_the_tables_of_one_run(tmp_path, fake_run):
    root, said = tmp_path / "a", []
    for shard in ((2, 4), (1, 4), (4, 4), (3, 4)):
        assert not (root / "cells.parquet").exists()
        said += resumed(root, shard=shard)
    assert "1 of 3 parts are computed; the last shard to finish writes the tables" in said
    assert tables_of(root) == tables_of(fake_run.root)
    sessions = json.loads((root / "manifest.json").read_text())["sessions"]
    assert [each["shard"] for each in sessions] == ["2 of 4", "1 of 4", "4 of 4", "3 of 4"]
    assert [each["parts_computed"] for each in sessions] == [1, 1, 0, 1]


@pytest.mark.parametrize(
    "words", ["show DIR --cell 0", "report DIR", "compare DIR DIR", "report DIR --only page"]
)
@pytest.mark.parametrize("harm", ["page", "footer"])
def test_a_damaged_table_is_named_and_the_run_writes_it_again(run, fake_run, refused, words, harm):
    path = run / "divergence.parquet"
    data = bytearray(path.read_bytes())
    chunk = (
        pq.read_metadata(path).row_group(0).column(pq.read_schema(path).names.index("velocity_divergence"))
    )
    start = chunk.dictionary_page_offset or chunk.data_page_offset
    place = start + chunk.total_compressed_size - 1 if harm == "page" else len(data) - 20
    data[place] ^= 255
    path.write_bytes(data)
    refused([str(run) if word == "DIR" else word for word in words.split()], f"{path}: ", "damaged", "again")
    resumed(run)
    assert tables_of(run) == tables_of(fake_run.root)


@pytest.mark.parametrize("name", [".lock", "a part"])
def test_a_folder_in_the_place_of_a_file_is_named(run, name):
    path = min((run / "parts").iterdir()) if name == "a part" else run / name
    path.unlink(missing_ok=True)
    path.mkdir()
    with pytest.raises(UserError, match=re.escape(str(path)) + ": a folder .*; legal: remove it"):
        resumed(run)
