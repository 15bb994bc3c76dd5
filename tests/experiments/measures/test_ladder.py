"""The ladder, which splits a divergence into contributions.

The tests check that contributions add up to the divergence, that each contribution is the difference it is defined as,
and that the sentences about the ladder are true.
"""

import itertools
import math

import numpy as np
import pandas as pd
import pytest

from impact_xval.compliant_baselines import get_solver
from impact_xval.compliant_baselines.solver import Settings
from impact_xval.experiments.config.arrangements import ChainSetup
from impact_xval.experiments.config.cells import experiment_cells
from impact_xval.experiments.config.experiment import parse_config
from impact_xval.experiments.measures import corners as of_corners
from impact_xval.experiments.measures.corners import Corners, corner_names
from impact_xval.experiments.measures.ladder import (
    CONTRIBUTIONS,
    NO_LIMIT,
    SentencePart,
    format_share_range,
    ladders,
    sentence,
    split,
)
from impact_xval.experiments.measures.summary import BAND, summarise_ladder
from impact_xval.experiments.presentation.views import _contribution_rows
from impact_xval.experiments.sweep.rows import (
    Experiment,
    model_as_comparison,
    solve_and_compare,
    solve_by_model,
)
from impact_xval.experiments.tables.folder import RunFolder
from impact_xval.model import solve, solve_batch
from impact_xval.model.collisions import Collisions
from tests.compliant_baselines.reference_cells import BATCHES, coefficients_of
from tests.experiments import fakes
from tests.experiments.conftest import swept
from tests.model.chain_reference import integrate

MU = 2 / math.sqrt(3)
CAUSES = "frozen_positions", "dissipation_law", "gravity"


def corners(model, cells, gravity_number):
    collisions = Collisions.from_ratios(*cells)
    velocities = np.column_stack([model.v1, model.v2])
    return of_corners.corners(velocities, collisions, gravity_number * np.sqrt(1 + 1 / cells[1]))


def cube_of(c, gravity, law):
    """Return the velocities of a collision at 1 m/s for all eight settings of three switches, shape (2, 2, 2, 2).

    The switches are positions (frozen or free), law (energetic or the engine's) and gravity (off or on). Laws with
    frozen positions have no solver, so they are called as functions.
    """
    cell = c.stiffness_ratio, c.mass_ratio, c.e1, c.e2
    number = gravity / math.sqrt(c.k1 * (1 / c.m1 + 1 / c.m2))
    scenarios = Settings(), Settings(scenario="drop", gravity=gravity) if gravity else Settings()
    cube = np.empty((2, 2, 2, 2))
    for (asked, name), weight in itertools.product(enumerate(("bistiffness", law)), (0, 1)):
        frozen = BATCHES[name](*cell, number * weight, frozen=True)
        cube[0, asked, weight] = frozen.v1, frozen.v2
        cube[1, asked, weight] = get_solver(name).solve(c, scenarios[weight]).velocities
    cube[0, 0, 0] = solve(c).velocities
    if not gravity:
        cube[0, 0, 1] = cube[0, 0, 0]
    return cube


def shapley(cube, cause):
    """Return the Shapley value of a cause: a sum over sets S of the other causes, with weights |S|! (2 - |S|)!/3!."""
    value = 0.0
    without, with_it = np.moveaxis(cube, cause, 0)
    for others in itertools.product((0, 1), repeat=2):
        weight = {0: 1 / 3, 1: 1 / 6, 2: 1 / 3}[sum(others)]
        value = value + weight * (with_it[others] - without[others])
    return value


