"""Make examples/impact-set-1.json: collisions with their outcomes by every exact law, for the tests of any engine.

python benchmarks/impact_set.py
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from importlib.metadata import version
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from impact_xval.compliant_baselines import get_solver
from impact_xval.compliant_baselines.registry import description_of, exact_law_names
from impact_xval.compliant_baselines.solver import Settings
from impact_xval.model.collision import Collision
from impact_xval.model.status import RESULT_STATUSES

FILE = Path(__file__).parents[1] / "examples" / "impact-set-1.json"
K = 1e8
#: Grazing margin of the model below which a case is called grazing: a thousandth of a vibration's amplitude.
GRAZING = 1e-3
#: What an engine of springs needs to know beyond the stiffnesses.
DAMPING = (
    "an engine of springs uses its own rule for e, or the rule of kelvin-voigt: c = 2 zeta sqrt(k M) in N s/m; M is "
    "the reduced mass of the two bodies of the contact (at the table the mass of the ball), and zeta solves "
    "e = exp(-zeta/w atan2(2 zeta w, 2 zeta^2 - 1)), w = sqrt(1 - zeta^2) (docs/mapping.md, section 1)"
)


def line(
    masses: Sequence[float],
    v: Sequence[float],
    e: float,
    *,
    table: bool = False,
    gap: float = 0.0,
    k: float = K,
) -> Collision:
    """Return a line of balls in which all contacts have the same e, stiffness and gap."""
    n = len(masses) - 1 + table
    return Collision(tuple(masses), (k,) * n, (e,) * n, tuple(v), table, (gap,) * n)


def cases() -> Iterator[tuple[str, Collision]]:
    """Yield the collisions of the set, each with its name."""
    for ratio, m, (e1, e2) in product((0.01, 1.0, 100.0), (0.5, 2.0), ((1.0, 1.0), (0.9, 0.7), (0.0, 0.0))):
        name = f"two balls on a table, k2/k1 = {ratio:g}, m2/m1 = {m:g}, e = {e1:g}, {e2:g}"
        yield name, Collision.two_balls(1.0, m, K, K * ratio, e1, e2, -1.0)
    for strike, e in product((1, 2), (1.0, 0.9, 0.5)):
        yield (
            f"cradle of 5, {strike} strike, e = {e:g}",
            line([1.0] * 5, [-1.0] * strike + [0.0] * (5 - strike), e),
        )
    for masses, e, gap in product(([1.0] * 3, [1.0, 0.5, 2.0], [2.0, 0.5, 1.0]), (1.0, 0.8), (0.0, 1e-3)):
        name = f"chain of {masses}, e = {e:g}, gaps of {gap:g} m"
        yield name, line(masses, [-1.0, 0.0, 0.0], e, gap=gap)
    for n, e in product((3, 5), (1.0, 0.8, 0.5)):
        yield f"stack of {n} falls on a table, e = {e:g}", line([1.0] * n, [-1.0] * n, e, table=True)
    for n, e in product((3, 4), (1.0, 0.9)):
        name = f"a ball falls on {n - 1} that rest on a table, e = {e:g}"
        yield name, line([1.0] * n, [-1.0] + [0.0] * (n - 1), e, table=True)
    for m, e in product((1.0, 3.0), (0.0, 0.5, 1.0)):
        yield f"two balls, m2/m1 = {m:g}, e = {e:g}", line([1.0, m], [-1.0, 0.0], e)
    for e in (0.0, 0.7, 1.0):
        yield f"a ball on a table, e = {e:g}", line([1.0], [-1.0], e, table=True)
    yield "a light ball between two, one strikes, e = 1", line([1.0, 0.01, 1.0], [-1.0, 0.0, 0.0], 1.0)
    yield (
        "a heavy ball on a light one that falls on a table, e = 0, 1",
        Collision((10.0, 0.1), (K, K), (0.0, 1.0), (0.0, -1.0), table=True),
    )
    yield (
        "unequal e on a table, k2/k1 = 1, m2/m1 = 0.3, e = 0.5, 0.9",
        Collision.two_balls(1.0, 0.3, K, K, 0.5, 0.9, -1.0),
    )
    yield (
        "beside a jump of the model: k2/k1 = 0.57, m2/m1 = 0.67, e = 0.64, 0.52",
        Collision.two_balls(1.0, 0.67, K, 0.57 * K, 0.64, 0.52, -1.0),
    )
    yield "a light ball between two that close in, e = 1", line([1.0, 0.5, 1.0], [-1.0, 0.0, 1.0], 1.0)


def known_of(outcomes: dict[str, Any]) -> list[str]:
    """Return sentences on facts about a case, from its outcomes by law."""
    ends = np.array([o.velocities for o in outcomes.values()])
    model = outcomes.get("state-transition")
    known = ["unique"] if np.ptp(ends, axis=0).max() < 1e-9 else []
    if model is not None and model.grazing_margin is not None and model.grazing_margin < GRAZING:
        known.append("grazing")
    return known + (["endless"] if any("infinitely many" in o.reason for o in outcomes.values()) else [])


def made() -> dict[str, Any]:
    """Solve all cases by all laws."""
    rows, laws = [], exact_law_names()
    for name, collision in cases():
        found = {law: get_solver(law).solve_many([collision], Settings())[0] for law in laws}
        found = {law: o for law, o in found.items() if o.status in RESULT_STATUSES}
        ends = {law: [float(f"{v:.12g}") for v in o.velocities] for law, o in found.items()}
        plain = {key: value for key, value in asdict(collision).items() if key != "exponent"}
        rows.append({"name": name, **plain, "known": known_of(found), "outcomes": ends})
    return {
        "name": "impact-set-1",
        "origin": f"impact-xval {version('impact-xval')}, python benchmarks/impact_set.py; licence Apache-2.0",
        "units": "kg, N/m, m/s, m; ball 1 on top, up is positive; contact i is below ball i, the last one on the table",
        "damping": DAMPING,
        "known": {
            "unique": "all laws end alike",
            "grazing": f"the model's outcome lies beside a jump, its grazing margin is below {GRAZING:g}",
            "endless": "by a law, bodies come to rest together after infinitely many impacts",
        },
        "laws": {law: description_of(law) for law in laws},
        "cases": rows,
    }


if __name__ == "__main__":
    FILE.write_text(json.dumps(made(), indent=1) + "\n", encoding="utf-8")
