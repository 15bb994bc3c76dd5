"""What an engine's velocities tend to as its step goes to zero, and how well that is known.

An engine is run at the steps h, h/2, h/4, ..., halved further only as long as the estimate below exceeds the
tolerance. Of the velocities V0, V1, ..., Vn (from the longest step to the shortest) the limit is Richardson's,

    L = 2 Vn - V(n-1),

for engines of first order, which these are. It removes what is smooth in the step. What it cannot remove is
chance: a contact that closes at a finite speed starts at the end of the step in which it was met, up to a
step late, and a dashpot then misses up to a step of its force c u. Which part of a step that is changes from
one step length to the next without any law, so that these errors shrink with h but cannot be extrapolated.

Balls that part for good have v1 >= v2 >= 0, and so has their limit. Where L is outside, the balls meet once more as the
step goes to zero, or B2 meets the table, and not at the steps that were run: L is then replaced by the nearest point
inside, in the kinetic norm. That is what a plastic meeting makes of it, and an elastic one goes as far again.

The estimate of the error of L is therefore the largest of five numbers (the larger of the two velocities
counts):

1. |L - L'|, with L' = 2 V(n-1) - V(n-2) the limit of the steps before: for errors a h + b h^2 three times the
   error of L;
2. a tenth of |Vn - V(n-1)|, the correction that was made: three differences can agree by accident. All of it where
   the last two runs do not pass through the same states (`state_runs`): between a run in which the balls meet once
   more and one in which they do not the velocities have a kink, across which no straight line leads;
3. half of what contacts that closed again did in their first step, in the run of the shortest step, as a
   change of the relative velocity of their pair (`Run.starts`): L takes twice what the shortest step has of
   this and once what the step before has, either between nothing and all of it;
4. how far L was moved to v1 >= v2 >= 0;
5. in a drop, where it is not known whether gravity ends in a first flight before two bodies meet again or goes on, what
   it does in that contact: g times half its period (`certificate`).

A contact that is met at the start is met at the beginning of the first step, whatever the step: it counts in
1 and 2 only.

**Regularisation.** An engine may add to its contacts what no step removes: MuJoCo's constraints have an
impedance of 1e-4 at least. What that does to the velocities is measured, by one more run at the step h with
ten times as much of it: a ninth of the difference (it is of first order in the impedance). Beside a grazing
that difference may be the step's: where it exceeds the tolerance it is measured again at the shortest step,
and the step is halved further unless two measures agree within a factor of 2. The total, estimate and
regularisation, is by how much L may differ from what the contacts *asked for* do.

The order is that of |V(i+1) - V(i)| in the step, fitted through all steps; 1 for a first-order method whose
errors are smooth, 2 for MuJoCo's symplectic steps on elastic contacts, and anything where chance leads.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

#: Share of the last correction that is doubted whatever the differences say.
DOUBT = 0.1

#: Share of what contacts do in their first steps that may be missing from the limit.
CHANCE = 0.5


@dataclass(frozen=True, slots=True)
class Convergence:
    """What a limit must satisfy.

    Parameters
    ----------
    tolerance : float
        Largest error of the limit, per abs(v0), at which a result counts as converged.
    halvings : int
        How often the step may be halved, at least 2.

    Raises
    ------
    ValueError
        For an illegal value.
    """

    tolerance: float = 1e-3
    halvings: int = 4

    def __post_init__(self) -> None:
        if not 0 < self.tolerance <= 1:
            raise ValueError(f"tolerance = {self.tolerance!r}; legal: greater than 0, at most 1")
        if not 2 <= self.halvings <= 10:
            raise ValueError(f"halvings = {self.halvings!r}; legal: a whole number from 2 to 10")


@dataclass(frozen=True, slots=True)
class Limit:
    """The limit of small steps.

    Attributes
    ----------
    v1, v2 : float
        Velocities in m/s.
    step_error : float
        Estimated error of both, in m/s, as the engine's own limit.
    regularisation : float
        By how much the engine's regularisation moves them, in m/s; 0 for an engine without.
    order : float
        Fitted order of convergence; NaN where there is nothing but rounding.
    step : float
        The shortest step, in s.
    flight : bool
        Whether gravity ended in a first flight at that step.
    """

    v1: float
    v2: float
    step_error: float
    regularisation: float
    order: float
    step: float
    flight: bool = False

    @property
    def error(self) -> float:
        """By how much v1 and v2 may differ from what the contacts asked for do, in m/s."""
        return self.step_error + self.regularisation


def parted(v1: float, v2: float, mass_ratio: float) -> tuple[float, float]:
    """Nearest velocities with v1 >= v2 >= 0, in the kinetic norm; mass_ratio is m2/m1."""
    if v2 > v1:
        v1 = v2 = (v1 + mass_ratio * v2) / (1 + mass_ratio)
    return max(v1, 0.0), max(v2, 0.0)


def limit_of(
    velocities: Floats,
    starts: float,
    step: float,
    mass_ratio: float,
    regularisation: float = 0.0,
    *,
    alike: bool = True,
    flight_doubt: float = 0.0,
) -> Limit:
    """Extrapolate to a step of zero; see the module.

    Parameters
    ----------
    velocities : ndarray, shape (n, 2), n >= 3
        Final velocities of B1 and B2 in m/s at steps each half of the one before.
    starts : float
        `Run.starts` of the last run, in m/s.
    step : float
        The last step, in s.
    mass_ratio : float
        m2/m1.
    regularisation : float
        What regularisation does, in m/s.
    alike : bool
        Whether the last two runs pass through the same states.
    flight_doubt : float
        What a first flight that is in doubt may change, in m/s.
    """
    differences = np.abs(np.diff(velocities, axis=0)).max(axis=1)
    limits = 2 * velocities[1:] - velocities[:-1]
    outside1, outside2 = map(float, limits[-1])
    v1, v2 = parted(outside1, outside2, mass_ratio)
    error = max(
        float(np.abs(limits[-1] - limits[-2]).max()),
        (DOUBT if alike else 1.0) * float(differences[-1]),
        CHANCE * abs(starts),
        max(abs(v1 - outside1), abs(v2 - outside2)),
        flight_doubt,
    )
    return Limit(v1, v2, error, regularisation, fitted_order(differences), step)


def fitted_order(errors: Floats) -> float:
    """Order of errors (or differences) at steps each half of the one before; NaN if any of them is zero."""
    if not np.all(errors > 0):
        return math.nan
    slope = np.polyfit(np.arange(len(errors)), np.log2(errors), 1)[0]
    return float(-slope)
