"""Cells that are no grid: sampled from a box, or listed in a file."""

import math

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from scipy.stats import qmc

from impact_xval.experiments.commands.cli import main
from impact_xval.experiments.config.axes import AXES, Sample
from impact_xval.experiments.config.configuration import from_canonical, load_config, parse_config
from impact_xval.experiments.config.errors import UserError
from impact_xval.experiments.config.grid import CellGrid
from impact_xval.experiments.measures.levels import levels_of
from impact_xval.experiments.measures.summary import summarise
from impact_xval.experiments.presentation.report import write_tables
from impact_xval.experiments.sweep.designs import cells_of, draw, read_cells
from impact_xval.experiments.sweep.run import run_sweep
from tests.experiments import fakes

BOX = {
    "stiffness_ratio": {"log": [0.1, 10.0]},
    "mass_ratio": {"linear": [0.5, 2.0]},
    "e1": 0.9,
    "e2": {"linear": [0, 1]},
}


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
    assert high[0] > 8
    assert low[3] < 0.02
    # Evenly in the logarithm: half of the stiffness ratios lie below 1, not below the middle of [0.1, 10].
    assert np.mean(cells[:, 0] < 1) == pytest.approx(0.5, abs=0.07)


def test_sobol_points_are_spread_better_than_independent_ones():
    """Their centred discrepancy, by scipy's own measure, is several times smaller."""

    def discrepancy(method):
        cells = draw(Sample.model_validate({"method": method, "n": 256, "seed": 1, **BOX}))
        unit = np.column_stack(
            [np.log10(cells[:, 0]) / 2 + 0.5, (cells[:, 1] - 0.5) / 1.5, np.clip(cells[:, 3], 0, 1)]
        )
        return qmc.discrepancy(np.clip(unit, 0, 1))

    assert discrepancy("sobol") < discrepancy("random") / 5


def test_a_shorter_sample_is_the_beginning_of_a_longer_one():
    longer, shorter = (draw(Sample.model_validate({"n": n, "seed": 5, **BOX})) for n in (100, 70))
    assert np.array_equal(longer[:70], shorter)


@pytest.mark.parametrize("range_", [{"log": [1e-160, 1e160]}, {"log": [1e-300, 1e300]}])
def test_points_are_even_in_the_logarithm_where_the_quotient_of_the_ends_overflows(range_):
    low, high = map(math.log10, range_["log"])
    box = Sample.model_validate({**BOX, "stiffness_ratio": range_, "mass_ratio": 1.0, "e2": 1.0})
    share = np.linspace(0, 1, 9)
    ratios = box.place(share[:, None])[:, 0]
    assert np.log10(ratios) == pytest.approx(low + (high - low) * share, rel=1e-14, abs=1e-12)
    assert [ratios[0], ratios[-1]] == pytest.approx(range_["log"], rel=1e-12)
    assert np.all((ratios >= range_["log"][0]) & (ratios <= range_["log"][1]))


def test_the_points_of_an_ordinary_range_are_the_same_to_the_last_bit():
    """They are part of the identity of every sampled run."""
    share = np.random.default_rng(0).random(1000)
    for lo, hi in ((1e-3, 1e3), (0.1, 10.0), (1e-150, 1e150)):
        box = Sample.model_validate({**BOX, "stiffness_ratio": {"log": [lo, hi]}, "mass_ratio": 1, "e2": 1})
        expected = np.clip(lo * (hi / lo) ** share, lo, hi)
        assert np.array_equal(box.place(share[:, None])[:, 0], expected)


def test_the_built_in_grid_does_not_judge_a_sample_or_a_list(tmp_path):
    box = {"stiffness_ratio": {"log": [0.1, 10.0]}, "mass_ratio": 1.0}
    extreme = {"scenario": "impact", "k1": 1e306}
    assert len(cells_of(parse_config(extreme | {"sample": {"n": 8, **box}}))) == 8
    path = _write(tmp_path / "cells.csv", [[10.0, 1.0, 0.9, 0.7]])
    assert cells_of(parse_config(extreme | {"cells": str(path)}))[0].collision.k2 == 1e307
    for illegal in ({}, {"sample": {"n": 8, "stiffness_ratio": 1e3}}, {"search": {}}):
        with pytest.raises(UserError, match=r"stiffness_ratio = .* leaves double precision"):
            parse_config(extreme | illegal)


