"""``impact-xval doctor``: contacts and traps of a scene of the user's, or traps in those of an experiment."""

from __future__ import annotations

import math
import os
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import typer

from impact_xval.experiments.commands.options import number, path
from impact_xval.experiments.config.errors import UserError

if TYPE_CHECKING:
    from impact_xval.compliant_baselines.diagnosis.bouncing import Inspected, Meeting
    from impact_xval.compliant_baselines.diagnosis.diagnosis import Finding
    from impact_xval.experiments.sweep.sandbox import Sandbox

#: Seconds for a scene to be loaded and examined, and again for its contacts to be measured.
_LONGEST = 40.0

#: Kinds of contacts that are measured, at most.
_MOST_KINDS = 20


class _Examined(NamedTuple):
    """What a file is: its engine, its traps, contacts to measure, and how many kinds of them are left out."""

    engine: str
    findings: list[Finding]
    meetings: list[Meeting]
    left_out: int


def doctor(
    scene: Annotated[
        Path | None,
        typer.Argument(
            metavar="[SCENE]",
            parser=path("SCENE"),
            help="MJCF file, PyBullet script (run up to its first step: it asks first), URDF, CONFIG.toml or folder of "
            "a run; without it, the built-in experiment.",
        ),
    ] = None,
    speed: Annotated[
        str | None,
        typer.Option(metavar="M/S", help="At which bodies of a scene meet; by default 1."),
    ] = None,
    yes: Annotated[bool, typer.Option("--yes", help="Run a script without asking.")] = False,
    json: Annotated[
        bool, typer.Option("--json", help="Print a JSON object: contacts in pairs, traps in traps.")
    ] = False,
) -> None:
    """Measure the contacts of a scene, and look for traps: contact parameters that do not do what they seem to.

    Every two bodies that can touch are driven against each other in the engine, at the step of the scene: stiffness,
    damping, restitution, duration, steps in a contact. A PyBullet script is run, as python runs it, up to its first
    step: only name scripts that you would run. Exit code 1 if there are traps, or a contact that fails in its engine.
    """
    from dataclasses import asdict
    from json import dumps

    from impact_xval.experiments.presentation.terminal import make_console, print_line

    meet = 1.0 if speed is None else number("--speed", speed)
    if not 0 < meet < math.inf:
        raise UserError(f"--speed = {speed!r:.60}; legal: a finite number > 0 (m/s)")
    pairs: list[Inspected] = []
    examined = None
    if scene is None or scene.suffix == ".toml" or scene.is_dir():
        if speed is not None:
            raise UserError(
                f"--speed = {speed!r:.60}: contacts of an experiment are not measured; legal: with an MJCF, URDF or "
                "Python file"
            )
        name, findings = _of_experiment(scene)
    else:
        examined, pairs = _of_file(scene, meet, yes)
        name, findings = str(scene), examined.findings
    failed = sum(pair.status not in ("ok", "unrepresentable") for pair in pairs)
    if json:
        traps, left = [asdict(finding) for finding in findings], examined.left_out if examined else 0
        found = {"pairs": [_object(pair) for pair in pairs], "pairs_left_out": left, "traps": traps}
        print(dumps(found, indent=2, allow_nan=False))
    else:
        if examined:
            _show(examined, pairs, meet)
        console = make_console()
        for finding in findings:
            print_line(console, str(finding))
        traps = f"{len(findings) or 'no'} trap{'s' if len(findings) != 1 else ''} found"
        print_line(
            console, f"{name}: {traps}" + (f"; not measured: {failed} of {len(pairs)}" if failed else "")
        )
    if findings or failed:
        raise typer.Exit(1)


def _object(pair: Inspected) -> dict[str, Any]:
    from dataclasses import asdict

    # JSON knows no infinity.
    return asdict(pair) | {"masses": ["inf" if math.isinf(mass) else mass for mass in pair.masses]}


def _show(examined: _Examined, pairs: list[Inspected], speed: float) -> None:
    """Print the table of contacts, and what to know of them."""
    from impact_xval.compliant_baselines import get_solver
    from impact_xval.experiments.presentation.pages import render
    from impact_xval.experiments.presentation.terminal import make_console, show

    remarks: dict[str, list[str]] = {}
    for pair in pairs:
        for remark in (*pair.remarks, *([f"{pair.status}: {pair.reason}"] if pair.reason else [])):
            remarks.setdefault(remark, []).append(pair.where)
    page = render(
        "doctor.md.j2",
        engine=examined.engine,
        version=get_solver(examined.engine).version(),
        pairs=pairs,
        speed=speed,
        remarks=remarks,
        left_out=examined.left_out,
    )
    show(make_console(), page)


