"""The ladder: it closes, each contribution is the difference it says, and what is said of it is so."""

import itertools
import math

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from impact_xval.compliant_baselines import get_solver
from impact_xval.compliant_baselines.solver import Settings
from impact_xval.experiments.config.cells import experiment_cells
from impact_xval.experiments.config.experiment import parse_config
from impact_xval.experiments.measures import corners as of_corners
from impact_xval.experiments.measures.corners import Corners, corner_names
from impact_xval.experiments.measures.ladder import by_order, contributions_of, split
from impact_xval.experiments.measures.ladder_rows import NO_LIMIT, Part, sentence
from impact_xval.experiments.measures.ladder_summary import BAND, summarise_ladder
from impact_xval.experiments.measures.layout import layout_of
from impact_xval.experiments.sweep.run import run_sweep
from impact_xval.experiments.tables.folder import RunFolder
from impact_xval.model import solve_batch
from impact_xval.model.collision import Collisions
from tests.compliant_baselines.reference_cells import BATCHES
from tests.experiments import fakes
from tests.experiments.ladders import ladder_rows

MU = 2 / math.sqrt(3)
GRID = {
    "stiffness_ratio": [0.05, 1.0, 40.0],
    "mass_ratio": [0.5, MU],
    "e1": [0.5, 0.9, 1.0],
    "e2": [0.7, 1.0],
}

#: A test to which the scenario makes no difference.
IN_A_DROP = pytest.mark.parametrize("run", ["drop"], indirect=True)


@pytest.fixture(scope="module", params=["impact", "drop"])
def run(request, tmp_path_factory):
    config = parse_config(
        {"name": "l", "scenario": request.param, "k1": 1e6, "solvers": ["mujoco", "pybullet"], "grid": GRID}
    )
    return run_sweep(config, tmp_path_factory.mktemp("ladder") / "a", workers=1, resolve=fakes.shifted)


def table_of(folder):
    return folder.read_table("ladder.parquet").to_pandas()


def corners(model, cells, gravity_number, law="kelvin-voigt"):
    collisions = Collisions.from_ratios(*cells)
    return of_corners.corners(model, collisions, gravity_number * np.sqrt(1 + 1 / cells[1]), law)


def ladder_of(run, cells, engines=("mujoco", "pybullet")):
    config = run.config()
    return ladder_rows(config, cells, experiment_cells(config).block(range(36)), engines)


def vectors(table):
    names = [c.name for c in contributions_of()]
    return np.stack([table[[f"{name}_dv1", f"{name}_dv2"]].to_numpy(dtype=float) for name in names])


def test_contributions_sum_to_the_divergence_that_the_run_measured(run):
    table = table_of(run)
    measured = pq.read_table(run.root / "divergence.parquet").to_pandas()
    measured = measured[measured.solver.isin(["mujoco", "pybullet"])].reset_index()
    ok = table.status == "ok"
    assert list(ok) == list(measured.velocity_divergence.notna())
    total = np.nansum(vectors(table), axis=0)[ok]
    assert np.abs(total - measured[["dv1", "dv2"]].to_numpy(dtype=float)[ok]).max() < 1e-12
    found, expected = (each.velocity_divergence[ok].astype(float) for each in (table, measured))
    np.testing.assert_allclose(found, expected, atol=1e-15)
    shares = table[[f"{r.name}_share" for r in contributions_of()]].astype(float).sum(axis=1)[ok]
    np.testing.assert_allclose(shares, 1, atol=1e-9)


def solved(c, name, frozen, settings):
    """v1 and v2 of one collision; laws with frozen positions have no solver."""
    if not frozen:
        o = get_solver(name).solve(c, settings)
        assert o.status in ("ok", "limit")
        return np.array([o.v1, o.v2])
    number = 0.0
    if settings.scenario == "drop":
        number = settings.gravity / (abs(c.v0) * math.sqrt(c.k1 * (1 / c.m1 + 1 / c.m2)))
    cell = c.stiffness_ratio, c.mass_ratio, c.e1, c.e2, number
    o = BATCHES[name](*cell, frozen=True)
    return np.array([float(o.v1), float(o.v2)]) * abs(c.v0)


def cube_of(c, config, law):
    """The eight corners of a collision, shape (2, 2, 2, 2)."""
    still, scenario = Settings(), Settings(scenario=config.scenario, gravity=config.gravity)
    cube = np.array(
        [
            [[solved(c, name, frozen, s) for s in (still, scenario)] for name in ("bistiffness", law)]
            for frozen in (True, False)
        ]
    )
    cube[0, 0, 0] = solved(c, "state-transition", False, still)
    if config.scenario == "impact":
        cube[0, 0, 1] = cube[0, 0, 0]
    return cube


