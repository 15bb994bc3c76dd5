"""Draw docs/figures/divergence.svg: final velocities by two laws that differ by D = 0.04, 0.11 and 0.42.

Run as ``python docs/figures/divergence.py``.
"""

from pathlib import Path

import matplotlib as mpl
import matplotlib.pyplot as plt

from impact_xval import Collision, compare

#: Stiffness ratios k2/k1 of the three collisions. The two laws are near each other, further apart, and far apart.
STIFFNESS_RATIOS = (0.5, 3.2, 0.01)

#: Mass ratio m2/m1 and restitutions of all three collisions.
MASS_RATIO, E1, E2 = 1.15, 0.9, 0.7

#: For each law its solver, its name in the legend, and its colour.
LAWS = (("state-transition", "the model", "#222222"), ("kelvin-voigt", "springs and dashpots", "#d55e00"))


def main() -> None:
    """Write the figure into the folder of this script, with the same bytes at every run."""
    mpl.rcParams.update({"svg.hashsalt": "divergence", "font.family": "DejaVu Sans"})
    fig, axes = plt.subplots(1, 3, figsize=(7.2, 2.7), sharey=True, layout="constrained")
    for ax, ratio in zip(axes, STIFFNESS_RATIOS, strict=True):
        compared = compare(Collision.from_ratios(ratio, MASS_RATIO, E1, E2), ["kelvin-voigt"])
        for offset, (solver, words, colour) in zip((-0.18, 0.18), LAWS, strict=True):
            velocities = compared.outcomes[solver].velocities
            ax.bar([1 + offset, 2 + offset], velocities, 0.32, color=colour, label=words)
        ax.set_title(f"k2/k1 = {ratio:g}: D = {compared.divergences['kelvin-voigt']:.2f}", fontsize=10)
        ax.set_xticks([1, 2], ["ball 1", "ball 2"])
        ax.spines[["top", "right"]].set_visible(False)
    axes[0].set_ylabel("velocity after, per |v0|")
    axes[0].legend(frameon=False, fontsize=8)
    axes[0].set_ylim(0, 1)
    fig.savefig(Path(__file__).with_suffix(".svg"), facecolor="white", metadata={"Date": None})


if __name__ == "__main__":
    main()
