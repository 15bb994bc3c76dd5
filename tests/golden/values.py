"""Compare golden values with new ones: tolerances, and messages for values that moved further.

Velocities are divided by the largest initial speed. Impulses are divided by that speed times the mass above their
contact. A golden outcome holds two measures of how sensitive it is:

* `moves`: the largest change of each number under eight random changes of the inputs by 2^-52
* `unsteady`: the words that changed under these, or under sixteen changes by 2^-48

Words can change because rounding decides the states where two contacts would end at exactly the same time.
"""

import json
import math
import zlib
from pathlib import Path

import numpy as np
import pandas as pd

from tests.golden import adapter

HERE = Path(__file__).parent
#: The command and the commit that made the golden values, by name of the values.
PROVENANCE = HERE / "values" / "provenance.json"
#: Number of random changes of the inputs by 2^-52, and of those by 2^-48.
CHANGES, MORE_CHANGES = 8, 16
#: If velocities move more than the first value under changes of the inputs, only the status is compared. If they move
#: less than the second, states are compared, too.
STATUS_ONLY, STATES = 1e-8, 1e-10
#: Smallest tolerance of velocities for linear contacts, and for contacts whose motion is integrated numerically.
LINEAR, INTEGRATED = 1e-12, 1e-9
#: Relative tolerances of the margin and of diagnostics, by name.
RELATIVE = {"margin": 1e-6, "duration": 1e-10, "first_flight": 1e-10, "gravity_number": 1e-12}
#: Absolute and relative tolerance by a part of a number's name. The first part that fits counts.
COMMON = {"n_steps": (1.0, 0.0), **dict.fromkeys(("error", "regularisation", "order"), (1e-9, 1e-3))}
COMMON |= {"limit": (1e-8, 0.0)}
#: Tolerance of numbers in tables for which nothing else is given. For those of engines it is 1e-9.
EXACT = 1e-10
#: Tolerances for outcomes of engines and for tables, on every machine. Durations by engines may differ by a step.
ENGINES = COMMON | {"duration": (0.0, 2e-3), "step": (0.0, 1e-12), "gravity_number": (0.0, 1e-12)}
ENGINES |= {"energy": (1e-12, 0.0)}
TABLES = {"curve_distance": (3e-9, 0.0), "grazing_margin": (0.0, 1e-6)} | COMMON
#: A rate is the median slope through a few distances, the smallest of which are three times the error of the solver.
#: Rounding therefore decides its digits: compiled for the generic processor instead of the host's, the same code gives
#: rates up to 3.4e-4 apart (1.97509 and 1.97543). The possible rates 1, 1.5 and 2 are far apart, and verdicts are
#: compared as words.
TABLES |= {"share": (1e-6, 0.0), "rate": (1e-3, 0.0)}
WORDS = ("status", "states", "events", "mark")


def read(name):
    return [json.loads(row) for row in (HERE / name).read_text().splitlines()]


def spec(name):
    return json.loads((HERE / "inputs" / f"{name}.json").read_text())


def provenance():
    return json.loads(PROVENANCE.read_text())


def flat(problem, found):
    """Return the numbers of an outcome by name, each in a unit in which rounding is about 1e-16."""
    if "velocities" not in found:
        return {}
    speed = max(map(abs, problem["velocities"]))
    above = np.cumsum([*problem["masses"], 0.0]) * speed
    numbers = {f"v{i}": v / speed for i, v in enumerate(found["velocities"], 1)}
    numbers |= {f"impulse{i + 1}": x / above[i] for i, x in enumerate(found["impulses"])}
    unit = {"velocity_error": speed, "rest_speed": speed}
    numbers |= {name: float(x) / unit.get(name, 1.0) for name, x in found["diagnostics"].items()}
    return numbers | ({} if found["margin"] is None else {"margin": float(found["margin"])})


def changed(problem, rng, size):
    """Change each mass, stiffness, restitution, gap and gravity up or down by `size`, and all velocities by one factor.

    One factor for all velocities keeps balls together that are meant to move together.
    """

    def nudged(numbers):
        return [float(x) * (1 + rng.choice([-size, size])) for x in numbers]

    (factor,) = nudged([1.0])
    return problem | {
        **{name: nudged(problem[name]) for name in ("masses", "stiffnesses", "gaps")},
        "restitutions": [min(e, 1.0) for e in nudged(problem["restitutions"])],
        "velocities": [v * factor for v in problem["velocities"]],
        "gravity": problem["gravity"] and nudged([problem["gravity"]])[0],
    }


def golden(problem, solver):
    rng = np.random.default_rng(zlib.crc32(f"{problem['name']} {solver}".encode()))
    found = adapter.solve(problem, solver)
    numbers, moved, unsteady = flat(problem, found), {}, set()
    for i in range(CHANGES + MORE_CHANGES):
        other = adapter.solve(changed(problem, rng, 2.0**-52 if i < CHANGES else 2.0**-48), solver)
        unsteady |= {word for word in WORDS if other.get(word) != found.get(word)}
        away = flat(problem, other) if i < CHANGES else numbers
        for name in {*numbers, *away}:
            x, y = numbers.get(name, math.nan), away.get(name, math.nan)
            step = 0.0 if x == y else abs(y - x)
            moved[name] = max(moved.get(name, 0.0), math.inf if math.isnan(step) else step)
    kept = {name: adapter.plain(float(f"{x:.2g}")) for name, x in moved.items() if x}
    more = {"moves": kept, "unsteady": sorted(unsteady)}
    return {"input": problem["name"], "solver": solver, **found} | {k: v for k, v in more.items() if v}


