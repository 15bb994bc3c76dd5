"""Trust maps, which show where an engine is within given errors, for a run whose engine is off by known amounts."""

import pandas as pd
import pytest

from impact_xval.experiments.measures.ladder import CONTRIBUTIONS
from impact_xval.experiments.presentation.pictures.ladders import draw_trust, make_trust_maps
from tests.experiments import fakes
from tests.experiments.conftest import SMALL, swept


def trusted(root, **fields):
    """Run an experiment; return its trust maps and the ladders of its engine."""
    folder = swept(root, fakes.shifted if "sample" in fields else fakes.graded, **fields)
    table = pd.read_parquet(folder.root / "ladder.parquet")
    return make_trust_maps(folder, folder.config()), table[table.solver == "mujoco"]


@pytest.fixture(scope="module")
def graded(tmp_path_factory):
    return trusted(tmp_path_factory.mktemp("run") / "run")


def test_levels_of_the_map_follow_the_known_errors(graded):
    """D equals the amount by which the engine is off, so that medians are 0.3 %, 1.7 % and 25 %.

    A field of the map holds two cells. The median of two numbers is their mean.
    """
    trust, _ = graded
    assert set(trust.index.unique("solver")) == {"mujoco"}  # pybullet has no result in any cell
    for name, along in (("cells", [2, 2, 2]), ("typical", [0, 1, 3]), ("strict", [0, 1, 3])):
        image = trust.loc["mujoco", name].unstack()
        assert (image.columns.tolist(), image.index.tolist()) == ([0.5, 1.0, 2.0], [1.0, 1.5])
        assert image.to_numpy().tolist() == [along] * 2
    ((_, _, caption),) = draw_trust(trust)
    assert (
        "MuJoCo: the median D is at most 0.05 in 66.7 % of the fields. The cause with the largest part"
        in caption
    )


def test_the_cause_to_blame_has_the_largest_sum_of_components(graded):
    trust, table = graded
    blamed, beyond = trust.loc["mujoco"].blamed, table[table.velocity_divergence > 0.01]
    names = [f"{c.name}_share" for c in CONTRIBUTIONS if f"{c.name}_share" in table]
    along = beyond[names].fillna(0).mul(beyond.velocity_divergence, axis=0)
    sums = along.groupby([beyond.mass_ratio, beyond.stiffness_ratio]).sum()
    assert (blamed[sums.index] + "_share").tolist() == sums.idxmax(axis=1).tolist()
    assert blamed.loc[:, 0.5].isna().all()  # D is within 1 %, so that the map names no cause
    assert len(sums) == blamed.notna().sum() == 4


def test_a_grid_without_a_plane_has_no_map(tmp_path):
    trust, _ = trusted(tmp_path / "run", grid=SMALL["grid"] | {"stiffness_ratio": [1.0]})
    assert trust is None
    assert list(draw_trust(trust)) == []


def test_scattered_cells_go_into_bins(tmp_path):
    box = {"stiffness_ratio": {"log": [0.1, 10.0]}, "mass_ratio": {"linear": [0.5, 2.0]}}
    box |= {name: {"linear": [0.5, 0.9]} for name in ("e1", "e2")}
    trust, table = trusted(tmp_path / "run", grid=None, sample={"n": 64, "seed": 1} | box)
    assert trust.cells.sum() == ((table.status == "ok") & table.marked.isna()).sum()
    assert min(len(trust.index.unique(axis)) for axis in ("mass_ratio", "stiffness_ratio")) >= 2
