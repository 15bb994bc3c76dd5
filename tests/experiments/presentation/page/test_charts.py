"""The map of a page: the D that it shows of a tile is the true one, and it opens on whom the sentences tell of."""

import re

import pytest

from impact_xval.experiments.presentation.page.charts import FLOOR, charts
from impact_xval.experiments.presentation.page.headlines import cells_piece
from impact_xval.experiments.presentation.page.tiles import Tiles

#: One of them below the floor of the colours.
TRUE = {"mujoco": [0.2, 3e-7, None], "bistiffness": [7.7e-8, 0.0, 0.4]}


def tiles(medians):
    return Tiles(
        up=("mass_ratio",),
        across_labels=["0.5", "1", "2"],
        up_labels=["1"],
        across=[0, 1, 2],
        above=[0, 0, 0],
        medians=medians,
        cells=[4, 5, 6],
        n_cells=3,
    )


def columns(item):
    """Return the columns of the source of a map, of a chart as JSON."""
    found = {}

    def look(value):
        if isinstance(value, dict):
            if value.get("attributes", {}).get("name") == "tiles":
                found.update(value["attributes"]["data"]["entries"])
            for each in value.values():
                look(each)
        elif isinstance(value, list):
            for each in value:
                look(each)

    look(item)
    return found


@pytest.mark.parametrize(
    ("first", "opens"), [("mujoco", "mujoco"), (None, "bistiffness"), ("x", "bistiffness")]
)
def test_the_map_holds_the_true_d_of_every_solver(first, opens):
    laid = tiles(TRUE)
    drawn = charts(laid, ["state-transition", *TRUE], first)
    held = columns(drawn[0])
    for name, medians in {"shown": TRUE[opens], **{f"d {name}": ds for name, ds in TRUE.items()}}.items():
        assert [d if isinstance(d, float) else None for d in held[name]] == medians
    piece = str(cells_piece(laid, "", drawn, first))
    assert re.findall(r"<option selected>(.*?)</option>", piece) == [opens]
    assert f"one colour for all up to {FLOOR:g}" in piece
    assert f'data-first="{4 if opens == "mujoco" else 6}"' in piece


def test_without_anything_compared_there_is_no_map_to_click():
    laid = tiles({"mujoco": [None] * 3})
    piece = str(cells_piece(laid, "", charts(laid, ["state-transition", "mujoco"])))
    assert 'id="solver"' not in piece
    assert "click it" not in piece
    assert 'data-cell="4"' in piece
