"""Cells of an experiment: their number and order, how they are written, and when two experiments are the same."""

import math

import numpy as np
import pandas as pd
import pytest
from scipy.stats import qmc

from impact_xval.experiments.config.arrangements import ChainSetup
from impact_xval.experiments.config.axes import AXES, Sample
from impact_xval.experiments.config.cells import collision_of, draw, experiment_cells, read_cells
from impact_xval.experiments.config.collision_options import parse_collision
from impact_xval.experiments.config.errors import UserError
from impact_xval.experiments.config.experiment import REFERENCE, Config, load_config, parse_config
from impact_xval.model import Collision
from tests.experiments.conftest import resumed

CHAINS = {
    "arrangement": ["cradle", "pile"],
    "balls": [3, 4],
    "strike": [1, 2],
    "e": {"linear": [0.5, 1.0, 3]},
    "stiffness_taper": [1.0, 0.5],
    "gap": 0.0,
}


def test_cells_are_numbered_with_the_last_axis_fastest_and_carry_the_scales():
    axes = {"stiffness_ratio": [2, 0], "mass_ratio": 3.0, "e1": [0.1, 0.2], "e2": {"linear": [0, 1, 3]}}
    scales = {"m1": 2.0, "k1": 1e6, "v0": -3.0}
    grid = experiment_cells(parse_config({"grid": axes, "chunk_size": 5} | scales))
    block = grid.block(range(12))
    assert block.index.tolist() == list(range(12))
    assert [collision.e2 for collision in block[:4].collisions] == [0.0, 0.5, 1.0, 0.0]
    assert block.parameters["stiffness_ratio"].tolist() == [2.0] * 6 + [0.0] * 6
    assert grid[0] == Collision.two_balls(m1=2.0, m2=6.0, k1=1e6, k2=2e6, e1=0.1, e2=0.0, v0=-3.0)
    assert grid[11] == Collision.two_balls(m1=2.0, m2=6.0, k1=1e6, k2=0.0, e1=0.2, e2=1.0, v0=-3.0)
    assert grid.block(range(5, 9)).collisions[2] == grid[7] == block.collisions[7]
    assert [i for n in range(grid.chunks()) for i in grid.chunk(n)] == list(range(12))


def test_restitutions_that_are_tied_are_equal_in_every_cell():
    axes = {"stiffness_ratio": [1.0, 2.0], "mass_ratio": [1.0]}
    config = parse_config({"grid": axes | {"e": [0.5, 0.9]}})
    cells = experiment_cells(config).block(range(4)).parameters
    assert set(cells) & {"e1", "e2", "e"} == {"e1", "e2"}
    assert cells["e1"].tolist() == cells["e2"].tolist() == [0.5, 0.9, 0.5, 0.9]
    assert config.identity() != parse_config({"grid": axes | {"e1": [0.5, 0.9], "e2": [0.5, 0.9]}}).identity()


def test_a_grid_in_si_units_holds_them_to_the_last_bit_and_ratios_follow():
    axes = {"k1": [1e4, 1e6], "k2": [0, 2e4, math.inf], "m1": [0.5], "m2": [0.1, 1, 10], "e": 0.9}
    config = parse_config({"grid": axes, "v0": -2.0})
    cells = experiment_cells(config)
    assert len(cells) == 18
    block = cells.block(range(18)).parameters
    assert block["k1"].tolist() == [1e4] * 9 + [1e6] * 9  # the first axis varies slowest
    assert block["m2"].tolist() == [0.1, 1.0, 10.0] * 6
    assert block["stiffness_ratio"][::3].tolist() == [0, 2, math.inf, 0, 0.02, math.inf]
    assert block["mass_ratio"][:3].tolist() == [0.2, 2.0, 20.0]
    assert cells[4] == Collision.two_balls(m1=0.5, m2=1.0, k1=1e4, k2=2e4, e1=0.9, e2=0.9, v0=-2.0)
    # the gravity number is g over |v0| sqrt(k1 (1/m1 + 1/m2))
    numbers = config.gravity_number(block["m2"], block["m1"], block["k1"])
    assert numbers[[1, 10]] == pytest.approx([9.81 / (2 * math.sqrt(3e4)), 9.81 / (2 * math.sqrt(3e6))])


def test_masses_and_stiffnesses_may_vary_beside_ratios():
    config = parse_config(
        {"grid": {"mass_ratio": [2.0], "stiffness_ratio": [3.0], "m1": [0.1, 7], "k1": 1e5, "e": 1}}
    )
    cells = experiment_cells(config)
    assert [cells[i].masses for i in (0, 1)] == [(0.1, 0.2), (7.0, 14.0)]
    assert cells[1].stiffnesses == (1e5, 3e5)
    # the grid's m1 is used and not the default scale, which is not in the grid
    assert collision_of(config, config.figure_cell).masses[0] == 0.1


