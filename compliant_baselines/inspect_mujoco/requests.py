"""Requests about a scene and their answers: an examination, or a scene that was written."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

from impact_xval.compliant_baselines.inspect_mujoco.examination import Examination, examine_groups, load_scene
from impact_xval.compliant_baselines.inspect_mujoco.fixing import FixedScene, fix_scene
from impact_xval.compliant_baselines.inspect_mujoco.readings import Kind


class InspectionRequest(NamedTuple):
    """A request about a scene."""

    #: Speed in m/s at which the bodies meet.
    speed: float
    #: Only the contacts of this geom; None for all.
    geom: str | None = None
    #: True to measure every combination of parameters and masses.
    every: bool = False
    #: A file to write the scene to; None for an examination.
    target: Path | None = None
    #: The reading that is written.
    kind: Kind = "keep"


def answer_request(request: InspectionRequest, scene: Path) -> Examination | FixedScene | str:
    """Examine a file, .mjb or MJCF, or write a fixed one; a string says why that is impossible."""
    try:
        if request.target is not None:
            return fix_scene(scene, request.target, request.kind, request.speed, request.geom)
        return examine_groups(load_scene(scene), request.speed, every=request.every, geom=request.geom)
    except (ValueError, OSError) as error:
        return str(error)
    except Exception as error:  # the engine may raise anything on a scene that it does not expect
        return f"{scene}: cannot be examined: {error!r}"