@pytest.mark.parametrize("scenario", ["impact", "drop"])
@pytest.mark.parametrize(
    ("engine", "law"), [("mujoco", "kelvin-voigt"), ("drake-hunt-crossley", "hunt-crossley")]
)
def test_each_cause_is_the_shapley_value_of_the_solvers_at_the_corners(scenario, engine, law):
    grid = {
        "stiffness_ratio": [0.05, 1.0, 40.0],
        "mass_ratio": [0.5, MU],
        "e1": [0.5, 0.9, 1.0],
        "e2": [0.7, 1],
    }
    config = parse_config({"scenario": scenario, "k1": 1e6, "solvers": ["mujoco"], "grid": grid})
    experiment, block = Experiment(config, fakes.shifted), experiment_cells(config).block(range(36))
    model = solve_by_model(experiment, block)
    shifted = solve_and_compare(experiment, "mujoco", block, model)
    rows = ladders(config, block, model_as_comparison(model), {engine: shifted})[engine]
    for cell, c in enumerate(block.collisions):

        def row(pattern, cell=cell):
            return [rows[pattern.format(ball)][cell] for ball in (1, 2)]

        cube = cube_of(c, config.gravity if scenario == "drop" else 0.0, law)
        for index, name in corner_names().items():
            assert row(name + "_v{}") == pytest.approx(cube[index], abs=1e-10)
        for cause, name in enumerate(CAUSES):
            assert row(name + "_dv{}") == pytest.approx(shapley(cube, cause), abs=1e-10)
        assert row("engine_dv{}")[0] == pytest.approx(cube[0, 0, 0][0] + 0.01 - cube[1, 1, 1][0], abs=1e-10)
    assert set(rows["reason"]) == {NO_LIMIT}
    gravity = rows["gravity_norm"]
    assert (gravity == 0).all() if scenario == "impact" else (gravity > 1e-7).all()


@pytest.mark.parametrize(
    ("arrangement", "balls", "e"), [("pile", 3, 0.8), ("stack", 4, 0.9), ("cradle", 5, 0.95)]
)
def test_corners_of_chains_are_those_of_an_integration_in_time(arrangement, balls, e):
    chain = ChainSetup(arrangement=arrangement, balls=balls, e=e, k=1.0, v0=-1.0).collision()
    model = np.array([solve(chain).velocities])
    found = of_corners.corners(model, Collisions.of([chain]), np.zeros(1), pair=False)
    names = {name: index for index, name in corner_names(gravity=False).items()}
    for corner, law in (
        ("free_asked", "kelvin-voigt"),
        ("frozen_asked", "kelvin-voigt"),
        ("free_energetic", "bistiffness"),
    ):
        damping, frozen = coefficients_of(chain, law, 1), corner.startswith("frozen")
        expected = integrate(chain, law, damping, frozen=frozen).velocities
        assert found.velocities[names[corner]][0] == pytest.approx(expected, abs=1e-8), corner


@pytest.mark.parametrize(("switches", "balls"), [((2, 2, 2), 2), ((2, 2, 1), 5)], ids=["pairs", "chains"])
def test_contributions_add_up_to_the_divergence_for_any_corners(switches, balls):
    n, rng = 400, np.random.default_rng(4)
    cube, engine = rng.uniform(-1, 1, (*switches, n, balls)), rng.normal(size=(n, balls))
    limit = np.where(rng.uniform(size=(n, 1)) < 0.5, engine + 1e-3, np.nan)
    nothing = np.full(n, "")
    ladder = split(10 ** rng.uniform(-1, 1, (n, balls)), Corners(cube, nothing, nothing), limit, engine)
    assert np.abs(np.nansum(ladder.vectors, axis=0) - (engine - cube[0, 0, 0])).max() < 1e-14
    np.testing.assert_allclose(np.nansum(ladder.along, axis=0), ladder.divergence, rtol=1e-12)
    np.testing.assert_allclose(np.nansum(ladder.orders, axis=1), [ladder.divergence] * 6, rtol=1e-12)
    there = ~np.isnan(ladder.along)
    longest = ladder.norms * (1 + 1e-12) + 1e-15
    # a contribution's component along the velocity difference is at most as long as the contribution
    assert np.all(np.abs(ladder.along) <= longest, where=there)
    low, high = ladder.ranges
    assert np.all((low <= ladder.shares + 1e-12) & (ladder.shares <= high + 1e-12), where=there)


