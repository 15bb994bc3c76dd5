"""Trust maps of a run whose engine is off by known amounts."""

import pandas as pd
import pytest

from impact_xval.experiments.config.experiment import parse_config
from impact_xval.experiments.measures.ladder import CONTRIBUTIONS
from impact_xval.experiments.presentation.pictures.trust import draw_trust, trust_of
from impact_xval.experiments.sweep.run import run_sweep
from tests.experiments import fakes
from tests.experiments.conftest import SMALL


@pytest.fixture(scope="module")
def graded(tmp_path_factory):
    root = tmp_path_factory.mktemp("run") / "run"
    return run_sweep(parse_config(SMALL), root, isolate=False, resolve=fakes.graded)


def test_levels_are_those_of_the_amounts(graded):
    """D is the amount itself. Of two cells of a field the median is their mean: 0.3 %, 1.7 % and 25 %."""
    trust = trust_of(graded, graded.config())
    assert set(trust.index.unique("solver")) == {"mujoco"}  # pybullet has no result anywhere
    for name, along in (("cells", [2, 2, 2]), ("typical", [0, 1, 3]), ("strict", [0, 1, 3])):
        image = trust.loc["mujoco", name].unstack()
        assert (image.columns.tolist(), image.index.tolist()) == ([0.5, 1.0, 2.0], [1.0, 1.5])
        assert image.to_numpy().tolist() == [along] * 2
    ((_, _, caption),) = draw_trust(trust)
    assert "MuJoCo: the median cell is within 5 % in 66.7 % of the fields" in caption


def test_to_blame_is_the_largest_sum_of_components_in_the_table(graded):
    blamed = trust_of(graded, graded.config()).loc["mujoco"].blamed
    table = pd.read_parquet(graded.root / "ladder.parquet")
    beyond = table[(table.solver == "mujoco") & (table.velocity_divergence > 0.01)]
    names = [f"{c.name}_share" for c in CONTRIBUTIONS if f"{c.name}_share" in table]
    along = beyond[names].fillna(0).mul(beyond.velocity_divergence, axis=0)
    sums = along.groupby([beyond.mass_ratio, beyond.stiffness_ratio]).sum()
    for place, row in sums.iterrows():
        assert f"{blamed[place]}_share" == row.idxmax()
    assert blamed.loc[:, 0.5].isna().all()  # within 1 %
    assert len(sums) == blamed.notna().sum() == 4


def test_a_grid_without_a_plane_has_no_map(tmp_path):
    config = parse_config(SMALL | {"grid": SMALL["grid"] | {"stiffness_ratio": [1.0]}})
    folder = run_sweep(config, tmp_path / "run", isolate=False, resolve=fakes.graded)
    assert trust_of(folder, folder.config()) is None
    assert list(draw_trust(None)) == []


def test_scattered_cells_go_into_bins(tmp_path):
    ratios = {"stiffness_ratio": {"log": [0.1, 10.0]}, "mass_ratio": {"linear": [0.5, 2.0]}}
    restitutions = {"e1": {"linear": [0.5, 0.9]}, "e2": {"linear": [0.5, 0.9]}}
    config = {key: value for key, value in SMALL.items() if key != "grid"}
    config |= {"sample": {"n": 64, "seed": 1} | ratios | restitutions}
    folder = run_sweep(parse_config(config), tmp_path / "run", isolate=False, resolve=fakes.shifted)
    trust = trust_of(folder, folder.config())
    table = pd.read_parquet(folder.root / "ladder.parquet")
    compared = table[(table.solver == "mujoco") & (table.status == "ok") & table.marked.isna()]
    assert trust.cells.sum() == len(compared)
    assert min(len(trust.index.unique(axis)) for axis in ("mass_ratio", "stiffness_ratio")) >= 2
