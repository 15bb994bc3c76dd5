"""Restitution and duration of the text for each engine, asked for and measured (docs/contacts-in-engines.md).

Run as ``python -m benchmarks.targets [NAME ...]``, names as after `contact --engine`. A ball of 1 kg meets a fixed
body, and a body of 3 kg, at 1 m/s. e is 0.5 and 0.8, k is 1e4 N/m, and the step is 1/200 of the contact. There are five
places of the touch within a step. For an engine that is not installed the script prints a line.
"""

import math
import sys

from impact_xval.compliant_baselines.engines.engine import version_of
from impact_xval.compliant_baselines.solver import SolverError
from impact_xval.compliant_baselines.target_drops import drop_target, missing_distribution
from impact_xval.compliant_baselines.targets import TARGETS, ContactRequest, targets_for

STIFFNESS, STEPS_IN_CONTACT = 1e4, 200


def requests():
    """Yield the four contacts: each of two restitutions, against a fixed body and against a body of 3 kg."""
    for e in (0.5, 0.8):
        for other in (math.inf, 3.0):
            longest = ContactRequest.between((1.0, other), e, STIFFNESS, 1.0)
            step = float(f"{longest.contact.duration / STEPS_IN_CONTACT:.3g}")
            yield longest._replace(step=step)


def main():
    names = sys.argv[1:] or list(TARGETS)
    for target in (target for name in names for target in targets_for(name)):
        missing = missing_distribution(target)
        if missing is not None:
            print(f"{target.name}: not run: {missing}")
            continue
        version = version_of(target.distributions[0])
        for request in requests():
            asked = f"{target.name} {version}, 1 kg on {request.masses[1]:g} kg, e = {request.restitution}"
            try:
                given = drop_target(target, request)
            except SolverError as error:
                print(f"{asked}: {error.status}: {error.reason}", flush=True)
                continue
            line = f"{asked}: {given.restitution[0]:.4f} to {given.restitution[1]:.4f}"
            if target.kind == "compliant":
                exact = target.duration(request) or request.contact.duration
                low, high = (duration / exact for duration in given.duration)
                law = "its law's" if target.duration(request) else "the spring's"
                line += f", {low:.4f} to {high:.4f} times {law} duration"
            print(line, flush=True)


if __name__ == "__main__":
    main()
