"""Newton (Warp) on a processor: springs with dashpots in compression, or position-based with restitution.

* SemiImplicit and Featherstone have one contact force, F = ke delta + kd max(0, delta') while bodies overlap, ke and kd
  the means of those of the two shapes (kernels_contact.py). That is the reference ``compression-dashpot``. Friction
  is 0, and so is `kf`.
* XPBD projects positions and then adds restitution, the mean of those of the two shapes, `enable_restitution` being off
  as it is shipped. What is below twice what gravity adds in a step does not bounce; here there is none.

Everything is single precision. Kernels are compiled when they are first needed, half a minute of them, and kept on
disk. Steps are those of the examples: 1 ms for forces (example_basic_pendulum.py: 100 frames a second of 10 steps),
2 ms for XPBD (example_basic_shapes.py: of 5).
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib import import_module
from typing import Any, NamedTuple

from impact_xval.compliant_baselines.contact.restitution_laws import compression_damping_ratio
from impact_xval.compliant_baselines.practical.mixing import means
from impact_xval.compliant_baselines.practical.practice import (
    RADIUS,
    Arrangement,
    Practice,
    reduced_masses,
    without_spring,
)
from impact_xval.model.columns.column import Column


class Surface(NamedTuple):
    """What a shape is given: stiffness in N/m, damping in N s/m, restitution."""

    ke: float = 0.0
    kd: float = 0.0
    restitution: float = 0.0


class _Newton(Practice):
    engine = "Newton/Warp"
    distribution = "newton"
    module = "newton"
    way_out = "run pip install 'impact-xval[newton]'"
    precision = "float32"

    def load(self) -> object:
        """Import it."""
        return import_module("newton.solvers")

    @abstractmethod
    def surfaces(self, column: Column) -> list[Surface] | None:
        """Give each body its surface, the table last; None if none do what is asked."""

    @abstractmethod
    def solver(self, model: Any) -> Any:
        """Make the engine's solver."""

    def refuses(self, column: Column) -> str | None:
        """Refuse what no means of two bodies are."""
        if self.surfaces(column) is not None:
            return None
        names = [{"restitution": "restitutions", "stiffness": "stiffnesses"}[name] for name in self.takes]
        said = " and ".join(f"{name} = {getattr(column, name)!r}" for name in names)
        return f"{said}: Newton averages what two shapes have; legal: values that are such means, as equal ones are"

    @contextmanager
    def world(self, column: Column, arrangement: Arrangement) -> Iterator[_World]:
        """Make the column."""
        yield _World(self, column, arrangement)


class _Springs(_Newton):
    takes = ("restitution", "stiffness")
    law = "compression-dashpot"
    default_step = 1e-3

    def refuses(self, column: Column) -> str | None:
        """Refuse what is perfectly plastic too."""
        return without_spring(column) or super().refuses(column)

    def surfaces(self, column: Column) -> list[Surface] | None:
        """Stiffness and damping."""
        contacts = zip(column.stiffnesses, column.restitutions, reduced_masses(column), strict=True)
        dampings = [2 * compression_damping_ratio(e) * (k * m) ** 0.5 for k, e, m in contacts]
        ke, kd = means(column.stiffnesses), means(dampings)
        if ke is None or kd is None:
            return None
        return [Surface(*pair) for pair in zip(ke, kd, strict=True)]


class NewtonSemiImplicit(_Springs):
    """Newton's SemiImplicit."""

    name = "newton-semi-implicit"
    settings = "ke and kd of the contact asked for; they are averaged; the dashpot acts in compression"

    def solver(self, model: Any) -> Any:
        """Make it."""
        return import_module("newton.solvers").SolverSemiImplicit(model)


class NewtonFeatherstone(_Springs):
    """Newton's Featherstone."""

    name = "newton-featherstone"
    settings = NewtonSemiImplicit.settings

    def solver(self, model: Any) -> Any:
        """Make it."""
        return import_module("newton.solvers").SolverFeatherstone(model)


class NewtonXpbd(_Newton):
    """Newton's XPBD, with restitution."""

    name = "newton-xpbd"
    settings = "enable_restitution, else as shipped; restitutions are averaged"
    default_step = 2e-3

    def surfaces(self, column: Column) -> list[Surface] | None:
        """Restitution."""
        found = means(column.restitutions, 1.0)
        return None if found is None else [Surface(restitution=e) for e in found]

    def solver(self, model: Any) -> Any:
        """Make it."""
        return import_module("newton.solvers").SolverXPBD(model, enable_restitution=True)


class _World:
    def __init__(self, practice: _Newton, column: Column, arrangement: Arrangement) -> None:
        warp: Any = import_module("warp")
        newton: Any = import_module("newton")
        warp.config.quiet = True
        self._step = arrangement.step
        heights, bodies = arrangement.heights(column), {}
        with warp.ScopedDevice("cpu"):
            builder = newton.ModelBuilder(gravity=(0.0, 0.0, 0.0))
            for i in arrangement.order(column):
                surface = (practice.surfaces(column) or [])[i]
                config = newton.ModelBuilder.ShapeConfig(
                    density=0.0, mu=0.0, kf=0.0, mu_torsional=0.0, mu_rolling=0.0, **surface._asdict()
                )
                if i == len(column.masses):
                    builder.add_ground_plane(height=arrangement.floor(), cfg=config)
                    continue
                inertia = 0.4 * column.masses[i] * RADIUS**2
                bodies[i] = builder.add_body(
                    xform=warp.transform((0.0, 0.0, heights[i]), warp.quat_identity()),
                    mass=column.masses[i],
                    inertia=warp.mat33(inertia, 0.0, 0.0, 0.0, inertia, 0.0, 0.0, 0.0, inertia),
                )
                builder.add_shape_sphere(bodies[i], radius=RADIUS, cfg=config)
                # Of a free joint: linear velocity first. Featherstone reads joints, the others bodies.
                first = builder.joint_qd_start[bodies[i]]
                builder.joint_qd[first + 2] = column.velocities[i]
                builder.body_qd[bodies[i]] = (0.0, 0.0, column.velocities[i], 0.0, 0.0, 0.0)
            model = builder.finalize(device="cpu")
            self._solver = practice.solver(model)
            self._now, self._next, self._control = model.state(), model.state(), model.control()
            self._collisions = newton.CollisionPipeline(model)
            self._contacts = self._collisions.contacts()
        self._rows = [bodies[i] for i in range(len(bodies))]

    def step(self) -> None:
        self._now.clear_forces()
        self._collisions.collide(self._now, self._contacts)
        self._solver.step(self._now, self._next, self._control, self._contacts, self._step)
        self._now, self._next = self._next, self._now

    def velocities(self) -> Sequence[float]:
        return self._now.body_qd.numpy()[self._rows, 2].tolist()
