"""Conformance checks for solvers.

Solvers that keep the contract pass. A mutant is a solver that was changed to break the contract in one way. The check
that must find it is named beside it.
"""

import dataclasses

import pytest

from impact_xval.compliant_baselines import get_solver
from impact_xval.compliant_baselines.conformance import checks, problems
from impact_xval.compliant_baselines.references import ReferenceSolver
from impact_xval.compliant_baselines.registry import law_name_of
from impact_xval.model.graph import GraphCollisionOutcome
from tests.compliant_baselines.conftest import installed

pytestmark = pytest.mark.smoke


SLOW = [
    pytest.param("drake", marks=pytest.mark.slow),
    pytest.param("drake-hunt-crossley", marks=pytest.mark.nightly),
]


@pytest.mark.parametrize(
    "name", ["kelvin-voigt", "mujoco", "pybullet", "hunt-crossley", "bistiffness", "state-transition", *SLOW]
)
def test_our_own_solvers_conform_and_have_the_law_the_registry_says(name):
    assert problems(installed(name), law_name_of(name)) == {}


class Mutant(ReferenceSolver):
    """A solver that keeps the contract. Tests change one of its methods to break it."""

    def solve_many(self, collisions, settings):
        return self.change(
            [
                dataclasses.replace(o, solver="mutant")
                for o in get_solver(self.exact).solve_many(collisions, settings)
            ]
        )

    def solve_graphs(self, collisions, settings):
        return get_solver(self.exact).solve_graphs(collisions, settings)

    name, exact = "mutant", "kelvin-voigt"

    def change(self, outcomes):
        return outcomes


def each(**values):
    def change(self, outcomes):
        return [
            dataclasses.replace(o, **{k: f(o) for k, f in values.items()})
            if (o.status, len(o.velocities)) == ("ok", 2)
            else o
            for o in outcomes
        ]

    return {"change": change}


def silent(self, outcomes):
    # For an outcome that has neither a result nor a reason, the constructor of `Outcome` raises a ValueError.
    return [dataclasses.replace(o, reason="") for o in outcomes]


def remembering(self, outcomes):
    type(self).calls = getattr(type(self), "calls", 0) + 1
    return each(velocities=lambda o: (o.v1 * (1 + 1e-12 * type(self).calls), o.v2))["change"](self, outcomes)


def with_units(self, collisions, settings):
    # multiplies k1 by m1, so that outcomes depend on the unit of mass
    made = [dataclasses.replace(c, stiffnesses=(c.k1 * c.m1, c.k2)) for c in collisions]
    return Mutant.solve_many(self, made, settings)


def heavy(self, collisions, settings):
    return Mutant.solve_many(self, collisions, dataclasses.replace(settings, gravity=2 * settings.gravity))


def raising(self, collisions, settings):
    if any(c.e1 == 0 for c in collisions):
        raise ValueError("e1 = 0")
    return Mutant.solve_many(self, collisions, settings)


MUTANTS = {
    "unsigned": (each(solver=lambda o: "x"), "answers_every_collision"),
    "reversed": ({"change": lambda self, outcomes: outcomes[::-1]}, "answers_every_collision"),
    "remembering": ({"change": remembering}, "answers_every_collision"),
    "raising": ({"solve_many": raising}, "refuses_with_a_reason"),
    "silent": ({"change": silent}, "refuses_with_a_reason"),
    "sinking": (each(velocities=lambda o: (o.v1, -o.v2)), "ends_apart_and_creates_no_energy"),
    "impulsive": (
        each(impulses=lambda o: (o.impulse1, 1.01 * o.impulse2)),
        "ends_apart_and_creates_no_energy",
    ),
    "stateless": (each(states=lambda o: o.states[:-1]), "ends_apart_and_creates_no_energy"),
    "unitless": ({"solve_many": with_units}, "scales"),
    "pathless": (each(path=lambda o: None), "gives_a_path"),
    "other-law": ({"exact": "hunt-crossley"}, "converges_to_kelvin_voigt"),
    "heavy": ({"solve_many": heavy}, "converges_to_kelvin_voigt"),
    "nameless": ({"name": " "}, "names_itself"),
    "versionless": ({"version": lambda self: None}, "names_itself"),
}


def test_the_mutant_conforms_unchanged():
    assert problems(Mutant()) == {}


def test_contact_graphs_are_answered_or_refused_with_a_reason(monkeypatch):
    monkeypatch.setattr(Mutant, "solve_graphs", lambda self, collisions, settings: [])
    assert problems(Mutant()) == {"refuses_with_a_reason": "0 outcomes for 2 contact graphs"}

    def crash(self, collisions, settings):
        return [GraphCollisionOutcome.failure("mutant", c, "crashed", "no normals") for c in collisions]

    monkeypatch.setattr(Mutant, "solve_graphs", crash)
    assert problems(Mutant())["refuses_with_a_reason"].endswith("no normals")


def test_every_way_of_breaking_the_contract_is_caught():
    for kind, (body, caught_by) in MUTANTS.items():
        found = problems(type("Broken", (Mutant,), dict(body))())
        assert caught_by in found, (kind, found)


def test_an_unknown_law_is_refused_by_name():
    with pytest.raises(ValueError, match=r"law = 'hertz'; legal: .*kelvin-voigt.*, none"):
        checks("hertz")


def test_the_command_prints_what_it_found(command, refused):
    assert command("solvers kelvin-voigt").count("passed  ") == len(checks())
    said = command("solvers kelvin-voigt-textbook --law kelvin-voigt", ends=3)
    assert "FAILED  converges to kelvin voigt: " in said
    refused("solvers mujoco --law hertz")
