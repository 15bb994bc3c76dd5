"""The map of a run with tiles: which colours they have, and which cell a tile opens."""

import pandas as pd
import pytest

from impact_xval.experiments.measures.summary import load_divergence
from impact_xval.experiments.presentation.page.charts import TILES, make_tiles
from impact_xval.experiments.tables.folder import finished_run
from tests.experiments.conftest import swept


def tiles(root, **config):
    """Return the tiles of a run and its table of divergences; with a configuration, run it with exact solvers first."""
    if config:
        swept(root, solvers=["kelvin-voigt", "bistiffness"], chunk_size=None, **config)
    folder = finished_run(root)
    return make_tiles(load_divergence(folder, folder.config())), pd.read_parquet(root / "divergence.parquet")


def test_a_tile_of_a_grid_is_a_cell(engine_run):
    found, table = tiles(engine_run)
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


def test_a_tile_of_chains_is_a_chain(chain_run):
    found, _ = tiles(chain_run)
    assert (found.along, found.up) == ("balls", ("arrangement", "e", "exponent"))
    assert sorted(found.places.cell) == list(range(24))


def test_scattered_cells_share_tiles_of_bins(tmp_path):
    found, table = tiles(tmp_path / "run", grid=None, sample={"n": 2400, "seed": 1})
    assert len(found.places) <= TILES < table.cell.nunique() == 2400
    assert not found.places.duplicated(["across", "above"]).any()
    worst = table.loc[table[table.marked.isna()].velocity_divergence.idxmax()]
    (tile,) = found.places[found.places.cell == worst.cell].itertuples()  # the tile that opens the worst cell
    assert float(tile.column) == pytest.approx(worst.stiffness_ratio, rel=0.6)


def test_the_colour_of_a_shared_tile_is_the_median(tmp_path):
    ratios = {"stiffness_ratio": {"log": [0.01, 100, 24]}, "mass_ratio": {"log": [0.3, 3, 24]}}
    found, table = tiles(tmp_path / "run", grid=ratios | {"e1": [0.5, 0.7, 0.9], "e2": [0.7]})
    assert len(found.places) == 24 * 24
    regular, axes = table[table.marked.isna()], ["stiffness_ratio", "mass_ratio"]
    places = table.drop_duplicates("cell").set_index("cell").loc[found.places.cell, axes]
    for name, medians in found.medians.items():
        expected = regular[regular.solver == name].groupby(axes).velocity_divergence.median()
        expected = expected.reindex(pd.MultiIndex.from_frame(places))
        assert medians.tolist() == pytest.approx(expected.tolist(), nan_ok=True)
