"""``python -m tests.golden.inputs``: draw the collisions of the golden values once, and write them as plain JSON.

The files are the inputs; this is where they come from. No test draws them again.
"""

import json
from itertools import pairwise
from pathlib import Path

import numpy as np

from tests.golden import adapter

HERE = Path(__file__).parent
INPUTS = HERE / "inputs"


def pair(kappa, mu, e1, e2, *, m1=1.0, k1=1.0, v0=-1.0, gravity=0.0, cutoff="exact"):
    """Make a collision of two balls on a table from k2/k1, m2/m1, e1 and e2."""
    return {
        "kernel": "pair",
        "masses": [m1, m1 * mu],
        "stiffnesses": [k1, k1 * kappa],
        "restitutions": [e1, e2],
        "velocities": [v0, 0.0],
        "table": True,
        "gaps": [],
        "exponent": 1.0,
        "gravity": gravity,
        "cutoff": cutoff,
    }


def line(masses, stiffnesses, restitutions, velocities, *, table=False, gaps=(), exponent=1.0):
    """Make a collision of N balls."""
    return {
        "kernel": "chain",
        "masses": list(masses),
        "stiffnesses": list(stiffnesses),
        "restitutions": list(restitutions),
        "velocities": list(velocities),
        "table": table,
        "gaps": list(gaps),
        "exponent": exponent,
        "gravity": 0.0,
        "cutoff": "exact",
    }


def log(rng, low, high, size=None):
    """Draw numbers evenly in their logarithm, of six digits."""
    drawn = np.exp(rng.uniform(np.log(low), np.log(high), size))
    return [float(f"{x:.6g}") for x in drawn] if size else float(f"{drawn:.6g}")


def some(rng, values):
    """Draw one of some values."""
    return values[rng.integers(len(values))]


def restitution(rng, low=0.3, elastic=0.15):
    """Draw a restitution, with a share of elastic ones."""
    return 1.0 if rng.random() < elastic else round(float(rng.uniform(low, 1)), 4)


def scales(rng):
    """Draw a mass, a stiffness and a velocity in SI units."""
    return {"m1": log(rng, 1e-3, 1e3), "k1": log(rng, 1e2, 1e9), "v0": -log(rng, 0.02, 20)}


def beside_a_jump(at, solver, grid, least=1e-3):
    """Bisect a parameter to the largest jump between the values of a grid; the collisions 1e-6 and 1e-9 away from it.

    Empty where the outcome is continuous there.
    """

    def away(x, y):
        one, other = (np.array(adapter.solve(at(z), solver)["velocities"]) for z in (x, y))
        return np.abs(one - other).max() / max(map(abs, at(x)["velocities"]))

    i = int(np.argmax([away(x, y) for x, y in pairwise(grid)]))
    low, high = grid[i], grid[i + 1]
    for _ in range(60):
        middle = (low * high) ** 0.5
        if not low < middle < high:
            break
        low, high = (low, middle) if away(low, middle) > away(middle, high) else (middle, high)
    if away(low, high) < least:
        return []
    return [at(float(low) * (1 + d)) for d in (-1e-6, -1e-9, 1e-9, 1e-6)]


