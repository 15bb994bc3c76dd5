import pytest

from impact_xval.experiments.config.experiment import parse_config
from impact_xval.experiments.presentation.report import present
from impact_xval.experiments.sweep.run import run_sweep

COLUMNS = {
    "name": "few columns",
    "solvers": ["bistiffness", "kelvin-voigt", "mujoco"],
    "column": {"arrangement": ["cradle", "drop"], "balls": [2, 3, 4], "e": [0.6, 0.9], "exponent": [1.0, 1.5]}
    | {"stiffness_taper": 1.0},
    "figure_column": {"balls": 4, "e": 0.8},
}


@pytest.fixture(scope="session")
def column_run(tmp_path_factory):
    """A small run of columns, half of which no engine represents, with its page; no test changes it."""
    root = tmp_path_factory.mktemp("columns") / "run"
    run_sweep(parse_config(COLUMNS), root, isolate=False, present=present)
    return root
