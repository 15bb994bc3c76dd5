"""The rungs of a ladder (`ladder`): what may stand between the model and an engine, and the laws that answer for it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial

from impact_xval.compliant_baselines.contract.registry import KELVIN_VOIGT
from impact_xval.compliant_baselines.references.kelvin_voigt import kelvin_voigt_batch
from impact_xval.compliant_baselines.references.batch import ReferenceBatch


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
        What it changes. Of the rungs below the causes these are two outcomes, of which it is the difference, after
        minus before; of a cause (`CAUSES`) one of the three switches of `corners`.
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
    "contacts that return when their bodies approach",
    "contacts that return when their gap has closed",
    "#CC79A7",
)
LAW = Rung(
    "dissipation_law",
    "dissipation law",
    "the dissipation law",
    "energetic restitution",
    "the law the engine was asked for (spring and dashpot, kelvin-voigt), or an alternative to it",
    "#009E73",
)
CHOICE = Rung(
    "law_choice",
    "choice of the dashpot",
    "the choice of the dashpot",
    "the alternative law",
    "the law the engine was asked for",
    "#F0E442",
)
GRAVITY = Rung(
    "gravity",
    "gravity",
    "gravity",
    "no gravity",
    "gravity as in the scenario of the run, B2 in static equilibrium",
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

#: Those that need no engine, in the order of `ladder.by_order`: averages over the orders in which they can be made.
CAUSES = (FROZEN, LAW, CHOICE, GRAVITY)

#: The rungs in their order; a cell has either the last one or the two before it, and `CHOICE` only where another
#: law than kelvin-voigt is asked about. Where a rung says kelvin-voigt, an engine of another law has its own.
RUNGS = (*CAUSES, MAPPING, STEP, ENGINE)

#: Laws that "what if" may put in the place of kelvin-voigt, and what answers for them.
LAWS: Mapping[str, Callable[..., ReferenceBatch]] = {
    KELVIN_VOIGT: kelvin_voigt_batch,
    "kelvin-voigt-anchored": partial(kelvin_voigt_batch, damping="anchored"),
    "kelvin-voigt-textbook": partial(kelvin_voigt_batch, damping="textbook"),
    "hunt-crossley": partial(kelvin_voigt_batch, damping="hunt-crossley"),
}


def rungs_of(law: str) -> tuple[Rung, ...]:
    """Return the rungs of a ladder by way of a law, in their order."""
    return tuple(rung for rung in RUNGS if rung is not CHOICE or law != KELVIN_VOIGT)
