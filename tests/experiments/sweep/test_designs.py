"""Cells that are no grid: sampled from a box, or listed in a file."""

import math

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from scipy.stats import qmc

from impact_xval.experiments.commands.cli import main
from impact_xval.experiments.config.axes import AXES, Sample
from impact_xval.experiments.config.cells import draw, experiment_cells, read_cells
from impact_xval.experiments.config.errors import UserError
from impact_xval.experiments.config.experiment import load_config, parse_config
from impact_xval.experiments.measures.summary import summarise
from impact_xval.experiments.sweep.run import run_sweep
from tests.experiments import fakes
from tests.experiments.conftest import resumed

RATIOS = {"stiffness_ratio": {"log": [0.1, 10.0]}, "mass_ratio": {"linear": [0.5, 2.0]}}
BOX = RATIOS | {"e1": 0.9, "e2": {"linear": [0, 1]}}


@pytest.mark.parametrize("method", ["sobol", "latin-hypercube", "random"])
def test_samples_fill_the_box_and_follow_their_seed(method):
    def points(seed):
        return draw(Sample.model_validate({"method": method, "n": 500, "seed": seed, **BOX}))

    cells = points(3)
    assert cells.shape == (500, 4)
    assert np.array_equal(cells, points(3))
    assert not np.array_equal(cells, points(4))
    low, high = cells.min(axis=0), cells.max(axis=0)
    assert np.all(low >= [0.1, 0.5, 0.9, 0])
    assert np.all(high <= [10, 2, 0.9, 1])
    # Evenly in the logarithm: half of the stiffness ratios lie below 1, not below the middle of [0.1, 10].
    assert np.mean(cells[:, 0] < 1) == pytest.approx(0.5, abs=0.07)


def test_sobol_points_are_spread_better_than_independent_ones():
    """Their centred discrepancy, by scipy's own measure, is several times smaller."""

    def discrepancy(method):
        cells = draw(Sample.model_validate({"method": method, "n": 256, "seed": 1, **BOX}))
        unit = [np.log10(cells[:, 0]) / 2 + 0.5, (cells[:, 1] - 0.5) / 1.5, cells[:, 3]]
        return qmc.discrepancy(np.clip(np.column_stack(unit), 0, 1))

    assert discrepancy("sobol") < discrepancy("random") / 5


def test_a_shorter_sample_is_the_beginning_of_a_longer_one():
    longer, shorter = (draw(Sample.model_validate({"n": n, "seed": 5, **BOX})) for n in (100, 70))
    assert np.array_equal(longer[:70], shorter)


def _write(path, values):
    if path.suffix == ".parquet":
        pq.write_table(pa.table(dict(zip(AXES, np.transpose(values), strict=True))), path)
    else:
        rows = [",".join([*AXES, "note"]), *(",".join([*map(repr, row), "x"]) for row in values)]
        path.write_text("\n".join(rows) + "\n")
    return path


@pytest.mark.parametrize("name", ["cells.csv", "cells.parquet"])
def test_a_list_is_read_to_the_last_bit_and_in_its_order(tmp_path, name):
    values = [[1 / 3, 0.7, 0.1, 1.0], [math.inf, 2.0, 0.0, 0.5], [0.0, 1e-3, 1.0, 0.0]]
    path = _write(tmp_path / name, values)
    assert read_cells(path).tolist() == values
    (tmp_path / "c.toml").write_text(f"cells = '{name}'\nsolvers = ['mujoco']\nk1 = 2.0\n")
    cells = experiment_cells(load_config(tmp_path / "c.toml"))
    assert len(cells) == 3
    assert cells[0].k2 == 2.0 / 3
    assert cells[0].stiffness_ratio == 1 / 3
    assert math.isinf(cells[1].k2)


def test_a_bad_list_is_one_line(tmp_path, capsys):
    header = "stiffness_ratio,mass_ratio,e1,e2\n"
    (tmp_path / "c.toml").write_text("cells = 'cells.csv'")
    for text, expected in (
        (None, ["no such file"]),
        ("stiffness_ratio,mass_ratio,e1\n1,1,1\n", ["column e2 is missing", "legal: columns"]),
        (header, ["0 rows", "legal: 1 to"]),
        (header + "1,1,1,half\n", ["e2 is not a column of numbers"]),
        (header + "1,1,1,1\n1,,1,1\n", ["row 2: mass_ratio is empty"]),
        (header + "1,1,1,1\n1,1,1.5,1\n", ["row 2: e1 = 1.5", "from 0 to 1"]),
        (header + "1,inf,1,1\n", ["row 1: mass_ratio = inf"]),
        (header + "1e305,1,1,1\n", ["row 1: stiffness_ratio", "precision"]),
        (header + "1,1\n", ["cannot be read"]),
    ):
        if text is not None:
            (tmp_path / "cells.csv").write_text(text)
        assert main(["run", str(tmp_path / "c.toml"), "--out", str(tmp_path / "out")]) == 2, text
        error = capsys.readouterr().err
        assert error.count("\n") == 1, text
        assert all(each in error for each in expected), (text, error)
    assert not (tmp_path / "out").exists()
    (tmp_path / "x.parquet").write_bytes(b"PAR1 and no more")
    with pytest.raises(UserError, match="cannot be read"):
        read_cells(tmp_path / "x.parquet")


def test_a_sampled_run_is_summarised_in_bins(tmp_path):
    config = parse_config({"scenario": "impact", "solvers": ["mujoco"], "sample": {"n": 64, **BOX}})
    summary = summarise(run_sweep(config, tmp_path / "a", isolate=False, resolve=fakes.shifted))
    bins = summary.statistics[
        (summary.statistics.axis == "stiffness_ratio") & (summary.statistics.measure == "velocity_divergence")
    ]
    whole = summary.get("mujoco", "velocity_divergence")
    assert (bins.n.sum(), bins["max"].max()) == (whole.n, whole["max"])
    assert 1 < len(bins) <= 12


def test_another_list_in_the_same_folder_is_computed_anew_and_said_so(tmp_path):
    _write(tmp_path / "cells.csv", [[1.0, 1.0, 0.9, 0.7], [2.0, 1.0, 0.9, 0.7]])
    (tmp_path / "c.toml").write_text("cells = 'cells.csv'\nsolvers = ['mujoco']\nchunk_size = 1\n")
    config = load_config(tmp_path / "c.toml")
    run_sweep(config, tmp_path / "a", isolate=False, resolve=fakes.shifted)
    _write(tmp_path / "cells.csv", [[1.0, 1.0, 0.9, 0.7], [3.0, 1.0, 0.9, 0.7]])
    said = resumed(config, tmp_path / "a")
    assert any("resumed: 0 of 2 parts" in line for line in said)
    rows = pq.read_table(tmp_path / "a/cells.parquet").to_pylist()
    assert [row["stiffness_ratio"] for row in rows] == [1.0, 1.0, 3.0, 3.0]
