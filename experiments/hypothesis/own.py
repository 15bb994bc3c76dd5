"""Test of a user's own collision, which shows by each law whether the bodies of its stiffest contact move as one.

The contrast is the stiffness of the stiffest contact over the largest stiffness of the other contacts. In the *welded*
collision the two bodies of the stiffest contact are one body with the mass and the momentum of both, or part of the
table (`chains.weld_contact`). Each law solves three things: the welded collision, the user's collision, and the user's
collision at rising contrasts. At rising contrasts only the stiffest contact changes. D measures how far the final
velocities are from those of the welded collision. It is the kinetic norm of the difference, over the kinetic norm of
the velocities at first touch. The outcomes at rising contrasts are judged by the rule of a test of the hypothesis
(`judging`). The command `impact-xval hypothesis` calls this module.

"The same contacts" has two meanings for a law with dashpots: the contacts of the welded collision keep their e, or they
keep their damping in N s/m (`keep_dashpots`). A law with dashpots gets a verdict for each meaning, if the meanings give
different collisions.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd
from pydantic import Field

from impact_xval.compliant_baselines import get_solver
from impact_xval.compliant_baselines.engines.scene import reduced_masses
from impact_xval.compliant_baselines.references import damping_ratios_of_law
from impact_xval.compliant_baselines.restitution import restitution, textbook_restitution
from impact_xval.compliant_baselines.solver import Settings
from impact_xval.experiments.config.axes import Strict
from impact_xval.experiments.config.errors import UserError, read_toml, validate
from impact_xval.experiments.hypothesis.chains import (
    ERROR,
    SOLVERS,
    stiffen_contact,
    velocities_of_balls,
    weld_contact,
)
from impact_xval.experiments.hypothesis.config import spaced_contrasts
from impact_xval.experiments.hypothesis.judging import (
    CLOSE,
    Approach,
    Verdict,
    judge_approach,
    kinetic_distance,
    mark_usable,
)
from impact_xval.experiments.presentation.document import Block, Table
from impact_xval.experiments.presentation.words import display_name
from impact_xval.experiments.tables.numbers import number
from impact_xval.model.arrays import Floats
from impact_xval.model.collision import MAX_BALLS, Collision
from impact_xval.model.outcome import Outcome
from impact_xval.model.status import RESULT_STATUSES

#: Laws that solve a collision of two balls on a table, in addition to the laws of chains.
OF_PAIRS = (
    "liu-zhao-brogliato",
    "kelvin-voigt-anchored",
    "compression-dashpot",
    "linear-dashpot",
    "hunt-crossley",
)

#: Laws that only two balls on a table have, each with the law that replaces it in the welded collision. The replacement
#: is needed because the welded collision has a single ball.
_WELDED_BY = {"kelvin-voigt-anchored": "kelvin-voigt"}

#: Laws whose contacts have a linear dashpot for the reduced mass of their two bodies, each with the restitution that a
#: damping ratio gives: the inverse of `references.damping_ratios_of_law`.
_DASHPOTS: dict[str, Callable[[float], float]] = {
    "kelvin-voigt": restitution,
    "kelvin-voigt-textbook": textbook_restitution,
    "compression-dashpot": lambda zeta: math.sqrt(restitution(zeta)),
    "linear-dashpot": textbook_restitution,
}

#: Contrasts of the series of collisions that a verdict is based on. They rise from `_FROM` to the largest of three
#: numbers: `_TO`, a hundred times the contrast of the user's collision, and `_BEYOND` times the contrast of
#: `_overtaking_contrast`. They never exceed `_MOST`, which is also the limit in a test of the hypothesis. `_PER_DECADE`
#: is the number of contrasts in a decade. `_DECADES` is the number of decades that a verdict is based on.
_FROM, _TO, _BEYOND, _MOST = 10.0, 1e6, 1e5, 1e10
_PER_DECADE, _DECADES = 4, 3.0

#: Multiples of the contrast of the user's collision at which D is shown.
MULTIPLES = (1.0, 10.0, 100.0, 1000.0)

#: Settings of all solvers. The cut-off of the stiffness ratio is infinite. Beyond a finite cut-off the model would use
#: the closed form that the test is about. Many steps are allowed, because a stiff contact may open and close very
#: often.
_SETTINGS = Settings(stiffness_ratio_cutoff=math.inf, max_steps=50_000_000, mark=False)

#: Key of a TOML file. A file with this key holds a collision, and not the configuration of a test of the hypothesis.
MARK = "masses"


class OwnCollision(Strict):
    """Collision that a user gives in a TOML file: balls in a line, from the top down, and their contacts."""

    masses: list[float] = Field(min_length=2, max_length=MAX_BALLS, description="a list of numbers > 0 (kg)")
    stiffnesses: list[float] = Field(
        description="a list of numbers > 0 (N/m), one a contact, the table's last"
    )
    restitutions: list[float] | float = Field(
        0.9, description="a number from 0 to 1, or a list, one a contact"
    )
    velocities: list[float] | None = Field(
        None, description="a list of numbers (m/s, up is positive), one a ball; by default the first has -1"
    )
    table: bool | None = Field(
        None, description="true or false; by default true with as many contacts as balls"
    )
    stiff: int | None = Field(
        None, description="the number of the stiff contact, from 1; by default the stiffest"
    )

    def collision(self) -> Collision:
        """Return the collision. If it is illegal, a ValueError says what is illegal."""
        contacts, balls = len(self.stiffnesses), len(self.masses)
        table = contacts == balls if self.table is None else self.table
        e = self.restitutions
        return Collision(
            masses=tuple(self.masses),
            stiffnesses=tuple(self.stiffnesses),
            restitutions=tuple(e) if isinstance(e, list) else (e,) * contacts,
            velocities=tuple(self.velocities or [-1.0, *[0.0] * (balls - 1)]),
            table=table,
        )


def load_own_collision(path: Path) -> tuple[Collision, int | None] | None:
    """Return the collision in a TOML file and the index of its stiff contact.

    The index is None if the file names no stiff contact. In that case the stiffest contact is taken.

    The result is None if the file holds the configuration of a test of the hypothesis instead.
    """
    data = read_toml(path)
    if MARK not in data:
        return None
    own = validate(OwnCollision, data, str(path))
    try:
        collision = own.collision()
    except ValueError as error:
        raise UserError(f"{path}: {error}") from None
    contacts = len(collision.stiffnesses)
    if own.stiff is not None and not 1 <= own.stiff <= contacts:
        raise UserError(f"{path}: stiff = {own.stiff}; legal: a whole number from 1 to {contacts}")
    return collision, None if own.stiff is None else own.stiff - 1


class OneBodyVerdict(NamedTuple):
    """Result of one law on whether the bodies of the stiff contact of a collision move as one."""

    solver: str
    #: Whether the contacts of the welded collision keep their dashpots, and not their e.
    keeps_dashpots: bool
    #: Reason why there is no verdict. Either the law has no result for the user's collision or the welded collision, or
    #: its outcomes at rising contrasts allow no verdict.
    reason: str
    #: Distance D from the welded collision, at `MULTIPLES` of the contrast of the user's collision; NaN without a
    #: result.
    distances: tuple[float, ...]
    #: Verdict by the rule of a test of the hypothesis: ``supported``, ``refuted``, ``no limit`` or ``undecided``.
    verdict: str
    rate: float
    offset: float

    @property
    def name(self) -> str:
        """Name of the law for readers, with the meaning of "the same contacts" if it is not "the same e"."""
        return display_name(self.solver) + (", dashpots kept" if self.keeps_dashpots else "")

    @property
    def as_one(self) -> str:
        """Whether the two bodies move as one in the user's collision: ``yes``, ``no``, or ``-`` for unknown."""
        if math.isnan(self.distances[0]):
            return "-"
        return "yes" if self.distances[0] <= CLOSE else "no"

    @property
    def trend(self) -> str:
        """Text that says how D, the distance from the welded collision, changes as the contrast grows."""
        match self.verdict:
            case "supported":
                return f"D falls as contrast^-{self.rate:.2f}: one body in the limiting case"
            case "refuted":
                return f"D goes to {number(self.offset, 2)}: not one body in the limiting case"
            case "no limit":
                return f"no limit: {self.reason}"
            case _:
                pass
        return "-" if self.as_one == "-" else f"undecided: {self.reason}"


