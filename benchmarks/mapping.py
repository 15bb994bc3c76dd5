"""Single contacts in engines: the error of the restitution by both mappings, and pasted text in scenes made by hand.

Run as ``python -m benchmarks.mapping [ENGINE ...]``. In the first table a row is the worst of 63 contacts, e from 0.2
to 1 and k from 1e2 to 1e8 N/m: the error of the restitution at a step of 1/1000 of the contact's period, and in the
limit dt -> 0, which is extrapolated from that step, its half, its quarter and its eighth. In the second table, 20
random pairs per engine are pasted, with the text of `impact-xval contact`, into a scene of another kind (free bodies,
boxes for floors). They meet at a random place within a step. A row has the number of pairs whose restitution is inside
the stated interval, the largest distance from the interval, and the largest error of restitution or duration over the
value asked for.
"""

import itertools
import math
import sys
from dataclasses import replace

import numpy as np
from rich.console import Console
from rich.table import Table

from impact_xval.compliant_baselines import get_solver
from impact_xval.compliant_baselines.single_contact import SingleImpact, find_largest_step, scenes_of
from tests.compliant_baselines.test_single_contact import measured, requests

RESTITUTIONS = np.arange(2, 11) / 10
STIFFNESSES = 10.0 ** np.arange(2, 9)
STEPS = 1e-3 / 2.0 ** np.arange(4)
BODIES = {"ball on table": (2 / 3**0.5, math.inf), "ball on ball": (1.0, 2 / 3**0.5)}


def errors(engine, masses, mapping):
    """Return errors of the restitution, with a row for each contact and a column for each step."""
    found = []
    for e, k in itertools.product(RESTITUTIONS.tolist(), STIFFNESSES.tolist()):
        pair = SingleImpact(masses, e, stiffness=k)
        asked = [scenes_of(pair, step * pair.contact.period, [0.0])[0] for step in STEPS]
        runs = engine.run([replace(scene, mapping=mapping) for scene in asked], 10_000_000)
        ends = np.array([run.velocities for run in runs])
        found.append((ends[:, 1] if pair.fixed else ends[:, 0] - ends[:, 1]) / pair.speed - e)
    return np.array(found)


def pasted(engine, n=20):
    """Return, for n random pairs, the distance of e from its stated interval over e, and the relative error."""
    rng, left, missed = np.random.default_rng(1), [], []
    for pair in requests(n):
        found = find_largest_step(engine, pair)
        e, duration = measured(engine.name, pair, found.step, rng.uniform())
        low, high = found.restitution
        left.append(max(low - e, e - high, 0) / pair.restitution)
        missed += [abs(e / pair.restitution - 1), abs(duration / pair.contact.duration - 1)]
    return np.array(left), np.array(missed)


def main() -> None:
    """Print the worst errors by engine, kind of contact and mapping, and the results of pasted contacts."""
    given = Table("engine", "contact", "mapping", "error of e at 1/1000 of a period", "dt -> 0")
    by_hand = Table("engine", "pasted", "e inside the interval", "left by at most", "largest error of e or T")
    for name in sys.argv[1:] or ("mujoco", "pybullet", "drake"):
        engine = get_solver(name)
        if (reason := engine.unavailable()) is not None:
            given.add_row(name, reason)
            continue
        for (contact, masses), mapping in itertools.product(BODIES.items(), ("calibrated", "naive")):
            off = errors(engine, masses, mapping)
            limit = 2 * off[:, -1] - off[:, -2]
            given.add_row(name, contact, mapping, *(f"{np.abs(x).max():.1e}" for x in (off[:, 0], limit)))
        left, missed = pasted(engine)
        inside = str(np.count_nonzero(left == 0))
        by_hand.add_row(name, str(left.size), inside, f"{left.max():.1e}", f"{missed.max():.1e}")
    for table in (given, by_hand):
        Console(width=110).print(table)


if __name__ == "__main__":
    main()
