"""Illegal graphs are refused with one line that names the field, the value and what is legal."""

import numpy as np
import pytest

from impact_xval.model.graph.collision import BodyContact, GraphCollision, Plane, touching_balls
from impact_xval.model.graph.named import GRAPHS, bernoulli, box, bridge, corner, rack
from impact_xval.model.graph.solving import solve_graph, solve_graphs

FLOOR = BodyContact((1, None), (0.0, 1.0), 1.0, 0.5)


def collide(*contacts, masses=(1.0, 1.0), velocities=((0.0, -1.0), (0.0, 0.0)), **given):
    return GraphCollision(masses, velocities, contacts, **given)


def contact(**given):
    fields = {"bodies": (1, None), "normal": (0.0, 1.0), "stiffness": 1.0, "restitution": 0.5}
    return BodyContact(**{**fields, **given})


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (
            lambda: collide(contact(bodies=(1, 1))),
            r"contacts\[1\].bodies = \(1, 1\): a contact of a body with itself",
        ),
        (
            lambda: collide(FLOOR, contact(bodies=(1, 3))),
            r"contacts\[2\].bodies = \(1, 3\); legal: numbers from 1 to 2",
        ),
        (lambda: collide(contact(bodies=(None, 1))), r"contacts\[1\].bodies = \(None, 1\); legal"),
        (
            lambda: collide(contact(bodies=(None, None))),
            r"contacts\[1\].bodies = \(None, None\); legal: numbers",
        ),
        (
            lambda: collide(contact(normal=(0.0, 0.0))),
            r"contacts\[1\].normal = \(0.0, 0.0\), of length 0.0; legal: 2 n",
        ),
        (
            lambda: collide(contact(normal=(0.0, 2.0))),
            r"normal = \(0.0, 2.0\), of length 2.0; legal: .* length 1",
        ),
        (lambda: collide(contact(normal=(0.0, 0.0, 1.0))), r"normal = .*; legal: 2 numbers"),
        (
            lambda: collide(contact(stiffness=0.0)),
            r"contacts\[1\].stiffness = 0.0; legal: finite numbers > 0",
        ),
        (lambda: collide(contact(restitution=1.5)), r"contacts\[1\].restitution = 1.5; legal: from 0 to 1"),
        (lambda: collide(contact(arms=((1.0, 0.0),))), r"contacts\[1\].arms: 1 of them; legal: 2, or none"),
        (lambda: collide(), r"contacts: 0 of them; legal: from 1 to 60"),
        (lambda: collide(*[FLOOR] * 61), r"contacts: 61 of them; legal: from 1 to 60"),
        (lambda: collide(FLOOR, masses=(1.0, -1.0)), r"masses\[2\] = -1.0; legal: finite numbers > 0"),
        (lambda: collide(FLOOR, masses=(1.0,)), r"velocities: 2 of them; legal: 1"),
        (lambda: collide(FLOOR, inertias=(1.0,)), r"inertias: 1 of them; legal: 2, one per body, or none"),
        (lambda: collide(FLOOR, inertias=(1.0, 0.0)), r"inertias\[2\] = 0.0; legal: numbers > 0"),
        (
            lambda: collide(FLOOR, velocities=((0.0, 1.0), (0.0, 0.0))),
            r"velocities = .*: nothing meets; legal: the bodies of some contact approach",
        ),
        (lambda: rack(5), r"balls = 5; legal: 3, 6 or 10"),
        (lambda: bernoulli(20), r"angle = 20.0; legal: from 30 to less than 90 degrees"),
        (lambda: bernoulli(stiffness_ratio=0), r"stiffness_ratio = 0.0; legal: a finite number > 0"),
        (lambda: bridge(90), r"angle = 90.0; legal: from 30"),
        (lambda: corner(180), r"angle = 180.0; legal: more than 0 and less than 180"),
        (lambda: box(0), r"inertia = 0.0; legal: a finite number > 0"),
        (
            lambda: touching_balls([(0, 0), (0, 0.9)], [0.5, 0.5]),
            r"positions\[1\] and positions\[2\]: balls overlap .* 0.9",
        ),
        (
            lambda: touching_balls([(0, 0.4)], [0.5], [Plane((0.0, 1.0))]),
            r"positions\[1\]: the ball overlaps plane 1",
        ),
        (lambda: touching_balls([(0, 0.4)], [0.0]), r"radii\[1\] = 0.0; legal: finite numbers > 0"),
    ],
)
def test_illegal_collisions(make, says):
    with pytest.raises(ValueError, match=says) as refusal:
        make()
    assert "\n" not in str(refusal.value)