@pytest.mark.parametrize(
    ("limit", "last"),
    [(math.nan, (math.nan, math.nan, 0.5)), (0.3, (0.3, 0.2, math.nan))],
    ids=["joined", "split"],
)
def test_a_cell_in_which_the_order_matters(limit, last):
    # A cube by hand, along v1 only. Free positions change v1 by 1, and by 3 once the law is changed. Gravity changes it
    # by 2 with free positions only. The law changes it by 1, and by 3 with free positions. The engine is 0.5 beyond
    # this, and its limit, if there is one, 0.3.
    def v1(positions, law, gravity):
        return positions + law + 2 * positions * law + 2 * positions * gravity

    cube = np.zeros((2, 2, 2, 1, 2))
    cube[..., 0, 0] = v1(*np.indices((2, 2, 2)))
    engine, at_limit = (cube[1, 1, 1] + np.array([x, 0.0]) for x in (0.5, limit))
    nothing = np.array([""])
    ladder = split(np.ones((1, 2)), Corners(cube, nothing, nothing), at_limit, engine)
    # The term 2 positions law is shared by positions and law, the term 2 positions gravity by positions and gravity.
    np.testing.assert_allclose(ladder.vectors[:, 0, 0], [1 + 1 + 1, 1 + 1, 1, *last], atol=1e-15)
    assert ladder.divergence[0] == 6.5
    low, high = ladder.ranges
    np.testing.assert_allclose(6.5 * low[:3, 0], [1, 1, 0], atol=1e-14)
    np.testing.assert_allclose(6.5 * high[:3, 0], [5, 3, 2], atol=1e-14)
    assert ladder.contributions[ladder.dominant()[0]].name == "frozen_positions"
    # if positions are changed first, they contribute 1, and the law, changed last, contributes 3
    assert not ladder.same_by_every_order()[0]


def test_only_the_last_contribution_depends_on_the_step_and_it_goes_away_with_it(tmp_path):
    grid = {"stiffness_ratio": [1.0, 10.0], "mass_ratio": [MU], "e1": [0.9], "e2": [0.7]}
    found = []
    for fraction in (8e-3, 4e-3, 2e-3):
        root = tmp_path / f"{fraction}"
        folder = swept(root, get_solver, solvers=["mujoco"], step_fraction=fraction, grid=grid)
        found.append(pd.read_parquet(folder.root / "ladder.parquet"))
    for name in CAUSES:
        assert np.ptp([t[f"{name}_norm"].to_numpy() for t in found], axis=0).max() == 0
    norms = np.array([t.discretisation_norm.to_numpy() for t in found])
    slopes = -np.diff(np.log2(norms), axis=0)
    assert np.all((slopes > 0.75) & (slopes < 1.25)), slopes
    # The limit for a step of zero is the same for all steps from which it was extrapolated, within the stated errors of
    # both velocities.
    mapping = np.array([t.mapping_norm.to_numpy() for t in found])
    stated = np.sqrt(1 + MU) * np.array([t.limit_error.to_numpy() for t in found])
    assert np.all(np.abs(np.diff(mapping, axis=0)) <= stated[:-1] + stated[1:])
    assert np.all(stated[-1] < norms[-1])


def test_a_missing_outcome_is_a_row_with_a_status_and_a_reason(tmp_path):
    grid = {"stiffness_ratio": [1.0], "mass_ratio": [1.0], "e1": [0.0, 0.5, 0.9], "e2": [0.7]}
    folder = swept(tmp_path / "a", fakes.crashing, grid=grid)
    table = pd.read_parquet(folder.root / "ladder.parquet").set_index(["solver", "e1"]).sort_index()
    assert table.loc["mujoco"].status.tolist() == ["unrepresentable", "crashed", "ok"]
    # the fake engine answers, but no reference does
    assert table.loc["mujoco"].reason[0.0] == "bistiffness: unrepresentable"
    assert set(table.loc["pybullet"].status) == {"unavailable"}
    failed = table[table.status != "ok"]
    assert failed[["velocity_divergence", "frozen_positions_norm", "sentence"]].isna().all(axis=None)
    assert failed.reason.notna().all()
    assert summarise_ladder(folder, folder.config()).solvers == ["mujoco"]


