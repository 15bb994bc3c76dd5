"""One collision, or one column, by several solvers: how far each is from the model, as text, as HTML, as a picture."""

from __future__ import annotations

import base64
import io
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from markupsafe import Markup

from impact_xval.compliant_baselines.registry import law_of
from impact_xval.compliant_baselines.solver import MappingName
from impact_xval.experiments.config.experiment import REFERENCE
from impact_xval.experiments.measures.divergence import Measures, measures_of, velocity_divergence
from impact_xval.experiments.measures.laws import by_law, in_order_of_laws
from impact_xval.experiments.presentation.document import Block, Table
from impact_xval.experiments.presentation.html import render
from impact_xval.experiments.presentation.words import one_vote
from impact_xval.experiments.tables.numbers import number
from impact_xval.model.collision import RESULT_STATUSES, Collision, Outcome

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from impact_xval.experiments.config.arrangements import Arranged

#: Letters of a line of the text of a comparison.
_WIDTH = 150
#: Dots per inch of the picture in a notebook.
_DPI = 100
#: The rows of the table of a column.
_COLUMN = (
    "v1, v2, ...: velocities per |v0|, up is positive. D: kinetic norm of the difference from the model. limit: "
    "largest difference of a velocity between an engine's limit dt -> 0 and the exact solver of its law; error: the "
    "engine's own estimate of it. E/E0, p/p0: energy and momentum over those before."
)


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Compared:
    """What several solvers made of one collision or column; a notebook shows it as a table and a picture.

    Attributes
    ----------
    problem : Collision
    outcomes : mapping of str to Outcome or Outcome
        By solver, the model (`REFERENCE`) among them; velocities in m/s, impulses in N s, with their paths.
    arranged : Arranged or None
        How a column was set up, if it is known: in words above its table.
    mapping : str
        That engines were given.
    """

    problem: Collision
    outcomes: Mapping[str, Any]
    arranged: Arranged | None = None
    mapping: MappingName = "calibrated"

    @property
    def is_column(self) -> bool:
        """Whether this is no problem of two balls as the paper has it, or was asked for as a column."""
        return self.arranged is not None or not self.problem.falls_on_resting

    @property
    def divergences(self) -> dict[str, float | None]:
        """Velocity divergence D from the model, by solver; None where one of the two has no result."""
        if self.is_column:
            measures = measures_of(self.problem, self.outcomes, self.mapping)
            return {name: each.velocity_divergence for name, each in measures.items()}
        model = self.outcomes[REFERENCE]
        return {name: velocity_divergence(self.problem, model, each) for name, each in self.outcomes.items()}

    @property
    def velocities(self) -> dict[str, tuple[float, ...]]:
        """Final velocities in m/s, ball 1 (on top) first, by solver; NaN where there is no result."""
        return {name: each.velocities for name, each in self.outcomes.items()}

    @property
    def statuses(self) -> dict[str, str]:
        """Status by solver: ``ok``, ``limit``, or why there is no result; the sentence is the outcome's ``reason``."""
        return {name: each.status for name, each in self.outcomes.items()}

    @property
    def states(self) -> dict[str, tuple[Any, ...]]:
        """State path by solver: of two balls names of states, of a column the sets of contacts that act."""
        return {name: each.states for name, each in self.outcomes.items()}

    def objects(self) -> list[dict[str, Any]]:
        """Return a JSON object a solver: velocities per abs(v0), impulses per m1 abs(v0), times in s."""
        from impact_xval.experiments.measures.results import scaled_diagnostics

        c, away, found = self.problem, self.divergences, []
        speed = max(map(abs, c.velocities))
        for name, outcome in self.outcomes.items():
            velocities = [_finite(v / speed) for v in outcome.velocities]
            diagnostics = scaled_diagnostics(outcome, speed)
            found.append(
                {
                    "solver": name,
                    "velocities": velocities,
                    **{f"v{i}": v for i, v in enumerate(velocities, 1)},
                    "impulses": [_finite(i / (c.masses[0] * speed)) for i in outcome.impulses],
                    "states": list(outcome.states),
                    "status": outcome.status,
                    "reason": outcome.reason,
                    "grazing_margin": _finite(outcome.grazing_margin),
                    "marked": outcome.marked,
                    "D": away[name],
                    "diagnostics": {key: _finite(value) for key, value in diagnostics.items()},
                }
            )
        return found

    def plot(self) -> Figure:
        """Draw the impulse curves of two balls, or the final velocities of a column, of all that have a result.

        Raises
        ------
        ValueError
            If none has.
        """
        drawn = self._results()
        if not drawn:
            raise ValueError(f"no solver has a result to draw; statuses: {self.statuses}")
        import pandas as pd

        if self.is_column:
            from impact_xval.experiments.presentation.pictures.columns import velocities_figure

            speed = max(map(abs, self.problem.velocities))
            rows = [(name, [v / speed for v in self.outcomes[name].velocities]) for name in drawn]
            return velocities_figure(pd.DataFrame(rows, columns=["solver", "velocities"]), drawn)
        from impact_xval.experiments.presentation.pictures.curves import draw_cell_curves

        curves = [
            pd.DataFrame({"solver": name, "impulse1": i1, "impulse2": i2})
            for name, (i1, i2) in impulse_curves(self.problem, self.outcomes).items()
        ]
        return draw_cell_curves(pd.concat(curves).assign(mass_ratio=self.problem.mass_ratio), drawn)

    def blocks(self) -> list[Block]:
        """Return the table of all solvers, and what there is to say of them."""
        table = self._column_table() if self.is_column else self._collision_table()
        blocks: list[Block] = [*self._setup(), table]
        if self.is_column and table.rows:
            blocks.append(_COLUMN)
        blocks.append(one_vote(self.outcomes))
        blocks += [
            f"{name}: {each.status}: {each.reason}" for name, each in self.outcomes.items() if each.reason
        ]
        blocks += [f"{name}: marked: {each.marked}" for name, each in self.outcomes.items() if each.marked]
        return [block for block in blocks if block]

    def fragment(
        self, lines: Mapping[str, Any] | None = None, paths: bool = False, picture: str = ""
    ) -> Markup:
        """Return the table as a piece of HTML.

        Parameters
        ----------
        lines : mapping of str to Line, optional
            How each solver is drawn (`cells.figures`), shown beside its name.
        paths : bool
            Whether the state paths of a column follow, folded away.
        picture : str
            A PNG in base64 that comes last.
        """
        shown = {name: self.states[name] for name in self._results()} if paths and self.is_column else {}
        facts = {"blocks": self.blocks(), "lines": lines or {}, "paths": shown}
        return render("compared.html.j2", **facts, picture=picture, column=self.is_column)

    def _repr_html_(self) -> str:
        """Return what a notebook shows: the table, and the picture as part of it."""
        if not self._results():
            return self.fragment()
        from matplotlib.backends.backend_agg import FigureCanvasAgg

        figure, file = self.plot(), io.BytesIO()
        figure.dpi = _DPI
        FigureCanvasAgg(figure).print_png(file)
        return self.fragment(picture=base64.b64encode(file.getvalue()).decode("ascii"))

    def __str__(self) -> str:
        from rich.console import Console

        from impact_xval.experiments.presentation.terminal import show

        console = Console(file=io.StringIO(), width=_WIDTH)
        show(console, self.blocks())
        return console.file.getvalue()  # type: ignore[attr-defined]

    __repr__ = __str__

    def _results(self) -> list[str]:
        """Solvers with a result, in the order of laws."""
        return [n for n in in_order_of_laws(self.outcomes) if self.outcomes[n].status in RESULT_STATUSES]

    def _setup(self) -> list[Block]:
        """Say how a column was set up, if it is known."""
        a = self.arranged
        if a is None:
            return []
        kinds = {
            "chain": f"ball 1 strikes a row of {a.balls - 1} at rest",
            "cradle": f"{a.striking} of {a.balls} balls {'strikes' if a.striking == 1 else 'strike'} the others",
            "drop": f"ball 1 falls on {a.balls - 1} at rest on a table",
            "stack": ("ball 1 falls" if a.balls == 1 else f"{a.balls} balls fall together") + " onto a table",
        }
        law = "" if a.exponent == 1 else f", F = k delta^{number(a.exponent, 6)}"
        gap = f", gaps of {number(a.gap, 6)} m" if a.gap else ""
        return [f"{a.arrangement}: {kinds[a.arrangement]}, e = {number(a.e, 6)}{law}{gap}."]

    def _collision_table(self) -> Table:
        away = self.divergences
        rows = [
            (law, name, self.outcomes[name].status, *_numbers(self.problem, self.outcomes[name], away[name]))
            for law, group in by_law(self.outcomes).items()
            for name in group
        ]
        scaled = ("v1/|v0|", "v2/|v0|", "I1/(m1|v0|)", "I2/(m1|v0|)")
        return Table(("law", "solver", "status", *scaled, "D", "states"), rows, text=3)

    def _column_table(self) -> Table:
        shown, measures = self._results(), measures_of(self.problem, self.outcomes, self.mapping)
        speed = max(map(abs, self.problem.velocities))
        columns = [_facts(name, self.outcomes[name], measures[name], speed) for name in shown]
        rows = [(fact, *(each[fact] for each in columns)) for fact in (columns[0] if columns else ())]
        return Table(["solver", *shown], rows)


