"""Base class of all engine adapters: it sets up or refuses scenes, runs them, and turns runs into outcomes."""

from __future__ import annotations

import os
import re
import sys
import tempfile
from collections.abc import Callable, Generator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from importlib import import_module
from importlib.metadata import PackageNotFoundError, version
from math import inf
from platform import python_version
from threading import Lock
from types import MappingProxyType, ModuleType
from typing import TYPE_CHECKING

import numpy as np

from impact_xval.compliant_baselines.engines.convergence import Limit, estimate_limit
from impact_xval.compliant_baselines.engines.plane_run import PlaneRun, follow_plane_scene
from impact_xval.compliant_baselines.engines.scanner import MOST_CONTACTS
from impact_xval.compliant_baselines.engines.scene import Scene, World, radius_of, reduced_masses
from impact_xval.compliant_baselines.engines.stepping import Run, follow_scene
from impact_xval.compliant_baselines.marks import DropEnd, marks_of
from impact_xval.compliant_baselines.references import law_at
from impact_xval.compliant_baselines.solver import Settings, Solver, group_by_layout
from impact_xval.model.collision import Collision
from impact_xval.model.graph.collision_outcome import GraphCollisionOutcome
from impact_xval.model.outcome import Outcome

if TYPE_CHECKING:
    from impact_xval.model.graph.collision import GraphCollision

#: Reason why a scene is refused if its parameters are outside the range of double precision.
BEYOND = (
    "periods, penetrations or energies beyond double precision; scale stiffnesses, masses or v0 (Theorem 5)"
)

_importing = Lock()


def import_quietly(module: str) -> ModuleType:
    """Import a module without letting PyBullet print its line "pybullet build time: ..." on the terminal."""
    with _importing:
        if module in sys.modules or module != "pybullet":
            return import_module(module)
        with standard_error_without(b"pybullet build time"):
            return import_module(module)


@contextmanager
def standard_error_without(beginning: bytes) -> Generator[None]:
    """Hold back what is written to standard error, and write it at the end without lines that have this beginning."""
    try:
        terminal = os.dup(2)
    except OSError:  # standard error is closed, so nothing can appear on it
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
    """Return the version of an installed distribution; ``""`` if it is not installed."""
    try:
        return version(distribution)
    except PackageNotFoundError:
        return ""


def _comparable(version: str) -> tuple[int, ...]:
    """Return the parts of a version that are numbers, before any suffix; for example (3, 2, 7) for ``3.2.7.post1``."""
    return tuple(map(int, re.findall(r"\d+", re.split(r"[^\d.]", version)[0])))