def test_an_experiment_in_si_units_is_written_and_read_back(tmp_path):
    config = parse_config(
        {"grid": {"m1": [1, 2], "m2": [0.1, 1, 10], "k1": 1e5, "k2": [1e5, math.inf], "e": 1}}
    )
    (tmp_path / "a.toml").write_text(config.toml())
    again = load_config(tmp_path / "a.toml")
    assert again.identity() == config.identity() != parse_config({"grid": {"e": 1}}).identity()
    assert again.grid.varied() == config.grid.varied()
    assert "mass_ratio" not in config.toml().partition("[figure_cell]")[0]
    assert config.size() == "12 cells; values on each axis: 1 of k1, 2 of k2, 2 of m1, 3 of m2, 1 of e"


def test_chains_are_an_arrangement_after_the_other_with_e_fastest():
    chains = experiment_cells(parse_config({"chain": CHAINS}))
    assert len(chains) == 2 * 2 * 2 * 3 + 2 * 2 * 3
    rows = chains.block(range(36)).parameters
    assert rows["arrangement"].tolist() == ["cradle"] * 24 + ["pile"] * 12
    names = ("balls", "strike", "stiffness_taper", "e")
    first = list(zip(*(rows[name][:4].tolist() for name in names), strict=True))
    assert first == [(3, 1, 1.0, 0.5), (3, 1, 1.0, 0.75), (3, 1, 1.0, 1.0), (3, 1, 0.5, 0.5)]
    assert rows["balls"][24::6].tolist() == [3, 4]
    assert np.isnan(rows["strike"][24:]).all()


@pytest.mark.parametrize(
    ("given", "velocities", "gaps"),
    [
        (("row", 3), (-1, 0, 0), (0, 1e-5)),
        (("cradle", 3), (-1, 0, 0), (0, 1e-5)),
        (("cradle", 5, 2), (-1, -1, 0, 0, 0), (1e-5, 0, 1e-5, 1e-5)),
        (("pile", 3), (-1, 0, 0), (0, 1e-5, 1e-5)),
        (("stack", 3), (-1, -1, -1), (1e-5, 1e-5, 0)),
        (("stack", 1), (-1,), (0,)),
    ],
)
def test_an_arrangement_is_the_chain_written_by_hand(given, velocities, gaps):
    """An arrangement gives the chain written by hand, with gaps at all contacts except the one that is struck."""
    data = dict(zip(("arrangement", "balls", "strike"), given, strict=False))
    n, contacts, table = len(velocities), len(gaps), given[0] in ("pile", "stack")
    by_hand = Collision((1,) * n, (1,) * contacts, (0.9,) * contacts, velocities, table=table, gaps=gaps)
    assert ChainSetup(m=1.0, k=1.0, e=0.9, gap=1e-5, **data).collision() == by_hand
    assert [rate > 0 for rate in by_hand.compression_rates] == [gap == 0 for gap in gaps]


def _points(n, seed):
    ratios = {"stiffness_ratio": {"log": [0.1, 10.0]}, "mass_ratio": {"linear": [0.5, 2.0]}}
    return draw(Sample.model_validate({"n": n, "seed": seed, "e1": 0.9, "e2": {"linear": [0, 1]}} | ratios))


@pytest.mark.smoke
def test_samples_fill_the_box_follow_their_seed_and_begin_as_shorter_ones():
    cells = _points(500, 3)
    assert cells.shape == (500, 4)
    assert np.array_equal(cells[:70], _points(70, 3))
    assert not np.array_equal(cells, _points(500, 4))
    low, high = cells.min(axis=0), cells.max(axis=0)
    assert np.all(low >= [0.1, 0.5, 0.9, 0])
    assert np.all(high <= [10, 2, 0.9, 1])
    # The points are even in the logarithm: half of the stiffness ratios are below 1, not below the middle of [0.1, 10].
    assert np.mean(cells[:, 0] < 1) == pytest.approx(0.5, abs=0.07)
    # The points are spread better than independent ones: their centred discrepancy is less than a fifth.
    unit = np.column_stack([np.log10(cells[:, 0]) / 2 + 0.5, (cells[:, 1] - 0.5) / 1.5, cells[:, 3]])
    independent = np.random.default_rng(1).random(unit.shape)
    assert qmc.discrepancy(np.clip(unit, 0, 1)) < qmc.discrepancy(independent) / 5


