"""The search for the worst divergence finds a maximum that is known."""

import dataclasses
import math

import pyarrow.parquet as pq
import pytest

from impact_xval.compliant_baselines import get_solver
from impact_xval.experiments.commands.cli import main
from impact_xval.experiments.config.configuration import load_config, parse_config
from impact_xval.experiments.config.errors import InterruptedRunError, UserError
from impact_xval.experiments.presentation.pictures.search import write_figure
from impact_xval.experiments.sweep.designs import cells_of
from impact_xval.experiments.sweep.search import search_worst
from impact_xval.experiments.tables.store import RunFolder
from impact_xval.model import solve
from tests.experiments import fakes
from tests.experiments.fakes import Shifted

PEAK = (0.03, 1.3, 0.62, 0.88)


class Peaked(Shifted):
    """The model's answer, faster by a bell over the four parameters: D is largest, 0.5, at `PEAK`."""

    def solve_many(self, collisions, settings):
        outcomes = []
        for c in collisions:
            away = (
                math.log10(c.stiffness_ratio / PEAK[0]) / 6,
                math.log2(c.mass_ratio / PEAK[1]) / 2,
                (c.e1 - PEAK[2]) / 0.5,
                (c.e2 - PEAK[3]) / 0.5,
            )
            o = solve(c, path=settings.record_path)
            bell = 0.5 * math.exp(-4 * sum(x * x for x in away))
            outcomes.append(dataclasses.replace(o, solver=self.name, v1=o.v1 + bell, status="ok", reason=""))
        return outcomes


def peaked(name):
    return Peaked() if name == "mujoco" else get_solver(name)


def _config(**search):
    return parse_config(
        {
            "name": "peak",
            "scenario": "impact",
            "grazing_threshold": 0.0,
            "search": {"population": 24, "generations": 25, **search},
        }
    )


def test_it_finds_a_known_maximum(tmp_path):
    found = search_worst(_config(), tmp_path / "a", isolate=False, resolve=peaked)
    write_figure(RunFolder(tmp_path / "a"), _config(), found)
    worst = found.rows[0]
    assert worst["velocity_divergence"] == pytest.approx(0.5, rel=1e-3)
    assert math.log10(worst["stiffness_ratio"] / PEAK[0]) / 6 == pytest.approx(0, abs=0.03)
    assert worst["mass_ratio"] == pytest.approx(PEAK[1], rel=0.05)
    assert worst["e1"] == pytest.approx(PEAK[2], abs=0.02)
    assert worst["e2"] == pytest.approx(PEAK[3], abs=0.02)
    assert found.best == sorted(found.best)
    assert found.evaluated == pq.read_table(tmp_path / "a/evaluations.parquet").num_rows == 24 * 26
    assert [entry["status"] for entry in found.confirmed] == ["ok"] * 3
    # What it lists is a list of cells that a run takes.
    (tmp_path / "c.toml").write_text("cells = 'a/worst.csv'")
    cells = cells_of(load_config(tmp_path / "c.toml"))
    assert cells[0].stiffness_ratio == worst["stiffness_ratio"]
    for name in ("search.png", "search.pdf", "search.txt", "manifest.json"):
        assert (tmp_path / "a" / name).stat().st_size > 100


def test_a_stopped_search_takes_the_same_way_when_it_is_resumed(tmp_path):
    config = _config(generations=6)
    whole = search_worst(config, tmp_path / "whole", isolate=False, resolve=peaked)

    def stop(done, total, line):
        if done >= 24 * 3:
            raise KeyboardInterrupt

    with pytest.raises(InterruptedRunError, match="interrupted"):
        search_worst(config, tmp_path / "cut", isolate=False, resolve=peaked, progress=stop)
    before = {path: path.read_bytes() for path in (tmp_path / "cut/parts").glob("0*")}
    assert len(before) == 3
    again = search_worst(config, tmp_path / "cut", isolate=False, resume=True, resolve=peaked)
    assert again.rows == whole.rows
    assert all(path.read_bytes() == content for path, content in before.items())
    for name in ("evaluations.parquet", "worst.csv"):
        assert (tmp_path / "cut" / name).read_bytes() == (tmp_path / "whole" / name).read_bytes()


def test_grazing_cells_do_not_count(tmp_path):
    config = _config(generations=3).model_copy(update={"grazing_threshold": 0.1})
    found = search_worst(config, tmp_path / "a", isolate=False, resolve=peaked)
    assert found.marked > 0
    assert all(row["model_grazing_margin"] >= 0.1 for row in found.rows)


def test_a_solver_without_results_is_an_empty_search(tmp_path):
    found = search_worst(
        _config(solver="pybullet", generations=2), tmp_path / "a", isolate=False, resolve=fakes.shifted
    )
    assert (found.rows, found.confirmed) == ([], [])
    assert found.failed == found.evaluated
    assert (tmp_path / "a/worst.csv").read_text() == "stiffness_ratio,mass_ratio,e1,e2\n"


def test_mistakes_are_one_line(tmp_path, capsys):
    box = {"stiffness_ratio": 1.0, "mass_ratio": 1.0, "e1": 0.5, "e2": 0.5}
    with pytest.raises(UserError, match="every parameter is a number; legal: one range or more"):
        search_worst(_config(**box), tmp_path / "a", isolate=False)
    for text, expected in (
        ("[search]\nsolver = 'mujoko'", "'mujoko' is not a solver (did you mean 'mujoco'?)"),
        ("[search]\nsolver = 'state-transition'", "the model itself; legal: another solver"),
        ("[search]\npopulation = 3", "search.population = 3; legal: a whole number from 8"),
        ("[search]\ne1 = {linear = [0.5, 2]}", "search.e1 = 2; legal: from 0 to 1"),
    ):
        (tmp_path / "c.toml").write_text(text)
        assert main(["search", str(tmp_path / "c.toml"), "--out", str(tmp_path / "out")]) == 2
        error = capsys.readouterr().err
        assert expected in error, error
        assert error.count("\n") == 1
    assert not (tmp_path / "out").exists()
