"""Solvers that were asked for one law are one vote on it."""

from impact_xval.compliant_baselines.registry import law_of, solver_names
from impact_xval.experiments.measures.laws import by_law, in_order_of_laws, voters


def test_solvers_are_grouped_by_the_law_that_the_registry_says():
    assert by_law(["mujoco", "bistiffness", "pybullet", "kelvin-voigt"]) == {
        "kelvin-voigt": ["kelvin-voigt", "mujoco", "pybullet"],
        "bistiffness": ["bistiffness"],
    }
    names = solver_names(on_request=True)
    assert sorted(in_order_of_laws(names)) == sorted(names)
    # One without a law is a vote of its own.
    assert len(voters(names)) == len({law_of(name) or name for name in names})
    assert voters(["pybullet", "mujoco"]) == ["pybullet"]
