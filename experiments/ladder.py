r"""Why an engine diverges from the model: the difference of final velocities, split into its causes.

Between the state-transition model and an engine stand outcomes that differ from their neighbours in one thing each
(docs/theory.md, section 7; docs/ladder.md). The differences of neighbours are the **rungs**; they telescope, so that in
every cell

    engine - model = frozen positions + dissipation law + gravity + regularisation and mapping + time step

holds for (v1, v2) to rounding, whatever the outcomes in between are. Those in between are computed here, through the
batch functions of the references, whether or not a run lists them as solvers: exact between events, no time step, at
1e5 cells a second. Only the engine in the limit of small steps has to come from the engine. Where it was not
computed, or did not converge, the last two rungs are one, `ENGINE`.

**Sizes.** The size of a rung is its kinetic norm, sqrt(dv1^2 + (m2/m1) dv2^2) per \|v0\|, as D is that of the total.
Norms do not add: rungs are vectors, and may oppose each other. What does add is their component along the total,

    along_i = <rung_i, total>/D,    <a, b> = a1 b1 + (m2/m1) a2 b2,    sum along_i = D,

and share_i = along_i/D, of which the sum is 1. A negative share is a rung that takes the engine back towards the
model; a share above 1 one that others take back. Over many cells the share of a rung is sum(along_i)/sum(D): what it
contributes to the mean D, cells of large D counting for as much as they diverge.

The order of the rungs is part of their meaning, as in every telescoping sum: the dissipation law is changed with
positions already free, gravity is switched on with the dashpots already in.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from compliant_baselines.bistiffness import bistiffness_batch
from compliant_baselines.reference_solver import ReferenceBatch
from compliant_baselines.registry import KELVIN_VOIGT
from experiments.rungs import CHOICE, ENGINE, FROZEN, GRAVITY, LAW, LAWS, MAPPING, STEP, Rung
from model.collision import RESULT_STATUSES

Floats = NDArray[np.float64]
Texts = NDArray[np.str_]

#: D below which there is nothing to split: the accuracy of the references.
NOTHING = 1e-9


@dataclass(frozen=True, slots=True, eq=False)
class Posts:
    """The outcomes between the rungs that need no engine, for arrays of cells of one shape (n,).

    Attributes
    ----------
    bistiffness, compliant, scenario : ndarray, shape (n, 2)
        v1 and v2 per abs(v0): bistiffness and the engine's law (kelvin-voigt) without gravity, that law in the
        scenario; NaN without a result.
    alternative : ndarray, shape (n, 2), or None
        What is asked about in the place of the engine's law, without gravity.
    reason : ndarray of str, shape (n,)
        Empty where all have a result; else the first that has none, and its status.
    """

    bistiffness: Floats
    compliant: Floats
    scenario: Floats
    alternative: Floats | None
    reason: Texts

    def take(self, index: NDArray[np.intp]) -> Posts:
        """Return those of some cells, in the order of `index`."""
        other = None if self.alternative is None else self.alternative[index]
        return Posts(
            self.bistiffness[index], self.compliant[index], self.scenario[index], other, self.reason[index]
        )


def posts(
    stiffness_ratio: Floats,
    mass_ratio: Floats,
    e1: Floats,
    e2: Floats,
    gravity_number: Floats,
    law: str = KELVIN_VOIGT,
    obeyed: str = KELVIN_VOIGT,
) -> Posts:
    r"""Compute what stands between the model and an engine.

    Parameters
    ----------
    stiffness_ratio, mass_ratio, e1, e2 : ndarray, shape (n,)
        k2/k1, m2/m1 and the coefficients of restitution.
    gravity_number : ndarray, shape (n,)
        g/(\|v0\| omega1); 0 without gravity.
    law : str
        One of `LAWS`: what is asked about.
    obeyed : str
        One of `LAWS`: what the engine was asked for.

    Raises
    ------
    ValueError
        For an unknown law, or an illegal value.
    """
    for name, value in (("law", law), ("obeyed", obeyed)):
        if value not in LAWS:
            raise ValueError(f"{name} = {value!r}; legal: {', '.join(LAWS)}")
    cells = stiffness_ratio, mass_ratio, e1, e2
    reason = np.full(np.shape(stiffness_ratio), "", dtype="U80")

    def velocities(name: str, batch: ReferenceBatch) -> Floats:
        failed = ~np.isin(batch.status, RESULT_STATUSES) & (reason == "")
        reason[failed] = np.char.add(f"{name}: ", batch.status[failed])
        return np.column_stack([batch.v1, batch.v2])

    bistiffness = velocities("bistiffness", bistiffness_batch(*cells))
    compliant = velocities(obeyed, LAWS[obeyed](*cells))
    other = None if law == KELVIN_VOIGT else velocities(law, LAWS[law](*cells))
    scenario = compliant
    if np.any(gravity_number > 0):
        scenario = velocities(f"{obeyed} with gravity", LAWS[obeyed](*cells, gravity_number))
    return Posts(bistiffness, compliant, scenario, other, reason)


@dataclass(frozen=True, slots=True, eq=False)
class Split:
    """The ladders of n cells.

    Attributes
    ----------
    rungs : tuple of Rung
        Those that were asked for, in order.
    vectors : ndarray, shape (m, n, 2)
        dv1 and dv2 of every rung per abs(v0); NaN for a rung that a cell does not have.
    total : ndarray, shape (n, 2)
        Engine minus model.
    norms, along : ndarray, shape (m, n)
        Kinetic norm of every rung, and its component along the total; `along` is NaN where D is 0.
    divergence : ndarray, shape (n,)
        D.
    """

    rungs: tuple[Rung, ...]
    vectors: Floats
    total: Floats
    norms: Floats
    along: Floats
    divergence: Floats

    @property
    def shares(self) -> Floats:
        """`along` over D; NaN where D is less than `NOTHING`."""
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.where(self.divergence >= NOTHING, self.along / self.divergence, np.nan)

    def dominant(self) -> NDArray[np.intp]:
        """Index into `rungs` of the one with the largest share in each cell; -1 where there is nothing to split."""
        shares = np.where(np.isnan(self.shares), -np.inf, self.shares)
        return np.where(self.divergence >= NOTHING, np.argmax(shares, axis=0), -1)

    def residual(self) -> Floats:
        """Return the largest component, cell by cell, by which the rungs fail to sum to the total."""
        return np.abs(np.nansum(self.vectors, axis=0) - self.total).max(axis=1)


def split(mass_ratio: Floats, model: Floats, between: Posts, limit: Floats, engine: Floats) -> Split:
    """Split the difference of an engine from the model into rungs.

    Parameters
    ----------
    mass_ratio : ndarray, shape (n,)
        m2/m1.
    model, engine : ndarray, shape (n, 2)
        Final velocities per abs(v0); NaN without a result.
    between : Posts
        From `posts`, for the same cells.
    limit : ndarray, shape (n, 2)
        The engine in the limit of small steps; NaN where it is not known.
    """
    known = ~np.isnan(limit).any(axis=1, keepdims=True)
    other = between.compliant if between.alternative is None else between.alternative
    steps = [(FROZEN, between.bistiffness - model), (LAW, other - between.bistiffness)]
    if between.alternative is not None:
        steps.append((CHOICE, between.compliant - other))
    steps += [
        (GRAVITY, between.scenario - between.compliant),
        (MAPPING, np.where(known, limit - between.scenario, np.nan)),
        (STEP, np.where(known, engine - limit, np.nan)),
        (ENGINE, np.where(known, np.nan, engine - between.scenario)),
    ]
    vectors = np.stack([vector for _, vector in steps])
    total = engine - model
    weight = np.stack([np.ones_like(mass_ratio), mass_ratio], axis=1)
    norms = np.sqrt((weight * vectors**2).sum(axis=2))
    divergence = np.sqrt((weight * total**2).sum(axis=1))
    with np.errstate(invalid="ignore", divide="ignore"):
        along = (weight * vectors * total).sum(axis=2) / divergence
    return Split(tuple(rung for rung, _ in steps), vectors, total, norms, along, divergence)
