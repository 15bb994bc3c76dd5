"""Rigid laws of contact graphs, compared with the laws of chains and with closed forms.

In some graphs the impulses and the velocities of separation are not unique.
"""

from itertools import combinations

import numpy as np
import pytest

from impact_xval.compliant_baselines.rigid.graphs import (
    GRAPH_LAWS,
    solve_graph_by_rigid_law,
    solve_rigid_graph,
)
from impact_xval.compliant_baselines.rigid.laws import follow_impacts
from impact_xval.model import Collision
from impact_xval.model.graph.collision import BodyContact, GraphCollision
from impact_xval.model.graph.named import bernoulli, box
from tests.model.graph.graphs import chain_as_graph, random_graphs


@pytest.mark.parametrize("law", GRAPH_LAWS)
def test_rigid_laws_of_graphs_are_those_of_chains_on_a_chain(law):
    rng = np.random.default_rng(1)
    for _ in range(20):
        balls = int(rng.integers(2, 6))
        e = (rng.uniform(0.5, 1),) * balls
        velocities = (-1.0,) + (0.0,) * (balls - 1)
        chain = Collision(
            tuple(10 ** rng.uniform(-0.5, 0.5, balls)), (1.0,) * balls, e, velocities, table=True
        )
        name = "sequential-top" if law == "sequential" else law
        line, graph = follow_impacts(chain, name), chain_as_graph(chain)
        # The order in which the law sweeps a chain: odd contacts between balls, even ones, then the table.
        order = (
            [*range(1, balls, 2), *range(2, balls, 2), balls] if law == "plastic-then-restitution" else None
        )
        outcome = solve_rigid_graph(law, graph.delassus, e, graph.rates, order=order)
        np.testing.assert_allclose(outcome.rates, -line.u, atol=1e-9)
        assert (outcome.impulse_spread, outcome.rate_spread) == (0, 0)


def test_a_symmetric_scene_and_an_order():
    """One ball strikes two at 30 degrees with e = 1: Newton's law keeps the symmetry, single impacts do not."""
    scene = bernoulli()
    both = solve_rigid_graph("newton-restitution", scene.delassus, [1, 1, 1], scene.rates)
    velocities, _ = scene.after(both.impulses)
    np.testing.assert_allclose(velocities[0], (0, 0.2), atol=1e-12)
    first = solve_rigid_graph("sequential", scene.delassus, [1, 1, 1], scene.rates, order=(1, 2, 3))
    second = solve_rigid_graph("sequential", scene.delassus, [1, 1, 1], scene.rates, order=(2, 1, 3))
    assert first.law == "sequential (1, 2, 3)"
    assert first.rates[0] != pytest.approx(second.rates[0], abs=0.01)
    # the two orders give mirror images of each other
    np.testing.assert_allclose(
        scene.after(first.impulses)[0][0] * (-1, 1), scene.after(second.impulses)[0][0], atol=1e-12
    )


@pytest.mark.parametrize("law", GRAPH_LAWS)
def test_a_diagonal_matrix_means_single_impacts(law):
    scene = box(1.0)
    outcome = solve_rigid_graph(law, scene.delassus, [0.8, 0.8], scene.rates)
    np.testing.assert_allclose(outcome.rates, (-0.8, -0.8), atol=1e-12)


def test_splits_that_are_not_unique():
    """Three contacts share one direction of motion, so that their impulses are not unique."""
    W, w = np.ones((3, 3)), np.ones(3)
    newton = solve_rigid_graph("newton-restitution", W, [0.5] * 3, w)
    np.testing.assert_allclose(newton.rates, -0.5, atol=1e-12)
    assert newton.impulse_spread == pytest.approx(1.0)
    assert newton.rate_spread == 0
    poisson = solve_rigid_graph("poisson-restitution", W, [0.2, 0.5, 0.8], w)
    # Any one contact can take the whole impulse of compression. The velocity of separation then follows from the
    # restitution of this contact.
    assert poisson.rate_spread == pytest.approx(0.8 - 0.2)
    with pytest.raises(ValueError, match="restitutions: unequal ones with a singular W"):
        solve_rigid_graph("newton-restitution", W, [0.2, 0.5, 0.8], w)


