"""Contact graphs by the model.

Named graphs are compared with numbers of independent integrations, chains and pairs written as graphs with the solvers
for chains and pairs, and random graphs with an independent solution. The tests also check invariances, balances and
limiting cases.
"""

from dataclasses import replace

import numpy as np
import pytest

from impact_xval.model import Collisions, solve, solve_batch, solve_many
from impact_xval.model.chain.record import ChainEnding
from impact_xval.model.graph import BodyContact, GraphCollision, solve_graph_collision
from impact_xval.model.graph.named import bernoulli, box, bridge, corner, rack
from impact_xval.model.graph.record import GraphEnding
from impact_xval.model.graph.solving import solve_graph, solve_graphs
from impact_xval.model.pair.record import PairEnding
from tests.compliant_baselines.reference_cells import random_cells
from tests.model.graph.graphs import chain_as_graph, random_graph, random_graphs
from tests.model.graph.reference import integrate
from tests.model.test_chains import random_chain, random_chains

nightly = pytest.mark.nightly

#: Outcomes with a grazing margin below this are not compared, because rounding may decide them.
GRAZING = 1e-9

#: Velocities (x, z) of all bodies after the collision, from an independent program: closed forms between events in
#: double precision, events found by bracketing. A second integration (DOP853) agrees to 1e-11.
AFTER = [
    (bernoulli(), [(0, 0.2), (-0.3464101615137753, -0.6), (0.3464101615137753, -0.6)]),
    (
        bernoulli(stiffness_ratio=4),
        [
            (-0.12505621385901, 0.17606397047155),
            (-0.27697231803848, -0.47973012713277),
            (0.40202853189749, -0.69633384333878),
        ],
    ),
    (
        bernoulli(stiffness_ratio=4, restitution=0.5),
        [
            (-0.08014348261014, -0.09148164221372),
            (-0.22219491791074, -0.38485288700501),
            (0.30233840052088, -0.52366547078128),
        ],
    ),
    (corner(60, restitutions=(0.9, 0.7)), [(0.38155485401021, 0.68399552358526)]),
    (corner(90, restitutions=(0.9, 0.7), stiffness_ratio=10), [(0.7, 0.27)]),
    (
        bridge(),
        [
            (0, 0.51432567200238),
            (-0.21857408359283, 0.22108943541715),
            (0.21857408359283, 0.22108943541715),
        ],
    ),
    (
        rack(),
        [
            (-0.18417509663619, 0),
            (0.03712050271463, 0),
            (0.57352729696078, -0.33112613928791),
            (0.57352729696078, 0.33112613928791),
        ],
    ),
    (box(stiffness_ratio=3), [(0, 0.71494079771426)]),
    (box(1.0, stiffness_ratio=3), [(0, 0.8)]),
]


def solved(collision, **given):
    outcome = solve_graph_collision(collision, **given)
    assert outcome.status in ("ok", "closed-form"), (collision, outcome.reason)
    return outcome


def numbers(collision):
    """Return the Delassus matrix W, stiffnesses k, restitutions e and rates of compression w of a collision."""
    contacts = collision.contacts
    return (
        collision.delassus,
        [contact.stiffness for contact in contacts],
        [contact.restitution for contact in contacts],
        collision.rates,
    )


def clear(*outcomes):
    """Return whether all outcomes are so far from a jump that rounding cannot decide them."""
    return all(outcome.grazing_margin > GRAZING for outcome in outcomes)


@pytest.mark.parametrize(("collision", "velocities"), AFTER)
def test_named_graphs_have_the_velocities_of_an_independent_program(collision, velocities):
    outcome = solved(collision)
    assert outcome.status == "ok"
    np.testing.assert_allclose(outcome.velocities, velocities, atol=1e-10, rtol=0)


def test_a_box_turns_by_its_stiffnesses():
    assert solved(box(stiffness_ratio=3)).angular_velocities[0][0] == pytest.approx(
        0.41386492765612, abs=1e-10
    )
    for symmetric in (box(), box(1.0, stiffness_ratio=3)):
        assert solved(symmetric).angular_velocities[0][0] == pytest.approx(0, abs=1e-14)


