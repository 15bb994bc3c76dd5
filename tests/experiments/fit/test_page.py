"""The command: its files, hostile text, a run that is ended, and the file to fill in."""

import json
import os
import signal
import subprocess
import sys

import pytest

import impact_xval
from impact_xval.experiments.commands.cli import main
from impact_xval.experiments.fit import page
from tests.experiments.fit.planted import trials

HOSTILE = "<script>alert(1)</script>|**x**"


@pytest.fixture
def data(tmp_path):
    file = tmp_path / "drops.csv"
    frame = trials("sequential", [0.9, 0.7], noise=1).assign(group=["a"] * 3 + [HOSTILE] * 3, trial=HOSTILE)
    frame.to_csv(file, index=False)
    return file


def test_the_command_writes_its_folder(data, tmp_path, capsys):
    out = tmp_path / "out"
    laws = [word for name in ("sequential", "newton", "kelvin-voigt") for word in ("--law", name)]
    assert main(["fit", str(data), "--out", str(out), *laws]) == 0
    said = capsys.readouterr().out
    assert "sequential explains these data best" in said
    names = {path.name for path in out.iterdir()}
    tables = {"parameters.csv", "predictions.csv", "predictions.parquet", "evidence.csv"}
    assert names == {"fit.md", "fit.html", "fit.json", "figures", *tables}
    html = (out / "fit.html").read_text(encoding="utf-8")
    assert "<script>alert" not in html
    assert "&lt;script&gt;alert(1)&lt;/script&gt;|**x**" in html
    assert "mujoco" in html
    assert json.loads((out / "fit.json").read_text(encoding="utf-8"))["format"].startswith("impact-xval fit")
    assert not [path for path in tmp_path.iterdir() if path.name.startswith(".tmp")]
    assert main(["fit", str(data), "--out", str(out), *laws]) == 2
    assert "not empty" in capsys.readouterr().err


def test_what_another_process_still_writes_is_left_alone(data, tmp_path):
    out = tmp_path / "out"
    running, ended = (out / f".tmp-{process}-fit" for process in (os.getppid(), 2**30))
    for folder in (running, ended):
        folder.mkdir(parents=True)
    assert main(["fit", str(data), "--out", str(out), "--law", "newton"]) == 0
    assert running.exists()
    assert not ended.exists()


def test_a_fit_that_fails_leaves_nothing(data, tmp_path, monkeypatch):
    def fail(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(page, "write_json", fail)
    assert main(["fit", str(data), "--out", str(tmp_path / "out"), "--law", "newton"]) == 1
    assert [path.name for path in tmp_path.iterdir()] == ["drops.csv"]


@pytest.mark.skipif(sys.platform == "win32", reason="there is no SIGKILL")
def test_a_fit_that_is_killed_leaves_no_half_of_its_folder(data, tmp_path):
    """Killed while it writes its last file: what is there has another name."""
    script = (
        "import os, signal, sys\n"
        "from impact_xval.experiments.commands.cli import main\n"
        "from impact_xval.experiments.fit import page\n"
        "page.write_json = lambda *_: os.kill(os.getpid(), signal.SIGKILL)\n"
        "main(sys.argv[1:])\n"
    )
    out = tmp_path / "out"
    words = ["fit", str(data), "--out", str(out), "--law", "newton"]
    done = subprocess.run([sys.executable, "-c", script, *words], capture_output=True, check=False)
    assert done.returncode == -signal.SIGKILL
    assert all(path.name.startswith(".tmp-") for path in out.iterdir())
    assert main(words) == 0  # and may be used again
    assert not list(out.glob(".tmp-*"))


def test_a_folder_that_nothing_can_take_the_place_of_is_written_to(data, tmp_path, monkeypatch):
    """Such as the one that a shell stands in, or that another disk is mounted on."""
    out = tmp_path / "out"
    out.mkdir()
    inode = out.stat().st_ino
    monkeypatch.chdir(out)
    assert main(["fit", str(data), "--out", ".", "--law", "newton"]) == 0
    assert out.stat().st_ino == inode
    assert (out / "fit.html").is_file()


def test_what_comes_into_the_folder_meanwhile_is_left_alone(data, tmp_path, monkeypatch, capsys):
    out = tmp_path / "out"
    monkeypatch.setattr(page, "write_json", lambda *_: (out / "evidence.csv").write_text("mine"))
    assert main(["fit", str(data), "--out", str(out), "--law", "newton"]) == 2
    assert "evidence.csv came there meanwhile" in capsys.readouterr().err
    assert (out / "evidence.csv").read_text() == "mine"


def test_nothing_free_is_fitted_where_all_is_known(tmp_path, capsys):
    """Warnings are errors here: the figure of the laws has its law."""
    trials("poisson", [0.5, 0.8], noise=1).assign(e1=0.5, e2=0.8).to_csv(tmp_path / "known.csv", index=False)
    words = ["fit", str(tmp_path / "known.csv"), "--out", str(tmp_path / "out")]
    assert main([*words, "--law", "poisson", "--law", "sequential"]) == 0
    assert "poisson explains these data best" in capsys.readouterr().out


def test_a_notebook_shows_the_result(data):
    html = impact_xval.fit(data, ["newton", "sequential"])._repr_html_()
    assert "sequential explains these data best" in html
    assert "<table>" in html


def test_an_unknown_law_is_refused(data, tmp_path, capsys):
    assert main(["fit", str(data), "--law", "hooke", "--out", str(tmp_path / "out")]) == 2
    assert "law = 'hooke'; legal: state-transition" in capsys.readouterr().err


def test_the_file_to_fill_in_can_be_read(tmp_path, capsys):
    file = tmp_path / "mine.csv"
    assert main(["init-data", str(file)]) == 0
    assert main(["fit", str(file), "--out", str(tmp_path / "out")]) == 2
    assert "nothing is left to fit: it has no rows" in capsys.readouterr().err
    with file.open("a", encoding="utf-8") as stream:
        stream.write("drop 1,mine,0.1,0.2,-1.98,0.61,0.34,0.02,0.02\n")
    assert main(["fit", str(file), "--law", "poisson", "--out", str(tmp_path / "out")]) == 0
    assert main(["init-data", str(file)]) == 2
    assert "is there already" in capsys.readouterr().err
