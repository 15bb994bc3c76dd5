"""Force timelines of a stored collision: what they integrate to, and what the springs of the law would say."""

import numpy as np
import pandas as pd
import pytest

from impact_xval.experiments.config.configuration import parse_config
from impact_xval.experiments.presentation.figures import write_figures
from impact_xval.experiments.presentation.pictures.timelines import draw_timelines
from impact_xval.experiments.sweep.curves import CURVES, CURVES_SCHEMA, FIGURE_CELL
from impact_xval.experiments.sweep.run import run_sweep
from tests.experiments.conftest import SMALL

CELL = {"stiffness_ratio": 1.0, "mass_ratio": 1.5, "e1": 1.0, "e2": 1.0}
NAMES = ["state-transition", "bistiffness", "kelvin-voigt"]


@pytest.fixture(scope="module")
def curves(tmp_path_factory):
    config = parse_config(SMALL | {"solvers": NAMES, "figure_cell": CELL, "m1": 2.0, "k1": 3e6, "v0": -0.5})
    folder = run_sweep(config, tmp_path_factory.mktemp("run") / "run", isolate=False)
    assert "force-timelines" in [path.stem for path, _ in write_figures(folder)]
    return folder.read_table(CURVES, CURVES_SCHEMA).to_pandas()


def axes_of(curves):
    ((name, figure, caption),) = draw_timelines(curves[curves.curve == FIGURE_CELL], NAMES, CELL)
    assert name == "force-timelines"
    assert "The model has no time" in " ".join(caption.split())
    return np.array(figure.axes).reshape(2, 2)


def test_over_time_forces_integrate_to_the_impulses_of_the_end(curves):
    axes = axes_of(curves)
    for contact in range(2):
        for line in axes[contact, 1].lines:
            rows = curves[(curves.curve == FIGURE_CELL) & (curves.solver == line.get_label())]
            time, force = line.get_xydata().T
            end = rows[f"impulse{contact + 1}"].iloc[-1]
            assert np.trapezoid(force, time) == pytest.approx(end, rel=0.01)


def test_both_columns_show_the_same_forces_on_two_clocks(curves):
    axes = axes_of(curves)
    for contact in range(2):
        for left, right in zip(axes[contact, 0].lines, axes[contact, 1].lines, strict=True):
            assert np.array_equal(left.get_ydata(), right.get_ydata())
            rows = curves[(curves.curve == FIGURE_CELL) & (curves.solver == left.get_label())]
            end = rows.impulse1.iloc[-1] + rows.impulse2.iloc[-1]
            assert left.get_xdata()[-1] == pytest.approx(end, abs=0.05)  # middle of the last interval


def test_of_one_law_without_dissipation_first_forces_are_those_of_two_springs(curves):
    """Until the first contact opens all laws are the same two springs at e = 1: in units of m1, k1, v0

    x1'' = -(x1 - x2), m2 x2'' = x1 - x2 - x2: a system of two modes, written out here.
    """
    axes = axes_of(curves)
    stiffness, masses = np.array([[1.0, -1.0], [-1.0, 2.0]]), np.array([1.0, 1.5])
    values, vectors = np.linalg.eigh(stiffness / np.sqrt(np.outer(masses, masses)))
    for contact in range(2):
        for line in axes[contact, 1].lines:
            time, force = line.get_xydata().T
            early = time < 1.5
            start = vectors.T @ (np.sqrt(masses) * [1.0, 0.0])
            modes = start[:, None] * np.sin(np.sqrt(values)[:, None] * time[early]) / np.sqrt(values)[:, None]
            down = (vectors @ modes) / np.sqrt(masses)[:, None]
            springs = (down[0] - down[1], down[1])[contact]
            assert early.sum() > 5
            assert np.abs(force[early] - springs).max() < 0.01


def test_a_model_without_a_finite_clock_is_left_out(curves):
    endless = curves.copy()
    endless.loc[endless.solver == NAMES[0], "time"] = np.inf
    axes = axes_of(endless)
    assert [line.get_label() for line in axes[0, 0].lines] == NAMES[1:]
    endless["time"] = np.inf
    assert list(draw_timelines(endless[endless.curve == FIGURE_CELL], NAMES, CELL)) == []
    assert list(draw_timelines(pd.DataFrame(columns=curves.columns), NAMES, CELL)) == []
