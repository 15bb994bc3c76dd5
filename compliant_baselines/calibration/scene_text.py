"""A column as files that an engine runs alone, without this package.

Neither scene is written a second time here. MuJoCo's is read off the batch that the adapter has loaded: the numbers
that stand in it, written into the adapter's own MJCF. PyBullet's is the adapter's own calls, recorded while it makes
them. The runners step as often as the adapter did and compare with what it got.
"""

from __future__ import annotations

import textwrap
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any
from xml.etree import ElementTree

import numpy as np

from impact_xval.compliant_baselines.contact.column import Column
from impact_xval.compliant_baselines.contract.registry import exportable_names
from impact_xval.compliant_baselines.engines import mujoco_engine
from impact_xval.compliant_baselines.engines.engine import EngineSolver
from impact_xval.compliant_baselines.engines.packages import standing_in
from impact_xval.compliant_baselines.engines.recording import Run

#: Engines that can be exported.
EXPORTABLE = exportable_names()


def scene_files(solver: EngineSolver, column: Column, max_steps: int) -> tuple[Run, dict[str, str]]:
    """Run a column, and write down how to run it without this package.

    Parameters
    ----------
    solver : EngineSolver
        One of `EXPORTABLE`, available.
    column : Column
        What to run.
    max_steps : int
        Steps after which it is given up.

    Returns
    -------
    run : Run
        What the adapter made of it.
    files : dict
        Names and contents.
    """
    if solver.name == "mujoco":
        (run,) = solver.run_columns([column], max_steps)
        return run, {"scene.xml": mjcf(column), "run.py": _mujoco_runner(solver, run)}
    with _recorded() as calls:
        (run,) = solver.run_columns([column], max_steps)
    return run, {"run.py": _pybullet_script(solver, run, calls)}


def _words(values: Any) -> str:
    return " ".join(repr(float(value)) for value in np.ravel(values))


def mjcf(column: Column) -> str:
    """Write the scene MuJoCo runs for a column, its initial state as the keyframe ``start``."""
    from mujoco.batch import Batch

    batch = Batch(mujoco_engine.scene_model(), 1, 1)
    mujoco_engine.load(batch, [column], 1, False)
    model, root = batch.model, ElementTree.fromstring(mujoco_engine.SCENE)

    def loaded(field: str, row: int | None = None) -> Any:
        expanded = batch.expanded(field)
        assert expanded is not None, field
        values = expanded[0]
        return values if row is None else values[row]

    def element(path: str) -> ElementTree.Element:
        found = root.find(path)
        assert found is not None, path
        return found

    option = element("option")
    for name in ("timestep", "tolerance", "gravity"):
        option.set(name, _words(loaded(f"opt.{name}")))
    for name in ("B1", "B2"):
        body, geom = model.body(name).id, model.geom(name).id
        placed = element(f".//body[@name='{name}']")
        placed.set("pos", _words(loaded("body_pos", body)))
        # As in the batch, where masses and sizes are written after compiling: the inertia, which nothing turns on a
        # slide, is the template's, and no compiler finds that of a small ball too small.
        inertial = {"pos": "0 0 0", "mass": _words(loaded("body_mass", body)), "diaginertia": "1 1 1"}
        placed.insert(0, ElementTree.Element("inertial", inertial))
        shape = element(f".//geom[@name='{name}']")
        shape.set("size", _words(loaded("geom_size", geom)[0]))
        del shape.attrib["mass"]
    for name in ("ball-ball", "ball-table"):
        pair = element(f".//pair[@name='{name}']")
        pair.set("solref", _words(loaded("pair_solref", model.pair(name).id)))
        pair.set("solimp", _words(loaded("pair_solimp", model.pair(name).id)))
    start = ElementTree.SubElement(ElementTree.SubElement(root, "keyframe"), "key", name="start")
    start.set("qpos", _words(batch.qpos[0]))
    start.set("qvel", _words(batch.qvel[0]))
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode") + "\n"


def _facts(solver: EngineSolver, run: Run) -> str:
    c = run.column
    return textwrap.dedent(f"""\
        # Two balls above a table, on one vertical line; SI units, up is positive.
        #   B1 (upper): {c.m1!r} kg, starts at {c.v1!r} m/s; B2 (lower): {c.m2!r} kg, at {c.v2!r} m/s
        #   contact 1, ball on ball:  F = max(0, k d + c d'), k = {c.contact1.k!r} N/m, c = {c.contact1.c!r} N s/m
        #   contact 2, ball on table: F = max(0, k d + c d'), k = {c.contact2.k!r} N/m, c = {c.contact2.c!r} N s/m
        #   gravity {c.gravity!r} m/s^2, {run.raw.n_steps} steps of {c.step!r} s: then the collision is over
        STEPS, STEP = {run.raw.n_steps}, {c.step!r}
        FLIGHT = {run.fall and run.fall[0]!r}  # steps until both balls are in the air: no gravity from there on
        V1, V2 = {run.v1!r}, {run.v2!r}  # what {solver.name} {solver.version()} gave in the table, in m/s
        """)


_COMPARE = """\
print(f"v1 = {v1!r} m/s, in the table {V1!r}, difference {v1 - V1:.1e}")
print(f"v2 = {v2!r} m/s, in the table {V2!r}, difference {v2 - V2:.1e}")
if max(abs(v1 - V1), abs(v2 - V2)) > 1e-12 * SPEED:
    sys.exit("not the same: another version of the engine?")
"""


