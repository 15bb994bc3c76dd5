"""Ladders of columns: by an independent integration, and what each row holds."""

import math

import numpy as np
import pandas as pd
import pyarrow as pa
import pytest

from impact_xval.experiments.config.arrangements import Arranged
from impact_xval.experiments.config.cells import Block
from impact_xval.experiments.config.experiment import REFERENCE, parse_config
from impact_xval.experiments.measures.ladder import contributions_of
from tests.compliant_baselines.reference_cells import coefficients_of
from tests.experiments.ladders import ladder_rows
from tests.model.column_reference import integrate
from tests.model.columns import solved

NAMES = [c.name for c in contributions_of(gravity=False)]
SPEED = 2.5


def some_columns():
    rng, arrangements = np.random.default_rng(1), ("chain", "cradle", "drop", "stack")
    for name in 3 * arrangements:
        balls = int(rng.integers(2, 7))
        tapers = dict(zip(("mass_taper", "stiffness_taper"), 10 ** rng.uniform(-0.5, 0.5, 2), strict=True))
        yield Arranged(arrangement=name, balls=balls, e=float(rng.uniform(0.3, 1)), v0=-SPEED, **tapers)


def rows_of(columns):
    """The rows of a run: the model's of every column, and one of an engine that is off by so much."""
    rows = []
    for cell, a in enumerate(columns):
        model = solved(a.column()).velocities
        facts = {"cell": cell, "status": "ok", "reason": None, "marked": None, "grazing_margin": 0.5}
        rows.append(facts | {"solver": REFERENCE} | {f"v{i}": v for i, v in enumerate(model, 1)})
        speed = abs(a.v0)
        known = {f"v{i}": 1.01 * v for i, v in enumerate(model, 1)}
        known |= {f"v{i}_limit": 1.001 * v / speed for i, v in enumerate(model, 1)}
        rows.append(facts | {"solver": "mujoco", "limit_error": 1e-5} | known)
    return pa.Table.from_pandas(pd.DataFrame(rows), preserve_index=False)


def ladders_of(columns, cells):
    config = parse_config({"column": {"balls": [7]}})
    block = Block(np.arange(len(columns)), {}, [a.column() for a in columns])
    return ladder_rows(config, cells, block)


def of_balls(row, pattern, balls):
    return [row[pattern.format(i)] for i in range(1, balls + 1)]


def test_contributions_sum_to_the_difference():
    columns = list(some_columns())
    cells = rows_of(columns)
    given = {(row["cell"], row["solver"]): row for row in cells.to_pylist()}
    for (_, row), a in zip(ladders_of(columns, cells).iterrows(), columns, strict=True):
        n, c = a.balls, a.column()
        model, engine = (of_balls(given[row["cell"], name], "v{}", n) for name in (REFERENCE, "mujoco"))
        mass, dv = np.array(c.masses), np.subtract(engine, model)
        d = math.sqrt(mass @ dv**2 / (mass @ np.square(c.velocities)))
        assert row["velocity_divergence"] == pytest.approx(d, rel=1e-12)
        assert of_balls(row, "dv{}", n) == pytest.approx(dv / SPEED, abs=1e-14)
        there = [name for name in NAMES if not math.isnan(row[f"{name}_norm"])]
        assert there == ["frozen_positions", "dissipation_law", "mapping", "discretisation"]
        parts = [of_balls(row, name + "_dv{}", n) for name in there]
        assert np.sum(parts, axis=0) == pytest.approx(dv / SPEED, abs=1e-13)
        assert sum(row[f"{name}_share"] for name in there) == pytest.approx(1, abs=1e-9)
        # of the two orders, whose mean each share is
        for cause in there[:2]:
            low, high = row[f"{cause}_share_low"], row[f"{cause}_share_high"]
            assert row[f"{cause}_share"] == pytest.approx((low + high) / 2, abs=1e-9)


def test_corners_are_those_of_an_integration_in_time():
    columns = [Arranged(arrangement=a, balls=n, e=e, k=1.0) for a, n, e in
               (("drop", 3, 0.8), ("stack", 4, 0.9), ("cradle", 5, 0.95))]  # fmt: skip
    columns = [each.model_copy(update={"v0": -1.0}) for each in columns]
    for (_, row), each in zip(ladders_of(columns, rows_of(columns)).iterrows(), columns, strict=True):
        column = each.column()
        for corner, law, frozen in (
            ("free_asked", "kelvin-voigt", False),
            ("frozen_asked", "kelvin-voigt", True),
            ("free_energetic", "bistiffness", False),
        ):
            expected = integrate(column, law, coefficients_of(column, law, 1), frozen=frozen).velocities
            assert of_balls(row, corner + "_v{}", each.balls) == pytest.approx(expected, abs=1e-8), corner
