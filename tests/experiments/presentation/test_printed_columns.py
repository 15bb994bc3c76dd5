"""What docs/columns.md, section 9, prints of a run of columns, held against the run of the experiment it prints."""

import re
import tomllib
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from impact_xval.experiments.config.experiment import parse_config
from impact_xval.experiments.sweep.run import run_sweep

PAGE = (Path(__file__).parents[3] / "docs" / "columns.md").read_text(encoding="utf-8")
FILE = tomllib.loads(PAGE.partition("<!-- experiment -->\n```toml\n")[2].partition("```")[0])


def test_medians_are_what_the_page_prints(tmp_path):
    """Of the references, which are exact; without engines the run takes seconds."""
    run_sweep(
        parse_config(FILE | {"solvers": ["bistiffness", "kelvin-voigt"]}), tmp_path / "a", isolate=False
    )
    table = pq.read_table(tmp_path / "a/divergence.parquet").to_pandas()
    medians = (
        table[table.marked.isna()].groupby(["arrangement", "solver", "balls"]).velocity_divergence.median()
    )
    rows = re.findall(r"^\| (\w+), `([\w-]+)` \| (.*) \|$", PAGE.partition("<!-- medians -->")[2], re.M)
    assert len(rows) == 6
    for arrangement, solver, numbers in rows:
        found = [medians[arrangement, solver, n] for n in (2, 3, 5, 10)]
        assert [float(number) for number in numbers.split(" | ")] == pytest.approx(found, abs=5.1e-4)
    assert len(table) == 2 * 216
    (worst,) = re.findall(r"the most is ([\d.]+), of ten balls that fall together at e = 0.6", PAGE)
    assert float(worst) == pytest.approx(table.velocity_divergence.max(), abs=5.1e-4)
