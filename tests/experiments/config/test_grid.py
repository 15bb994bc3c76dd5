"""Cells of two balls: which there are, in which order, and what tells two experiments apart."""

import json
import math

import pytest

from impact_xval.experiments.config.cells import experiment_cells
from impact_xval.experiments.config.experiment import REFERENCE, Config, from_canonical, parse_config


def test_cells_are_numbered_with_the_last_axis_fastest():
    axes = {"stiffness_ratio": [2, 1], "mass_ratio": [3.0], "e1": [0.1, 0.2], "e2": {"linear": [0, 1, 3]}}
    grid = experiment_cells(parse_config({"grid": axes, "chunk_size": 5}))
    block = grid.block(range(12))
    assert block.index.tolist() == list(range(12))
    assert [collision.e2 for collision in block[:4].collisions] == [0.0, 0.5, 1.0, 0.0]
    assert block.parameters["stiffness_ratio"].tolist() == [2.0] * 6 + [1.0] * 6
    assert grid.block(range(5, 9)).collisions[2] == grid[7] == block.collisions[7]
    assert [i for n in range(grid.chunks()) for i in grid.chunk(n)] == list(range(12))


def test_cells_carry_the_physical_scale():
    config = parse_config({"m1": 2.0, "k1": 1e6, "v0": -3.0, "grid": {"stiffness_ratio": [0, math.inf, 4]}})
    grid = experiment_cells(config)
    soft, rigid, stiff = (grid[i * len(grid) // 3] for i in range(3))
    assert (soft.k2, rigid.k2, stiff.k2) == (0.0, math.inf, 4e6)
    assert (stiff.m1, stiff.m2, stiff.v0) == (2.0, 1.0, -3.0)


def test_the_reference_leads_whatever_is_listed():
    assert parse_config({"solvers": ["pybullet", "mujoco"]}).solvers == [REFERENCE, "pybullet", "mujoco"]
    assert parse_config({"solvers": ["mujoco", REFERENCE]}).solvers == [REFERENCE, "mujoco"]


@pytest.mark.parametrize(
    "given",
    [
        {"stiffness_ratio_cutoff": math.inf, "grid": {"stiffness_ratio": [0, math.inf]}},
        {"sample": {"n": 10}},
        {"column": {"arrangement": ["cradle", "drop"], "e": {"linear": [0.5, 1.0, 3]}}},
    ],
    ids=["grid", "sample", "columns"],
)
def test_a_configuration_comes_back_from_json(given):
    config = parse_config(given)
    stored = json.loads(json.dumps(config.canonical(), allow_nan=False))
    assert from_canonical(stored, "here") == config


def test_identity_ignores_what_does_not_change_results():
    def identity(**changes) -> str:
        return Config.model_validate(changes).identity()

    base = identity()
    assert identity(name="other", workers=3, figure_cell={"e1": 0.5}) == base
    assert identity(grid={"mass_ratio": [0.5, 2 / math.sqrt(3), 2]}) == base
    assert identity(cells="a.csv") == identity(cells="elsewhere/b.csv")
    others = [
        identity(**change)
        for change in (
            {"step_fraction": 1e-2},
            {"grazing_threshold": 0.5},  # rows are marked by it
            {"scenario": "impact"},
            {"grid": {"e1": [0.5]}},
            {"chunk_size": 5},
            {"sample": {"n": 10}},
            {"sample": {"n": 10, "seed": 1}},
        )
    ]
    assert len({base, *others}) == 8
