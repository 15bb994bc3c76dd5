"""Shares of the causes over the gravity number, on the built-in grid and without an engine.

Run as ``python benchmarks/shares.py``. The divergence is between exact Kelvin-Voigt contacts in a drop and the model.
It is an engine's divergence without regularisation, mapping and time step. For every k1 and every band of k2/k1 the
script prints the mean D, and the shares of frozen positions, dissipation law and gravity as `measures.ladder` defines
them. Each share comes with the least and the largest value over the six orders of the causes. The script also counts
the cells in which the largest cause depends on the order.

The outcome depends on m1, k1, v0 and g only through the number g/(|v0| omega1) (Theorem 5, and one number for gravity).
So k1 = 1e8 at 1 m/s equals k1 = 1e6 at 10 m/s.
"""

from __future__ import annotations

import argparse
import math

import numpy as np

from impact_xval.experiments.config.experiment import Config
from impact_xval.experiments.measures.corners import corners
from impact_xval.experiments.measures.ladder import NOTHING, split
from impact_xval.experiments.measures.summary import BANDS, band_of
from impact_xval.experiments.tables.numbers import percent
from impact_xval.model import Collisions, solve_batch


def _plain(share: float) -> str:
    return percent(share).removesuffix(" %")


def main() -> None:
    """Compute the shares of the causes, and print them as rows of a Markdown table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--exponents", type=int, nargs=2, default=(5, 10), help="k1 from 10^A to 10^B N/m")
    arguments = parser.parse_args()
    config = Config.model_validate({})
    axes = np.meshgrid(*config.grid.axes().values(), indexing="ij")
    cells = [axis.ravel() for axis in axes]
    kappa, mu = cells[:2]
    collisions = Collisions.from_ratios(*cells)
    model = solve_batch(*cells, stiffness_ratio_cutoff=math.inf)
    velocities, band = np.column_stack([model.v1, model.v2]), band_of(kappa)
    print(
        "| k1, N/m | v0 at 1e8 N/m | number | region | cells | mean D | positions | law | gravity | undecided |"
    )
    for exponent in range(arguments.exponents[0], arguments.exponents[1] + 1):
        k1 = 10.0**exponent
        # The gravity number for m1 = k1 = 1 and v0 = -1.
        unit = config.gravity / (abs(config.v0) * math.sqrt(k1 / config.m1))
        between = corners(velocities, collisions, np.full(len(mu), unit))
        ladder = split(collisions.masses, between, np.full_like(velocities, np.nan), between.engine_law)
        counted = (between.reason == "") & (model.grazing_margin >= config.grazing_threshold)
        counted &= ladder.divergence >= NOTHING
        depends = ~ladder.same_by_every_order()  # cells that depend on the order of causes
        for edge, label in ((math.nan, "all"), *BANDS.items()):
            here = counted & (math.isnan(edge) | (band == edge))
            total = ladder.divergence[here].sum()
            orders = ladder.orders[:, :3, here].sum(axis=2) / total
            shares = (f"{percent(x.mean())} ({_plain(x.min())} to {_plain(x.max())})" for x in orders.T)
            print(
                f"| 1e{exponent} | {abs(config.v0) * math.sqrt(k1 / 1e8):.3g} | {unit:.2g} | {label} | {here.sum()} "
                f"| {total / here.sum():.3f} | {' | '.join(shares)} | {np.count_nonzero(depends[here])} |"
            )


if __name__ == "__main__":
    main()