def shapley(cube, cause):
    """The textbook's sum over sets of the other causes, with weights |S|! (2 - |S|)!/3!."""
    value = 0.0
    without, with_it = np.moveaxis(cube, cause, 0)
    for others in itertools.product((0, 1), repeat=2):
        weight = {0: 1 / 3, 1: 1 / 6, 2: 1 / 3}[sum(others)]
        value = value + weight * (with_it[others] - without[others])
    return value


@pytest.mark.parametrize(
    ("engine", "law"), [("mujoco", "kelvin-voigt"), ("drake-hunt-crossley", "hunt-crossley")]
)
def test_each_cause_is_the_shapley_value_of_the_solvers_at_the_corners(run, engine, law):
    config, cells = run.config(), run.read_table("cells.parquet")
    names = [engine if name == "mujoco" else name for name in cells["solver"].to_pylist()]
    renamed = cells.set_column(cells.column_names.index("solver"), "solver", pa.array(names))
    table = ladder_of(run, renamed, (engine, "pybullet"))
    rows = table[(table.solver == engine) & (table.status == "ok")]
    assert len(rows) > 30
    grid = experiment_cells(config)
    for row in rows.itertuples():
        c = grid[row.cell]
        cube = cube_of(c, config, law)
        for index, name in corner_names().items():
            found = getattr(row, f"{name}_v1"), getattr(row, f"{name}_v2")
            assert found == pytest.approx(tuple(cube[index]), abs=1e-10)
        for cause, name in enumerate(("frozen_positions", "dissipation_law", "gravity")):
            expected = shapley(cube, cause)
            found = getattr(row, f"{name}_dv1"), getattr(row, f"{name}_dv2")
            assert found == pytest.approx(tuple(expected), abs=1e-10)
        assert row.engine_dv1 == pytest.approx(cube[0, 0, 0][0] + 0.01 - cube[1, 1, 1][0], abs=1e-10)
    gravity = rows.gravity_norm
    assert (gravity == 0).all() if config.scenario == "impact" else (gravity > 1e-7).all()


def velocities(batch):
    return np.column_stack([batch.v1, batch.v2])


def test_published_numbers():
    cell = np.array([[1.0], [MU], [0.9], [0.7]])
    causes = by_order(corners(velocities(solve_batch(*cell)), cell, np.zeros(1)).velocities).mean(axis=0)
    expected = (0.65159996 - 0.61394941925041, 0.31646952 - 0.20971952034697)
    np.testing.assert_allclose(causes[0] + causes[1], [expected], atol=6e-9)


def test_closes_for_any_outcomes_in_between():
    n = 400
    box = np.random.default_rng(3).uniform([-2, -1, 0.3, 0.3], [2, 1, 1, 1], (n, 4)).T
    cells = [10 ** box[0], 10 ** box[1], box[2], box[3]]
    model, rng = velocities(solve_batch(*cells)), np.random.default_rng(4)
    engine = rng.normal(size=(n, 2))
    limit = np.where(rng.uniform(size=(n, 1)) < 0.5, engine + 1e-3, np.nan)
    for law in ("kelvin-voigt", "hunt-crossley"):
        between = corners(model, cells, np.full(n, 0.05), law)
        assert set(between.reason) == {""}
        ladder = split(np.stack([np.ones(n), cells[1]], axis=1), between, limit, engine)
        assert np.abs(np.nansum(ladder.vectors, axis=0) - ladder.total).max() < 1e-14
        np.testing.assert_allclose(np.nansum(ladder.along, axis=0), ladder.divergence, rtol=1e-12)
        np.testing.assert_allclose(np.nansum(ladder.orders, axis=1), [ladder.divergence] * 6, rtol=1e-12)
        there = ~np.isnan(ladder.along)
        longest = ladder.norms * (1 + 1e-12) + 1e-15
        assert np.all(np.abs(ladder.along) <= longest, where=there)  # no longer than its vector
        low, high = ladder.ranges
        assert np.all((low <= ladder.shares + 1e-12) & (ladder.shares <= high + 1e-12), where=there)


def test_a_cell_in_which_the_order_matters():
    # By hand, along v1 alone: positions move v1 by 1, or by 3 once the law is changed; gravity by 2 with free positions
    # only; the law by 1, or by 3 with free positions.
    def v1(positions, law, gravity):
        return positions + law + 2 * positions * law + 2 * positions * gravity

    cube = np.zeros((2, 2, 2, 1, 2))
    cube[..., 0, 0] = v1(*np.indices((2, 2, 2)))
    engine, nothing = cube[1, 1, 1] + np.array([0.5, 0.0]), np.array([""])
    ladder = split(np.ones((1, 2)), Corners(cube, nothing, nothing), np.full((1, 2), np.nan), engine)
    # 2 positions law is shared by positions and law, 2 positions gravity by positions and gravity
    np.testing.assert_allclose(ladder.vectors[:3, 0, 0], [1 + 1 + 1, 1 + 1, 1], atol=1e-15)
    assert ladder.vectors[-1, 0, 0] == 0.5
    assert ladder.divergence[0] == 6.5
    low, high = ladder.ranges
    np.testing.assert_allclose(6.5 * low[:3, 0], [1, 1, 0], atol=1e-14)
    np.testing.assert_allclose(6.5 * high[:3, 0], [5, 3, 2], atol=1e-14)
    assert ladder.contributions[ladder.dominant()[0]].name == "frozen_positions"
    assert not ladder.agreed()[0]  # positions first: 1 to 3 of the law, last