def test_no_contact_approaches_afterwards_and_equal_e_makes_no_energy():
    for collision in random_graphs(3, 20):
        W, w = collision.delassus, collision.rates
        for law in ("newton-restitution", "poisson-restitution", "generalised-reflection"):
            outcome = solve_rigid_graph(law, W, np.full(len(w), 0.7), w)
            assert outcome.rates.max() <= 1e-9
            assert outcome.impulses.min() >= -1e-12
            assert outcome.impulses @ (w + outcome.rates) >= -1e-9  # twice the lost energy


def nearest_parting_velocity(velocity, normals):
    """Return the velocity nearest to a given one at which a ball leaves planes or slides on them, in two dimensions."""
    best = None
    for n in range(3):
        for some in combinations(normals, n):
            touched = np.reshape(some, (n, 2))
            moved = velocity - np.linalg.pinv(touched) @ (touched @ velocity)
            if (normals @ moved > -1e-12).all():
                best = (
                    min(best, moved, key=lambda v: np.linalg.norm(v - velocity))
                    if best is not None
                    else moved
                )
    return best


@pytest.mark.parametrize("law", [law for law in GRAPH_LAWS if law != "sequential"])
def test_a_plastic_ball_on_three_planes_takes_the_nearest_velocity(law):
    """W has rank 2 for three contacts. For e = 0 the impact is a projection, which is found here by trying all pairs.

    The second complementarity problem of Poisson's law has nothing but rounding errors on its right-hand side.
    """
    rng = np.random.default_rng(0)
    for _ in range(60):
        angles, velocity = rng.uniform(-1.3, 1.3, 3), rng.normal(size=2)
        normals = np.column_stack([np.sin(angles), np.cos(angles)])
        if not (normals @ velocity < 0).any():
            continue
        contacts = [BodyContact((1, None), tuple(normal), 1.0, 0.0) for normal in normals.tolist()]
        outcome = solve_graph_by_rigid_law(law, GraphCollision([1.0], [tuple(velocity.tolist())], contacts))
        assert outcome.status == "ok", outcome.reason
        if law != "plastic-then-restitution":  # one sweep over the contacts need not end at rest
            expected = nearest_parting_velocity(velocity, normals)
            np.testing.assert_allclose(outcome.velocities[0], expected, atol=1e-12)


def test_rates_may_grow_in_a_sequence_of_single_impacts():
    """Six contacts on which rates become larger than the largest rate at the start, while energy is lost.

    In rational arithmetic the sequence is not over after 300 impacts. In floating point it is over when all rates of
    approach are below the rounding of the largest rate at the start, and then count as 0.
    """
    upper = [
        [1.5, 152 / 425, -13 / 85, 0, 18 / 85, -110 / 221],
        [0, 5 / 6, 0, 0, 117 / 250, -253 / 650],
        [0, 0, 4, 132 / 125, 72 / 25, -48 / 65],
        [0, 0, 0, 3, 1.8, -969 / 325],
        [0, 0, 0, 0, 3.5, -231 / 130],
        [0, 0, 0, 0, 0, 3.5],
    ]
    W = np.triu(upper) + np.triu(upper, 1).T
    w = np.array([36 / 17, -24 / 25, -24 / 5, 141 / 25, 1.4, -63 / 13])
    outcome = solve_rigid_graph("sequential", W, [0.5] * 6, w)
    assert np.abs(outcome.rates).max() > np.abs(w).max()
    assert outcome.rates.max() < 1e-12
    assert outcome.impulses.min() >= 0
    assert outcome.impulses @ (w + outcome.rates) > 0  # twice the lost energy


@pytest.mark.parametrize(
    ("given", "says"),
    [
        ({"law": "cooking"}, "law = 'cooking'; legal: newton-restitution, "),
        ({"order": (1, 1)}, r"order = \(1, 1\); legal: the numbers from 1 to 2, each once"),
        ({"law": "generalised-reflection", "e": (0.5, 0.6)}, "has one e for all contacts"),
        ({"w": (-1.0, -1.0)}, "nothing approaches"),
    ],
)
def test_illegal_input(given, says):
    fields = {"law": "sequential", "e": (0.5, 0.5), "w": (1.0, 1.0), "order": None} | given
    with pytest.raises(ValueError, match=says):
        solve_rigid_graph(fields["law"], np.eye(2), fields["e"], fields["w"], order=fields["order"])
