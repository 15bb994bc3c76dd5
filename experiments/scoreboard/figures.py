"""The board as pictures: one field an entrant and a case."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pandas as pd
from matplotlib import colormaps
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure

from impact_xval.experiments.measures.aggregates import Frame
from impact_xval.experiments.presentation.pages import phrase
from impact_xval.experiments.presentation.style import drawing
from impact_xval.experiments.scoreboard.playing import EXACT

#: Measures that are drawn.
DRAWN = ("divergence", "law_divergence", "spread")

#: Ends of the scale of colours.
_LOW, _HIGH = 1e-4, 1.0


def draw_board(board: Frame) -> Iterator[tuple[str, Figure, str]]:
    """Draw each measure, of every entrant and case: name, figure, caption; none where nothing has it."""
    for measure in DRAWN:
        rows = board if measure == "divergence" else board[board.engine != EXACT]
        if rows[measure].notna().any():
            caption = phrase("scoreboard_words.md.j2", f"caption_{measure}", _LOW)
            yield f"board-{measure.replace('_', '-')}", _map(rows, measure), caption


def _map(rows: Frame, measure: str) -> Figure:
    solvers, names = list(dict.fromkeys(rows.solver)), list(dict.fromkeys(rows.case))
    restitutions = list(dict.fromkeys(rows.e))
    places = pd.MultiIndex.from_product([names, restitutions])
    table = (
        rows.set_index(["solver", "case", "e"])[measure]
        .unstack([1, 2])
        .reindex(index=solvers, columns=places)
    )
    answered = (rows.set_index(["solver", "case", "e"]).status != "unavailable").unstack([1, 2])
    answered = answered.reindex(index=solvers, columns=places).to_numpy(dtype=bool)
    values = table.to_numpy(dtype=float)
    with drawing(9.2, 1.6 + 0.2 * len(solvers)) as figure:
        ax = figure.subplots()
        image = ax.imshow(
            np.clip(values, _LOW, None), norm=LogNorm(_LOW, _HIGH), cmap=colormaps["viridis"], aspect="auto"
        )
        for row, column in np.argwhere(np.isnan(values)):
            sign = "x" if answered[row, column] and measure == "divergence" else "·"
            ax.text(column, row, sign, ha="center", va="center", fontsize=7, color="0.4")
        ax.set_yticks(range(len(solvers)), solvers, fontsize=7)
        ax.set_xticks(range(len(places)), [f"{e:g}" for _ in names for e in restitutions], fontsize=7)
        ax.set_xlabel("coefficient of restitution e (-)")
        for at, name in enumerate(names):
            middle = (at + 0.5) * len(restitutions) - 0.5
            ax.text(middle, -0.9, name.replace(", ", ",\n"), ha="center", va="bottom", fontsize=7)
            ax.axvline((at + 1) * len(restitutions) - 0.5, color="white", linewidth=2.5)
        ax.grid(False)
        for spine in ax.spines.values():
            spine.set_visible(False)
        figure.colorbar(image, ax=ax, label="D (-)", extend="both")
    return figure