def test_a_box_on_four_corners_is_the_box_on_two():
    """A box on four corners in space moves like the box on two corners in the plane, to 1e-12.

    The Delassus matrix of the four corners is singular. Each pair of corners has the stiffness of one corner in the
    plane.
    """
    corners = [
        BodyContact((1, None), (0.0, 0.0, 1.0), k / 2, 0.8, ((x, y, -0.5), (0.0, 0.0, 0.0)))
        for x, k in ((1.0, 1.0), (-1.0, 3.0))
        for y in (0.7, -0.7)
    ]
    flat = GraphCollision([1.0], [(0.0, 0.0, -1.0)], corners, inertias=[(0.2, 1 / 3, 0.5)])
    assert np.linalg.matrix_rank(flat.delassus) == 3
    outcome = solved(flat)
    np.testing.assert_allclose(outcome.velocities[0], (0, 0, 0.71494079771426), atol=1e-12)
    np.testing.assert_allclose(outcome.angular_velocities[0], (0, -0.41386492765612, 0), atol=1e-12)
    assert outcome.states == ("1+2+3+4", "1+2", "1+2+3+4", "3+4", "-")


@nightly
def test_a_close_pair_of_events_is_found():
    """The kernel finds a compression that ends and begins again between two points of a coarse grid.

    The independent solution misses the two events on the coarse grid. On a fine grid it agrees to 1e-10.
    """
    collision = random_graphs(200, 56, least=0.3)[55]
    W, k, e, w = numbers(collision)
    k[-1] *= 0.54054289725
    outcome = solve_graph(W, k, e, w)
    ends = [event.time for event in outcome.events if event.contact == 3][:2]
    assert ends[1] - ends[0] < 1e-5
    coarse, fine = integrate(W, k, e, w), integrate(W, k, e, w, resolution=1e-5)
    assert np.abs(coarse.rates - outcome.rates).max() > 0.1
    np.testing.assert_allclose(fine.rates, outcome.rates, atol=1e-10)


def test_contacts_that_touch_and_never_act():
    assert solved(bernoulli()).states == ("1+2", "-")  # without rounding, both would end at once
    assert solved(bernoulli()).impulses[2] == 0
    assert solved(rack()).states[0] == "1+2+3"
    assert solved(rack()).impulses[3] == 0


def test_events_have_words_and_times():
    outcome = solve_graph([[1.0]], [4.0], [0.5], [2.0])
    # a quarter of the period with stiffness k, and with stiffness k/e^2
    compression, restitution = 0.25 * np.pi, 0.125 * np.pi
    kinds = [(event.kind, event.contact, event.active) for event in outcome.events]
    assert kinds == [("start", 0, (1,)), ("end of compression", 1, (1,)), ("end of restitution", 1, ())]
    times = [event.time for event in outcome.events]
    assert times == pytest.approx([0, compression, compression + restitution], abs=1e-15)
    assert (outcome.states, outcome.times) == (("1", "-"), (times[0], times[2]))
    assert (outcome.impulses, outcome.rates) == (pytest.approx((3.0,)), pytest.approx((-1.0,)))


@pytest.mark.parametrize(("seed", "count"), [(31, 40), pytest.param(32, 2000, marks=nightly)])
def test_a_chain_laid_as_a_graph_is_the_chain(seed, count):
    rng, left_out = np.random.default_rng(seed), 0
    for _ in range(count):
        chain = random_chain(rng, balls=int(rng.integers(2, 9)))
        line, laid = solve(chain), chain_as_graph(chain)
        graph = solved(laid)
        if min(line.grazing_margin, graph.grazing_margin) < 1e-6:
            left_out += 1
            continue
        up = np.array(laid.contacts[0].normal)
        np.testing.assert_allclose(graph.velocities @ up, line.velocities, atol=1e-12, rtol=0)
        np.testing.assert_allclose(graph.impulses, line.impulses, atol=1e-12, rtol=0)
        assert graph.status == line.status
        if line.status == "ok" and np.isfinite(line.grazing_margin):
            assert graph.grazing_margin == pytest.approx(line.grazing_margin, rel=1e-6)
    assert left_out <= 0.01 * count


