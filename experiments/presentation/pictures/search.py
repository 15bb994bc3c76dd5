"""The figure of a search: how it went, and where in the box it found what."""

from __future__ import annotations

import numpy as np
import pyarrow.parquet as pq

from impact_xval.experiments.config.axes import AXES
from impact_xval.experiments.config.configuration import Config
from impact_xval.experiments.measures.summary import SUMMARISED
from impact_xval.experiments.presentation.pages import phrase
from impact_xval.experiments.presentation.style import drawing, save
from impact_xval.experiments.sweep.search import EVALUATIONS, Found
from impact_xval.experiments.tables.store import RunFolder, write_text

FIGURE = "search"


def write_figure(folder: RunFolder, config: Config, found: Found) -> None:
    """Draw ``search.png`` and ``search.pdf``, and write their caption to ``search.txt``."""
    search = found.search
    label = f"{SUMMARISED[search.measure]} (-)"
    table = pq.read_table(folder.root / EVALUATIONS).to_pandas()
    table = table[table.marked.isna()]
    values = table[search.measure].abs()
    generation = table.cell // search.population
    free = search.free()
    with drawing(2.3 * (len(free) + 1) + 1.0, 3.0) as figure:
        axes = figure.subplots(1, len(free) + 1, sharey=True, squeeze=False)[0]
        axes[0].plot(np.arange(len(found.best)), found.best, color="black")
        axes[0].set_xlabel("generation")
        axes[0].set_ylabel(label)
        points = [
            ax.scatter(table[axis], values, c=generation, s=5, cmap="viridis", linewidths=0, rasterized=True)
            for ax, axis in zip(axes[1:], free, strict=True)
        ]
        for ax, axis in zip(axes[1:], free, strict=True):
            if "log" in search.ranges()[axis]:  # type: ignore[operator]
                ax.set_xscale("log")
            ax.set_xlim(*search.ends()[axis])
            if found.rows:
                worst = found.rows[0]
                ax.plot(worst[axis], abs(worst[search.measure]), "r*", markersize=10, clip_on=False)
            ax.set_xlabel(AXES[axis])
        figure.colorbar(points[0], ax=list(axes), label="generation")
        save(figure, folder.root, FIGURE)
    write_text(folder.root / f"{FIGURE}.txt", caption(found) + "\n")


def caption(found: Found) -> str:
    """Say what the figure shows, so that it can stand alone."""
    search = found.search
    fixed = {AXES[name]: low for name, (low, high) in search.ends().items() if low == high}
    return phrase("captions.md.j2", "search", found, SUMMARISED[search.measure], fixed)
