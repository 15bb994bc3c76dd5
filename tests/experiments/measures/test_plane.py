"""Dense maps: what they say is what the solvers say, cell by cell, and where theory draws a border they have one."""

import json
import math

import numpy as np
import pyarrow.parquet as pq
import pytest

from impact_xval.compliant_baselines import get_solver
from impact_xval.compliant_baselines.contract.solver import Settings
from impact_xval.experiments.commands.cli import main
from impact_xval.experiments.measures import plane as planes
from impact_xval.experiments.measures.corners import corners
from impact_xval.experiments.measures.ladder import split, weights_of_two
from impact_xval.experiments.measures.plane import (
    ALIKE,
    FROZEN_PARTS,
    LAW_PARTS,
    NO_PATH,
    PLANE_SCHEMA,
    Plane,
    write_plane,
)
from impact_xval.model import Collision, solve

PLANE = Plane(0.9, 0.7, (1e-2, 1e2), (0.2, 5), 9, 0.02, "exact")


@pytest.fixture(scope="module")
def mapped(tmp_path_factory):
    path = tmp_path_factory.mktemp("plane") / "map.parquet"
    return write_plane(PLANE, path), pq.read_table(path)


def test_cells_are_those_of_the_solvers(mapped):
    _, table = mapped
    assert table.schema.names == PLANE_SCHEMA.names
    seen = set()
    for row in table.to_pylist():
        c = Collision.from_ratios(row["stiffness_ratio"], row["mass_ratio"], PLANE.e1, PLANE.e2)
        g = PLANE.gravity  # m1 = k1 = -v0 = 1
        drop = Settings(scenario="drop", gravity=g)
        outcomes = {
            "model": solve(c),
            "liu_zhao_brogliato": get_solver("liu-zhao-brogliato").solve(c),
            "bistiffness": get_solver("bistiffness").solve(c),
            "kelvin_voigt": get_solver("kelvin-voigt").solve(c),
            "scenario": get_solver("kelvin-voigt").solve(c, drop),
        }
        for name, o in outcomes.items():
            assert (row[f"{name}_v1"], row[f"{name}_v2"]) == pytest.approx((o.v1, o.v2), abs=1e-10)

        def distance(a, b, c=c, outcomes=outcomes):
            a, b = outcomes[a], outcomes[b]
            return math.hypot(a.v1 - b.v1, math.sqrt(c.mass_ratio) * (a.v2 - b.v2))

        # the causes are those of the ladder, which is tested against the solvers
        model = np.array([[outcomes["model"].v1, outcomes["model"].v2]])
        cell = [np.array([x]) for x in (c.stiffness_ratio, c.mass_ratio, c.e1, c.e2)]
        between = corners(model, cell, np.array([row["gravity_number"]]))
        causes = split(weights_of_two(cell[1]), between, np.full((1, 2), np.nan), between.asked)
        for name, norm in zip(
            ("frozen_positions", "dissipation_law", "gravity"), causes.norms[:3, 0], strict=True
        ):
            assert row[f"{name}_norm"] == pytest.approx(norm, abs=1e-9)
        assert row["repeats_norm"] == pytest.approx(distance("liu_zhao_brogliato", "model"), abs=1e-9)
        assert row["velocity_divergence"] == pytest.approx(distance("scenario", "model"), abs=1e-9)
        assert row["gravity_number"] == pytest.approx(g / math.sqrt(1 + 1 / c.mass_ratio), rel=1e-12)
        model, stiff, dashpot = (outcomes[n] for n in ("model", "bistiffness", "kelvin_voigt"))
        if "limit" in (model.status, stiff.status):
            expected = NO_PATH
        elif stiff.states != model.states:
            expected = FROZEN_PARTS
        else:
            expected = ALIKE if dashpot.states == model.states else LAW_PARTS
        assert row["paths"] == expected
        seen.add(expected)
        assert not row["failed"]
    assert seen == {ALIKE, FROZEN_PARTS, LAW_PARTS, NO_PATH}


def test_images_are_the_table(mapped):
    images, table = mapped
    assert np.all(np.diff(table["stiffness_ratio"].to_numpy()[:9]) > 0)
    for name, image in images.items():
        np.testing.assert_array_equal(image.ravel(), table[name].to_numpy())


def test_blocks_make_no_difference(mapped, tmp_path, monkeypatch):
    monkeypatch.setattr(planes, "_BLOCK", 20)
    write_plane(PLANE, tmp_path / "map.parquet")
    assert pq.read_table(tmp_path / "map.parquet").equals(mapped[1])


