"""Files and folders of a user that cannot be used are refused with one line, before any work is done."""

import errno
import json
import os
from pathlib import Path

import pyarrow as pa
import pytest

from impact_xval.experiments.tables.parquet import replacing, table_writer

CELL = "solve --stiffness-ratio 1 --mass-ratio 1 --e1 0.9 --e2 0.7 --solver kelvin-voigt"


@pytest.fixture
def read_only(monkeypatch):
    """Return a function that makes a folder count as not writable. Permissions alone do not stop root."""
    access, folders = os.access, []

    def asked(path, mode):
        return access(path, mode) and not (mode & os.W_OK and Path(path) in folders)

    monkeypatch.setattr(os, "access", asked)
    return folders.append


@pytest.mark.parametrize("suffix", ["png", "gif"])
def test_a_picture_into_a_read_only_folder(tmp_path, read_only, refused, suffix):
    (tmp_path / "ro").mkdir()
    read_only(tmp_path / "ro")
    words = [*CELL.split(), "--plot", tmp_path / "ro" / f"a.{suffix}"]
    refused(words, "--plot = ", f"the folder {tmp_path / 'ro'} cannot be written to")


@pytest.mark.parametrize(
    "only", [(), ("--only", "page"), ("--only", "tables"), ("--only", "figures"), ("--latex",)]
)
def test_a_report_of_a_read_only_run(run, read_only, refused, only):
    read_only(run)
    refused(["report", run, *only], f"{run}: the folder cannot be written to; legal: one that can")


def test_a_read_only_run_is_not_continued(run, read_only, refused):
    read_only(run)
    refused(["run", "--out", run], f"--out {run}: the folder cannot be written to")


def test_a_new_folder_that_is_read_only(tmp_path, read_only, refused):
    read_only(tmp_path)
    for words in (["report", "--supplement"], ["hypothesis", "--out"], ["scoreboard", "--out"]):
        refused([*words, tmp_path], f"{tmp_path}: the folder cannot be written to")


@pytest.mark.parametrize("code", [errno.EACCES, errno.EPERM, errno.EROFS], ids=errno.errorcode.get)
def test_a_file_that_may_not_be_written_is_told_by_its_own_name(run, monkeypatch, refused, code):
    """An error names the file that the user knows and not its temporary file, as with a read-only folder of figures."""
    opened = Path.open

    def open_path(path, *arguments, **how):
        if path.name.startswith(".tmp-"):
            raise OSError(code, os.strerror(code), str(path))
        return opened(path, *arguments, **how)

    monkeypatch.setattr(Path, "open", open_path)
    refused(["report", run, "--only", "tables"], f"{run / 'summary.csv'}: {os.strerror(code)}")
    with pytest.raises(OSError, match=r"a\.txt") as caught, replacing(run / "a.txt") as temporary:
        temporary.write_text("any")
    assert ".tmp-" not in str(caught.value)


def test_an_error_of_arrow_names_the_table_and_not_its_temporary_file(tmp_path):
    table = table_writer(tmp_path / "no folder" / "a.parquet", pa.schema([("a", pa.int64())]))
    with pytest.raises(FileNotFoundError, match=r"No such file.*a\.parquet") as caught, table:
        raise AssertionError("it was opened")
    assert ".tmp-" not in str(caught.value)


@pytest.mark.parametrize("text", ["", "\n", "# all as built in\n"], ids=["empty", "a line", "a remark"])
@pytest.mark.parametrize("command", ["run", "hypothesis"])
def test_a_file_without_a_key_starts_nothing(tmp_path, refused, command, text):
    (tmp_path / "empty.toml").write_text(text)
    words = [command, tmp_path / "empty.toml", "--out", tmp_path / "out"]
    refused(words, "empty.toml: empty", f"needs no file: impact-xval {command}")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("text", [b"{", b"[1]", b"\xff", b"[" * 100_000, b'{"D": 1}'])
def test_damaged_captions_are_written_again(run, command, text):
    path = run / "figures/captions.json"
    path.parent.mkdir()
    path.write_bytes(text)
    command(["report", run, "--only", "page"])
    captions = json.loads(path.read_text(encoding="utf-8"))
    assert captions
    assert all((path.parent / f"{name}.svg").is_file() for name in captions)
