"""The laws of `model.chain` in time, with positions, as solvers; and the model itself (docs/theory.md, section 7).

Contact i is F = max(0, k_i delta^p + c_i delta^((p - 1)/2) delta') while its bodies overlap, or one of the laws below
that have no dashpot or another one. Where p is not 1 the dashpot is that of Tsuji, Tanaka and Ishida (Powder Technology
71:239, 1992), times sqrt((p + 1)/2): in xi = delta^((p + 1)/2) it is the linear contact, u du/dxi = -2 (k xi + c u)/(M
(p + 1)), with the same e for every p, at any speed.

**compression-dashpot** is F = k_i delta^p + c_i delta^((p - 1)/2) delta' while delta' > 0, else k_i delta^p.

**hunt-crossley** is F = max(0, k delta^p (1 + a delta')), a = A(e)/u with u the largest rate of compression at first
touch, and the same A for every p (`restitution`). **bistiffness** is the model's own law in time. In a drop an end of
compression takes 1 - e2^2 of all the strain energy of contact 2, that which carries the weight included: the permanent
indentation is of the contact, whatever presses it.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import replace
from importlib.metadata import version

import numpy as np
from numpy.typing import ArrayLike

from impact_xval.compliant_baselines import marks
from impact_xval.compliant_baselines.restitution import (
    damping_ratios,
    hunt_crossley_coefficients,
    textbook_damping_ratios,
)
from impact_xval.compliant_baselines.solver import Settings, Solver, by_kind
from impact_xval.model import solving
from impact_xval.model.arrays import Floats
from impact_xval.model.chain.following import MAX_WINDOWS, ChainResult, Problem
from impact_xval.model.chain.laws import Law
from impact_xval.model.chain.power_law import TOLERANCE
from impact_xval.model.chain.record import ChainEnding
from impact_xval.model.collision import Collision
from impact_xval.model.collisions import Collisions
from impact_xval.model.outcome import Outcome
from impact_xval.model.outcomes import Outcomes
from impact_xval.model.status import Ending

#: Laws by name, as codes of the kernel.
LAWS = {
    "bistiffness": Law.STATE_TRANSITION,
    "kelvin-voigt": Law.KELVIN_VOIGT,
    "kelvin-voigt-anchored": Law.KELVIN_VOIGT,
    "kelvin-voigt-textbook": Law.KELVIN_VOIGT,
    "hunt-crossley": Law.HUNT_CROSSLEY,
    "compression-dashpot": Law.COMPRESSION_DASHPOT,
}

#: Times `TOLERANCE`, the tolerance of the second run from which the error of the first is known.
LOOSER = 100.0

_PLASTIC = (
    "a restitution is 0: no finite stiffness or damping in time makes a contact perfectly plastic; take a small "
    "positive one, or the state-transition model, which knows the limit"
)
_LIMITS = (
    "a stiffness is 0 or infinite: a contact in time needs a finite one > 0; take a large or small k2/k1, or the "
    "state-transition model, which knows the limit"
)


def solve(
    collisions: Collisions,
    law: str,
    *,
    frozen: bool = False,
    gravity: ArrayLike = 0.0,
    states: bool = True,
    paths: bool = False,
    max_steps: int = MAX_WINDOWS,
) -> Outcomes:
    """Solve collisions by one of `LAWS`, without marks.

    Where positions are frozen, as in the model, a contact that has opened returns where its bodies begin to approach;
    such collisions have no gaps. Gravity is in m/s^2, of shape (n,) or (); above 0 is a drop, of two balls on a table,
    the lower one settled (`chain.rest`). A collision is given up after `max_steps` pieces of segments.

    ``limit`` is a bistiffness whose bodies were united or brought to rest by a closed form. Outcomes are exact to
    rounding where the forces are linear; else ``velocity_error`` estimates the error of velocities in m/s, by how much
    a run at `LOOSER` times the tolerance differs. Of drops, ``first_flight`` is when gravity ended, in s, and
    ``rest_speed`` the velocity in m/s that a B2 at rest on the table still had; it and impulses count as without.
    ``duration`` is in s.
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
        velocities, fallen, more = _of_drops(collisions, g, went)
        went, diagnostics = went._replace(velocities=velocities), diagnostics | more
    k: Floats = collisions.stiffnesses
    lost = [
        Ending((~np.isfinite(k) | (k <= 0)).any(axis=1), "unrepresentable", _LIMITS),
        Ending((collisions.restitutions == 0).any(axis=1), "unrepresentable", _PLASTIC),
        Ending(went.given_up, "timeout", f"not over after {max_steps} segments"),
    ]
    return problem.outcomes(
        law, went, lost, margin=margin, diagnostics=diagnostics, fallen=fallen, paths=paths
    )