def test_only_the_last_contribution_depends_on_the_step_and_it_goes_away_with_it(tmp_path):
    grid = {"stiffness_ratio": [1.0, 10.0], "mass_ratio": [MU], "e1": [0.9], "e2": [0.7]}
    found, errors = [], []
    for fraction in (8e-3, 4e-3, 2e-3):
        config = {"scenario": "impact", "solvers": ["mujoco"], "step_fraction": fraction, "grid": grid}
        folder = run_sweep(parse_config(config), tmp_path / f"{fraction}", isolate=False)
        found.append(table_of(folder))
        rows = pq.read_table(folder.root / "cells.parquet", columns=["solver", "limit_error"]).to_pandas()
        errors.append(rows.limit_error[rows.solver == "mujoco"].to_numpy())
    for name in ("frozen_positions_norm", "dissipation_law_norm", "gravity_norm"):
        assert np.ptp([t[name].to_numpy() for t in found], axis=0).max() == 0
    norms = np.array([t.discretisation_norm.to_numpy() for t in found])
    slopes = -np.diff(np.log2(norms), axis=0)
    assert np.all((slopes > 0.75) & (slopes < 1.25)), slopes
    # the limit dt -> 0 is one, within what its estimates state of both velocities, whatever step it was sought from
    mapping = np.array([t.mapping_norm.to_numpy() for t in found])
    stated = np.sqrt(1 + MU) * np.array(errors)
    assert np.all(np.abs(np.diff(mapping, axis=0)) <= stated[:-1] + stated[1:])
    assert np.all(stated[-1] < norms[-1])


def with_limits(cells, solvers):
    """The table of cells with a limit for some solvers, 1e-3 from their result."""
    frame = cells.to_pandas()
    known = frame.solver.isin(solvers) & frame.v1.notna()
    for name, shift in (("v1", 1e-3), ("v2", -2e-3)):
        frame[f"{name}_limit"] = (frame[name] / frame.v0.abs() + shift).where(known)
    frame["limit_error"] = np.where(known, 1e-5, np.nan)
    return pa.Table.from_pandas(frame, preserve_index=False)


@IN_A_DROP
def test_a_certified_limit_splits_the_last_contribution(run):
    cells = with_limits(run.read_table("cells.parquet"), ["mujoco"])
    split_up, joined = (
        table[(table.solver == "mujoco") & (table.status == "ok")]
        for table in (ladder_of(run, cells), table_of(run))
    )
    step = split_up[["discretisation_dv1", "discretisation_dv2"]]
    np.testing.assert_allclose(step, [[-1e-3, 2e-3]] * len(joined), atol=1e-14)
    np.testing.assert_allclose(split_up.mapping_dv1 + step.discretisation_dv1, joined.engine_dv1, atol=1e-14)
    assert split_up[["engine_norm", "reason"]].isna().all(axis=None)
    assert joined.mapping_norm.isna().all()
    assert set(joined.reason) == {NO_LIMIT}


@IN_A_DROP
def test_an_unconverged_engine_has_a_joined_contribution_that_no_statistic_counts(run, tmp_path):
    frame = with_limits(run.read_table("cells.parquet"), ["mujoco"]).to_pandas()
    shaky = (frame.solver == "mujoco") & (frame.stiffness_ratio == 1.0) & (frame.status == "ok")
    frame.loc[shaky, ["status", "reason"]] = ["unconverged", "differs from its limit by 0.1"]
    table = ladder_of(run, pa.Table.from_pandas(frame, preserve_index=False))
    rows = table[table.status == "unconverged"]
    assert len(rows) == shaky.sum() > 0
    assert rows.engine_norm.notna().all()
    assert rows.mapping_norm.isna().all()
    assert set(rows.reason) == {"mujoco: differs from its limit by 0.1"}
    schema = layout_of(run.config()).tables["ladder"].schema
    known = table_of(run)
    table = table.assign(**{name: known[name] for name in schema.names if name not in table})
    table["marked"] = table.marked.replace("", None)
    pq.write_table(pa.Table.from_pandas(table, schema), tmp_path / "ladder.parquet")
    counted = summarise_ladder(RunFolder(tmp_path), run.config()).statistics
    counted = counted[(counted.axis == "stiffness_ratio") & (counted.contribution == "mapping")]
    ok = table[(table.solver == "mujoco") & (table.status == "ok") & table.marked.isna()]
    assert dict(zip(counted.value, counted.n, strict=True)) == ok.groupby("stiffness_ratio").size().to_dict()
    assert set(counted.value) == {0.05, 40.0}


