"""One collision in slow motion: balls, contacts and forces by the model and, beside it, by another solver."""

from __future__ import annotations

import base64
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Circle
from numpy.typing import NDArray
from PIL import Image

from impact_xval.experiments.presentation.html import page_of, render
from impact_xval.experiments.presentation.pictures.history import Floats, History
from impact_xval.experiments.presentation.pictures.one import at
from impact_xval.experiments.presentation.style import drawing
from impact_xval.experiments.presentation.words import named
from impact_xval.experiments.tables.numbers import number
from impact_xval.experiments.tables.parquet import replacing
from impact_xval.model.collision import Collision

Pixels = NDArray[np.uint8]

_STATES = ("S1: both contacts act", "S2: ball on table", "S3: ball on ball", "S4: no contact acts")

_CLOCK = (
    "The model has no time: its clock is how long its forces F = sqrt(2 k E) take to pass on its impulses."
)

#: Pictures of a collision, and pictures a second.
FRAMES, RATE = 100, 10

_DPI = 100
#: Colours of a picture.
_COLORS = 64

#: Colours of contacts 1 and 2, those of the states in which they act alone.
CONTACT_COLORS = ("#D55E00", "#0072B2")
_BALLS, _IDLE = ("#B0B0B0", "#D0D0D0"), "0.75"

#: Of a scene: natural length of a spring, and how much of it the largest compression takes.
_SPRING, _COMPRESSED = 0.6, 0.8
#: Largest radius of a ball, smallest radius, and how far it may rise before it leaves the scene.
_RADIUS, _SMALL, _RISE = 0.45, 0.16, 0.7
#: Length of the arrow of abs(v0), and of the bar of the largest force.
_ARROW, _BAR = 0.7, 0.75


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """What is animated.

    Attributes
    ----------
    collision : Collision
    scenario : str
        In which the other solvers were asked; the model has no gravity.
    histories : dict of History
        By solver, the model first.
    """

    collision: Collision
    scenario: str
    histories: dict[str, History]

    @property
    def instants(self) -> Floats:
        """Instants of the pictures: a little beyond the last one that matters to a solver."""
        last = 1.12 * max(each.ended for each in self.histories.values())
        return np.linspace(0.0, last, FRAMES)

    def title(self) -> str:
        """Say who is shown."""
        return f"One collision in slow motion: {' and '.join(map(named, self.histories))}"

    def caption(self) -> str:
        """Say what is shown, and what the clock is."""
        seconds = self.instants[-1] * self.collision.units.time
        c, slower = self.collision, number(FRAMES / RATE / seconds, 2)
        gravity = ", in which the model has no gravity" if self.scenario == "drop" else ""
        return (
            f"{self.title()}: {at(c)}, scenario {self.scenario}{gravity}; {slower} times slower than at m1 = "
            f"{number(c.m1)} kg, k1 = {number(c.k1)} N/m. Balls and springs show heights with compressions enlarged, a "
            "grey spring carries no force; arrows are velocities, bars the forces of contact 1 (ball on "
            "ball) and contact 2 (ball on table) per |v0| sqrt(m1 k1), which stand over time below. "
            f"{_CLOCK} The model's heights are those that its velocities imply. Where its balls still "
            "overlap when a contact has ended, its assumption of frozen positions shows."
        )


