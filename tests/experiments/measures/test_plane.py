"""Dense maps: where theory draws a border they have one."""

import json
import math

import numpy as np
import pytest

from impact_xval.experiments.commands.cli import main
from impact_xval.experiments.measures.plane import (
    ALIKE,
    Plane,
    write_plane,
)


def test_on_a_soft_table_positions_matter_below_the_border_of_theory(tmp_path):
    # k2/k1 = 0: from m2/m1 = (1 + e2 (1 + e1))/e1 on, B1 is gone when B2 comes up, S1 S2 S4; below, contact 1 returns
    for e1, e2 in ((0.9, 0.7), (0.6, 0.5), (1.0, 0.4)):
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
    assert "144 cells" in capsys.readouterr().out
    names = {path.name for path in out.iterdir()}
    figures = {f"plane-{n}.{e}" for n in ("causes", "dominant-and-paths") for e in ("png", "pdf")}
    assert names == {"map.parquet", "map.json", "captions.json"} | figures
    described = json.loads((out / "map.json").read_text())
    assert described["gravity_over_v0_sqrt_k1_m1"] == pytest.approx(9.81e-4)
    assert main(["map", "--e1", "0.9", "--e2", "0.7", "--out", str(out)]) == 2
    assert "not empty" in capsys.readouterr().err
    for option, value, legal in (
        ("--e1", "0", "greater than 0, at most 1"),
        ("--v0", "1", "a finite number < 0"),
    ):
        assert main(["map", "--e1", "1", "--e2", "1", option, value, "--out", f"{out}2"]) == 2
        assert f"{option} = {float(value)}; legal: {legal}" in capsys.readouterr().err