def test_the_gravity_number_of_a_list_is_within_double_precision(tmp_path, capsys):
    path = _write(tmp_path / "cells.csv", [[1.0, 1.0, 0.9, 0.7], [1.0, 1e-300, 0.9, 0.7]])
    (tmp_path / "c.toml").write_text(f"cells = '{path.name}'\nv0 = -1e200\ngravity = 1e-50\n")
    assert main(["run", str(tmp_path / "c.toml"), "--out", str(tmp_path / "out")]) == 2
    error = capsys.readouterr().err
    assert "cells.csv: row 2: v0 = -1e+200" in error
    assert "mass_ratio = 1e-300" in error
    assert "= 0.0 leaves double precision; legal: a finite number > 0" in error
    assert error.count("\n") == 1


def _write(path, values):
    if path.suffix == ".parquet":
        pq.write_table(pa.table(dict(zip(AXES, np.transpose(values), strict=True))), path)
    else:
        rows = [",".join([*AXES, "note"]), *(",".join([*map(repr, row), "x"]) for row in values)]
        path.write_text("\n".join(rows) + "\n")
    return path


@pytest.mark.parametrize("name", ["cells.csv", "cells.parquet"])
def test_a_list_is_read_to_the_last_bit_and_in_its_order(tmp_path, name):
    values = [
        [1 / 3, 0.7, 0.1, 1.0],
        [math.inf, 2.0, 0.0, 0.5],
        [0.0, 1e-3, 1.0, 0.0],
        [1 / 3, 0.7, 0.1, 1.0],
    ]
    path = _write(tmp_path / name, values)
    assert read_cells(path).tolist() == values
    (tmp_path / "c.toml").write_text(f"cells = '{name}'\nsolvers = ['mujoco']\nk1 = 2.0\n")
    cells = cells_of(load_config(tmp_path / "c.toml"))
    assert len(cells) == 4
    assert cells[0].collision.k2 == 2.0 / 3
    assert cells[0].stiffness_ratio == 1 / 3
    assert math.isinf(cells[1].collision.k2)


BAD_LISTS = {
    "missing column": ("stiffness_ratio,mass_ratio,e1\n1,1,1\n", ["column e2 is missing", "legal: columns"]),
    "empty": ("stiffness_ratio,mass_ratio,e1,e2\n", ["0 rows", "legal: 1 to"]),
    "text": ("stiffness_ratio,mass_ratio,e1,e2\n1,1,1,half\n", ["e2 is not a column of numbers"]),
    "hole": ("stiffness_ratio,mass_ratio,e1,e2\n1,1,1,1\n1,,1,1\n", ["row 2: mass_ratio is empty"]),
    "range": ("stiffness_ratio,mass_ratio,e1,e2\n1,1,1,1\n1,1,1.5,1\n", ["row 2: e1 = 1.5", "from 0 to 1"]),
    "nan": ("stiffness_ratio,mass_ratio,e1,e2\nnan,1,1,1\n", ["row 1: stiffness_ratio"]),
    "infinite mass": ("stiffness_ratio,mass_ratio,e1,e2\n1,inf,1,1\n", ["row 1: mass_ratio = inf"]),
    "overflow": ("stiffness_ratio,mass_ratio,e1,e2\n1e305,1,1,1\n", ["row 1: stiffness_ratio", "precision"]),
    "ragged": ("stiffness_ratio,mass_ratio,e1,e2\n1,1\n", ["cannot be read"]),
    "binary": ("\x00\x01\x02", ["cells.csv"]),
}


