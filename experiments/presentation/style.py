"""Style of the figures, and functions that save figures.

The functions here need Matplotlib. All modules of `pictures` and the commands that draw call them.
"""

from __future__ import annotations

from collections.abc import Generator, Iterable, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.backends.backend_pdf import FigureCanvasPdf
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from matplotlib.legend import Legend

from impact_xval.experiments.presentation.words import format_axis_value
from impact_xval.experiments.tables.folder import write_json
from impact_xval.experiments.tables.frames import AxisValue
from impact_xval.experiments.tables.parquet import replacing

if TYPE_CHECKING:
    from matplotlib.typing import RcKeyType  # old releases of Matplotlib do not have this type

#: Name of the file that holds the captions of the figures of a run.
CAPTIONS = "captions.json"

#: A figure that was drawn: its name, the figure itself, and its caption.
Drawn = tuple[str, Figure, str]

#: Sentence for the captions of figures that leave out marked cells.
LEFT_OUT = "Cells in which a tiny change of a parameter flips the outcome (marked cells) are left out."

#: Parameters of Matplotlib for all figures.
_PARAMETERS: dict[RcKeyType, object] = {
    "figure.constrained_layout.use": True,
    "font.size": 9,
    "axes.grid": True,
    "grid.color": "0.9",
    "axes.axisbelow": True,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "legend.frameon": False,
    "lines.linewidth": 1.6,
    "lines.markersize": 4.5,
    "svg.hashsalt": "impact-xval",
    "pdf.fonttype": 42,  # TrueType: some publishers refuse the default, Type 3
}


@contextmanager
def styled_figure(width: float, height: float) -> Generator[Figure]:
    """Yield an empty figure of a size in inches. The style of the project is set only inside the `with` block."""
    with mpl.rc_context(_PARAMETERS):
        yield Figure(figsize=(width, height), layout="constrained")


def draw_legend_beside(axes: Axes) -> Legend:
    """Draw the legend of axes to the right of the axes, and return it."""
    return axes.legend(loc="center left", bbox_to_anchor=(1.01, 0.5))


def label_axis_values(axis: Axis, values: Sequence[AxisValue], most: int) -> None:
    """Label the positions 0, 1, ... of an axis with the given values, with at most `most` labels."""
    step = max(1, -(-len(values) // most))
    axis.set_ticks(range(0, len(values), step), [format_axis_value(value, 2) for value in values[::step]])


def _widen_limits(low: float, high: float) -> tuple[float, float]:
    """Return the limits of an axis, widened if they differ only by rounding, because such an axis has no ticks."""
    reach = 1e-9 * max(abs(low), abs(high))
    return (low, high) if abs(high - low) > reach else (low - reach, high + reach)


def save_figure(figure: Figure, folder: Path, name: str) -> None:
    """Write a figure as ``NAME.svg`` and ``NAME.pdf``. The same figure always gives the same bytes."""
    for ax in figure.axes:
        ax.minorticks_off()  # minor ticks have invisible labels, which take half of the time of the layout
        ax.set_xlim(_widen_limits(*ax.get_xlim()), auto=None)
        ax.set_ylim(_widen_limits(*ax.get_ylim()), auto=None)
    # The figure is laid out here once, because `savefig` would lay out and draw it twice for each format.
    figure.draw_without_rendering()
    figure.set_layout_engine("none")  # the layout is final from here on
    with mpl.rc_context(_PARAMETERS), replacing(folder / f"{name}.svg") as temporary:
        FigureCanvasSVG(figure).print_svg(temporary, metadata={"Date": None})
    with mpl.rc_context(_PARAMETERS), replacing(folder / f"{name}.pdf") as temporary:
        FigureCanvasPdf(figure).print_pdf(temporary, metadata={"CreationDate": None})


def save_figures(figures: Iterable[Drawn], folder: Path) -> dict[str, str]:
    """Write figures, and their captions as ``captions.json``. Return the captions by name of the figure."""
    captions: dict[str, str] = {}
    for name, figure, caption in figures:
        save_figure(figure, folder, name)
        captions[name] = caption
    write_json(folder / CAPTIONS, captions)
    return captions


def save_picture(figure: Figure, path: Path) -> None:
    """Write a figure in the format of the suffix of its path: .png, .svg or .pdf.

    The same figure always gives the same bytes.
    """
    dates = {".svg": {"Date": None}, ".pdf": {"CreationDate": None}}
    with mpl.rc_context(_PARAMETERS), replacing(path) as temporary:
        figure.savefig(temporary, format=path.suffix[1:], dpi=200, metadata=dates.get(path.suffix))