def _of_experiment(what: Path | None) -> tuple[str, list[Finding]]:
    from impact_xval.experiments.config.configuration import load_config, parse_config
    from impact_xval.experiments.sweep.designs import cells_of_run
    from impact_xval.experiments.sweep.examination import experiment_findings
    from impact_xval.experiments.tables.store import FINISHED, RunFolder

    cells = None
    if what is None:
        config = parse_config({})
    elif what.is_dir():
        folder = RunFolder(what)
        config = folder.config()
        if folder.manifest()["state"] in FINISHED and config.column is None:
            cells = cells_of_run(folder, config)
    else:
        config = load_config(what)
    examined, findings = experiment_findings(config, cells=cells)
    return f"scenes of {config.name!r} ({', '.join(examined) or 'no engine is installed'})", findings


def _of_file(scene: Path, speed: float, yes: bool) -> tuple[_Examined, list[Inspected]]:
    from impact_xval.compliant_baselines import get_solver
    from impact_xval.experiments.presentation.terminal import at_work
    from impact_xval.experiments.sweep.sandbox import Sandbox

    if not scene.is_file():
        raise UserError(
            f"{scene}: no such file; legal: an MJCF, URDF, TOML or Python file, or the folder of a run"
        )
    kinds = {
        ".xml": ("mujoco", _mjcf),
        ".mjb": ("mujoco", _mjcf),
        ".urdf": ("pybullet", _urdf),
        ".py": ("pybullet", _script),
    }
    if scene.suffix not in kinds:
        raise UserError(
            f"{scene}: legal: .xml or .mjb (MuJoCo), .py or .urdf (PyBullet), .toml, or the folder of a run"
        )
    engine, examine = kinds[scene.suffix]
    reason = get_solver(engine).unavailable()
    if reason is not None:
        raise UserError(f"{scene}: {engine} is unavailable: {reason}")
    if examine is _script and not yes:
        _ask(scene)
    sandbox = Sandbox(None, _limit_memory)
    try:
        examined = _apart(sandbox, examine, scene)
        with at_work("measuring contacts"):
            return _measured(sandbox, examined, speed)
    finally:
        sandbox.close()


def _ask(scene: Path) -> None:
    """Ask whether a script may be run.

    Raises
    ------
    UserError
        If it may not, or there is nobody to ask.
    """
    if not sys.stdin.isatty():
        raise UserError(
            f"{scene}: examining a script runs it up to its first step; legal without a terminal: --yes"
        )
    if not typer.confirm(f"run {scene} up to its first step?", err=True):
        raise UserError(f"{scene}: not run, so not examined")


def _apart(sandbox: Sandbox, examine: Callable[[Path], _Examined], path: Path) -> _Examined:
    """Examine a file in a process of its own: a few bytes can be a scene of any size, and crash its engine."""
    from impact_xval.experiments.sweep.sandbox import FaultError

    try:
        found = sandbox.call(_tried, examine, path, timeout=_LONGEST)
    except FaultError as fault:
        raise UserError(
            f"{path}: cannot be examined: {fault.reason}; legal: a scene that is loaded within {_LONGEST:g} s, "
            "by half of the memory of this machine"
        ) from None
    if isinstance(found, str):
        raise UserError(found)
    return found


def _limit_memory(_: None) -> None:
    with suppress(ImportError):  # of Unix
        import resource

        most = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") // 2
        resource.setrlimit(resource.RLIMIT_AS, (most, most))


def _tried(_: None, examine: Callable[[Path], _Examined], path: Path) -> _Examined | str:
    """Return what was found, or why nothing could be."""
    try:
        return examine(path)
    except UserError as error:
        return str(error)
    except Exception as error:  # of an engine that met what it does not expect
        return f"{path}: cannot be examined: {type(error).__name__}: {error}"


