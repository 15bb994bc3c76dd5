"""Ladders of columns: beside those of two balls, by an independent integration, and what each row holds."""

import math

import numpy as np
import pyarrow as pa
import pytest
from impact_xval.experiments.measures.columns.ladder import column_ladder_rows
from impact_xval.experiments.measures.ladder_table import NO_LIMIT, ladder_rows

from impact_xval.experiments.config.arrangements import Arranged
from impact_xval.experiments.config.experiment import REFERENCE
from impact_xval.experiments.measures.ladder import contributions_of
from impact_xval.experiments.measures.single import column_divergence
from impact_xval.experiments.tables.schema import CELLS_SCHEMA, LINES
from tests.compliant_baselines.column_in_time import integrate
from tests.compliant_baselines.reference_cells import coefficients_of
from tests.model.columns import solved

NAMES = [c.name for c in contributions_of(gravity=False)]
SPEED = 2.5


def arranged(rng, name, balls):
    tapers = 10 ** rng.uniform(-0.5, 0.5, 2)
    e = float(rng.uniform(0.3, 1))
    return Arranged(
        arrangement=name, balls=balls, e=e, mass_taper=tapers[0], stiffness_taper=tapers[1], v0=-SPEED
    )


def some_columns(count=12):
    rng = np.random.default_rng(1)
    names = ("chain", "cradle", "drop", "stack")
    return [arranged(rng, names[i % 4], int(rng.integers(2, 7))) for i in range(count)]


def experiment_cells(columns, **changed):
    """The table of cells of a run: the model's row of every column, and one of an engine that is off by so much."""
    rows = []
    for cell, a in enumerate(columns):
        column = a.column()
        model = solved(column).velocities
        facts = a.model_dump() | {"m1": a.m, "k1": a.k, "cell": cell, "strike": None, "status": "ok"}
        rows.append(facts | {"solver": REFERENCE, "velocities": list(model), "grazing_margin": 0.5})
        known = {
            "velocities": [1.01 * v for v in model],
            "velocities_limit": [1.001 * v / SPEED for v in model],
        }
        rows.append(facts | {"solver": "mujoco", "limit_error": 1e-5} | known | changed)
    return pa.Table.from_pylist(rows, schema=LINES.cells)


def test_two_balls_are_the_ladder_of_two_balls():
    rng = np.random.default_rng(2)
    columns = [arranged(rng, "drop", 2) for _ in range(15)]
    ours = column_ladder_rows(experiment_cells(columns)).to_pandas()
    pairs = []
    for row in experiment_cells(columns).to_pylist():
        c = row | {"stiffness_ratio": row["stiffness_taper"], "mass_ratio": row["mass_taper"]}
        c |= {"e1": row["e"], "e2": row["e"], "gravity_number": 0.0}
        c |= {f"v{i + 1}": v for i, v in enumerate(row["velocities"])}
        c |= {f"v{i + 1}_limit": v for i, v in enumerate(row["velocities_limit"] or (None, None))}
        pairs.append(c)
    theirs = ladder_rows(pa.Table.from_pylist(pairs, schema=CELLS_SCHEMA)).to_pandas()
    assert list(ours.status) == ["ok"] * 15
    for name in NAMES[:-1]:
        dv = np.array([*ours[f"{name}_dv"]])
        np.testing.assert_allclose(dv, theirs[[f"{name}_dv1", f"{name}_dv2"]], rtol=0, atol=1e-12)
        for of in ("norm", "share"):
            np.testing.assert_allclose(ours[f"{name}_{of}"], theirs[f"{name}_{of}"], rtol=1e-9, atol=1e-9)
    for cause in ("frozen_positions", "dissipation_law"):
        for end in ("low", "high"):
            of = f"{cause}_share_{end}"
            np.testing.assert_allclose(ours[of], theirs[of], rtol=1e-9, atol=1e-9)
    assert list(ours.dominant) == list(theirs.dominant)
    assert list(ours.sentence) == list(theirs.sentence)


def test_contributions_sum_to_the_difference():
    columns = some_columns()
    cells = experiment_cells(columns)
    table = column_ladder_rows(cells).to_pylist()
    velocities = {(row["cell"], row["solver"]): row["velocities"] for row in cells.to_pylist()}
    for row, a in zip(table, columns, strict=True):
        model, engine = (velocities[row["cell"], name] for name in (REFERENCE, "mujoco"))
        d = column_divergence(a.column(), model, engine)
        assert row["velocity_divergence"] == pytest.approx(d, rel=1e-12)
        assert row["dv"] == pytest.approx(np.subtract(engine, model) / SPEED, abs=1e-14)
        there = [name for name in NAMES if row[f"{name}_norm"] is not None]
        assert there == ["frozen_positions", "dissipation_law", "mapping", "discretisation"]
        assert np.sum([row[f"{name}_dv"] for name in there], axis=0) == pytest.approx(row["dv"], abs=1e-13)
        assert sum(row[f"{name}_share"] for name in there) == pytest.approx(1, abs=1e-9)
        # of the two orders, whose mean each share is
        for cause in there[:2]:
            low, high = row[f"{cause}_share_low"], row[f"{cause}_share_high"]
            assert row[f"{cause}_share"] == pytest.approx((low + high) / 2, abs=1e-9)
        expected = np.array(engine) / SPEED - np.array(model) * 1.001 / SPEED
        assert row["discretisation_dv"] == pytest.approx(expected)


def test_corners_are_those_of_an_integration_in_time():
    columns = [Arranged(arrangement=a, balls=n, e=e, k=1.0) for a, n, e in
               (("drop", 3, 0.8), ("stack", 4, 0.9), ("cradle", 5, 0.95))]  # fmt: skip
    cells = experiment_cells([each.model_copy(update={"v0": -1.0}) for each in columns])
    for row, each in zip(column_ladder_rows(cells).to_pylist(), columns, strict=True):
        column = each.column()
        for corner, law, frozen in (
            ("free_asked", "kelvin-voigt", False),
            ("frozen_asked", "kelvin-voigt", True),
            ("free_energetic", "bistiffness", False),
        ):
            expected = integrate(column, law, 1, coefficients_of(column, law, 1), frozen=frozen)
            assert row[f"{corner}_v"] == pytest.approx(expected, abs=1e-8), corner


def test_what_has_no_ladder_says_why():
    columns = some_columns(4)
    (row, *_) = column_ladder_rows(
        experiment_cells(columns, status="timeout", reason="too many steps")
    ).to_pylist()
    assert (row["status"], row["reason"]) == ("timeout", "mujoco: too many steps")
    assert row["velocity_divergence"] is row["sentence"] is row["dv"] is row["free_asked_v"] is None
    (row, *_) = column_ladder_rows(experiment_cells(columns, velocities_limit=None)).to_pylist()
    assert (row["status"], row["reason"]) == ("ok", NO_LIMIT)
    assert row["mapping_dv"] is None
    assert math.isclose(
        row["engine_share"] + row["frozen_positions_share"] + row["dissipation_law_share"], 1, abs_tol=1e-9
    )
    cells = experiment_cells(columns)
    only = cells.filter(pa.compute.equal(cells["solver"], REFERENCE))
    assert len(column_ladder_rows(only)) == 0
