"""Folders of runs: those of another version, and what is left of a run that was refused."""

import hashlib
import json
import os
import shutil
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from impact_xval.experiments.commands.cli import main
from impact_xval.experiments.config.configuration import parse_config
from impact_xval.experiments.config.errors import UserError
from impact_xval.experiments.sweep import run as sweep
from impact_xval.experiments.sweep.run import run_sweep
from impact_xval.experiments.tables.files import is_regular
from impact_xval.experiments.tables.folders import discard, finished, missing, open_folder
from impact_xval.experiments.tables.schema import CELLS_SCHEMA
from impact_xval.experiments.tables.store import TABLES, RunFolder
from tests.experiments import fakes
from tests.experiments.conftest import SMALL


def test_a_run_of_another_version_is_refused_in_a_line_with_both(small, tmp_path, capsys):
    root = tmp_path / "a"
    folder = run_sweep(small, root, isolate=False, resolve=fakes.shifted)
    manifest = folder.manifest()
    here = manifest["versions"]["impact-xval"]
    manifest["versions"]["impact-xval"] = "0.2.0"
    old = manifest | {"configuration": manifest["configuration"] | {"certificates": True}}
    (root / "manifest.json").write_text(json.dumps(old))
    assert main(["table", str(root)]) == 2
    error = capsys.readouterr().err
    assert f"(written by impact-xval 0.2.0, read by {here})" in error
    assert error.count("\n") == 1

    table = pq.read_table(root / "cells.parquet")
    pq.write_table(table.drop_columns(["marked"]), root / "cells.parquet")
    manifest["files"]["cells.parquet"] = hashlib.sha256((root / "cells.parquet").read_bytes()).hexdigest()
    (root / "manifest.json").write_text(json.dumps(manifest))
    with pytest.raises(UserError, match=rf"other columns.*0\.2\.0, read by {here}"):
        folder.table_path("cells.parquet", CELLS_SCHEMA)


def test_what_was_made_for_nothing_is_removed_and_nothing_else(tmp_path):
    root = tmp_path / "runs/deep/a"
    new = missing(root)
    assert new == [root, tmp_path / "runs/deep", tmp_path / "runs"]
    folder, continued = open_folder(root, resume=False)
    assert not continued
    (root / ".lock").touch()
    discard(folder, new)
    assert not (tmp_path / "runs").exists()

    (tmp_path / "mine").mkdir()
    folder, _ = open_folder(tmp_path / "mine", resume=False)
    discard(folder, [])
    assert (tmp_path / "mine").is_dir()
    assert not any((tmp_path / "mine").iterdir())

    folder, _ = open_folder(root, resume=False)
    folder.write_part(0, "0" * 32, b"kept")
    discard(folder, new)
    assert len(list(folder.parts.iterdir())) == 1


def _entries(root):
    return {
        str(path.relative_to(root)): path.read_bytes() if is_regular(path) else path.lstat().st_mode
        for path in sorted(root.rglob("*"))
        if not path.name.startswith((".lock", ".owner"))
    }


@pytest.fixture(scope="module")
def complete(tmp_path_factory):
    root = tmp_path_factory.mktemp("complete") / "run"
    run_sweep(parse_config(SMALL), root, isolate=False, resolve=fakes.shifted)
    return root


@pytest.fixture
def run(complete, tmp_path):
    return Path(shutil.copytree(complete, tmp_path / "run"))


def _resume(root):
    said = []
    run_sweep(
        parse_config(SMALL),
        root,
        resume=True,
        isolate=False,
        resolve=fakes.shifted,
        progress=lambda done, total, line: said.append(line),
    )
    return said


