"""Engines on contact graphs of balls in a plane.

Outcomes are compared with exact laws, and with the same scene rotated, mirrored or renumbered.
"""

import math
from dataclasses import replace
from itertools import permutations

import numpy as np
import pytest

from impact_xval.compliant_baselines import get_solver
from impact_xval.compliant_baselines.engines.plane_run import project_to_parting
from impact_xval.compliant_baselines.engines.scene import Scene
from impact_xval.compliant_baselines.rigid.graphs import solve_rigid_graph
from impact_xval.compliant_baselines.solver import Convergence, Settings
from impact_xval.model.collision import Collision
from impact_xval.model.graph import BodyContact, GraphCollision, bernoulli, box, bridge, corner, rack
from tests.compliant_baselines.conftest import installed
from tests.compliant_baselines.plane_graphs import moved, random_graph, renumbered, with_stiffness

COMPLIANT = ["mujoco", "pybullet", "drake"]

#: For each rigid engine: the impact law that it follows where the contacts of several bodies form a graph, and the
#: largest difference (m/s) between one of its velocities and the velocity by this law.
RIGID = {
    "pymunk": ("newton-restitution", 1e-6),
    "dart": ("newton-restitution", 1e-4),
    "rapier": ("plastic-then-restitution", 1e-3),
    "sapien": ("newton-restitution", 1e-3),
}
ALL = [*COMPLIANT, *RIGID]

#: Velocities after Bernoulli's problem with e = 1, at k2/k1 = 1 and 4, by an independent program with closed forms
#: between events.
BERNOULLI = {
    1: ((0.0, 0.2), (-0.3464101615137753, -0.6), (0.3464101615137753, -0.6)),
    4: (
        (-0.12505621385901, 0.17606397047155),
        (-0.27697231803848, -0.47973012713277),
        (0.40202853189749, -0.69633384333878),
    ),
}

STIFF = Settings(step_fraction=1e-3, max_steps=100_000)
COARSE = replace(STIFF, step_fraction=2e-3)
LIMITS = replace(STIFF, convergence=Convergence(halvings=2))


def solve(engine, collision, settings=COARSE):
    (outcome,) = engine.solve_graphs([collision], settings)
    assert outcome.status == "ok", outcome.reason
    return outcome


@pytest.mark.smoke
@pytest.mark.parametrize("ratio", BERNOULLI)
def test_bernoullis_problem_in_mujoco_is_the_models(ratio):
    engine = installed("mujoco")
    outcome = solve(engine, with_stiffness(bernoulli(stiffness_ratio=ratio), 1e8), STIFF)
    assert np.array(outcome.velocities) == pytest.approx(np.array(BERNOULLI[ratio]), abs=2e-5)


@pytest.mark.parametrize("name", COMPLIANT)
def test_limits_of_random_graphs_are_those_of_kelvin_voigt(name):
    engine, rng = installed(name), np.random.default_rng(11)
    graphs = [random_graph(rng) for _ in range(6)]
    exact = get_solver("kelvin-voigt").solve_graphs(graphs, LIMITS)
    for graph, outcome, reference in zip(graphs, engine.solve_graphs(graphs, LIMITS), exact, strict=True):
        assert outcome.has_result, outcome.reason
        off = np.abs(np.subtract(outcome.limit_velocities, reference.velocities)).max()
        assert off <= 3 * outcome.diagnostics["limit_error"] < 0.01, graph


@pytest.mark.parametrize("name", RIGID)
def test_rigid_engines_follow_their_law_on_named_graphs(name):
    engine, (law, distance) = installed(name), RIGID[name]
    for graph in (bridge(restitutions=(0.8, 0.8)), corner(60, restitutions=(0.9, 0.7)), rack(3)):
        restitutions = [contact.restitution for contact in graph.contacts]
        velocities = np.array(solve(engine, graph).velocities)
        off: list[float] = []
        for order in permutations(range(1, len(restitutions) + 1)):
            rigid = solve_rigid_graph(law, graph.delassus, restitutions, graph.rates, order=order)
            off.append(np.abs(velocities - graph.after(rigid.impulses.tolist())[0]).max())
            if law == "newton-restitution":  # Newton's law does not depend on the order
                break
        assert min(off) < distance, graph


@pytest.mark.parametrize("name", ALL)
def test_one_oblique_contact_returns_its_restitution_and_keeps_what_is_across(name):
    engine, rng = installed(name), np.random.default_rng(3)
    for second in (2, None):
        angle = rng.uniform(0, 2 * math.pi)
        normal = np.array([math.cos(angle), math.sin(angle)])
        velocity = -normal + 0.4 * np.array([-normal[1], normal[0]])
        contact = BodyContact((1, second), tuple(normal.tolist()), 1e8, 0.6)
        bodies = 1 if second is None else 2
        graph = GraphCollision([1.0, 2.0][:bodies], [tuple(velocity.tolist()), (0, 0)][:bodies], [contact])
        outcome = solve(engine, graph, LIMITS)
        v = np.array(outcome.limit_velocities)
        relative = v[0] - (v[1] if second else 0)
        assert relative @ normal == pytest.approx(0.6, abs=1e-4 + 3 * outcome.diagnostics["limit_error"])
        assert v[0] @ [-normal[1], normal[0]] == pytest.approx(0.4, abs=2e-6)


