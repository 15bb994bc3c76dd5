"""Proposals of what to write in a MuJoCo scene for the contact that was probably meant."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from impact_xval.compliant_baselines.inspect_mujoco.drops import MeasuredContact, measure_contact
from impact_xval.compliant_baselines.inspect_mujoco.scene_contacts import Bodies
from impact_xval.compliant_baselines.inspect_mujoco.traps import FORCE_LEVEL
from impact_xval.compliant_baselines.mapping import KelvinVoigtContact, MujocoContact, mujoco_contact

#: How far the restitution of a contact may be from what was meant.
NEAR_E = 0.02

#: How far its stiffness may be, relatively.
NEAR_K = 0.05

#: Restitution of a contact that is not to rebound: no finite damping gives 0.
NO_REBOUND = 0.01

#: Time constant over the longest step at which refsafe leaves it as it is (2), with some room.
_REFSAFE_STEPS = 2.2


class Proposal(NamedTuple):
    """A change of a contact to what was probably meant; empty texts if nothing is to be said."""

    #: What to write, and what that was measured to give.
    change: str = ""
    #: Why the proposal does not give what was meant.
    unkept: str = ""


class _Meaning(NamedTuple):
    """The contact that was probably meant, and how to write it."""

    contact: KelvinVoigtContact
    pair: MujocoContact
    #: In words.
    text: str
    #: Longest step in s at which the engine takes the pair as it is written.
    longest_step: float
    #: Whether a stiffness was meant, or only a restitution.
    has_stiffness: bool


def propose_change(bodies: Bodies, option: Any, speed: float, measured: MeasuredContact) -> Proposal:
    """Propose what to write for what was probably meant; nothing if the contact is near it.

    Where only the solver's tolerance is in the way, the proposal contains a tolerance of 0.
    """
    meaning = _meaning_of(bodies)
    if meaning is None:
        return Proposal()
    meant = meaning.contact
    off = max(abs(e - meant.restitution) for e in measured.restitution_range or ())
    stiffness_off = meaning.has_stiffness and (
        measured.stiffness is None or abs(measured.stiffness / meant.k - 1) > NEAR_K
    )
    if off <= NEAR_E and not stiffness_off:
        return Proposal()
    step = min(option.timestep, float(f"{min(meant.duration / 100, meaning.longest_step):.2g}"))
    solref, solimp = meaning.pair
    proposed = bodies._replace(pair=(("solref", solref), ("solimp", solimp), ("dim", 1)))
    paste = f'<pair condim="1" solref="{_format(solref)}" solimp="{_format(solimp)}"/>'
    gives, kept = "", False
    for exact in (False, True):
        try:
            row = measure_contact(proposed, option, step, speed, exact=exact)
        except RuntimeError as error:
            gives = f"was not measured: {error}"
            continue
        k = math.nan if row.stiffness is None else row.stiffness
        off = max(abs(e - meant.restitution) for e in row.restitution_range or (math.inf,))
        right_stiffness = not meaning.has_stiffness or abs(k / meant.k - 1) <= NEAR_K
        kept = off <= NEAR_E and right_stiffness
        gives = f"gives e = {row.restitution:.3g} and {k:.4g} N/m"
        if kept:
            if exact:
                paste += ' with <option tolerance="0"/>'
            break
    change = f"for {meaning.text}: {paste} and a step of {step:g} s, which {gives}"
    if kept:
        return Proposal(change)
    unkept = f"the pair proposed {gives}, not {meaning.text} (e = {meant.restitution:.3g})"
    return Proposal(change, unkept)


def _meaning_of(bodies: Bodies) -> _Meaning | None:
    """Guess the contact that was meant; None if the solref says nothing.

    A direct solref was meant in N/m and N s/m, unless it is at the level of forces. A damping ratio was meant as in
    textbooks, whose contact may pull, and has no rebound from a ratio of 1 on.
    """
    solref, solimp = bodies.solref, bodies.solimp
    first, second = map(abs, solref)
    if solref[0] < 0:
        is_at_force_level = solimp[0] <= FORCE_LEVEL and solref[1] <= 0
        unit = bodies.scale if is_at_force_level else 1.0
        meant = KelvinVoigtContact(first * unit, second * unit, bodies.mass)
        pair = mujoco_contact(meant._replace(mass=bodies.scale))
        text = f"{meant.k:.4g} N/m and {meant.c:.4g} N s/m"
        return _Meaning(meant, pair, text, longest_step=math.inf, has_stiffness=True)
    if not (first and second):
        return None
    e = math.exp(-math.pi * second / math.sqrt(1 - second**2)) if second < 1 else 0.0
    stiffness = bodies.mass / (first * second) ** 2
    meant = KelvinVoigtContact.from_restitution(stiffness, max(e, NO_REBOUND), bodies.mass)
    pair = MujocoContact(mujoco_contact(meant, "documented").solref, solimp)
    text = f"e = {e:.2g}" if e > NO_REBOUND else f"no rebound (e = {NO_REBOUND})"
    return _Meaning(meant, pair, text, pair.solref[0] / _REFSAFE_STEPS, has_stiffness=False)


def _format(numbers: tuple[float, ...]) -> str:
    """Format numbers as MJCF has them."""
    return " ".join(f"{number:.6g}" for number in numbers)
