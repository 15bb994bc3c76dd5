"""How often, and by how much, an exact law misses each limit of the hypothesis: the size behind the verdicts.

Cells are drawn as the design of ``impact-xval hypothesis`` draws them (inelastic ones only), with no regard to how a
fit judges them: each is solved once, at the largest contrast of the built-in design. Printed are, by limit and solver,
the shares of cells in which D from the closed form exceeds 0.01, and in which it is 0.001 at most. Cells without a
result or beside a grazing jump do not count.

    python benchmarks/misses.py --cells 1000 --seed 1
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence

import numpy as np

from impact_xval.experiments.hypothesis.cases import CASES, LOSSY, Case, draw, pair_class
from impact_xval.experiments.hypothesis.config import parse
from impact_xval.experiments.hypothesis.run import contrasts, ratios_of
from impact_xval.experiments.hypothesis.solvers import default_names, under_test
from impact_xval.experiments.hypothesis.verdicts import FAR, Series
from impact_xval.experiments.tables.numbers import percent

#: D up to which a cell counts as agreeing.
NEAR = 1e-3


def distances(solver: str, case: Case, cells: int, seed: int) -> np.ndarray:
    """Compute D from the closed form in the inelastic cells of a limit that count, at its largest contrast."""
    config, one = parse({}, "built-in"), under_test(solver, 100)
    # At least half of a design is inelastic.
    points = tuple(p for p in draw(case, 2 * cells, seed) if pair_class(case, p) in LOSSY)[:cells]
    contrast = contrasts(config, case, one)[-1:]
    series = Series(one, case, points, contrast, one.solve(*ratios_of(case, points, contrast)))
    return series.distances()[series.usable()[0]]


def shares(D: np.ndarray) -> tuple[float, float]:
    """Share of cells that miss by more than `FAR`, and of those that agree to `NEAR`; NaN without cells."""
    if not D.size:
        return float("nan"), float("nan")
    return float(np.mean(D > FAR)), float(np.mean(D <= NEAR))


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--cells", type=int, default=1000, help="of each limit")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--solver", nargs="+", help="exact solvers; by default all")
    options = parser.parse_args(arguments)
    names = options.solver or [name for name in default_names() if under_test(name, 100).kind == "exact"]
    start = time.perf_counter()
    print(f"| limit | {' | '.join(names)} |")
    print(f"| --- |{' --- |' * len(names)}")
    for case in CASES:
        found = [distances(name, case, options.cells, options.seed) for name in names]
        fields = (" / ".join(map(percent, shares(D))) if D.size else "-" for D in found)
        print(f"| `{case.key}` | {' | '.join(fields)} |")
        short = [f"{name} {D.size}" for name, D in zip(names, found, strict=True) if D.size < options.cells]
        if short:
            print(f"cells that count: {', '.join(short)}")
    print(f"{options.cells} cells a limit, seed {options.seed}, {time.perf_counter() - start:.0f} s")


if __name__ == "__main__":
    main()
