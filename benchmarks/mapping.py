"""Single contacts, requested and given: the restitution of both mappings over e, k and the two kinds of contact.

Run as ``python -m benchmarks.mapping [ENGINE ...]``. A row is the worst of 63 contacts, e from 0.2 to 1 and k from
1e2 to 1e8 N/m: the error of the restitution at a step of 1/1000 of the contact's period, and in the limit dt -> 0,
which is extrapolated from that step, its half, its quarter and its eighth.
"""

import itertools
import math
import sys
from dataclasses import replace

import numpy as np
from rich.console import Console
from rich.table import Table

from impact_xval.compliant_baselines import get_solver
from impact_xval.compliant_baselines.engines.convergence import extrapolated
from impact_xval.compliant_baselines.mapping import Contact
from impact_xval.compliant_baselines.registry import engine_names
from impact_xval.compliant_baselines.single_contact import Pair, columns

RESTITUTIONS = np.arange(2, 11) / 10
STIFFNESSES = 10.0 ** np.arange(2, 9)
STEPS = 1e-3 / 2.0 ** np.arange(4)
BODIES = {"ball on table": (2 / 3**0.5, math.inf), "ball on ball": (1.0, 2 / 3**0.5)}


def errors(solver, masses, mapping):
    """Errors of the restitution, a row a contact, a column a step."""
    found = []
    for e, k in itertools.product(RESTITUTIONS.tolist(), STIFFNESSES.tolist()):
        pair = Pair(masses, e, stiffness=k)
        given = Contact.from_restitution(k, e, pair.mass, mapping)
        asked = [columns(pair, step * pair.contact.period, [0.0])[0] for step in STEPS]
        asked = [replace(each, contact1=given, contact2=given, mapping=mapping) for each in asked]
        runs = solver.run_columns(asked, 10_000_000)
        found.append([(run.v2 if pair.fixed else run.v1 - run.v2) / pair.speed - e for run in runs])
    return np.array(found)


def main() -> None:
    """Print the worst errors by engine, kind of contact and mapping."""
    table = Table("engine", "contact", "mapping", "error of e at 1/1000 of a period", "dt -> 0")
    for name in sys.argv[1:] or engine_names():
        solver = get_solver(name)
        if (reason := solver.unavailable()) is not None:
            table.add_row(name, reason)
            continue
        for (contact, masses), mapping in itertools.product(BODIES.items(), ("calibrated", "naive")):
            off = errors(solver, masses, mapping)
            limit = extrapolated(off.T[..., None])[-1]
            table.add_row(name, contact, mapping, *(f"{np.abs(x).max():.1e}" for x in (off[:, 0], limit)))
    Console(width=110).print(table)


if __name__ == "__main__":
    main()