def exact_misses(problem, golden, found):
    unsteady = golden.get("unsteady", [])
    moves = {name: float(x) for name, x in golden.get("moves", {}).items()}
    w = max(
        (x for name, x in moves.items() if name.startswith(("v", "impulse")) and "_" not in name), default=0.0
    )
    misses = word_misses(golden, found, {"status"}.difference(unsteady))
    if w > STATUS_ONLY or misses or "status" in unsteady:
        return misses
    stated = float(golden.get("diagnostics", {}).get("velocity_error", 0.0)) / max(
        map(abs, problem["velocities"])
    )
    linear = problem["exponent"] == 1 and (problem["kernel"] == "pair" or golden["solver"] != "hunt-crossley")
    tolerance = max(LINEAR if linear else max(INTEGRATED, 3 * stated), 100 * w)
    if w < STATES and (golden.get("margin") is None or float(golden["margin"]) > 1e-9):
        misses = word_misses(golden, found, set(WORDS).difference(unsteady))

    def allowed(name, x):
        least = RELATIVE[name] * abs(x) * max(1.0, tolerance / LINEAR) if name in RELATIVE else tolerance
        return max(least, 100 * moves.get(name, 0.0))

    return misses + number_misses(problem, golden, found, allowed)


def engine_misses(problem, golden, found):
    """List the words of an engine's outcome that differ, and the numbers that differ by more than `ENGINES` allows."""
    misses = word_misses(golden, found, WORDS)

    def allowed(name, x):
        absolute, relative = tolerances(ENGINES, name, 1e-9, 0.0)
        return absolute + relative * abs(x)

    return misses + number_misses(problem, golden, found, allowed)


def tolerances(table, name, *default):
    return next((both for part, both in table.items() if part in name), default)


def word_misses(golden, found, names):
    where = f"{golden['input']}, {golden['solver']}"
    return [
        f"{where}: {name}: expected {golden.get(name)!r}, found {found.get(name)!r}"
        for name in sorted(names)
        if golden.get(name) != found.get(name)
    ]


def number_misses(problem, golden, found, allowed):
    """List the numbers of an outcome that moved too far; `allowed` gives the tolerance by name and golden number."""
    where, misses = f"{golden['input']}, {golden['solver']}", []
    expected, there = flat(problem, golden), flat(problem, found)
    for name in {**expected, **there}:
        x, y = expected.get(name, math.nan), there.get(name, math.nan)
        misses += miss(where, name, x, y, allowed(name, x))
    return misses


def miss(where, name, expected, found, tolerance):
    """Return a list with a message if a number is too far from the expected one, else an empty list; NaN equals NaN."""
    same = expected == found or (math.isnan(expected) and math.isnan(found))
    if same or abs(found - expected) <= tolerance:
        return []
    return [f"{where}: {name}: expected {expected!r}, found {found!r}, tolerance {tolerance:.2g}"]


def path_misses(problem, golden, found):
    where, misses = f"{golden['input']}, {golden['solver']}, path", []
    expected, there = golden["path"], found["path"]
    speed = max(map(abs, problem["velocities"]))
    above = np.cumsum([*problem["masses"], 0.0])[: len(problem["stiffnesses"])] * speed
    scale = {"time": expected["time"][-1], "velocities": speed, "impulses": above, "interpolated": above}
    exact = 1e-10 if problem["exponent"] == 1 else 1e-8
    for name, unit in scale.items():
        x, y = np.array(expected[name]) / unit, np.array(there[name]) / unit
        if x.shape != y.shape:
            misses.append(f"{where}: {name}: expected {len(x)} rows, found {len(y)}")
            continue
        tolerance = 1e-3 if name == "interpolated" else exact
        worst = np.unravel_index(np.abs(x - y).argmax(), x.shape)
        misses += miss(where, f"{name}{list(map(int, worst))}", float(x[worst]), float(y[worst]), tolerance)
    return misses


#: Columns that identify a row of a table.
KEYS = ("cell", "case", "solver", "class", "measure")
#: Columns with texts for readers. Only whether a text is present is compared.
PROSE = ("reason", "marked", "sentence", "without_result")


def table_misses(where, found):
    golden = pd.read_csv(HERE / "values" / f"{where}.csv", dtype=str, keep_default_na=False)
    there = pd.DataFrame(found)
    if missing := {*golden} - {*there}:
        return [f"{where}: {name}: no such column" for name in sorted(missing)]
    if len(there) != len(golden):
        return [f"{where}: expected {len(golden)} rows, found {len(there)}"]
    rows = golden.filter(KEYS).agg(" ".join, axis=1)
    for name in golden.columns.intersection(PROSE):
        golden[name], there[name] = (each[name].astype(bool).astype(str) for each in (golden, there))
    return [
        text
        for name in golden
        for i in np.flatnonzero(golden[name] != there[name])
        for text in field_misses(f"{where}, row {i} ({rows[i]})", name, golden.loc[i], there[name][i])
    ]


def field_misses(where, name, golden, found):
    """Compare a field of a row with the golden field, as numbers or as words, and list what differs."""
    try:
        x, y = float(golden[name]), float(found)
    except ValueError:
        return [f"{where}: {name}: expected {golden[name]!r}, found {found!r}"]
    absolute, relative = tolerances(TABLES, name, EXACT, EXACT)
    if golden.get("solver") in adapter.ENGINES and "limit" not in name:
        absolute, relative = max(absolute, 1e-9), max(relative, 2e-3 if name == "duration" else 0.0)
    return miss(where, name, x, y, absolute + relative * abs(x))
