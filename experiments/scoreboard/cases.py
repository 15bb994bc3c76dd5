"""What every solver is asked, and the arrangements of it that change the impact by nothing, or next to nothing."""

from __future__ import annotations

from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np

from impact_xval.compliant_baselines.engines.engine import Engine
from impact_xval.compliant_baselines.engines.scene import Scene
from impact_xval.compliant_baselines.solver import Settings
from impact_xval.experiments.config.arrangements import Arranged
from impact_xval.model.collision import Collision

#: Coefficients of restitution of all contacts.
RESTITUTIONS = (1.0, 0.9, 0.5, 0.0)

#: Collisions by name, as `Arranged` takes them; where nothing else is said balls of 1 kg at 1 m/s, contacts of 1e8 N/m.
COLUMNS: dict[str, dict[str, Any]] = {
    "drop, k2/k1 = 0.01": {"arrangement": "drop", "balls": 2, "mass_taper": 2.0, "stiffness_taper": 0.01},
    "drop, k2/k1 = 1": {"arrangement": "drop", "balls": 2, "mass_taper": 2.0},
    "drop, k2/k1 = 100": {"arrangement": "drop", "balls": 2, "mass_taper": 2.0, "stiffness_taper": 100.0},
    "cradle 1 on 2": {"arrangement": "cradle", "balls": 3},
    "1 on 2, 1 mm apart": {"arrangement": "chain", "balls": 3, "gap": 1e-3},
    "cradle 1 on 4": {"arrangement": "cradle", "balls": 5},
    "cradle 2 on 3": {"arrangement": "cradle", "balls": 5, "strike": 2},
    "stack of 3": {"arrangement": "stack", "balls": 3},
}

#: Every case, in the order of the board.
CASES = list(product(COLUMNS, RESTITUTIONS))

#: The arrangement that is compared with the laws: bodies touch, those of a rigid engine overlap by 2^-16 radii.
USUAL = "as it is"

MIRRORED = "made in the other order"

#: Gaps, in radii, by which touching bodies are apart, or overlap.
_GAPS = {
    "apart by 1e-4": 1e-4,
    "apart by 1e-6": 1e-6,
    "overlapping by 1e-6": -1e-6,
    "overlapping by 1e-4": -1e-4,
}

#: Steps over the usual one.
STEPS = {"half the step": 0.5, "twice the step": 2.0}


def column(case: str, e: float) -> Collision:
    """Give the collision of a case."""
    return Arranged(**COLUMNS[case], e=e).column()


def arrangements(engine: Engine, collision: Collision, settings: Settings) -> dict[str, Scene] | str:
    """Arrange a case in every way for an engine, or say why it takes none.

    Every gap is changed at once, by the share of a radius that the name says. Without a table a column is also moved
    along its line, and made in the other order: mirrored, so that ball N comes first.
    """
    settings = replace(settings, **engine.as_set)
    usual = engine.scene_or_refusal(collision, settings)
    if isinstance(usual, str):
        return usual
    radius, heights = engine.radius(usual), np.array(usual.heights)
    # Heights grow upwards: ball i is above as many changed gaps as there are contacts below it.
    below = np.arange(len(heights), 0, -1) - (not usual.table)

    def moved(by: Any) -> Scene:
        return replace(usual, heights=tuple((heights + by * radius).tolist()))

    found = {USUAL: usual} | {name: moved(gap * below) for name, gap in _GAPS.items()}
    found |= {name: replace(usual, step=usual.step * share) for name, share in STEPS.items()}
    if not usual.table:
        mirrored = engine.scene_or_refusal(collision.reversed(), settings)
        assert isinstance(mirrored, Scene)
        found |= {"moved by 0.37 radii": moved(0.37), MIRRORED: mirrored}
    return found
