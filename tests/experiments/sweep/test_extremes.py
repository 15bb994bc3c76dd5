"""Legal extremes end as legal input does; ``python -m tests.experiments.extremes`` draws hundreds."""

import pytest

from tests.experiments.extremes import extremes


@pytest.mark.slow
def test_legal_extremes_are_run_and_called_without_a_traceback(tmp_path):
    counts, problems = extremes(tmp_path, configurations=2, calls=4, seed=3)
    assert problems == []
    assert counts.total() == 6
