"""Outcomes and paths of collisions against golden values."""

from collections import defaultdict
from functools import cache

import pytest

from tests.golden import adapter, values


@cache
def problems(name):
    return {problem["name"]: problem for problem in values.read(f"inputs/{name}.jsonl")}


@cache
def goldens(name):
    found = defaultdict(list)
    for row in values.read(f"values/{name}.jsonl"):
        found[row["solver"]].append(row)
    return found


def report(misses, most=20):
    more = f"\n... and {len(misses) - most} more" if len(misses) > most else ""
    assert not misses, f"{len(misses)} golden values moved:\n" + "\n".join(misses[:most]) + more


@pytest.mark.parametrize(
    ("name", "solver"),
    [
        (name, s)
        for name, kernel in (("two-balls", "pair"), ("lines", "chain"))
        for s in adapter.EXACT[kernel]
    ],
)
def test_exact_solvers(name, solver):
    rows = goldens(name)[solver]
    assert [row["input"] for row in rows] == list(problems(name))
    misses = []
    for row in rows:
        problem = problems(name)[row["input"]]
        misses += values.exact_misses(problem, row, adapter.solve(problem, solver))
    report(misses)


def test_paths():
    misses = []
    for rows in goldens("paths").values():
        for row in rows:
            problem = problems("paths")[row["input"]]
            misses += values.path_misses(problem, row, adapter.solve(problem, row["solver"], path=True))
    report(misses)


@pytest.mark.parametrize("engine", adapter.ENGINES)
def test_engines(engine):
    if reason := adapter.unavailable(engine):
        pytest.skip(reason)
    same = values.provenance("engines") == adapter.fingerprint()
    misses = []
    for row in goldens("engines")[engine]:
        problem = problems("engines")[row["input"]]
        misses += values.engine_misses(problem, row, adapter.solve(problem, engine), same_machine=same)
    report(misses)