@pytest.mark.parametrize(
    ("W", "k", "e", "w", "says"),
    [
        (
            [[1, 2], [2, 1]],
            [1, 1],
            [1, 1],
            [1, 1],
            r"delassus in row 0: an eigenvalue of -1\.0\d*.*legal: none below 0",
        ),
        (
            [[1, 0.5], [0.4, 1]],
            [1, 1],
            [1, 1],
            [1, 1],
            r"delassus\[1, 2\] = 0.5, but \[2, 1\] = 0.4 in row 0; legal: a sy",
        ),
        ([[0, 0], [0, 1]], [1, 1], [1, 1], [0, 1], r"delassus\[1, 1\] = 0.0 in row 0; legal: > 0"),
        (
            [[1, 1], [1, 1]],
            [1, 1],
            [1, 1],
            [1, 0.5],
            r"rates = \[1.0, 0.5\] in row 0: .* outside the range .*; legal: r",
        ),
        (
            [[1, 0], [0, 1]],
            [1, 1],
            [1, 1],
            [0, -1],
            r"rates = \[0.0, -1.0\] in row 0: nothing approaches; legal: at l",
        ),
        (
            [[1, 0], [0, 1]],
            [1, -1],
            [1, 1],
            [1, 1],
            r"stiffnesses = -1.0 in row 0; legal: finite numbers > 0",
        ),
        ([[1, 0], [0, 1]], [1, 1], [1, 2], [1, 1], r"restitutions = 2.0 in row 0; legal: from 0 to 1"),
        (
            [[1, 0], [0, 1]],
            [1, 1, 1],
            [1, 1],
            [1, 1],
            r"stiffnesses: shape \(3,\); legal: \(2,\), for 2 rates",
        ),
        ([[1, 0], [0, np.nan]], [1, 1], [1, 1], [1, 1], r"delassus = nan in row 0; legal: finite numbers"),
        (
            [[1, 0], [0, 1]],
            [1, "soft"],
            [1, 1],
            [1, 1],
            r"stiffnesses = .*'soft'.*: not an array of numbers; l",
        ),
    ],
)
def test_illegal_numbers(W, k, e, w, says):
    with pytest.raises(ValueError, match=says) as refusal:
        solve_graph(W, k, e, w)
    assert "\n" not in str(refusal.value)


def test_a_number_of_windows_is_at_least_one():
    with pytest.raises(ValueError, match=r"max_windows = 0; legal: at least 1"):
        solve_graph([[1.0]], [1.0], [0.5], [1.0], max_windows=0)


def test_rows_of_many_are_named():
    W = np.array([np.eye(2)] * 3)
    W[2, 0, 1] = W[2, 1, 0] = 2.0
    ones = np.ones((3, 2))
    with pytest.raises(ValueError, match="delassus in row 2: an eigenvalue"):
        solve_graphs(W, ones, ones, ones)
    assert solve_graphs(W[:2], ones[:2], ones[:2], ones[:2]).statuses.tolist() == ["ok", "ok"]


def test_masses_too_far_apart_have_no_result():
    outcome = solve_graph(np.diag([1.0, 1e-200]), [1, 1], [1, 1], [1, 1])
    assert outcome.status == "unrepresentable"
    assert np.isnan(outcome.rates).all()


def test_rounding_is_not_refused():
    """Rounding errors are accepted: balls overlap by 1e-12, and a normal is longer than 1 by 1e-10."""
    assert len(touching_balls([(0, 0), (0, 1 - 1e-12)], [0.5, 0.5])) == 1
    assert len(touching_balls([(0, 0), (0, 1 + 1e-6)], [0.5, 0.5])) == 0
    collision = collide(contact(normal=(0.6, 0.8000000001)))
    assert np.hypot(*collision.contacts[0].normal) == pytest.approx(1, abs=1e-16)


@pytest.mark.parametrize("name", GRAPHS)
def test_graphs_by_name_have_defaults(name):
    assert (GRAPHS[name]().rates > 0).any()
