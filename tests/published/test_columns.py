"""Columns that others have computed or measured, with the precision their numbers bear (docs/columns.md, section 5)."""

import json
from pathlib import Path

import numpy as np
import pytest

from impact_xval.model import Collision, solve
from tests.compliant_baselines.reference_cells import chain
from tests.model.column_reference import JME, LZB
from tests.model.columns import solved

SICONOS = json.loads(Path(__file__).with_name("siconos_columns.json").read_text(encoding="utf-8"))


def by_siconos(name):
    """Give columns, and what stands beside each; their law is that of Liu, Zhao and Brogliato."""
    fields = ("masses", "stiffnesses", "restitutions", "velocities", "table")
    for row in SICONOS[name]:
        yield Collision(*(row[field] for field in fields), exponent=row["exponent"]), row


@pytest.mark.parametrize("name", ["standing", "columns"])
def test_siconos(name):
    for column, row in by_siconos(name):
        assert solve(column, law=LZB).velocities == pytest.approx(row["result"], abs=row["bears"], rel=0), row


def test_where_no_compression_is_repeated_the_two_laws_are_one():
    for column, row in by_siconos("standing"):
        if "repeats" in row:
            here, there = (solve(column, law=law).velocities for law in (JME, LZB))
            assert (here == there) == (not row["repeats"]), row
            assert not row["repeats"] or np.abs(np.subtract(here, row["result"])).max() > row["bears"]


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
    outcome = solved(chain(*struck * [-1], *(balls - struck) * [0]), exponent=1.5)
    assert np.nanmax(np.abs(np.subtract(outcome.velocities, velocities))) < bears
