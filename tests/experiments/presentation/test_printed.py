"""Numbers printed in docs/ladder.md and docs/chains.md, section 9, compared with the runs that they are from."""

import re
import tomllib
from pathlib import Path

import pandas as pd
import pytest

from impact_xval.compliant_baselines import get_solver
from impact_xval.experiments.config.experiment import parse_config
from impact_xval.experiments.measures.summary import summarise
from impact_xval.experiments.presentation.report import write_tables
from impact_xval.experiments.sweep.run import run_sweep

DOCS = Path(__file__).parents[3] / "docs"
LADDER, CHAINS = ((DOCS / name).read_text(encoding="utf-8") for name in ("ladder.md", "chains.md"))
ROWS = {
    "MuJoCo": "mujoco",
    "PyBullet": "pybullet",
    "Kelvin-Voigt contacts, exact": "kelvin-voigt",
    "the model's own impact law in real time, exact (`bistiffness`)": "bistiffness",
}
ENGINES = ("MuJoCo", "PyBullet")
#: How much D or a share may change with another version of an engine. If it changes more, the page must be printed
#: anew.
NEW_VERSION = 0.01
BANDS = {"k2/k1 < 0.1": 0.0, "0.1 to 10": 0.1, "k2/k1 > 10": 10.0}
RUNGS = ("frozen_positions", "dissipation_law", "gravity", "mapping", "discretisation")


def as_printed(cell, more=0.0):
    """Return the numbers in a printed cell, each with a tolerance of half a unit of its last digit, plus `more`."""
    scale = 0.01 if "%" in cell else 1.0
    # 51 % of a unit, because a value on a border may be rounded either way
    return [
        pytest.approx(float(text) * scale, abs=0.51 * scale * 10.0 ** -len(text.partition(".")[2]) + more)
        for text in re.findall(r"-?\d+\.?\d*", cell)
    ]


@pytest.mark.nightly
def test_medians_and_shares_of_the_default_run(tmp_path):
    for label in ENGINES:
        if get_solver(ROWS[label]).unavailable() is not None:
            pytest.skip(f"{label} is not installed")
    same = all(f"{label} {get_solver(ROWS[label]).version()}" in LADDER for label in ENGINES)
    printed = {
        first: [as_printed(cell, 0.0 if same else NEW_VERSION) for cell in cells.split(" | ")]
        for first, cells in re.findall(r"^\| (.*?) \| (.*) \|$", LADDER, re.M)
    }
    folder = run_sweep(parse_config({}), tmp_path / "run").folder
    write_tables(folder, summarise(folder))
    summary = pd.read_csv(tmp_path / "run/summary.csv").query("cells == 'regular'")
    for label, name in ROWS.items():
        whole = summary[(summary.solver == name) & (summary.axis == "all")].set_index("measure")
        D, paths = whole.loc["velocity_divergence"], whole.loc["states_equal"]
        assert [[D["median"]], [D.p95], [D["max"]], [paths["mean"]]] == printed[label], label
    of_mujoco = summary[(summary.solver == "mujoco") & (summary.axis == "stiffness_band")]
    for band, value in BANDS.items():
        found = of_mujoco[of_mujoco.value == value].set_index("measure")["mean"]
        for rung, cell in zip(RUNGS, printed[band], strict=True):
            known = [found[f"{share}_{rung}"] for share in ("share", "share_low", "share_high")]
            assert known[: len(cell)] == cell, (band, rung)


def test_medians_of_chains(tmp_path):
    """The printed medians are those of the exact references, to the last digit. Engines are left out to save time."""
    file = tomllib.loads(CHAINS.partition("<!-- experiment -->\n```toml\n")[2].partition("```")[0])
    run_sweep(
        parse_config(file | {"solvers": ["bistiffness", "kelvin-voigt"]}), tmp_path / "a", isolate=False
    )
    table = pd.read_parquet(tmp_path / "a/divergence.parquet")
    rows = re.findall(r"^\| (\w+), `([\w-]+)` \| (.*) \|$", CHAINS.partition("<!-- medians -->")[2], re.M)
    assert (len(rows), len(table)) == (6, 2 * 216)
    keys = ["arrangement", "solver", "balls"]
    medians = table[table.marked.isna()].groupby(keys, observed=True).velocity_divergence.median()
    for arrangement, solver, cells in rows:
        found = [[medians[arrangement, solver, n]] for n in (2, 3, 5, 10)]
        assert found == [as_printed(cell) for cell in cells.split(" | ")]
    (worst,) = re.findall(r"the most is ([\d.]+), of ten balls that fall together at e = 0.6", CHAINS)
    assert [table.velocity_divergence.max()] == as_printed(worst)
