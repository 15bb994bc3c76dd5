"""Comparison of several solvers with the model on one collision or chain, as text, as HTML and as a picture.

`compare` solves a collision and returns a `SolverComparison`. Notebooks call it as `impact_xval.compare`; the command
``solve`` and the explorer make a `SolverComparison` from outcomes that they have computed themselves.
"""

from __future__ import annotations

import base64
import io
import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from importlib.metadata import version
from typing import TYPE_CHECKING

import numpy as np
from markupsafe import Markup
from rich.console import Console

from impact_xval.compliant_baselines.registry import (
    get_solver,
    is_engine,
    is_ours,
    law_name_of,
    solver_names,
    sort_by_law,
    stated_law,
)
from impact_xval.experiments.config.arrangements import ChainSetup
from impact_xval.experiments.config.experiment import parse_config
from impact_xval.experiments.measures.divergence import measures_of
from impact_xval.experiments.presentation.document import Block, Table
from impact_xval.experiments.presentation.html import render_blocks
from impact_xval.experiments.presentation.terminal import print_blocks, say_waiting
from impact_xval.experiments.presentation.words import (
    NO_RESULT,
    WHAT_NO_RESULT_IS,
    WITHOUT_GRAVITY,
    capitalise_first,
    describe_chain,
    describe_direction,
    describe_shared_laws,
)
from impact_xval.experiments.sweep.one import open_solvers_apart
from impact_xval.experiments.tables.numbers import join_words, number
from impact_xval.model.collision import Collision
from impact_xval.model.kinetic import kinetic_norm
from impact_xval.model.outcome import Outcome
from impact_xval.model.status import RESULT_STATUSES

if TYPE_CHECKING:
    from matplotlib.figure import Figure