class OwnPair(NamedTuple):
    """Results of all laws on whether the bodies of the stiff contact of a user's collision move as one."""

    collision: Collision
    #: Index of the stiff contact, from 0; and the contrast, which is the stiffness of this contact over the largest
    #: stiffness of the other contacts.
    contact: int
    contrast: float
    laws: list[OneBodyVerdict]

    @property
    def bodies(self) -> str:
        """Names of the two bodies of the stiff contact, such as ``ball 2 and the table``."""
        upper = f"ball {self.contact + 1}"
        below = "the table" if self.contact == len(self.collision.masses) - 1 else f"ball {self.contact + 2}"
        return f"{upper} and {below}"

    @property
    def meets(self) -> bool:
        """Whether the two bodies of the stiff contact approach each other when the collision begins."""
        return bool(self.collision.compression_rates[self.contact] > 0)


def judge_own_pair(collision: Collision, stiff: int | None = None) -> OwnPair:
    """For each law, return whether the two bodies of the stiff contact of a collision move as one.

    `stiff` is the index of the stiff contact, from 0; by default the stiffest contact is taken. The collision needs at
    least two contacts. All contacts have to be linear and without gaps, and the stiff contact has to be stiffer than
    all others, by a factor of at most `_MOST`. Otherwise a `UserError` is raised.
    """
    k: Floats = np.array(collision.stiffnesses)
    contact = int(np.argmax(k)) if stiff is None else stiff
    others = np.delete(k, contact)
    if not others.size:
        raise UserError(
            "a collision with one contact: with its two bodies welded nothing is left to collide; "
            "legal: two contacts or more"
        )
    with np.errstate(divide="ignore", invalid="ignore"):
        contrast = float(k[contact] / others.max())
    if not 1 < contrast <= _MOST:
        legal = f"a contact more than 1 and at most {_MOST:g} times as stiff as all others"
        raise UserError(
            f"contact {contact + 1}: its stiffness over the largest of the others is {contrast:.6g}; legal: {legal}"
        )
    if collision.exponent != 1 or any(collision.gaps):
        raise UserError(
            "exponent or gap: the hypothesis is tested on linear contacts that touch; legal: no exponent, no gap"
        )
    try:
        weld_contact(collision, contact)
    except ValueError as error:
        raise UserError(f"contact {contact + 1}, with its two bodies welded: {error}") from None
    solvers = (*SOLVERS, *OF_PAIRS) if collision.falls_on_resting else SOLVERS
    laws = [verdict for name in solvers for verdict in _judge_law(name, collision, contact, contrast)]
    return OwnPair(collision, contact, contrast, laws)


