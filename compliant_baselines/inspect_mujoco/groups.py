"""Groups of contacts that have the same parameters, and the contacts that are measured for each group."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

from impact_xval.compliant_baselines.inspect_mujoco.scene_contacts import Bodies, SceneContact

#: Most contacts that are measured for a group.
MOST_MEASURED = 4


class ContactGroup(NamedTuple):
    """Contacts whose parameters are the same; masses, joints and friction may differ."""

    contacts: list[SceneContact]

    @property
    def names(self) -> list[str]:
        """Names of the contacts."""
        return [contact.name for contact in self.contacts]

    @property
    def members(self) -> dict[Bodies, list[str]]:
        """Names of the contacts by their bodies; contacts that are alike in everything have one entry."""
        members: dict[Bodies, list[str]] = {}
        for contact in self.contacts:
            members.setdefault(contact.bodies, []).append(contact.name)
        return members


def group_contacts(contacts: Sequence[SceneContact]) -> list[ContactGroup]:
    """Group contacts by their parameters, in the order in which the parameters first occur."""
    groups: dict[object, ContactGroup] = {}
    for contact in contacts:
        groups.setdefault(contact.bodies.parameters, ContactGroup([])).contacts.append(contact)
    return list(groups.values())


def choose_members(group: ContactGroup) -> list[Bodies]:
    """Choose the members of a group to measure: those with extreme values of the quantities that matter.

    They are the lightest and the heaviest pair; the pair whose mass is farthest from the engine's inverse weights (both
    agree for free bodies); the light body that is solved together with most inertia, where the solver's tolerance
    matters most; and the body that rests on most points.
    """
    members = list(group.members)
    chosen = [
        min(members, key=lambda bodies: bodies.mass),
        max(members, key=lambda bodies: bodies.mass),
        max(members, key=lambda bodies: abs(math.log(bodies.mass / bodies.scale))),
        max(members, key=lambda bodies: bodies.inertia / bodies.masses[0]),
        max(members, key=lambda bodies: bodies.points),
        *(bodies for bodies in members if any(losses.damping or losses.friction for losses in bodies.losses)),
    ]
    return list(dict.fromkeys(chosen))[:MOST_MEASURED]
