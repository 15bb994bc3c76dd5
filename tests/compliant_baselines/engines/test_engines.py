"""Properties that all engine adapters share."""

import math
import sys
from itertools import product

import numpy as np
import pytest

from examples.toy_engine import ToyEngine
from impact_xval.compliant_baselines import SolverError, get_solver
from impact_xval.compliant_baselines.engines import engine as engine_module
from impact_xval.compliant_baselines.engines import stepping
from impact_xval.compliant_baselines.engines.engine import Engine
from impact_xval.compliant_baselines.engines.mujoco import Mujoco
from impact_xval.compliant_baselines.engines.scene import Scene
from impact_xval.compliant_baselines.mapping import restitution
from impact_xval.compliant_baselines.solver import Settings
from impact_xval.model.collision import Collision
from tests.compliant_baselines.conftest import installed
from tests.compliant_baselines.reference_cells import random_collisions
from tests.model.test_chains import random_chains

COARSE = Settings(step_fraction=5e-3)


def cell(m1=1.0, m2=1.0, k1=1e8, k2=1e8, e1=0.5, e2=0.5, v0=-1.0):
    return Collision.two_balls(m1, m2, k1, k2, e1, e2, v0)


def test_theorem_5_when_the_step_scales_along(engine):
    factors = (1e-6, 1e-3, 1e4)
    for k1, what, factor in product((1.0, 1e8), "kmv", factors):
        k, m, v = (factor if what == scaled else 1.0 for scaled in "kmv")
        cells = random_collisions(6, 7, k1=k1, decades=(2, 0.5))
        scaled = [
            Collision.two_balls(c.m1 * m, c.m2 * m, c.k1 * k, c.k2 * k, c.e1, c.e2, c.v0 * v) for c in cells
        ]
        both = (engine.solve_many(some, COARSE) for some in (cells, scaled))
        for a, b in zip(*both, strict=True):
            assert (a.status, b.status) == ("ok", "ok"), (k1, what, factor)
            assert (b.v1 / v, b.v2 / v) == pytest.approx((a.v1, a.v2), abs=1e-9), (k1, what, factor)
            assert b.states == a.states, (k1, what, factor)


def test_what_an_engine_cannot_represent_is_refused(engine):
    beyond = "periods, penetrations or energies beyond double precision"
    light = cell(m1=1e147, k1=1e-193)
    for name, collision, says in (
        (engine.name, cell(k2=math.inf), r"k2 = inf N/m: .* finite stiffness > 0"),
        (engine.name, cell(k1=0.0), r"k1 = 0.0 N/m: .* finite stiffness > 0"),
        (engine.name, cell(e1=0.0), r"e1 = 0: no finite damping"),
        (engine.name, cell(e2=0.0), r"e2 = 0: no finite damping"),
        ("mujoco", cell(k1=1e22, k2=1e22), r"accelerations .* = 1\.\d+e\+11 .*: MuJoCo accepts 1e\+10"),
        ("mujoco", cell(v0=-5e-324), beyond),
        ("mujoco", light, beyond),
        ("mujoco", Collision((1,) * 62, (1,) * 61, (1,) * 61, (-1,) + (0,) * 61), "61 contacts: .* up to 60"),
        ("pybullet", light, beyond),
        ("pybullet", cell(v0=-1e-200), beyond),
        ("pybullet", cell(k1=1, k2=1, v0=-1e6), r"radius .* PyBullet drops bodies larger than 1e\+06"),
        ("pybullet", cell(k1=1e30, k2=1e30), r"step = .* PyBullet ignores steps of .* or less"),
        ("pybullet", cell(m1=1e11, m2=1e11), r"PyBullet caps a contact at 1e\+10 N s a step"),
        (
            "pybullet-naive",
            Collision((1, 1, 1), (1, 1), (1, 0.9), (-1, 0, 0)),
            "PyBullet's is that of two balls",
        ),
    ):
        if name.startswith(engine.name):
            with pytest.raises(SolverError, match=rf"{name}: unrepresentable: .*{says}"):
                get_solver(name).solve(collision, COARSE)


def test_running_out_of_steps_is_a_timeout(engine):
    c = random_collisions(1, 7)[0]
    needed = int(engine.solve(c, COARSE).diagnostics["n_steps"])
    assert engine.solve(c, Settings(step_fraction=5e-3, max_steps=needed)).status == "ok"
    with pytest.raises(SolverError, match=rf"timeout: not over after {needed - 1} steps"):
        engine.solve(c, Settings(step_fraction=5e-3, max_steps=needed - 1))


