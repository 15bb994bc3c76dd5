"""Outcomes, paths, tables of runs and tables of the hypothesis, compared with golden values."""

import pytest

from tests.golden import adapter, values


def report(misses, most=20):
    more = f"\n... and {len(misses) - most} more" if len(misses) > most else ""
    assert not misses, f"{len(misses)} golden values moved:\n" + "\n".join(misses[:most]) + more


def rows(name, solver):
    problems = {problem["name"]: problem for problem in values.read(f"inputs/{name}.jsonl")}
    found = [row for row in values.read(f"values/{name}.jsonl") if solver in (None, row["solver"])]
    assert [row["input"] for row in found] == [*problems]
    return [(problems[row["input"]], row) for row in found]


def skip_without(*engines):
    for engine in engines:
        if reason := adapter.unavailable(engine):
            pytest.skip(reason)


KERNELS = {"two-balls": "pair", "chains": "chain"}


@pytest.mark.parametrize(
    ("name", "solver"), [(name, solver) for name in KERNELS for solver in adapter.EXACT[KERNELS[name]]]
)
def test_exact_solvers(name, solver):
    found = ((problem, row, adapter.solve(problem, solver)) for problem, row in rows(name, solver))
    report([text for each in found for text in values.exact_misses(*each)])


def test_paths():
    found = ((p, row, adapter.solve(p, row["solver"], path=True)) for p, row in rows("paths", None))
    report([text for each in found for text in values.path_misses(*each)])


@pytest.mark.parametrize("engine", adapter.ENGINES)
def test_engines(engine):
    skip_without(engine)
    found = ((problem, row, adapter.solve(problem, engine)) for problem, row in rows("engines", engine))
    report([text for each in found for text in values.engine_misses(*each)])


@pytest.mark.parametrize("run", ["two-balls", "chains"])
def test_tables_of_a_run(run, tmp_path):
    skip_without(*adapter.ENGINES)
    found = adapter.tables(values.spec("tables")[run], tmp_path)
    report([text for name in found for text in values.table_misses(f"tables-{run}-{name}", found[name])])


@pytest.mark.parametrize("design", ["small", pytest.param("full", marks=pytest.mark.nightly)])
def test_hypothesis(design, tmp_path):
    found = adapter.hypothesis(values.spec("hypothesis")[design], tmp_path)
    report(
        [text for name in found for text in values.table_misses(f"hypothesis-{design}-{name}", found[name])]
    )
