"""The rungs of a ladder (`ladder`): what may stand between the model and an engine, and the laws that answer for it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from compliant_baselines.kelvin_voigt import kelvin_voigt_batch
from compliant_baselines.reference_solver import ReferenceBatch
from compliant_baselines.registry import KELVIN_VOIGT


@dataclass(frozen=True, slots=True)
class Rung:
    """One cause.

    Attributes
    ----------
    name : str
        In tables and files.
    label : str
        For readers.
    phrase : str
        In a sentence about an engine, after "by".
    before, after : str
        The two outcomes it is the difference of, after minus before.
    color : str
        In figures.
    """

    name: str
    label: str
    phrase: str
    before: str
    after: str
    color: str


FROZEN = Rung(
    "frozen_positions",
    "frozen positions",
    "frozen positions",
    "the state-transition model",
    "the same impact law in real time, with gaps (bistiffness, no gravity)",
    "#CC79A7",
)
LAW = Rung(
    "dissipation_law",
    "dissipation law",
    "the dissipation law",
    "bistiffness, no gravity",
    "the law the engine was asked for (spring and dashpot, kelvin-voigt), no gravity",
    "#009E73",
)
CHOICE = Rung(
    "law_choice",
    "choice of the dashpot",
    "the choice of the dashpot",
    "the alternative law, no gravity",
    "kelvin-voigt, no gravity",
    "#F0E442",
)
GRAVITY = Rung(
    "gravity",
    "gravity",
    "gravity",
    "kelvin-voigt, no gravity",
    "kelvin-voigt in the scenario of the run",
    "#E69F00",
)
MAPPING = Rung(
    "mapping",
    "regularisation and mapping",
    "its regularisation and mapping",
    "kelvin-voigt in the scenario of the run",
    "the engine in the limit of small steps",
    "#0072B2",
)
STEP = Rung(
    "discretisation",
    "time step",
    "its time step",
    "the engine in the limit of small steps",
    "the engine at the step it was run with",
    "#D55E00",
)
ENGINE = Rung(
    "engine",
    "mapping and time step",
    "its mapping and time step, not separated",
    "kelvin-voigt in the scenario of the run",
    "the engine at the step it was run with",
    "#56B4E9",
)

#: The rungs in their order; a cell has either the last one or the two before it, and `CHOICE` only where another
#: law than kelvin-voigt is asked about. Where a rung says kelvin-voigt, an engine of another law has its own.
RUNGS = (FROZEN, LAW, CHOICE, GRAVITY, MAPPING, STEP, ENGINE)

#: Laws that "what if" may put in the place of kelvin-voigt, and what answers for them.
LAWS: Mapping[str, Callable[..., ReferenceBatch]] = {
    KELVIN_VOIGT: kelvin_voigt_batch,
    "kelvin-voigt-anchored": lambda *cells: kelvin_voigt_batch(*cells, damping="anchored"),
    "kelvin-voigt-textbook": lambda *cells: kelvin_voigt_batch(*cells, damping="textbook"),
    "hunt-crossley": lambda *cells: kelvin_voigt_batch(*cells, damping="hunt-crossley"),
}


def rungs_of(law: str) -> tuple[Rung, ...]:
    """Return the rungs of a ladder by way of a law, in their order."""
    return tuple(rung for rung in RUNGS if rung is not CHOICE or law != KELVIN_VOIGT)