def _of_drops(
    collisions: Collisions, g: Floats, went: ChainResult
) -> tuple[Floats, Floats, dict[str, Floats]]:
    """Velocities with balls at rest at 0, what gravity has added to those of free balls (m/s), and diagnostics."""
    end, fall, falls, velocities = went.records["ending"], went.records["fall"], g > 0, went.velocities
    both_settled = end == ChainEnding.BOTH_SETTLED
    lower_settled = both_settled | (end == ChainEnding.LOWER_SETTLED)
    rests = np.column_stack([falls & both_settled, falls & lower_settled])
    speed, reduced = collisions.units[1], 1 / (1 / collisions.masses).sum(axis=1)
    with np.errstate(over="ignore", invalid="ignore"):
        stated = {
            "gravity_number": g / (speed * np.sqrt(collisions.stiffnesses[:, 0] / reduced)),
            "first_flight": np.where(fall < went.records["time"], fall, np.nan),
            "rest_speed": np.where(rests[:, 1], velocities[:, 1], np.nan),
        }
        fallen = np.where(falls, g * fall, 0.0)
    stated = {name: np.where(falls, values, np.nan) for name, values in stated.items()}
    return np.where(rests, 0.0, velocities), fallen, stated


def dampings(collisions: Collisions, law: str) -> Floats:
    """Give c or a of each contact in the units of its collision, shape (n, C); 0 of bistiffness, NaN where e is 0.

    The unit of c is sqrt(m1 k1) where contacts are linear, that of a the inverse of a velocity.
    """
    c, flat = collisions, collisions.restitutions.ravel()
    if law == "bistiffness":
        return np.where(c.restitutions > 0, 0.0, np.nan)
    if law == "hunt-crossley":
        rates = c.compression_rates
        largest = np.abs(rates).max(axis=1) / rates.max(axis=1)
        return hunt_crossley_coefficients(flat).reshape(rates.shape) * largest[:, None]
    ratios = textbook_damping_ratios if law == "kelvin-voigt-textbook" else damping_ratios
    if law == "compression-dashpot":
        flat = flat**2  # why is said in `restitution`
    with np.errstate(over="ignore", under="ignore", invalid="ignore", divide="ignore"):
        below = [np.full(len(c), np.inf)] if c.table else []
        inverse = c.masses[:, :1] / np.column_stack([c.masses, *below])
        mass = 1 / (inverse[:, 1:] + inverse[:, :-1])
        if law == "kelvin-voigt-anchored":
            mass[:, 0] = 1.0
        root = np.sqrt(c.stiffnesses / c.stiffnesses[:, :1]) * np.sqrt(mass)
        return 2 * ratios(flat).reshape(root.shape) * np.sqrt(0.5 * (c.exponent + 1)) * root


def law_at(law: str, *, frozen: bool = False, max_steps: int = MAX_WINDOWS) -> marks.Law:
    """Return what solves collisions by a law for their marks."""
    return lambda some, g: solve(some, law, frozen=frozen, gravity=g, states=False, max_steps=max_steps)


class ExactSolver(Solver):
    """A solver that answers arrays of collisions."""

    def version(self) -> str:
        """Version of this project: what is exact is its own."""
        return version("impact-xval")

    def solve_many(self, collisions: Sequence[Collision], settings: Settings) -> Sequence[Outcome]:
        """Answer every collision, in order."""
        return by_kind(collisions, lambda some: self.solve_alike(some, settings))

    @abstractmethod
    def solve_alike(self, collisions: Collisions, settings: Settings) -> Outcomes:
        """Answer collisions of one kind."""


class ReferenceSolver(ExactSolver):
    """A law in time as a solver, by the name of the law; `step_fraction`, `shortest_state`, `mapping` do not matter."""

    kind = "reference"

    def solve_alike(self, collisions: Collisions, settings: Settings) -> Outcomes:
        """Answer collisions of one kind."""
        if not collisions.falls_on_resting.all():
            reason = ""
            if self.name == "kelvin-voigt-anchored":
                reason = f"{self.name} is a law of two balls on a table"
            elif settings.scenario != "impact":
                reason = "scenario = 'drop': columns of N balls are solved without gravity; legal: 'impact'"
            if reason:
                return Outcomes.failures(self.name, collisions, "unrepresentable", reason)
        gravity = np.full(len(collisions), settings.gravity if settings.scenario == "drop" else 0.0)
        paths, most = settings.record_path, settings.max_steps
        outcomes = solve(collisions, self.name, gravity=gravity, paths=paths, max_steps=most)
        if not settings.mark:
            return outcomes
        law = law_at(self.name, max_steps=most)
        return outcomes.with_marks(marks.marks_of(law, self.name, collisions, outcomes, gravity))


class StateTransitionSolver(ExactSolver):
    """The state-transition model; of the settings it knows the cut-off, the threshold of marks and the path only.

    It has no gravity and no step: `impact` and `drop` are the same collision to it. Under the name of their law it is
    that of Liu, Zhao and Brogliato (Proc. R. Soc. A 464:3193, 2008) on the same diagram: bistiffness with energetic
    restitution, positions frozen, as in the primary model; but every compression runs at the original stiffness
    (`pair.law`). It equals the primary model exactly until a contact compresses a second time, and is `limit` also
    where the bodies come to rest together after infinitely many events.
    """

    name = law = "state-transition"
    kind = "model"

    def solve_alike(self, collisions: Collisions, settings: Settings) -> Outcomes:
        """Answer collisions of one kind; gaps are ``unrepresentable``."""
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
