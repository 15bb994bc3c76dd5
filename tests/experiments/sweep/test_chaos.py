"""Faults at random instants of real runs, and in their folders; the tables are those of a run left alone.

``python -m tests.experiments.chaos --faults 200`` draws two hundred.
"""

import pytest

from tests.experiments.chaos import chaos


@pytest.mark.exhaustive
def test_twenty_faults_change_no_byte_and_leave_nothing_behind(tmp_path):
    drawn, problems = chaos(tmp_path, faults=20, seed=6)
    assert problems == []
    assert drawn.total() == 20
    assert len(drawn) >= 8  # of fifteen kinds
