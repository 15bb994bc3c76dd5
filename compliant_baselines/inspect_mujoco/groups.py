"""Groups of contacts with the same parameters, and the choice of contacts that are measured for each group."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

from impact_xval.compliant_baselines.inspect_mujoco.scene_contacts import Bodies, SceneContact

#: Largest number of contacts that are measured for a group.
MOST_MEASURED = 4


class ContactGroup(NamedTuple):
    """Contacts with the same parameters; their masses, joints and friction may differ."""

    contacts: list[SceneContact]

    @property
    def names(self) -> list[str]:
        """Names of the contacts."""
        return [contact.name for contact in self.contacts]

    @property
    def members(self) -> dict[Bodies, list[str]]:
        """Names of the contacts, by their bodies and parameters.

        Contacts in which all of these are equal have one entry.
        """
        members: dict[Bodies, list[str]] = {}
        for contact in self.contacts:
            members.setdefault(contact.bodies, []).append(contact.name)
        return members


def group_contacts(contacts: Sequence[SceneContact]) -> list[ContactGroup]:
    """Group contacts by their parameters; groups are in the order in which the parameters first occur."""
    groups: dict[object, ContactGroup] = {}
    for contact in contacts:
        groups.setdefault(contact.bodies.parameters, ContactGroup([])).contacts.append(contact)
    return list(groups.values())


def choose_members(group: ContactGroup) -> list[Bodies]:
    """Choose the contacts of a group that are measured: those with extreme values of the quantities that matter.

    At most `MOST_MEASURED` contacts are chosen, in this order. First come the lightest and the heaviest pair of bodies.
    Then comes the pair whose reduced mass differs most from the mass by the engine's inverse weights; for free bodies
    both are the same. Then comes the pair in which a light body is solved together with the most inertia, because there
    the solver's tolerance matters most. Last come the body that rests on most points, and bodies that joints slow down.
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
