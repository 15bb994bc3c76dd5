"""The check of what a solver returns or raises: each collision gets one outcome that can be printed."""

import dataclasses
import math

import pytest

from impact_xval.compliant_baselines import Settings, get_solver
from impact_xval.compliant_baselines.answers import answer
from impact_xval.compliant_baselines.solver import Convergence, OneByOne, Solver
from impact_xval.model.collision import Collision
from impact_xval.model.outcome import Outcome

CELL = Collision.two_balls(m1=1.0, m2=1.5, k1=1e6, k2=2e6, e1=0.9, e2=0.7)
CHAIN = Collision((1.0, 1.0, 1.0), (1e6, 1e6), (0.9, 0.9), (-1.0, 0.0, 0.0))


def test_illegal_settings_are_named_with_the_legal_range():
    for kind, field, values, legal in (
        (Settings, "scenario", ["bounce"], "'impact' or 'drop'"),
        (Settings, "gravity", [0.0, math.inf, math.nan], "a finite number > 0"),
        (Settings, "step_fraction", [0.0, 0.21, math.nan], "greater than 0, at most 0.2"),
        (Settings, "max_steps", [0], "a whole number >= 1"),
        (Settings, "mapping", ["default"], "one of calibrated, naive, documented, shipped"),
        (Settings, "shortest_state", [-0.001, 0.2, math.nan], "from 0 to 0.1"),
        (Settings, "stiffness_ratio_cutoff", [1.0], "greater than 1, up to inf"),
        (Convergence, "tolerance", [0.0, math.nan], "greater than 0"),
        (Convergence, "halvings", [-1], "a whole number from 0 to 10"),
    ):
        for value in values:
            with pytest.raises(ValueError, match=rf"{field} = {value!r}; legal: {legal}"):
                kind(**{field: value})


class Mine(Solver):
    name = "mine"

    def __init__(self, made):
        self.made = made

    def version(self):
        return "1"

    def solve_many(self, collisions, settings):
        return self.made(collisions)


def test_a_solver_that_fails_gives_each_collision_a_crashed_outcome():
    for made, says in (
        (lambda asked: 1 / 0, "ZeroDivisionError: division by zero"),
        (lambda asked: asked[1:], "RuntimeError: 0 outcomes for 1 collisions"),
        (lambda asked: None, "TypeError: 'NoneType' object is not iterable"),
        (lambda asked: [1] * len(asked), "AttributeError: 'int' object has no attribute 'velocities'"),
        (
            lambda asked: [Outcome("mine", (0.0,), (0.0,)) for _ in asked],
            "velocities, impulses: 1, 1 values; legal: {}",
        ),
    ):
        outcomes = answer(Mine(made), [CELL, CHAIN], Settings())
        assert [(o.status, o.reason) for o in outcomes] == [
            ("crashed", says.format(legal)) for legal in ("2, 2", "3, 2")
        ]
        assert [len(o.velocities) for o in outcomes] == [2, 3]


def test_collisions_that_go_wrong_spoil_no_other():
    class Fussy(OneByOne):
        name = "fussy"

        def version(self):
            return "1"

        def solve_one(self, collision, settings):
            if collision.e1 == 0.5:
                raise ValueError("not\nthis\x1b one")
            if collision.e1 == 0.6:
                return Outcome("fussy", (math.nan, 0.0), (0.0, 0.0))
            return get_solver("state-transition").solve(collision)

    cells = [dataclasses.replace(CELL, restitutions=(e1, 0.7)) for e1 in (0.9, 0.5, 0.8, 0.6, 0.7)]
    outcomes = answer(Fussy(), cells, Settings())
    assert [o.status for o in outcomes] == ["ok", "crashed", "ok", "crashed", "ok"]
    assert outcomes[1].reason == r"ValueError: not this\x1b one"
    assert "velocities[1] = nan" in outcomes[3].reason
    exact = get_solver("state-transition").solve_many(cells[::2], Settings())
    assert [o.v1 for o in outcomes[::2]] == [o.v1 for o in exact]
    with pytest.raises(ValueError, match="not"):
        Fussy().solve(cells[1])


def test_hostile_texts_of_a_solver_are_escaped():
    says = "not\n\x1b\u202etoday"
    refused = Mine(lambda asked: [Outcome.failure("mine", c, "unrepresentable", says) for c in asked])
    assert answer(refused, [], Settings()) == []
    assert [each.reason for each in answer(refused, [CELL], Settings())] == [r"not \x1b\u202etoday"]
