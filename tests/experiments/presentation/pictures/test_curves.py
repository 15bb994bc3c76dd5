"""Curves and histories of collisions, compared with printed numbers, formulas, an independent solution and springs."""

import json
import math

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest
from scipy.integrate import trapezoid

from impact_xval.compliant_baselines import get_solver
from impact_xval.compliant_baselines.solver import Settings
from impact_xval.experiments.commands.cli import main
from impact_xval.experiments.config.experiment import parse_config
from impact_xval.experiments.presentation.pictures.curves import (
    draw_cell_curves,
    draw_collision,
    drawable_paths,
)
from impact_xval.experiments.presentation.pictures.history import make_history
from impact_xval.experiments.presentation.pictures.supplement import draw_supplement_figures
from impact_xval.model import Collision, Outcome, solve
from tests.model.oracle import solve_oracle

M2 = 2 / math.sqrt(3)
#: Final velocities in panel 1b. The origin of such numbers is in tests/published/test_printed_values.py.
EXACT_1B = (0.88981120733190, 0.00016910787873)


@pytest.fixture(scope="module")
def panels():
    found = {}
    for name, figure, _ in draw_supplement_figures():
        upper = [ax for ax in figure.axes if ax.get_title().startswith("(")]
        found |= {name[-1] + ax.get_title()[1]: ax for ax in upper}
    return found


def drawn(ax, label):
    """Return the points of all lines with a label, one line after the other."""
    points = np.concatenate([line.get_xydata() for line in ax.lines if line.get_label() == label])
    return points[np.isfinite(points).all(axis=1)]


def impulses(v1, v2, m2=M2):
    """Return the impulses of both contacts, per m1 abs(v0), from the momentum of B1 and of both balls."""
    return 1 + v1, 1 + v1 + m2 * v2


def test_2a_turns_where_the_supplement_says(panels):
    """Curve 2a goes horizontally to (1 + e1) m2/(1 + m2), vertically by e1 m2, then along l1 to the velocity 0.45203.

    The corners are compared with the supplement's values, the end to 2e-5.
    """
    turn = 1.9 * M2 / (1 + M2)
    horizontal, vertical = drawn(panels["2a"], "S1"), drawn(panels["2a"], "S2")
    assert np.abs(vertical[:, 0] - turn).max() < 1e-12
    assert vertical[[0, -1], 1] == pytest.approx([0, 0.9 * M2], abs=1e-12)
    flat = horizontal[np.abs(horizontal[:, 1]) < 1e-12]
    assert flat[:, 0].max() == pytest.approx(turn, abs=1e-12)
    assert drawn(panels["2a"], "exact end")[0] == pytest.approx(impulses(0.45203, 0.45203), abs=2e-5)
    corners = [(M2 / (1 + M2), 0), (turn, 0), (turn, 0.9 * M2), impulses(0.45203, 0.45203)]
    assert drawn(panels["2a"], "printed") == pytest.approx(np.array(corners), abs=1e-12)


def test_exact_and_printed_ends_stand_side_by_side(panels):
    of_2b = (0.46187997174429, 0.43939196930137)
    for name, printed, exact in (("1b", (0.88922, 0.00022), EXACT_1B), ("2b", (0.4573, 0.44281), of_2b)):
        (window,) = panels[name].child_axes
        for ax in (panels[name], window):
            assert drawn(ax, "exact end")[0] == pytest.approx(impulses(*exact), abs=1e-11)
            assert drawn(ax, "printed")[0] == pytest.approx(impulses(*printed), abs=1e-12)


def test_curves_without_printed_velocities_end_where_the_oracle_does(panels):
    for name, cell in {"3a": (7 / 2, M2, 0.2, 0.7), "3b": (2 / 9, 1 / math.sqrt(3), 0.9, 0.2)}.items():
        outcome = solve_oracle(Collision.from_ratios(*cell))
        end = impulses(outcome.v1, outcome.v2, cell[1])
        assert drawn(panels[name], "exact end")[0] == pytest.approx(end, abs=1e-6)
        assert not any(line.get_label() == "printed" for line in panels[name].lines)
    i1, i2 = drawn(panels["3a"], "S1")[-1]  # the curve ends on the line l1
    assert -1 + (1 + 1 / M2) * i1 - i2 / M2 == pytest.approx(0, abs=1e-12)