def test_a_step_too_long_for_the_damping_is_no_answer():
    # A dashpot c that is integrated explicitly with step h is unstable if c h/M exceeds 2, where M is the reduced mass.
    # With a damping ratio of 5 and a step of a tenth of a period, c h/M is 6.
    (outcome,) = get_solver("mujoco").solve_many([cell(e1=0.01, e2=0.01)], Settings(step_fraction=0.1))
    assert outcome.status in ("unconverged", "crashed", "timeout")
    assert outcome.reason


def test_mujoco_s_complaint_becomes_a_crash_and_leaves_no_trace(tmp_path, monkeypatch, capfd):
    import mujoco

    from impact_xval.compliant_baselines.engines.mujoco import Mujoco

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(Mujoco, "refusal", lambda *_: None)
    before = mujoco.get_mju_user_warning()
    outcome = Mujoco().solve_many([cell(k1=1e24, k2=1e24)], COARSE)[0]
    assert outcome.status == "crashed"
    assert "beyond 1e+10" in outcome.reason
    assert mujoco.get_mju_user_warning() is before
    assert list(tmp_path.iterdir()) == []  # MuJoCo wrote no MUJOCO_LOG.TXT
    assert capfd.readouterr() == ("", "")


def test_mujoco_s_profiler_has_no_clock_while_scenes_run():
    import mujoco

    model = mujoco.MjModel.from_xml_string("<mujoco/>")

    def clock():
        data = mujoco.MjData(model)
        mujoco.mj_step(model, data, nstep=1000)
        return data.timer[mujoco.mjtTimer.mjTIMER_STEP].duration > 0

    had_clock = clock()  # MuJoCo 3.2.7 has no clock at all
    with installed("mujoco").running():
        assert not clock()
    assert clock() == had_clock


def test_a_missing_engine_names_the_command_that_installs_it(monkeypatch):
    for module, name, advice in (
        ("pybullet", "pybullet", "PyBullet is not installed: run pip install 'pybullet>=3.2.7'"),
        ("mujoco.rollout", "mujoco", "pip install 'mujoco>=3.2.7'"),
        ("pydrake", "drake", "pip install 'impact-xval[drake]'"),
        ("pydrake", "drake-hunt-crossley", "pip install 'impact-xval[drake]'"),
        ("dartpy", "dart:default", "DART is not installed: run pip install 'impact-xval[dart]'"),
    ):
        monkeypatch.setitem(sys.modules, module, None)
        outcome = get_solver(name).solve_many([cell()], COARSE)[0]
        assert outcome.status == "unavailable"
        assert advice in outcome.reason


def test_an_engine_whose_requirement_is_missing_is_not_said_to_be_missing(tmp_path, monkeypatch):
    (tmp_path / "half_an_engine.py").write_text("import gone_with_setuptools")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(Mujoco, "module", "half_an_engine")
    said = Mujoco().unavailable()
    assert "cannot be imported" in said
    assert "No module named 'gone_with_setuptools'" in said
    assert "is not installed" not in said


@pytest.mark.parametrize(("version", "is_old"), [("3.1.6", True), ("3.2.7", False), ("3.10.0", False)])
def test_an_engine_that_is_too_old_is_unavailable(version, is_old, monkeypatch):
    monkeypatch.setattr(Mujoco, "version", lambda _: version)
    monkeypatch.setattr(engine_module, "import_quietly", lambda _: None)
    said = Mujoco().unavailable()
    if is_old:
        assert said == f"MuJoCo {version} is too old: 3.2.7 or later runs: run pip install 'mujoco>=3.2.7'"
    else:
        assert said is None


@pytest.mark.parametrize("scenario", ["impact", "drop"])
def test_a_path_has_the_states_of_its_outcome_and_not_too_many_points(engine, scenario):
    c = Collision.two_balls(m1=1.0, m2=2 / 3**0.5, k1=1e8, k2=2.5e6, e1=0.9, e2=0.7)
    settings = Settings(scenario=scenario, record_path=True)
    o = engine.solve(c, settings)
    path = o.path
    assert stepping.PATH_POINTS / 2.1 < len(path.time) <= stepping.PATH_POINTS + 4 * len(o.states) + 100
    # the path has the states of the outcome, and two samples at each time at which the active contacts change
    change = np.flatnonzero(np.diff(path.state))
    walked = tuple(f"S{s}" for s in path.state[np.append(change, -1)])
    assert (walked if walked[-1] == "S4" else (*walked, "S4")) == o.states
    assert np.array_equal(path.time[change], path.time[change + 1])


