"""Folders of runs: those of another version, and what is left of a run that was refused."""

import json

import pyarrow.parquet as pq
import pytest

from impact_xval.experiments.commands.cli import main
from impact_xval.experiments.config.errors import UserError
from impact_xval.experiments.sweep.run import run_sweep
from impact_xval.experiments.tables.folders import discard, missing, open_folder
from impact_xval.experiments.tables.schema import CELLS_SCHEMA
from tests.experiments import fakes


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

    del manifest["files"]
    (root / "manifest.json").write_text(json.dumps(manifest))
    table = pq.read_table(root / "cells.parquet")
    pq.write_table(table.drop_columns(["marked"]), root / "cells.parquet")
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
