"""What `impact-xval status` says of a run: while it runs, after it was stopped, and when it is complete."""

import functools
import json
import shlex

import pytest

from impact_xval.experiments.commands.cli import main
from impact_xval.experiments.config.configuration import parse_config
from impact_xval.experiments.config.errors import InterruptedRunError
from impact_xval.experiments.measures.summary import summarise
from impact_xval.experiments.sweep import run as sweep
from impact_xval.experiments.sweep.run import run_sweep
from impact_xval.experiments.sweep.status import Medians, status_of
from tests.experiments import fakes
from tests.experiments.conftest import SMALL


def test_status_while_it_runs_and_after(tmp_path, capsys):
    config = parse_config(SMALL)
    seen = []

    def look(done, total, line):
        if done:
            seen.append((done, status_of(tmp_path / "a")))

    run_sweep(config, tmp_path / "a", isolate=False, resolve=fakes.crashing, progress=look)
    assert list(dict.fromkeys(done for done, _ in seen)) == [4, 8, 12]
    for done, status in seen:
        assert status.state == "running"
        assert status.owner
        assert status.cells_done == done
        assert status.parts_done == done / 4
        assert sum(status.statuses["mujoco"].values()) == done
    final = status_of(tmp_path / "a")
    assert (final.state, final.cells_done, final.parts_done) == ("complete", 12, 3)
    assert final.statuses["mujoco"] == {"ok": 6, "crashed": 6}
    assert final.reasons[0][:2] == ("pybullet", "unavailable")
    assert ("mujoco", "crashed", "ZeroDivisionError: a bug of the engine | here", 6) in final.reasons
    assert final.seconds_left is None

    assert main(["status", str(tmp_path / "a")]) == 0
    text = capsys.readouterr().out
    assert "complete" in text
    assert "12 of 12 cells (100.0 %), 3 of 3 parts" in text
    assert "ZeroDivisionError: a bug of the engine | here" in text
    assert main(["status", str(tmp_path / "a"), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["statuses"]["mujoco"] == {"ok": 6, "crashed": 6}


def test_status_of_a_stopped_run_counts_what_is_damaged(tmp_path, capsys):
    with pytest.raises(InterruptedRunError):
        run_sweep(parse_config(SMALL), tmp_path / "a", isolate=False, resolve=fakes.interrupting)
    status = status_of(tmp_path / "a")
    assert (status.state, status.owner, status.cells_done, status.parts_done) == ("stopped", "", 8, 2)
    part = sorted((tmp_path / "a/parts").glob("0*"))[0]
    part.write_bytes(part.read_bytes()[:100])
    status = status_of(tmp_path / "a")
    assert (status.cells_done, status.parts_damaged) == (4, 1)
    assert main(["status", str(tmp_path / "a")]) == 0
    text = capsys.readouterr().out
    assert "1 parts are damaged" in text
    assert "to continue: impact-xval run" in text


def test_the_command_to_continue_can_be_pasted(tmp_path, capsys, monkeypatch):
    """As it stands, without the file of the configuration, from a folder whose name a shell would take apart."""
    root = tmp_path / "my *runs* _a_ & 'b' | $c"
    with pytest.raises(InterruptedRunError):
        run_sweep(parse_config(SMALL), root, isolate=False, resolve=fakes.interrupting)
    kept = {path.name: path.read_bytes() for path in (root / "parts").glob("0*")}
    assert main(["status", str(root)]) == 0
    (line,) = [line for line in capsys.readouterr().out.splitlines() if line.startswith("to continue: ")]
    program, *words = shlex.split(line.removeprefix("to continue: "))
    assert (program, words) == ("impact-xval", ["run", "--resume", "--out", str(root)])
    monkeypatch.setattr(
        sweep, "run_sweep", functools.partial(run_sweep, isolate=False, resolve=fakes.shifted)
    )
    assert main(words) == 0
    assert status_of(root).state == "complete"
    assert {path.name: path.read_bytes() for path in (root / "parts").glob("0*")}.items() >= kept.items()


def test_status_of_no_run_is_one_line(tmp_path, capsys):
    assert main(["status", str(tmp_path / "none")]) == 2
    assert main(["status", str(tmp_path)]) == 2
    (tmp_path / "manifest.json").write_text('{"format": "impact-xval run, format 1"}')
    assert main(["status", str(tmp_path)]) == 2
    error = capsys.readouterr().err
    assert "no such folder" in error
    assert "state: missing; legal: 'running'" in error


def test_medians_of_a_run_that_goes_on_end_as_those_of_its_summary(tmp_path):
    config = parse_config(SMALL | {"solvers": ["bistiffness", "mujoco", "pybullet"], "chunk_size": 6})
    medians, seen = Medians(config.solvers), {}

    def look(done, total, line):
        if total:
            seen.setdefault((done, tuple(n for *_, n, _ in medians.rows())), None)

    folder = run_sweep(
        config, tmp_path / "a", isolate=False, resolve=fakes.shifted, progress=look, on_rows=medians.add
    )
    assert next(iter(seen)) == (0, (6,))  # one solver's, of a chunk that the others are still to solve
    summary = summarise(folder)
    rows = {name: (n, median) for _, name, n, median in medians.rows()}
    assert set(rows) == {"bistiffness", "mujoco"}  # no cell has a result of pybullet's
    for name, found in rows.items():
        row = summary.get(name, "velocity_divergence")
        assert found == (row.n, row["median"])
