"""What every engine adapter shares: refusing, setting up, running, and saying what came of it."""

from __future__ import annotations

import os
import re
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from importlib import import_module
from importlib.metadata import PackageNotFoundError, version
from math import inf
from platform import python_version
from threading import Lock
from types import MappingProxyType
from typing import Any

import numpy as np

from impact_xval.compliant_baselines.engines.convergence import Limit, estimate_limit
from impact_xval.compliant_baselines.engines.scene import Scene, World, radius_of, reduced_masses
from impact_xval.compliant_baselines.engines.stepping import Run, follow
from impact_xval.compliant_baselines.marks import marks_of
from impact_xval.compliant_baselines.references import law_at
from impact_xval.compliant_baselines.solver import Settings, Solver, by_kind
from impact_xval.model.chain.rest import REST, STUCK
from impact_xval.model.collision import Collision, Collisions, Outcome

#: Most contacts of a scene: the states of a run are sets of them, kept as bits.
MOST_CONTACTS = 60

#: Why an engine cannot take what double precision has no numbers for.
BEYOND = (
    "periods, penetrations or energies beyond double precision; scale stiffnesses, masses or v0 (Theorem 5)"
)

_importing = Lock()


def import_quietly(module: str) -> Any:
    """Import a module, without the line "pybullet build time: ..." of PyBullet's C code at the first import."""
    with _importing:
        if module in sys.modules or module != "pybullet":
            return import_module(module)
        with standard_error_without(b"pybullet build time"):
            return import_module(module)


@contextmanager
def standard_error_without(beginning: bytes) -> Iterator[None]:
    """Hold back what is written to the descriptor of standard error; write it afterwards, but for some lines."""
    try:
        terminal = os.dup(2)
    except OSError:  # closed: there is nothing to keep clean
        yield
        return
    with tempfile.TemporaryFile() as held:
        os.dup2(held.fileno(), 2)
        try:
            yield
        finally:
            os.dup2(terminal, 2)
            os.close(terminal)
            held.seek(0)
            os.write(2, b"".join(line for line in held if not line.startswith(beginning)))


def version_of(distribution: str) -> str:
    """Version of an installed package, by the name it is distributed under; ``""`` if it is not installed."""
    try:
        return version(distribution)
    except PackageNotFoundError:
        return ""


def _numbers_of(version: str) -> tuple[int, ...]:
    """Numbers of a version before any suffix, to be compared: (3, 2, 7) of ``3.2.7.post1``."""
    return tuple(map(int, re.findall(r"\d+", re.split(r"[^\d.]", version)[0])))


