import math

import pytest

from impact_xval.experiments.config.configuration import (
    REFERENCE,
    Config,
    from_canonical,
    load_config,
    parse_config,
)
from impact_xval.experiments.config.grid import CellGrid
from impact_xval.experiments.sweep.designs import cells_of


def test_built_in_experiment_is_the_one_described():
    config = parse_config({})
    grid = CellGrid(config)
    assert len(grid) == 624
    axes = config.grid.axes()
    assert axes["stiffness_ratio"][0] == 1e-3
    assert axes["stiffness_ratio"][-1] == 1e3
    assert axes["stiffness_ratio"][2::2] == [1e-2, 1e-1, 1.0, 10.0, 100.0, 1e3][0:6]
    assert axes["mass_ratio"] == [0.5, 2 / math.sqrt(3), 2.0]
    assert axes["e1"] == axes["e2"] == [0.5, 0.7, 0.9, 1.0]
    assert (config.scenario, config.gravity, config.m1, config.k1, config.v0) == (
        "drop",
        9.81,
        1.0,
        1e8,
        -1.0,
    )


def test_an_empty_file_is_the_built_in_experiment(tmp_path):
    path = tmp_path / "empty.toml"
    path.write_text("")
    assert load_config(path) == parse_config({})


def test_cells_are_numbered_with_the_last_axis_fastest():
    config = parse_config(
        {
            "grid": {
                "stiffness_ratio": [2, 1],
                "mass_ratio": [3.0],
                "e1": [0.1, 0.2],
                "e2": {"linear": [0, 1, 3]},
            }
        }
    )
    grid = CellGrid(config)
    cells = list(grid)
    assert [cell.index for cell in cells] == list(range(12))
    assert [cell.collision.e2 for cell in cells[:4]] == [0.0, 0.5, 1.0, 0.0]
    assert [cell.stiffness_ratio for cell in cells] == [2.0] * 6 + [1.0] * 6
    assert cells[7].collision == grid[7].collision
    with pytest.raises(IndexError, match="12"):
        grid[12]


def test_cells_carry_the_physical_scale():
    config = parse_config({"m1": 2.0, "k1": 1e6, "v0": -3.0, "grid": {"stiffness_ratio": [0, math.inf, 4]}})
    grid = CellGrid(config)
    soft, rigid, stiff = (grid[i * len(grid) // 3].collision for i in range(3))
    assert (soft.k2, rigid.k2, stiff.k2) == (0.0, math.inf, 4e6)
    assert (stiff.m1, stiff.m2, stiff.v0) == (2.0, 1.0, -3.0)


def test_chunks_cover_every_cell_once():
    config = parse_config({"chunk_size": 7, "grid": {"stiffness_ratio": [1, 2, 3]}})
    grid = CellGrid(config)
    assert [i for n in range(grid.chunks()) for i in grid.chunk(n)] == list(range(len(grid)))


@pytest.mark.parametrize(
    ("solvers", "cells", "size"),
    [
        (["mujoco"], 1000, 16),
        (["bistiffness"], 1000, 16),
        (["bistiffness", "kelvin-voigt"], 10_000, 128),
        (["bistiffness", "mujoco"], 10_000, 16),
        (["bistiffness"], 2_000_000, 200),
        (["mujoco"], 1_000_000, 100),
    ],
)
def test_a_chunk_is_about_as_much_work_whatever_the_solvers(solvers, cells, size):
    config = parse_config({"solvers": solvers, "sample": {"n": cells, "method": "random"}})
    assert cells_of(config).chunk_size == size


def test_the_reference_leads_whatever_is_listed():
    assert parse_config({"solvers": ["pybullet", "mujoco"]}).solvers == [REFERENCE, "pybullet", "mujoco"]
    assert parse_config({"solvers": ["mujoco", REFERENCE]}).solvers == [REFERENCE, "mujoco"]


def test_a_configuration_survives_its_plain_form():
    config = parse_config(
        {
            "name": "inf",
            "stiffness_ratio_cutoff": math.inf,
            "grid": {"stiffness_ratio": [0, math.inf], "e1": {"linear": [0, 1, 5]}},
        }
    )
    assert from_canonical(config.canonical(), "test") == config


def test_identity_ignores_what_does_not_change_results():
    def identity(**changes) -> str:
        return Config.model_validate(changes).identity()

    base = identity()
    assert identity(name="other", workers=3, figure_cell={"e1": 0.5}) == base
    assert identity(grid={"mass_ratio": [0.5, 2 / math.sqrt(3), 2]}) == base
    for change in (
        {"step_fraction": 1e-2},
        {"grazing_threshold": 0.5},  # rows are marked by it
        {"scenario": "impact"},
        {"grid": {"e1": [0.5]}},
        {"chunk_size": 5},
    ):
        assert identity(**change) != base