@pytest.mark.parametrize("name", [".owner.json", ".lock", "manifest.json", "parts", "figures"])
@pytest.mark.parametrize("kind", ["link", "pipe"])
def test_nothing_is_written_through_a_link_nor_waited_for_at_a_pipe(run, tmp_path, name, kind):
    mine = tmp_path / "mine"
    path = run / name
    if path.is_dir():
        shutil.move(path, mine)
    elif path.exists():
        path.rename(mine)
    elif name == "figures":
        mine.mkdir()
    else:
        mine.write_text("mine")
    path.symlink_to(mine) if kind == "link" else os.mkfifo(path)
    before = _entries(tmp_path)
    with pytest.raises(UserError, match=rf"{name}: not a (regular file|folder of its own); legal"):
        _resume(run)
    assert _entries(tmp_path) == before


@pytest.mark.parametrize("kind", ["link", "pipe", "folder"])
def test_what_has_the_name_of_a_part_and_is_no_file_is_refused(run, tmp_path, kind):
    part = sorted((run / "parts").glob("0*"))[1]
    part.rename(tmp_path / "mine")
    make = {"link": lambda: part.symlink_to(tmp_path / "mine"), "pipe": lambda: os.mkfifo(part)}
    make.get(kind, part.mkdir)()
    before = _entries(tmp_path)
    with pytest.raises(UserError, match="not a regular file; legal: a part that a run wrote"):
        _resume(run)
    assert _entries(tmp_path) == before
    if kind == "pipe":
        assert main(["status", str(run)]) == 0


def test_what_a_hard_link_leads_to_is_left_as_it_is(run, tmp_path):
    for name in (".owner.json", ".lock", "manifest.json", "cells.parquet"):
        (run / name).touch()
        os.link(run / name, tmp_path / name)
    (tmp_path / ".owner.json").write_text("mine")
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir() if path.is_file()}
    _resume(run)
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir() if path.is_file()} == before


def test_temporary_files_of_the_user_stay(run):
    (run / "mine").mkdir()
    (run / "figures").mkdir(exist_ok=True)
    names = (
        ".tmp-notes",
        ".tmp-7-notes",
        ".tmp-x-cells.parquet",
        "parts/.tmp-7-notes",
        "parts/.tmp-7-cells.parquet",
    )
    mine = [run / name for name in (*names, "mine/.tmp-7-cells.parquet", "figures/.tmp-7-notes.txt")]
    for path in mine:
        path.write_text("mine")
    (run / ".tmp-8-cells.parquet").symlink_to(run / ".tmp-notes")
    _resume(run)
    assert all(path.read_text() == "mine" for path in mine)
    assert (run / ".tmp-8-cells.parquet").is_symlink()


def test_the_folder_itself_may_be_behind_a_link(run, tmp_path):
    (tmp_path / "here").symlink_to(run)
    assert any("3 of 3 parts are there" in line for line in _resume(tmp_path / "here"))
    assert finished(tmp_path / "here").manifest()["state"] == "complete"


@pytest.mark.parametrize(
    "harm",
    [
        lambda path: path.unlink(),
        lambda path: path.write_bytes(b""),
        lambda path: path.write_bytes(b"{}"),
        lambda path: path.write_bytes(path.read_bytes()[:300]),
        lambda path: path.write_text(path.read_text().replace('"chunks": 3', '"chunks": "three"')),
        lambda path: path.write_text(path.read_text().replace('"scenario": "impact"', '"scenario": 3')),
    ],
)
def test_a_damaged_manifest_strands_no_part(run, harm, capsys):
    before = {name: (run / name).read_bytes() for name in TABLES}
    harm(run / "manifest.json")
    assert main(["table", str(run)]) == 2
    assert capsys.readouterr().err.count("\n") == 1
    said = _resume(run)
    assert any("manifest.json" in line and "it is written now" in line for line in said)
    assert any("3 of 3 parts are there and whole" in line for line in said)
    assert {name: (run / name).read_bytes() for name in TABLES} == before
    assert main(["status", str(run)]) == 0


