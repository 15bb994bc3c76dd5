"""One contact to paste into a scene, and a whole column as files that an engine runs without this package.

What stands beside the numbers of a contact is what an engine must not do to it on its own account (the adapters'
modules say why). No scene is written a second time here. MuJoCo's is read off the batch that the adapter has loaded:
the numbers that stand in it, written into the adapter's own MJCF. PyBullet's is the adapter's own calls, recorded
while it makes them. The runners step as often as the adapter did and compare with what it got.
"""

from __future__ import annotations

import contextlib
import functools
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from typing import Any
from xml.etree import ElementTree

import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined

from impact_xval.compliant_baselines.engines import mujoco_engine
from impact_xval.compliant_baselines.engines.column import Column
from impact_xval.compliant_baselines.engines.engine import EngineSolver
from impact_xval.compliant_baselines.engines.packages import standing_in
from impact_xval.compliant_baselines.engines.recording import Run
from impact_xval.compliant_baselines.mapping import (
    Contact,
    drake_geometries,
    mujoco_contact,
    pybullet_bodies,
)
from impact_xval.compliant_baselines.registry import engine_names, exportable_names
from impact_xval.compliant_baselines.solver import SolverError

#: Engines whose contact parameters are known here, and those whose scenes can be exported.
ENGINES, EXPORTABLE = engine_names(), exportable_names()


@functools.cache
def _environment() -> Environment:
    environment = Environment(
        loader=PackageLoader("impact_xval.compliant_baselines"),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    # 12 digits, and always a float: Drake tells 0 from 0.0.
    environment.filters |= {"repr": repr, "digits": lambda value: repr(float(f"{value:.12g}"))}
    return environment


def paste(engine: str, contact: Contact, step: float) -> tuple[Mapping[str, Any], str]:
    """Give an engine's parameters of a contact and the text to paste.

    The first body carries the contact, the second is rigid and undamped, wherever an engine's parameters belong to
    bodies and not to pairs.

    Parameters
    ----------
    engine : str
        One of `ENGINES`.
    contact : Contact
        What is asked.
    step : float
        Time step in s to write into the text.

    Returns
    -------
    parameters : mapping
        Under the engine's own names, SI units.
    text : str
        Lines of MJCF or of Python.

    Raises
    ------
    SolverError
        If the engine cannot take the numbers.
    ValueError
        If no such engine is known here.
    """
    if engine not in ENGINES:
        raise ValueError(f"engine = {engine!r}; legal: {', '.join(ENGINES)}")
    parameters = _parameters(engine, contact)
    template = _environment().get_template("paste.j2")
    text = template.render(engine=engine, contact=contact, step=step, **parameters)
    if "inf" in text or "nan" in text:
        raise SolverError(engine, "unrepresentable", f"a parameter of {contact} leaves double precision")
    return parameters, text


def _parameters(engine: str, contact: Contact) -> dict[str, Any]:
    if engine == "mujoco":
        pair = mujoco_contact(contact)
        return {
            "solref": list(pair.solref),
            "solimp": list(pair.solimp),
            "condim": 1,
            "integrator": "Euler",
        }
    if engine == "pybullet":
        bodies = pybullet_bodies(contact, contact)[:2]
        each = [{"contactStiffness": body.stiffness, "contactDamping": body.damping} for body in bodies]
    else:
        geometries = drake_geometries(contact, contact)[:2]
        each = [
            {"point_contact_stiffness": geometry.stiffness, "relaxation_time": geometry.relaxation_time}
            for geometry in geometries
        ]
    return dict(zip("ab", each, strict=True))


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
    with _recorded() if solver.name == "pybullet" else contextlib.nullcontext([]) as calls:
        (run,) = solver.run_columns([column], max_steps)
    template = _environment().get_template("run.py.j2")
    script = template.render(engine=solver.name, version=solver.version(), run=run, calls=_setting_up(calls))
    files = {"scene.xml": mjcf(column)} if solver.name == "mujoco" else {}
    return run, files | {"run.py": script}


def mjcf(column: Column) -> str:
    """Write the scene MuJoCo runs for a column, its initial state as the keyframe ``start``."""
    from mujoco.batch import Batch

    batch: Any = Batch(mujoco_engine.scene_model(), 1, 1)
    mujoco_engine.load(batch, [column], 1, False)
    model, root = batch.model, ElementTree.fromstring(mujoco_engine.scene())

    def loaded(field: str, row: int | None = None) -> Any:
        values = batch.expanded(field)[0]
        return values if row is None else values[row]

    def element(path: str) -> ElementTree.Element:
        found = root.find(path)
        assert found is not None, path
        return found

    for name in ("timestep", "tolerance", "gravity"):
        element("option").set(name, _words(loaded(f"opt.{name}")))
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
        for field in ("solref", "solimp"):
            pair.set(field, _words(loaded(f"pair_{field}", model.pair(name).id)))
    start = ElementTree.SubElement(ElementTree.SubElement(root, "keyframe"), "key", name="start")
    start.set("qpos", _words(batch.qpos[0]))
    start.set("qvel", _words(batch.qvel[0]))
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode") + "\n"


def _words(values: Any) -> str:
    return " ".join(repr(float(value)) for value in np.ravel(values))


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
        self._counts: Counter[str] = Counter()
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
                self._counts[kind] += 1
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
    return repr(value if isinstance(value, bool | int | str) else float(value))


@contextlib.contextmanager
def _recorded() -> Iterator[list[str]]:
    """Record the calls into pybullet that are made meanwhile; the adapter imports the module where it uses it."""
    import pybullet

    recording = _RecordingModule(pybullet)
    with standing_in("pybullet", recording):
        yield recording.calls


def _setting_up(calls: Sequence[str]) -> Sequence[str]:
    """Give the calls before the run itself, in which gravity may be switched off: up to the last placing of a ball."""
    placing = [i for i, call in enumerate(calls) if call.startswith("p.resetBaseVelocity")]
    return calls[: 1 + max(placing, default=-1)]
