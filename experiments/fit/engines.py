"""What engines would do in each trial, calibrated with the fitted parameters."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from impact_xval.compliant_baselines import get_solver
from impact_xval.compliant_baselines.contract.solver import Settings
from impact_xval.experiments.fit.fitting import FitResult, Fitted
from impact_xval.experiments.fit.laws import Floats
from impact_xval.model import Collision
from impact_xval.model.collision import RESULT_STATUSES

#: The engines, by the names of their solvers.
ENGINES = ("mujoco", "pybullet")
#: k1 in N/m where it is not known: without gravity only k2/k1 matters.
_STIFFNESS = 1e5


@dataclass(frozen=True, slots=True, eq=False)
class EngineAnswers:
    """What an engine answers to the trials.

    Attributes
    ----------
    solver, version : str
    law : str
        The law whose parameters it has.
    v1, v2 : ndarray, shape (T,)
        After, in m/s; NaN where it gave nothing.
    chi2 : float
        Of them, over the trials that it answered.
    answered : int
        Trials.
    reason : str
        Why it gave nothing somewhere.
    """

    solver: str
    version: str
    law: str
    v1: Floats
    v2: Floats
    chi2: float
    answered: int
    reason: str


def answers_of(result: FitResult) -> list[EngineAnswers]:
    """Have each engine answer the trials, with the parameters of the best law that knows a stiffness ratio.

    Returns
    -------
    list of EngineAnswers
        Empty where no such law was fitted.
    """
    compliant = next((each for each in result.fitted if "k2/k1" in each.parameters), None)
    return [] if compliant is None else [_answer(name, result, compliant) for name in ENGINES]


def _answer(name: str, result: FitResult, fitted: Fitted) -> EngineAnswers:
    t, solver, parameters = result.trials, get_solver(name), fitted.parameters
    k1 = _STIFFNESS if math.isnan(t.stiffness) else t.stiffness
    springs = k1, k1 * parameters["k2/k1"], parameters["e1"], parameters["e2"]
    collisions = [
        Collision(m1, m2, *springs, -speed) for m1, m2, speed in zip(t.m1, t.m2, t.speed, strict=True)
    ]
    reason = solver.unavailable()
    outcomes = [] if reason else solver.solve_many(collisions, Settings(mark=False))
    there = [outcome.status in RESULT_STATUSES for outcome in outcomes] or [False] * len(collisions)
    v1 = np.array([o.v1 for o in outcomes]) if outcomes else np.full(len(collisions), np.nan)
    v2 = np.array([o.v2 for o in outcomes]) if outcomes else np.full(len(collisions), np.nan)
    v1, v2 = np.where(there, v1, np.nan), np.where(there, v2, np.nan)
    squares = ((v1 / t.speed - t.v1) / t.sd1) ** 2 + ((v2 / t.speed - t.v2) / t.sd2) ** 2
    reasons = [reason or ""] + [
        f"{o.status}: {o.reason}" for o in outcomes if o.status not in RESULT_STATUSES
    ]
    chi2 = float(np.nansum(squares)) if any(there) else math.nan
    said = next((text for text in reasons if text), "")
    return EngineAnswers(name, solver.version(), fitted.law.name, v1, v2, chi2, sum(there), said)
