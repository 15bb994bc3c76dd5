"""Which exact law do an engine's answers follow? Needs numpy, impact-set-1.json, and nothing else.

Run every case of the set in an engine, without gravity and friction: balls in a line that touch, or are `gaps` apart;
`restitutions` for engines that take them, `stiffnesses` for those that have springs. Then write what it answers, the
final velocities in m/s by the name of the case, as JSON, and run

    python check_impact_set.py answers.json

or call `check` from a test. D is sqrt(sum m (v - w)^2 / sum m v0^2), of velocities v and those of the law w.
"""

import json
import sys
from pathlib import Path

import numpy as np

SET = Path(__file__).with_name("impact-set-1.json")


def distance(case, velocities, law):
    """Give D from a law, or None where the law has no outcome."""
    if law not in case["outcomes"]:
        return None
    m, v0 = np.array(case["masses"]), np.array(case["velocities"])
    away = np.subtract(velocities, case["outcomes"][law])
    return float(np.sqrt(m @ away**2 / (m @ v0**2)))


def check(answers, tolerance=1e-3):
    """Hold answers, velocities by the name of a case, against every law.

    Returns rows, the nearest law first: law, cases within the tolerance, cases compared, largest D.
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
    """Print the laws, the nearest first, and what is wrong with energy and momentum."""
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
    main(sys.argv[1]) if len(sys.argv) == 2 else sys.exit(__doc__)
