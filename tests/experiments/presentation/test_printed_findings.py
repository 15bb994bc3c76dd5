"""The findings that docs/ladder.md prints, held against the run that it prints them of."""

import re
from pathlib import Path

import pandas as pd
import pytest

from impact_xval.compliant_baselines import get_solver
from impact_xval.experiments.config.experiment import parse_config
from impact_xval.experiments.measures.summary import summarise
from impact_xval.experiments.presentation.report import write_tables
from impact_xval.experiments.sweep.run import run_sweep

PAGE = (Path(__file__).parents[3] / "docs" / "ladder.md").read_text(encoding="utf-8")
ROWS = {
    "MuJoCo": "mujoco",
    "PyBullet": "pybullet",
    "Kelvin-Voigt contacts, exact": "kelvin-voigt",
    "the model's own impact law in real time, exact (`bistiffness`)": "bistiffness",
}
ENGINES = ("MuJoCo", "PyBullet")
#: By how much D, and a share, may differ with another version of an engine; beyond it the page has to be printed again.
NEW_VERSION = 0.01
BANDS = {"k2/k1 < 0.1": 0.0, "0.1 to 10": 0.1, "k2/k1 > 10": 10.0}


def cells(first):
    """Return the cells of the row of a table that begins so."""
    (line,) = (line for line in PAGE.splitlines() if line.startswith(f"| {first} |"))
    return [cell.strip() for cell in line.strip("| ").split("|")[1:]]


def as_printed(text):
    """Read a number with the half unit of its last digit by which it may be off, and more for a new version."""
    number, percent = re.fullmatch(r"(-?[\d.]+)( %)?", text).groups()
    scale = 0.01 if percent else 1.0
    # 51 % of a unit: a value that lies on a border may round either way.
    half = 0.51 * scale * 10.0 ** -len(number.partition(".")[2])
    return pytest.approx(float(number) * scale, abs=half + (0.0 if of_these_versions() else NEW_VERSION))


def of_these_versions():
    """Whether the page is printed of the versions that are installed."""
    return all(f"{label} {get_solver(ROWS[label]).version()}" in PAGE for label in ENGINES)


@pytest.mark.nightly
def test_medians_and_shares_are_what_the_page_prints(tmp_path):
    for label in ENGINES:
        if get_solver(ROWS[label]).unavailable() is not None:
            pytest.skip(f"{label} is not installed")
    folder = run_sweep(parse_config({}), tmp_path / "run")
    write_tables(folder, summarise(folder))
    summary = pd.read_csv(tmp_path / "run/summary.csv", dtype={"value": str})
    for label, name in ROWS.items():
        found = summary[(summary.solver == name) & (summary.cells == "regular") & (summary.axis == "all")]
        (D,) = found[found.measure == "velocity_divergence"].itertuples()
        (paths,) = found[found.measure == "states_equal"].itertuples()
        printed = [as_printed(text) for text in cells(label)]
        assert [D.median, D.p95, D.max, paths.mean] == printed, label
    of_mujoco = summary[(summary.solver == "mujoco") & (summary.axis == "stiffness_band")]
    rungs = ("frozen_positions", "dissipation_law", "gravity", "mapping", "discretisation")
    for band, value in BANDS.items():
        found = of_mujoco[of_mujoco.value.astype(float) == value].set_index("measure")["mean"]
        for rung, text in zip(rungs, cells(band), strict=True):
            share, _, orders = text.partition(" (")
            assert found[f"share_{rung}"] == as_printed(share), (band, rung)
            if orders:
                low, high = (as_printed(f"{number} %") for number in orders.removesuffix(")").split(" to "))
                assert (found[f"share_low_{rung}"], found[f"share_high_{rung}"]) == (low, high), (band, rung)