def compare(
    problem: Collision,
    solvers: Sequence[str] | None = None,
    *,
    timeout: float = 300.0,
) -> Compared:
    """Solve one collision, or one column, by several solvers without gravity, and compare them with the model.

    Each solver runs in a process of its own, within a limit of time: one that crashes or hangs has a status that says
    so. The first comparison of an installation has kernels compiled, a minute or two.

    Parameters
    ----------
    problem : Collision
    solvers : sequence of str, optional
        Names of solvers, to which the model is added; by default those that a run has.
    timeout : float
        Seconds after which a solver is ended.

    Returns
    -------
    Compared

    Raises
    ------
    TypeError
        If the problem is none.
    ValueError
        For names that are no solvers, or an illegal time; the message says what is legal.
    """
    from impact_xval.compliant_baselines.registry import get_solver, solver_names
    from impact_xval.experiments.config.errors import UserError
    from impact_xval.experiments.config.experiment import parse_config, solvers_problem
    from impact_xval.experiments.sweep.one import solvers_apart

    if not isinstance(problem, Collision):
        raise TypeError(f"compare was given {type(problem).__name__}; legal: a Collision")
    names = [solvers] if isinstance(solvers, str) else list(solver_names() if solvers is None else solvers)
    wrong = solvers_problem(names)
    if wrong:
        raise ValueError(f"solvers: {wrong}")
    names = [REFERENCE, *(name for name in names if name != REFERENCE)]
    try:
        config = parse_config({"scenario": "impact", "cell_timeout": timeout}, where="")
    except UserError as error:
        raise ValueError(str(error)) from None
    with solvers_apart(names, columns=not problem.falls_on_resting) as apart:
        return Compared(problem, apart.solve(problem, config, names, get_solver, _say))