def _mujoco_runner(solver: EngineSolver, run: Run) -> str:
    return (
        '"""Runs scene.xml in MuJoCo alone and compares with the table: python run.py"""\n\n'
        "import sys\nfrom pathlib import Path\n\nimport mujoco\n\n"
        + _facts(solver, run)
        + f"SPEED = {max(abs(run.column.v1), abs(run.column.v2))!r}\n\n"
        + textwrap.dedent("""\
            model = mujoco.MjModel.from_xml_path(str(Path(__file__).with_name("scene.xml")))
            data = mujoco.MjData(model)
            mujoco.mj_resetDataKeyframe(model, data, model.key("start").id)
            for i in range(STEPS):
                if i == FLIGHT:
                    model.opt.gravity[:] = 0
                mujoco.mj_step(model, data)
            v1, v2 = (float(data.joint(name).qvel[0]) for name in ("B1", "B2"))
            """)
        + _COMPARE
    )


class _Named(int):
    """A number that stands in a script under a name."""

    name: str

    def __new__(cls, value: int, name: str) -> _Named:
        named = super().__new__(cls, value)
        named.name = name
        return named

    def __repr__(self) -> str:
        return self.name


#: Calls that advance a world: those after the last other one are the run itself, and no part of its setting up.
_STEPPING = ("stepSimulation", "setPhysicsEngineParameter")


class _RecordingModule:
    """The module pybullet, writing down the calls that set a world up."""

    def __init__(self, module: Any) -> None:
        self._module = module
        self._counts: dict[str, int] = {}
        self._stepping: list[tuple[str, int]] = []
        self.calls: list[str] = []

    def __getattr__(self, name: str) -> Any:
        value = getattr(self._module, name)
        if not callable(value):
            return _Named(value, f"p.{name}") if type(value) is int else value
        return value if name.startswith("get") or name == "disconnect" else self._recording(name, value)

    def _recording(self, name: str, function: Any) -> Any:
        def call(*args: Any, **kwargs: Any) -> Any:
            result = function(*args, **kwargs)
            text = _call(f"p.{name}", args, kwargs)
            if name in _STEPPING:
                times = self._stepping.pop()[1] if self._stepping and self._stepping[-1][0] == text else 0
                self._stepping.append((text, times + 1))
                return result
            if name == "connect" or name.startswith("create"):
                kind = {"connect": "client", "createMultiBody": "body"}.get(name, "shape")
                self._counts[kind] = self._counts.get(kind, 0) + 1
                variable = kind if kind == "client" else f"{kind}{self._counts[kind]}"
                result, text = _Named(result, variable), f"{variable} = {text}"
            self.calls += [
                f"for _ in range({n}):\n    {each}" if n > 1 else each for each, n in self._stepping
            ]
            self.calls.append(text)
            self._stepping.clear()
            return result

        return call


def _call(name: str, args: Sequence[Any], kwargs: dict[str, Any]) -> str:
    words = [*map(_literal, args), *(f"{key}={_literal(value)}" for key, value in kwargs.items())]
    line = f"{name}({', '.join(words)})"
    return line if len(line) <= 100 else f"{name}(\n    " + ",\n    ".join(words) + ",\n)"


def _literal(value: Any) -> str:
    if isinstance(value, tuple | list):
        return "(" + ", ".join(map(_literal, value)) + ("," if len(value) == 1 else "") + ")"
    if isinstance(value, bool | int | str):
        return repr(value)
    return repr(float(value))


@contextmanager
def _recorded() -> Iterator[list[str]]:
    """Record the calls into pybullet that are made meanwhile; the adapter imports the module where it uses it."""
    import pybullet

    recording = _RecordingModule(pybullet)
    with standing_in("pybullet", recording):
        yield recording.calls


def _setting_up(calls: Sequence[str]) -> Sequence[str]:
    """Give the calls before the run itself, in which gravity may be switched off: up to the last placing of a ball."""
    return calls[: 1 + max(i for i, call in enumerate(calls) if call.startswith("p.resetBaseVelocity"))]


def _pybullet_script(solver: EngineSolver, run: Run, calls: Sequence[str]) -> str:
    return (
        '"""Runs the collision in PyBullet alone and compares with the table: python run.py"""\n\n'
        "import sys\n\nimport pybullet as p\n\n"
        + _facts(solver, run)
        + f"SPEED = {max(abs(run.column.v1), abs(run.column.v2))!r}\n\n"
        + "\n".join(_setting_up(calls))
        + "\n\n"
        + textwrap.dedent("""\
            # From here on as often as the adapter stepped, one step a call.
            p.setPhysicsEngineParameter(fixedTimeStep=STEP, numSubSteps=0)
            balls = [i for i in range(p.getNumBodies()) if p.getDynamicsInfo(i, -1)[0] > 0]
            balls.sort(key=lambda i: p.getBasePositionAndOrientation(i)[0][2])  # B2 below B1
            for i in range(STEPS):
                if i == FLIGHT:
                    p.setGravity(0, 0, 0)
                p.stepSimulation()
            v2, v1 = (p.getBaseVelocity(i)[0][2] for i in balls)
            """)
        + _COMPARE
    )
