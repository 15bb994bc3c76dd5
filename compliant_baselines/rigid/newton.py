"""Newton's XPBD solver (Warp) on a processor, in single precision: rigid contacts with restitution.

A step moves bodies out of each other, and then gives every contact the rebound of its restitution e, in iterations.
XPBD takes the mean of the coefficients of two shapes, so both shapes of a contact have its e, and
`Settings.partner_restitution` has no effect. Nothing rebounds from a speed below 2 g dt with gravity g and step dt, and
here g is 0. Steps are recorded and replayed as in `engines.newton`.

A body with several contacts gets the mean of their changes of velocity, and a body with one contact gets the full
change. So XPBD does not conserve momentum where a body touches two others (docs/contacts-in-engines.md). More
iterations do not help.
"""

from __future__ import annotations

import numpy as np

from impact_xval.compliant_baselines.engines.newton import NewtonSetting, RecordedScene
from impact_xval.compliant_baselines.engines.scene import Scene
from impact_xval.compliant_baselines.rigid.lines import SINGLE, RigidEngine, RigidWorld, nearest_float32

#: Number of iterations of restitution in a step. The engine's default is 2.
ITERATIONS = 64

#: Length of a step in the engine's units of time. XPBD stops bodies that move at less than 1e-4 in the engine's units
#: (apply_body_deltas in its kernels.py). With these units, bodies that touch move at some 1000.
TIME = 2.0**-20

XPBD = NewtonSetting(
    "SolverXPBD",
    (("enable_restitution", True), ("rigid_contact_restitution_iterations", ITERATIONS)),
    4,
    TIME,
)


class XpbdWorld(RigidWorld):
    """A scene in Newton, whose steps are replayed from a recording."""

    resolution = accuracy = SINGLE

    def __init__(self, scene: Scene, radius: float) -> None:
        super().__init__(scene, radius)
        e = np.array(scene.restitutions)
        self._recorded = RecordedScene(scene, self.radius, XPBD, {"shape_material_restitution": e})
        self._recorded.start(np.array(scene.velocities), self.heights, 0.0)
        #: Velocities and heights after steps that were taken but not returned yet, in reverse order.
        self._states: list[tuple[list[float], list[float]]] = []
        given = self._recorded.numbers("shape_material_restitution", e.size).tolist()
        self.effective = {
            "restitution": tuple(map(nearest_float32, given, scene.restitutions)),
            "step": (scene.step,),
        }

    def step(self) -> tuple[list[float], list[float]]:
        """Take a step, and return the velocities in m/s and the heights of the balls' centres in m after it."""
        if not self._states:
            velocities, heights = self._recorded.advance(XPBD.steps)
            centres = heights + self.places
            self._states = [*zip(velocities.tolist(), centres.tolist(), strict=True)][::-1]
        return self._states.pop()


class NewtonXpbd(RigidEngine):
    """Newton with its XPBD solver."""

    name, distribution, module, title = "newton:xpbd", "newton", "newton", "Newton"
    made = XpbdWorld

    def refusal(self, scene: Scene) -> str | None:
        """Return a sentence that says why Newton cannot take a scene, or None.

        Newton has no other mapping than the calibrated one. It also refuses what every rigid engine refuses.
        """
        if scene.mapping != "calibrated":
            return f"mapping = {scene.mapping!r}: Newton has only one mapping; legal: 'calibrated'"
        return super().refusal(scene)