def _measured(sandbox: Sandbox, examined: _Examined, speed: float) -> tuple[_Examined, list[Inspected]]:
    """Measure contacts in the sandbox, one after the other, as far as the time goes."""
    from impact_xval.compliant_baselines.diagnosis.bouncing import lost
    from impact_xval.experiments.sweep.sandbox import FaultError

    pairs: list[Inspected] = []
    end = time.monotonic() + _LONGEST
    for meeting in examined.meetings:
        left = end - time.monotonic()
        if left <= 0:
            break
        try:
            pairs.append(sandbox.call(_inspected, meeting, speed, timeout=left))
        except FaultError as fault:
            pairs.append(lost(meeting, speed, fault.status, fault.reason))
    missed = len(examined.meetings) - len(pairs)
    return examined._replace(left_out=examined.left_out + missed), pairs


def _inspected(_: None, meeting: Meeting, speed: float) -> Inspected:
    from impact_xval.compliant_baselines.diagnosis.bouncing import inspect

    return inspect(meeting, speed)


def _examined(engine: str, findings: list[Finding], meetings: Iterable[Meeting]) -> _Examined:
    from impact_xval.compliant_baselines.diagnosis.bouncing import kinds

    found = kinds(meetings)
    return _Examined(engine, findings, found[:_MOST_KINDS], max(0, len(found) - _MOST_KINDS))


def _mjcf(path: Path) -> _Examined:
    from importlib import import_module

    from impact_xval.compliant_baselines.diagnosis.diagnose_mujoco import diagnose_mujoco
    from impact_xval.compliant_baselines.diagnosis.inspect_mujoco import mujoco_meetings
    from impact_xval.compliant_baselines.practical.practice import silent

    mujoco: Any = import_module("mujoco")
    load = mujoco.MjModel.from_binary_path if path.suffix == ".mjb" else mujoco.MjModel.from_xml_path
    try:
        with silent():
            model = load(str(path))
    except ValueError as error:
        raise UserError(f"{path}: MuJoCo does not compile it: {error}") from None
    if not 0 < model.opt.timestep < math.inf:
        raise UserError(f"{path}: timestep = {model.opt.timestep:g}; legal: a finite number > 0 (s)")
    return _examined("mujoco", diagnose_mujoco(model), mujoco_meetings(model))


def _client(client: int, engine_parameters: dict[str, Any], dynamics: Any) -> _Examined:
    from impact_xval.compliant_baselines.diagnosis.diagnose_pybullet import diagnose_pybullet
    from impact_xval.compliant_baselines.diagnosis.inspect_pybullet import pybullet_meetings

    seen = client, engine_parameters, dynamics
    return _examined("pybullet", diagnose_pybullet(*seen), pybullet_meetings(*seen))


def _urdf(path: Path) -> _Examined:
    """Examine a URDF file over a plane of which nothing is set, as `loadURDF` and its examples have it."""
    from impact_xval.compliant_baselines.engines.packages import import_pybullet

    p = import_pybullet()
    client = p.connect(p.DIRECT)
    try:
        plane = p.createCollisionShape(p.GEOM_PLANE, physicsClientId=client)
        p.createMultiBody(0, plane, physicsClientId=client)
        try:
            p.loadURDF(str(path), physicsClientId=client)
        except p.error as error:
            raise UserError(f"{path}: PyBullet does not load it: {error}") from None
        return _client(client, {}, None)
    finally:
        p.disconnect(client)


def _script(path: Path) -> _Examined:
    import runpy

    from impact_xval.compliant_baselines.diagnosis.diagnose_pybullet import at_first_step

    def run() -> None:
        with _as_main(path):
            runpy.run_path(str(path), run_name="__main__")

    try:
        examined = at_first_step(run, _client)
    except SystemExit as error:
        raise UserError(f"{path}: it ended with {error} before its first step") from None
    except Exception as error:
        raise UserError(f"{path}: before its first step it raised {type(error).__name__}: {error}") from None
    if examined is None:
        raise UserError(f"{path}: it ended without a stepSimulation(); nothing to examine")
    return examined


@contextmanager
def _as_main(path: Path) -> Iterator[None]:
    """Let a script see its own arguments and find its neighbours, as ``python path`` does."""
    arguments, paths = sys.argv, sys.path
    sys.argv, sys.path = [str(path)], [str(path.resolve().parent), *sys.path]
    try:
        yield
    finally:
        sys.argv, sys.path = arguments, paths
