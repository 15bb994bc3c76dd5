"""How far golden values may move, and what moved further.

Velocities are taken per largest speed before, impulses per that speed and the masses above their contact. A golden
outcome holds `moves`, the largest move of each number under eight random changes of the inputs by 2^-52, and
`unsteady`, the words that changed under these, or sixteen changes by 2^-48: where two contacts end at once in exact
numbers, rounding names the states.
"""

import csv
import json
import math
import zlib
from pathlib import Path

import numpy as np

from tests.golden import adapter

HERE = Path(__file__).parent
#: Numbers of changes of the inputs.
CHANGES, MORE_CHANGES = 8, 16
#: Moves above which only the status is compared, and below which states are.
STATUS_ONLY, STATES = 1e-8, 1e-10
#: Least tolerances of velocities: linear contacts, and contacts that are integrated.
LINEAR, INTEGRATED = 1e-12, 1e-9
WORDS = ("status", "states", "events", "mark")


def read(name):
    """Read a file of JSON lines."""
    return [json.loads(row) for row in (HERE / name).read_text().splitlines()]


def spec(name):
    """Read what is to be run, by name."""
    return json.loads((HERE / "inputs" / f"{name}.json").read_text())


def flat(problem, found):
    """Numbers of an outcome by name, each in a unit in which rounding is about 1e-16."""
    if "velocities" not in found:
        return {}
    speed = max(map(abs, problem["velocities"]))
    above = np.cumsum([*problem["masses"], 0.0]) * speed
    numbers = {f"v{i}": v / speed for i, v in enumerate(found["velocities"], 1)}
    numbers |= {
        f"impulse{i}": x / m for i, (x, m) in enumerate(zip(found["impulses"], above, strict=False), 1)
    }
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
    """Make the golden outcome of a collision by an exact solver, with its moves."""
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


def sensitivity(golden):
    """Largest move w of the velocities and impulses of a golden outcome."""
    known = golden.get("moves", {}).items()
    return max(
        (float(x) for name, x in known if name.startswith(("v", "impulse")) and "_" not in name), default=0.0
    )


def exact_misses(problem, golden, found):
    """Say what of an exact solver's outcome is further away than it may be, one sentence each."""
    where, unsteady, w = (
        f"{golden['input']}, {golden['solver']}",
        golden.get("unsteady", []),
        sensitivity(golden),
    )
    misses = []

    def word(name):
        if name not in unsteady and found.get(name) != golden.get(name):
            misses.append(f"{where}: {name}: expected {golden.get(name)!r}, found {found.get(name)!r}")

    word("status")
    if w > STATUS_ONLY or misses or "status" in unsteady:
        return misses
    speed = max(map(abs, problem["velocities"]))
    stated = float(golden.get("diagnostics", {}).get("velocity_error", 0.0)) / speed
    linear = problem["exponent"] == 1 and (problem["kernel"] == "pair" or golden["solver"] != "hunt-crossley")
    tolerance = max(LINEAR if linear else max(INTEGRATED, 3 * stated), 100 * w)
    margin = golden.get("margin")
    if w < STATES and (margin is None or float(margin) > 1e-9):
        for name in ("states", "events", "mark"):
            word(name)
    expected, there = flat(problem, golden), flat(problem, found)
    for name in {**expected, **there}:
        x, y = expected.get(name, math.nan), there.get(name, math.nan)
        moved = 100 * float(golden.get("moves", {}).get(name, 0.0))
        relative = {"margin": 1e-6, "duration": 1e-10, "first_flight": 1e-10, "gravity_number": 1e-12}.get(
            name
        )
        least = tolerance if relative is None else relative * abs(x) * max(1.0, tolerance / LINEAR)
        misses += miss(where, name, x, y, max(least, moved))
    return misses


def miss(where, name, expected, found, tolerance):
    """Say that a number is further away than it may be; NaN equals NaN."""
    same = expected == found or (math.isnan(expected) and math.isnan(found))
    if same or abs(found - expected) <= tolerance:
        return []
    return [f"{where}: {name}: expected {expected!r}, found {found!r}, tolerance {tolerance:.2g}"]


