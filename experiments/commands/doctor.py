"""What ``impact-xval doctor`` does: traps in a scene of the user's, or in those of an experiment."""

from __future__ import annotations

import json
import runpy
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from typing import Any

import typer

from impact_xval.compliant_baselines import get_solver
from impact_xval.compliant_baselines.diagnosis.diagnosis import Finding
from impact_xval.experiments.config.configuration import load_config, parse_config
from impact_xval.experiments.config.errors import UserError
from impact_xval.experiments.presentation.terminal import make_console, print_line
from impact_xval.experiments.sweep.designs import cells_of_run
from impact_xval.experiments.sweep.examination import experiment_findings
from impact_xval.experiments.tables.store import RunFolder


def doctor(what: Path | None, *, as_json: bool) -> None:
    """Examine a scene or an experiment and print what was found.

    Parameters
    ----------
    what : Path, optional
        MJCF file, PyBullet script, URDF file, configuration or folder of a run; the built-in experiment if there is
        none.
    as_json : bool
        Whether to print a JSON list.

    Raises
    ------
    UserError
        If it cannot be read, or its engine is missing.
    typer.Exit
        With code 1, if anything was found.
    """
    name, findings = _examine(what)
    if as_json:
        rows = [{"trap": f.trap, "where": f.where, "says": f.says} for f in findings]
        print(json.dumps(rows, indent=2))
    else:
        console = make_console()
        for finding in findings:
            print_line(console, str(finding))
        print_line(console, f"{name}: {len(findings) or 'no'} trap{'s' if len(findings) != 1 else ''} found")
    if findings:
        raise typer.Exit(1)


def _examine(what: Path | None) -> tuple[str, list[Finding]]:
    if what is None or what.suffix == ".toml" or what.is_dir():
        cells = None
        if what is None:
            config = parse_config({})
        elif what.is_dir():
            folder = RunFolder(what)
            config = folder.config()
            if folder.manifest().get("state") == "complete":
                cells = cells_of_run(folder, config)
        else:
            config = load_config(what)
        examined, findings = experiment_findings(config, cells=cells)
        return f"scenes of {config.name!r} ({', '.join(examined) or 'no engine is installed'})", findings
    if not what.is_file():
        raise UserError(
            f"{what}: no such file; legal: an MJCF, URDF, TOML or Python file, or the folder of a run"
        )
    kinds = {".xml": _mjcf, ".mjb": _mjcf, ".urdf": _urdf, ".py": _script}
    if what.suffix not in kinds:
        raise UserError(
            f"{what}: legal: .xml or .mjb (MuJoCo), .py or .urdf (PyBullet), .toml, or the folder of a run"
        )
    engine = "mujoco" if what.suffix in (".xml", ".mjb") else "pybullet"
    reason = get_solver(engine).unavailable()
    if reason is not None:
        raise UserError(f"{what}: {engine} is unavailable: {reason}")
    return str(what), kinds[what.suffix](what)


def _mjcf(path: Path) -> list[Finding]:
    from impact_xval.compliant_baselines.diagnosis.diagnose_mujoco import diagnose_mujoco

    mujoco: Any = import_module("mujoco")
    load = mujoco.MjModel.from_binary_path if path.suffix == ".mjb" else mujoco.MjModel.from_xml_path
    try:
        model = load(str(path))
    except ValueError as error:
        raise UserError(f"{path}: MuJoCo does not compile it: {error}") from None
    return diagnose_mujoco(model)


def _urdf(path: Path) -> list[Finding]:
    """Examine a URDF file over a plane of which nothing is set, as `loadURDF` and its examples have it."""
    import pybullet as p

    from impact_xval.compliant_baselines.diagnosis.diagnose_pybullet import diagnose_pybullet

    client = p.connect(p.DIRECT)
    try:
        plane = p.createCollisionShape(p.GEOM_PLANE, physicsClientId=client)
        p.createMultiBody(0, plane, physicsClientId=client)
        try:
            p.loadURDF(str(path), physicsClientId=client)
        except p.error as error:
            raise UserError(f"{path}: PyBullet does not load it: {error}") from None
        return diagnose_pybullet(client, {})
    finally:
        p.disconnect(client)


def _script(path: Path) -> list[Finding]:
    from impact_xval.compliant_baselines.diagnosis.diagnose_pybullet import diagnose_at_first_step

    def run() -> None:
        with _as_main(path):
            runpy.run_path(str(path), run_name="__main__")

    try:
        findings = diagnose_at_first_step(run)
    except SystemExit as error:
        raise UserError(f"{path}: it ended with {error} before its first step") from None
    except Exception as error:
        raise UserError(f"{path}: before its first step it raised {type(error).__name__}: {error}") from None
    if findings is None:
        raise UserError(f"{path}: it ended without a stepSimulation(); nothing to examine")
    return findings


@contextmanager
def _as_main(path: Path) -> Iterator[None]:
    """Let a script see its own arguments and find its neighbours, as ``python path`` does."""
    arguments, paths = sys.argv, sys.path
    sys.argv, sys.path = [str(path)], [str(path.resolve().parent), *sys.path]
    try:
        yield
    finally:
        sys.argv, sys.path = arguments, paths