def keep_dashpots(law: str, collision: Collision, contact: int) -> Collision:
    """Return the welded collision with the damping (N s/m) that its contacts have before welding.

    The damping of a contact in N s/m is 2 zeta sqrt(k M) with the reduced mass M of its two bodies. Welding changes M.
    So the damping ratio zeta is multiplied by sqrt(M before/M after), and e follows from zeta.

    Parameters
    ----------
    law
        Law of the contacts, one of those with a linear dashpot (`_DASHPOTS`).
    collision
        Collision before welding, with restitutions in (0, 1].
    contact
        Index of the contact whose two bodies are welded, from 0.
    """
    welded = weld_contact(collision, contact)
    before = np.delete(reduced_masses(collision), contact)
    changes = np.sqrt(before / np.array(reduced_masses(welded)))
    ratios = damping_ratios_of_law(law, np.array(welded.restitutions))
    kept = (
        # A contact that does not touch the welded body keeps its e to the bit.
        e if change == 1 else _DASHPOTS[law](ratio * change)
        for e, ratio, change in zip(welded.restitutions, ratios.tolist(), changes.tolist(), strict=True)
    )
    return dataclasses.replace(welded, restitutions=tuple(kept))


def _overtaking_contrast(law: str, collision: Collision, contact: int) -> float:
    """Return the contrast above which the stiff contact is quicker than the damping of all contacts; 0 without damping.

    A dashpot stops its bodies in the time M/c = 1/(2 zeta omega) with omega^2 = k/M. A stiffer contact acts as an
    infinitely stiff one only if it is much quicker, at contrasts far above (2 zeta)^2 times the ratio of the reduced
    masses. Below this contrast D is nearly constant, because the stiff contact has no time to act: the impact is one on
    a free body. So a constant D there is no sign of a limit. A Hunt-Crossley contact stops its bodies in the time
    sqrt(2/A)/omega, and A < 1/e (`compliant_baselines.restitution`). So 1/e takes the place of (2 zeta)^2.
    """
    if law in _DASHPOTS or law in _WELDED_BY:
        ratios = damping_ratios_of_law(_WELDED_BY.get(law, law), np.array(collision.restitutions))
        strongest = float(4 * ratios.max() ** 2)
    elif law == "hunt-crossley":
        strongest = 1 / min(collision.restitutions)
    else:
        return 0.0
    masses = reduced_masses(collision)
    return strongest * masses[contact] / min(np.delete(masses, contact))


