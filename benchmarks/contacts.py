"""Random contacts by each way to state a contact, and the results of their printed lines.

Run as ``python -m benchmarks.contacts [N [ENGINE ...]]``, by default 40 contacts of MuJoCo and PyBullet. The ways to
state a contact take turns: every pair of (restitution, damping, damping ratio) and (stiffness, duration, sink, step),
MuJoCo's solref, and three bodies. A pair is pasted into a scene written by hand, of another kind than the drops' own
(free bodies, boxes for floors), and meets at eight places within a step. A row has the number of restitutions outside
the printed interval, their largest distance from it, the largest error of e or duration over the tolerance, and the
width of the interval over e. For three bodies the printed text runs at eight further places.
"""

import itertools
import math
import sys
import time

import numpy as np
from rich.console import Console
from rich.table import Table

from impact_xval.compliant_baselines import SolverError, get_solver
from impact_xval.compliant_baselines.paste import paste
from impact_xval.compliant_baselines.single_contact import (
    TOLERANCE,
    Drops,
    SingleImpact,
    bodies_of_contacts,
    find_largest_step,
    find_stiffest,
    verify_contacts,
)
from impact_xval.compliant_baselines.solref import read_solref
from impact_xval.compliant_baselines.three_bodies import STRIKES, paste_both, strike
from impact_xval.experiments.presentation.contacts import round_outward
from tests.compliant_baselines import hand_scenes

DAMPERS, SPRINGS = ("restitution", "damping", "damping_ratio"), ("stiffness", "duration", "sink", "step")
WAYS = [*itertools.product(DAMPERS, SPRINGS), ("solref", "direct"), ("solref", "ratio"), ("three", "bodies")]


def random_masses(rng: np.random.Generator) -> tuple[float, float]:
    """Return two random masses from 1 g to 1 t; in one of three cases the second body is fixed."""
    light = 10 ** rng.uniform(-3, 2)
    return light, math.inf if rng.uniform() < 1 / 3 else light * 10 ** rng.uniform(0, 2)


def random_pair(way: tuple[str, str], rng: np.random.Generator) -> SingleImpact:
    """Draw a pair for a way to state it; durations are from 0.1 ms to 0.1 s, and damping ratios up to 5."""
    masses, speed, duration = random_masses(rng), 10 ** rng.uniform(-1, 1), 10 ** rng.uniform(-4, -1)
    reduced = SingleImpact(masses, 1.0, duration=duration).mass
    zeta = 10 ** rng.uniform(-2, 0.7)
    like = SingleImpact(masses, damping_ratio=zeta, duration=duration, speed=speed)
    if way[0] == "solref":
        k, c = like.contact.k / reduced, like.contact.c / reduced
        solimp = (rng.uniform(0.1, 0.99), rng.uniform(0.5, 0.99), like.penetration * 10 ** rng.uniform(-1, 1))
        solref = (-k, -c) if way[1] == "direct" else (2 / c, c / (2 * math.sqrt(k)))
        return SingleImpact(masses, speed=speed, solref=read_solref(solref, solimp))
    numbers = {
        "restitution": like.contact.restitution,
        "damping": like.contact.c,
        "damping_ratio": zeta,
        "stiffness": like.contact.k,
        "duration": duration,
        "sink": like.depth_at_rest,
        "step": None,
    }
    damper, spring = way
    asked = {
        damper: numbers[damper],
        ("duration" if spring == "step" else spring): numbers[spring] or duration,
    }
    return SingleImpact(masses, speed=speed, **asked)


def leaves(low: float, high: float, value: float) -> float:
    """Return the distance of a value from the printed interval of two numbers, over the interval's upper end."""
    low, high = map(float, round_outward(low, high).split(" to "))
    return max(low - value, value - high, 0.0) / max(abs(low), abs(high))


def judge_pair(
    engine: str, pair: SingleImpact, drops: Drops, rng: np.random.Generator
) -> tuple[list[float], float]:
    """Paste a pair by hand at eight places; return the distances of e from its interval, and the largest error."""
    text = paste(engine, pair.contact, drops.step, pair.solref)
    outside, worst = [], 0.0
    for place in (*rng.uniform(0, 1, 7).tolist(), 1e-5):
        e, duration = getattr(hand_scenes, engine)(
            pair, text, drops.step, (3 + place) * pair.speed * drops.step
        )
        outside.append(leaves(*drops.restitution, e))
        worst = max(worst, Drops(drops.step, (e, e), (duration, duration), 1).error(pair))
    return outside, worst


def judge_three(engine: str, rng: np.random.Generator) -> tuple[list[float], float, float]:
    """Strike three bodies at eight places; return distances from intervals, the widest interval, and the error."""
    solver = get_solver(engine)
    a, b = (10 ** rng.uniform(-1, 1) for _ in range(2))
    masses = (a, b, math.inf if rng.uniform() < 0.5 else 10 ** rng.uniform(-1, 1))
    pairs = [
        SingleImpact(two, rng.uniform(0.2, 1), duration=10 ** rng.uniform(-2.3, -2), load=load)
        for two, load in bodies_of_contacts(masses)
    ]
    verified = verify_contacts(solver, pairs, 0.05)
    step = verified[0].drops.step
    found = strike(engine, masses, pairs, step, thorough=True)
    gaps = (rng.uniform(0, 1, 8) * step).tolist()
    outside = [
        leaves(low, high, velocity)
        for velocities in STRIKES[engine](paste_both(engine, pairs, step), masses, 1.0, 1.0, gaps, 100_000)
        for (low, high), velocity in zip(found.velocities, velocities, strict=True)
    ]
    return (
        outside,
        max(high - low for low, high in found.velocities),
        max(v.drops.error(v.pair) for v in verified),
    )


def main() -> None:
    """Print a row for each contact, and the number of values inside their intervals."""
    n = int(sys.argv[1]) if len(sys.argv) > 1 else 40
    table = Table("engine", "way in", "places outside", "by at most", "error/tolerance", "width", "s")
    inside = total = 0
    for engine in sys.argv[2:] or ("mujoco", "pybullet"):
        solver, rng = get_solver(engine), np.random.default_rng(72)
        for way in itertools.islice(itertools.cycle(WAYS), n):
            start, tolerance = time.perf_counter(), TOLERANCE
            if way[0] == "solref" and engine != "mujoco":
                continue
            try:
                if way[0] == "three":
                    tolerance = 0.05
                    outside, width, error = judge_three(engine, rng)
                else:
                    pair = random_pair(way, rng)
                    if way[1] == "step":
                        tolerance = 0.05
                        step = float(f"{pair.motion.duration * tolerance:.2g}")
                        pair, drops = find_stiffest(solver, pair, step, tolerance)
                    else:
                        drops = find_largest_step(solver, pair)
                    outside, error = judge_pair(engine, pair, drops, rng)
                    width = (drops.restitution[1] - drops.restitution[0]) / pair.motion.restitution
            except SolverError as refused:
                table.add_row(engine, " ".join(way), str(refused)[:60])
                continue
            total, inside = total + 1, inside + (max(outside) == 0 and error <= tolerance)
            table.add_row(
                engine,
                " ".join(way),
                f"{np.count_nonzero(outside)} of {len(outside)}",
                f"{max(outside):.1e}",
                f"{error / tolerance:.2f}",
                f"{width:.1e}",
                f"{time.perf_counter() - start:.1f}",
            )
    Console(width=110).print(table)
    print(f"{inside} of {total} contacts do what is printed")


if __name__ == "__main__":
    main()