@pytest.mark.parametrize("case", BAD_LISTS)
def test_a_bad_list_is_one_line(case, tmp_path, capsys):
    text, expected = BAD_LISTS[case]
    (tmp_path / "cells.csv").write_text(text)
    (tmp_path / "c.toml").write_text("cells = 'cells.csv'")
    assert main(["run", str(tmp_path / "c.toml"), "--out", str(tmp_path / "out")]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    for each in expected:
        assert each in error
    assert not (tmp_path / "out").exists()


def test_a_file_that_is_no_parquet_or_not_there_is_one_line(tmp_path):
    with pytest.raises(UserError, match="no such file"):
        read_cells(tmp_path / "none.csv")
    (tmp_path / "x.parquet").write_bytes(b"PAR1 and no more")
    with pytest.raises(UserError, match="cannot be read"):
        read_cells(tmp_path / "x.parquet")


def test_one_design_at_a_time():
    with pytest.raises(UserError, match=r"grid and sample are given; legal: one of grid, sample, cells"):
        parse_config({"sample": {}, "grid": {"e1": [0.5]}})
    config = parse_config({"sample": {"n": 10}})
    assert from_canonical(config.canonical(), "test") == config
    assert isinstance(cells_of(parse_config({})), CellGrid)


def test_identity_knows_the_sample_and_not_the_place_of_a_list():
    def identity(**values):
        return parse_config(values).identity()

    assert identity(sample={"n": 10}) != identity(sample={"n": 10, "seed": 1}) != identity()
    assert identity(cells="a.csv") == identity(cells="elsewhere/b.csv")


def test_a_sampled_run_is_summarised_in_bins(tmp_path):
    config = parse_config(
        {"name": "sampled", "scenario": "impact", "solvers": ["mujoco"], "sample": {"n": 64, **BOX}}
    )
    folder = run_sweep(config, tmp_path / "a", isolate=False, resolve=fakes.shifted)
    summary = summarise(folder)
    bins = summary.statistics[
        (summary.statistics.axis == "stiffness_ratio") & (summary.statistics.measure == "velocity_divergence")
    ]
    whole = summary.get("mujoco", "velocity_divergence")
    assert bins.n.sum() == whole.n
    assert bins["max"].max() == whole["max"]
    assert len(bins) <= 12
    write_tables(folder)
    assert "in bins of k2/k1, named by their middle" in (folder.root / "summary.md").read_text()


def test_another_list_in_the_same_folder_is_computed_anew_and_said_so(tmp_path):
    _write(tmp_path / "cells.csv", [[1.0, 1.0, 0.9, 0.7], [2.0, 1.0, 0.9, 0.7]])
    (tmp_path / "c.toml").write_text("cells = 'cells.csv'\nsolvers = ['mujoco']\nchunk_size = 1\n")
    config = load_config(tmp_path / "c.toml")
    run_sweep(config, tmp_path / "a", isolate=False, resolve=fakes.shifted)
    _write(tmp_path / "cells.csv", [[1.0, 1.0, 0.9, 0.7], [3.0, 1.0, 0.9, 0.7]])
    said = []
    folder = run_sweep(
        config,
        tmp_path / "a",
        isolate=False,
        resume=True,
        resolve=fakes.shifted,
        progress=lambda done, total, line: said.append(line),
    )
    assert "part 1 belongs to another configuration or version: computed again" in said
    rows = pq.read_table(folder.root / "cells.parquet").to_pylist()
    assert [row["stiffness_ratio"] for row in rows] == [1.0, 1.0, 3.0, 3.0]


def test_levels_hold_every_value_once():
    rng = np.random.default_rng(1)
    x = np.concatenate([[0.0, math.inf, 0.0], 10 ** rng.uniform(-3, 3, 500)])
    levels = levels_of(x)
    codes = levels.codes(x)
    assert levels.values[0] == 0
    assert math.isinf(levels.values[-1])
    assert codes[:3].tolist() == [0, len(levels.values) - 1, 0]
    for code, value in zip(codes, x, strict=True):
        if 0 < value < math.inf:
            middle = levels.values[code]
            others = [v for v in levels.values[1:-1] if v != middle]
            # The middle of its own bin is the nearest in the logarithm.
            assert all(abs(math.log(value / middle)) <= abs(math.log(value / v)) + 1e-9 for v in others)
    few = levels_of(np.array([2.0, 1.0, 2.0]))
    assert few.values == [1.0, 2.0]
    assert few.codes(np.array([2.0, 1.0])).tolist() == [1, 0]