def _judge_law(name: str, collision: Collision, contact: int, contrast: float) -> Iterator[OneBodyVerdict]:
    """Yield the verdict of one law with the same e, and one with kept dashpots if these give another welded collision.

    The law solves the welded collisions, the collision at multiples of its contrast, and the collision at the rising
    contrasts on which a verdict is based.
    """
    solver = get_solver(name)
    (own,) = solver.solve_many([collision], _SETTINGS)
    if own.status not in RESULT_STATUSES:
        yield OneBodyVerdict(name, False, *_without_distance(own))
        return
    multiples = [x for x in MULTIPLES if x * contrast <= _MOST]
    needed = _BEYOND * _overtaking_contrast(name, collision, contact)
    series = spaced_contrasts((_FROM, min(_MOST, max(_TO, 100 * contrast, needed))), _PER_DECADE)
    stiffer = [*multiples[1:], *(x / contrast for x in series)]
    outcomes = [own, *solver.solve_many([stiffen_contact(collision, contact, x) for x in stiffer], _SETTINGS)]
    welded = [weld_contact(collision, contact)]
    if name in _DASHPOTS:
        kept = keep_dashpots(name, collision, contact)
        welded += [kept] if kept.restitutions != welded[0].restitutions else []
    of_welded = get_solver(_WELDED_BY.get(name, name)).solve_many(welded, _SETTINGS)
    for as_one, keeps_dashpots in zip(of_welded, (False, True), strict=False):
        verdict = OneBodyVerdict(
            name, keeps_dashpots, *_compare_with_welded(collision, contact, outcomes, as_one, series)
        )
        if needed > _MOST:
            reason = (
                f"damping this strong needs contrasts up to {needed:.2g}; the largest one solved is {_MOST:g}"
            )
            verdict = verdict._replace(verdict="undecided", reason=reason)
        yield verdict


def _without_distance(outcome: Outcome) -> tuple[str, tuple[float, ...], str, float, float]:
    """Return the fields of a verdict from `reason` on, where an outcome without a result gives no D."""
    return (
        f"{outcome.status}: {outcome.reason}",
        (math.nan,) * len(MULTIPLES),
        "undecided",
        math.nan,
        math.nan,
    )


def _compare_with_welded(
    collision: Collision, contact: int, outcomes: Sequence[Outcome], as_one: Outcome, series: Sequence[float]
) -> tuple[str, tuple[float, ...], str, float, float]:
    """Return the fields of a verdict from `reason` on.

    Parameters
    ----------
    collision, contact
        The user's collision, and the index of its stiff contact.
    outcomes
        Outcomes at multiples of the contrast of the user's collision, the first of which has a result, then those at
        the contrasts in `series`.
    as_one
        Outcome of the welded collision.
    """
    if as_one.status not in RESULT_STATUSES:
        return _without_distance(as_one)
    weights = np.array(collision.masses) / np.dot(collision.masses, np.square(collision.velocities))
    form = velocities_of_balls(as_one.velocities, contact)
    differences = np.array([outcome.velocities for outcome in outcomes]) - form
    solved = np.array([outcome.status in RESULT_STATUSES for outcome in outcomes])
    distances = np.where(solved, kinetic_distance(weights, differences), math.nan)
    at_multiples = distances[: -len(series)].tolist()
    at_multiples += [math.nan] * (len(MULTIPLES) - len(at_multiples))
    verdict = _judge_series(outcomes[-len(series) :], distances[-len(series) :], series, weights, form)
    why = verdict.reason.replace("the closed form", "the welded collision")
    return why, tuple(at_multiples), verdict.verdict, verdict.rate, verdict.offset