#: Width of a comparison as text in characters; resolution of its picture in a notebook in dots per inch.
_WIDTH, _DPI = 150, 100
#: Note below the table of a chain, which explains the rows of the table.
_CHAIN_NOTE = (
    "v1, v2, ...: velocities per |v0|, {direction}. D: kinetic norm of the difference from the model. limit: "
    "largest difference of a velocity between an engine's limit dt -> 0 and the exact solver of its law; error: the "
    "engine's own estimate of it. E/E0, p/p0: energy and momentum over those before. states: number of sets of "
    "active contacts that follow each other in time."
)


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class SolverComparison:
    """Outcomes of several solvers for one collision or chain. A notebook shows them as a table and a picture.

    Attributes
    ----------
    problem : Collision
    outcomes : mapping of str to Outcome
        Outcomes by solver. The outcome of the model (`REFERENCE`) is among them. Velocities are in m/s, impulses in N
        s.
    chain : ChainSetup or None
        Setup of a chain, if it is known. It is described above the table.
    versions : mapping of str to str
        Versions of solvers by name; solvers that did not state their version are not in it.
    scenario : str
        Scenario of the collision in words: without gravity, or with which gravity.
    """

    problem: Collision
    outcomes: Mapping[str, Outcome]
    chain: ChainSetup | None = None
    versions: Mapping[str, str] = field(default_factory=dict)
    scenario: str = WITHOUT_GRAVITY

    @property
    def is_chain(self) -> bool:
        """Whether the problem is a chain. It is false for two balls on a table that were not set up as a chain."""
        return self.chain is not None or not self.problem.falls_on_resting

    @property
    def divergences(self) -> dict[str, float]:
        """Divergence D of each solver's final velocities from the model's, by solver.

        It is NaN if the solver or the model has no result.
        """
        return {name: measures["velocity_divergence"] for name, measures in self._measures.items()}

    @property
    def scaled_velocities(self) -> dict[str, list[float]]:
        """Final velocities over the speed of impact by solver; solvers without a result are skipped.

        Solvers with the same law follow each other.
        """
        known = self._known_velocities
        return {name: velocities for name, velocities in known.items() if self._no_result_mark(name) == ""}

    #: Setup of a chain in words; empty if the setup is not known.
    setup = property(lambda self: "" if self.chain is None else describe_chain(self.chain))

    @property
    def _known_velocities(self) -> dict[str, list[float]]:
        """Final velocities over the speed of impact, by solver, also of solvers without a result.

        A solver without a result may still return velocities, for example if it ran out of time. Solvers without
        velocities are skipped. Solvers with the same law follow each other.
        """
        all_of = {name: self.outcomes[name].velocities for name in sort_by_law(self.outcomes)}
        return {
            name: [v / self._speed for v in all_of[name]]
            for name in all_of
            if np.isfinite(all_of[name]).all()
        }

    def _no_result_mark(self, name: str) -> str:
        """Return the mark that stands after the numbers of a solver without a result; empty if it has a result."""
        return "" if self.outcomes[name].status in RESULT_STATUSES else NO_RESULT

    _measures = property(lambda self: measures_of(self.problem, self.outcomes))
    _speed = property(lambda self: max(map(abs, self.problem.velocities)))

    @property
    def between(self) -> dict[tuple[str, str], float]:
        """Divergence D between every two solvers that have a result; each pair of solvers is listed once.

        D is the kinetic norm of the difference between the two solvers' final velocities, over the kinetic norm of the
        velocities at first touch. D is the same in both directions. Solvers with the same law follow each other.
        """
        masses, length = self.problem.masses, kinetic_norm(self.problem.masses, self.problem.velocities)
        results = {name: np.array(self.outcomes[name].velocities) for name in self.scaled_velocities}
        return {
            (first, second): float(kinetic_norm(masses, results[second] - results[first]) / length)
            for first, second in itertools.combinations(results, 2)
        }

    def objects(self) -> list[dict[str, object]]:
        """Return one dictionary per solver, which becomes an object in JSON.

        Velocities are over abs(v0), impulses over m1 abs(v0), and times are in s. Missing numbers are NaN, and a
        grazing margin without a bound is infinite; both become null in JSON.
        """
        measures, between, speed = self._measures, self.between, self._speed
        return [
            {
                "solver": name,
                "version": self.versions.get(name, ""),
                "velocities": [v / speed for v in outcome.velocities],
                **{f"v{i}": v / speed for i, v in enumerate(outcome.velocities, 1)},
                "impulses": [i / (self.problem.masses[0] * speed) for i in outcome.impulses],
                **{
                    key: getattr(outcome, key)
                    for key in ("states", "status", "reason", "grazing_margin", "marked", "mark")
                },
                "D": measures[name]["velocity_divergence"],
                "D_from": {
                    partner: d
                    for solvers, d in between.items()
                    if name in solvers
                    for partner in solvers
                    if partner != name
                },
                "diagnostics": {key: measures[name][key] for key in outcome.diagnostics},
            }
            for name, outcome in self.outcomes.items()
        ]

    def plot(self) -> Figure:
        """Draw the impulse curves and velocities of two balls, or the final velocities of a chain.

        A `ValueError` is raised if there is nothing to draw. For two balls that means that no outcome has a path, and
        for a chain that no solver has a result.
        """
        from impact_xval.experiments.presentation.pictures.curves import (
            draw_collision,
            draw_velocities,
            drawable_paths,
        )

        if self.is_chain and self.scaled_velocities:
            return draw_velocities(self.scaled_velocities)
        if not self.is_chain and (paths := drawable_paths(self.problem, self.outcomes)):
            return draw_collision(self.problem, paths)
        statuses = {name: outcome.status for name, outcome in self.outcomes.items()}
        raise ValueError(
            f"no solver has a path to draw ({statuses}); legal: a collision that a solver can solve"
        )

    def blocks(self) -> list[Block]:
        """Return the table of all solvers, and the sentences about it."""
        table = self._chain_table() if self.is_chain else self._collision_table()
        setup = " ".join(f"{capitalise_first(text)}." for text in (self.setup, self.scenario) if text)
        note = ""
        if self.is_chain and table.rows:
            note = _CHAIN_NOTE.format(direction=describe_direction(table=self.problem.table))
        withheld = WHAT_NO_RESULT_IS if any(map(self._no_result_mark, self._known_velocities)) else ""
        reasons = [
            f"{n}: {outcome.status}: {outcome.reason}"
            for n, outcome in self.outcomes.items()
            if outcome.reason
        ]
        marks = [
            f"{name}: marked: {outcome.mark}" for name, outcome in self.outcomes.items() if outcome.marked
        ]
        differences = [
            f"{name}: {outcome.differences}" for name, outcome in self.outcomes.items() if outcome.differences
        ]
        return [
            *filter(
                None,
                [
                    setup,
                    table,
                    note,
                    withheld,
                    self._pairwise_table(),
                    describe_shared_laws(name for name in self.outcomes if name in self.scaled_velocities),
                    *reasons,
                    *marks,
                    *differences,
                    self._describe_versions(),
                ],
            )
        ]

    def _repr_html_(self) -> str:
        """Return the table, the sentences about it and the picture as HTML for a notebook."""
        file = io.BytesIO()
        try:
            self.plot().savefig(file, format="png", dpi=_DPI)
        except ValueError:  # there is nothing to draw
            return render_blocks(self.blocks())
        picture = Markup('<img alt="{} by every solver" src="data:image/png;base64,{}" style="{}">').format(
            "final velocity of each ball" if self.is_chain else "impulse curves and velocities",
            base64.b64encode(file.getvalue()).decode("ascii"),
            "max-width: 100%; background: white",
        )
        return render_blocks([*self.blocks(), picture])

    def __str__(self) -> str:
        file = io.StringIO()
        print_blocks(
            Console(file=file, width=_WIDTH, force_jupyter=False, force_terminal=False), self.blocks()
        )
        return file.getvalue()

    __repr__ = __str__

    def _collision_table(self) -> Table:
        divergences, velocities, unit = self.divergences, self._known_velocities, self.problem.units.impulse
        rows: list[tuple[str, ...]] = []
        for name in sort_by_law(self.outcomes):
            outcome, cells = self.outcomes[name], ["-"] * 6
            if name in velocities:
                numbers = [*velocities[name], *(impulse / unit for impulse in outcome.impulses)]
                cells = [self._format_number(name, value) for value in numbers]
                cells += [number(divergences[name]), " ".join(outcome.states)]
            rows.append((stated_law(name) or name, name, outcome.status, *cells))
        header = "law solver status v1/|v0| v2/|v0| I1/(m1|v0|) I2/(m1|v0|) D states"
        return Table(header.split(), rows, text=3)

    def _pairwise_table(self) -> Table | None:
        """Return a table of D between every two solvers, or None if fewer than three solvers have a result.

        With two solvers this table is not needed, because the table of outcomes already shows the D between them.
        """
        names, between = list(self.scaled_velocities), self.between
        if len(names) < 3:
            return None
        rows = [
            (second, *(number(between[first, second], 2) for first in names[:place]))
            for place, second in enumerate(names)
        ]
        filled = [(*row, *[""] * (len(names) - len(row))) for row in rows[1:]]
        return Table(["solver", *names[:-1]], filled, "D between every two solvers")

    def _describe_versions(self) -> str:
        """Return a sentence with the versions of the project and of the engines and plug-ins that solved the problem.

        The sentence is empty if no engine and no plug-in solved the problem.
        """
        foreign = [name for name in self.outcomes if is_engine(name) or not is_ours(name)]
        of_foreign = [f"{name} {self.versions[name]}" for name in foreign if self.versions.get(name)]
        ours = f"impact-xval {version('impact-xval')}"
        return f"Versions: {join_words([ours, *of_foreign])}." if of_foreign else ""

    def _format_number(self, name: str, value: float) -> str:
        """Return a number of a solver as text; a mark follows if the solver has no result, and NaN becomes "-"."""
        return "-" if np.isnan(value) else f"{value:.6f}{self._no_result_mark(name)}"

    def _chain_table(self) -> Table:
        """Return the table of a chain, with a row for each quantity and a column for each solver.

        Quantities are in rows, because a chain of many balls has more quantities than there are solvers.
        """
        measures = self._measures
        facts: dict[str, dict[str, str]] = {}
        for name, velocities in self._known_velocities.items():
            outcome, measured = self.outcomes[name], measures[name]
            facts[name] = {
                "law": law_name_of(name) or "-",
                "status": outcome.status,
                **{
                    f"v{i}": self._format_number(name, round(v, 6) + 0.0) for i, v in enumerate(velocities, 1)
                },
                "D": number(measured["velocity_divergence"], 2),
                "limit": number(measured["limit_distance"], 2),
                "error": number(measured["limit_error"], 2),
                "E/E0": self._format_number(name, measured["retained_energy"]),
                "p/p0": self._format_number(name, measured["retained_momentum"]),
                "states": str(len(outcome.states)),
            }
        rows = [
            (fact, *(values[fact] for values in facts.values())) for fact in next(iter(facts.values()), ())
        ]
        return Table(["solver", *facts], rows)


def compare(
    problem: Collision, solvers: Sequence[str] | None = None, *, timeout: float = 300.0
) -> SolverComparison:
    """Solve one collision or chain without gravity by several solvers, and compare their outcomes with the model's.

    Solvers run in worker processes, each within a time limit. If a solver crashes or takes too long, the status of its
    outcome says so. The first comparison after an installation compiles kernels, which takes a minute or two.

    Parameters
    ----------
    problem : Collision
    solvers : sequence of str, optional
        Names of solvers; the model is added to them. By default all solvers that the command ``solve`` calls by
        default, plug-ins included.
    timeout : float
        Time limit of each solver in s.

    Raises
    ------
    ValueError
        If a name is not a solver's or the time limit is illegal. The message says what is legal.
    """
    names = [solvers] if isinstance(solvers, str) else list(solver_names() if solvers is None else solvers)
    config = parse_config({"scenario": "impact", "cell_timeout": timeout, "solvers": names}, where="")
    with open_solvers_apart(config.solvers, chains=not problem.falls_on_resting) as apart:
        outcomes = apart.solve(problem, config, config.solvers, get_solver, say_waiting)
        return SolverComparison(problem, outcomes, versions=apart.versions)
