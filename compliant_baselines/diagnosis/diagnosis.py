"""What a doctor finds in a scene: a trap, where, and what it does."""

from __future__ import annotations

import math
from dataclasses import dataclass

#: Steps in a contact below which it is too short for the step: 10 % of the restitution and more go astray.
FEWEST_STEPS = 30


@dataclass(frozen=True, slots=True)
class Finding:
    """A trap.

    Attributes
    ----------
    trap : str
        Its name, such as ``"mixed-signs"``.
    where : str
        The contact, the body or the option.
    says : str
        What was asked for, what the engine does instead, and the way out; one sentence or two.
    """

    trap: str
    where: str
    says: str

    def __str__(self) -> str:
        return f"{self.trap}: {self.where}: {self.says}"


def step_finding(where: str, omega: float, damping_rate: float, step: float) -> Finding | None:
    """Judge a time step against a contact.

    Parameters
    ----------
    where : str
        The contact.
    omega : float
        sqrt(k/M) of the pair alone, in 1/s.
    damping_rate : float
        c/M, in 1/s.
    step : float
        In s.
    """
    if not (omega > 0 and step > 0):
        return None
    duration, zeta = math.pi / omega, damping_rate / (2 * omega)
    if zeta > 1:  # what decays fast has to be resolved, too
        duration = min(duration, 2 * math.pi / damping_rate)
    steps = duration / step
    if steps >= FEWEST_STEPS:
        return None
    return Finding(
        "long-step",
        where,
        f"a contact of {duration:.3g} s gets {steps:.2g} steps of {step:.3g} s; some {FEWEST_STEPS} are the least for "
        f"its restitution to be within 10 %, {duration / 100:.2g} s the step for about 1 % (see impact-xval contact)",
    )