def impulse_curves(
    collision: Collision, outcomes: Mapping[str, Outcome], points: int = 4000
) -> dict[str, tuple[Sequence[float], Sequence[float]]]:
    """Return the impulse curves of all that have one: by solver I1 and I2 per m1 abs(v0), of some `points`."""
    from impact_xval.experiments.sweep.curves import thinned

    curves = {}
    for name in in_order_of_laws(outcomes):
        path = outcomes[name].path
        if outcomes[name].status in RESULT_STATUSES and path is not None:
            i1, i2 = (impulse / collision.units.impulse for impulse in (path.impulse1, path.impulse2))
            kept = thinned(i1, i2, path.state, points)
            curves[name] = i1[kept], i2[kept]
    return curves


def _say(line: str) -> None:
    """Say what is waited for, on standard error."""
    from impact_xval.experiments.presentation.terminal import COMPILING, error_line

    error_line(line or COMPILING)


def _finite(value: float | None) -> float | None:
    return None if value is None or not math.isfinite(value) else float(value)


def _numbers(collision: Collision, outcome: Outcome, away: float | None) -> list[str]:
    """Cells of the table of a collision: velocities per abs(v0), impulses per m1 abs(v0), D, states."""
    if outcome.status not in RESULT_STATUSES:
        return ["-"] * 6
    speed = abs(collision.v0)
    impulse = collision.m1 * speed
    scaled = outcome.v1 / speed, outcome.v2 / speed, outcome.impulse1 / impulse, outcome.impulse2 / impulse
    shown = "-" if away is None else number(away)
    return [*(f"{value:.6f}" for value in scaled), shown, " ".join(outcome.states)]


def _facts(name: str, outcome: Outcome, measures: Measures, speed: float) -> dict[str, str]:
    """Return a column of the table of a column: velocities per speed of impact, measures, number of states."""

    def rough(value: float | None) -> str:
        return number(math.nan if value is None else value, 2)

    return {
        "law": law_of(name) or "-",
        "status": outcome.status,
        **{f"v{i}": f"{round(v / speed, 6) + 0.0:.6f}" for i, v in enumerate(outcome.velocities, 1)},
        "D": rough(measures.velocity_divergence),
        "limit": rough(measures.limit_distance),
        "error": rough(measures.limit_error),
        "E/E0": f"{measures.retained_energy:.6f}",
        "p/p0": f"{measures.retained_momentum:.6f}",
        "states": str(len(outcome.states)),
    }
