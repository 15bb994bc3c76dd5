"""Engines as people use them: with longer steps, with documented parameters, or with default settings only."""

import subprocess
import sys

import pytest

from impact_xval.compliant_baselines import get_solver
from impact_xval.compliant_baselines.registry import STEPS
from impact_xval.compliant_baselines.restitution import damping_ratio
from impact_xval.compliant_baselines.solver import Convergence, Settings, SolverError
from impact_xval.model.collision import Collision
from tests.compliant_baselines.conftest import installed

#: Two balls on a table with gaps of a ten-thousandth of the balls' radius of 6.25 cm.
APART = Collision((1.0, 2.0), (1e8, 1e8), (0.9, 0.9), (-1.0, 0.0), table=True, gaps=(6.25e-6, 6.25e-6))
BASIC = Collision.two_balls(1.0, 2.0, 1e6, 1e6, 0.9, 0.7)


@pytest.mark.parametrize("engine", ["mujoco", "pybullet"])
@pytest.mark.parametrize("step", STEPS)
def test_a_step_of_practice_is_the_calibrated_engine_at_that_step_and_has_no_limit(engine, step):
    found = get_solver(f"{engine}:step-{step:g}").solve(BASIC, Settings(convergence=Convergence()))
    assert found.velocities == get_solver(engine).solve(BASIC, Settings(step_fraction=step)).velocities
    assert "limit_error" not in found.diagnostics


def by_hand(solrefs: list[str], option: str) -> tuple[float, float]:
    """Return the final velocities of `BASIC` in a scene that a user of MuJoCo would write, without a <pair>."""
    mujoco = pytest.importorskip("mujoco")
    model = mujoco.MjModel.from_xml_string(f"""<mujoco><option gravity="0 0 0" {option}/>
    <default><joint type="slide" axis="0 0 1"/></default><worldbody>
    <body pos="0 0 0.375"><joint/><geom size="0.125" mass="1" {solrefs[0]}/></body>
    <body pos="0 0 0.125"><joint/><geom size="0.125" mass="2" {solrefs[1]}/></body>
    <geom type="plane" size="1 1 1" {solrefs[2]}/></worldbody></mujoco>""")
    data = mujoco.MjData(model)
    data.qvel[:] = -1, 0
    for _ in range(200_000):
        mujoco.mj_step(model, data)
        if data.qpos[0] > data.qpos[1] > 0 and data.qvel[0] > data.qvel[1]:
            return tuple(data.qvel.tolist())
    raise AssertionError("not over")


def test_mujoco_as_it_ships_is_a_scene_in_which_nothing_is_set():
    found = get_solver("mujoco:default").solve(BASIC)
    assert found.velocities == pytest.approx(by_hand([""] * 3, ""), abs=2e-6)
    assert found.effective["step"] == (0.002,)
    other = Collision.two_balls(1.0, 2.0, 1e4, 1e8, 0.0, 1.0)
    assert get_solver("mujoco:default").solve(other).velocities == found.velocities
    with pytest.raises(SolverError, match="an engine as it ships is run without gravity; legal: 'impact'"):
        get_solver("mujoco:default").solve(BASIC, Settings(scenario="drop"))


def test_mujoco_as_documented_is_a_scene_with_time_constant_and_damping_ratio():
    e = 0.8
    c = Collision.two_balls(1.0, 2.0, 1e6, 3e6, e, e)
    zeta, masses = damping_ratio(e), (2 / 3, 2.0)
    ball, table = (1 / (zeta * (k / m) ** 0.5) for k, m in zip(c.stiffnesses, masses, strict=True))
    # A pair of geoms uses one solref, here of the geom with the higher priority.
    solrefs = [f'solref="{ball!r} {zeta!r}" priority="1"', "", f'solref="{table!r} {zeta!r}" priority="2"']
    found = get_solver("mujoco:documented").solve(c)
    step = f'timestep="{found.diagnostics["step"]!r}" tolerance="0"'
    assert found.velocities == pytest.approx(by_hand(solrefs, step), abs=1e-4)
    with pytest.raises(SolverError, match=r"e2 = 1: no time constant and damping ratio are undamped"):
        get_solver("mujoco:documented").solve(Collision.two_balls(1.0, 2.0, 1e6, 1e6, 0.9, 1.0))


def test_pybullet_as_it_ships_heeds_nothing_that_ran_before():
    pytest.importorskip("pybullet")
    code = "from impact_xval import Collision, get_solver; "
    code += f"print(get_solver('pybullet:default').solve({APART!r}).velocities)"
    alone = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    get_solver("pybullet").solve(BASIC)  # this run sets a threshold for the whole process
    assert repr(get_solver("pybullet:default").solve(APART).velocities) == alone.stdout.strip()
    assert alone.stderr == ""


def test_pybullet_as_it_ships_rebounds_above_its_threshold_only():
    pytest.importorskip("pybullet")
    solve = get_solver("pybullet:default").solve
    for v0, rebound in ((-1.0, 0.7), (-0.15, 0.0)):
        one = solve(Collision((1.0,), (1e6,), (0.7,), (v0,), table=True))
        assert one.velocities == pytest.approx((rebound,), abs=0.01)
        assert one.effective["step"] == (1 / 240,)
    with pytest.raises(SolverError, match=r"\|v0\| = 100 m/s: more than a radius of 0.0625 m in a step"):
        solve(Collision.two_balls(1.0, 2.0, 1e6, 1e6, 0.9, 0.7, v0=-100.0))


@pytest.mark.parametrize(
    ("name", "below", "above", "step"),
    # DART gives no rebound of 0.1 m/s or less, which is 0.4 times 0.25 m/s.
    [("dart", 0.24, 0.26, 1e-3), ("rapier", None, 1e-2, 1 / 60), ("sapien", 1.99, 2.01, 1e-2)],
)
def test_a_rigid_engine_as_it_ships_rebounds_above_its_threshold_only(name, below, above, step):
    e = 0.4
    solve = installed(f"{name}:default").solve

    def rebound(speed: float, stiffness: float = 1e6) -> float:
        found = solve(Collision((1.0,), (stiffness,), (e,), (-speed,), table=True))
        assert found.effective["step"] == pytest.approx((step,))
        return found.velocities[0] / speed

    if below is not None:
        assert rebound(below) == pytest.approx(0.0, abs=2e-3)
    assert rebound(above) == pytest.approx(e, abs=2e-3)
    assert rebound(above, stiffness=1e3) == rebound(above)
