"""The contacts of a MuJoCo scene: traps in their parameters, and measurements of their behaviour (docs/mapping.md).

A trap is a documented rule of the engine by which a contact behaves otherwise than its parameters suggest (XML
reference, "Solver parameters" and the options; changelog of 3.13). For each trap a test measures its effect.

* `scene_contacts` reads the contacts of a compiled scene, and the two bodies of each contact.
* `drops` measures a contact in a separate scene of two bodies.
* `traps` finds traps in parameters.
* `groups` gathers contacts with the same parameters, and chooses the contacts to measure.
* `readings` proposes parameters for the contact that a user may have meant.
* `examination` combines all of these.
"""

from impact_xval.compliant_baselines.inspect_mujoco.drops import PLACES, MeasuredContact
from impact_xval.compliant_baselines.inspect_mujoco.examination import (
    MOST_ROWS,
    Examination,
    ExaminedContact,
    ExaminedGroup,
    abbreviate_names,
    examine,
    examine_groups,
    examine_model,
    inspect_model,
    measure_model,
)
from impact_xval.compliant_baselines.inspect_mujoco.scene_contacts import read_contacts
from impact_xval.compliant_baselines.inspect_mujoco.traps import Finding

__all__ = [
    "MOST_ROWS",
    "PLACES",
    "Examination",
    "ExaminedContact",
    "ExaminedGroup",
    "Finding",
    "MeasuredContact",
    "abbreviate_names",
    "examine",
    "examine_groups",
    "examine_model",
    "inspect_model",
    "measure_model",
    "read_contacts",
]
