"""Drake in continuous time: Hunt-Crossley contacts under an integrator with error control.

F = max(0, k delta (1 + d delta')), k in series and d = d_A k_B/(k_A + k_B) + d_B k_A/(k_A + k_B) of the two
geometries (the engine's page "Modeling Dissipation"): with one of them rigid, d is the other's.

* For e = 1 the dissipation is zero and the column is that of two springs, which every reference here agrees
  on: with its own integrator, the best third-party oracle there is.
* For e < 1 it is another law than the dashpot's, to be compared with `hunt-crossley`: d = A/|v0| with A from
  equation (*) of `contact.restitution_laws`, both contacts for the approach speed |v0|. A rung of
  its own, not a Kelvin-Voigt engine; it runs where it is asked for by name.

The integrator is the simulator's default, the error-controlled Runge-Kutta of third order. Contact onset and
end are kinks: at the same accuracy the fifth-order scheme is off by a hundred times as much, since what it
compares across a kink is not its error. The accuracy is a bound on absolute changes of heights in m and
velocities in m/s: it is scaled with the larger of the two.

The "step" of this solver is the time between two samples. It decides on the state path and on when the
collision is seen to be over, not on the velocities.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np

from impact_xval.compliant_baselines.contact.column import Column
from impact_xval.compliant_baselines.contact.mapping import PYBULLET_RIGID, Contact
from impact_xval.compliant_baselines.contact.restitution_laws import hunt_crossley_coefficients
from impact_xval.compliant_baselines.engines.drake_drop import (
    DrakeSolver,
    Scene,
    build,
    contact_material,
    follow,
    quiet,
)
from impact_xval.compliant_baselines.engines.engine_run import Run

#: Integration error aimed at in each step, per |v0|. Velocities at the end come out 4 times as far off.
ACCURACY = 1e-10


class DrakeHuntCrossleySolver(DrakeSolver):
    """Drake, continuous time, Hunt-Crossley contacts; elastic ones are linear springs."""

    name = "drake-hunt-crossley"

    def refusal(self, column: Column) -> str | None:
        """Why a column cannot be taken: there is no naive mapping to this law. No step is too short."""
        if column.mapping == "naive":
            return "mapping = 'naive': a Hunt-Crossley contact has no naive mapping; take 'calibrated'"
        return None

    def run_columns(self, columns: Sequence[Column], max_steps: int, record_path: bool = False) -> list[Run]:
        """Run every column until its collision is over or `max_steps` samples are taken; in order."""
        with quiet():
            return [
                follow(partial(_scene, abs(column.v1)), column, max_steps, record_path) for column in columns
            ]


def dissipation(contact: Contact, speed: float) -> float:
    """Hunt-Crossley dissipation d in s/m for the restitution this contact is meant to have.

    Parameters
    ----------
    contact : Contact
        Calibrated; its damping ratio says which restitution.
    speed : float
        Approach speed in m/s at which it holds.
    """
    return float(hunt_crossley_coefficients(np.array([contact.restitution]))[0]) / speed


def _scene(speed: float, column: Column) -> Scene:
    """Set a column up whose contacts have their restitution at an approach speed in m/s."""
    one, two = column.contact1, column.contact2
    upper = contact_material(point_stiffness=one.k, dissipation=dissipation(one, speed))
    table = contact_material(point_stiffness=two.k, dissipation=dissipation(two, speed))
    lower = contact_material(point_stiffness=PYBULLET_RIGID, dissipation=0.0)
    scene = build(column, (upper, lower, table), one.k, two.k, discrete=False)
    integrator = scene.simulator.get_mutable_integrator()
    slow = min(one.omega, two.omega)
    integrator.set_target_accuracy(ACCURACY * speed * max(1.0, 1 / slow))
    integrator.set_maximum_step_size(column.step)
    integrator.request_initial_step_size_target(column.step / 10)
    integrator.set_requested_minimum_step_size(1e-6 * column.step)
    return scene