def _judge_series(
    outcomes: Sequence[Outcome],
    distances: Floats,
    contrasts: Sequence[float],
    weights: Floats,
    form: tuple[float, ...],
) -> Verdict:
    """Return the verdict on a law's outcomes at rising contrasts, by the rule of a test of the hypothesis."""
    # An outcome without a grazing margin gets NaN.
    margins = np.array([outcome.grazing_margin for outcome in outcomes], float)
    rows = pd.DataFrame({"contrast": contrasts, "distance": distances, "grazing_margin": margins})
    rows = mark_usable(rows, np.sqrt(rows.contrast))
    return judge_approach(
        Approach(
            contrast=rows.contrast.to_numpy(),
            used=rows.used.to_numpy(),
            velocities=np.array([outcome.velocities for outcome in outcomes]),
            error=np.full(len(rows), ERROR),
            closed_form=np.array(form),
            weights=weights,
            decades=_DECADES,
        )
    )


def _verdict_table(own: OwnPair, laws: Sequence[OneBodyVerdict], first: str) -> Table:
    """Return the table of the verdicts of laws; `first` is the header of the column with the laws."""
    contrasts = [number(x * own.contrast) for x in MULTIPLES]
    header = [first, "as one body", f"D at {contrasts[0]} (yours)", *(f"D at {x}" for x in contrasts[1:])]
    rows = [
        (display_name(law.solver), law.as_one, *(number(d, 2) for d in law.distances), law.trend)
        for law in laws
    ]
    return Table([*header, "as the contrast grows"], rows, text=2)


def own_pair_blocks(own: OwnPair) -> Iterator[Block]:
    """Yield what the command prints about a user's collision: tables with one row per law, and their explanation."""
    masses, place = own.collision.masses, own.contact
    at_table = place == len(masses) - 1
    united = (
        f"ball {place + 1} is part of the table"
        if at_table
        else f"they are one body of {number(sum(masses[place : place + 2]), 6)} kg, with the momentum of both"
    )
    first = "meet with different velocities" if own.meets else "have one velocity at the start"
    yield (
        f"Contact {place + 1}, between {own.bodies}, is {number(own.contrast, 6)} times as stiff as any other; its "
        f"bodies {first}. Welded, {united}."
    )
    yield _verdict_table(own, [law for law in own.laws if not law.keeps_dashpots], "law")
    highest = number(max(_TO, min(_MOST, 100 * own.contrast)))
    yield (
        "D: difference from the same collision with the pair welded, by the same law. It is the kinetic norm "
        "of the difference of final velocities, over the kinetic norm of the velocities at first touch. The "
        "other contacts keep their e, so a law with dashpots computes them anew for the welded body. "
        f"As one body: whether D is at most {CLOSE:g} at your contrast. As the contrast "
        f"grows: where D goes as only this contact becomes stiffer, up to a contrast of {highest}, or further if "
        "strong damping needs it (an e below about 0.1)."
    )
    if kept := [law for law in own.laws if law.keeps_dashpots]:
        yield _verdict_table(own, kept, "law, dashpots kept")
        yield (
            "Dashpots kept: in the welded collision the other contacts keep their damping (N s/m), as contacts of an "
            "engine do, and so have another e (docs/hypothesis.md)."
        )
    if own.meets:
        yield (
            "The bodies of the stiff contact collide with each other first, and restitution parts them. The hypothesis "
            "of the supplement is about what follows once they have one velocity (docs/hypothesis.md)."
        )
    for law in own.laws:
        if law.as_one == "-":
            yield f"{law.name}: {law.reason}"
