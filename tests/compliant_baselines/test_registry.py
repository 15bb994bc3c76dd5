import subprocess
import sys

import pytest

from compliant_baselines import Solver, get_solver, solver_names

FIRST = ("state-transition", "mujoco", "pybullet")


def test_names_come_in_the_order_of_the_tables():
    assert tuple(n for n in solver_names() if n in FIRST) == FIRST


@pytest.mark.parametrize("name", FIRST)
def test_a_solver_answers_to_its_name_and_keeps_the_protocol(name):
    solver = get_solver(name)
    assert solver.name == name
    assert isinstance(solver, Solver)


def test_unknown_name_is_named_with_the_known_ones():
    with pytest.raises(ValueError, match=r"solver 'bullet' is unknown; known: .*mujoco.*pybullet"):
        get_solver("bullet")


def test_engines_are_not_imported_before_they_are_asked_to_run():
    code = (
        "import sys, compliant_baselines as b; [b.get_solver(n) for n in b.solver_names()];"
        "print([m for m in ('mujoco', 'pybullet') if m in sys.modules])"
    )
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert out.strip() == "[]"
