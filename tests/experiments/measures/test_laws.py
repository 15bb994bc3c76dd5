"""Solvers that were asked for one law are one vote on it; how far an engine is from its law depends on the step."""

from pathlib import Path

import numpy as np
import pytest

from benchmarks import steps
from impact_xval.compliant_baselines import get_solver
from impact_xval.compliant_baselines.contract.registry import law_of, solver_names
from impact_xval.experiments.measures.laws import by_law, in_order_of_laws, voters

ROOT = Path(__file__).parents[3]


def test_solvers_are_grouped_by_the_law_that_the_registry_says():
    assert by_law(["mujoco", "bistiffness", "pybullet", "kelvin-voigt", "oracle"]) == {
        "kelvin-voigt": ["kelvin-voigt", "mujoco", "pybullet"],
        "bistiffness": ["bistiffness"],
        "state-transition": ["oracle"],
    }
    names = solver_names(on_request=True)
    assert sorted(in_order_of_laws(names)) == sorted(names)
    assert len(voters(names)) == len({law_of(name) for name in names})
    assert voters(["pybullet", "mujoco"]) == ["pybullet"]


def test_an_engine_is_further_from_its_law_at_longer_steps():
    reason = get_solver("mujoco").unavailable()
    if reason is not None:
        pytest.skip(reason)
    D, failed = steps.distances("mujoco", steps.sample(8, 3), (1e-2, 0.1))
    assert D.shape == (2, 8)
    assert not failed[0]
    assert np.nanmedian(D[1]) > 4 * np.nanmedian(D[0])


@pytest.mark.nightly
def test_the_table_of_longer_steps_is_what_the_benchmark_measures(capsys):
    text = (ROOT / "docs/convergence.md").read_text(encoding="utf-8")
    for label, name in (("MuJoCo", "mujoco"), ("PyBullet", "pybullet")):
        solver = get_solver(name)
        if (
            solver.unavailable() is not None
            or f"{label} {solver.version()}" not in text.split("## Longer steps")[1]
        ):
            pytest.skip(f"the table is of another {label}")
    steps.main(["--cells", "208", "--seed", "1"])
    found = [line for line in capsys.readouterr().out.splitlines() if line.startswith("|")]
    printed = text.split("<!-- steps -->\n")[1].split("\n\n")[0].splitlines()
    assert len(found) == len(printed) == 10
    for line, expected in zip(found[2:], printed[2:], strict=True):
        (engine, *numbers), (named, *others) = (row.strip("| ").split(" | ") for row in (line, expected))
        assert engine == named
        assert [float(x) for x in numbers] == pytest.approx([float(x) for x in others], rel=0.02)
