"""The map of a run whose tiles open: what its colours are, and which cell a tile opens."""

import pandas as pd
import pytest

from impact_xval.experiments.config.experiment import parse_config
from impact_xval.experiments.measures.summary import load_divergence
from impact_xval.experiments.presentation.page.charts import TILES, tiles_of
from impact_xval.experiments.sweep.run import run_sweep
from impact_xval.experiments.tables.folder import RunFolder
from tests.experiments.conftest import SMALL


def tiles(root, **fields):
    """Run an experiment of exact solvers, and give its tiles and its table."""
    solvers = ["kelvin-voigt", "bistiffness"]
    given = SMALL | {"solvers": solvers, "chunk_size": 512} | fields
    config = parse_config({key: value for key, value in given.items() if value is not None})
    folder = RunFolder(root)
    run_sweep(config, root)
    return tiles_of(load_divergence(folder, config)), pd.read_parquet(root / "divergence.parquet")


def test_a_tile_of_a_grid_is_a_cell(tmp_path):
    found, table = tiles(tmp_path / "run")
    assert found.up == ("mass_ratio", "e1", "e2")
    assert sorted(found.places.cell) == list(range(12))
    for name, medians in found.medians.items():
        d = table[table.solver == name].set_index("cell").velocity_divergence
        assert medians.tolist() == d[found.places.cell].tolist()
    for tile in found.places.itertuples():
        row = table[table.cell == tile.cell].iloc[0]
        assert float(tile.column) == row.stiffness_ratio == [0.5, 1.0, 2.0][tile.across]
        assert [*map(float, tile.row.split(" · "))] == [row.mass_ratio, row.e1, row.e2]
    rows = found.places.drop_duplicates("above").sort_values("above").row
    assert rows.tolist() == sorted(rows)


def test_scattered_cells_share_tiles_of_bins(tmp_path):
    found, table = tiles(tmp_path / "run", solvers=["bistiffness"], grid=None, sample={"n": 2400, "seed": 1})
    assert len(found.places) <= TILES < len(table) == 2400
    assert not found.places.duplicated(["across", "above"]).any()
    regular = table[table.marked.isna() & table.velocity_divergence.notna()]
    worst = regular.loc[regular.velocity_divergence.idxmax()]
    (tile,) = found.places[found.places.cell == worst.cell].itertuples()  # it opens
    assert float(tile.column) == pytest.approx(worst.stiffness_ratio, rel=0.6)


def test_the_colour_of_a_shared_tile_is_the_median(tmp_path):
    ratios = {"stiffness_ratio": {"log": [0.01, 100, 24]}, "mass_ratio": {"log": [0.3, 3, 24]}}
    found, table = tiles(tmp_path / "run", grid=ratios | {"e1": [0.5, 0.7, 0.9], "e2": [0.7]})
    assert len(found.places) == 24 * 24
    table = table[table.marked.isna()]
    for name, medians in found.medians.items():
        of_tile = table[table.solver == name].groupby(["stiffness_ratio", "mass_ratio"]).velocity_divergence
        expected = of_tile.median().to_dict()  # of three cells; a marked one is left out
        places = table.drop_duplicates("cell").set_index("cell")[["stiffness_ratio", "mass_ratio"]]
        for at in (0, 100, 575):
            assert medians[at] == pytest.approx(expected[tuple(places.loc[found.places.cell[at]])])
