"""What is asked of every engine, and in which arrangements: those that change nothing of the impact, or nearly so."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any

from impact_xval.compliant_baselines.practical.practice import STIFFNESS, Arrangement
from impact_xval.experiments.config.arrangements import Arranged
from impact_xval.model.columns.column import Column

#: Coefficients of restitution of all contacts.
RESTITUTIONS = (1.0, 0.9, 0.5)

#: Arrangements by name; balls of 1 kg at 1 m/s, springs of `STIFFNESS` where nothing else is said.
_ARRANGED: dict[str, dict[str, Any]] = {
    "ball on table": {"arrangement": "stack", "balls": 1},
    "ball on ball": {"arrangement": "chain", "balls": 2},
    "drop, k2/k1 = 0.01": {"arrangement": "drop", "balls": 2, "mass_taper": 2.0, "stiffness_taper": 0.01},
    "drop, k2/k1 = 1": {"arrangement": "drop", "balls": 2, "mass_taper": 2.0},
    "drop, k2/k1 = 100": {"arrangement": "drop", "balls": 2, "mass_taper": 2.0, "stiffness_taper": 100.0},
    "cradle 1 on 2": {"arrangement": "cradle", "balls": 3, "strike": 1},
    "cradle 1 on 4": {"arrangement": "cradle", "balls": 5, "strike": 1},
    "cradle 2 on 3": {"arrangement": "cradle", "balls": 5, "strike": 2},
    "stack of 3": {"arrangement": "stack", "balls": 3},
}

#: The cases of one contact: no law but e has a say in them.
ONE_CONTACT = ("ball on table", "ball on ball")
#: The collision that all others are measured by.
BASIC = "drop, k2/k1 = 1"


@dataclass(frozen=True, slots=True)
class Case:
    """A column and its name."""

    name: str
    e: float
    column: Column


def cases() -> Iterator[Case]:
    """Give every case, in the order of the board."""
    for name, arranged in _ARRANGED.items():
        for e in RESTITUTIONS:
            yield Case(name, e, Arranged(**arranged, e=e, k=STIFFNESS).column())


def command(name: str, e: float) -> str:
    """Write the command that solves a case by exact solvers."""
    options = {"k": STIFFNESS, **_ARRANGED[name], "e": e}
    words = (f"--{key.replace('_', '-')} {value}" for key, value in options.items())
    return f"impact-xval cradle {' '.join(words)}"


#: The arrangement that is compared with the laws.
USUAL = "as it is"

#: Steps after which an impact is given up: twice and more what the longest takes.
MOST_STEPS = 50_000

#: What an answer should not depend on, but for its step only a little. Lengths are in radii; bodies touch in the usual
#: arrangement.
VARIATIONS: dict[str, Callable[[Arrangement], Arrangement]] = {
    USUAL: lambda usual: usual,
    "overlapping by 1e-4": lambda usual: replace(usual, gap=-1e-4),
    "overlapping by 1e-6": lambda usual: replace(usual, gap=-1e-6),
    "apart by 1e-6": lambda usual: replace(usual, gap=1e-6),
    "apart by 1e-4": lambda usual: replace(usual, gap=1e-4),
    "half the step": lambda usual: replace(usual, step=usual.step / 2),
    "twice the step": lambda usual: replace(usual, step=2 * usual.step),
    "bodies made in the other order": lambda usual: replace(usual, reversed_insertion=True),
    "one metre higher": lambda usual: replace(usual, translation=1.0),
}
#: Those of another step: an engine's answer may well depend on that, as its documentation says.
STEPS = ("half the step", "twice the step")
