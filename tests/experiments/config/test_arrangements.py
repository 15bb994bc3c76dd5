"""Arrangements are the columns that one would write by hand."""

from impact_xval.experiments.config.arrangements import Arranged
from impact_xval.model import Collision

UNIT = {"m": 1.0, "k": 1.0, "e": 0.9}


def test_each_arrangement_is_the_column_written_by_hand():
    cradle = Collision((1,) * 5, (1,) * 4, (0.9,) * 4, (-1, -1, 0, 0, 0))
    for given, column in (
        (
            {"arrangement": "chain", "balls": 3},
            Collision((1, 1, 1), (1, 1), (0.9, 0.9), (-1, 0, 0)),
        ),
        (
            {"arrangement": "cradle", "balls": 3},
            Collision((1, 1, 1), (1, 1), (0.9, 0.9), (-1, 0, 0)),
        ),
        ({"arrangement": "cradle", "balls": 5, "strike": 2}, cradle),
        (
            {"arrangement": "drop", "balls": 3},
            Collision((1, 1, 1), (1, 1, 1), (0.9,) * 3, (-1, 0, 0), table=True),
        ),
        (
            {"arrangement": "stack", "balls": 3},
            Collision((1, 1, 1), (1, 1, 1), (0.9,) * 3, (-1, -1, -1), table=True),
        ),
        ({"arrangement": "stack", "balls": 1}, Collision((1,), (1,), (0.9,), (-1,), table=True)),
    ):
        assert Arranged(**UNIT | given).column() == column, given


def test_masses_and_stiffnesses_taper_from_the_first():
    tapered = Arranged(
        arrangement="drop", balls=3, m=2.0, mass_taper=0.5, k=3.0, stiffness_taper=10, e=1, v0=-4.0
    )
    assert tapered.column() == Collision((2, 1, 0.5), (3, 30, 300), (1, 1, 1), (-4, 0, 0), table=True)


def test_every_contact_but_the_struck_one_has_the_gap():
    for given, gaps in (
        ({"arrangement": "chain", "balls": 4}, (0, 1e-5, 1e-5)),
        ({"arrangement": "cradle", "balls": 4, "strike": 2}, (1e-5, 0, 1e-5)),
        ({"arrangement": "drop", "balls": 3}, (0, 1e-5, 1e-5)),
        ({"arrangement": "stack", "balls": 3}, (1e-5, 1e-5, 0)),
    ):
        column = Arranged(**given, gap=1e-5).column()
        assert column.gaps == gaps, given
        assert [rate > 0 for rate in column.compression_rates] == [gap == 0 for gap in gaps], given
