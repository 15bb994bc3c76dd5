"""The contacts of a MuJoCo scene: traps in their parameters, and measurements of their behaviour (docs/mapping.md).

The engine documents each trap (XML reference, "Solver parameters" and the options; changelog of 3.13), and a test
measures its effect.

* `scene_contacts` reads the contacts of a compiled scene and the bodies of each.
* `drops` measures a contact in a scene of its own.
* `traps` finds traps in parameters.
* `groups` gathers contacts of the same parameters, and chooses the contacts to measure.
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
