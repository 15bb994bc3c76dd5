"""Find the exact law that an engine's answers follow. Needs only numpy and the file impact-set-1.json.

Run every case of the set in your engine, without gravity and friction. The balls stand in a line, and touch or are
`gaps` apart. An engine that takes coefficients of restitution e needs `restitutions`. An engine of springs also needs
`stiffnesses`, and a damping for each e. If your engine has a rule that turns e into a damping, use this rule. If it has
none, use the damping of the law `kelvin-voigt`, c = 2 zeta sqrt(k M). Here k is the stiffness of the contact, M the
reduced mass of its two bodies (at the table the mass of the ball), and zeta the solution of

    e = exp(-zeta/w atan2(2 zeta w, 2 zeta^2 - 1)),    w = sqrt(1 - zeta^2)

(docs/mapping.md of impact-xval, section 1). For e = 0.9 zeta is 0.0343, for e = 0.5 it is 0.2553. No damping gives
e = 0.

Write a JSON file that holds, by the name of each case, the final velocities in m/s from ball 1 on, or `null` if your
engine has no answer, for example at e = 0. Then run

    python check_impact_set.py answers.json

or call `check` from a test. The script refuses a file with mistakes: a case that is missing, a name that the set does
not have, another number of velocities than balls, or a number that is not finite. Each mistake has its line, and the
exit code is 1.

The distance from a law is D = sqrt(sum m (v - w)^2 / sum m v0^2). Here m are the masses, v the final velocities of the
engine, w those of the law, and v0 the velocities at the start. A law is compared with your answers only in the cases
for which the law has an outcome: Newton's law in all 60, laws with a dashpot not at e = 0. More energy than at the
start need not be a fault of the engine: with unequal restitutions Newton's law itself may create energy.
"""

import json
import sys
from pathlib import Path

import numpy as np

SET = Path(__file__).with_name("impact-set-1.json")
CASES = {case["name"]: case for case in json.loads(SET.read_text(encoding="utf-8"))["cases"]}


def mistake(name, answers):
    """Return what is wrong with the answer to a case, or None."""
    if name not in CASES:
        return "the set has no case of this name"
    if name not in answers:
        return 'missing; write null for "no answer"'
    if answers[name] is None:
        return None
    try:
        velocities = np.array(answers[name], float)
    except (TypeError, ValueError):
        return f"{answers[name]!r} is not a list of numbers"
    balls = len(CASES[name]["masses"])
    if velocities.shape != (balls,):
        return f"{answers[name]!r} is not one velocity for each ball; balls: {balls}"
    return None if np.isfinite(velocities).all() else f"{answers[name]!r} has a number that is not finite"


def checked(answers):
    """Return the cases that have an answer, each with its velocities; raise a ValueError with a line for each mistake.

    `answers` are an engine's final velocities by the name of a case, with None for "no answer".
    """
    mistakes = {name: mistake(name, answers) for name in {**CASES, **answers}}
    lines = [f"{name}: {wrong}" for name, wrong in mistakes.items() if wrong]
    if lines:
        raise ValueError("\n".join(lines))
    pairs = [(CASES[name], np.array(v, float)) for name, v in answers.items() if v is not None]
    if not pairs:
        raise ValueError("no case has an answer")
    return pairs


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
    pairs = checked(answers)
    rows = []
    for law in {law: None for case, _ in pairs for law in case["outcomes"]}:
        found = [distance(case, velocities, law) for case, velocities in pairs]
        found = np.array([D for D in found if D is not None])
        rows.append((law, int(np.sum(found <= tolerance)), found.size, float(found.max())))
    return sorted(rows, key=lambda row: (-row[1], row[3]))


def main(path):
    """Print the laws, the nearest first, and the cases in which energy grows or momentum changes."""
    answers = json.loads(Path(path).read_text(encoding="utf-8"))
    try:
        pairs, laws = checked(answers), check(answers)
    except ValueError as error:
        sys.exit(f"{error}")
    print(f"{'law':28} within 1e-3   largest D")
    for law, near, of, largest in laws:
        print(f"{law:28} {near:4d} of {of:3d}   {largest:.2g}")
    if len(pairs) < len(CASES):
        print(f"no answer (null): {len(CASES) - len(pairs)} of {len(CASES)} cases")
    for case, v in pairs:
        m, v0 = np.array(case["masses"]), np.array(case["velocities"])
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