class Engine(Solver):
    """Base class of engine adapters: an adapter states which scenes its engine refuses, and sets up the others.

    An outcome has the status `ok`, or one of these:

    * `unavailable`: the engine cannot be imported
    * `unrepresentable`: k_i is 0 or infinite, e_i = 0 would need an infinite damping, or the engine refuses a number
    * `timeout`: the collision is not over after `max_steps` steps; `Run.problem` says how far it came
    * `crashed`: a number is not finite, or the engine has raised an error
    * `unconverged`: the collision is over, but it has gained energy, or its limit dt -> 0 is not known to the tolerance
      asked for. The outcome keeps its velocities and impulses.
    """

    #: Name of the engine as its makers spell it.
    title: str
    #: Name of the Python package that contains the engine.
    distribution: str
    #: Name of the module that is imported to run the engine.
    module: str
    #: Advice on how to install the engine, for users on whose machine the import fails. If it is empty, users are told
    #: to install the extra with the solver's name, up to a colon.
    way_out: str = ""

    #: The oldest version that the adapter can run; empty: any version that can be imported.
    oldest: str = ""

    #: Factor on the engine's regularisation of contacts in a second run, which shows how much the regularisation
    #: changes. None for an engine without regularisation.
    regularisation_probe: float | None = None

    #: Settings that this solver always has, whatever the user sets (`registry`).
    fixed_settings: Mapping[str, object] = MappingProxyType({})

    #: True if the adapter can also set up scenes in a plane, for contact graphs (docs/adding-a-solver.md).
    knows_planes: bool = False

    #: The engine's default step in s. Only engines that run with all their defaults have it.
    shipped_step: float

    #: Function that makes a world from a scene and a radius in m. An adapter sets it, or overrides `world`.
    made: Callable[[Scene, float], World]

    def version(self) -> str:
        """Return the version of the engine's package, or ``""`` if it is not installed."""
        return version_of(self.distribution)

    def unavailable(self) -> str | None:
        """Return None if the engine can run on this machine; else one sentence with the reason and the remedy."""
        way_out = self.way_out or f"run pip install 'impact-xval[{self.name.partition(':')[0]}]'"
        if (installed := self.version()) and _comparable(installed) < _comparable(self.oldest):
            return f"{self.title} {installed} is too old: {self.oldest} or later runs: {way_out}"
        try:
            import_quietly(self.module)
        except Exception as error:  # a broken package can raise any exception
            if isinstance(error, ModuleNotFoundError) and error.name == self.module.partition(".")[0]:
                return f"{self.title} is not installed: {way_out}"
            message = " ".join(str(error).split()) or type(error).__name__
            python = f"Python {python_version()} and NumPy {version_of('numpy')}"
            return f"{self.title} {self.version()} cannot be imported by {python} ({message}): {way_out}"
        return None

    def refusal(self, scene: Scene) -> str | None:
        """Return one sentence that says why the engine cannot take a scene; None if it can."""
        return None

    def radius(self, scene: Scene) -> float:
        """Return the radius in m of the balls of a scene."""
        return radius_of(scene.depth(scene.stiffnesses), scene.axes)

    def world(self, scene: Scene) -> World:
        """Set up a scene in the engine; a world that was set up before can no longer be used."""
        return self.made(scene, self.radius(scene))

    @contextmanager
    def running(self) -> Generator[None]:
        """Prepare the engine while scenes are set up and run, for example by a connection."""
        yield

    def run(self, scenes: Sequence[Scene], max_steps: int, record_path: bool = False) -> list[Run]:
        """Run every scene until its collision is over or `max_steps` steps are taken. Return the runs in order."""
        with self.running():
            return [self.follow(scene, max_steps, record_path) for scene in scenes]

    def follow(self, scene: Scene, max_steps: int, record_path: bool = False) -> Run:
        """Run a scene until its collision is over or `max_steps` steps are taken; call this only inside `running`."""
        return follow_scene(scene, self.world(scene), max_steps, record_path)

    def scene_or_refusal(self, collision: Collision, settings: Settings) -> Scene | str:
        """Return the scene of a collision for this engine; or one sentence that says why the engine refuses it."""
        refusal = self._refusal_of_collision(collision, settings)
        if refusal is not None:
            return refusal
        try:
            return self._accepted(Scene.of(collision, settings))
        except ArithmeticError:
            return BEYOND

    def _accepted(self, scene: Scene) -> Scene | str:
        """Return the scene in the form that this engine runs; or one sentence that says why the engine refuses it."""
        if scene.mapping == "shipped":
            scene = replace(scene, step=self.shipped_step)
        energy = sum(m * v * v for m, v in zip(scene.inertia.tolist(), scene.velocities, strict=True))
        # Later energies are divided by the energy at the start, and radii are computed from the depth of contacts. So
        # neither may be 0 or infinite.
        if not (0 < energy < inf and 0 < scene.step < inf and scene.depth(scene.stiffnesses) > 0):
            return BEYOND
        return self.refusal(scene) or scene

    def _refusal_of_collision(self, collision: Collision, settings: Settings) -> str | None:
        """Return one sentence that says why engines of this kind refuse a collision; None if an engine may take it."""
        c, shipped = collision, settings.mapping == "shipped"
        if settings.scenario == "drop" and not c.falls_on_resting:
            return f"scenario = {settings.scenario!r}: only two balls on a table are dropped; legal: 'impact'"
        if c.exponent != 1:
            return (
                f"exponent = {c.exponent!r}: the contacts of an engine are linear springs and dashpots; legal: 1 "
                "(the references kelvin-voigt, hunt-crossley and bistiffness have others)"
            )
        refusal = self._refusal_of_contacts(c.stiffnesses, c.restitutions, shipped)
        if refusal is None and shipped and settings.scenario == "drop":
            return "scenario = 'drop': an engine as it ships is run without gravity; legal: 'impact'"
        return refusal

    def _refusal_of_contacts(
        self, stiffnesses: Sequence[float], restitutions: Sequence[float], shipped: bool
    ) -> str | None:
        """Return one sentence that says why engines of this kind refuse contacts; None if an engine may take them."""
        if len(stiffnesses) > MOST_CONTACTS:
            return f"{len(stiffnesses)} contacts: engines run up to {MOST_CONTACTS}"
        model = "or the state-transition model, which knows the limit"
        for i, (k, e) in enumerate(zip(stiffnesses, restitutions, strict=True), 1):
            if k in (0, inf):
                return f"k{i} = {k!r} N/m: an engine needs a finite stiffness > 0; take a large or small k2/k1, {model}"
            if e == 0 and self.kind == "compliant" and not shipped:
                reason = "no finite damping makes a dashpot perfectly plastic; take a small positive e"
                return f"e{i} = 0: {reason}, {model}"
        return None

    def plane_scene_or_refusal(self, collision: GraphCollision, settings: Settings) -> Scene | str:
        """Return the scene of a contact graph for this engine; or one sentence that says why the engine refuses it."""
        if not self.knows_planes:
            return f"{self.name} solves balls in a line alone, no contact graphs"
        if settings.scenario == "drop":
            return "scenario = 'drop': contact graphs are run without gravity; legal: 'impact'"
        refusal = self._refusal_of_contacts(
            [contact.stiffness for contact in collision.contacts],
            [contact.restitution for contact in collision.contacts],
            settings.mapping == "shipped",
        )
        if refusal is not None:
            return refusal
        try:
            scene = Scene.of_graph(collision, settings)
            return scene if isinstance(scene, str) else self._accepted(scene)
        except ArithmeticError:
            return BEYOND

    def solve_many(self, collisions: Sequence[Collision], settings: Settings) -> Sequence[Outcome]:
        """Solve every collision, in order; failures are outcomes with a status."""
        settings = replace(settings, **self.fixed_settings)
        missing = self.unavailable()
        if missing is not None:
            return [Outcome.failure(self.name, c, "unavailable", missing) for c in collisions]
        with self.running():
            solved = [self._solve_with_limit(c, settings) for c in collisions]
        outcomes = [outcome for outcome, _ in solved]
        # Marks come from the exact law that was asked for. Under other mappings the contacts may obey another law.
        if settings.mark and settings.mapping == "calibrated" and self.law is not None:
            self._mark(outcomes, [limit for _, limit in solved], collisions, self.law, settings)
        return outcomes

    def solve_graphs(
        self, collisions: Sequence[GraphCollision], settings: Settings
    ) -> Sequence[GraphCollisionOutcome]:
        """Solve contact graphs of balls in a plane; failures are outcomes with a status.

        `velocities` of an outcome are those at the user's step. With `Settings.convergence`, `limit_velocities` are the
        velocities of the limit dt -> 0, and `diagnostics` contain its accuracy, under the same names as for balls in a
        line.
        """
        settings = replace(settings, **self.fixed_settings)
        if (missing := self.unavailable()) is not None:
            return [GraphCollisionOutcome.failure(self.name, c, "unavailable", missing) for c in collisions]
        if not self.knows_planes:
            return super().solve_graphs(collisions, settings)
        with self.running():
            return [self._solve_graph(collision, settings) for collision in collisions]

    def follow_plane(self, scene: Scene, max_steps: int) -> PlaneRun:
        """Run a scene in a plane until its collision is over or `max_steps` steps are taken; only inside `running`."""
        return follow_plane_scene(scene, self.world(scene), max_steps)

    def _solve_graph(self, collision: GraphCollision, settings: Settings) -> GraphCollisionOutcome:
        """Solve one contact graph, and find its limit dt -> 0 if it is asked for."""
        scene = self.plane_scene_or_refusal(collision, settings)
        if isinstance(scene, str):
            return GraphCollisionOutcome.failure(self.name, collision, "unrepresentable", scene)
        run = self.follow_plane(scene, settings.max_steps)
        if not run.over:
            advice = "; a smaller step may help" if run.status == "crashed" else ""
            return GraphCollisionOutcome.failure(self.name, collision, run.status, run.problem() + advice)
        outcome = graph_outcome_of(self.name, run)
        if settings.convergence is None:
            return outcome
        limit, reason = estimate_limit(
            self.follow_plane, self.regularisation_probe, run, settings.convergence, settings.max_steps
        )
        if reason and outcome.status == "ok":
            outcome = replace(outcome, status="unconverged", reason=reason)
        if limit is None:
            return outcome
        return replace(
            outcome,
            limit_velocities=_by_body(limit.velocities, scene.axes),
            diagnostics={**outcome.diagnostics, **limit.quality},
        )

    def _mark(
        self,
        outcomes: list[Outcome],
        limits: Sequence[Limit | None],
        collisions: Sequence[Collision],
        law: str,
        settings: Settings,
    ) -> None:
        """Add marks to the outcomes in the list, by the exact law that the engine was asked for.

        A mark is a sentence that warns of an outcome near a jump of this law. Failures get no marks.
        """
        has_numbers = [i for i, outcome in enumerate(outcomes) if np.isfinite(outcome.velocities).all()]
        g = settings.gravity if settings.scenario == "drop" else 0.0
        solve = law_at(law, max_steps=settings.max_steps)
        for positions, group in group_by_layout([collisions[i] for i in has_numbers]):
            places: list[int] = positions.tolist()
            rows = [has_numbers[place] for place in places]
            gravity = np.full(len(group), g)
            ends = [_end_of(limits[i]) for i in rows] if g else []
            marks = marks_of(solve, law, group, solve(group, gravity), gravity, ends)
            for i, mark in zip(rows, marks.tolist(), strict=True):
                if mark:
                    outcomes[i] = replace(outcomes[i], mark=mark)

    def _solve_with_limit(self, collision: Collision, settings: Settings) -> tuple[Outcome, Limit | None]:
        """Solve one collision, and return its outcome and its limit dt -> 0.

        In place of the limit None is returned if the limit is unknown or was not asked for.
        """
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
            outcome = replace(outcome, diagnostics={**outcome.diagnostics, **limit.diagnostics})
        return outcome, limit


