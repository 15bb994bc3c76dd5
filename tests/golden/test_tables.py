"""Tables of runs, and of the hypothesis, against golden values."""

import pytest

from tests.golden import adapter, values
from tests.golden.test_collisions import report


@pytest.mark.parametrize("run", ["two-balls", "lines"])
def test_tables_of_a_run(run, tmp_path):
    for engine in adapter.ENGINES:
        if reason := adapter.unavailable(engine):
            pytest.skip(reason)
    found = adapter.tables(values.spec("tables")[run], tmp_path)
    report([text for name in found for text in values.table_misses(f"tables-{run}-{name}", found[name])])


@pytest.mark.parametrize("design", ["small", pytest.param("full", marks=pytest.mark.nightly)])
def test_hypothesis(design, tmp_path):
    found = adapter.hypothesis(values.spec("hypothesis")[design], tmp_path)
    report(
        [text for name in found for text in values.table_misses(f"hypothesis-{design}-{name}", found[name])]
    )
