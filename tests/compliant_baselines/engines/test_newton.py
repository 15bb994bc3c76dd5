"""Dashpots in compression only: the exact law against an integration that watches nothing, and Newton against the law."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from impact_xval.compliant_baselines import Settings, get_solver
from impact_xval.compliant_baselines.restitution import compression_damping_ratio
from impact_xval.model import Collision
from tests.compliant_baselines.references.test_columns import with_gaps
from tests.model.test_columns import random_column

LAW = "compression-dashpot"


def by_force_alone(column, duration, exponent=1.0):
    """Final velocities: the force is a continuous function of positions and velocities, so that no event is needed."""
    n, table = len(column.masses), [0.0] if column.table else []
    inverse = 1 / np.array([*column.masses, *([np.inf] if column.table else [])])
    k, mass = np.array(column.stiffnesses), 1 / (inverse[1:] + inverse[:-1])
    # zeta of e: half of a damped cycle ends at exp(-zeta arctan(w/zeta)/w), w = sqrt(1 - zeta^2).
    ratios = np.array([_damping_ratio(e) for e in column.restitutions])
    c = 2 * ratios * np.sqrt(0.5 * (exponent + 1) * k * mass)

    def motion(_time, state):
        x, v = state[:n], state[n:]
        depth, rate = np.diff([*x, *table]) - column.gaps, np.diff([*v, *table])
        depth = np.maximum(depth, 0)
        dashpot = c * np.maximum(rate, 0) * (depth ** (0.5 * (exponent - 1)) if exponent != 1 else depth > 0)
        force = np.array([0, *(k * depth**exponent + dashpot), 0])
        return np.concatenate([v, inverse[:n] * (force[1:] - force[:-1])[:n]])

    start = np.concatenate([np.zeros(n), column.velocities])
    done = solve_ivp(motion, (0, duration), start, method="DOP853", rtol=1e-10, atol=1e-13, max_step=0.02)
    assert done.success
    return done.y[n:, -1]
