"""Folders of runs: those of another version, and what is damaged in one."""

import hashlib
import json

import pytest

from impact_xval.experiments.commands.cli import main
from impact_xval.experiments.config.configuration import parse_config
from impact_xval.experiments.config.errors import UserError
from impact_xval.experiments.sweep import run as sweep
from impact_xval.experiments.sweep.run import run_sweep
from impact_xval.experiments.tables.folders import finished
from impact_xval.experiments.tables.store import TABLES, RunFolder
from tests.experiments import fakes
from tests.experiments.conftest import SMALL


def _entries(root):
    return {
        str(path.relative_to(root)): path.read_bytes()
        for path in sorted(root.rglob("*"))
        if path.is_file() and not path.name.startswith((".lock", ".owner"))
    }


def _tables(root):
    return {name: (root / name).read_bytes() for name in TABLES}


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


def test_a_run_of_another_version_is_refused_in_a_line_with_both(run, capsys):
    manifest = RunFolder(run).manifest()
    here = manifest["versions"]["impact-xval"]
    manifest["versions"]["impact-xval"] = "0.2.0"
    old = manifest | {"configuration": manifest["configuration"] | {"certificates": True}}
    (run / "manifest.json").write_text(json.dumps(old))
    assert main(["table", str(run)]) == 2
    error = capsys.readouterr().err
    assert f"(written by impact-xval 0.2.0, read by {here})" in error
    assert error.count("\n") == 1


def test_files_of_the_user_in_the_folder_stay(run):
    (run / "mine").mkdir()
    (run / "figures").mkdir(exist_ok=True)
    names = ("notes.txt", ".tmp-notes", "parts/.tmp-notes", "mine/cells.parquet", "figures/notes.txt")
    for name in names:
        (run / name).write_text("mine")
    _resume(run)
    assert all((run / name).read_text() == "mine" for name in names)


def test_the_folder_itself_may_be_behind_a_link(run, tmp_path):
    (tmp_path / "here").symlink_to(run)
    assert any("3 of 3 parts are there" in line for line in _resume(tmp_path / "here"))
    assert finished(tmp_path / "here").manifest()["state"] == "complete"


@pytest.mark.parametrize(
    "harm",
    [
        lambda path: path.unlink(),
        lambda path: path.write_bytes(b""),
        lambda path: path.write_bytes(path.read_bytes()[:300]),
        lambda path: path.write_text(path.read_text().replace('"chunks": 3', '"chunks": "three"')),
    ],
    ids=["missing", "empty", "cut", "altered"],
)
def test_a_damaged_manifest_strands_no_part(run, harm, capsys):
    before = _tables(run)
    harm(run / "manifest.json")
    assert main(["table", str(run)]) == 2
    assert capsys.readouterr().err.count("\n") == 1
    said = _resume(run)
    assert any("manifest.json" in line and "it is written now" in line for line in said)
    assert any("3 of 3 parts are there and whole" in line for line in said)
    assert _tables(run) == before
    assert main(["status", str(run)]) == 0


def test_the_rows_of_another_chunk_under_a_right_digest_are_computed_again(run):
    before = _tables(run)
    one, two, _ = sorted((run / "parts").glob("0*"))
    content = two.read_bytes()
    start, identity, _ = one.name.split("-")
    one.unlink()
    (run / f"parts/{start}-{identity}-{hashlib.sha256(content).hexdigest()}.parquet").write_bytes(content)
    assert "part 0 holds the rows of another: computed again" in _resume(run)
    assert _tables(run) == before


def test_without_a_manifest_another_configuration_takes_no_part_away(run):
    (run / "manifest.json").write_text("{")
    before = _entries(run)
    other = parse_config(SMALL | {"step_fraction": 1e-2})
    with pytest.raises(UserError, match=r"not JSON.*no part there is of this configuration"):
        run_sweep(other, run, resume=True, isolate=False, resolve=fakes.shifted)
    assert _entries(run) == before


def test_no_command_reads_a_table_that_was_cut(run, capsys):
    for name in ("divergence", "ladder"):
        (run / f"{name}.parquet").write_bytes((run / f"{name}.parquet").read_bytes()[:300])
    for command in ("ladder", "figures", "table", "report"):
        assert main([command, str(run)]) == 2, command
        assert ".parquet: altered since it was written" in capsys.readouterr().err


@pytest.mark.parametrize("lost", ["missing", "damaged"])
def test_a_run_is_continued_without_its_file_and_without_its_manifest(run, lost, monkeypatch):
    manifest, begun = run / "manifest.json", []
    whole = _tables(run)
    manifest.unlink() if lost == "missing" else manifest.write_text("{")

    def resumed(config, root, **how):
        begun.append(config)
        return run_sweep(
            config, root, resume=True, isolate=False, resolve=fakes.shifted, present=how["present"]
        )

    monkeypatch.setattr(sweep, "run_sweep", resumed)
    assert main(["run", "--out", str(run), "--resume"]) == 0
    assert begun == [parse_config(SMALL)]
    assert _tables(run) == whole
    assert json.loads(manifest.read_text())["configuration"] == parse_config(SMALL).canonical()


def test_where_nothing_says_what_parts_are_of_they_stay(run, capsys):
    (run / "manifest.json").unlink()
    for content in (None, "{", '{"m1": -1}'):
        path = run / "parts/configuration.json"
        path.unlink() if content is None else path.write_text(content)
        before = _entries(run)
        assert main(["run", "--out", str(run), "--resume"]) == 2
        assert "no part there is of this configuration" in capsys.readouterr().err
        assert _entries(run) == before