def _write(path, values):
    frame = pd.DataFrame(values, columns=list(AXES)).assign(note="x")
    if path.suffix == ".parquet":
        frame.to_parquet(path)
    else:
        frame.to_csv(path, index=False)
    return path


@pytest.mark.parametrize("name", ["cells.csv", "cells.parquet"])
def test_a_list_is_read_to_the_last_bit_and_in_its_order(tmp_path, name):
    values = [[1 / 3, 0.7, 0.1, 1.0], [math.inf, 2.0, 0.0, 0.5], [0.0, 1e-3, 1.0, 0.0]]
    assert read_cells(_write(tmp_path / name, values)).tolist() == values
    (tmp_path / "c.toml").write_text(f"cells = '{name}'\nsolvers = ['mujoco']\nk1 = 2.0\n")
    cells = experiment_cells(load_config(tmp_path / "c.toml"))
    assert (len(cells), cells[0].k2, cells[0].stiffness_ratio, cells[1].k2) == (3, 2 / 3, 1 / 3, math.inf)


def test_another_list_in_the_same_folder_is_refused_and_the_tables_stay(tmp_path):
    """The name of the file has not changed, so the configuration is the same; the values of the cells are not."""
    (tmp_path / "c.toml").write_text("cells = 'cells.csv'\nsolvers = ['mujoco']\nchunk_size = 1\n")
    _write(tmp_path / "cells.csv", [[1.0, 1.0, 0.9, 0.7], [2.0, 1.0, 0.9, 0.7]])
    resumed(tmp_path / "a", load_config(tmp_path / "c.toml"))
    before = (tmp_path / "a/cells.parquet").read_bytes()
    _write(tmp_path / "cells.csv", [[1.0, 1.0, 0.9, 0.7], [3.0, 1.0, 0.9, 0.7]])
    with pytest.raises(UserError, match=r"holds a run of other cells than those of .*cells\.csv; legal: "):
        resumed(tmp_path / "a", load_config(tmp_path / "c.toml"))
    assert (tmp_path / "a/cells.parquet").read_bytes() == before


def test_the_reference_leads_whatever_is_listed():
    assert parse_config({"solvers": ["pybullet", "mujoco"]}).solvers == [REFERENCE, "pybullet", "mujoco"]
    assert parse_config({"solvers": ["mujoco", REFERENCE]}).solvers == [REFERENCE, "mujoco"]


def test_si_units_and_ratios_are_one_collision():
    cell = {"e1": "0.9", "e2": "0.7", "v0": "-3"}
    plain, _, _ = parse_collision(cell | {"stiffness_ratio": "40", "mass_ratio": str(2 / math.sqrt(3))})
    scaled, _, _ = parse_collision(
        cell | {"m1": "0.5", "m2": str(1 / math.sqrt(3)), "k1": "1e6", "k2": "4e7"}
    )
    assert scaled.masses == pytest.approx((0.5, 1 / math.sqrt(3)))
    assert scaled.stiffnesses == pytest.approx((1e6, 4e7))
    for same in ("stiffness_ratio", "mass_ratio", "restitutions", "velocities"):
        assert getattr(scaled, same) == pytest.approx(getattr(plain, same), rel=1e-15)


def test_identity_ignores_what_does_not_change_results():
    def identity(**changes) -> str:
        return Config.model_validate(changes).identity()

    base, chains = identity(), identity(chain=CHAINS)
    assert identity(name="other", workers=3, figure_cell={"e1": 0.5}) == base
    assert identity(grid={"mass_ratio": [0.5, 2 / math.sqrt(3), 2]}) == base
    assert identity(cells="a.csv") == identity(cells="elsewhere/b.csv")
    assert identity(chain=CHAINS | {"gap": [0], "e": [0.5, 0.75, 1]}, name="x", workers=3) == chains
    assert identity(chain=CHAINS, figure_chain={"balls": 7}) == chains
    others = [
        {"step_fraction": 1e-2},
        # the threshold decides which rows get a mark, a warning that the outcome is near a jump
        {"grazing_threshold": 0.5},
        {"scenario": "impact"},
        {"grid": {"e1": [0.5]}},
        {"chunk_size": 5},
        {"sample": {"n": 10}},
        {"sample": {"n": 10, "seed": 1}},
        {"chain": CHAINS | {"strike": 1}},
        {"chain": CHAINS | {"arrangement": ["pile", "cradle"]}},
        {"chain": CHAINS | {"gap": 1e-300}},
    ]
    assert len({base, chains, *(identity(**each) for each in others)}) == 2 + len(others)
