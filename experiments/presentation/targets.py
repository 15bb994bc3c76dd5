"""Text and tables about a contact for an engine: the text to paste, what the engine reads, and results of drops.

The functions here need a pair of bodies and targets. A target is a way to write a contact for an engine. The command
`contact` calls them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Protocol

from impact_xval.compliant_baselines.engines.engine import version_of
from impact_xval.compliant_baselines.mapping import KelvinVoigtContact
from impact_xval.compliant_baselines.solver import SolverError
from impact_xval.compliant_baselines.target_drops import PLACES, drop_target, missing_distribution
from impact_xval.compliant_baselines.targets import ContactRequest, Target
from impact_xval.experiments.presentation.contacts import round_outward
from impact_xval.experiments.presentation.document import Block, Table

#: Number of time steps in the duration of a contact if no step is given. The step that follows is then rounded.
DEFAULT_STEPS = 200

#: Explanations of the contact laws of engines, by `Target.law`.
LAWS = {
    "pushes": "F = max(0, k d + c d') at a depth d; the contact may push but not pull",
    "pulls": "F = k d + c d' at a depth d; the contact may pull",
    "compression": "F = k d + c max(0, d') at a depth d; the dashpot acts in compression only",
    "depth": "the damping is in proportion to the depth, and gives e at the speed of the impact",
    "rigid": "a coefficient of restitution; stiffness and duration are not used",
}


class ContactOfTwo(Protocol):
    """Two bodies and the contact between them, such as `single_contact.SingleImpact`."""

    @property
    def masses(self) -> tuple[float, float]:
        """Masses in kg. One mass may be infinite."""
        ...

    @property
    def contact(self) -> KelvinVoigtContact:
        """The contact that the user requests."""
        ...

    @property
    def speed(self) -> float:
        """Speed of approach in m/s."""
        ...


def request_contact(pair: ContactOfTwo, step: float | None = None) -> ContactRequest:
    """Return the request for the contact of a pair at a time step in s.

    The default step is a 200th of the duration of the contact, rounded down to one digit.
    """
    light, heavy = sorted(pair.masses)
    e = float(f"{pair.contact.restitution:.12g}")
    if step is None:
        step = _round_down(pair.contact.duration / DEFAULT_STEPS)
    return ContactRequest(pair.contact, (light, heavy), e, step, pair.speed)


def _round_down(value: float) -> float:
    """Return the largest number with one significant digit that does not exceed a value."""
    exponent = math.floor(math.log10(value))
    # A multiple of the power of ten keeps its value, although rounding may change the quotient by less than a
    # thousandth.
    return float(f"{math.floor(value / 10.0**exponent + 1e-3)}e{exponent}")


def describe_target(target: Target, pair: ContactOfTwo, step: float | None = None) -> list[Block]:
    """Return the text to paste for a contact, the numbers that the engine reads in this text, and results of drops.

    Parameters
    ----------
    target
        One of `targets.targets_for`.
    pair
        Two bodies and the contact between them.
    step
        Time step in s; by default a 200th of the contact's duration, rounded down to one digit.

    Returns
    -------
    list of Block
        Paragraphs and tables for a terminal or a page.

    Raises
    ------
    SolverError
        If the engine cannot represent the contact.
    """
    request = request_contact(pair, step)
    facts = [
        f"what the engine reads: {target.reads}",
        f"law: {LAWS[target.law]}",
        f"numbers of two bodies: {target.combines}",
        f"speed below which nothing rebounds: {target.threshold}",
        *target.notes,
        *(f"source of {source}" for source in target.sources),
    ]
    rebound = request.restitution * request.speed
    if 0 < rebound <= target.dropped_rebound:
        facts.append(
            f"At {request.speed:.6g} m/s this contact would rebound at {rebound:.3g} m/s, but {target.title} gives no "
            f"rebound of {target.dropped_rebound:g} m/s or less."
        )
    return [
        f"{target.title} (--engine {target.name})",
        f"\n{target.text(request).rstrip()}\n",
        *(fact.replace("`", "") for fact in facts),
        *_describe_drops(target, request),
    ]


def describe_targets(targets: Sequence[Target], pair: ContactOfTwo, step: float | None = None) -> list[Block]:
    """Return the blocks of several targets, one target after the other.

    If a target cannot represent the contact, its block says why.

    Raises
    ------
    SolverError
        If no target can represent the contact.
    """
    c = pair.contact
    blocks: list[Block] = []
    if any(target.kind == "compliant" for target in targets):
        blocks.append(
            f"k = {c.k:.6g} N/m, e = {c.restitution:.6g}, reduced mass {c.mass:.6g} kg. A contact that can only push "
            f"has this e with c = {c.c:.6g} N s/m, and lasts {c.duration:.6g} s."
        )
    refusals: list[SolverError] = []
    for target in targets:
        try:
            blocks += [*([""] if blocks else []), *describe_target(target, pair, step)]
        except SolverError as error:
            refusals.append(error)
            blocks.append(f"{target.name}: {error.status}: {error.reason}")
    if len(refusals) == len(targets):
        raise refusals[0]
    return blocks


def _describe_drops(target: Target, request: ContactRequest) -> list[Block]:
    """Return the table of requested and measured numbers, or a line that says why nothing was measured."""
    missing = missing_distribution(target)
    if missing is not None:
        return [f"not verified here: {missing}"]
    try:
        given = drop_target(target, request)
    except SolverError as error:
        return [
            f"not verified here, because a drop with this text in {target.title} gave no rebound: {error.reason}"
        ]
    rows = [("restitution", f"{request.restitution:.6g}", _describe_range(*given.restitution))]
    if target.kind == "compliant":
        exact = target.duration(request)
        asked = f"{request.contact.duration:.6g} s"
        by_law = (
            ""
            if exact is None or math.isclose(exact, request.contact.duration)
            else f"{exact:.6g} s by its law"
        )
        rows.append(("duration", by_law or asked, f"{_describe_range(*given.duration)} s"))
    version = version_of(target.distributions[0])
    caption = (
        f"Drops with this text alone in {target.distributions[0]} {version}: a step of {request.step:.6g} s, "
        f"{request.speed:.6g} m/s, and {len(PLACES)} instants of first touch within a step"
    )
    return [Table(("", "requested", "measured"), rows, caption)]


def _describe_range(low: float, high: float) -> str:
    """Return an interval as text, or one number of six digits if both ends round to it."""
    ends = {f"{end:.6g}" for end in (low, high)}
    return ends.pop() if len(ends) == 1 else round_outward(low, high)