@pytest.mark.parametrize("count", [300, pytest.param(2000, marks=nightly)])
def test_a_pair_laid_as_a_graph_is_the_pair(count):
    kappa, mu, e1, e2 = cells = np.array(random_cells(count, count + 1))
    pairs = solve_batch(*cells, states=True)
    W = np.empty((count, 2, 2))
    W[:, 0, 0], W[:, 0, 1], W[:, 1, 0], W[:, 1, 1] = 1 + 1 / mu, -1 / mu, -1 / mu, 1 / mu
    ones = np.ones(count)
    graphs = solve_graphs(W, np.stack([ones, kappa], 1), np.stack([e1, e2], 1), np.stack([ones, 0 * ones], 1))
    is_clear = (pairs.grazing_margin > 1e-6) & (graphs.grazing_margin > 1e-6)
    assert is_clear.mean() > 0.99
    assert graphs.has_result[is_clear].all()
    v2 = -graphs.rates[:, 1]
    v1 = v2 - graphs.rates[:, 0]
    np.testing.assert_allclose(
        np.stack([v1, v2], 1)[is_clear], pairs.velocities[is_clear], atol=1e-12, rtol=0
    )


@pytest.mark.parametrize(("seed", "count"), [(41, 12), pytest.param(42, 200, marks=nightly)])
def test_random_graphs_are_those_of_modes_on_a_grid(seed, count):
    left_out = 0
    for collision in random_graphs(seed, count):
        ours = solved(collision)
        if ours.status != "ok" or ours.grazing_margin < 1e-6:
            left_out += 1
            continue
        for resolution in (0.02, 0.004):  # a coarse grid may miss two events that are close together
            theirs = integrate(*numbers(collision), resolution=resolution)
            if np.abs(ours.impulses - theirs.impulses).max() < 1e-10:
                break
        np.testing.assert_allclose(ours.impulses, theirs.impulses, atol=1e-10, rtol=0)
        np.testing.assert_allclose(ours.rates, theirs.rates, atol=1e-10, rtol=0)
    assert left_out <= 0.1 * count


@pytest.mark.parametrize(("seed", "count"), [(51, 30), pytest.param(52, 500, marks=nightly)])
def test_invariances(seed, count):
    """Outcomes do not change with rotation, mirroring, renumbering and scaling (Theorem 5), to 1e-10.

    Energy and momentum are balanced to 1e-12. At most 2 % of the collisions have no result, and at most 2 % are so near
    a jump that they are not compared.
    """
    rng, given_up, jumps = np.random.default_rng(seed), 0, 0
    for index in range(count):
        collision = random_graph(rng, singular=index % 4 == 3, fixed=index % 8 < 6)
        outcome = solve_graph_collision(collision)
        if not outcome.has_result:
            given_up += 1
            continue
        assert all(impulse >= 0 for impulse in outcome.impulses)
        assert max(outcome.rates) <= 0
        assert max(map(abs, outcome.diagnostics.values())) < 1e-12
        others = {
            "rotation": rotated(collision, rng.uniform(0, 2 * np.pi)),
            "mirror": mirrored(collision),
            "Theorem 5": scaled(collision, 3.0, 700.0, 0.01),
        }
        ways = {
            name: (solve_graph_collision(other), np.arange(len(collision.contacts)))
            for name, other in others.items()
        }
        order = rng.permutation(len(collision.contacts))
        renumbered = replace(collision, contacts=[collision.contacts[i] for i in order])
        ways["renumbering"] = solve_graph_collision(renumbered), np.argsort(order)
        for name, (other, place) in ways.items():
            if not clear(outcome, other):
                jumps += 1
                continue
            unit_of_impulse, unit_of_rate = (0.03, 0.01) if name == "Theorem 5" else (1, 1)
            impulses = np.array(other.impulses)[place] / unit_of_impulse
            np.testing.assert_allclose(impulses, outcome.impulses, atol=1e-10, rtol=0, err_msg=name)
            rates = np.array(other.rates)[place] / unit_of_rate
            np.testing.assert_allclose(rates, outcome.rates, atol=1e-10, rtol=0, err_msg=name)
        if all(contact.bodies[1] is not None for contact in collision.contacts):
            before, after = (
                np.array(collision.masses) @ np.array(v) for v in (collision.velocities, outcome.velocities)
            )
            np.testing.assert_allclose(after, before, atol=1e-12)
        elastic = replace(collision, contacts=[replace(c, restitution=1.0) for c in collision.contacts])
        bounced = solve_graph_collision(elastic)
        if bounced.has_result:
            assert energy(elastic, bounced) == pytest.approx(energy(elastic), rel=1e-12)
        else:
            given_up += 1
    assert given_up <= 0.02 * count
    assert jumps <= 0.02 * count


