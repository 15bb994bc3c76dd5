"""What docs/hypothesis.md prints, held against the built-in test of the exact solvers."""

from pathlib import Path

import pytest

from impact_xval.experiments.hypothesis.cases import CASES
from impact_xval.experiments.hypothesis.page import over_places, reached, span
from impact_xval.experiments.hypothesis.run import run_hypothesis
from tests.experiments.hypothesis.test_physics import SOLVERS, config

PAGE = (Path(__file__).parents[3] / "docs" / "hypothesis.md").read_text(encoding="utf-8")


@pytest.mark.nightly
def test_the_tables_are_those_of_a_run(tmp_path):
    results = run_hypothesis(config(), tmp_path)
    wholes = results.verdicts[results.verdicts["class"] == "all"].set_index(["case", "solver"], drop=False)
    rows = []
    for case in CASES:
        cells = []
        for solver in SOLVERS:
            row = wholes.loc[case.key, solver]
            far = f", {span((row.offset_least, row.offset_largest))}" if row.verdict == "refuted" else ""
            cells.append(f"{row.verdict}, {reached(row)}{far}")
        rows.append(f"| `{case.key}` | {' | '.join(cells)} |")
    for row in over_places(results).itertuples():
        cells = [f"{n} of {row.points}" for n in (row.n_supported, row.n_refuted)]
        cells.append(span((row.least_rate, row.largest_rate), ".2f") if row.n_supported else "-")
        cells.append(span((row.offset_least, row.offset_largest)) if row.n_refuted else "-")
        first = "meet" if row.meets else "one velocity"
        rows.append(f"| `{row.solver}` | {first} | {' | '.join(cells)} |")
    stale = [row for row in rows if row not in PAGE]
    assert not stale, "docs/hypothesis.md prints other rows than:\n" + "\n".join(stale)
