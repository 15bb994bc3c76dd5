"""The hypothesis in columns: what a welded column is, and where a dashpot law goes instead."""

import dataclasses
import math
from itertools import pairwise

import numpy as np
import pytest

from impact_xval.compliant_baselines import get_solver
from impact_xval.compliant_baselines.mapping import damping_ratio, restitution
from impact_xval.compliant_baselines.solver import Settings
from impact_xval.experiments.hypothesis.columns import PLACES, draw, of_each_ball, stiffened, welded
from impact_xval.experiments.hypothesis.judging import distance
from impact_xval.model.collision import Collision
from tests.model.columns import solved


def test_a_welded_column_has_the_mass_and_the_momentum_of_all_but_what_is_part_of_the_table():
    struck = [("chain", "top"), ("cradle", "middle"), ("drop", "top"), ("stack", "table")]
    for place, (column, contact) in ((at, one) for at in PLACES for one in draw(at, 6, (4, 7), 1)):
        one, n = welded(column, contact), len(column.masses) - (place[1] == "table")
        assert len(one.masses) == len(column.masses) - 1
        assert sum(one.masses) == pytest.approx(sum(column.masses[:n]))
        momentum = np.dot(column.masses[:n], column.velocities[:n])
        assert np.dot(one.masses, one.velocities) == pytest.approx(momentum)
        assert one.stiffnesses == column.stiffnesses[:contact] + column.stiffnesses[contact + 1 :]
        assert (column.compression_rates[contact] > 0) == (place in struck)
        velocities = of_each_ball(range(1, len(one.masses) + 1), contact, len(column.masses))
        pair = (*velocities, 0)[contact : contact + 2]
        assert pair == ((0, 0) if place[1] == "table" else (contact + 1, contact + 1))


def test_of_two_balls_on_a_stiff_table_it_is_the_closed_form_of_the_supplement():
    column = Collision((1.0, 1.7), (1.0, 1.0), (0.8, 0.6), (-1.0, 0.0), table=True)
    velocities = of_each_ball(solved(welded(column, 1)).velocities, 1, 2)
    assert velocities == pytest.approx((0.8, 0), abs=1e-14)


def test_a_dashpot_law_goes_where_its_own_dashpots_lead_and_not_where_it_is_mapped_anew():
    """The welded column is given the dashpots as they were, by the restitutions with which they are mapped to it."""

    def unit_dashpots(column):
        """c = 2 zeta sqrt(k m) per zeta, m the reduced mass of the bodies of a contact."""
        reduced = [1 / (1 / a + 1 / b) for a, b in pairwise((*column.masses, math.inf))]
        return 2 * np.sqrt(np.multiply(column.stiffnesses, reduced))

    for column, contact in draw(("drop", "middle"), 2, (4, 5), 2):
        anew = welded(column, contact)
        kept = np.delete(unit_dashpots(column), contact) / unit_dashpots(anew)
        kept = tuple(restitution(c * damping_ratio(e)) for c, e in zip(kept, anew.restitutions, strict=True))
        asked = [stiffened(column, contact, 1e6), anew, dataclasses.replace(anew, restitutions=kept)]
        stiff, *forms = get_solver("kelvin-voigt").solve_many(asked, Settings())
        ends = [of_each_ball(form.velocities, contact, len(column.masses)) for form in forms]
        weights = np.divide(column.masses, column.masses[0])
        away = distance(weights, np.subtract(ends, [stiff.velocities]))
        assert away[0] > 1e-3
        assert away[1] < 1e-5