class Engine(Solver):
    """An engine behind the contract: an adapter says what it refuses and how to set a scene up.

    Statuses beside `ok`: `unavailable` (the engine cannot be imported), `unrepresentable` (k_i = 0 or infinite, e_i = 0
    of dashpots, or what the engine itself cannot take), `timeout` (not over after `max_steps`), `crashed` (numbers that
    are not finite, or the engine's own complaint), `unconverged` (over, but with more energy than it began with, or
    with a limit dt -> 0 that is not known to the tolerance asked for: the outcome keeps its numbers).
    """

    #: The engine as its makers spell it, the name of its package as distributed, the module that is imported, and what
    #: to run where that fails; empty: to install the extra of its name.
    title: str
    distribution: str
    module: str
    way_out: str = ""

    #: The oldest version that the adapter can run; empty: any that can be imported.
    oldest: str = ""

    #: How many times as much regularisation of contacts shows what that of the engine does; None: it has none.
    regularisation_probe: float | None = None

    #: Settings that are this solver's own, whatever is asked for (`registry`), and the step in s as the engine ships.
    as_set: Mapping[str, Any] = MappingProxyType({})
    shipped_step: float

    #: What it makes of a scene and a radius, unless `world` says more.
    made: Callable[[Scene, float], World]

    def version(self) -> str:
        """Version of the engine's package, or ``""`` if it is not installed."""
        return version_of(self.distribution)

    def unavailable(self) -> str | None:
        """Why the engine cannot run here and the way out; None if it can."""
        way_out = self.way_out or f"run pip install 'impact-xval[{self.name}]'"
        if (installed := self.version()) and _numbers_of(installed) < _numbers_of(self.oldest):
            return f"{self.title} {installed} is too old: {self.oldest} or later runs: {way_out}"
        try:
            import_quietly(self.module)
        except Exception as error:  # of a package that is there but broken, any
            if isinstance(error, ModuleNotFoundError) and error.name == self.module.partition(".")[0]:
                return f"{self.title} is not installed: {way_out}"
            said = " ".join(str(error).split()) or type(error).__name__
            here = f"Python {python_version()} and NumPy {version_of('numpy')}"
            return f"{self.title} {self.version()} cannot be imported by {here} ({said}): {way_out}"
        return None

    def refusal(self, scene: Scene) -> str | None:
        """Why this engine cannot take a scene, in one sentence; None if it can."""
        return None

    def radius(self, scene: Scene) -> float:
        """Radius in m of the balls that it makes of a scene."""
        return radius_of(scene.depth(scene.stiffnesses))

    def world(self, scene: Scene) -> World:
        """Set a scene up; the world before it is done with."""
        return self.made(scene, self.radius(scene))

    @contextmanager
    def running(self) -> Iterator[None]:
        """Hold what is needed while scenes are set up and run: a connection, silence."""
        yield

    def run(self, scenes: Sequence[Scene], max_steps: int, record_path: bool = False) -> list[Run]:
        """Run every scene until its collision is over or `max_steps` steps are taken; in order."""
        with self.running():
            return [self.follow(scene, max_steps, record_path) for scene in scenes]

    def follow(self, scene: Scene, max_steps: int, record_path: bool = False) -> Run:
        """Run a scene while `running`."""
        return follow(scene, self.world(scene), max_steps, record_path)

    def scene_or_refusal(self, collision: Collision, settings: Settings) -> Scene | str:
        """Set a collision up as a scene that this engine takes, or say in one sentence why it takes none."""
        c, shipped = collision, settings.mapping == "shipped"
        if settings.scenario == "drop" and not c.falls_on_resting:
            return f"scenario = {settings.scenario!r}: only two balls on a table are dropped; legal: 'impact'"
        if c.exponent != 1:
            return (
                f"exponent = {c.exponent!r}: the contacts of an engine are linear springs and dashpots; legal: 1 "
                "(the references kelvin-voigt, hunt-crossley and bistiffness have others)"
            )
        if len(c.stiffnesses) > MOST_CONTACTS:
            return f"{len(c.stiffnesses)} contacts: engines run up to {MOST_CONTACTS}"
        limit = "or the state-transition model, which knows the limit"
        for i, (k, e) in enumerate(zip(c.stiffnesses, c.restitutions, strict=True), 1):
            if k in (0, inf):
                return f"k{i} = {k!r} N/m: an engine needs a finite stiffness > 0; take a large or small k2/k1, {limit}"
            if e == 0 and self.kind == "compliant" and not shipped:
                why = "no finite damping makes a dashpot perfectly plastic; take a small positive e"
                return f"e{i} = 0: {why}, {limit}"
        if shipped and settings.scenario == "drop":
            return "scenario = 'drop': an engine as it ships is run without gravity; legal: 'impact'"
        try:
            scene = Scene.of(c, settings)
            if shipped:
                scene = replace(scene, step=self.shipped_step)
            energy = sum(m * v * v for m, v in zip(scene.masses, scene.velocities, strict=True))
            # Energies are told over that at the start, and radii follow from how deep contacts go.
            if not (0 < energy < inf and 0 < scene.step < inf and scene.depth(scene.stiffnesses) > 0):
                return BEYOND
            return self.refusal(scene) or scene
        except ArithmeticError:
            return BEYOND

    def solve_many(self, collisions: Sequence[Collision], settings: Settings) -> Sequence[Outcome]:
        """Answer every collision, in order; failures are outcomes with a status."""
        settings = replace(settings, **self.as_set)
        missing = self.unavailable()
        if missing is not None:
            return [Outcome.failure(self.name, each, "unavailable", missing) for each in collisions]
        with self.running():
            found = [self._solved(each, settings) for each in collisions]
        law, outcomes = self.law, [outcome for outcome, _ in found]
        if not settings.mark or settings.mapping != "calibrated" or law is None:
            return outcomes  # whose contacts may not be those of the law
        # Marked by the exact law that the engine was asked for; what has no numbers stays as it is.
        there = [i for i, outcome in enumerate(outcomes) if np.isfinite(outcome.velocities).all()]
        limits = [found[i][1] for i in there]
        g = settings.gravity if settings.scenario == "drop" else 0.0
        ends = {n: (limit.flight, limit.rest) for n, limit in enumerate(limits) if g and limit is not None}
        solve = law_at(law, max_steps=settings.max_steps)

        def why(some: Collisions) -> list[str]:
            gravity = np.full(len(some), g)
            return marks_of(solve, law, some, solve(some, gravity), gravity, ends).tolist()

        for i, mark in zip(there, by_kind([collisions[i] for i in there], why), strict=True):
            outcomes[i] = replace(outcomes[i], marked=mark) if mark else outcomes[i]
        return outcomes

    def _solved(self, collision: Collision, settings: Settings) -> tuple[Outcome, Limit | None]:
        """Answer a collision, with its limit dt -> 0 if that is asked for and known."""
        scene = self.scene_or_refusal(collision, settings)
        if isinstance(scene, str):
            return Outcome.failure(self.name, collision, "unrepresentable", scene), None
        run = self.follow(scene, settings.max_steps, settings.record_path)
        outcome = outcome_of(self.name, collision, run, settings)
        if settings.convergence is None or not run.over:
            return outcome, None
        limit, reason = estimate_limit(
            self.follow, self.regularisation_probe, run, settings.convergence, settings.max_steps
        )
        if reason and outcome.status == "ok":
            outcome = replace(outcome, status="unconverged", reason=reason)
        if limit is not None:
            outcome = replace(outcome, diagnostics={**outcome.diagnostics, **limit.stated})
        return outcome, limit


