"""What `impact-xval show` says of a run while it runs, after it was stopped, and when it is complete."""

import functools
import json
import shlex

import pytest

from impact_xval.experiments.config.errors import InterruptedRunError
from impact_xval.experiments.config.experiment import parse_config
from impact_xval.experiments.sweep import run as sweep
from impact_xval.experiments.sweep.run import run_sweep
from impact_xval.experiments.sweep.status import status_of
from tests.experiments import fakes
from tests.experiments.conftest import SMALL


def test_status_while_it_runs_and_after(tmp_path, command, refused):
    seen = []

    def look(done, total, line):
        if done:
            seen.append((done, status_of(tmp_path / "a")))

    run_sweep(parse_config(SMALL), tmp_path / "a", isolate=False, resolve=fakes.crashing, progress=look)
    assert list(dict.fromkeys(done for done, _ in seen)) == [4, 8, 12]
    for done, status in seen:
        assert (status.state, status.cells_done, status.parts_done) == ("running", done, done / 4)
        assert sum(status.statuses["mujoco"].values()) == done
    final = status_of(tmp_path / "a")
    assert (final.state, final.cells_done, final.parts_done) == ("complete", 12, 3)
    assert ("mujoco", "crashed", "ZeroDivisionError: a bug of the engine | here", 6) in final.reasons
    text = command(["show", tmp_path / "a"])
    assert "12 of 12 cells (100.0 %), 3 of 3 parts" in text
    assert "ZeroDivisionError: a bug of the engine | here" in text
    statuses = json.loads(command(["show", tmp_path / "a", "--json"]))["statuses"]
    assert statuses["mujoco"] == {"ok": 6, "crashed": 6}
    refused(["show", tmp_path / "a", "--cell", "999"], "--cell = 999")


def test_a_stopped_run_counts_what_is_damaged_and_its_command_to_continue_can_be_pasted(
    tmp_path, command, monkeypatch
):
    """A stopped run counts its damaged part, and the printed command continues it when it is pasted.

    The command has no file of the configuration. The folder's name has spaces, quotes and other characters of the
    shell.
    """
    root = tmp_path / "my *runs* _a_ & 'b' | $c"
    with pytest.raises(InterruptedRunError):
        run_sweep(parse_config(SMALL), root, isolate=False, resolve=fakes.interrupting)
    damaged, kept = sorted((root / "parts").glob("0*"))
    damaged.write_bytes(damaged.read_bytes()[:100])
    status = status_of(root)
    assert (status.state, status.cells_done, status.parts_done, status.parts_damaged) == ("stopped", 4, 1, 1)
    (line,) = [line for line in command(["show", root]).splitlines() if line.startswith("to continue: ")]
    program, *words = shlex.split(line.removeprefix("to continue: "))
    assert (program, words) == ("impact-xval", ["run", "--out", str(root)])
    begun = functools.partial(run_sweep, isolate=False, resolve=fakes.shifted)
    monkeypatch.setattr(sweep, "run_sweep", begun)
    before = kept.stat().st_mtime_ns
    command(words)
    assert status_of(root).state == "complete"
    assert kept.stat().st_mtime_ns == before