@pytest.mark.parametrize("name", ALL)
def test_a_chain_laid_upright_in_a_plane_has_the_engines_answer_of_a_chain(name):
    engine = installed(name)
    masses, stiffnesses, restitutions = (1.0, 2.0, 0.7), (1e6, 3e6, 2e6), (0.9, 0.6, 0.8)
    chain = Collision(masses, stiffnesses, restitutions, (-1.0, 0.0, 0.0), table=True)
    contacts = [
        BodyContact((i, i + 1 if i < 3 else None), (0.0, 1.0), k, e)
        for i, (k, e) in enumerate(zip(stiffnesses, restitutions, strict=True), 1)
    ]
    graph = GraphCollision(masses, [(0.0, v) for v in chain.velocities], contacts)
    outcome, (expected,) = solve(engine, graph, LIMITS), engine.solve_many([chain], LIMITS)
    across, along = np.transpose(outcome.limit_velocities)
    limit = np.array([expected.diagnostics[f"v{i}_limit"] for i in (1, 2, 3)])
    errors = outcome.diagnostics["limit_error"] + expected.diagnostics["limit_error"]
    assert across == pytest.approx(0, abs=1e-12)
    assert along == pytest.approx(limit, abs=errors + 2e-6)


@pytest.mark.parametrize("name", ALL)
def test_turned_and_mirrored_scenes_have_turned_and_mirrored_outcomes(name):
    engine = installed(name)
    graph = with_stiffness(bridge(restitutions=(0.9, 0.7)), 1e8)
    expected = np.array(solve(engine, graph).velocities)
    cosine, sine = math.cos(0.7), math.sin(0.7)
    matrices = [np.array([[cosine, -sine], [sine, cosine]]), np.diag([-1.0, 1.0])]
    # Rapier solves contacts in an order of its own, which breaks the symmetry of the scene
    if name == "rapier":
        del matrices[1]
    for matrix in matrices:
        turned = moved(graph, lambda v, matrix=matrix: (matrix @ v).tolist())
        accuracy = 1e-3 if name in ("rapier", "sapien") else 2e-5
        assert np.array(solve(engine, turned).velocities) == pytest.approx(expected @ matrix.T, abs=accuracy)


@pytest.mark.parametrize("name", [*COMPLIANT, "pymunk", "dart"])
def test_numbers_of_bodies_and_contacts_do_not_matter(name):
    engine, graph = installed(name), with_stiffness(bridge(), 1e8)
    expected = np.array(solve(engine, graph).velocities)
    bodies, contacts = [2, 0, 1], [3, 1, 4, 0, 2]
    other = np.array(solve(engine, renumbered(graph, bodies, contacts)).velocities)
    assert other == pytest.approx(expected[bodies], abs=2e-5)


@pytest.mark.parametrize(
    ("graph", "reason"),
    [
        (box(), "contacts with arms: engines run balls"),
        (
            GraphCollision([1], [(0, 0, -1)], [BodyContact((1, None), (0, 0, 1), 1, 1)]),
            "the bodies move in space",
        ),
        (
            GraphCollision(
                [1, 1, 1],
                [(0, -1), (0, 0), (0, 0)],
                [
                    BodyContact((1, 2), (0, 1), 1, 1),
                    BodyContact((1, 3), (1, 0), 1, 1),
                    BodyContact((2, 3), (1, 0), 1, 1),
                ],
            ),
            "no equal balls touch with these normals: contact",
        ),
        (
            GraphCollision([1, 1], [(0, -1), (0, 0)], [BodyContact((1, 2), (0, 1), 1, 1)] * 2),
            "two contacts of the same two bodies",
        ),
        (
            replace(corner(), contacts=[BodyContact((1, None), (0, 1), 1, 0.0)]),
            "e1 = 0: no finite damping",
        ),
    ],
)
def test_graphs_that_no_scene_holds_are_refused_with_a_reason(graph, reason):
    (outcome,) = installed("mujoco").solve_graphs([graph], Settings())
    assert outcome.status == "unrepresentable"
    assert reason in outcome.reason
    assert np.isnan(outcome.velocities).all()


def test_an_engine_of_lines_alone_refuses_graphs():
    engine = installed("pybullet-restitution")
    assert not engine.knows_planes
    (outcome,) = engine.solve_graphs([corner()], Settings())
    assert outcome.status == "unrepresentable"
    assert "balls in a line alone" in outcome.reason


def test_balls_of_a_scene_touch_and_overlap_by_less_than_a_step():
    for graph in (bernoulli(), bridge(), rack(10), corner(120)):
        scene = Scene.of_graph(graph, Settings())
        assert not isinstance(scene, str)
        arrangement = scene.arrangement
        for touch in arrangement.touches:
            if touch.second is not None:
                apart = np.subtract(arrangement.centres[touch.first], arrangement.centres[touch.second])
                assert apart == pytest.approx(2 * np.array(touch.normal), abs=1e-12)
        assert arrangement.jacobian @ scene.closing == pytest.approx(-1)
        assert scene.rates == pytest.approx(graph.rates, abs=1e-15)


def test_velocities_that_part_are_the_nearest_ones():
    rng = np.random.default_rng(2)
    for _ in range(20):
        scene = Scene.of_graph(random_graph(rng), Settings())
        assert not isinstance(scene, str)
        v, J, m = rng.normal(size=len(scene.velocities)), scene.arrangement.jacobian, scene.inertia
        nearest = project_to_parting(v, scene)
        assert (J @ nearest).min() > -1e-12
        for _ in range(20):  # any other velocities that separate the bodies are further away
            other = project_to_parting(nearest + 0.1 * rng.normal(size=len(v)), scene)
            assert m @ (other - v) ** 2 >= m @ (nearest - v) ** 2 * (1 - 1e-12)
