"""Draw a map of v1 by the model over k2/k1 and m2/m1, with lines at which v1 jumps.

Run as ``python examples/trust_map.py [FILE [SIDE]]``. By default it writes ``trust_map.png``, with 1000 by 1000
collisions. On one side of a line a compression just ends, and on the other side it just does not end. Close to a line
the result of an engine cannot be compared with the model's.
"""

import sys

import numpy as np
from matplotlib.figure import Figure

from impact_xval import solve_batch

E1, E2, NEAR = 0.9, 0.7, 1e-3
file = sys.argv[1] if len(sys.argv) > 1 else "trust_map.png"
side = int(sys.argv[2]) if len(sys.argv) > 2 else 1000

stiffness_ratio = np.geomspace(1e-3, 1e3, side)
mass_ratio = np.geomspace(0.1, 10, side)[:, None]
found = solve_batch(stiffness_ratio, mass_ratio, E1, E2)

figure = Figure(figsize=(7, 4.5), layout="constrained")
axes = figure.subplots()
drawn = axes.pcolormesh(stiffness_ratio, mass_ratio[:, 0], found.v1, cmap="viridis", rasterized=True)
axes.contour(stiffness_ratio, mass_ratio[:, 0], found.grazing_margin, [NEAR], colors="white", linewidths=0.6)
axes.set(xscale="log", yscale="log", xlabel="stiffness ratio k2/k1 (-)", ylabel="mass ratio m2/m1 (-)")
axes.set_title(f"e1 = {E1}, e2 = {E2}; white: grazing margin {NEAR:g}, where the model jumps")
figure.colorbar(drawn, label="v1/|v0| (-)")
figure.savefig(file, dpi=200)
