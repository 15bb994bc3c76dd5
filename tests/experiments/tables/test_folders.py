"""Folders of runs: those of another version, and what is damaged in one."""

import json

import pytest

from impact_xval.experiments.commands.cli import main
from impact_xval.experiments.config.errors import UserError
from impact_xval.experiments.config.experiment import parse_config
from impact_xval.experiments.sweep.run import run_sweep
from impact_xval.experiments.tables.store import RunFolder
from tests.experiments import fakes
from tests.experiments.conftest import SMALL, resumed, tables_of


def _entries(root):
    return {
        str(path.relative_to(root)): path.read_bytes()
        for path in sorted(root.rglob("*"))
        if path.is_file() and not path.name.startswith(".lock")
    }


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
    resumed(parse_config(SMALL), run)
    assert all((run / name).read_text() == "mine" for name in names)


@pytest.mark.parametrize(
    "harm",
    [lambda path: path.unlink(), lambda path: path.write_bytes(path.read_bytes()[:300])],
    ids=["missing", "cut"],
)
def test_a_damaged_manifest_strands_no_part(run, harm, capsys):
    before = tables_of(run)
    harm(run / "manifest.json")
    assert main(["table", str(run)]) == 2
    assert capsys.readouterr().err.count("\n") == 1
    said = resumed(parse_config(SMALL), run)
    assert any("manifest.json" in line and "it is written now" in line for line in said)
    assert any("3 of 3 parts are there and whole" in line for line in said)
    assert tables_of(run) == before
    assert main(["status", str(run)]) == 0


def test_without_a_manifest_another_configuration_takes_no_part_away(run):
    (run / "manifest.json").write_text("{")
    before = _entries(run)
    other = parse_config(SMALL | {"step_fraction": 1e-2})
    with pytest.raises(UserError, match=r"not JSON.*no part there is of this configuration"):
        run_sweep(other, run, isolate=False, resolve=fakes.shifted)
    assert _entries(run) == before
