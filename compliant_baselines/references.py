"""Exact solvers: of contact laws that are integrated over time, with positions, and of the model itself.

The laws are those of `model.chain`, and docs/theory.md, section 7, explains them.

k is the stiffness of a contact, c its damping, delta its depth, p the exponent of its spring, M the reduced mass of its
bodies.

**kelvin-voigt**: F = max(0, k delta^p + c delta^((p - 1)/2) delta') while the bodies overlap. For p = 1 this is a
linear spring and dashpot. For other p the dashpot is that of Tsuji, Tanaka and Ishida (Powder Technology 71:239, 1992),
and c has a factor sqrt((p + 1)/2). In the variable xi = delta^((p + 1)/2) and with u = delta', the motion is that of a
linear contact: u du/dxi = -2 (k xi + c u)/(M (p + 1)). So e is the same for every p and at any speed.

**compression-dashpot**: F = k delta^p + c delta^((p - 1)/2) delta' while delta' > 0, and F = k delta^p otherwise.

**linear-dashpot**: F = k delta^p + c delta^((p - 1)/2) delta' while delta > 0. The contact may pull, and ends at delta
= 0. In the variable xi a contact alone is an oscillator until xi returns to 0. So the textbook's damping ratio is exact
for every p.

Without gravity, linear contacts of this law always open. Proof: suppose that contacts of a row stayed closed for good.
Their slowest mode would then decay without oscillation, with all delta > 0. But the damping ratio of this mode is at
most the largest zeta of its contacts, by Cauchy's inequality, because the bodies of a row have at least the reduced
masses of its contacts. And every zeta is below 1.

**hunt-crossley**: F = max(0, k delta^p (1 + a delta')), with a = A(e)/u. Here u is the largest rate of compression at
first touch. A is the same for every p (`restitution`).

**bistiffness**: the model's own law in time. In a drop, an end of compression of contact 2 takes the part 1 - e2^2 of
its whole strain energy. This includes the energy of the compression by the weight, because the permanent indentation
belongs to the contact, whatever presses it.

Contact graphs are solved only by the laws with linear contacts (`model.graph.in_time`). As in chains, c_i follows from
e_i and the reduced mass of the contact, which is 1/W_ii with the Delassus matrix W.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import replace
from importlib.metadata import version
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from impact_xval.compliant_baselines import marks
from impact_xval.compliant_baselines.restitution import (
    damping_ratios,
    hunt_crossley_coefficients,
    textbook_damping_ratios,
)
from impact_xval.compliant_baselines.solver import Settings, Solver, solve_in_groups
from impact_xval.model import solving
from impact_xval.model.arrays import Floats
from impact_xval.model.chain.following import MAX_WINDOWS, ChainResult, Problem
from impact_xval.model.chain.laws import Law
from impact_xval.model.chain.power_law import TOLERANCE
from impact_xval.model.chain.record import ChainEnding
from impact_xval.model.collision import Collision
from impact_xval.model.collisions import Collisions
from impact_xval.model.graph.collision_outcome import GraphCollisionOutcome
from impact_xval.model.outcome import Outcome
from impact_xval.model.outcomes import Outcomes
from impact_xval.model.status import Ending, Status

if TYPE_CHECKING:
    from impact_xval.model.graph.collision import GraphCollision

#: For each law by its name: the value by which compiled code selects it.
LAWS = {
    "bistiffness": Law.STATE_TRANSITION,
    "kelvin-voigt": Law.KELVIN_VOIGT,
    "kelvin-voigt-anchored": Law.KELVIN_VOIGT,
    "kelvin-voigt-textbook": Law.KELVIN_VOIGT,
    "hunt-crossley": Law.HUNT_CROSSLEY,
    "compression-dashpot": Law.COMPRESSION_DASHPOT,
    "linear-dashpot": Law.LINEAR_DASHPOT,
}

#: Laws whose damping ratio is the textbook's, which belongs to a contact that may pull.
_TEXTBOOK = ("kelvin-voigt-textbook", "linear-dashpot")

#: Factor on `TOLERANCE` in a second run. The difference between the two runs estimates the error of the first run.
LOOSER = 100.0

_PLASTIC = (
    "a restitution is 0: no finite stiffness or damping in time makes a contact perfectly plastic; legal: "
    "0 < e <= 1; take a small one, or the state-transition model, which knows the limit"
)
_LIMITS = (
    "a stiffness is 0 or infinite: a contact in time needs a finite one > 0; take a large or small k2/k1, or the "
    "state-transition model, which knows the limit"
)


def solve_by_law(
    collisions: Collisions,
    law: str,
    *,
    frozen: bool = False,
    gravity: ArrayLike = 0.0,
    states: bool = True,
    paths: bool = False,
    max_steps: int = MAX_WINDOWS,
) -> Outcomes:
    """Solve collisions by a contact law that is integrated over time. The outcomes get no marks.

    Parameters
    ----------
    collisions
        The n collisions, all of one layout.
    law
        One of `LAWS`.
    frozen
        True for frozen positions, as in the model: a contact that has opened returns as soon as its bodies approach.
        With frozen positions collisions must not have gaps.
    gravity
        Gravity in m/s^2, of shape (n,) or (). Where it is above 0, the collision is a drop of two balls on a table,
        with the lower ball settled (`chain.drop`).
    states, paths
        True if the outcomes shall contain state sequences, or paths.
    max_steps
        Largest number of windows of series. A collision that needs more is given up. A window is the time over which a
        series is valid.

    Returns
    -------
    Outcomes
        The status is ``closed-form`` where a closed form has united bodies of bistiffness contacts or brought them to
        rest. Outcomes are exact to rounding where the forces are linear. Elsewhere ``velocity_error`` estimates the
        error of velocities in m/s, as the difference from a run at `LOOSER` times the tolerance. ``duration`` is in s.
        Drops have two more diagnostics: ``first_flight`` is the time in s at which gravity ended, and ``rest_speed`` is
        the velocity in m/s that a settled B2 still had. Velocities and impulses do not contain ``rest_speed``.
    """
    if law not in LAWS:
        raise ValueError(f"law = {law!r}; legal: {', '.join(LAWS)}")
    if frozen and collisions.gaps.any():
        raise ValueError(f"gaps: {float(collisions.gaps.max())!r}; legal where positions are frozen: none")
    g = np.broadcast_to(np.asarray(gravity, float), len(collisions))
    problem = Problem(collisions, LAWS[law], dampings(collisions, law), frozen, g, max_windows=max_steps)
    went = problem.follow(states=states)
    margin = went.records["margin"] if law == "bistiffness" else np.full(len(collisions), np.nan)
    diagnostics = {"duration": went.records["time"], "n_steps": went.records["n_windows"]}
    if collisions.exponent != 1:
        looser = replace(problem, tolerance=LOOSER * TOLERANCE).follow(states=False)
        moved = np.abs(looser.velocities - went.velocities).max(axis=1)
        diagnostics["velocity_error"] = np.where(looser.given_up, np.nan, moved)
    fallen: Floats | float = 0.0
    if g.any():
        velocities, fallen, drop_diagnostics = _settle_drops(collisions, g, went)
        went, diagnostics = went._replace(velocities=velocities), diagnostics | drop_diagnostics
    k: Floats = collisions.stiffnesses
    failures = [
        Ending((~np.isfinite(k) | (k <= 0)).any(axis=1), "unrepresentable", _LIMITS),
        Ending((collisions.restitutions == 0).any(axis=1), "unrepresentable", _PLASTIC),
        Ending(went.given_up, "timeout", f"not over after {max_steps} segments"),
    ]
    return problem.outcomes(
        law, went, failures, margin=margin, diagnostics=diagnostics, fallen=fallen, paths=paths
    )


def _settle_drops(
    collisions: Collisions, g: Floats, went: ChainResult
) -> tuple[Floats, Floats, dict[str, Floats]]:
    """Return velocities with settled balls at 0, the velocity that gravity gave free balls, and diagnostics of drops.

    Velocities are in m/s. Velocities of collisions without gravity are returned unchanged.
    """
    end, fall, falls, velocities = went.records["ending"], went.records["fall"], g > 0, went.velocities
    both_settled = falls & (end == ChainEnding.BOTH_SETTLED)
    b2_settled = both_settled | (falls & (end == ChainEnding.LOWER_SETTLED))
    settled = np.column_stack([both_settled, b2_settled])
    speed, reduced = collisions.units[1], 1 / (1 / collisions.masses).sum(axis=1)
    with np.errstate(over="ignore", invalid="ignore"):
        diagnostics = {
            "gravity_number": g / (speed * np.sqrt(collisions.stiffnesses[:, 0] / reduced)),
            "first_flight": np.where(fall < went.records["time"], fall, np.nan),
            "rest_speed": np.where(b2_settled, velocities[:, 1], np.nan),
        }
        fallen = np.where(falls, g * fall, 0.0)
    diagnostics = {name: np.where(falls, values, np.nan) for name, values in diagnostics.items()}
    return np.where(settled, 0.0, velocities), fallen, diagnostics


def dampings(collisions: Collisions, law: str) -> Floats:
    """Return the damping of each contact: c for linear contacts, a for `hunt-crossley`; shape (n, C).

    c is in the unit sqrt(m1 k1) of its collision, and a is in the inverse of its unit of velocity. The damping is 0 for
    bistiffness, and NaN where e is 0.
    """
    c, flat = collisions, collisions.restitutions.ravel()
    if law == "bistiffness":
        return np.where(c.restitutions > 0, 0.0, np.nan)
    if law == "hunt-crossley":
        rates = c.compression_rates
        largest = np.abs(rates).max(axis=1) / rates.max(axis=1)
        return hunt_crossley_coefficients(flat).reshape(rates.shape) * largest[:, None]
    with np.errstate(over="ignore", under="ignore", invalid="ignore", divide="ignore"):
        below = [np.full(len(c), np.inf)] if c.table else []
        inverse = c.masses[:, :1] / np.column_stack([c.masses, *below])
        mass = 1 / (inverse[:, 1:] + inverse[:, :-1])
        if law == "kelvin-voigt-anchored":
            mass[:, 0] = 1.0
        root = np.sqrt(c.stiffnesses / c.stiffnesses[:, :1]) * np.sqrt(mass)
        return (
            2 * damping_ratios_of_law(law, flat).reshape(root.shape) * np.sqrt(0.5 * (c.exponent + 1)) * root
        )


def damping_ratios_of_law(law: str, e: Floats) -> Floats:
    """Return the damping ratios with which the contacts of a law with linear dashpots have the restitutions e.

    `e` has the shape (n,). The result is NaN for e outside (0, 1].
    """
    if (
        law == "compression-dashpot"
    ):  # it needs the damping ratio that a dashpot in both directions needs for e^2
        e = e**2
    return (textbook_damping_ratios if law in _TEXTBOOK else damping_ratios)(e)


def law_at(law: str, *, frozen: bool = False, max_steps: int = MAX_WINDOWS) -> marks.Law:
    """Return the function that solves collisions by a law, in the form that `marks` calls."""

    def solve_without_states(collisions: Collisions, gravity: Floats) -> Outcomes:
        return solve_by_law(
            collisions, law, frozen=frozen, gravity=gravity, states=False, max_steps=max_steps
        )

    return solve_without_states


#: Laws that cannot be solved on contact graphs, with the reason.
_NOT_ON_GRAPHS = {
    "kelvin-voigt-anchored": "kelvin-voigt-anchored is a law of two balls on a table",
    "hunt-crossley": "hunt-crossley is not a linear contact; contact graphs are solved with linear contacts only",
    "liu-zhao-brogliato": "liu-zhao-brogliato is solved for balls in a line alone, no contact graphs",
}


def solve_graphs_by_law(
    collisions: Sequence[GraphCollision], law: str, *, frozen: bool = False, max_steps: int = MAX_WINDOWS
) -> list[GraphCollisionOutcome]:
    """Solve contact graphs by a contact law that is integrated over time.

    All contacts touch at the start, and normals stay constant (`model.graph.in_time.law` states the law).

    Parameters
    ----------
    collisions
        The contact graphs.
    law
        One of `LAWS`; the laws in `_NOT_ON_GRAPHS` are refused.
    frozen
        True for frozen positions, as in the model.
    max_steps
        Largest number of windows of series. A collision that needs more is given up. Whatever the number is, a
        collision is given up after about a second.

    Returns
    -------
    list of GraphCollisionOutcome
        One outcome for each collision, in order, exact to rounding. The status is ``closed-form`` where bistiffness
        contacts became rigid or came to rest together. The diagnostic ``duration`` is in s, and ``n_steps`` is the
        number of windows.
    """
    # This module takes 0.1 s to import. Callers who solve only chains do not need it, so it is imported here.
    from impact_xval.model.graph.in_time.following import solve_timed_graphs

    if law not in LAWS:
        raise ValueError(f"law = {law!r}; legal: {', '.join(LAWS)}")
    outcomes: dict[int, GraphCollisionOutcome] = {}
    for place, collision in enumerate(collisions):
        plastic = any(contact.restitution == 0 for contact in collision.contacts)
        reason = _NOT_ON_GRAPHS.get(law, _PLASTIC if plastic else "")
        if reason:
            outcomes[place] = GraphCollisionOutcome.failure(law, collision, "unrepresentable", reason)
    solved = [place for place in range(len(collisions)) if place not in outcomes]
    for group in _group_by_contacts(collisions, solved):
        W, k, e, w = group.delassus, group.stiffnesses, group.restitutions, group.rates
        c = graph_dampings(W, k, e, law)
        results = solve_timed_graphs(LAWS[law], W, k, e, w, c, frozen=frozen, max_windows=max_steps)
        for i, place in enumerate(group.places):
            outcomes[place] = _outcome_of_impulses(
                law,
                collisions[place],
                results.impulses[i].tolist(),
                status=results.status_of(i),
                reason=results.reason_texts[int(results.reason[i])],
                diagnostics={"duration": float(results.duration[i]), "n_steps": float(results.n_windows[i])},
            )
    return [outcomes[place] for place in range(len(collisions))]


class _GraphGroup(NamedTuple):
    """Collisions of one number of contacts C, as arrays of n rows."""

    places: list[int]
    """Place of each row in the sequence of all collisions."""
    delassus: Floats
    """Delassus matrices in 1/kg, shape (n, C, C)."""
    stiffnesses: Floats
    """In N/m, shape (n, C)."""
    restitutions: Floats
    """Shape (n, C)."""
    rates: Floats
    """Rates before the collision in m/s, positive where bodies approach, shape (n, C)."""


def _group_by_contacts(collisions: Sequence[GraphCollision], places: Sequence[int]) -> list[_GraphGroup]:
    """Group the collisions at `places` by their number of contacts."""
    groups: dict[int, list[int]] = {}
    for place in places:
        groups.setdefault(len(collisions[place].contacts), []).append(place)
    return [
        _GraphGroup(
            group,
            np.array([collisions[place].delassus for place in group]),
            np.array([[contact.stiffness for contact in collisions[place].contacts] for place in group]),
            np.array([[contact.restitution for contact in collisions[place].contacts] for place in group]),
            np.array([collisions[place].rates for place in group]),
        )
        for group in groups.values()
    ]


def graph_dampings(W: Floats, k: Floats, e: Floats, law: str) -> Floats:
    """Return the damping c of each contact of n graphs in N s/m, shape (n, C).

    c follows from the restitution e, the stiffness k in N/m, and the reduced mass 1/W_ii with the Delassus matrix W.
    """
    if law == "bistiffness":
        return np.zeros(k.shape)
    diagonal = np.diagonal(W, axis1=1, axis2=2)
    with np.errstate(over="ignore", under="ignore", invalid="ignore", divide="ignore"):
        return 2 * damping_ratios_of_law(law, e.ravel()).reshape(k.shape) * np.sqrt(k) / np.sqrt(diagonal)


def _outcome_of_impulses(
    solver: str,
    collision: GraphCollision,
    impulses: Sequence[float],
    *,
    status: Status,
    reason: str,
    mark: str = "",
    diagnostics: Mapping[str, float],
) -> GraphCollisionOutcome:
    """Return the outcome of a contact graph, with the velocities that impulses in N s give its bodies."""
    velocities, turning = collision.after(impulses)
    return GraphCollisionOutcome(
        solver,
        tuple(tuple(row) for row in velocities.tolist()),
        tuple(tuple(row) for row in turning.tolist()) if len(collision.inertias) else (),
        status=status,
        reason=reason,
        mark=mark,
        diagnostics=diagnostics,
    )


class ExactSolver(Solver):
    """Base class of the solvers of this project that solve whole arrays of collisions."""

    def version(self) -> str:
        """Return the version of this project."""
        return version("impact-xval")

    def solve_many(self, collisions: Sequence[Collision], settings: Settings) -> Sequence[Outcome]:
        """Solve every collision, and return the outcomes in order."""
        return solve_in_groups(collisions, lambda group: self.solve_group(group, settings))

    @abstractmethod
    def solve_group(self, collisions: Collisions, settings: Settings) -> Outcomes:
        """Solve collisions that have the same layout (`solver.group_by_layout`)."""


class ReferenceSolver(ExactSolver):
    """Solver of a contact law that is integrated over time. Its name is the name of the law.

    It ignores the settings `step_fraction`, `shortest_state` and `mapping`.
    """

    kind = "reference"

    def solve_group(self, collisions: Collisions, settings: Settings) -> Outcomes:
        """Solve collisions that have the same layout, and add marks to outcomes next to a jump."""
        if not collisions.falls_on_resting.all():
            reason = ""
            if self.name == "kelvin-voigt-anchored":
                reason = f"{self.name} is a law of two balls on a table"
            elif settings.scenario != "impact":
                reason = "scenario = 'drop': chains of N balls are solved without gravity; legal: 'impact'"
            if reason:
                return Outcomes.failures(self.name, collisions, "unrepresentable", reason)
        gravity = np.full(len(collisions), settings.gravity if settings.scenario == "drop" else 0.0)
        paths, most = settings.record_path, settings.max_steps
        outcomes = solve_by_law(collisions, self.name, gravity=gravity, paths=paths, max_steps=most)
        if not settings.mark:
            return outcomes
        law = law_at(self.name, max_steps=most)
        return outcomes.with_marks(marks.marks_of(law, self.name, collisions, outcomes, gravity))

    def solve_graphs(
        self, collisions: Sequence[GraphCollision], settings: Settings
    ) -> Sequence[GraphCollisionOutcome]:
        """Solve contact graphs, without gravity and without marks."""
        if settings.scenario != "impact":
            reason = "scenario = 'drop': contact graphs are solved without gravity; legal: 'impact'"
            return [
                GraphCollisionOutcome.failure(self.name, collision, "unrepresentable", reason)
                for collision in collisions
            ]
        return solve_graphs_by_law(collisions, self.name, max_steps=settings.max_steps)


class StateTransitionSolver(ExactSolver):
    """The state-transition model as a solver.

    Of the settings it reads the cut-off of stiffness ratios, the threshold of marks, and whether paths are recorded.
    The model has no gravity and no time step. So the scenarios `impact` and `drop` have the same outcome.

    Under the name liu-zhao-brogliato this class solves the law of Liu, Zhao and Brogliato (Proc. R. Soc. A 464:3193,
    2008) on the same diagram of states. This law also has bistiffness, energetic restitution and frozen positions. It
    differs in one point: every compression runs at the original stiffness (`pair.law`). So both laws are equal until a
    contact is compressed a second time. The status is also `closed-form` where the bodies come to rest together after
    infinitely many events.
    """

    name = law = "state-transition"
    kind = "model"

    def solve_group(self, collisions: Collisions, settings: Settings) -> Outcomes:
        """Solve collisions that have the same layout; collisions with gaps are ``unrepresentable``."""
        if collisions.gaps.any():
            reason = solving.no_positions(collisions)
            return Outcomes.failures(self.name, collisions, "unrepresentable", reason)
        outcomes = solving.solve_many(
            collisions,
            law="jia-mason-erdmann" if self.name == "state-transition" else self.name,
            stiffness_ratio_cutoff=settings.stiffness_ratio_cutoff,
            grazing_threshold=settings.grazing_threshold,
            paths=settings.record_path,
        )
        return replace(outcomes, solver=self.name)

    def solve_graphs(
        self, collisions: Sequence[GraphCollision], settings: Settings
    ) -> Sequence[GraphCollisionOutcome]:
        """Solve contact graphs by the state-transition model; the setting of the cut-off has no effect on graphs."""
        if self.name != "state-transition":
            reason = _NOT_ON_GRAPHS[self.name]
            return [
                GraphCollisionOutcome.failure(self.name, collision, "unrepresentable", reason)
                for collision in collisions
            ]
        # The compiled kernel of graphs takes a while to import, which collisions of chains would pay for nothing.
        from impact_xval.model.graph.solving import solve_graphs

        outcomes: dict[int, GraphCollisionOutcome] = {}
        for group in _group_by_contacts(collisions, range(len(collisions))):
            results = solve_graphs(
                group.delassus,
                group.stiffnesses,
                group.restitutions,
                group.rates,
                grazing_threshold=settings.grazing_threshold,
                events=False,
            )
            for place, result in zip(group.places, results, strict=True):
                outcomes[place] = _outcome_of_impulses(
                    self.name,
                    collisions[place],
                    result.impulses,
                    status=result.status,
                    reason=result.reason,
                    mark=result.mark,
                    diagnostics={"grazing_margin": result.grazing_margin, **result.diagnostics},
                )
        return [outcomes[place] for place in range(len(collisions))]
