"""Graphs with welded contacts: welded outcomes compared with other computations, and verdicts with docs/graphs.md.

Two bodies are welded if they move as one body. The hypothesis says that a contact that becomes ever stiffer welds its
bodies.
"""

import math

import numpy as np
import pytest

from benchmarks.graph_hypothesis import CONTRASTS, graphs, judge_contact, welded_velocities
from impact_xval.model.graph import BodyContact, GraphCollision, corner, rack, solve_graph_collision

_BY_HAND = {"bridge, 30 degrees": 3, "bridge, 45 degrees": 2}


def test_a_ball_welded_to_a_wall_slides_along_it_against_the_other():
    # On the floor v_z = 0. The wall at 60 degrees stops v_x = -1 and returns e of it.
    assert np.allclose(welded_velocities(corner(60, restitutions=(0.9, 0.9)), 0), [(0.9, 0.0)], atol=1e-14)


def test_two_balls_welded_along_the_axis_are_one_of_both_masses():
    graph = rack(3, restitution=0.8)
    welded = welded_velocities(graph, 0)
    contacts = [
        BodyContact((i - 1, j - 1), c.normal, 1.0, 0.8)
        for c in graph.contacts[1:]
        for i, j in [(c.bodies[0], c.bodies[1] or 0)]
    ]
    one = GraphCollision([2.0, 1.0, 1.0], [(0.5, 0.0), (0.0, 0.0), (0.0, 0.0)], contacts)
    velocities = solve_graph_collision(one).velocities
    assert np.allclose(welded, [velocities[0], *velocities], atol=1e-12)


@pytest.mark.parametrize("name", [*_BY_HAND])
@pytest.mark.parametrize(("e", "low", "high"), [(1.0, 0.8, 1.1), (0.9, 1.4, 2.0), (0.5, 1.4, 2.0)])
def test_a_resting_ball_becomes_part_of_the_table(name, e, low, high):
    found = judge_contact(name, graphs(e)[name], _BY_HAND[name], e)
    assert found.bodies == (2, None)
    assert not found.struck
    assert found.verdict.verdict == "supported"
    assert low < found.verdict.rate < high
    assert abs(found.parting) < 1e-8


@pytest.mark.parametrize("e", [1.0, 0.7])
def test_a_struck_wall_at_right_angles_to_the_other_returns_e_of_its_rate(e):
    for contact, rate in ((0, 0.3), (1, 1.0)):
        found = judge_contact("corner", graphs(e)["corner, 90 degrees"], contact, e)
        assert found.verdict.verdict == "refuted"
        assert math.isclose(found.verdict.offset, e * rate / math.hypot(1.0, 0.3), rel_tol=1e-9)


@pytest.mark.parametrize(
    ("name", "contact", "parts"),
    [("bernoulli, 45 degrees", 0, True), ("corner, 120 degrees", 1, False), ("rack of 3", 0, False)],
)
def test_a_struck_contact_refutes_the_hypothesis_whether_or_not_the_bodies_part(name, contact, parts):
    found = judge_contact(name, graphs(0.7)[name], contact, 0.7)
    assert found.struck
    assert found.verdict.verdict == "refuted"
    assert found.verdict.offset > 100 * found.verdict.limit_error
    assert (found.parting > 0.01) == parts


@pytest.mark.parametrize(
    ("name", "contact"), [("bernoulli, 30 degrees", 2), ("rack of 3", 1), ("rack of 3", 3)]
)
def test_a_contact_at_rest_that_opens_refutes_the_hypothesis(name, contact):
    found = judge_contact(name, graphs(0.7)[name], contact, 0.7)
    assert not found.struck
    assert found.verdict.verdict == "refuted"
    assert found.parting > 0.01
    assert found.verdict.settles
    assert len(CONTRASTS) == 29
