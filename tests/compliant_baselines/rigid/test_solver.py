"""The rigid laws behind the contract: what they refuse, their phases, states and paths."""

import math
from fractions import Fraction

import numpy as np
import pytest

from impact_xval.compliant_baselines import Settings, SolverError, get_solver
from impact_xval.compliant_baselines.contract import registry
from impact_xval.compliant_baselines.contract.conformance import conform
from impact_xval.compliant_baselines.contract.registry import kind_of, law_of, solver_names
from impact_xval.compliant_baselines.contract.state_runs import compared_states
from impact_xval.compliant_baselines.rigid.solver import GeneralisedReflectionSolver, RigidSolver
from impact_xval.model.collision import Collision
from impact_xval.model.columns.column import Column

LAWS = ("newton", "poisson", "sequential-top", "sequential-bottom", "generalised-reflection")


def test_they_are_rigid_laws_of_their_own_and_no_comparisons_default():
    rigid = tuple(name for name in solver_names(on_request=True) if kind_of(name) == "rigid")
    assert rigid == LAWS
    assert all(law_of(name) == name and isinstance(get_solver(name), RigidSolver) for name in LAWS)
    assert not set(LAWS) & set(solver_names())
    assert set(LAWS) <= set(registry.engine_free_names())


@pytest.mark.parametrize("name", LAWS[:-1])
def test_they_keep_the_contract(name):
    assert [
        (check.__name__, problem) for check, problem in conform(get_solver(name), "none") if problem
    ] == []


def test_reflections_keep_it_too_where_the_restitutions_are_equal():
    class OfOne(GeneralisedReflectionSolver):
        """With e1 for both contacts: the checks have cells of two, which the law refuses."""

        def solve_many(self, collisions, settings):
            equal = [Collision(c.m1, c.m2, c.k1, c.k2, c.e1, c.e1, c.v0) for c in collisions]
            return super().solve_many(equal, settings)

    assert [(check.__name__, problem) for check, problem in conform(OfOne(), "none") if problem] == []


@pytest.mark.parametrize(
    ("name", "collision", "said"),
    [
        ("newton", Collision(1.0, 1.0, 1.0, 0.0, 0.5, 0.5), r"k2 = 0.0 N/m: a contact without stiffness"),
        ("sequential-top", Collision(1.0, 1.0, 0.0, 1.0, 0.5, 0.5), r"k1 = 0.0 N/m: a contact without"),
        ("generalised-reflection", Collision(1.0, 1.0, 1.0, 1.0, 0.5, 0.6), r"\(0.5, 0.6\).*one coefficient"),
    ],
)
def test_what_they_cannot_say_is_refused_by_name(name, collision, said):
    with pytest.raises(SolverError, match=said) as caught:
        get_solver(name).solve(collision)
    assert caught.value.status == "unrepresentable"


def test_gaps_are_refused():
    c = Column((1.0, 1.0, 1.0), (1.0, 1.0), (1.0, 1.0), (-1.0, 0.0, 0.0), gaps=(0.0, 1e-3))
    for name in LAWS:
        with pytest.raises(
            SolverError, match=r"gaps = \(0.0, 0.001\) m: under a rigid law all contacts touch"
        ):
            get_solver(name).solve_column(c)


def test_an_infinite_stiffness_is_what_a_rigid_law_means():
    assert get_solver("newton").solve(Collision(1.0, 2.0, 1.0, math.inf, 0.9, 0.9)).v1 == 0.9


def test_the_path_of_poissons_law_has_the_end_of_compression():
    c = Collision(1.0, 1.0, 1.0, 1.0, 0.0, 0.5, v0=-2.0)
    path = get_solver("poisson").solve(c, Settings(record_path=True)).path
    assert path is not None
    assert path.time.tolist() == [0.0] * 5
    assert path.impulse1 == pytest.approx([0, 2, 2, 2.5, 2.5])
    assert path.impulse2 == pytest.approx([0, 2, 2, 3, 3])
    assert path.v2 == pytest.approx([0, 0, 0, 0.5, 0.5])
    assert path.state.tolist() == [1, 1, 1, 1, 4]
    assert path.phase2.tolist() == [1, 1, 2, 2, 0]


def test_the_path_of_a_sequence_has_each_impact():
    c = Collision(1.0, 2.0, 1.0, 1.0, 1.0, 1.0)
    outcome = get_solver("sequential-top").solve(c, Settings(record_path=True))
    path = outcome.path
    assert path is not None
    # (-1, 0), (1/3, -2/3), (1/3, 2/3), (7/9, 4/9)
    assert path.impulse1[[0, 1, 3, 5]] == pytest.approx([0, 4 / 3, 4 / 3, 16 / 9])
    assert path.impulse2[[0, 1, 3, 5]] == pytest.approx([0, 0, 8 / 3, 8 / 3])
    # Until the table has had an impulse it counts as acting, as in engines.
    assert path.state.tolist() == [1, 1, 2, 2, 3, 3, 4]
    assert np.diff(path.impulse2).min() >= 0
    assert outcome.states == ("S1", "S2", "S3", "S4")
    assert compared_states(outcome, 1e-6) == ("S1", "S4")  # none of them lasts
    assert outcome.n_events == 3


def test_the_states_of_a_column_are_the_sets_of_contacts_with_an_impulse():
    c = Column((1.0,) * 4, (1.0,) * 3, (1.0,) * 3, (-1.0, 0.0, 0.0, 0.0))
    assert get_solver("sequential-top").solve_column(c).states == ((1, 2, 3), (2, 3), (3,), ())
    assert get_solver("newton").solve_column(c).states == ((1, 2, 3), ())


def _poisson_in_fractions(mass, e):
    """Both contacts act: compression brings the balls to rest, expansion gives e times its impulses, p = (1, 1)."""
    m = Fraction(mass)
    v1, v2 = -1 + (1 + e), ((1 + e) - (1 + e)) / m
    return float(v1), float(v2)


@pytest.mark.parametrize("mass", [0.3, 3e-3, 3e-5, 3e-7, 3e-9, 3e-12])
@pytest.mark.parametrize("name", ["newton", "poisson", "generalised-reflection"])
def test_of_very_light_balls_it_is_the_answer_or_none(name, mass):
    (o,) = get_solver(name).solve_columns(
        [Column((1.0, mass), (1.0, 1.0), (0.5, 0.5), (-1.0, 0.0), True)], Settings()
    )
    if mass < 1e-6:
        assert (o.status, "condition number" in o.reason) == ("unrepresentable", True)
    elif name != "generalised-reflection":
        assert o.velocities == pytest.approx(_poisson_in_fractions(mass, Fraction(1, 2)), abs=1e-10)


def test_masses_beyond_double_precision_are_no_exception():
    for name in LAWS:
        c = Column((1e308, 1e-308), (1.0,), (0.5,), (-1.0, 0.0))
        (o,) = get_solver(name).solve_columns([c], Settings())
        assert o.status == "unrepresentable"
        assert "masses" in o.reason
