"""Columns of an experiment: which there are, in which order, and what tells two experiments apart."""

import numpy as np

from impact_xval.experiments.config.cells import experiment_cells
from impact_xval.experiments.config.experiment import parse_config

AXES = {
    "arrangement": ["cradle", "drop"],
    "balls": [3, 4],
    "strike": [1, 2],
    "e": {"linear": [0.5, 1.0, 3]},
    "stiffness_taper": [1.0, 0.5],
    "gap": 0.0,
}


def _columns(**changed):
    return experiment_cells(parse_config({"column": AXES | changed}))


def test_an_arrangement_comes_after_the_other_and_e_varies_fastest():
    columns = _columns()
    assert len(columns) == 2 * 2 * 2 * 3 + 2 * 2 * 3
    block = columns.block(range(36))
    rows = dict(block.parameters)
    assert rows["arrangement"].tolist() == ["cradle"] * 24 + ["drop"] * 12
    names = ("balls", "strike", "stiffness_taper", "e")
    assert list(zip(*(rows[name][:4].tolist() for name in names), strict=True)) == [
        (3, 1, 1.0, 0.5),
        (3, 1, 1.0, 0.75),
        (3, 1, 1.0, 1.0),
        (3, 1, 0.5, 0.5),
    ]
    assert rows["balls"][24::6].tolist() == [3, 4]
    assert np.isnan(rows["strike"][24:]).all()
    assert block.index.tolist() == list(range(36))
    part = columns.block(range(20, 30))
    assert list(part.collisions) == list(block.collisions[20:30]) == [columns[i] for i in range(20, 30)]
    assert all(
        (values == rows[name][20:30]).all() for name, values in part.parameters.items() if name != "strike"
    )


def test_a_column_has_the_scales_of_the_experiment():
    axes = {"arrangement": "drop", "mass_taper": 2, "stiffness_taper": 1, "balls": 3}
    column = experiment_cells(parse_config({"m1": 2.0, "k1": 3e6, "v0": -0.5, "column": axes}))[1]
    assert column.masses == (2.0, 4.0, 8.0)
    assert (column.stiffnesses, column.velocities) == ((3e6,) * 3, (-0.5, 0.0, 0.0))
    assert column.table


def test_a_number_is_an_axis_of_one_value_and_a_list_is_as_its_range():
    plain = parse_config({"column": AXES})
    other = parse_config({"column": AXES | {"gap": [0], "e": [0.5, 0.75, 1]}, "name": "x", "workers": 3})
    assert plain.identity() == other.identity()
    for changed in ({"strike": 1}, {"arrangement": ["drop", "cradle"]}, {"gap": 1e-300}):
        assert plain.identity() != parse_config({"column": AXES | changed}).identity()
    assert plain.identity() == parse_config({"column": AXES, "figure_column": {"balls": 7}}).identity()