def two_balls(rng):
    """Draw two balls on a table, by kind."""

    def ratios(low_k, high_k, low_m, high_m, least=0.3):
        e1, e2 = restitution(rng, least), restitution(rng, least)
        return log(rng, low_k, high_k), log(rng, low_m, high_m), e1, e2

    def drop(number, kappa, mu, e1, e2):
        found = pair(kappa, mu, e1, e2, **scales(rng))
        m, k, v = found["masses"][0], found["stiffnesses"][0], -found["velocities"][0]
        return found | {"gravity": float(f"{number * v * (k / m * (1 + 1 / mu)) ** 0.5:.6g}")}

    ends = (0.0, 1e-8, 1e-6, 1e6, 1e8, np.inf)
    steep = [ratios(1e-4, 1e4, 0.2, 5, 0.3) for _ in range(6)]
    grid = np.geomspace(1e-2, 1e2, 401)
    kinds = {
        "impact": [pair(*ratios(1e-3, 1e3, 0.05, 20), **scales(rng)) for _ in range(100)],
        "far": [pair(*ratios(1e-4, 1e4, 1e-4, 1e4, 0.5), **scales(rng)) for _ in range(30)],
        "corner": [
            pair(kappa, mu, e, 0.7, **scales(rng))
            for kappa in (1e-4, 1e4)
            for mu in (1e-4, 1e4)
            for e in (0.5, 1.0)
        ],
        "drop": [drop(log(rng, 1e-6, 1e-2), *ratios(1e-2, 1e2, 0.1, 10)) for _ in range(45)],
        "heavy-drop": [drop(log(rng, 1e-2, 3), *ratios(1e-2, 1e2, 0.1, 10)) for _ in range(25)],
        "limit": [
            pair(kappa, mu, e1, e2, **scales(rng))
            for kappa in ends
            for mu, e1, e2 in ((0.5, 0.8, 0.6), (2.0, 0.9, 0.7), (5.0, 0.9, 0.3), (1.0, 1.0, 1.0))
        ],
        "soft": [pair(1.0, mu, 0.9, 0.7) | {"stiffnesses": [0.0, 1e6]} for mu in (0.5, 1.0, 3.0)],
        "plastic": [
            pair(kappa, mu, e1, e2, **scales(rng))
            for kappa in (0.05, 1.0, 30.0)
            for mu in (0.4, 3.0)
            for e1, e2 in ((0.0, 0.0), (0.0, 0.8), (0.8, 0.0), (1.0, 0.0), (0.0, 1.0), (1e-4, 0.9))
        ],
        "tie": [
            pair(kappa, mu, e, e, k1=k1)
            for kappa, mu in ((1.0, 1.0), (4.0, 1.0), (0.25, 1.0), (1.0, 2.0), (2.0, 0.5), (3.0, 3.0))
            for e, k1 in ((1.0, 1.0), (0.5, 1.0), (0.9, 1e8))
        ],
        "cut-off": [pair(*four, cutoff=cutoff) for four in steep for cutoff in ("exact", 1e5, "inf")],
        "paper": [pair(kappa, 2 / 3**0.5, 0.9, 0.7) for kappa in (40.0, 1.0, 1 / 40)],
        "grazing": [],
        "grazing-in-time": [],
        "grazing-drop": [],
        "unrepresentable": [pair(1.0, mu, 0.9, 0.7) for mu in (1e160, 1e-160, 1e10)],
    }
    for kind, solver, count in (
        ("grazing", "state-transition", 8),
        ("grazing-in-time", "bistiffness", 3),
        ("grazing-drop", "kelvin-voigt", 3),
    ):
        while len(kinds[kind]) < 4 * count:
            e1, e2, mu, units = restitution(rng), restitution(rng), log(rng, 0.3, 3), scales(rng)
            gravity = (
                0.05 * -units["v0"] * (units["k1"] / units["m1"]) ** 0.5 if kind == "grazing-drop" else 0.0
            )
            gravity = float(f"{gravity:.6g}")

            def at(kappa, mu=mu, e1=e1, e2=e2, units=units, gravity=gravity):
                return pair(kappa, mu, e1, e2, **units, gravity=gravity)

            kinds[kind] += beside_a_jump(at, solver, grid)
    return kinds


