"""Trials computed by a law, with planted parameters."""

import numpy as np
import pandas as pd

from impact_xval.experiments.fit.laws import LAWS

RATIOS = np.geomspace(0.4, 3.0, 6)


def trials(law, point, ratios=RATIOS, sd=0.01, noise=None):
    ratios = np.asarray(ratios, float)
    v1, v2 = LAWS[law].velocities(np.asarray(point, float), ratios)
    if noise is not None:
        v1, v2 = np.array([v1, v2]) + sd * np.random.default_rng(noise).standard_normal((2, len(ratios)))
    return table(ratios, v1, v2, sd)


def table(ratios, v1, v2, sd=0.01, speed=1.0):
    return pd.DataFrame(
        {
            "m1 [kg]": 0.5,
            "m2 [kg]": 0.5 * np.asarray(ratios),
            "v1_before [m/s]": -speed,
            "v1_after [m/s]": speed * np.asarray(v1),
            "v2_after [m/s]": speed * np.asarray(v2),
            "sd_v1_after [m/s]": speed * sd,
            "sd_v2_after [m/s]": speed * sd,
        }
    )