def outcome_of(solver: str, collision: Collision, run: Run, settings: Settings) -> Outcome:
    """Turn a finished run into an outcome.

    `diagnostics` holds `step` (s), `n_steps`, `duration` (s), `energy_gain` (over the energy before), and of a drop
    `gravity_number`, `first_flight` (s, if there is one) and `rest_speed` (m/s, of a B2 that is reported at rest).
    Impulses are those of the contacts, support of B2's weight included, and go with the velocities reported.
    """
    c = run.scene
    if not run.over:
        advice = "; a smaller step may help" if run.status == "crashed" else ""
        return Outcome.failure(solver, collision, run.status, run.problem() + advice)
    states = run.states(settings.shortest_state)
    names = states.names(c.table and len(c.masses) == 2)
    diagnostics = {
        "step": c.step,
        "n_steps": float(run.n_steps),
        "duration": run.duration,
        "energy_gain": run.energy_gain(),
    }
    if c.gravity:
        omega = (c.stiffnesses[0] / reduced_masses(c)[0]) ** 0.5
        diagnostics["gravity_number"] = c.gravity / (c.speed * omega)
    if run.fall is not None:
        diagnostics["first_flight"] = run.fall[0] * c.step
    if run.end in (REST, STUCK):
        diagnostics["rest_speed"] = float(run.velocities[1])
    reason = run.too_much_energy()
    return Outcome(
        solver=solver,
        velocities=run.reported,
        impulses=tuple(run.impulses(run.reported, run.duration).tolist()),
        states=names,
        status="unconverged" if reason else "ok",
        reason=reason,
        n_events=len(names) - 1,
        diagnostics=diagnostics,
        path=run.path(states) if run.points is not None else None,
        requested=c.requested,
        effective=run.effective,
    )
