"""Solvers under test: arrays of ratios in, velocities with an error and a status out.

Three kinds, told apart by how exact their outcomes are:

* `exact`: the model and the engine-free references, compiled and without a step; their error is rounding, and they
  run in the process of the caller;
* `stepped`: engines. Each collision is run at three steps, h, h/2 and h/4, and extrapolated to dt -> 0.
* `single`: any other solver of the registry, collision by collision; taken as exact.

What is not of this project can crash or hang: the last two run in processes of their own, and a collision that ends its
process twice, or takes longer than `cell_timeout`, has the status ``crashed`` or ``timeout`` (`process.in_halves`).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Literal

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray

from impact_xval.compliant_baselines import get_solver, references, registry, solver_names
from impact_xval.compliant_baselines.answers import answer
from impact_xval.compliant_baselines.engines.convergence import extrapolated
from impact_xval.compliant_baselines.engines.engine import Engine
from impact_xval.compliant_baselines.solver import Settings
from impact_xval.experiments.sweep.rows import Resolve
from impact_xval.model import Collision, solve_batch
from impact_xval.model.collision import RESULT_STATUSES

Floats = NDArray[np.float64]
Kind = Literal["exact", "stepped", "single"]

#: Events after which the model gives a collision up here (status ``unconverged``): elastic contacts ring through
#: about sqrt(contrast) of them. A tenth of a second.
MAX_EVENTS = 300_000

#: Steps after which an engine gives up.
MAX_STEPS = 50_000_000

#: Least error of an engine's outcome, per abs(v0), however short the step: MuJoCo's smallest impedance makes its
#: contacts differ by so much from springs and dashpots (`mapping`).
LEAST_ERROR = 1e-4

#: Rounding of an exact solver's velocities, per abs(v0).
ROUNDING = 1e-13


def outcomes_of(
    v1: ArrayLike,
    v2: ArrayLike,
    error: ArrayLike = ROUNDING,
    status: ArrayLike = "ok",
    grazing_margin: ArrayLike = math.inf,
    reason: ArrayLike = "",
) -> pd.DataFrame:
    """Make a frame of the outcomes of n collisions.

    Parameters
    ----------
    v1, v2 : array_like, shape (n,)
        Per abs(v0), NaN where `status` and `reason` state why.
    error : array_like, shape (n,) or ()
        Of the velocities, in the kinetic norm: rounding, or what is left of the step.
    status, reason : array_like of str, shape (n,) or ()
        As of an `Outcome`; a reason is never empty where the status is no result.
    grazing_margin : array_like, shape (n,) or ()
        Of the model; infinite for others.
    """
    columns: dict[str, Any] = {"v1": v1, "v2": v2, "error": error, "status": status}
    return pd.DataFrame(columns | {"grazing_margin": grazing_margin, "reason": reason})


#: Gives the outcomes (`outcomes_of`) of arrays k2/k1, m2/m1, e1, e2 of one shape (n,).
Solve = Callable[[Floats, Floats, Floats, Floats], pd.DataFrame]


@dataclass(frozen=True, slots=True)
class SolverUnderTest:
    """A solver under test.

    Attributes
    ----------
    name : str
    kind : str
        `exact`, `stepped` or `single`.
    solve : callable
        Can be sent to another process.
    family : str
        Whose predictions apply (`predictions`): its name; ``kelvin-voigt`` for an engine of every run, whose mapping is
        calibrated; ``none`` for one that is run on request.
    costly : bool
        Whether its step costs ten times that of other engines: it runs at a third of the steps in a period, over a
        decade less of contrast, and on one map of half the size.
    """

    name: str
    kind: Kind
    solve: Solve
    family: str
    costly: bool = False


def model_batch(
    kappa: Floats, mu: Floats, e1: Floats, e2: Floats, impact_law: str = "jia-mason-erdmann"
) -> pd.DataFrame:
    """Solve by the model, its cut-off off, under one of its impact laws."""
    batch = solve_batch(
        kappa,
        mu,
        e1,
        e2,
        stiffness_ratio_cutoff=math.inf,
        max_events=MAX_EVENTS,
        law=impact_law,
    )
    gave_up = np.where(batch.statuses == "unconverged", f"not over after {MAX_EVENTS} events", "")
    error = ROUNDING + np.abs(batch.diagnostics["energy_residual"])
    return outcomes_of(batch.v1, batch.v2, error, batch.statuses, batch.grazing_margin, gave_up)


def _reference(law: str, kappa: Floats, mu: Floats, e1: Floats, e2: Floats) -> pd.DataFrame:
    found = references.solve_batch(law, kappa, mu, e1, e2)
    reason = np.where(found.statuses == "timeout", "not over after the most segments a reference follows", "")
    reason = np.where(found.statuses == "unrepresentable", "the law has no such contact", reason)
    return outcomes_of(found.v1, found.v2, status=found.statuses, reason=reason)


_EXACT: dict[str, Solve] = {
    "state-transition": model_batch,
    "liu-zhao-brogliato": partial(model_batch, impact_law="liu-zhao-brogliato"),
    **{law: partial(_reference, law) for law in references.LAWS},
}


def one_by_one(
    resolve: Resolve, name: str, settings: Settings, kappa: Floats, mu: Floats, e1: Floats, e2: Floats
) -> pd.DataFrame:
    """Solve by a solver of the registry, collision by collision, as given in the settings."""
    collisions = [Collision.from_ratios(*map(float, row)) for row in zip(kappa, mu, e1, e2, strict=True)]
    outcomes = answer(resolve(name), collisions, settings)
    margins = [math.inf if o.grazing_margin is None else o.grazing_margin for o in outcomes]
    return outcomes_of(
        [o.v1 for o in outcomes],
        [o.v2 for o in outcomes],
        status=[o.status for o in outcomes],
        grazing_margin=margins,
        reason=[o.reason for o in outcomes],
    )


def at_no_step(
    resolve: Resolve, name: str, settings: Settings, kappa: Floats, mu: Floats, e1: Floats, e2: Floats
) -> pd.DataFrame:
    """Run an engine at the steps h, h/2, h/4, and extrapolate to dt -> 0.

    Richardson's table for errors in h and h^2 gives the answer. Its columns change the finest run by s1 = v(h/4) -
    v(h/2), then by s2; the error is the next term of that series, s2 min(1, 2 s2/s1), plus `LEAST_ERROR`. Backward
    Euler (PyBullet), whose errors are smooth in h, has s2 << s1; an explicit engine, whose contacts begin between two
    steps, s2 of about s1. `judge` spreads errors over neighbouring contrasts, since a difference can vanish by chance.
    """
    fractions = [settings.step_fraction / 2**level for level in range(3)]
    runs = [
        one_by_one(resolve, name, replace(settings, step_fraction=fraction), kappa, mu, e1, e2)
        for fraction in fractions
    ]
    values = np.array([run[["v1", "v2"]] for run in runs])
    coarse, fine = extrapolated(values)

    def norm(dv: Floats) -> Floats:
        return np.hypot(dv[:, 0], np.sqrt(mu) * dv[:, 1])

    second, first = norm((fine - coarse) / 3), norm(values[2] - values[1])
    error = second * np.minimum(1, 2 * second / np.maximum(first, 1e-300)) + LEAST_ERROR
    v1, v2 = ((4 * fine - coarse) / 3).T
    found = outcomes_of(v1, v2, error, runs[2].status, reason=runs[2].reason)
    for run in runs[:2]:
        failed = ~run.status.isin(RESULT_STATUSES)
        found.loc[failed, ["status", "reason"]] = run
    found.loc[~found.status.isin(RESULT_STATUSES), ["v1", "v2", "error"]] = math.nan
    return found


def default_names() -> list[str]:
    """Names of the solvers tested unless a configuration says otherwise: those of every run, and all references."""
    usual = solver_names()
    return [name for name in solver_names(on_request=True) if name in usual or name in _EXACT]


def under_test(name: str, steps: int, resolve: Resolve = get_solver) -> SolverUnderTest:
    """Put a solver under test.

    Parameters
    ----------
    name : str
        Of the registry.
    steps : int
        Steps in a period of the stiffer contact at the longest of an engine's three steps.
    resolve : callable
        Finds the solver, here and in every process it is sent to; at the top level of a module.
    """
    if name in _EXACT:
        return SolverUnderTest(name, "exact", _EXACT[name], name)
    costly = registry.is_costly(name)
    fraction = (3 if costly else 1) / steps
    settings = Settings(
        step_fraction=fraction, stiffness_ratio_cutoff=math.inf, mark=False, max_steps=MAX_STEPS
    )
    if registry.is_ours(name) and isinstance(resolve(name), Engine):
        family = "kelvin-voigt" if name in solver_names() else "none"
        return SolverUnderTest(name, "stepped", partial(at_no_step, resolve, name, settings), family, costly)
    return SolverUnderTest(name, "single", partial(one_by_one, resolve, name, settings), name)