def lines(rng):
    """Draw N balls in a line, by kind."""

    def arranged(arrangement, n, e, *, exponent=1.0, gap=0.0, mass=1.0, stiffness=1.0, striking=1, **units):
        units = {"m1": 1.0, "k1": 1e8, "v0": -1.0} | units
        table = arrangement in ("drop", "stack")
        striking = n if arrangement == "stack" else striking
        contacts = n - 1 + table
        return line(
            [units["m1"] * mass**i for i in range(n)],
            [units["k1"] * stiffness**i for i in range(contacts)],
            [e] * contacts,
            [units["v0"]] * striking + [0.0] * (n - striking),
            table=table,
            gaps=[gap if gap and i != striking - 1 else 0.0 for i in range(contacts)],
            exponent=exponent,
        )

    def unlike(n, *, table, exponent=1.0, gaps=False, least=0.5):
        contacts, v0 = n - 1 + table, -log(rng, 0.05, 10)
        masses, stiffnesses = log(rng, 0.1, 10, n), log(rng, 1e6, 1e9, contacts)
        depth = abs(v0) * (masses[0] / stiffnesses[0]) ** 0.5
        return line(
            masses,
            stiffnesses,
            [restitution(rng, least) for _ in range(contacts)],
            [v0, *(round(float(v0 * rng.uniform(0, 0.3)), 6) for _ in range(n - 1))],
            table=bool(table),
            gaps=[0.0, *(float(f"{depth * rng.uniform(0, 2):.6g}") for _ in range(contacts - 1))]
            if gaps
            else (),
            exponent=exponent,
        )

    def busy(count, **more):
        found = []
        while len(found) < count:
            one = unlike(int(rng.integers(4, 7)), table=True, **more)
            found += [one] if 45 <= adapter.solve(one, "state-transition").get("events", 0) <= 55 else []
        return found

    four = ("chain", "cradle", "drop", "stack")
    kinds = {
        "chain": [arranged("chain", n, e, **scales(rng)) for n in range(2, 9) for e in (1.0, 0.9)],
        "cradle": [
            arranged("cradle", n, 0.95, striking=j, **scales(rng)) for n in range(3, 9) for j in (1, 2)
        ],
        "drop": [arranged("drop", n, e, **scales(rng)) for n in range(2, 9) for e in (1.0, 0.8)],
        "stack": [arranged("stack", n, e, **scales(rng)) for n in range(1, 9) for e in (1.0, 0.8)],
        "tie": [arranged(a, n, e, k1=1.0) for a in four for n in (3, 4) for e in (1.0, 0.5)],
        "taper": [
            arranged(a, n, 0.9, mass=0.7, stiffness=1.3, **scales(rng)) for a in four for n in (3, 5, 8)
        ],
        "hertz": [
            arranged(a, n, e, exponent=1.5, k1=log(rng, 1e7, 1e10))
            for a in four
            for n in (2, 3, 5)
            for e in (1.0, 0.85)
        ],
        "gap": [
            arranged(a, n, 0.9, gap=gap, exponent=p)
            for a in four
            for n in (3, 5)
            for gap, p in ((1e-7, 1.0), (1e-4, 1.0), (1e-5, 1.5))
        ],
        "unlike": [
            unlike(n, table=t) for n in range(1, 9) for t in (False, True) if n > 1 or t for _ in range(2)
        ],
        "unlike-hertz": [
            unlike(n, table=t, exponent=1.5) for n in (2, 3, 4, 5) for t in (False, True) for _ in range(2)
        ],
        "unlike-gaps": [
            unlike(n, table=t, gaps=True) for n in (3, 4, 5) for t in (False, True) for _ in range(2)
        ],
        "plastic": [
            line(
                [1.0, 2.0, 0.5], [1e8, 2e8, 1e8][: 2 + t], es[: 2 + t], [-1.0, 0.0, 0.0], table=t, exponent=p
            )
            for t in (False, True)
            for p in (1.0, 1.5)
            for es in ([0.0, 0.8, 0.9], [0.8, 0.0, 0.6], [0.0, 0.0, 0.0])
        ],
        "busy": busy(6) + busy(2, exponent=1.5),
        "far": [
            line([1.0, 1e4, 1.0], [1e8, 1e8], [0.9, 0.8], [-2.0, 0.0, 0.0]),
            line([1.0, 1e-4, 1.0], [1e8, 1e6], [0.9, 0.8], [-2.0, 0.0, 0.0]),
            line([1.0, 1.0, 1.0], [1e8, 1e4, 1e8], [0.9, 0.8, 0.7], [-2.0, 0.0, 0.0], table=True),
            line([1.0, 1.0, 1.0], [1e4, 1e8, 1e4], [1.0, 1.0, 0.7], [-2.0, 0.0, 0.0], table=True),
            line([1.0, 1e20, 1.0], [1e8, 1e8], [0.9, 0.8], [-2.0, 0.0, 0.0]),
        ],
        "grazing": [],
    }
    while len(kinds["grazing"]) < 16:
        base = unlike(int(rng.integers(3, 5)), table=bool(rng.integers(2)))

        def at(k, base=base):
            return base | {"stiffnesses": [*base["stiffnesses"][:-1], float(k)]}

        kinds["grazing"] += beside_a_jump(at, "state-transition", np.geomspace(1e6, 1e9, 301))
    return kinds


