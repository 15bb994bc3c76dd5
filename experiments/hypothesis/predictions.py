"""Where else a compliant solver goes, predicted from its law alone: closed forms, and one hybrid motion.

In real time a contact acts while its bodies overlap. So, whatever becomes infinitely stiff:

* **k2/k1 -> 0.** The balls collide as if free, and a gap opens that grows with the *soft* contact's motion
  (`cases.after_first_impact`). B2 turns around on the table. Where v11 >= 0 it leaves the table before it can catch up
  with B1, and what follows is the third impact of a sequence of single ones:
  u1 = v11, u2 = -e2 v21, and, if u2 > u1, u1 and u2 collide with e1. Where v11 < 0, B1 lands on B2 while the table
  contact is loaded: `hard_contact`.
* **k2/k1 -> infinity.** B1 alone meets a wall: v1 = the restitution of contact 1 against m1, v2 = 0.
* **e1 -> 0 by a dashpot.** An infinite dashpot joins the balls at first touch, not at the end of a compression:
  one body of mass m1 + m2 and velocity -m1/(m1 + m2) meets the table contact.
* **e2 -> 0 by a dashpot.** B2 never moves: as k2/k1 -> infinity.

What restitution a contact then shows is its law's affair. A linear dashpot mapped with the mass M and working against
m has the damping ratio zeta sqrt(M/m); Hunt and Crossley's restitution is independent of the mass and depends on the
speed; the bistiffness law returns e, always.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import brentq

from impact_xval.compliant_baselines.contact.mapping import damping_ratio, restitution, textbook_damping_ratio
from impact_xval.compliant_baselines.contact.restitution_laws import hunt_crossley_coefficients
from impact_xval.experiments.hypothesis.cases import Case, Point, after_first_impact
from impact_xval.experiments.hypothesis.hard_contact import Table, hard_ball_ball

#: Families with a law to predict from.
FAMILIES = (
    "bistiffness",
    "kelvin-voigt",
    "kelvin-voigt-anchored",
    "kelvin-voigt-textbook",
    "hunt-crossley",
)


@dataclass(frozen=True, slots=True)
class Prediction:
    """Where a solver should go.

    Attributes
    ----------
    v1, v2 : float
        Per abs(v0).
    form : str
        What it rests on, in a few words.
    """

    v1: float
    v2: float
    form: str


def dashpot_restitution(zeta: float, mapped: float, against: float) -> float:
    """Restitution of a linear dashpot of ratio zeta for the mass it was mapped with, working against another."""
    return restitution(zeta * math.sqrt(mapped / against))


def hunt_crossley_restitution(a: float, speed: float) -> float:
    """Restitution of F = k p (1 + a p') at a speed of approach: `restitution_laws` (*), solved for e."""
    A = a * speed
    if A == 0:
        return 1.0
    # A (1 + e) - ln((1 + A)/(1 - e A)) = 0 has the root e = -1 too; it is positive at e = 0 and negative at
    # e -> 1/A and beyond the root.
    high = min(1.0, (1 - 1e-15) / A)

    def excess(e: float) -> float:
        return A * (1 + e) - math.log1p(A) + math.log1p(-e * A)

    if excess(high) >= 0:
        return 1.0
    root: Any = brentq(excess, 0.0, high, xtol=1e-15)
    return float(root)


@dataclass(frozen=True, slots=True)
class Law:
    """The contacts of a family at a point, with e_i > 0 (or NaN where it goes to 0 and is not asked for).

    Attributes
    ----------
    family : str
    mass_ratio, e1, e2 : float
    """

    family: str
    mass_ratio: float
    e1: float
    e2: float

    def _zeta(self, e: float) -> float:
        return textbook_damping_ratio(e) if self.family.endswith("textbook") else damping_ratio(e)

    def _hunt_crossley(self, e: float, speed: float) -> float:
        return hunt_crossley_restitution(float(hunt_crossley_coefficients(np.array([e]))[0]), speed)

    def ball_ball(self, against: float, speed: float) -> float:
        """Restitution of contact 1 against a mass (m1 = 1) at a speed of approach."""
        match self.family:
            case "bistiffness":
                return self.e1
            case "hunt-crossley":
                return self._hunt_crossley(self.e1, speed)
            case _:
                pair = self.mass_ratio / (1 + self.mass_ratio)
                mapped = 1.0 if self.family.endswith("anchored") else pair
                return dashpot_restitution(self._zeta(self.e1), mapped, against)

    def ball_table(self, against: float, speed: float) -> float:
        """Restitution of contact 2 against a mass at a speed of approach."""
        match self.family:
            case "bistiffness":
                return self.e2
            case "hunt-crossley":
                return self._hunt_crossley(self.e2, speed)
            case _:
                return dashpot_restitution(self._zeta(self.e2), self.mass_ratio, against)

    def table(self) -> Table | None:
        """Contact 2 for a motion in time; None where it is not linear."""
        if self.family == "hunt-crossley":
            return None
        if self.family == "bistiffness":
            return Table(0.0, self.e2)
        return Table(self._zeta(self.e2), 1.0)


def predict(case: Case, point: Point, family: str) -> Prediction | None:
    """Predict the limit of a compliant solver; None where its family or the limit has no closed form here."""
    if family not in FAMILIES:
        return None
    mu = point.mass_ratio
    law = Law(family, mu, point.e1, point.e2)
    match case.key:
        case "zero-apart" | "zero-early" | "zero-late":
            pair = mu / (1 + mu)
            e1 = law.ball_ball(pair, 1.0)
            v11, v21 = after_first_impact(mu, e1)
            u2 = -law.ball_table(mu, -v21) * v21
            if v11 >= 0:
                if u2 <= v11:
                    return Prediction(v11, u2, "one impact of each contact")
                impulse = pair * (1 + law.ball_ball(pair, u2 - v11)) * (u2 - v11)
                return Prediction(v11 + impulse, u2 - impulse / mu, "a sequence of three single impacts")
            table = law.table()
            if table is None:
                return None
            v1, v2 = hard_ball_ball(mu, law.ball_ball(pair, 1.0), v11, v21, table)
            return Prediction(v1, v2, "a rigid ball-ball contact that can open, on the soft table contact")
        case "infinity":
            return Prediction(law.ball_ball(1.0, 1.0), 0.0, "contact 1 against m1 alone")
    if family in ("bistiffness", "kelvin-voigt-textbook"):
        # The impact law is the model's own where nothing returns; the textbook's zeta goes to 1, not to infinity.
        return None
    if case.stiff == 1:
        speed = 1 / (1 + mu)
        v = law.ball_table(1 + mu, speed) * speed
        return Prediction(v, v, "one body of both masses from the first touch")
    return Prediction(law.ball_ball(1.0, 1.0), 0.0, "contact 1 against m1 alone")
