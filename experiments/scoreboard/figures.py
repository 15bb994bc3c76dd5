"""Pictures of a scoreboard: the collisions, how far from the model every answer is, and how a cradle ends."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.colors import LogNorm
from matplotlib.patches import Circle

from impact_xval.experiments.presentation.style import drawing, save
from impact_xval.experiments.scoreboard.cases import COLUMNS, PICTURED, RESTITUTIONS, Case, cases
from impact_xval.experiments.scoreboard.judging import MODEL, Board

CASES = (
    "The collisions: arrows show which balls move at first, at 1 m/s. Balls of 1 kg, the lower one of a drop of 2 kg; "
    "contacts of 1e8 N/m, the table's in a drop k2/k1 times as stiff. A gap of 1 mm is drawn wider."
)

DIVERGENCE = (
    "D from the state-transition model, by solver and collision; in each group e = 1, 0.9, 0.5, 0 from left to right, "
    "the darker the farther. White: no answer. The model knows no gaps, so that the chain with gaps is left out."
)

CRADLE = (
    f"How a {PICTURED} ends at e = 1: velocities of the five balls, over that of the striker before (grey). Exact laws "
    "first, in black, then engines; laws with the same row cannot be told apart by this collision."
)


def draw_all(made: Board, folder: Path) -> None:
    """Draw all pictures into a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    draw_cases(folder)
    draw_divergence(made, folder)
    draw_cradle(made, folder)


def draw_cases(folder: Path) -> None:
    """Draw the balls of every collision at the start."""
    with drawing(9.5, 2.1) as figure:
        for ax, name in zip(figure.subplots(1, len(COLUMNS)), COLUMNS, strict=True):
            column = Case(name, 1.0).arranged.column()
            below = np.array([0.6 * (gap > 0) for gap in column.gaps] + [0.0] * (not column.table))
            heights = 2.0 * np.arange(len(column.masses), 0, -1) - 1 + np.cumsum(below[::-1])[::-1]
            for z, v in zip(heights, column.velocities, strict=True):
                ax.add_patch(Circle((0, z), 0.95, facecolor="0.85", edgecolor="0.2"))
                if v:
                    ax.annotate(
                        "", (0, z - 1.0), (0, z + 0.9), arrowprops={"arrowstyle": "->", "color": "#0b5cad"}
                    )
            if column.table:
                ax.axhline(0, color="0.2", linewidth=2)
            ax.set(xlim=(-2, 2), ylim=(-0.5, 11), aspect="equal")
            ax.set_title(name.replace(", ", "\n").replace("cradle ", "cradle\n"), fontsize=8)
            ax.axis("off")
    save(figure, folder, "cases")


def draw_divergence(made: Board, folder: Path) -> None:
    """Draw D from the model, a row a solver and a column a case."""
    names = [*made.engines, *(name for name in made.exact if name != MODEL)]
    grid = made.judged.pivot_table(index="solver", columns=["case", "e"], values=f"D_{MODEL}")
    known = [name for name in COLUMNS if not COLUMNS[name].get("gap")]
    grid = grid.reindex(index=names, columns=[(case.name, case.e) for case in cases() if case.name in known])
    with drawing(9.5, 0.9 + 0.24 * len(names)) as figure:
        ax, n = figure.subplots(), len(RESTITUTIONS)
        ax.grid(visible=False)
        shown = np.ma.masked_invalid(np.maximum(grid.to_numpy(float), 1e-4))
        image = ax.imshow(shown, aspect="auto", cmap="viridis_r", norm=LogNorm(1e-4, 1.0))
        ax.set_yticks(range(len(names)), list(map(made.called, names)))
        titles = [name.replace(", ", "\n").replace("cradle ", "cradle\n") for name in known]
        ax.set_xticks([n * i + (n - 1) / 2 for i in range(len(known))], titles)
        for i in range(1, len(known)):
            ax.axvline(n * i - 0.5, color="white", linewidth=3)
        ax.axhline(len(made.engines) - 0.5, color="black", linewidth=1)
        figure.colorbar(image, label="D from the model (-)", extend="min", fraction=0.03)
    save(figure, folder, "divergence")


def draw_cradle(made: Board, folder: Path) -> None:
    """Draw how the balls of a cradle leave, a row a solver."""
    found = made.judged[(made.judged.case == PICTURED) & (made.judged.e == 1)].set_index("solver")
    v = -found.reindex([*made.exact, *made.engines])[[f"v{i}" for i in range(1, 6)]].dropna()
    colors = ["#0b5cad" if name in made.engines else "#1a1a1a" for name in v.index]
    with drawing(9.5, 0.8 + 0.26 * len(v)) as figure:
        axes = figure.subplots(1, 5, sharey=True)
        for ball, ax in enumerate(axes, 1):
            ax.barh(range(len(v)), v[f"v{ball}"], height=0.7, color=colors)
            ax.axvline(1.0 if ball == 1 else 0.0, color="0.6", linewidth=3, zorder=0)
            ax.set_xlim(-0.7, 1.1)
            ax.set_title(f"ball {ball}", fontsize=9)
            ax.set_xlabel("v/v0 (-)")
        axes[0].set_yticks(range(len(v)), list(map(made.called, v.index)))
        axes[0].invert_yaxis()
    save(figure, folder, "cradle")
