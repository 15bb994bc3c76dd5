"""Forces of both contacts of one collision on two clocks: the impulse that has passed, and time."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from matplotlib.figure import Figure

from impact_xval.experiments.config.configuration import REFERENCE
from impact_xval.experiments.measures.summary import Frame
from impact_xval.experiments.presentation.looks import look
from impact_xval.experiments.presentation.pages import phrase
from impact_xval.experiments.presentation.pictures.history import passed_at
from impact_xval.experiments.presentation.style import drawing

#: Clocks, in the order of the columns.
_CLOCKS = ("impulse", "time")


def draw_timelines(
    curves: Frame, solvers: Sequence[str], cell: dict[str, float]
) -> Iterator[tuple[str, Figure, str]]:
    """Draw the forces of one collision by every solver: name, figure, caption; nothing where none has a finite clock.

    Parameters
    ----------
    curves : DataFrame
        Of that collision, as a run stores them (`sweep.curves`).
    solvers : sequence of str
        In their order.
    cell : dict
        Its parameters, by what a reader knows them by.
    """
    lines = {name: line for name in solvers if (line := _line(curves[curves.solver == name])) is not None}
    if lines:
        caption = phrase("pictures.md.j2", "timelines", REFERENCE, list(lines), cell)
        yield "force-timelines", _figure(lines), caption


def _line(rows: Frame) -> tuple[np.ndarray, np.ndarray] | None:
    """Time, shape (n,), and impulses so far, shape (n, 2), at instants that rise; None without a finite clock."""
    time = rows.time.to_numpy(dtype=float)
    if len(time) < 2 or not (np.isfinite(time).all() and time[-1] > time[0]):
        return None
    rising = np.append(np.diff(time) > 0, True)
    return time[rising], rows[["impulse1", "impulse2"]].to_numpy(dtype=float)[rising]


def _figure(lines: dict[str, tuple[np.ndarray, np.ndarray]]) -> Figure:
    with drawing(8.6, 4.6) as figure:
        axes = figure.subplots(2, 2, sharex="col", sharey="row", squeeze=False)
        last = {clock: 0.0 for clock in _CLOCKS}
        for position, (name, (time, impulses)) in enumerate(lines.items()):
            style = look(name, position)
            forces = np.diff(impulses, axis=0) / np.diff(time)[:, None]
            for column, (clock, x) in enumerate(zip(_CLOCKS, (impulses.sum(axis=1), time), strict=True)):
                last[clock] = max(last[clock], passed_at(x, impulses))
                for contact in range(2):
                    model = name == REFERENCE
                    axes[contact, column].plot(
                        0.5 * (x[1:] + x[:-1]),
                        forces[:, contact],
                        color=style.color,
                        linestyle=style.dash,
                        linewidth=2.2 if model else 1.4,
                        alpha=0.85 if model else 1,
                        label=name,
                    )
        for contact, ax in enumerate(axes[:, 0]):
            ax.set_ylabel(phrase("pictures.md.j2", "force", contact + 1))
        axes[1, 0].set_xlabel(r"$(I_1 + I_2)\,/\,(m_1 |v_0|)$")
        axes[1, 1].set_xlabel(r"time$\,/\,\sqrt{m_1/k_1}$")
        for ax, clock in zip(axes[0], _CLOCKS, strict=True):
            ax.set_title(phrase("pictures.md.j2", f"clock_{clock}"), fontsize=9)
            ax.set_xlim(0, 1.04 * last[clock])
        handles = axes[0, 0].get_legend_handles_labels()
        figure.legend(*handles, loc="outside lower center", ncols=min(len(lines), 6), fontsize=8)
    return figure
