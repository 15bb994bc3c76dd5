"""The filter that leaves states out of a sequence if they are too short. A state is a set of active contacts.

The rules of the filter are tested with sequences made by hand, and with the paths of solvers.
"""

import numpy as np

from impact_xval.compliant_baselines import get_solver
from impact_xval.compliant_baselines.engines.scene import periods
from impact_xval.compliant_baselines.solver import Settings
from impact_xval.compliant_baselines.states import Runs, comparable_states, merge_runs
from impact_xval.model import Collision
from impact_xval.model.path import Paths
from tests.compliant_baselines.reference_cells import random_collisions

#: The states S1 to S4 as bit sets of active contacts, from index 1.
SETS = np.array([-1, 0b11, 0b10, 0b01, 0])


def runs(pairs, unit=1):
    ends = np.cumsum([0, *(n * unit for _, n in pairs)])
    return Runs(ends[:-1], SETS[[s for s, _ in pairs]], ends[-1])


RULES = [
    # rule 1: a contact counts as active until it first carries force
    ([(4, 2), (3, 9), (1, 50), (2, 40), (4, 1)], "S1 S2 S4"),
    ([(2, 9), (1, 50), (3, 40), (4, 1)], "S1 S3 S4"),
    # rule 2: a state that is too short is joined to the state before it
    ([(1, 50), (3, 2), (1, 30), (2, 40), (4, 1)], "S1 S2 S4"),
    ([(1, 50), (3, 3), (1, 30), (2, 40), (4, 1)], "S1 S3 S1 S2 S4"),
    # several short states in a row are joined to one
    ([(1, 50), (3, 1), (1, 1), (3, 2), (1, 2), (2, 40), (4, 1)], "S1 S2 S4"),
    # short states in a row that are equal after rule 1 count as one state with their total length
    ([(4, 1), (3, 1), (1, 1), (2, 40), (4, 1)], "S1 S2 S4"),
    # a free flight between contacts is kept
    ([(1, 50), (2, 40), (4, 10), (3, 30), (4, 1)], "S1 S2 S4 S3 S4"),
    # B2 stays on the table: the sequence still ends with S4
    ([(1, 50), (2, 40)], "S1 S2 S4"),
    # contact 2 alone is never active
    ([(3, 50), (4, 1)], "S1 S3 S4"),
    # the run broke off in its first step, so that the sequence is empty
    ([], "S1 S4"),
]


def test_the_rules_hold_in_steps_and_in_time():
    for unit in (1, 1e-7):
        for pairs, names in RULES:
            assert merge_runs(runs(pairs, unit), 2.5 * unit, 0b11).names(True) == tuple(names.split()), (
                unit,
                pairs,
            )
    # nothing is joined if no state is too short
    raw = runs([(1, 5), (3, 1), (1, 1), (2, 1), (4, 1)])
    assert merge_runs(raw, 0, 0b11).names(True) == ("S1", "S3", "S1", "S2", "S4")


def compared(outcome, collision):
    paths, shortest = Paths.of([outcome.path], 2, 2), Settings().shortest_state * min(periods(collision))
    return tuple(comparable_states(paths, np.array([shortest]))[0].split())


def test_the_states_of_an_engine_are_those_it_is_compared_by(engine):
    cells = random_collisions(6, 6, lowest_e=0.05, decades=(3, 1), v0=-2.0)
    for scenario, fraction in (("impact", 1e-3), ("impact", 5e-4), ("drop", 1e-3), ("drop", 5e-4)):
        settings = Settings(scenario=scenario, step_fraction=fraction, record_path=True)
        for c, o in zip(cells, engine.solve_many(cells, settings), strict=True):
            assert compared(o, c) == o.states, (scenario, fraction, c)


def test_the_states_of_an_engine_do_not_depend_on_its_step():
    """A state that is too short in the exact solution is dropped from the engine's states at every step, too.

    S2 lasts 5e-4 of a period here: five of the shortest steps, and none of the longest.
    """
    c = Collision.two_balls(1.0, 0.5, 1e8, 1e8 * 10**1.5, 0.9, 0.5)
    exact = get_solver("kelvin-voigt").solve(c, Settings(record_path=True))
    assert exact.states == ("S1", "S2", "S4")
    for fraction in (1e-3, 5e-4, 2.5e-4, 1e-4):
        outcome = get_solver("mujoco").solve(c, Settings(step_fraction=fraction))
        assert outcome.states == compared(exact, c) == ("S1", "S4")
