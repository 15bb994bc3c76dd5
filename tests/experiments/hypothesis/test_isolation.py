"""A solver that crashes or hangs costs the collisions it does so at, with a status and a reason, and nothing else."""

import numpy as np
import pytest

from impact_xval.experiments.hypothesis.config import parse
from impact_xval.experiments.hypothesis.run import run_hypothesis
from impact_xval.experiments.hypothesis.tables import outcome_frame, point_frame
from tests.experiments import faulty


@pytest.mark.slow
def test_a_run_survives_and_its_tables_say_what_failed_and_why():
    """The range of contrasts is too short for two: one collision a point."""
    config = parse(
        {
            "points": 6,
            "solvers": ["mujoco"],
            "contrast": [10, 11],
            "plastic_contrast": [10, 11],
            "map": {"size": 4, "stiffness_ratio": [0.1, 10], "restitutions": [[0.9, 0.7]]},
            "point": [{"case": "zero-late", "mass_ratio": 2.0, "e1": faulty.SEGFAULT, "e2": 0.7}],
        },
        "test",
    )
    results = run_hypothesis(config, workers=1, resolve=faulty.faulty)
    outcomes = outcome_frame(results)
    assert len(outcomes) == 6 * 6 + 1
    lost = outcomes[~outcomes.status.isin(["ok", "limit"])]
    assert lost[["case", "e1", "status", "reason"]].to_numpy().tolist() == [
        ["zero-late", faulty.SEGFAULT, "crashed", "its process died: SIGSEGV"]
    ]
    assert np.isnan(lost[["v1", "v2"]].to_numpy()).all()
    points = point_frame(results)
    said = points[points.without_result != ""]
    assert said[["case", "e1", "verdict", "without_result"]].to_numpy().tolist() == [
        ["zero-late", faulty.SEGFAULT, "undecided", "1 of 1 crashed: its process died: SIGSEGV"]
    ]
