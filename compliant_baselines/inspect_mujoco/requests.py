"""Requests about a MuJoCo scene and their answers: an examination of the scene, or a new file with changed contacts."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

from impact_xval.compliant_baselines.inspect_mujoco.examination import Examination, examine_groups, load_scene
from impact_xval.compliant_baselines.inspect_mujoco.fixing import FixedScene, fix_scene
from impact_xval.compliant_baselines.inspect_mujoco.readings import Kind


class InspectionRequest(NamedTuple):
    """A request to examine a MuJoCo scene, or to write it with changed contacts."""

    #: Speed in m/s at which the bodies meet.
    speed: float
    #: Name of a geom whose contacts alone are examined; None for all contacts.
    geom: str | None = None
    #: True to measure every combination of parameters and bodies.
    every: bool = False
    #: File into which the changed scene is written; None if the scene is only examined.
    target: Path | None = None
    #: How a solref (-stiffness, -damping) of a contact is read when the scene is written (`readings`).
    kind: Kind = "keep"


def answer_request(request: InspectionRequest, scene: Path) -> Examination | FixedScene | str:
    """Examine a .mjb or MJCF file, or write a changed one. If this is impossible, return a text that says why."""
    try:
        if request.target is not None:
            return fix_scene(scene, request.target, request.kind, request.speed, request.geom)
        return examine_groups(load_scene(scene), request.speed, every=request.every, geom=request.geom)
    except (ValueError, OSError) as error:
        return str(error)
    except Exception as error:  # the engine can raise any exception on a scene that it does not expect
        return f"{scene}: cannot be examined: {error!r}"