def engine_misses(problem, golden, found, *, same_machine):
    """Say what of an engine's outcome is further away than it may be: bits where all is the same, else a little."""
    where = f"{golden['input']}, {golden['solver']}"
    if same_machine:
        names = {**golden, **found}.keys() - {"input", "solver"}
        return [
            f"{where}: {name}: expected {golden.get(name)!r}, found {found.get(name)!r}, the same bits"
            for name in sorted(names)
            if golden.get(name) != found.get(name)
        ]
    misses = [
        f"{where}: {name}: expected {golden.get(name)!r}, found {found.get(name)!r}"
        for name in WORDS
        if golden.get(name) != found.get(name)
    ]
    expected, there = flat(problem, golden), flat(problem, found)
    for name in {**expected, **there}:
        x = expected.get(name, math.nan)
        misses += miss(where, name, x, there.get(name, math.nan), engine_tolerance(name, x))
    return misses


def engine_tolerance(name, value):
    """Tolerance of a number of an engine on another machine."""
    if name == "n_steps":
        return 1.0
    if "error" in name or name in ("regularisation", "order"):
        return 1e-3 * abs(value) + 1e-9
    if "limit" in name:
        return 1e-8
    if name == "duration":
        return 2e-3 * abs(value)  # a step
    return 1e-12 * abs(value) if "step" in name or name == "gravity_number" else 1e-9


def path_misses(problem, golden, found):
    """Say what of a path is further away than it may be."""
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


def provenance(name):
    """Return the fingerprint of the machine on which golden values were made."""
    return json.loads((HERE / "values/provenance.json").read_text())[name]["fingerprint"]


def table(name):
    """Read a golden table, by column."""
    with (HERE / "values" / f"{name}.csv").open(newline="") as file:
        names, *rows = csv.reader(file)
    return dict(zip(names, map(list, zip(*rows, strict=True)), strict=True))


#: Columns that tell a row.
KEYS = ("cell", "solver", "case", "class", "measure")
#: Columns of words for a reader, of which only is compared whether there are any.
PROSE = ("reason", "marked", "sentence", "without_result")
#: Tolerance of numbers of tables, those of engines 1e-9.
EXACT = 1e-10
#: Others by a part of the column's name, absolute and relative; the first that fits counts.
TABLES = {
    "curve_distance": (3e-9, 0.0),
    "grazing_margin": (0.0, 1e-6),
    "n_steps": (1.0, 0.0),
    "error": (1e-9, 1e-3),
    "regularisation": (1e-9, 1e-3),
    "order": (1e-9, 1e-3),
    "share": (1e-6, 0.0),
    "rate": (1e-6, 1e-6),
    "limit": (1e-8, 0.0),
}


def table_misses(where, found):
    """Say what of a table, columns of text, is further away than it may be."""
    golden = table(where)
    misses, rows = [], len(next(iter(golden.values())))
    for name, expected in golden.items():
        if name not in found or len(found[name]) != rows:
            misses.append(
                f"{where}: {name}: {'another number of rows' if name in found else 'no such column'}"
            )
            continue
        for i, (x, y) in enumerate(zip(expected, found[name], strict=True)):
            if name in PROSE:
                x, y = str(bool(x)), str(bool(y))
            if x != y:
                row = " ".join(golden[key][i] for key in golden if key in KEYS)
                misses += field_misses(
                    f"{where}, row {i} ({row})", name, x, y, golden.get("solver", [""] * rows)[i]
                )
    return misses


def field_misses(where, name, expected, found, solver):
    """Compare two fields of a table: numbers, or words."""
    try:
        x, y = float(expected), float(found)
    except ValueError:
        return [f"{where}: {name}: expected {expected!r}, found {found!r}"]
    absolute, relative = next((two for part, two in TABLES.items() if part in name), (EXACT, EXACT))
    if solver in adapter.ENGINES and "limit" not in name:
        absolute, relative = max(absolute, 1e-9), max(relative, 2e-3 if name == "duration" else 0.0)
    return miss(where, name, x, y, absolute + relative * abs(x))
