"""Random collisions for tests of the references, functions that solve them by a law, and their damping coefficients."""

from dataclasses import replace
from functools import partial

import numpy as np

from impact_xval.compliant_baselines import references
from impact_xval.model import Collision, Collisions, GridOutcomes


def solve_batch(law, stiffness_ratio, mass_ratio, e1, e2, gravity_number=0.0, **how):
    """Solve two balls on a table by a law, with m1 = 1 kg, k1 = 1 N/m and v0 = -1 m/s. Arrays are broadcast."""
    cells = np.broadcast_arrays(stiffness_ratio, mass_ratio, e1, e2, gravity_number)
    *ratios, number = (np.ravel(np.asarray(each, float)) for each in cells)
    how = {"gravity": number * np.sqrt(1 + 1 / ratios[1]), "states": False} | how
    outcomes = references.solve_by_law(Collisions.from_ratios(*ratios), law, **how)
    return GridOutcomes(outcomes, cells[0].shape)


#: For each law, the function that solves many pairs on a table.
BATCHES = {law: partial(solve_batch, law) for law in references.LAWS}


def in_time(collision, law="kelvin-voigt", *, exponent=1.0, path=False, **how):
    some = Collisions.of([replace(collision, exponent=exponent)])
    return references.solve_by_law(some, law, paths=path, **how)[0]


def dampings(law, *cells):
    """Return c1 and c2 (or Hunt and Crossley's a1 and a2) of pairs in units of the collision, shape (n,) each."""
    return references.dampings(Collisions.from_ratios(*cells), law).T


def coefficients_of(collision, law, exponent):
    """Return the damping coefficient of each contact in SI units: c, or a of Hunt and Crossley's law."""
    some = Collisions.of([replace(collision, exponent=exponent)])
    (found,), (speed,) = references.dampings(some, law), some.units[1]
    if law == "hunt-crossley":
        return found / speed
    return found * np.sqrt(collision.masses[0] * collision.stiffnesses[0])


def end_of(batch):
    """Return the end of each drop: "free", "rest" (B2 at rest on the table) or "stuck" (both balls at rest)."""
    rested = ~np.isnan(batch.diagnostics.get("rest_speed", np.full(batch.v1.shape, np.nan)))
    return np.where(rested, np.where(batch.v1 == 0, "stuck", "rest"), "free")


def random_cells(n, seed, lowest_e=0.3, decades=(2, 1)):
    """Draw n pairs: k2/k1 and m2/m1 log-uniform within decades of 1, e1 and e2 uniform in [lowest_e, 1].

    The result is four arrays of shape (n,).
    """
    rng = np.random.default_rng(seed)
    kappa, mu = (10 ** rng.uniform(-each, each, n) for each in decades)
    return kappa, mu, rng.uniform(lowest_e, 1, n), rng.uniform(lowest_e, 1, n)


def two_balls(kappa, mu, e1, e2, k1=1e8, v0=-1.0):
    return Collision.two_balls(1.0, mu, k1, k1 * kappa, e1, e2, v0)


def random_collisions(*how, k1=1e8, v0=-1.0, **cells):
    return [two_balls(*cell, k1, v0) for cell in np.transpose(random_cells(*how, **cells)).tolist()]


def random_gravity(n, seed):
    """Draw n gravity numbers g/(|v0| omega1), log-uniform in [1e-3, 0.3]."""
    return 10 ** np.random.default_rng(seed).uniform(-3, -0.5, n)


def make_chain(*velocities, e=1.0, masses=None, gap=0.0, table=False):
    """Return a chain of equal balls and equal contacts with the given velocities."""
    n = len(velocities)
    k, e, gaps = ((value,) * (n - 1 + table) for value in (1.0, e, gap))
    return Collision(masses or (1.0,) * n, k, e, velocities, table, gaps)