class Scene:
    """The picture of one solver: balls, springs, arrows of velocity and bars of force."""

    def __init__(self, ax: Any, motion: Motion, scale: float, strongest: float) -> None:
        self._scale, self._strongest = scale, strongest
        masses = np.array([motion.collision.m1, motion.collision.m2])
        self.radii = np.maximum(_RADIUS * (masses / masses.max()) ** (1 / 3), _SMALL)
        top = 2 * _SPRING + 2 * self.radii.sum()
        ax.set_xlim(-1.25, 1.25)
        ax.set_ylim(-0.12, top + _RISE)
        ax.set_aspect("equal")
        ax.axis("off")
        ax.fill_between([-1.25, 1.25], -0.12, 0, color="0.55", linewidth=0)
        self.balls = [
            Circle((0, 0), r, facecolor=c, edgecolor="black") for r, c in zip(self.radii, _BALLS, strict=True)
        ]
        for ball in self.balls:
            ax.add_patch(ball)
        self.names = [ax.text(0, 0, f"B{i}", ha="center", va="center", fontsize=9) for i in (1, 2)]
        self.springs = [ax.plot([], [], linewidth=1.6, solid_capstyle="round")[0] for _ in range(2)]
        self.bars = [ax.plot([], [], color=c, linewidth=6, solid_capstyle="butt")[0] for c in CONTACT_COLORS]
        self.arrows = [ax.plot([], [], color="black", linewidth=1.4)[0] for _ in range(2)]
        self.heads = [ax.plot([], [], color="black", markersize=6, linestyle="none")[0] for _ in range(2)]
        self.state = ax.text(-1.25, top + _RISE, "", fontsize=9.5, va="top", ha="left", fontweight="bold")
        self.artists = [
            *self.springs,
            *self.balls,
            *self.names,
            *self.bars,
            *self.arrows,
            *self.heads,
            self.state,
        ]
        for artist in self.artists:
            artist.set_animated(True)

    def show(self, heights: Floats, velocities: Floats, forces: Floats, state: int) -> None:
        """Move everything to where it is."""
        rise = np.minimum(self._scale * heights, _RISE)
        r1, r2 = self.radii
        y2 = _SPRING + r2 + rise[1]
        y1 = 2 * _SPRING + 2 * r2 + r1 + rise[0]
        acting = (state in (1, 3), state in (1, 2))
        ends = ((y2 + r2, y1 - r1), (0.0, y2 - r2))
        for contact, (low, high) in enumerate(ends):
            x, y = _zigzag(low, min(high, low + _SPRING))
            self.springs[contact].set_data(x, y)
            self.springs[contact].set_color(CONTACT_COLORS[contact] if acting[contact] else _IDLE)
            length = _BAR * max(float(forces[contact]), 0.0) / self._strongest
            middle = 0.5 * (low + min(high, low + _SPRING))
            self.bars[contact].set_data([0.28, 0.28 + length], [middle, middle])
        for i, y in enumerate((y1, y2)):
            self.balls[i].center = (0.0, y)
            self.names[i].set_position((0.0, y))
            tip = y + _ARROW * velocities[i]
            side = -self.radii[i] - 0.15
            self.arrows[i].set_data([side, side], [y, tip])
            self.heads[i].set_data([side], [tip])
            self.heads[i].set_marker("^" if velocities[i] > 0 else "v")
            self.heads[i].set_visible(abs(velocities[i]) > 1e-3)
        self.state.set_text(_STATES[state - 1])


def _zigzag(low: float, high: float) -> tuple[Floats, Floats]:
    """Points of a spring between two heights."""
    x = np.array([0, 0, 1, -1, 1, -1, 1, -1, 0, 0]) * 0.12
    y = np.array([0, 0.1, 0.17, 0.3, 0.43, 0.57, 0.7, 0.83, 0.9, 1])
    return x, low + (high - low) * y


def frames_of(motion: Motion) -> Iterator[Pixels]:
    """Draw the pictures of a motion, shape (height, width, 3) each; all but what moves is drawn once.

    There is a scene a solver, and below it the forces of both contacts over time.
    """
    instants = motion.instants
    with drawing(7.6, 5.8) as figure:
        figure.dpi = _DPI
        scenes, cursors = _set_up(figure, motion)
        moving = [
            (each.height(instants), each.velocity(instants), each.force(instants), each.state_at(instants))
            for each in motion.histories.values()
        ]
        canvas = FigureCanvasAgg(figure)
        canvas.draw()
        still = canvas.copy_from_bbox(figure.bbox)
        for frame, instant in enumerate(instants):
            canvas.restore_region(still)
            for scene, cursor, values in zip(scenes, cursors, moving, strict=True):
                heights, velocities, forces, state = (each[frame] for each in values)
                scene.show(heights, velocities, forces, int(state))
                cursor.set_xdata([instant] * 2)
                for artist in (*scene.artists, cursor):
                    artist.axes.draw_artist(artist)
            yield np.asarray(canvas.buffer_rgba())[..., :3].copy()


