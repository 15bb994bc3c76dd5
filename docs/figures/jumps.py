"""Draw docs/figures/jumps.svg: final velocities of two balls that jump again and again on a soft table.

Run as ``python docs/figures/jumps.py``.
"""

from pathlib import Path

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np

from impact_xval import solve_batch

#: Mass ratio m2/m1 and restitutions of the collision. The lower ball is lighter, and the outcome jumps as the stiffness
#: ratio k2/k1 falls.
MASS_RATIO, E1, E2 = 0.5, 0.9, 0.7

#: Stiffness ratio k2/k1 below which more points are drawn, because jumps lie close together there.
FLIPS_BELOW = 0.02

#: Change of a velocity between neighbouring stiffness ratios, per |v0|, above which it is drawn as a jump.
FLIP = 0.02


def main() -> None:
    """Write the figure into the folder of this script, with the same bytes at every run."""
    mpl.rcParams.update({"svg.hashsalt": "jumps", "font.family": "DejaVu Sans"})
    ratios = np.unique(np.concatenate([np.geomspace(1e-3, FLIPS_BELOW, 801), np.geomspace(1e-3, 10, 201)]))
    outcomes = solve_batch(stiffness_ratio=ratios, mass_ratio=MASS_RATIO, e1=E1, e2=E2)
    fig, ax = plt.subplots(figsize=(7.2, 3.0), layout="constrained")
    for ball, colour in enumerate(("#0072b2", "#d55e00")):
        # Break the line where the outcome jumps.
        velocities = outcomes.velocities[:, ball]
        flips = np.flatnonzero(np.abs(np.diff(velocities)) > FLIP) + 1
        broken = np.insert(velocities, flips, np.nan)
        ax.plot(np.insert(ratios, flips, np.nan), broken, color=colour, lw=1.5, label=f"v{ball + 1}/|v0|")
    ax.set(xscale="log", xlabel="k2/k1 (stiffness of ball on table over that of ball on ball)")
    ax.set_ylabel("velocity after the collision, per |v0|")
    ax.axvspan(1e-3, FLIPS_BELOW, color="#eeeeee", zorder=0)
    ax.legend(frameon=False)
    fig.savefig(Path(__file__).with_suffix(".svg"), facecolor="white", metadata={"Date": None})


if __name__ == "__main__":
    main()