def energy(collision, outcome=None):
    turns = collision.angular_velocities if outcome is None else outcome.angular_velocities
    velocities = np.array(collision.velocities if outcome is None else outcome.velocities)
    moving = (np.array(collision.masses)[:, None] * velocities**2).sum()
    return 0.5 * (moving + (np.array(collision.inertias) * np.ravel(turns) ** 2).sum())


def moved(collision, matrix, sign):
    """Return a collision after a linear map of the plane; `sign` is -1 for a mirror, which reverses rotations."""

    def image(vectors):
        return [tuple(matrix @ np.array(vector)) for vector in vectors]

    contacts = [
        replace(contact, normal=image([contact.normal])[0], arms=tuple(image(contact.arms)))
        for contact in collision.contacts
    ]
    spins = tuple(sign * spin for spin in collision.angular_velocities)
    return replace(
        collision, velocities=image(collision.velocities), contacts=contacts, angular_velocities=spins
    )


def rotated(collision, angle):
    s, c = np.sin(angle), np.cos(angle)
    return moved(collision, np.array([[c, -s], [s, c]]), 1.0)


def mirrored(collision):
    return moved(collision, np.diag([-1.0, 1.0]), -1.0)


def scaled(collision, mass, stiffness, speed):
    return replace(
        collision,
        masses=[mass * m for m in collision.masses],
        inertias=[mass * inertia for inertia in collision.inertias],
        velocities=[tuple(speed * x for x in v) for v in collision.velocities],
        angular_velocities=[speed * spin for spin in collision.angular_velocities],
        contacts=[replace(c, stiffness=stiffness * c.stiffness) for c in collision.contacts],
    )


def test_a_diagonal_delassus_matrix_means_single_impacts():
    rng = np.random.default_rng(61)
    for _ in range(50):
        contacts = int(rng.integers(1, 13))
        diagonal, k, e = (
            10 ** rng.uniform(-1, 1, contacts),
            10 ** rng.uniform(-4, 4, contacts),
            rng.uniform(0, 1, contacts),
        )
        e[0], w = 0.0, rng.normal(size=contacts)
        w[-1] = 1.0
        outcome = solve_graph(np.diag(diagonal), k, e, w)
        expected = np.where(w > 0, -e * w, w)
        np.testing.assert_allclose(outcome.rates, expected, atol=1e-13, rtol=0)
        np.testing.assert_allclose(outcome.impulses, (w - expected) / diagonal, atol=1e-12, rtol=1e-13)


@pytest.mark.parametrize(("seed", "count"), [(71, 10), pytest.param(72, 100, marks=nightly)])
def test_a_plastic_contact_is_the_limit_of_small_restitution(seed, count):
    """As e -> 0, velocities approach those for e = 0 in proportion to e.

    Rigid contacts (e = 0) can be pulled open later here, because W has entries of both signs.
    """
    rng = np.random.default_rng(seed)
    for index, collision in enumerate(random_graphs(seed, count)):
        contacts = collision.contacts
        plastic = rng.permutation(len(contacts))[: 1 + index % 3]

        def with_restitution(e, contacts=contacts, plastic=plastic, collision=collision):
            changed = [replace(c, restitution=e) if i in plastic else c for i, c in enumerate(contacts)]
            return replace(collision, contacts=changed)

        limit = solved(with_restitution(0.0))
        if not clear(limit):
            continue
        differences = [
            np.abs(np.subtract(solved(with_restitution(e)).velocities, limit.velocities)).max()
            for e in (1e-4, 1e-6)
        ]
        assert differences[1] < 1e-5, index
        assert differences[1] < 0.02 * differences[0] + 1e-9, index


