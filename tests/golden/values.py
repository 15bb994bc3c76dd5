"""How far golden values may move, and what moved further.

Velocities are taken per largest speed before, impulses per that speed and the masses above their contact. A golden
outcome holds `moves`, the largest move of each number under eight random changes of the inputs by 2^-52, and
`unsteady`, the words that changed under these, or sixteen changes by 2^-48: where two contacts end at once in exact
numbers, rounding names the states.
"""

import json
import math
import zlib
from pathlib import Path

import numpy as np
import pandas as pd

from tests.golden import adapter

HERE = Path(__file__).parent
#: By name of golden values the command and the commit that made them.
PROVENANCE = HERE / "values" / "provenance.json"
#: Numbers of changes of the inputs.
CHANGES, MORE_CHANGES = 8, 16
#: Moves above which only the status is compared, and below which states are.
STATUS_ONLY, STATES = 1e-8, 1e-10
#: Least tolerances of velocities: linear contacts, and contacts that are integrated.
LINEAR, INTEGRATED = 1e-12, 1e-9
#: Relative tolerances of other numbers.
RELATIVE = {"margin": 1e-6, "duration": 1e-10, "first_flight": 1e-10, "gravity_number": 1e-12}
#: Tolerances by a part of the name of a number, absolute and relative; the first that fits counts.
COMMON = {"n_steps": (1.0, 0.0), **dict.fromkeys(("error", "regularisation", "order"), (1e-9, 1e-3))}
COMMON |= {"limit": (1e-8, 0.0)}
#: Of numbers of tables where nothing else is said, those of engines 1e-9.
EXACT = 1e-10
#: Of outcomes of engines, and of tables, on every machine; durations of engines differ by a step.
ENGINES = COMMON | {"duration": (0.0, 2e-3), "step": (0.0, 1e-12), "gravity_number": (0.0, 1e-12)}
ENGINES |= {"energy": (1e-12, 0.0)}
TABLES = {"curve_distance": (3e-9, 0.0), "grazing_margin": (0.0, 1e-6)} | COMMON
#: A rate is the median slope of a few distances that begin at three times the error of the solver, so that rounding
#: decides its digits: compiled for the generic processor instead of the host's, the same code gives rates up to 3.4e-4
#: apart (1.97509 and 1.97543). The rates in question, 1, 1.5 and 2, are far apart, and verdicts are compared as words.
TABLES |= {"share": (1e-6, 0.0), "rate": (1e-3, 0.0)}
WORDS = ("status", "states", "events", "mark")


def read(name):
    return [json.loads(row) for row in (HERE / name).read_text().splitlines()]


def spec(name):
    return json.loads((HERE / "inputs" / f"{name}.json").read_text())


def provenance():
    return json.loads(PROVENANCE.read_text())


def flat(problem, found):
    """Numbers of an outcome by name, each in a unit in which rounding is about 1e-16."""
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
    """Change masses, stiffnesses, restitutions, gaps and gravity, up or down, and all velocities alike.

    Velocities of balls that move together are equal by intent, and stay so.
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
    """Say which words of an engine's outcome differ, and which numbers are further away than `ENGINES` allows."""
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
    """Say which numbers of an outcome are further away than they may be: `allowed`, of name and golden number."""
    where, misses = f"{golden['input']}, {golden['solver']}", []
    expected, there = flat(problem, golden), flat(problem, found)
    for name in {**expected, **there}:
        x, y = expected.get(name, math.nan), there.get(name, math.nan)
        misses += miss(where, name, x, y, allowed(name, x))
    return misses


def miss(where, name, expected, found, tolerance):
    """Say that a number is further away than it may be; NaN equals NaN."""
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


#: Columns that tell a row.
KEYS = ("cell", "case", "solver", "class", "measure")
#: Columns of words for a reader, of which only is compared whether there are any.
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
    """Compare a field of a row with the golden one: numbers, or words."""
    try:
        x, y = float(golden[name]), float(found)
    except ValueError:
        return [f"{where}: {name}: expected {golden[name]!r}, found {found!r}"]
    absolute, relative = tolerances(TABLES, name, EXACT, EXACT)
    if golden.get("solver") in adapter.ENGINES and "limit" not in name:
        absolute, relative = max(absolute, 1e-9), max(relative, 2e-3 if name == "duration" else 0.0)
    return miss(where, name, x, y, absolute + relative * abs(x))