@pytest.mark.parametrize(("e1", "e2"), [(0.9, 0.7), (0.6, 0.5), (1.0, 0.4)])
def test_on_a_soft_table_positions_matter_below_the_border_of_theory(e1, e2, tmp_path):
    # k2/k1 = 0: from m2/m1 = (1 + e2 (1 + e1))/e1 on, B1 is gone when B2 comes up, S1 S2 S4; below, contact 1 returns
    border = (1 + e2 * (1 + e1)) / e1
    plane = Plane(e1, e2, (1e-6, 2e-6), (border / 1.02, border * 1.02), 2, 0.0, math.inf)
    images = write_plane(plane, tmp_path / "map.parquet")
    below, above = images["frozen_positions_norm"]
    assert np.all(above < 1e-9)
    assert np.all(images["repeats_norm"][1] == 0)
    assert np.all(below > 1e-4)
    assert np.all(images["paths"][1] == ALIKE)


def test_the_command_writes_and_says_what_it_found(tmp_path, capsys):
    out = tmp_path / "m"
    assert main(["map", "--e1", "0.9", "--e2", "0.7", "--side", "12", "--out", str(out)]) == 0
    said = capsys.readouterr().out
    for text in (
        "frozen positions: more than 0.01 in",
        "gravity:",
        "state paths: all three alike in",
        "144 cells",
    ):
        assert text in said
    names = {path.name for path in out.iterdir()}
    figures = {f"plane-{n}.{e}" for n in ("causes", "dominant-and-paths") for e in ("png", "pdf")}
    assert names == {"map.parquet", "map.json", "captions.json"} | figures
    described = json.loads((out / "map.json").read_text())
    assert described["gravity_over_v0_sqrt_k1_m1"] == pytest.approx(9.81e-4)
    assert set(described["columns"]) == set(PLANE_SCHEMA.names)
    assert main(["map", "--e1", "0.9", "--e2", "0.7", "--out", str(out)]) == 2
    assert "not empty" in capsys.readouterr().err
    assert (
        main(["map", "--e1", "1", "--e2", "1", "--scenario", "impact", "--side", "3", "--out", f"{out}2"])
        == 0
    )
    assert "gravity:" not in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--e1", "0", "--e2", "0.5"], "--e1 = 0.0; legal: greater than 0, at most 1"),
        (["--e1", "0.5", "--e2", "1.5"], "--e2 = 1.5; legal: from 0 to 1"),
        (["--e1", "x", "--e2", "1"], "--e1 = 'x'; legal: from 0 to 1"),
        (["--e1", "1", "--e2", "1", "--side", "1"], "--side = '1'; legal: a whole number from 2 to 5000"),
        (
            ["--e1", "1", "--e2", "1", "--stiffness-ratio", "2", "1"],
            "--stiffness-ratio = 2 1; legal: two numbers",
        ),
        (["--e1", "1", "--e2", "1", "--mass-ratio", "0", "1"], "--mass-ratio = 0 1; legal: two numbers"),
        (["--e1", "1", "--e2", "1", "--cutoff", "0"], "--cutoff = 0.0; legal: greater than 1"),
        (["--e1", "1", "--e2", "1", "--v0", "1"], "--v0 = 1.0; legal: a finite number < 0"),
        (["--e1", "1", "--e2", "1", "--scenario", "x"], "--scenario = 'x'; legal: 'impact' or 'drop'"),
    ],
)
def test_bad_input_is_one_line(arguments, message, tmp_path, capsys):
    assert main(["map", *arguments, "--out", str(tmp_path / "m")]) == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1
    assert not (tmp_path / "m").exists()


def test_pieces_make_no_difference_and_slow_ones_are_told_one_by_one(tmp_path, monkeypatch):
    where = Plane(0.8, 0.7, (0.1, 10.0), (0.5, 2.0), 6, 0.01, "exact")
    told = []
    write_plane(where, tmp_path / "a")
    monkeypatch.setattr(planes, "_SHORT", 0.0)
    write_plane(where, tmp_path / "b", lambda done, total, line: told.append((done, total)))
    assert told == [(done, 36) for done in range(1, 37)]
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()


def test_after_many_quick_pieces_a_slow_one_halves_the_next(tmp_path, monkeypatch):
    done, clock = [0], iter(range(10**6))
    monkeypatch.setattr(planes, "_BLOCK", 16)
    # Two looks a piece: a second apart up to cell 128, hours apart from there on.
    monkeypatch.setattr(planes.time, "monotonic", lambda: next(clock) * (1.0 if done[-1] <= 128 else 1e4))
    write_plane(
        Plane(0.8, 0.7, (0.1, 10.0), (0.5, 2.0), 16, 0.01, "exact"),
        tmp_path / "a",
        lambda cells, total, line: done.append(cells),
    )
    pieces = np.diff(done)
    assert pieces[:5].tolist() == [1, 2, 4, 8, 1]  # the last ends at its block
    slow = pieces[np.searchsorted(done, 128) :]
    assert pieces.max() == 16
    assert slow[4:].max() <= 2
