"""Every example runs, and its printed numbers are right."""

import json
import re
import runpy
import sys

import pytest

from impact_xval.experiments.config.experiment import load_config, parse_config
from impact_xval.experiments.sweep.run import run_sweep
from impact_xval.experiments.tables.folder import RunFolder
from tests.test_project import ROOT

EXAMPLES = ROOT / "examples"


@pytest.fixture
def run(monkeypatch, capsys):
    def run(name, *arguments):
        monkeypatch.setattr(sys, "argv", [name, *map(str, arguments)])
        runpy.run_path(str(EXAMPLES / name), run_name="__main__")
        return capsys.readouterr().out

    return run


def test_the_supplement_s_limits_are_exact_and_its_integrations_near(run):
    rows = re.findall(r"^(inf|40|0|1/40) +(.*)$", run("supplement.py"), re.M)
    for name, text in rows:
        v1, exact1, v2, exact2 = map(float, text.split()[:4])
        bears = {"40": 6e-4, "1/40": 5e-3}.get(name, 0.0)
        assert max(abs(v1 - exact1), abs(v2 - exact2)) <= bears + 1e-9, name
    assert [name for name, _ in rows] == ["inf", "40", "0", "1/40"]


def test_a_cradle_by_every_solver(run):
    said = run("cradle.py", "state-transition", "bistiffness", "mujoco")
    D = dict(re.findall(r"^(\S+?),? .*  D = (\S+)$", said.replace(", Hertz", "-hertz"), re.M))
    assert float(D["state-transition"]) == 0
    assert float(D["bistiffness"]) < 1e-4
    assert 0 < float(D["mujoco"]) < 0.2
    assert float(D["state-transition-hertz"]) == pytest.approx(0.1408, abs=1e-3)


def test_contact_graphs(run):
    corner = [line.split() for line in run("graph_corner.py").splitlines()]
    right_angles = {tuple(row[2:4]) for row in corner if row[0] == "90"}
    assert right_angles == {("0.70000", "0.27000")}  # the result is the same for all stiffnesses
    assert len({tuple(row[2:4]) for row in corner}) == 7
    box = [tuple(map(float, line.split())) for line in run("graph_box.py").splitlines()]
    assert all((turning == 0) == (ratio == 1 or inertia == 1) for inertia, ratio, _, turning in box)
    *balls, end = run("graph_rack.py", 6).splitlines()
    assert sum(float(ball.split()[2]) for ball in balls) == pytest.approx(1, abs=1e-4)
    assert end.startswith("10 contacts")


def test_a_run_of_contact_graphs_is_legal():
    config = load_config(EXAMPLES / "graphs.toml")
    assert config.size().startswith("168 graphs; values on each axis: 4 of name, 9 of stiffness_ratio")


def test_a_run_is_read_in_three_ways_that_agree(run, tmp_path, monkeypatch):
    grid = {"stiffness_ratio": [0.5, 1.0, 2.0], "mass_ratio": [1.0, 1.5], "e1": [0.9], "e2": [0.7]}
    solvers = ["bistiffness", "kelvin-voigt"]
    config = parse_config({"scenario": "impact", "solvers": solvers, "grid": grid})
    run_sweep(config, tmp_path / "run", isolate=False)
    said = run("read_a_run.py", RunFolder(tmp_path / "run").root)
    for solver in solvers:
        medians = [float(text) for text in re.findall(rf"{solver}[ │]+(\d\.\d+)", said)]
        assert len(medians) == 3, said
        assert medians == pytest.approx([medians[0]] * 3, abs=1e-6)
    for name in ("xarray", "duckdb"):  # if a library is not installed, the rest is still printed
        monkeypatch.setitem(sys.modules, name, None)
    rest = run("read_a_run.py", tmp_path / "run")
    assert said.startswith(rest.partition("\nxarray")[0])
    assert rest.endswith(
        "\nxarray is not installed: pip install xarray\n\nduckdb is not installed: pip install duckdb\n"
    )


def test_a_map_of_few_collisions(run, tmp_path):
    run("trust_map.py", tmp_path / "map.png", 20)
    assert (tmp_path / "map.png").read_bytes()[1:4] == b"PNG"


def test_the_notebook_runs_from_the_top_and_holds_no_outputs():
    cells = json.loads((EXAMPLES / "first_ten_minutes.ipynb").read_text(encoding="utf-8"))["cells"]
    code = [cell for cell in cells if cell["cell_type"] == "code"]
    assert not any(cell["outputs"] or cell["execution_count"] for cell in code)
    names = {}
    for cell in code:
        exec("".join(cell["source"]), names)
    assert names["compared"]._repr_html_()
    assert names["outcome"].states == ("S1", "S3", "S1", "S2", "S4")