def test_plastic_balls_in_a_drop_on_a_rigid_table_are_at_rest_after_a_step():
    class Falling(ToyEngine):
        refusal = Engine.refusal  # the example itself refuses drops only

    for scenario in ("impact", "drop"):
        outcome = Falling().solve(cell(e1=0.0, e2=0.0), Settings(scenario=scenario))
        assert (outcome.velocities, outcome.mark) == ((0, 0), ""), scenario
        assert outcome.diagnostics["n_steps"] <= 2


def test_pybullet_client_is_given_back():
    p = pytest.importorskip("pybullet")
    solver = get_solver("pybullet")
    # a PyBullet client that the solver did not connect, and that it must not change
    taken = p.connect(p.DIRECT)
    try:
        p.setGravity(0, 0, -3, physicsClientId=taken)
        beside = solver.solve(cell(), COARSE)
        assert p.connect(p.DIRECT) == taken + 1
        p.disconnect(taken + 1)
        assert p.getNumBodies(physicsClientId=taken) == 0
    finally:
        p.disconnect(taken)
    assert beside == solver.solve(cell(), COARSE)


def test_an_engine_says_where_it_uses_other_numbers_than_were_asked_for(engine):
    pair, line = cell(k2=3e8), Collision((1, 2, 1), (1e8, 2e8), (0.5, 1.0), (-1, 0, 0))
    for collision in (pair, line):
        outcome = engine.solve(collision, COARSE)
        assert outcome.differences == ""
        assert outcome.effective["stiffness"] == pytest.approx(collision.stiffnesses, rel=1e-9)
        assert outcome.effective["step"] == (outcome.diagnostics["step"],)
    naive = get_solver(f"{engine.name}-naive").solve(pair, COARSE)
    # MuJoCo's naive mapping takes N/m for 1/s^2, which gives k M (0.9/0.95)^2. PyBullet puts the stiffnesses of two
    # balls in series, which gives k/2.
    alone = 1e8 * 0.5 * ((0.9 / 0.95) ** 2 if engine.name == "mujoco" else 1)
    assert naive.effective["stiffness"][0] == pytest.approx(alone, rel=1e-9)
    assert f"stiffness 1 is {alone:.6g}, 1e+08 was asked for" in naive.differences


def test_a_naive_contact_of_mujoco_rebounds_as_the_numbers_say_that_it_uses():
    pair = Collision((1, 3), (1e8,), (0.5,), (-1, 0))
    found = get_solver("mujoco-naive").solve(pair, Settings(step_fraction=1e-4))
    (k,), (c,) = found.effective["stiffness"], found.effective["damping"]
    assert found.v1 - found.v2 == pytest.approx(restitution(c / (2 * math.sqrt(k * 0.75))), abs=2e-4)


SCENES = [
    ("impact", 1e8, 1e-3),
    ("impact", 1e8, 1e-2),
    ("drop", 1e8, 1e-3),
    ("drop", 1e5, 2e-3),  # gravity matters here: B2 comes to rest, and balls may end at rest together
    ("drop", 1e3, 5e-3),
]


def scenes(scenario, k1, step_fraction, n, seed):
    rng, settings = np.random.default_rng(seed), Settings(scenario=scenario, step_fraction=step_fraction)
    masses, ratios = 10 ** rng.uniform(-0.5, 0.5, n), 10 ** rng.uniform(-2, 2, n)
    cells = zip(masses, k1 * ratios, *rng.choice([0.2, 0.5, 0.8, 1.0], (2, n)), strict=True)
    return [Scene.of(Collision.two_balls(1.0, m2, k1, k2, e1, e2), settings) for m2, k2, e1, e2 in cells]


def everything(run):
    ends = (run.end, *run.velocities.tolist(), run.n_steps, run.starts)
    return repr((*ends, run.raw_states.start.tolist(), run.raw_states.state.tolist()))


def test_many_steps_a_call_are_single_steps_to_the_bit(monkeypatch):
    engine = installed("pybullet")
    chains = random_chains(5, 6, table=True)
    lines = [Scene.of(chain, Settings(step_fraction=2e-3)) for chain in chains]
    for some in (*(scenes(*scene, n=5, seed=11) for scene in SCENES), lines):
        found = []
        for record_path, shortest in ((False, 10**9), (False, 8), (True, 8)):
            monkeypatch.setattr(stepping, "SHORTEST_LEAP", shortest)
            found.append([everything(run) for run in engine.run(some, 30_000, record_path)])
        assert found[0] == found[1] == found[2]