def _end_of(limit: Limit | None) -> DropEnd | None:
    """Return how the drop ended in the run with the shortest time step of a limit; None if there is no limit."""
    return None if limit is None else DropEnd(limit.has_first_flight, limit.b2_settled)


def outcome_of(solver: str, collision: Collision, run: Run, settings: Settings) -> Outcome:
    """Return the outcome of a run.

    `diagnostics` contains `step` (s), `n_steps`, `duration` (s) and `energy_gain` (over the energy before). For a drop
    it also contains `gravity_number`, `first_flight` (s, if there is one) and `rest_speed` (m/s, of a settled B2).
    Impulses are those of the contacts, including the part that carries B2's weight. They agree with the reported
    velocities.
    """
    c = run.scene
    if not run.over:
        advice = "; a smaller step may help" if run.status == "crashed" else ""
        return Outcome.failure(solver, collision, run.status, run.problem() + advice)
    states = run.merged_states(settings.shortest_state)
    names = states.names(c.table and len(c.masses) == 2)
    reason = run.too_much_energy()
    return Outcome(
        solver=solver,
        velocities=run.reported,
        impulses=tuple(run.impulses(run.reported, run.duration).tolist()),
        states=names,
        status="unconverged" if reason else "ok",
        reason=reason,
        n_events=len(names) - 1,
        diagnostics=_diagnostics_of(run),
        path=run.path(states) if run.points is not None else None,
        requested=c.requested,
        effective=run.effective,
    )


