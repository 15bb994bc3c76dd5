"""The hypothesis in columns: what a welded column is, and verdicts on laws of which it is known where they go."""

import math
from itertools import pairwise, product

import numpy as np
import pytest

from impact_xval.compliant_baselines import get_solver
from impact_xval.compliant_baselines.mapping import damping_ratio, textbook_damping_ratio
from impact_xval.compliant_baselines.solver import Settings
from impact_xval.experiments.hypothesis.cases import BY_KEY, closed_form, point_of
from impact_xval.experiments.hypothesis.columns import (
    PLACES,
    Place,
    dashpots_kept,
    draw,
    examine_place,
    of_each_ball,
    stiffened,
    welded,
)
from impact_xval.experiments.hypothesis.config import spaced
from impact_xval.model.collision import Collision
from tests.model.columns import solved

CONTRAST = np.logspace(1, 5, 17)


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
    found = of_each_ball(solved(welded(column, 1)).velocities, 1, 2)
    assert found == pytest.approx(closed_form(BY_KEY["infinity"], point), abs=1e-14)


def test_dashpots_beside_a_pair_stay_what_they_were():
    """c = 2 zeta sqrt(k m), m the reduced mass of the bodies of a contact."""

    def dashpots(column, ratio):
        masses = (*column.masses, math.inf) if column.table else column.masses
        reduced = [1 / (1 / a + 1 / b) for a, b in pairwise(masses)]
        values = zip(column.restitutions, column.stiffnesses, reduced, strict=True)
        return [2 * ratio(e) * math.sqrt(k * m) for e, k, m in values]

    laws = (("kelvin-voigt", damping_ratio), ("kelvin-voigt-textbook", textbook_damping_ratio))
    for place, (solver, ratio) in product(PLACES, laws):
        for column in draw(place, 2, (4, 7), 3):
            contact = place.contact(len(column.masses))
            before, kept = dashpots(column, ratio), dashpots_kept(column, contact, solver)
            del before[contact]
            assert dashpots(kept, ratio) == pytest.approx(before, rel=1e-9), (place, solver)
            assert dashpots(welded(column, contact), ratio) != pytest.approx(before, rel=1e-3)


def test_no_dashpot_is_kept_of_what_has_none_or_cannot_be_mapped():
    column = Collision((1.0, 1e-4, 1e4), (1.0, 1.0), (1e-12, 0.9), (-1.0, 0.0, 0.0))
    assert dashpots_kept(column, 1, "bistiffness") is None
    assert dashpots_kept(column, 1, "kelvin-voigt") is not None
    heavy = Collision((1.0, 1e4, 1e-4), (1.0, 1.0), (1e-12, 0.9), (-1.0, 0.0, 0.0))
    assert dashpots_kept(heavy, 1, "kelvin-voigt-textbook") is not None
    assert dashpots_kept(heavy.reversed(), 0, "kelvin-voigt-textbook") is not None
    light = Collision((1.0, 1e4, 1e-4), (1.0, 1.0), (0.9, 1e-12), (-1.0, 0.0, 0.0))
    assert dashpots_kept(light, 0, "kelvin-voigt-textbook").restitutions[0] == pytest.approx(1e-12, rel=1e-2)


def apart(column, some, others):
    """D of final velocities from others."""
    m, v = np.array(column.masses), np.array(column.velocities)
    return np.sqrt(m @ np.subtract(some, others) ** 2 / (m @ v**2))


def test_a_dashpot_law_goes_where_its_own_dashpots_lead_and_not_where_it_is_mapped_anew():
    place = Place("drop", "middle")
    for column in draw(place, 2, (4, 5), 2):
        balls = len(column.masses)
        contact = place.contact(balls)
        kept = dashpots_kept(column, contact, "kelvin-voigt")
        columns = [stiffened(column, contact, 1e6), welded(column, contact), kept]
        stiff, anew, as_were = get_solver("kelvin-voigt").solve_many(columns, Settings())
        away = [
            apart(column, of_each_ball(each.velocities, contact, balls), stiff.velocities)
            for each in (anew, as_were)
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
    place = Place(arrangement, where)
    found = examine_place(solver, place, draw(place, 3, (4, 5), 1), CONTRAST, 3.0)
    assert {group.name: group.verdict for group in found.classes} == {"lossy": lossy, "elastic": elastic}
    for point in found.whole.members:
        D = point.distances()
        if point.judgement.verdict == "supported":
            assert D[-1] < 1e-3 * D[0]
            assert 0.4 < point.judgement.rate < 2.2
        else:
            assert point.judgement.offset == pytest.approx(D[-1], rel=0.2)


@pytest.mark.parametrize("end", [5e4, 2e4])
def test_a_range_of_any_length_leaves_no_window_without_outcomes(end):
    x = spaced((10.0, end), 4)
    assert x[-1] == pytest.approx(end)
    assert 10.0 * (1 - 1e-9) <= x[0] < 10.0 * 10**0.25
    assert np.diff(np.log10(x)) == pytest.approx(0.25)
    place = Place("stack", "middle")
    assert (
        examine_place("state-transition", place, draw(place, 3, (4, 4), 1), x, 3.0).whole.verdict
        == "supported"
    )
