"""Random collisions for the references of two balls, and those references in bulk by the name of their solver."""

from functools import partial

import numpy as np

from impact_xval.compliant_baselines.references.bistiffness import bistiffness_batch
from impact_xval.compliant_baselines.references.kelvin_voigt import kelvin_voigt_batch

DAMPING = {
    "kelvin-voigt": "pair",
    "kelvin-voigt-anchored": "anchored",
    "kelvin-voigt-textbook": "textbook",
    "hunt-crossley": "hunt-crossley",
}
BATCHES = {
    "bistiffness": bistiffness_batch,
    **{law: partial(kelvin_voigt_batch, damping=damping) for law, damping in DAMPING.items()},
}


def random_cells(n, seed, lowest_e=0.3):
    """k2/k1 log-uniform in [1e-2, 1e2], m2/m1 in [0.1, 10], e uniform in [lowest_e, 1]; arrays of shape (n,)."""
    rng = np.random.default_rng(seed)
    kappa, mu = 10 ** rng.uniform(-2, 2, n), 10 ** rng.uniform(-1, 1, n)
    return kappa, mu, rng.uniform(lowest_e, 1, n), rng.uniform(lowest_e, 1, n)


def random_gravity(n, seed):
    """Gravity numbers g/(|v0| omega1), log-uniform in [1e-3, 0.3]."""
    return 10 ** np.random.default_rng(seed).uniform(-3, -0.5, n)
