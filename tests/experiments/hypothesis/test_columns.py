"""The hypothesis in columns: what a welded column is, and verdicts on laws of which it is known where they go."""

import math
from itertools import pairwise

import numpy as np
import pandas as pd
import pytest

from impact_xval.compliant_baselines import get_solver
from impact_xval.compliant_baselines.mapping import damping_ratio, restitution
from impact_xval.compliant_baselines.solver import Settings
from impact_xval.experiments.hypothesis.cases import BY_KEY, closed_form, point_of
from impact_xval.experiments.hypothesis.columns import (
    PLACES,
    Place,
    draw,
    of_each_ball,
    solved,
    stiffened,
    welded,
)
from impact_xval.experiments.hypothesis.config import parse, spaced
from impact_xval.experiments.hypothesis.verdicts import columns_judged, verdicts
from impact_xval.model.collision import Collision
from tests.model.columns import solved as solved_column

SETTINGS = Settings()


def judged(solver, place, balls=(4, 5), contrast=None):
    """Judge three columns at a place: each by itself, and their classes."""
    contrast = np.logspace(1, 5, 17) if contrast is None else contrast
    outcomes = pd.DataFrame(solved(solver, place, draw(place, 3, balls, 1), contrast))
    points = columns_judged(outcomes, parse({}, "test"))
    classes = verdicts(points, ["arrangement", "stiff_contact", "meets", "solver"]).set_index("class").verdict
    return outcomes, points, classes.to_dict()


def test_a_welded_column_has_the_mass_and_the_momentum_of_all_but_what_is_part_of_the_table():
    for place, column in ((at, one) for at in PLACES for one in draw(at, 6, (4, 7), 1)):
        contact = place.contact(len(column.masses))
        one = welded(column, contact)
        lost = (column.masses[-1], column.velocities[-1]) if place.where == "table" else (0.0, 0.0)
        assert len(one.masses) == len(column.masses) - 1
        assert sum(one.masses) == pytest.approx(sum(column.masses) - lost[0])
        momentum = np.dot(column.masses, column.velocities) - lost[0] * lost[1]
        assert np.dot(one.masses, one.velocities) == pytest.approx(momentum)
        assert one.stiffnesses == column.stiffnesses[:contact] + column.stiffnesses[contact + 1 :]
        assert (column.compression_rates[contact] > 0) == place.meets
        velocities = of_each_ball(range(1, len(one.masses) + 1), contact, len(column.masses))
        pair = velocities[contact], (*velocities, 0)[contact + 1] if contact + 1 < len(velocities) else 0
        assert pair == ((0, 0) if place.where == "table" else (contact + 1, contact + 1))


def test_of_two_balls_on_a_stiff_table_it_is_the_closed_form_of_the_supplement():
    point = point_of(BY_KEY["infinity"], 1.7, 0.8, 0.6, math.nan)
    column = Collision((1.0, 1.7), (1.0, 1.0), (0.8, 0.6), (-1.0, 0.0), table=True)
    found = of_each_ball(solved_column(welded(column, 1)).velocities, 1, 2)
    assert found == pytest.approx(closed_form(BY_KEY["infinity"], point), abs=1e-14)


def dashpots(column, restitutions):
    """c = 2 zeta sqrt(k m), m the reduced mass of the bodies of a contact."""
    masses = (*column.masses, math.inf) if column.table else column.masses
    reduced = [1 / (1 / a + 1 / b) for a, b in pairwise(masses)]
    values = zip(restitutions, column.stiffnesses, reduced, strict=True)
    return [2 * damping_ratio(e) * math.sqrt(k * m) for e, k, m in values]


def test_a_dashpot_law_goes_where_its_own_dashpots_lead_and_not_where_it_is_mapped_anew():
    """The welded column is given the dashpots as they were, by the restitutions with which they are mapped to it."""
    place = Place("drop", "middle")
    for column in draw(place, 2, (4, 5), 2):
        contact = place.contact(len(column.masses))
        anew, wanted = welded(column, contact), dashpots(column, column.restitutions)
        del wanted[contact]
        # The restitutions by which these dashpots are mapped to the welded column: c is linear in zeta.
        unit = dashpots(anew, [math.exp(-math.pi)] * len(wanted))
        kept = [
            restitution(c / u * damping_ratio(math.exp(-math.pi))) for c, u in zip(wanted, unit, strict=True)
        ]
        as_were = Collision(anew.masses, anew.stiffnesses, tuple(kept), anew.velocities, table=True)
        outcomes = get_solver("kelvin-voigt").solve_many(
            [stiffened(column, contact, 1e6), anew, as_were], SETTINGS
        )
        m = np.array(column.masses)
        stiff, *forms = (np.array(each.velocities) for each in outcomes)
        away = [
            np.sqrt(m @ (np.array(of_each_ball(form, contact, len(m))) - stiff) ** 2 / column.masses[0])
            for form in forms
        ]
        assert away[0] > 1e-3
        assert away[1] < 1e-5


@pytest.mark.parametrize(
    ("solver", "arrangement", "where", "lossy", "elastic"),
    [
        ("state-transition", "stack", "middle", "supported", "supported"),
        ("bistiffness", "cradle", "bottom", "supported", "supported"),
        ("kelvin-voigt", "stack", "middle", "refuted", "supported"),
        ("state-transition", "cradle", "middle", "refuted", "refuted"),
        ("kelvin-voigt", "stack", "table", "refuted", "refuted"),
    ],
)
def test_verdicts(solver, arrangement, where, lossy, elastic):
    outcomes, points, classes = judged(solver, Place(arrangement, where))
    assert (classes["lossy"], classes["elastic"]) == (lossy, elastic)
    for row, (_, series) in zip(points.itertuples(), outcomes.groupby("column"), strict=True):
        D = series.distance.to_numpy()
        if row.verdict == "supported":
            assert D[-1] < 1e-3 * D[0]
            assert 0.4 < row.rate < 2.2
        else:
            assert row.offset == pytest.approx(D[-1], rel=0.2)


@pytest.mark.parametrize("end", [5e4, 2e4])
def test_a_range_of_any_length_leaves_no_window_without_outcomes(end):
    x = spaced((10.0, end), 4)
    assert x[-1] == pytest.approx(end)
    assert 10.0 * (1 - 1e-9) <= x[0] < 10.0 * 10**0.25
    assert np.diff(np.log10(x)) == pytest.approx(0.25)
    assert judged("state-transition", Place("stack", "middle"), (4, 4), x)[2]["all"] == "supported"
