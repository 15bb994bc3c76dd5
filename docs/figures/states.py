"""Draw docs/figures/states.svg, the state diagram of docs/theory.md, section 3.

Run as ``python docs/figures/states.py``.
"""

from pathlib import Path

import matplotlib as mpl
import matplotlib.pyplot as plt
from matplotlib.patches import Circle, FancyArrowPatch, FancyBboxPatch

INK, ACTING = "#222222", "#d55e00"
WIDTH, HEIGHT = 2.5, 1.2

#: For each state: centre of its box, words for its active contacts, and whether contact 1 and contact 2 are active.
STATES = {
    "S1": ((0, 3.4), "both contacts", True, True),
    "S2": ((-3.8, 1.7), "ball on table", False, True),
    "S3": ((3.8, 1.7), "ball on ball", True, False),
    "S4": ((0, 0), "no contact", False, False),
}

#: For each arrow: its two ends, its curvature, the words for its event, and the centre of these words.
EVENTS = [
    ((-1.3, 3.7), (-4.2, 2.35), 0.25, "contact 1 ends\nrestitution", (-3.9, 3.85)),
    ((-2.5, 2.0), (-1.3, 3.0), 0.1, "v1 − v2 turns\nnegative", (-1.05, 2.05)),
    ((1.3, 3.7), (4.2, 2.35), -0.25, "contact 2 ends\nrestitution", (3.9, 3.85)),
    ((2.5, 2.0), (1.3, 3.0), -0.1, "v2 turns\nnegative", (1.05, 2.05)),
    ((0, 2.75), (0, 0.65), 0, "both end restitution\nat once", (0, 1.45)),
    ((-3.8, 1.05), (-1.3, 0), 0.25, "contact 2 ends\nrestitution", (-3.9, 0.0)),
    ((3.8, 1.05), (1.3, 0), -0.25, "contact 1 ends\nrestitution", (3.9, 0.0)),
    ((0, 4.75), (0, 4.05), 0, "B1 touches B2", (0, 4.95)),
]


def draw_state(ax, name, centre, words, ball_ball, ball_table):
    """Draw a state as a box: its name, its active contacts in words, and a sketch with a dot at each active contact."""
    x, y = centre
    corner = (x - WIDTH / 2, y - HEIGHT / 2)
    ax.add_patch(
        FancyBboxPatch(corner, WIDTH, HEIGHT, boxstyle="round,pad=0,rounding_size=0.12", fc="white", ec=INK)
    )
    ax.text(x + 0.35, y + 0.18, name, ha="center", va="center", fontsize=13, weight="bold", color=INK)
    ax.text(x + 0.35, y - 0.22, words, ha="center", va="center", fontsize=8, color=INK)
    left, floor, radius = x - 0.9, y - 0.45, 0.2
    ax.plot((left - 0.25, left + 0.25), (floor, floor), color=INK, lw=2)
    gap = 0.08 * (not ball_table)
    lower = floor + gap + radius
    upper = lower + 2 * radius + 0.08 * (not ball_ball)
    for height in (lower, upper):
        ax.add_patch(Circle((left, height), radius, fc="white", ec=INK))
    for height, acts in ((floor + gap / 2, ball_table), ((lower + upper) / 2, ball_ball)):
        if acts:
            ax.add_patch(Circle((left, height), 0.06, fc=ACTING, ec=ACTING, zorder=3))


def main():
    """Write the figure into the folder of this script, with the same bytes at every run."""
    mpl.rcParams.update({"svg.hashsalt": "states", "font.family": "DejaVu Sans"})
    fig, ax = plt.subplots(figsize=(7.2, 4.1), layout="constrained")
    for name, state in STATES.items():
        draw_state(ax, name, *state)
    for start, end, bend, words, place in EVENTS:
        arrow = FancyArrowPatch(
            start, end, connectionstyle=f"arc3,rad={bend}", arrowstyle="-|>", mutation_scale=11, color=INK
        )
        ax.add_patch(arrow)
        ax.text(*place, words, ha="center", va="center", fontsize=8, color=INK, backgroundcolor="white")
    ax.set(xlim=(-5.3, 5.3), ylim=(-0.75, 5.15), aspect="equal")
    ax.axis("off")
    fig.savefig(Path(__file__).with_suffix(".svg"), facecolor="white", metadata={"Date": None})


if __name__ == "__main__":
    main()
