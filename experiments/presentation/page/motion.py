"""The frame of a slow motion on the page, which its own script fills from curves (`cells.clocked_curve`)."""

from __future__ import annotations

from bokeh.models import ColumnDataSource, Span
from bokeh.plotting import figure
from markupsafe import Markup

from impact_xval.experiments.config.configuration import REFERENCE
from impact_xval.experiments.config.grid import collision_of
from impact_xval.experiments.presentation.looks import CONTACT_COLORS
from impact_xval.experiments.presentation.page.cells import clocked_curve, fall
from impact_xval.experiments.presentation.page.charts import embedded
from impact_xval.experiments.presentation.page.html import render_markup
from impact_xval.experiments.presentation.pages import phrase
from impact_xval.experiments.presentation.pictures.history import clocked
from impact_xval.experiments.sweep.curves import CURVES, CURVES_SCHEMA, FIGURE_CELL
from impact_xval.experiments.tables.store import RunFolder

#: Points of a curve of the figures.
_POINTS = 250

_WORDS = "pictures.md.j2"


def motion_of_cell() -> Markup:
    """Return the frame for the cell that is open, by the exact solvers."""
    return _frame("cell", None)


def motion_of_figures(folder: RunFolder) -> Markup:
    """Return the frame for the collision of the figures, by all solvers of the run that have its curve."""
    config = folder.config()
    collision = collision_of(config, config.figure_cell)
    table = folder.read_table(CURVES, CURVES_SCHEMA).to_pandas()
    histories = {
        str(name): clocked(
            rows.time.to_numpy(),
            rows[["v1", "v2"]].to_numpy(),
            rows[["impulse1", "impulse2"]].to_numpy(),
            rows.state.to_numpy(),
        )
        for name, rows in table[table.curve == FIGURE_CELL].groupby("solver", sort=False)
    }
    facts = {
        "clocked": {name: clocked_curve(each, _POINTS) for name, each in histories.items() if each},
        "stiffness": collision.stiffness_ratio,
        "mass": collision.mass_ratio,
        "gravity": fall(config, collision),
    }
    return _frame("figures", facts)


def _frame(place: str, collision: dict[str, object] | None) -> Markup:
    return render_markup(
        "slow_motion.html.j2",
        id=place,
        model=REFERENCE,
        collision=collision,
        chart=embedded(f"forces-{place}", _forces(place)),
    )


def _forces(place: str) -> object:
    """Draw empty forces over time, of the model thick and of another solver thin, and a line at an instant."""
    plot = figure(
        height=200,
        sizing_mode="stretch_width",
        tools="",
        toolbar_location=None,
        x_axis_label="time/sqrt(m1/k1) (-)",
        y_axis_label="force/(|v0| sqrt(m1 k1)) (-)",
    )
    for contact, color in enumerate(CONTACT_COLORS, start=1):
        for who, width in (("model", 3.5), ("beside", 1.5)):
            source = ColumnDataSource({"x": [], "y": []}, name=f"force {place} {who} {contact}")
            plot.line(
                "x",
                "y",
                source=source,
                color=color,
                line_alpha=0.45 if who == "model" else 1.0,
                line_width=width,
                legend_label=phrase(_WORDS, "contact", contact),
            )
    plot.add_layout(Span(location=0, dimension="height", line_color="#404040", name=f"now {place}"))
    plot.legend.background_fill_alpha = 0.6
    plot.legend.label_text_font_size = "11px"
    return plot
