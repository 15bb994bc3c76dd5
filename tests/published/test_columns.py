"""Columns that others have computed or measured, with the precision their numbers bear (docs/columns.md, section 5)."""

import json
from pathlib import Path

import numpy as np
import pytest

from impact_xval.model import Collision
from tests.model.columns import solved

LZB = "liu-zhao-brogliato"


def chain(balls, e=1.0, struck=1):
    """Build a chain of unit masses and stiffnesses, struck by its first balls at unit speed."""
    rest = balls - struck
    return Collision((1,) * balls, (1,) * (balls - 1), (e,) * (balls - 1), (-1,) * struck + (0,) * rest)


def stack(e):
    return Collision((1,) * 3, (1,) * 3, (e,) * 3, (-1,) * 3, table=True)


#: Siconos 4.4.0, MultipleImpact of kind BiStiffness with MultipleImpactNSL: the law of Liu, Zhao and Brogliato.
SICONOS = [
    (chain(3), 1, (0.130260, -0.150226, -0.980034), 2e-5),
    (chain(3, 0.9), 1, (0.065303, -0.167191, -0.898113), 2e-5),
    (chain(3), 1.5, (0.07095235, -0.07640304, -0.99454931), 6e-6),
    (chain(3, 0.9), 1.5, (0.008612, -0.104138, -0.904474), 6e-6),
    (chain(5), 1, (0.132278, 0.075328, 0.031013, -0.296214, -0.942404), 2e-5),
    (chain(5), 1.5, (0.071079, 0.030168, 0.014389, -0.126824, -0.988811), 2.3e-4),
    (stack(1.0), 1, (1.234241, 1.001447, 0.688302), 2e-5),
    (stack(0.9), 1, (1.093749, 0.889333, 0.592184), 2e-5),
]


def test_siconos():
    for column, exponent, velocities, bears in SICONOS:
        outcome = solved(column, law=LZB, exponent=exponent)
        assert outcome.velocities == pytest.approx(velocities, abs=bears, rel=0), (column, exponent)


def test_where_no_compression_is_repeated_the_two_laws_are_one():
    for column, exponent, _, _ in SICONOS[:-1]:
        here, there = (solved(column, law=law, exponent=exponent) for law in ("jia-mason-erdmann", LZB))
        assert here.velocities == there.velocities


@pytest.mark.parametrize(
    ("balls", "struck", "velocities", "bears"),
    [
        # DOP853 in time, each figure good to 1e-8.
        (3, 1, (0.07095235, -0.07640304, -0.99454931), 1e-8),
        (5, 1, (0.07108502, 0.03027376, 0.01446363, -0.12704499, -0.98877742), 1e-8),
        # Alciatore, three billiard balls, technical proof B.29, per the striker's speed, to the digits printed.
        (3, 1, (0.071, -0.076, -0.995), 6e-4),
        # Two balls that strike three: the first two of the far side, to the digits printed.
        (5, 2, (np.nan, np.nan, np.nan, -0.80, -1.14), 1e-2),
        # MonodisperseChainOfBalls.ref of siconos-tutorials, commit b6c9bfd: good to 5e-4.
        (10, 1, (0.0710593, *(8 * [np.nan]), -0.9859561), 5e-4),
    ],
)
def test_elastic_hertz_chains(balls, struck, velocities, bears):
    outcome = solved(chain(balls, struck=struck), exponent=1.5)
    assert np.nanmax(np.abs(np.subtract(outcome.velocities, velocities))) < bears


def test_two_balls_on_a_table_by_siconos():
    for cell, velocities, as_the_model in (
        ((0.01, 1, 1, 1), (0.717800, 0.696251), True),
        ((1, 1, 1, 1), (0.975472, 0.220126), True),
        ((10, 2, 0.6, 0.9), (0.589300, 0.225281), True),
        ((0.3, 4, 0.7, 0.5), (0.366259, 0.169034), True),
        ((2, 10, 0.9, 0.8), (0.739593, 0.133835), True),
        ((1, 1, 0.5, 0.5), (0.252856, 0.009892), False),
        ((0.1, 0.5, 0.8, 0.6), (0.523146, 0.246763), False),
        ((3, 0.3, 0.9, 0.9), (0.850181, 0.396132), False),
    ):
        ratio, mass, e1, e2 = cell
        column = Collision((1, mass), (1, ratio), (e1, e2), (-1, 0), table=True)
        ours = solved(column, law=LZB).velocities
        assert ours == pytest.approx(velocities, abs=2e-5, rel=0), cell
        own = np.abs(np.subtract(solved(column).velocities, velocities)).max()
        assert (own < 2e-5) == as_the_model, cell


def test_siconos_tutorials_ten_beads_on_a_wall():
    """BeadColumnED_LZB.ref of siconos-tutorials, commit b6c9bfd, its first impact: good to about 1e-3."""
    printed = (
        0.199598,
        0.460194,
        0.541052,
        0.871998,
        1.011202,
        1.042022,
        1.080208,
        1.148062,
        1.280967,
        1.568832,
    )
    column = Collision((1,) * 10, (1,) * 9 + (2**0.5,), (1,) * 10, (-1,) * 10, table=True)
    outcome = solved(column, law=LZB, exponent=1.5)
    assert outcome.velocities[::-1] == pytest.approx(printed, abs=1.5e-3, rel=0)


def test_a_hundred_random_columns_by_siconos():
    """Chains, drops and stacks of 2 to 8 balls; its own error is within 4e-5 for p = 1, and 4e-4 for p = 1.5."""
    data = json.loads(Path(__file__).with_name("siconos_columns.json").read_text(encoding="utf-8"))
    names = ("masses", "stiffnesses", "restitutions", "velocities", "table")
    for exponent, bears in ((1.0, 1e-4), (1.5, 5e-4)):
        rows = [row for row in data["columns"] if row["exponent"] == exponent]
        for row in rows:
            outcome = solved(Collision(*(row[name] for name in names)), law=LZB, exponent=exponent)
            difference = np.abs(np.subtract(outcome.velocities, row["result"])).max()
            assert difference < bears, row
