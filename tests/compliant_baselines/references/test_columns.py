"""The references for N balls: two balls, an independent integration, invariances, gaps, and what is refused."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from impact_xval.compliant_baselines import Settings, SolverError, get_solver
from impact_xval.compliant_baselines.references.columns.rounding import MOVED, changed, mark_columns
from impact_xval.compliant_baselines.references.columns.solving import LAWS, coefficients_of, solve_column
from impact_xval.model import Column
from impact_xval.model import solve_column as solve_by_the_model
from tests.compliant_baselines.column_in_time import integrate
from tests.compliant_baselines.reference_cells import BATCHES, DAMPING
from tests.model.test_columns import random_column

NAMES = {(1, 2): "S1", (2,): "S2", (1,): "S3", (): "S4"}


def cradle(balls, struck, gap=0.0, e=1.0):
    velocities = [-1.0] * struck + [0.0] * (balls - struck)
    contacts = balls - 1
    return Column((1,) * balls, (1,) * contacts, (e,) * contacts, velocities, gaps=(gap,) * contacts)


def with_gaps(rng, column):
    contacts = len(column.stiffnesses)
    return replace(column, gaps=tuple(10 ** rng.uniform(-4, 0, contacts) * rng.integers(2, size=contacts)))


@pytest.mark.parametrize("law", LAWS)
def test_two_balls_on_a_table_are_the_two_ball_references(law):
    rng, count = np.random.default_rng(1), 60 if law == "hunt-crossley" else 200
    cells = (*10 ** rng.uniform((-2, -1), (2, 1), (count, 2)).T, *rng.uniform(0.05, 1, (2, count)))
    batch = BATCHES[law](*cells)
    frozen = BATCHES[law](*cells, frozen=True) if law in DAMPING else None
    for i, (k, m, e1, e2) in enumerate(zip(*cells, strict=True)):
        # In SI units of no particular size.
        column = Column((0.3, 0.3 * m), (2e4, 2e4 * k), (e1, e2), (-2.5, 0), table=True)
        outcome = solve_column(column, law)
        expected = 2.5 * batch.v1[i], 2.5 * batch.v2[i]
        assert outcome.velocities == pytest.approx(expected, abs=1e-10, rel=0)
        assert outcome.status == batch.status[i]
        if frozen is not None:
            assert tuple(NAMES[states] for states in outcome.states) == batch.states(i)
            outcome = solve_column(Column((1, m), (1, k), (e1, e2), (-1, 0), table=True), law, frozen=True)
            assert outcome.velocities == pytest.approx((frozen.v1[i], frozen.v2[i]), abs=1e-10, rel=0)
            assert outcome.status == frozen.status[i]


def test_the_bistiffness_law_with_frozen_positions_is_the_model():
    rng = np.random.default_rng(5)
    for exponent in [1] * 200 + [1.5] * 20:
        column = random_column(rng, int(rng.integers(2, 9)))
        ours = solve_column(column, "bistiffness", exponent=exponent, frozen=True)
        model = solve_by_the_model(column, exponent=exponent)
        assert ours.velocities == pytest.approx(model.velocities, abs=1e-10, rel=0)
        assert (ours.states, ours.status) == (model.states, model.status)


def compare(seed, count, law, exponent, most, frozen=False):
    rng = np.random.default_rng(seed)
    compared = 0
    while compared < count:
        column = random_column(rng, int(rng.integers(2, most + 1)), least=0.6)
        column = with_gaps(rng, column) if not frozen and rng.integers(2) else column
        ours = solve_column(column, law, exponent=exponent, frozen=frozen)
        if ours.status == "limit" or (ours.grazing_margin or 1) < 1e-3:
            continue  # the integration follows no contact that becomes rigid, and nothing beside a jump
        compared += 1
        b = coefficients_of(column, law, exponent)
        theirs = integrate(column, law, exponent, b, frozen=frozen)
        assert ours.velocities == pytest.approx(theirs, abs=1e-8, rel=0), column
        assert ours.diagnostics.get("velocity_error", 0) < 1e-8


@pytest.mark.parametrize(
    ("law", "exponent", "count", "most"),
    [
        ("kelvin-voigt", 1, 8, 7),
        pytest.param("kelvin-voigt", 1, 6, 10, marks=pytest.mark.slow),
        ("kelvin-voigt", 1.5, 3, 4),
        pytest.param("kelvin-voigt", 1.5, 4, 10, marks=pytest.mark.slow),
        ("hunt-crossley", 1, 3, 4),
        ("hunt-crossley", 1.5, 3, 4),
        ("bistiffness", 1, 4, 4),
        ("bistiffness", 1.5, 2, 3),
    ],
)
def test_an_integration_in_time_agrees(law, exponent, count, most):
    compare(2, count, law, exponent, most)


def test_an_integration_in_time_agrees_where_positions_are_frozen():
    for law, exponent in (("kelvin-voigt", 1), ("kelvin-voigt", 1.5), ("hunt-crossley", 1)):
        compare(6, 4, law, exponent, 6, frozen=True)


@pytest.mark.parametrize("law", LAWS)
def test_momentum_energy_order_reversal_and_a_moving_observer(law):
    rng = np.random.default_rng(4)
    for exponent in [1] * 4 + [1.5] * 4:
        column = with_gaps(rng, random_column(rng, 4))
        outcome = solve_column(column, law, exponent=exponent)
        masses, v = np.array(column.masses), np.array(outcome.velocities)
        assert (np.diff(v) <= 1e-12).all()
        assert masses @ v**2 <= masses @ np.square(column.velocities) * (1 + 1e-12)
        if column.table:
            assert v[-1] >= -1e-12
            continue
        assert masses @ v == pytest.approx(masses @ column.velocities, abs=1e-12)
        back = solve_column(column.reversed(), law, exponent=exponent)
        assert back.velocities == pytest.approx(-v[::-1], abs=1e-9)
        moving = solve_column(
            replace(column, velocities=np.array(column.velocities) + 3), law, exponent=exponent
        )
        assert moving.velocities == pytest.approx(v + 3, abs=1e-9)


def test_a_pair_alone_has_its_restitution_at_any_speed():
    laws = "bistiffness", "kelvin-voigt", "hunt-crossley"
    for law, speed, exponent, e in product(laws, (0.01, 100), (1, 1.5, 2), (0.3, 0.9, 1)):
        pair = Column((2, 3), (1e3,), (e,), (-speed, 0))
        v1, v2 = solve_column(pair, law, exponent=exponent).velocities
        assert (v1 - v2) / speed == pytest.approx(e, abs=1e-10), (law, speed, exponent)


def test_gaps_make_another_collision():
    """Of steel a hundred-thousandth of a diameter does; gaps as long as a collision is deep make single impacts."""
    mass, stiffness, diameter = 0.0638, 1.2165e10, 0.025  # Hertz contacts of steel balls of this diameter
    velocities = []
    for gap in (0, 1e-5 * diameter, 1e-2 * diameter):
        column = Column((mass,) * 5, (stiffness,) * 4, (1,) * 4, (-1, 0, 0, 0, 0), gaps=(gap,) * 4)
        velocities.append(solve_column(column, exponent=1.5).velocities)
    touching, close, apart = np.array(velocities)
    assert np.abs(touching - close).max() > 3e-3
    assert apart == pytest.approx([0, 0, 0, 0, -1], abs=1e-9)


def test_a_touching_pair_beyond_a_gap_waits():
    column = Column((1, 1, 1, 1), (1, 1, 1), (1, 1, 1), (-1, 0, 0, 0), gaps=(0, 3.0, 0))
    outcome = solve_column(column, path=True)
    # Ball 2 comes back, and sends ball 1 off again.
    assert outcome.states == ((1,), (), (2, 3), (3,), (), (1,), ())
    path = outcome.path
    assert path.velocities[-1] == pytest.approx(outcome.velocities)
    assert path.impulses[-1] == pytest.approx(outcome.impulses)
    assert path.forces.max() > 0.4


def in_time_without_events(column, law, duration):
    """Final velocities of Hertz contacts of spring and dashpot: forces of positions alone, nothing watched."""
    balls, b = len(column.masses), coefficients_of(column, law, 1.5)
    assert column.masses == (1,) * balls
    assert column.stiffnesses == (1,) * (balls - 1)

    def motion(_time, state):
        depth, rate = np.maximum(np.diff(state[:balls]), 0), np.diff(state[balls:])
        dashpot = b * rate * (depth**1.5 if law == "hunt-crossley" else depth**0.25)
        force = np.maximum(depth**1.5 + dashpot, 0) * (depth > 0)
        return np.concatenate([state[balls:], np.diff(np.concatenate([[0], force, [0]]))])

    start = np.concatenate([np.zeros(balls), column.velocities])
    done = solve_ivp(motion, (0, duration), start, method="DOP853", rtol=1e-12, atol=1e-14, max_step=0.2)
    assert done.success
    return done.y[balls:, -1]


def test_a_row_of_hertz_contacts_ends_as_in_time_without_events():
    # The last contacts wait for a wave whose load far ahead of it underflows.
    for law, balls, e in (
        ("kelvin-voigt", 18, 0.8),
        ("kelvin-voigt", 30, 0.99),
        ("kelvin-voigt", 30, 1),
        ("kelvin-voigt-textbook", 20, 0.95),
        ("hunt-crossley", 18, 0.95),
    ):
        column = cradle(balls, 1, e=e)
        outcome = solve_column(column, law, exponent=1.5, max_steps=5000)
        assert outcome.status == "ok"
        assert outcome.diagnostics["velocity_error"] < 1e-9
        assert sum(outcome.velocities) == pytest.approx(-1, abs=1e-12)
        expected = in_time_without_events(column, law, outcome.diagnostics["duration"] + 1)
        assert outcome.velocities == pytest.approx(expected, abs=1e-9, rel=0), (law, balls, e)


@pytest.mark.parametrize("law", LAWS)
def test_long_rows_end_at_every_exponent(law):
    # The higher the exponent, the faster a load grows from nothing: cubics through the ends of a step are wrong by far.
    for exponent, (balls, e) in product((1.5, 2, 3), ((24, 0.95), (18, 0.05))):
        if law == "bistiffness":
            e = 1.0  # no contact becomes rigid
        outcome = solve_column(cradle(balls, 2, e=e), law, exponent=exponent, max_steps=20_000)
        assert outcome.status == "ok", (exponent, balls)
        v = np.array(outcome.velocities)
        assert v.sum() == pytest.approx(-2, abs=1e-11)
        assert (np.diff(v) <= 1e-9).all()
        assert v @ v <= 2 * (1 + 1e-9)


def test_ratios_beyond_double_precision_end_with_a_status():
    far = Column((1e74, 1, 1e-75), (1, 1), (0.9, 0.9), (-1, 0, 0))
    for law in LAWS:
        assert solve_column(far, law, exponent=1.5, max_steps=1000).status == "timeout"
        refused = solve_column(Column((1e300, 1e-300), (1,), (0.9,), (-1, 0)), law, exponent=1.5)
        assert refused.status == "unrepresentable"
        assert "masses from 1e-300 to 1e+300: where one exceeds 1e+150 times another" in refused.reason


def test_what_is_refused():
    column = cradle(3, 1)
    with pytest.raises(ValueError, match=r"law = 'hertz'; legal: bistiffness, kelvin-voigt"):
        solve_column(column, "hertz")
    with pytest.raises(ValueError, match=r"exponent = 0\.5; legal: from 1"):
        solve_column(column, exponent=0.5)
    with pytest.raises(ValueError, match=r"gaps\[2\] = -1\.0; legal: finite numbers >= 0"):
        replace(column, gaps=(0, -1))
    with pytest.raises(ValueError, match=r"gaps: 1 values; legal: 2, for 3 balls without a table"):
        replace(column, gaps=(0,))
    with pytest.raises(ValueError, match=r"gaps = \(0\.1, 0\.1\): the model has no positions; legal: 0"):
        solve_by_the_model(cradle(3, 1, 0.1))
    with pytest.raises(ValueError, match=r"gaps = \(0\.1, 0\.1\); legal where positions are frozen: none"):
        solve_column(cradle(3, 1, 0.1), frozen=True)
    plastic = solve_column(replace(column, restitutions=(1, 0)))
    assert (plastic.status, plastic.reason[:24]) == ("unrepresentable", "restitutions[2] = 0.0: n")
    assert solve_column(column, max_steps=1).status == "timeout"


def test_a_solver_refuses_by_name_what_it_cannot_represent():
    for solver, settings, exponent, says in (
        ("kelvin-voigt-anchored", Settings(), 1, "kelvin-voigt-anchored is a law of two balls on a table"),
        ("bistiffness", Settings(scenario="drop"), 1, "scenario = 'drop'"),
        ("mujoco", Settings(), 1.5, "exponent = 1.5: the contacts of an engine are linear"),
    ):
        with pytest.raises(SolverError, match=says):
            get_solver(solver).solve_column(cradle(3, 1), settings, exponent)


#: All of 8 balls fall together, elastic: 585 events. By Taylor series in 40 and in 60 digits, which agree in these ten.
STACK = Column(
    tuple(0.5**i for i in range(8)), tuple(3.0**i for i in range(8)), (1.0,) * 8, (-1.0,) * 8, table=True
)
TRUTH = (1.09328, 1.05188, 0.81421, 0.65294, 0.59658, 0.23538, 0.21022, 0.03787)

TAME = Column((1.0, 0.5, 0.25), (1e5, 2e5, 4e5), (0.9, 0.8, 1.0), (-1.0, -1.0, -1.0), table=True)


def test_what_rounding_decides_is_marked():
    for law in ("bistiffness", "kelvin-voigt"):
        (outcome,) = get_solver(law).solve_columns([STACK], Settings(scenario="impact"))
        assert outcome.status == "ok"
        assert np.abs(np.subtract(outcome.velocities, TRUTH)).max() > 0.1  # which is why
        assert outcome.marked.startswith(
            "a change of 1e-06 in masses and stiffnesses moves the exact outcome"
        )


def test_what_it_does_not_decide_is_not():
    for law in ("bistiffness", "kelvin-voigt", "kelvin-voigt-textbook", "hunt-crossley"):
        (outcome,) = get_solver(law).solve_columns([TAME], Settings(scenario="impact"))
        assert (outcome.status, outcome.marked) == ("ok", ""), law
        for other in changed(TAME):
            assert other.velocities == TAME.velocities
            away = np.abs(np.subtract(solve_column(other, law).velocities, outcome.velocities)).max()
            assert away < MOVED, law


def test_an_error_that_is_stated_marks_too():
    outcome = solve_column(STACK, "hunt-crossley", exponent=1.5)
    assert outcome.diagnostics["velocity_error"] > 1e-3
    (marked,) = mark_columns([outcome], [STACK], "hunt-crossley", 1.5)
    assert marked.marked.startswith("its own error moves")


@pytest.mark.slow
def test_an_engine_is_marked_where_its_exact_law_is():
    column = Column(STACK.masses[:6], STACK.stiffnesses[:6], (1.0,) * 6, STACK.velocities[:6], table=True)
    settings = Settings(scenario="impact", step_fraction=0.05)
    (exact,) = get_solver("kelvin-voigt").solve_columns([column], settings)
    (engine,) = get_solver("mujoco").solve_columns([column], settings)
    (tame,) = get_solver("mujoco").solve_columns([TAME], settings)
    assert engine.marked == exact.marked != ""
    assert tame.marked == ""