def test_a_plastic_contact_that_is_pulled_open():
    """A contact with e = 0 that others pull open again has the outcome of e = 1e-7, to 1e-6.

    A body lies in an acute corner between floor and wall. Its contact with the floor sticks first. Later the force of
    the wall lifts it off the floor.
    """
    corner_of_both = corner(40, restitutions=(0.0, 1.0), stiffness_ratio=1e-4, velocity=(-1.0, -1.0))
    outcome = solved(corner_of_both)
    assert outcome.status == "closed-form"
    assert outcome.rates[0] < 0
    softer = solved(corner(40, restitutions=(1e-7, 1.0), stiffness_ratio=1e-4, velocity=(-1.0, -1.0)))
    np.testing.assert_allclose(outcome.velocities, softer.velocities, atol=1e-6)


def test_extreme_stiffness_ratios_have_a_result():
    for contrast in (1e-8, 1e8):
        for collision in (
            bernoulli(stiffness_ratio=contrast, restitution=0.6),
            box(stiffness_ratio=contrast),
        ):
            assert solved(collision).status in ("ok", "closed-form")


def test_jammed_bodies_are_given_up():
    """A ball between two fixed walls that face each other ends as `unconverged`, without velocities."""
    walls = [BodyContact((1, None), (0.0, 1.0), 1.0, 1.0), BodyContact((1, None), (0.0, -1.0), 2.0, 1.0)]
    outcome = solve_graph_collision(GraphCollision([1.0], [(0.0, -1.0)], walls), max_windows=1000)
    assert outcome.status == "unconverged"
    assert outcome.reason == "not over within 1000 windows"
    assert np.isnan(outcome.velocities).all()
    assert not outcome.has_result


@pytest.mark.parametrize("balls", [3, 6, 10])
def test_a_rack_is_symmetric(balls):
    outcome = solved(rack(balls))
    velocities = np.array(outcome.velocities)
    last_row = {3: 2, 6: 3, 10: 4}[balls]
    end = velocities[-last_row:]
    np.testing.assert_allclose(end[:, 0], end[::-1, 0], atol=1e-13)
    np.testing.assert_allclose(end[:, 1], -end[::-1, 1], atol=1e-13)
    assert velocities.sum(axis=0) == pytest.approx((1, 0), abs=1e-13)


def test_many_graphs_are_those_one_by_one():
    rng = np.random.default_rng(81)
    same = [g for g in random_graphs(82, 200) if len(g.contacts) == 4]
    fields = [np.array(values) for values in zip(*map(numbers, same), strict=True)]
    assert len(same) > 5
    many = solve_graphs(*fields)
    for i in rng.permutation(len(same))[:5]:
        one = solve_graph(*(field[i] for field in fields))
        same_one = many[int(i)]
        # Residuals are rounding errors, which depend on the order in which arrays are added up.
        assert replace(one, diagnostics={}) == replace(same_one, diagnostics={})
        assert one.diagnostics == pytest.approx(same_one.diagnostics, abs=1e-14)
    without = solve_graphs(*fields, events=False)
    assert np.array_equal(without.rates, many.rates)
    assert without[0].states == ()
    assert [outcome.status for outcome in many[:3]] == many.statuses[:3].tolist()


def test_endings_of_different_kernels_have_different_numbers():
    endings = [{ending.value for ending in kind} for kind in (PairEnding, ChainEnding, GraphEnding)]
    assert len(set.union(*endings)) == sum(map(len, endings))


def test_margins_are_those_of_chains():
    chains = random_chains(91, 300, balls=4, table=True)
    line = solve_many(Collisions.of(chains))
    rows = [numbers(chain_as_graph(chain)) for chain in chains]
    graphs = solve_graphs(*(np.array(values) for values in zip(*rows, strict=True)))
    near = (line.grazing_margin < 0.05) & (line.grazing_margin > 1e-6) & (line.statuses == "ok")
    assert near.sum() > 5
    np.testing.assert_allclose(graphs.grazing_margin[near], line.grazing_margin[near], rtol=1e-7)