def test_the_command_writes_each_figure_with_its_caption(tmp_path):
    root = tmp_path / "drawn"
    assert main(["report", str(root), "--supplement"]) == 0
    names = ["supplement-1", "supplement-2", "supplement-3"]
    assert {path.stem for path in root.iterdir()} == {*names, "captions"}
    assert list(json.loads((root / "captions.json").read_text(encoding="utf-8"))) == names


def test_curves_of_one_collision_end_at_the_printed_numbers_whatever_the_units():
    collision = Collision.two_balls(m1=3.0, m2=3.0 * M2, k1=1e7, k2=40e7, e1=0.9, e2=0.7, v0=-2.0)
    outcomes = {
        "state-transition": solve(collision, path=True),
        "kelvin-voigt": get_solver("kelvin-voigt").solve(collision, Settings(record_path=True)),
        "mujoco": Outcome.failure("mujoco", collision, "timeout", "too long"),
    }
    figure = draw_collision(collision, drawable_paths(collision, outcomes))
    curve, *velocities = (drawn(ax, "the model") for ax in figure.axes)
    ends = impulses(*EXACT_1B)
    assert curve[-1] == pytest.approx(ends, abs=1e-11)
    for line, start, end in zip(velocities, (-1.0, 0.0), EXACT_1B, strict=True):
        assert line[0] == pytest.approx([0, start], abs=1e-12)
        assert line[-1] == pytest.approx([sum(ends), end], abs=1e-11)


def test_curves_of_chains_are_those_of_the_chain_of_the_figures(chain_run):
    """In the curves of a run, the impulse of contact 1 equals the change of ball 1's momentum.

    Both are divided by m1 |v0|. They agree within 2 % of their value.
    """
    curves = {row["solver"]: row for row in pq.read_table(chain_run / "curves.parquet").to_pylist()}
    for name in ("state-transition", "kelvin-voigt", "mujoco"):
        row = curves[name]
        assert len(row["velocities"]) == 4
        passed = trapezoid(row["forces"][0], row["time"])
        assert passed == pytest.approx(1 + row["velocities"][0], rel=2e-2)


ELASTIC = Collision.two_balls(m1=2.0, m2=3.0, k1=1e6, k2=3e6, e1=1.0, e2=1.0, v0=-0.5)


def of(name, **settings):
    outcome = get_solver(name).solve(ELASTIC, Settings(record_path=True, **settings))
    return outcome, make_history(ELASTIC, outcome.path, settings.get("gravity", 0.0))


@pytest.mark.parametrize("name", ["kelvin-voigt", "mujoco"])
def test_without_damping_a_force_is_that_of_a_spring_of_its_compression(name):
    """Without damping each force is that of a spring: force 1 is compression 1, force 2 is k2/k1 compression 2.

    Forces and compressions are in units in which k1 is 1, with the length abs(v0) sqrt(m1/k1).
    """
    _, history = of(name)
    between = 0.5 * (history.compressions[1:] + history.compressions[:-1])
    springs = np.maximum(between, 0) * [1, 3]
    assert np.abs(history.forces - springs).max() < 0.02
    assert springs.max() > 0.5


def test_after_the_last_instant_balls_fly_on_with_the_velocities_of_the_outcome():
    outcome, history = of("kelvin-voigt")
    last = history.time[-1]
    heights, _, forces, acting = history.at(np.array([last, last + 2.0]))
    assert heights[1] - heights[0] == pytest.approx(np.array(outcome.velocities) * 2 / 0.5, rel=1e-9)
    assert forces[1].tolist() == [0.0, 0.0]
    assert not acting[1].any()


def test_a_drop_begins_where_the_table_carries_b2():
    _, history = of("kelvin-voigt", scenario="drop", gravity=9.81)
    length = 0.5 * math.sqrt(2.0 / 1e6)
    assert history.heights[0] == pytest.approx([-3.0 * 9.81 / 3e6 / length] * 2)
    weight = 3.0 * 9.81 / (0.5 * math.sqrt(2.0 * 1e6))
    assert history.forces[0, 1] == pytest.approx(weight, rel=0.05)


def test_without_a_finite_clock_there_is_no_history():
    collision = Collision.from_ratios(0.0, 1.0, 0.9, 0.7)
    assert make_history(collision, solve(collision, path=True).path) is None


def test_the_caption_names_the_key_of_the_collision():
    curves = pd.DataFrame({"solver": ["state-transition"], "impulses": [[[0.0, 0.0], [1.9, 1.9]]]})
    ((name, _, caption),) = draw_cell_curves(curves, parse_config({}))
    assert name == "impulse-curves"
    assert (
        "figure_cell of the experiment chooses the collision, which need not be a cell of the run" in caption
    )