def test_shares_of_a_region_are_of_its_sum_of_d(engine_run):
    """The share of a contribution in a region of the grid agrees with the tables of the run to 1e-12.

    D is the divergence of the engine from the model, and a contribution is the part of it that has one cause. The share
    is A divided by the sum of D over the cells (collisions) of the region. A is a sum over the same cells. Its terms
    are the components of the contribution along the cell's velocity difference between engine and model.
    """
    folder = RunFolder(engine_run)
    found = summarise_ladder(folder, folder.config())
    table, measured = (pd.read_parquet(engine_run / f"{name}.parquet") for name in ("ladder", "divergence"))
    here = table[table.marked.isna()]
    measured = measured[measured.solver == "mujoco"].set_index("cell").loc[here.cell]
    region = found.region("mujoco", BAND, 0.1)
    weight = np.column_stack([np.ones(len(here)), here.mass_ratio])
    total = measured[["dv1", "dv2"]].to_numpy()
    vectors = {name: here[[f"{name}_dv1", f"{name}_dv2"]].to_numpy() for name in region.index}
    np.testing.assert_allclose(sum(vectors.values()), total, atol=1e-12)
    d = measured.velocity_divergence.to_numpy()
    for name, vector in vectors.items():
        along = (weight * vector * total).sum(axis=1) / d
        assert region.share[name] == pytest.approx(along.sum() / d.sum(), abs=1e-12)
    cause = region.loc["frozen_positions"]
    assert cause.low + 5e-4 < cause.share < cause.high - 5e-4
    assert region.total.iloc[0] == pytest.approx(d.mean(), rel=1e-12)
    sums = found.statistics.groupby(["solver", "axis", "value"], dropna=False).share.sum()
    assert sums.to_numpy() == pytest.approx(1, abs=1e-9)


def test_a_cell_is_marked_where_a_corner_of_its_ladder_jumps():
    # The model and kelvin-voigt do not move here. With frozen positions and gravity, bistiffness moves by 0.1 when
    # k2/k1 changes by 1e-3. The share of gravity then changes from 4 to 75 %.
    cell = 0.0367233421504446, 0.6889490525763244, 0.5694414020068647, 0.7990332863355147
    cells = [np.array([x, y]) for x, y in zip(cell, (1.0, 1.0, 0.8, 0.8), strict=True)]
    number = 9.81 / np.sqrt(1e8 * (1 + 1 / cells[1]))
    first, second = corners(solve_batch(*cells).flat, cells, number).mark
    assert first == "ladder: frozen bistiffness with gravity jumps where a parameter changes by 0.004 or less"
    assert second == ""


def test_a_sentence_claims_most_only_if_every_order_agrees():
    def said(*parts, agreed=True, divergence=0.1):
        return sentence("engine", divergence, [SentencePart(*part) for part in parts], agreed)

    most, little = ("a", 0.9, 0.09, 0.8, 0.95), ("b", 0.1, 0.01, 0.05, 0.2)
    assert "Most of it comes from a: 90 % (80 to 95 %)." in said(most, little)
    two = ("a", 0.62, 0.1, 0.04, 1.2), ("b", 0.38, 0.1, -0.2, 0.96)
    assert "In another order of the causes, another cause is the largest." in said(*two, agreed=False)
    assert "The largest part of it comes from a: 40 %." in said(
        ("a", 0.4, 0.1, 0.4, 0.4), *[("b", 0.3, 0.1, 0.3, 0.3)] * 2
    )
    assert "A part of it is undone by b: -80 %." in said(
        ("a", 1.8, 0.2, 1.8, 1.8), ("b", -0.8, 0.1, -0.8, -0.8)
    )
    assert "causes nearly cancel" in said(("a", 13.0, 1.3, 12, 14), ("b", -12.0, 1.2, -13, -11))
    assert "no difference to explain" in said(most, little, divergence=1e-12)


def test_a_share_that_is_only_rounding_is_printed_as_0():
    assert format_share_range(-5.67e-16, 0.0) == "0 to 0 %"
    assert format_share_range(-0.0883, 2.43e-16) == "-8.83 to 0 %"


def test_a_change_that_is_only_rounding_is_printed_as_0():
    row = {"ladder_dv1": 0.25, "ladder_dv2": 1e-17, "ladder_velocity_divergence": 0.25}
    for c in CONTRIBUTIONS:
        changes = {
            "norm": 0.25,
            "share": 0.2,
            "share_low": 0.1,
            "share_high": 0.3,
            "dv1": 0.05,
            "dv2": -6.476e-17,
        }
        row |= {f"{c.name}_{key}": value for key, value in changes.items()}
    *lines, total = _contribution_rows(row, ("1", "2"))
    assert {line[1:4] for line in lines} == {("5.000e-02", "0", "2.500e-01")}
    assert total == ("sum", "2.500e-01", "0", "2.500e-01", "100.0 %", "")