def _set_up(figure: Figure, motion: Motion) -> tuple[list[Scene], list[Any]]:
    """Draw all that does not move; the scenes, and the lines that will stand at the instant that is shown."""
    histories, last = motion.histories, motion.instants[-1]
    within = [each.time <= last for each in histories.values()]
    largest = max(
        each.compressions[some].max() for each, some in zip(histories.values(), within, strict=True)
    )
    forces = np.concatenate(
        [each.forces[some[1:]] for each, some in zip(histories.values(), within, strict=True)]
    )
    strongest, least = float(forces.max()), min(0.0, 1.08 * float(forces.min()))
    scale = _COMPRESSED * _SPRING / largest if largest > 0 else 1.0
    figure.set_layout_engine("none")
    sides = {"left": 0.08, "right": 0.98, "top": 0.9, "bottom": 0.17, "hspace": 0.08}
    grid = figure.add_gridspec(2, len(histories), height_ratios=(3.2, 1), **sides)
    scenes, cursors = [], []
    for column, (name, history) in enumerate(histories.items()):
        ax = figure.add_subplot(grid[0, column])
        ax.set_title(named(name), pad=8)
        scenes.append(Scene(ax, motion, scale, strongest))
        ax = figure.add_subplot(grid[1, column])
        for contact, color in enumerate(CONTACT_COLORS):
            label = f"contact {contact + 1}, {('ball on ball', 'ball on table')[contact]}"
            ax.plot(history.between, history.forces[:, contact], color=color, label=label, linewidth=1.3)
        ax.set_xlim(0, last)
        ax.set_ylim(least, 1.08 * strongest)
        ax.set_xlabel("time / sqrt(m1/k1) (-)")
        ax.tick_params(labelleft=column == 0)
        cursors.append(ax.axvline(0.0, color="black", linewidth=0.9, animated=True))
    figure.axes[1].set_ylabel("force (-)")
    lines = figure.axes[1].get_legend_handles_labels()
    figure.legend(*lines, loc="lower center", bbox_to_anchor=(0.53, 0.03), ncols=2, fontsize=8)
    c = motion.collision
    figure.suptitle(f"{at(c)}, {motion.scenario}", fontsize=10)
    figure.text(0.01, 0.012, f"{_CLOCK} Compressions are enlarged.", fontsize=7, color="0.3")
    return scenes, cursors


def player_of(motion: Motion) -> Markup:
    """Make HTML that plays a motion and needs nothing else."""

    def png(picture: Image.Image) -> str:
        file = BytesIO()
        picture.save(file, "PNG", optimize=True)
        return base64.b64encode(file.getvalue()).decode("ascii")

    pictures = list(map(png, _in_few_colors(frames_of(motion))))
    return render("player.html.j2", title=motion.title(), pictures=pictures, pause=1000 // RATE)


def _in_few_colors(frames: Iterable[Pixels]) -> list[Image.Image]:
    """Give pictures one palette, that of the first and the middle one: in these are all colours."""
    pictures = list(frames)
    both = np.vstack([pictures[0], pictures[len(pictures) // 2]])
    palette = Image.fromarray(both).quantize(_COLORS, Image.Quantize.MAXCOVERAGE)  # white stays white
    return [Image.fromarray(each).quantize(palette=palette, dither=Image.Dither.NONE) for each in pictures]


def write_animation(motion: Motion, path: Path) -> None:
    """Write an animation as GIF or a page that needs nothing else, as the suffix of the file says.

    Raises
    ------
    OSError
        If it cannot be written.
    """
    with replacing(path) as temporary:
        if path.suffix == ".html":
            page = page_of(motion.title(), [player_of(motion), motion.caption()])
            temporary.write_text(page, encoding="utf-8")
        else:
            first, *others = _in_few_colors(frames_of(motion))
            first.save(temporary, "GIF", save_all=True, append_images=others, duration=1000 / RATE, loop=0)