def test_the_rows_of_another_chunk_under_a_right_digest_are_computed_again(run):
    before = {name: (run / name).read_bytes() for name in TABLES}
    one, two, _ = sorted((run / "parts").glob("0*"))
    content = two.read_bytes()
    start, identity, _ = one.name.split("-")
    one.unlink()
    (run / f"parts/{start}-{identity}-{hashlib.sha256(content).hexdigest()}.parquet").write_bytes(content)
    assert "part 0 holds the rows of another: computed again" in _resume(run)
    assert {name: (run / name).read_bytes() for name in TABLES} == before


def test_a_table_that_is_a_pipe_is_not_waited_for(run, capsys):
    (run / "cells.parquet").unlink()
    os.mkfifo(run / "cells.parquet")
    assert main(["status", str(run)]) == 2
    assert "cells.parquet: no regular file" in capsys.readouterr().err


def test_without_a_manifest_another_configuration_takes_no_part_away(run):
    (run / "manifest.json").write_text("{")
    before = _entries(run)
    other = parse_config(SMALL | {"step_fraction": 1e-2})
    with pytest.raises(UserError, match=r"not JSON.*no part there is of this configuration"):
        run_sweep(other, run, resume=True, isolate=False, resolve=fakes.shifted)
    assert _entries(run) == before


def test_no_command_reads_a_table_that_was_cut(run, capsys):
    (run / "cells.parquet").write_bytes((run / "cells.parquet").read_bytes()[:300])
    for command in ("ladder", "figures", "table", "report"):
        assert main([command, str(run)]) == 2, command
        assert "cells.parquet: altered since it was written" in capsys.readouterr().err


def test_a_damaged_manifest_of_a_run_without_a_part_is_written_again(run):
    before = {name: (run / name).read_bytes() for name in TABLES}
    for path in (*run.glob("parts/0*"), *run.glob("*.parquet")):
        path.unlink()
    (run / "manifest.json").write_text("{")
    assert any("manifest.json: damaged, not JSON" in line for line in _resume(run))
    assert {name: (run / name).read_bytes() for name in TABLES} == before


def test_a_table_without_a_digest_is_an_error(run, capsys):
    manifest = RunFolder(run).manifest()
    del manifest["files"]["divergence.parquet"]
    (run / "manifest.json").write_text(json.dumps(manifest))
    assert main(["table", str(run)]) == 2
    assert "files: no digest of divergence.parquet; impact-xval run --resume" in capsys.readouterr().err


@pytest.mark.parametrize("lost", ["missing", "damaged"])
def test_a_run_is_continued_without_its_file_and_without_its_manifest(run, lost, monkeypatch, capsys):
    manifest, begun = run / "manifest.json", []
    whole = {path.name: path.read_bytes() for path in run.glob("*.parquet")}
    if lost == "missing":
        manifest.unlink()
    elif lost:
        manifest.write_text("{" if lost == "damaged" else '{"format": "impact-xval run, format 1"}')

    def resumed(config, root, **how):
        begun.append(config)
        return run_sweep(
            config, root, resume=True, isolate=False, resolve=fakes.shifted, present=how["present"]
        )

    monkeypatch.setattr(sweep, "run_sweep", resumed)
    assert main(["run", "--out", str(run), "--resume"]) == 0
    assert begun == [parse_config(SMALL)]
    assert {path.name: path.read_bytes() for path in run.glob("*.parquet")} == whole
    assert json.loads(manifest.read_text())["configuration"] == parse_config(SMALL).canonical()


def test_where_nothing_says_what_parts_are_of_they_stay(run, capsys):
    (run / "manifest.json").unlink()
    for content in (None, "{", "[]", '{"m1": -1}', '{"name": "x"}'):
        path = run / "parts/configuration.json"
        path.unlink() if content is None else path.write_text(content)
        before = _entries(run)
        assert main(["run", "--out", str(run), "--resume"]) == 2
        assert "no part there is of this configuration" in capsys.readouterr().err
        assert _entries(run) == before
