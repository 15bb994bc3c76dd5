"""The engines as a user sets them up who has read the names of the parameters: the naive mapping as solvers.

`contact.mapping` says what each naive mapping is. Here they have names, so that one run can hold an engine
mapped both ways side by side, and the ladder can show what the mapping costs: an engine converges, with its step, to
the contact it was given, not to the one that was meant, so the cost is in the rung "regularisation and mapping".

The naive mapping of MuJoCo breaks Theorem 5: its default solimp has a width in metres, and k in N/m is read as 1/s^2,
so that the outcome depends on the scale of k and m.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from impact_xval.compliant_baselines.contract.solver import Settings
from impact_xval.compliant_baselines.engines.mujoco_drop import MujocoSolver
from impact_xval.compliant_baselines.engines.pybullet_drop import PybulletSolver
from impact_xval.model.collision import Collision, Outcome


class NaiveMujocoSolver(MujocoSolver):
    """MuJoCo with k and c written into a direct-format solref as N/m and N s/m, under the default solimp."""

    name = "mujoco-naive"

    def solve_many(self, collisions: Sequence[Collision], settings: Settings) -> list[Outcome]:
        """Answer every collision, in order, whatever mapping the settings ask for."""
        return super().solve_many(collisions, replace(settings, mapping="naive"))


class NaivePybulletSolver(PybulletSolver):
    """PyBullet with the stiffness and damping of the ball-ball contact on both balls, zeta from the textbook."""

    name = "pybullet-naive"

    def solve_many(self, collisions: Sequence[Collision], settings: Settings) -> list[Outcome]:
        """Answer every collision, in order, whatever mapping the settings ask for."""
        return super().solve_many(collisions, replace(settings, mapping="naive"))
