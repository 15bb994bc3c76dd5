"""``impact-xval doctor``: traps in a MuJoCo scene of the user's, or in those of an experiment."""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from impact_xval.experiments.commands.options import path
from impact_xval.experiments.config.errors import UserError

if TYPE_CHECKING:
    from impact_xval.compliant_baselines.inspect_mujoco import Finding

#: Seconds for a scene to be loaded and examined.
_LONGEST = 40.0


def doctor(
    scene: Annotated[
        Path | None,
        typer.Argument(
            metavar="[SCENE]",
            parser=path("SCENE"),
            help="MJCF file, CONFIG.toml or folder of a run; without it, the built-in experiment.",
        ),
    ] = None,
    json: Annotated[bool, typer.Option("--json", help="Print a JSON list, an object a trap.")] = False,
) -> None:
    """Look for the traps that MuJoCo sets: contact parameters that are replaced, ignored or not what they seem.

    Exit code 1 if there are any.
    """
    from dataclasses import asdict
    from json import dumps

    from impact_xval.experiments.presentation.terminal import make_console, print_line

    if scene is None or scene.suffix == ".toml" or scene.is_dir():
        name, findings = _of_experiment(scene)
    else:
        name, findings = str(scene), _of_file(scene)
    if json:
        print(dumps([asdict(finding) for finding in findings], indent=2))
    else:
        console = make_console()
        for finding in findings:
            print_line(console, str(finding))
        print_line(console, f"{name}: {len(findings) or 'no'} trap{'s' if len(findings) != 1 else ''} found")
    if findings:
        raise typer.Exit(1)


def _of_experiment(what: Path | None) -> tuple[str, list[Finding]]:
    from impact_xval.experiments.config.experiment import load_config, parse_config
    from impact_xval.experiments.sweep.examination import experiment_findings
    from impact_xval.experiments.tables.folder import FINISHED, RunFolder, cells_of_run

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
    findings = experiment_findings(config, cells=cells)
    what_is = "mujoco" if findings is not None else "MuJoCo is not among its solvers, or not installed"
    return f"scenes of {config.name!r} ({what_is})", findings or []


def _of_file(scene: Path) -> list[Finding]:
    from impact_xval.compliant_baselines import get_solver

    if not scene.is_file():
        raise UserError(f"{scene}: no such file; legal: an MJCF or TOML file, or the folder of a run")
    if scene.suffix not in (".xml", ".mjb"):
        raise UserError(f"{scene}: legal: .xml or .mjb (MuJoCo), .toml, or the folder of a run")
    reason = get_solver("mujoco").unavailable()
    if reason is not None:
        raise UserError(f"{scene}: mujoco is unavailable: {reason}")
    return _apart(scene)


def _apart(path: Path) -> list[Finding]:
    """Examine a file in a process of its own: a few bytes can be a scene of any size, and crash its engine."""
    from impact_xval.experiments.sweep.process import FaultError, Worker

    worker = Worker()
    try:
        found = worker.call(_examined, path, timeout=_LONGEST)
    except FaultError as fault:
        raise UserError(
            f"{path}: cannot be examined: {fault.reason}; legal: a scene that is loaded within {_LONGEST:g} s, "
            "by half of the memory of this machine"
        ) from None
    finally:
        worker.close()
    if isinstance(found, str):
        raise UserError(found)
    return found


def _limit_memory() -> None:
    with suppress(ImportError):  # of Unix
        import resource

        most = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") // 2
        resource.setrlimit(resource.RLIMIT_AS, (most, most))


def _examined(_: None, path: Path) -> list[Finding] | str:
    """Return what was found, or why nothing could be."""
    _limit_memory()
    try:
        return _mjcf(path)
    except UserError as error:
        return str(error)
    except Exception as error:  # of an engine that met what it does not expect
        return f"{path}: cannot be examined: {type(error).__name__}: {error}"


def _mjcf(path: Path) -> list[Finding]:
    from importlib import import_module

    from impact_xval.compliant_baselines.inspect_mujoco import inspect_model

    mujoco: Any = import_module("mujoco")
    load = mujoco.MjModel.from_binary_path if path.suffix == ".mjb" else mujoco.MjModel.from_xml_path
    try:
        model = load(str(path))
    except ValueError as error:
        raise UserError(f"{path}: MuJoCo does not compile it: {error}") from None
    return inspect_model(model)
