"""Find the exact law that an engine's answers follow. Needs only numpy and the file impact-set-1.json.

Run every case of the set in your engine, without gravity and friction. The balls stand in a line, and touch or are
`gaps` apart. An engine that takes coefficients of restitution needs `restitutions`, an engine with springs also needs
`stiffnesses`. Write a JSON file that holds, by the name of each case, the final velocities in m/s. Then run

    python check_impact_set.py answers.json

or call `check` from a test. The distance from a law is D = sqrt(sum m (v - w)^2 / sum m v0^2). Here m are the masses, v
the final velocities of the engine, w those of the law, and v0 the velocities at the start. Some laws have no outcome
for some cases, so the number of compared cases differs from law to law. More energy than at the start need not be a
fault of the engine: with unequal restitutions Newton's law itself may create energy.
"""

import json
import sys
from pathlib import Path

import numpy as np

SET = Path(__file__).with_name("impact-set-1.json")


def distance(case, velocities, law):
    """Return the distance D of velocities from a law, or None if the law has no outcome for the case."""
    if law not in case["outcomes"]:
        return None
    m, v0 = np.array(case["masses"]), np.array(case["velocities"])
    away = np.subtract(velocities, case["outcomes"][law])
    return float(np.sqrt(m @ away**2 / (m @ v0**2)))


def check(answers, tolerance=1e-3):
    """Compare an engine's answers, which are final velocities by the name of a case, with every law.

    Returns a row for each law, the nearest law first: its name, the number of cases with D within the tolerance, the
    number of cases that were compared, and the largest D.
    """
    cases = [case for case in json.loads(SET.read_text(encoding="utf-8"))["cases"] if case["name"] in answers]
    if not cases:
        raise ValueError("no case of the set is among the answers")
    rows = []
    for law in {law: None for case in cases for law in case["outcomes"]}:
        found = [distance(case, answers[case["name"]], law) for case in cases]
        found = np.array([D for D in found if D is not None])
        rows.append((law, int(np.sum(found <= tolerance)), found.size, float(found.max())))
    return sorted(rows, key=lambda row: (-row[1], row[3]))


def main(path):
    """Print the laws, the nearest first, and the cases in which energy grows or momentum changes."""
    answers = json.loads(Path(path).read_text(encoding="utf-8"))
    print(f"{'law':28} within 1e-3   largest D")
    for law, near, of, largest in check(answers):
        print(f"{law:28} {near:4d} of {of:3d}   {largest:.2g}")
    for case in json.loads(SET.read_text(encoding="utf-8"))["cases"]:
        if case["name"] in answers:
            m, v, v0 = (np.array(x) for x in (case["masses"], answers[case["name"]], case["velocities"]))
            if m @ v**2 > 1.001 * (m @ v0**2):
                print(f"{case['name']}: energy is {m @ v**2 / (m @ v0**2):.3f} of what it was")
            if not case["table"] and abs(m @ v - m @ v0) > 1e-3 * abs(m) @ abs(v0):
                print(f"{case['name']}: momentum is {m @ v:.3f} kg m/s, and was {m @ v0:.3f}")


if __name__ == "__main__":
    if sys.argv[1:] in (["-h"], ["--help"]):
        print(__doc__)
    elif len(sys.argv) == 2:
        main(sys.argv[1])
    else:
        sys.exit(__doc__)
