"""Draw docs/figures/jumps.svg, the outcome that flips on a soft table: python docs/figures/jumps.py."""

from pathlib import Path

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np

from impact_xval import solve_batch

#: The lighter lower ball and its two contacts; the outcome flips as the stiffness ratio falls.
MASS_RATIO, E1, E2 = 0.5, 0.9, 0.7

#: Below this stiffness ratio the whole range is drawn finely, for flips lie close together there.
FLIPS_BELOW = 0.02

#: Change of a velocity, per |v0|, between neighbouring ratios that is a flip.
FLIP = 0.02


def main() -> None:
    """Write the figure beside this script, the same bytes at every run."""
    mpl.rcParams.update({"svg.hashsalt": "jumps", "font.family": "DejaVu Sans"})
    ratios = np.unique(np.concatenate([np.geomspace(1e-3, FLIPS_BELOW, 801), np.geomspace(1e-3, 10, 201)]))
    outcomes = solve_batch(stiffness_ratio=ratios, mass_ratio=MASS_RATIO, e1=E1, e2=E2)
    fig, ax = plt.subplots(figsize=(7.2, 3.0), layout="constrained")
    for ball, colour in enumerate(("#0072b2", "#d55e00")):
        # A line that is broken where the outcome flips.
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