def engines(rng):
    """Draw the collisions of the engines."""
    stiff = {"m1": 0.5, "k1": 2e7, "v0": -1.5}
    ratios = [(1.0, 1.0, 0.9, 0.7), (0.05, 2.0, 0.8, 0.6), (20.0, 0.5, 0.95, 0.9), (3.0, 3.0, 0.5, 1.0)]
    ratios += [(log(rng, 0.1, 10), log(rng, 0.3, 3), restitution(rng), restitution(rng)) for _ in range(4)]
    return {
        "impact": [pair(*four, **stiff) for four in ratios],
        "drop": [pair(*four, **stiff, gravity=9.81) for four in ratios],
        "four": [
            line(
                log(rng, 0.3, 3, 4),
                log(rng, 1e7, 1e8, 3 + table),
                [restitution(rng) for _ in range(3 + table)],
                [-1.0] * (4 if striking == 4 else striking) + [0.0] * (4 - striking),
                table=table,
            )
            for table, striking in ((False, 1), (False, 2), (True, 1), (True, 4))
            for _ in range(2)
        ],
    }


#: The solvers whose paths are kept, in the order of their collisions: m the model, z the law of Liu, Zhao and
#: Brogliato, b bistiffness, k Kelvin-Voigt, h Hunt-Crossley.
PATHS = {"pair": "mbkkbhmzmb", "chain": "mbkhmkmkzb"}
_LETTERS = {
    "m": "state-transition",
    "z": "liu-zhao-brogliato",
    "b": "bistiffness",
    "k": "kelvin-voigt",
    "h": "hunt-crossley",
}


def followed(problems, letters):
    """Name the solver of each path."""
    return [{"solver": _LETTERS[one]} | problem for one, problem in zip(letters, problems, strict=True)]


def write(name, kinds):
    """Write collisions, one a line, each with a name of its own."""
    with (INPUTS / f"{name}.jsonl").open("w") as file:
        for kind, problems in kinds.items():
            for i, problem in enumerate(problems, 1):
                spelled = {
                    key: [adapter.plain(x) for x in value] if isinstance(value, list) else value
                    for key, value in problem.items()
                }
                file.write(json.dumps({"name": f"{name}-{kind}-{i}"} | spelled, allow_nan=False) + "\n")
    print(name, {kind: len(problems) for kind, problems in kinds.items()}, sum(map(len, kinds.values())))


def main():
    """Write all inputs."""
    rng = np.random.default_rng(2013)
    sets = two_balls(rng), lines(rng)
    write("two-balls", sets[0])
    write("lines", sets[1])
    write("engines", engines(rng))
    pairs, columns = sets
    by_pair = [pairs[kind][i] for kind in ("impact", "drop", "plastic", "paper") for i in (0, 1, 2)][:10]
    of_n = [columns[kind][i] for kind in ("chain", "drop", "stack", "hertz", "unlike") for i in (1, 4)]
    write("paths", {"pair": followed(by_pair, PATHS["pair"]), "chain": followed(of_n, PATHS["chain"])})


if __name__ == "__main__":
    main()
