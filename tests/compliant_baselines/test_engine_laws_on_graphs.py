"""Laws and measures by which `benchmarks` compares engines on contact graphs."""

import math

import numpy as np

from benchmarks.graph_symmetry import asymmetry, measure_symmetry, other_orders, symmetric_scenes
from benchmarks.graphs_in_engines import distance, newton_in_steps, restitution_once
from impact_xval.compliant_baselines.registry import get_solver
from impact_xval.compliant_baselines.rigid.graphs import solve_rigid_graph
from impact_xval.compliant_baselines.solver import Settings
from impact_xval.model.graph import BodyContact, GraphCollision, bernoulli, rack


def row_of_three(velocities, restitutions=(1.0, 1.0)):
    """Return three balls of 1 kg in a line along x, ball 1 at the right."""
    contacts = [
        BodyContact((i, i + 1), (1.0, 0.0), 1e8, e) for i, e in zip((1, 2), restitutions, strict=True)
    ]
    return GraphCollision((1.0, 1.0, 1.0), [(v, 0.0) for v in velocities], contacts)


def test_newton_in_steps_is_newtons_law_where_all_contacts_touch():
    for graph in (bernoulli(restitution=0.8), rack(3, restitution=0.7)):
        e = [contact.restitution for contact in graph.contacts]
        rigid = solve_rigid_graph("newton-restitution", graph.delassus, e, graph.rates)
        in_steps = newton_in_steps(graph, 1e-6, np.full(len(e), -1e-5))
        assert distance(graph, in_steps, graph.after(rigid.impulses.tolist())[0]) < 1e-12


def test_newton_in_steps_leaves_out_a_contact_that_has_parted():
    graph = row_of_three((-1.0, 0.0, -0.5))  # contact 2 parts at 0.5 m/s
    by_steps = newton_in_steps(graph, 1e-6, np.array([-1e-5, 0.0]))
    # Contact 2 has a gap: balls 1 and 2 exchange velocities, then balls 2 and 3.
    assert np.allclose(by_steps[:, 0], (0.0, -0.5, -1.0))


def test_restitution_once_gives_a_contact_its_restitution_in_its_first_impact_alone():
    pair = GraphCollision((1.0,), [(0.0, -1.0)], [BodyContact((1, None), (0.0, 1.0), 1e8, 0.5)])
    assert np.allclose(restitution_once(pair, [1]), [(0.0, 0.5)])
    # Contact 1 rebounds, contact 2 drives ball 2 back into ball 1: the second impact of contact 1 is plastic.
    graph = row_of_three((-1.0, 0.0, 0.0), (0.5, 1.0))
    for order in ([1, 2], [2, 1]):
        x = restitution_once(graph, order)[:, 0]
        assert math.isclose(x.sum(), -1.0)
        assert x[0] - x[1] >= -1e-7
        assert x[1] - x[2] >= -1e-7


def test_asymmetry_of_a_symmetric_answer_is_none_and_orders_are_other_ones():
    scenes = symmetric_scenes()
    assert len(scenes) == 33
    assert other_orders(1) == []
    assert other_orders(2) == [[1, 0]]
    assert other_orders(3) == [[2, 1, 0], [1, 2, 0]]
    (first, *_), (corner_scene, *_) = scenes, [scene for scene in scenes if scene.name == "corner"]
    assert asymmetry(first, np.array([(0.1, 0.2), (-0.3, -0.6), (0.3, -0.6)])) == 0.2
    # The mirror of a corner of 60 degrees is the line at 30 degrees from z.
    assert math.isclose(asymmetry(corner_scene, np.array([(1.0, 0.0)])), 1.5, rel_tol=1e-12)


def test_the_model_keeps_symmetry_and_single_impacts_break_it():
    scenes = symmetric_scenes()[:9]
    model = measure_symmetry(get_solver("state-transition"), scenes, Settings())
    assert max(*model.asymmetries.values(), model.by_bodies, model.by_contacts) < 1e-13
    sequential = measure_symmetry(get_solver("sequential-top"), scenes, Settings())
    assert sequential.asymmetries["bernoulli"] > 0.3
    assert sequential.by_bodies < 1e-13
    assert sequential.by_contacts > 0.3
    assert sequential.refused == 0