def test_a_missing_outcome_is_a_row_with_a_status_and_a_reason(tmp_path):
    grid = {"stiffness_ratio": [1.0], "mass_ratio": [1.0], "e1": [0.0, 0.5, 0.9], "e2": [0.7]}
    config = parse_config({"scenario": "impact", "solvers": ["mujoco", "pybullet"], "grid": grid})
    folder = run_sweep(config, tmp_path / "a", isolate=False, resolve=fakes.crashing)
    table = table_of(folder).set_index(["solver", "e1"]).sort_index()
    assert table.loc["mujoco"].status.tolist() == ["unrepresentable", "crashed", "ok"]
    assert (
        table.loc["mujoco"].reason[0.0] == "bistiffness: unrepresentable"
    )  # the fake answers, no reference does
    assert set(table.loc["pybullet"].status) == {"unavailable"}
    failed = table[table.status != "ok"]
    assert failed[["velocity_divergence", "frozen_positions_norm", "sentence"]].isna().all(axis=None)
    assert failed.reason.notna().all()
    assert summarise_ladder(folder, config).solvers == ["mujoco"]


@IN_A_DROP
def test_shares_of_a_region_are_of_its_sum_of_d(run):
    """A share is the sum of components along each cell's difference, here from the vectors themselves."""
    config, table = run.config(), table_of(run)
    found = summarise_ladder(run, config)
    here = table[(table.solver == "mujoco") & (table.stiffness_ratio == 0.05)]
    here = here[~(here.model_grazing_margin < config.grazing_threshold)]
    region = found.region("mujoco", BAND, 0.0)
    weight = np.column_stack([np.ones(len(here)), here.mass_ratio])
    total = here[["dv1", "dv2"]].to_numpy()
    d = np.sqrt((weight * total**2).sum(axis=1))
    for name in region.index:
        vector = here[[f"{name}_dv1", f"{name}_dv2"]].to_numpy()
        along = (weight * vector * total).sum(axis=1) / d
        assert region.share[name] == pytest.approx(along.sum() / d.sum(), abs=1e-12)
    assert region.high["frozen_positions"] - region.low["frozen_positions"] > 1e-3
    assert region.total.iloc[0] == pytest.approx(d.mean(), rel=1e-12)
    sums = found.statistics.groupby(["solver", "axis", "value"], dropna=False).share.sum()
    assert sums.to_numpy() == pytest.approx(1, abs=1e-9)


def test_a_cell_is_marked_where_a_corner_of_its_ladder_jumps():
    # Model and kelvin-voigt stay where they are; with frozen positions and gravity bistiffness moves by 0.1 within
    # 1e-3 in k2/k1, and gravity's share with it from 4 to 75 %.
    cell = 0.0367233421504446, 0.6889490525763244, 0.5694414020068647, 0.7990332863355147
    cells = [np.array([x, y]) for x, y in zip(cell, (1.0, 1.0, 0.8, 0.8), strict=True)]
    number = 9.81 / np.sqrt(1e8 * (1 + 1 / cells[1]))
    first, second = corners(velocities(solve_batch(*cells)), cells, number).mark
    assert first == "ladder: frozen bistiffness with gravity jumps where a parameter changes by 0.004 or less"
    assert second == ""


def test_a_sentence_claims_most_only_if_every_order_agrees():
    def said(*parts, agreed=True, divergence=0.1):
        return sentence("engine", divergence, [Part(*part) for part in parts], agreed)

    most, little = ("a", 0.9, 0.09, 0.8, 0.95), ("b", 0.1, 0.01, 0.05, 0.2)
    assert "most of it by a (90 %, by order 80 to 95 %" in said(most, little)
    two = ("a", 0.62, 0.1, 0.04, 1.2), ("b", 0.38, 0.1, -0.2, 0.96)
    assert "(another by another order) by a" in said(*two, agreed=False)
    assert "the largest part of it by a (40 %" in said(
        ("a", 0.4, 0.1, 0.4, 0.4), *[("b", 0.3, 0.1, 0.3, 0.3)] * 2
    )
    assert "taken back in part by b (-80 %" in said(("a", 1.8, 0.2, 1.8, 1.8), ("b", -0.8, 0.1, -0.8, -0.8))
    assert "causes cancel" in said(("a", 13.0, 1.3, 12, 14), ("b", -12.0, 1.2, -13, -11))
    assert "nothing to split" in said(most, little, divergence=1e-12)