def graph_outcome_of(solver: str, run: PlaneRun) -> GraphCollisionOutcome:
    """Return the outcome of a run in a plane.

    `diagnostics` contains `step` (s), `n_steps`, `duration` (s) and `energy_gain` (over the energy before).
    """
    reason = run.too_much_energy()
    return GraphCollisionOutcome(
        solver,
        _by_body(run.reported, run.scene.axes),
        status="unconverged" if reason else "ok",
        reason=reason,
        diagnostics={
            "step": run.scene.step,
            "n_steps": float(run.n_steps),
            "duration": run.duration,
            "energy_gain": run.energy_gain(),
        },
        requested=run.scene.requested,
        effective=run.effective,
    )


def _by_body(coordinates: Sequence[float], axes: int) -> tuple[tuple[float, ...], ...]:
    """Return coordinates as one tuple for each body."""
    return tuple(tuple(coordinates[i : i + axes]) for i in range(0, len(coordinates), axes))


def _diagnostics_of(run: Run) -> dict[str, float]:
    """Return the diagnostics of a run's outcome: further numbers by name.

    If a new diagnostic is in m/s, it must also be listed in `experiments.measures.divergence` (`_VELOCITY`). It is then
    shown as a fraction of abs(v0).
    """
    c = run.scene
    diagnostics = {
        "step": c.step,
        "n_steps": float(run.n_steps),
        "duration": run.duration,
        "energy_gain": run.energy_gain(),
    }
    if c.gravity:
        omega = (c.stiffnesses[0] / reduced_masses(c)[0]) ** 0.5
        diagnostics["gravity_number"] = c.gravity / (c.speed * omega)
    if run.first_flight is not None:
        diagnostics["first_flight"] = run.first_flight.n_steps * c.step
    if run.b2_settled:
        diagnostics["rest_speed"] = float(run.velocities[1])
    return diagnostics
