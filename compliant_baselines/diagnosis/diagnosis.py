"""What a doctor finds in a scene: a trap, where, and what it does; the words are those of ``templates/traps.j2``."""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined

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


@functools.cache
def _words(template: str) -> Any:
    environment = Environment(
        loader=PackageLoader("impact_xval.compliant_baselines.diagnosis"), undefined=StrictUndefined
    )
    environment.filters["g"] = lambda value, digits=6: f"{value:.{digits}g}"
    return environment.get_template(template).module


def sentence(template: str, macro: str, **facts: Any) -> str:
    """Return what a macro of a template says of some facts, on one line."""
    return " ".join(getattr(_words(template), macro)(**facts).split())


def finding(trap: str, where: str, **facts: Any) -> Finding:
    """Describe a trap by its macro in ``traps.j2``, which is given the facts."""
    return Finding(trap, where, sentence("traps.j2", trap.replace("-", "_"), **facts))


def long_step(where: str, omega: float, damping_rate: float, step: float) -> list[Finding]:
    """Judge a time step against a contact: a finding, or none.

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
        return []
    duration, zeta = math.pi / omega, damping_rate / (2 * omega)
    if zeta > 1:  # what decays fast has to be resolved, too
        duration = min(duration, 2 * math.pi / damping_rate)
    steps = duration / step
    if steps >= FEWEST_STEPS:
        return []
    return [finding("long-step", where, duration=duration, steps=steps, step=step, fewest=FEWEST_STEPS)]
