"""Comparison of solvers and rigid laws with the model on one contact graph, as text and as a picture.

A contact graph is a set of bodies that meet at once in any number of contacts. The command ``solve --graph`` makes a
`GraphComparison` from the outcomes.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib.metadata import version
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from impact_xval.compliant_baselines.registry import is_engine, is_ours, sort_by_law
from impact_xval.compliant_baselines.rigid.laws import LAWS
from impact_xval.experiments.config.experiment import REFERENCE
from impact_xval.experiments.presentation.document import Block, Table
from impact_xval.experiments.presentation.words import (
    NO_RESULT,
    WHAT_NO_RESULT_IS,
    WITHOUT_GRAVITY,
    capitalise_first,
)
from impact_xval.experiments.tables.numbers import join_words, number
from impact_xval.model.arrays import Floats
from impact_xval.model.graph.collision import GraphCollision
from impact_xval.model.graph.collision_outcome import GraphCollisionOutcome
from impact_xval.model.kinetic import kinetic_norm

if TYPE_CHECKING:
    from matplotlib.figure import Figure

#: Solvers that solve a graph by default, in addition to the model and the rigid laws.
REFERENCES = ("bistiffness", "kelvin-voigt", "compression-dashpot", "linear-dashpot")

#: Names of the rigid laws, which compute impulses from the Delassus matrix W of a graph (`rigid.graphs`).
RIGID_LAWS = tuple(LAWS)

#: Largest spread of a rigid law's final rates in m/s that counts as rounding; a larger spread is reported.
_ROUNDING = 1e-9

_NOTE = (
    "v1, v2, ...: velocities of the bodies in m/s. D: kinetic norm of the difference from the model, over that of the "
    "velocities at first touch. E/E0: kinetic energy after the impact over kinetic energy before."
)


@dataclass(frozen=True, slots=True, eq=False)
class GraphComparison:
    """Outcomes of several solvers and rigid laws for one contact graph.

    Attributes
    ----------
    problem : GraphCollision
    outcomes : mapping of str to GraphCollisionOutcome
        Outcomes by solver or rigid law. The outcome of the model (`REFERENCE`) is among them.
    setup : str
        Setup of the graph in words.
    versions : mapping of str to str
        Versions of solvers by name, as the solvers state them.
    """

    problem: GraphCollision
    outcomes: Mapping[str, GraphCollisionOutcome]
    setup: str
    versions: Mapping[str, str] = field(default_factory=dict)

    @property
    def divergences(self) -> dict[str, float]:
        """Divergence D of each solver's final velocities from the model's, by solver.

        It is NaN if the solver or the model has no result.

        D is the kinetic norm of the difference between the two arrays of velocities, over the kinetic norm of the
        velocities at first touch.
        """
        model = self.outcomes[REFERENCE]
        length = self._norm(self._motion(self.problem.velocities, self.problem.angular_velocities))
        return {
            name: self._norm(self._motion_of(outcome) - self._motion_of(model)) / length
            if outcome.has_result and model.has_result
            else float("nan")
            for name, outcome in self.outcomes.items()
        }

    def retained_energy(self, outcome: GraphCollisionOutcome) -> float:
        """Return the kinetic energy after the impact divided by the kinetic energy before it, for one outcome."""
        length = self._norm(self._motion(self.problem.velocities, self.problem.angular_velocities))
        return (self._norm(self._motion_of(outcome)) / length) ** 2

    def _motion(self, velocities: ArrayLike, turning: ArrayLike) -> Floats:
        """Return one array of all velocities: the components of each body, and then the angular velocities.

        If there are no angular velocities, zeros stand in their place.
        """
        moments = np.ravel(self.problem.inertias)
        turns = np.ravel(np.asarray(turning, float)) if np.size(turning) else np.zeros(len(moments))
        return np.append(np.ravel(np.asarray(velocities, float)), turns)

    def _motion_of(self, outcome: GraphCollisionOutcome) -> Floats:
        return self._motion(outcome.velocities, outcome.angular_velocities)

    def _norm(self, motion: Floats) -> float:
        """Return the kinetic norm of an array of velocities that `_motion` makes.

        Bodies that cannot turn have no energy of rotation.
        """
        moments = np.ravel(np.asarray(self.problem.inertias, float))
        masses = np.repeat(np.array(self.problem.masses), len(self.problem.velocities[0]))
        weights = np.append(masses, np.where(np.isfinite(moments), moments, 0.0))
        return float(kinetic_norm(weights, np.where(weights > 0, motion, 0.0)))

    @property
    def _order(self) -> list[str]:
        """Names of the solvers in the order of tables: the model, the references, the engines, the rigid laws."""
        known = sort_by_law([name for name in self.outcomes if name not in RIGID_LAWS])
        return [*known, *(name for name in RIGID_LAWS if name in self.outcomes)]

    def label(self, name: str) -> str:
        """Return the name of a solver for tables and pictures.

        The name of a rigid law that takes contacts one after the other also tells the order of the contacts.
        """
        contacts = len(self.problem.contacts)
        if name == "sequential-top":
            return "sequential (1)" if contacts == 1 else f"sequential (1 to {contacts})"
        if name == "sequential-bottom":
            return "sequential (1)" if contacts == 1 else f"sequential ({contacts} to 1)"
        return name

    def objects(self) -> list[dict[str, object]]:
        """Return one dictionary per solver, which becomes an object in JSON.

        Velocities are in m/s and rad/s. Missing numbers are NaN, which becomes null in JSON.
        """
        divergences = self.divergences
        return [
            {
                "solver": name,
                "version": self.versions.get(name, ""),
                "velocities": [list(v) for v in outcome.velocities],
                "angular_velocities": [list(v) for v in outcome.angular_velocities],
                "status": outcome.status,
                "reason": outcome.reason,
                "mark": outcome.mark,
                "D": divergences[name],
                "retained_energy": self.retained_energy(outcome),
                "diagnostics": dict(outcome.diagnostics),
            }
            for name, outcome in ((name, self.outcomes[name]) for name in self._order)
        ]

    def blocks(self) -> list[Block]:
        """Return the table of all solvers, and the sentences about it."""
        sentences: list[str] = []
        shows_numbers = False
        for name in self._order:
            outcome = self.outcomes[name]
            shows_numbers |= not outcome.has_result and bool(np.isfinite(outcome.velocities).all())
            if outcome.reason:
                sentences.append(f"{self.label(name)}: {outcome.status}: {outcome.reason}")
            if outcome.mark:
                sentences.append(f"{self.label(name)}: marked: {outcome.mark}")
            spread = outcome.diagnostics.get("rate_spread", 0.0)
            if spread > _ROUNDING:
                sentences.append(
                    f"{self.label(name)}: the split of impulses between contacts is not unique, and final rates "
                    f"differ by up to {number(spread)} m/s with it"
                )
        withheld = [WHAT_NO_RESULT_IS] if shows_numbers else []
        return [
            f"{capitalise_first(self.setup)}. {capitalise_first(WITHOUT_GRAVITY)}.",
            self._table(),
            _NOTE,
            *withheld,
            *sentences,
            *self._versions(),
        ]

    def _table(self) -> Table:
        """Return the table of outcomes, with a row for each solver and a column for each body's velocity."""
        divergences, axes = self.divergences, "x, z" if len(self.problem.velocities[0]) == 2 else "x, y, z"
        bodies = range(1, len(self.problem.masses) + 1)
        turns = bool(len(self.problem.inertias))
        rows: list[tuple[str, ...]] = []
        for name in self._order:
            outcome = self.outcomes[name]
            cells = ["-"] * (len(bodies) * (1 + turns) + 2)
            if np.isfinite(outcome.velocities).all():
                mark = "" if outcome.has_result else NO_RESULT
                cells = [_numbers(v) + mark for v in outcome.velocities]
                if turns:
                    spins = outcome.angular_velocities or [(float("nan"),) for _ in bodies]
                    cells += [_numbers(v) + mark for v in spins]
                cells += [number(divergences[name], 2), number(self.retained_energy(outcome), 4)]
            rows.append((self.label(name), outcome.status, *cells))
        header = ["solver", "status", *(f"v{i} ({axes})" for i in bodies)]
        header += [f"omega{i} (rad/s)" for i in bodies] if turns else []
        return Table([*header, "D", "E/E0"], rows, text=2)

    def _versions(self) -> list[str]:
        """Return a sentence with the versions of the project and of the engines and plug-ins that solved the graph.

        The sentence is empty if no engine and no plug-in solved the graph.
        """
        foreign = [
            name
            for name in self.versions
            if name not in RIGID_LAWS and (is_engine(name) or not is_ours(name))
        ]
        stated = [f"{name} {self.versions[name]}" for name in foreign if self.versions[name]]
        ours = f"impact-xval {version('impact-xval')}"
        return [f"Versions: {join_words([ours, *stated])}."] if stated else []

    def caption(self) -> str:
        """Return the caption of the picture."""
        return (
            f"{capitalise_first(self.setup)}, by solver. Black arrows: normals of contacts. Grey arrows: velocities "
            "before; coloured ones: after; both to the scale of the arrow at the top. D: kinetic norm of the "
            "difference from the model, over that of the velocities before."
        )

    def plot(self) -> Figure:
        """Draw bodies, contact normals and velocities, with a panel for each solver that has a result.

        A `ValueError` is raised if no solver has a result.
        """
        from impact_xval.experiments.presentation.pictures.graphs import draw_graph

        divergences = self.divergences
        drawn = {
            f"{self.label(name)}, D = {number(divergences[name], 2)}": self.outcomes[name]
            for name in self._order
            if self.outcomes[name].has_result
        }
        if not drawn:
            raise ValueError("no solver has a result to draw; legal: a graph that a solver can solve")
        return draw_graph(self.problem, drawn, self.caption())


def _numbers(vector: tuple[float, ...]) -> str:
    """Return the components of a velocity as text, with four decimals and "-" for NaN."""
    return ", ".join("-" if np.isnan(x) else f"{round(x, 4) + 0.0:.4f}" for x in vector)
