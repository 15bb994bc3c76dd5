"""Accuracy and speed of references and engines for N balls.

``python -m benchmarks.chains_in_time references`` compares the references with an independent integration in time
(tests/model/chain_reference.py) on random chains, N from 2 to 10, half of them with gaps. It also counts chains per
second. ``... engines`` compares the engines of ``--engine`` at their limit dt -> 0 with the exact solver of their law,
N from 3 to 10. It prints the error of the limit, and the numbers of chains in which this error is more than once and
three times the estimated error. Chains have no gaps unless ``--with-gaps``. ``... gaps`` shows a cradle of steel balls
whose gaps grow.
"""

from __future__ import annotations

import argparse
import math
import sys
import time
from dataclasses import replace

import numpy as np
from rich.console import Console
from rich.table import Table

from benchmarks.chains import random_chain
from benchmarks.state_transition import machine
from impact_xval.compliant_baselines import Settings, get_solver
from impact_xval.compliant_baselines.registry import law_name_of
from impact_xval.compliant_baselines.solver import Convergence
from impact_xval.model import Collision
from tests.compliant_baselines.reference_cells import coefficients_of, in_time
from tests.model.chain_reference import integrate

#: Laws and exponents that are compared, and the largest N, above which the integration is too slow.
CASES = (
    ("kelvin-voigt", 1.0, 10),
    ("bistiffness", 1.0, 5),
    ("kelvin-voigt", 1.5, 10),
    ("hunt-crossley", 1.0, 10),
    ("hunt-crossley", 1.5, 10),
    ("bistiffness", 1.5, 4),
)

#: A steel ball of Newton's cradle: diameter in m, density in kg/m^3, Young's modulus in Pa, Poisson's number.
DIAMETER, DENSITY, YOUNG, POISSON = 0.025, 7800.0, 2.1e11, 0.3

#: Gaps between the balls of the cradle, in diameters of a ball.
GAPS = (0.0, 1e-6, 3e-6, 1e-5, 3e-5, 1e-4, 1e-3)


def with_gaps(rng: np.random.Generator, chain: Collision) -> Collision:
    """Open about half of the contacts of every second chain."""
    contacts = len(chain.stiffnesses)
    if rng.integers(2):
        return chain
    return replace(chain, gaps=tuple(10 ** rng.uniform(-4, 0, contacts) * rng.integers(2, size=contacts)))


def references(console: Console, count: int, seed: int) -> None:
    table = Table("law", "p", "compared", "worst", "of them estimated", "united", "chains/s, one thread")
    for law, exponent, most in CASES:
        rng = np.random.default_rng(seed)
        chains = [with_gaps(rng, random_chain(rng, int(rng.integers(2, most + 1)))) for _ in range(count)]
        in_time(chains[0], law, exponent=exponent)
        start = time.perf_counter()
        outcomes = [in_time(chain, law, exponent=exponent) for chain in chains]
        spent = time.perf_counter() - start
        compared, worst, estimated = 0, 0.0, 0.0
        for chain, ours in zip(chains, outcomes, strict=True):
            if ours.status != "ok":
                continue
            compared += 1
            theirs = integrate(replace(chain, exponent=exponent), law, coefficients_of(chain, law, exponent))
            difference = float(np.abs(np.subtract(ours.velocities, theirs.velocities)).max())
            if difference > 1e-8:
                console.print(f"{law}, {exponent:g}: {difference:.1e}, {chain}", highlight=False)
            worst = max(worst, difference)
            estimated = max(estimated, ours.diagnostics.get("velocity_error", 0.0))
        table.add_row(
            law,
            f"{exponent:g}",
            str(compared),
            f"{worst:.1e}",
            f"{estimated:.1e}",
            str(count - compared),
            f"{count / spent:,.0f}",
        )
    console.print(table)


def engines(console: Console, names: list[str], count: int, seed: int, some_gaps: bool) -> None:
    table = Table(
        "engine", "chains", "converged", "worst", "beyond the estimate", "beyond 3 times", "states equal", "s a chain"
    )  # fmt: skip
    rng = np.random.default_rng(seed)
    chains = []
    for _ in range(count):
        chain = random_chain(rng, int(rng.integers(3, 11)))
        chains.append(with_gaps(rng, chain) if some_gaps else chain)
    settings = Settings(convergence=Convergence())
    for name in names:
        exact = get_solver(law_name_of(name)).solve_many(chains, settings)
        start = time.perf_counter()
        outcomes = get_solver(name).solve_many(chains, settings)
        spent = time.perf_counter() - start
        off, ratio = [], []
        for i, (ours, theirs) in enumerate(zip(outcomes, exact, strict=True)):
            balls = range(1, len(theirs.velocities) + 1)
            limit = [ours.diagnostics.get(f"v{ball}_limit", math.nan) for ball in balls]
            off.append(float(np.abs(np.subtract(limit, theirs.velocities)).max()))
            ratio.append(off[-1] / ours.diagnostics.get("limit_error", math.nan))
            if ours.status != "ok" or not ratio[-1] <= 1:
                text = f"{name}, {i}: off by {off[-1]:.1e}, {ratio[-1]:.1f} times the estimate"
                console.print(text, ours.status, ours.reason, highlight=False)
        table.add_row(
            name,
            str(count),
            str(sum(outcome.status == "ok" for outcome in outcomes)),
            f"{np.nanmax(off):.1e}",
            str(np.sum(np.array(ratio) > 1)),
            str(np.sum(np.array(ratio) > 3)),
            str(sum(a.states == b.states for a, b in zip(outcomes, exact, strict=True))),
            f"{spent / count:.2f}",
        )
    console.print(table)


def gaps(console: Console) -> None:
    radius = DIAMETER / 2
    mass = DENSITY * 4 / 3 * math.pi * radius**3
    # Hertz: F = 4/3 E* sqrt(R*) delta^1.5, with R* = radius/2 and E* = E/(2 (1 - nu^2)) of two equal balls.
    stiffness = 4 / 3 * YOUNG / (2 * (1 - POISSON**2)) * math.sqrt(radius / 2)
    table = Table("gap, diameters", "gap, um", *(f"v{i}" for i in range(1, 6)))
    for gap in GAPS:
        distances = (0, *[gap * DIAMETER] * 3)
        velocities = (-1.0, -1.0, 0, 0, 0)
        chain = Collision((mass,) * 5, (stiffness,) * 4, (1.0,) * 4, velocities, gaps=distances)
        outcome = in_time(chain, exponent=1.5)
        table.add_row(f"{gap:g}", f"{gap * DIAMETER * 1e6:g}", *(f"{v:.4f}" for v in outcome.velocities))
    console.print(table)


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("what", choices=("references", "engines", "gaps"))
    parser.add_argument("--count", type=int, default=60, help="number of chains (default: %(default)s)")
    parser.add_argument("--seed", type=int, default=0, help="(default: %(default)s)")
    parser.add_argument("--engine", nargs="+", default=["mujoco", "pybullet"], help="(default: %(default)s)")
    parser.add_argument("--with-gaps", action="store_true", help="open contacts of about half of the chains")
    options = parser.parse_args()
    console = Console(width=max(110, Console().width))
    console.print(machine(), highlight=False)
    if options.what == "references":
        references(console, options.count, options.seed)
    elif options.what == "engines":
        engines(console, options.engine, options.count, options.seed, options.with_gaps)
    else:
        gaps(console)
    return 0


if __name__ == "__main__":
    sys.exit(main())
