"""One collision in slow motion: balls, contacts and forces by the model and, beside it, by another solver."""

from __future__ import annotations

import base64
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.artist import Artist
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle
from matplotlib.text import Text
from numpy.typing import NDArray
from PIL import Image

from impact_xval.compliant_baselines.registry import is_engine
from impact_xval.experiments.config.arrangements import Arranged
from impact_xval.experiments.config.experiment import REFERENCE, Config
from impact_xval.experiments.presentation.html import page_of, render
from impact_xval.experiments.presentation.pictures.curves import by_ratios
from impact_xval.experiments.presentation.pictures.history import Floats, History, history_of, passed_at
from impact_xval.experiments.presentation.style import drawing
from impact_xval.experiments.presentation.words import arranged, named
from impact_xval.experiments.tables.numbers import number
from impact_xval.experiments.tables.parquet import replacing
from impact_xval.model.collision import RESULT_STATUSES, Collision, Outcome

Pixels = NDArray[np.uint8]

_STATES = ("S1: both contacts act", "S2: ball on table", "S3: ball on ball", "S4: no contact acts")

_CLOCK = "The model has no time: its clock is how long its forces take to pass on its impulses."

#: Pictures of a collision, and pictures a second.
FRAMES, RATE = 100, 10
_DPI = 100
#: Colours of a picture.
_COLORS = 128

#: Colours of contacts 1 and 2 of two balls, those of the states in which they act alone.
CONTACT_COLORS = ("#D55E00", "#0072B2")
_BALLS, _IDLE = ("#B0B0B0", "#D0D0D0"), "0.75"

#: Of a scene: natural length of a spring, and how much of it the largest compression takes.
_SPRING, _COMPRESSED = 0.6, 0.8
#: Largest and smallest radius of a ball; room to rise, and to fall where there is no table.
_RADIUS, _SMALL, _RISE, _FALL = 0.45, 0.16, 0.7, 1.4
#: Length of the arrow of abs(v0), and of the bar of the largest force.
_ARROW, _BAR = 0.7, 0.75
#: Points of a spring: across, and up from its lower end over its length.
_ZIGZAG = (
    np.array([0, 0, 1, -1, 1, -1, 1, -1, 0, 0]) * 0.12,
    np.array([0, 0.1, 0.17, 0.3, 0.43, 0.57, 0.7, 0.83, 0.9, 1]),
)


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """What is animated: a collision, which it is in words, and its histories by solver, the model first."""

    collision: Collision
    what: str
    histories: dict[str, History]

    @classmethod
    def of(
        cls, collision: Collision, outcomes: Mapping[str, Outcome], config: Config, column: Arranged | None
    ) -> Motion:
        """Put the model beside an engine, or else another solver; a ValueError says that one has no path in time.

        The configuration says how they solved it, and `column` what the collision is, if a column.
        """
        drop, shown = config.scenario == "drop", {}
        for name in sorted(outcomes, key=lambda name: (name != REFERENCE, not is_engine(name))):
            outcome = outcomes[name]
            weight = config.gravity if drop and name != REFERENCE else 0.0
            if outcome.status in RESULT_STATUSES and outcome.path is not None:
                history = history_of(collision, outcome.path, weight)
                shown |= {name: history} if history is not None else {}
        if REFERENCE not in shown or len(shown) < 2:
            raise ValueError(
                "needs the model and another solver with a path in finite time; legal: such a collision, or FILE.png"
            )
        what = (
            arranged(column) if column is not None else f"{by_ratios(collision)}, scenario {config.scenario}"
        )
        what += ", in which the model has no gravity" if drop else ""
        return cls(collision, what, dict(list(shown.items())[:2]))

    @property
    def instants(self) -> Floats:
        """Instants of the pictures: a little beyond the last one that matters to a solver."""
        ends = (passed_at(each.time, each.impulses.sum(axis=1)) for each in self.histories.values())
        return np.linspace(0.0, 1.12 * max(ends), FRAMES)

    @property
    def colors(self) -> list[Any]:
        """Colours of the contacts."""
        count = len(self.collision.stiffnesses)
        return [
            *(CONTACT_COLORS[:count] if count <= 2 else colormaps["viridis"](np.linspace(0, 0.92, count)))
        ]

    def title(self) -> str:
        """Say who is shown."""
        return f"One collision in slow motion: {' and '.join(map(named, self.histories))}"

    def caption(self) -> str:
        """Say what is shown, and what the clock is."""
        seconds = self.instants[-1] * self.collision.units.time
        c, slower = self.collision, number(FRAMES / RATE / seconds, 2)
        unit = "N/m" if c.exponent == 1 else f"N/m^{number(c.exponent)}"
        return (
            f"{self.title()}: {self.what}; {slower} times slower than at m1 = {number(c.masses[0])} kg, k1 = "
            f"{number(c.stiffnesses[0])} {unit}. Balls and springs show heights with compressions enlarged, a grey "
            "spring carries no force; arrows are velocities, bars the forces of the contacts, 1 on top, which stand "
            f"over time below. {_CLOCK} The model's heights are those that its velocities imply. Where its balls still "
            "overlap when a contact has ended, its assumption of frozen positions shows."
        )


def _at_rest(c: Collision) -> tuple[Floats, Floats]:
    """Radii of the balls in a picture, and heights of their middles where all springs are unloaded and touch."""
    masses = np.array(c.masses)
    radii = np.maximum(_RADIUS * (masses / masses.max()) ** (1 / 3), _SMALL)
    springs = np.full(len(masses), _SPRING)
    springs[-1] *= c.table
    return radii, np.cumsum((springs + 2 * radii)[::-1])[::-1] - radii


def _moving(motion: Motion, scale: float, strongest: float, now: tuple[Any, ...]) -> Iterator[Artist]:
    """Give what moves in the picture of a solver: springs, balls, bars of force, arrows of velocity, the state."""
    heights, velocities, forces, acting = now
    radii, at_rest = _at_rest(motion.collision)
    middles, top = at_rest + scale * heights, at_rest[0] + radii[0] + _RISE
    tops = np.append(middles + radii, 0.0)[1:]  # of what is below a contact, the table last
    ends = list(zip(tops, np.minimum(middles - radii, tops + _SPRING), strict=True))
    contacts = list(zip(ends, motion.colors, acting, forces, strict=False))  # the last ball may have none
    for (low, high), color, acts, _ in contacts:
        zigzag = low + (high - low) * _ZIGZAG[1]
        yield Line2D(_ZIGZAG[0], zigzag, linewidth=1.6, color=color if acts else _IDLE)
    for i, (y, radius) in enumerate(zip(middles, radii, strict=True)):
        yield Circle((0, y), radius, facecolor=_BALLS[i % 2], edgecolor="black")
        yield Text(0, y, f"B{i + 1}", ha="center", va="center", fontsize=9)
    for (low, high), color, _, force in contacts:
        place = [0.28, 0.28 + _BAR * max(force, 0.0) / strongest], [0.5 * (low + high)] * 2
        yield Line2D(*place, color=color, linewidth=6, solid_capstyle="butt")
    for y, radius, v in zip(middles, radii, velocities, strict=True):
        if abs(v) > 1e-3:
            head = {"marker": "^" if v > 0 else "v", "markersize": 6, "markevery": [1]}
            yield Line2D([-radius - 0.15] * 2, [y, y + _ARROW * v], color="black", linewidth=1.4, **head)
    if motion.collision.falls_on_resting:
        state = _STATES[3 - acting @ np.array([1, 2])]
        yield Text(-1.25, top, state, fontsize=9.5, va="top", fontweight="bold", clip_on=False)


def frames_of(motion: Motion) -> Iterator[Pixels]:
    """Draw the pictures of a motion, shape (height, width, 3) each; all but what moves is drawn once.

    There is a scene a solver, and below it the forces of the contacts over time.
    """
    instants, histories = motion.instants, motion.histories.values()
    shown = [(each, each.time <= instants[-1]) for each in histories]
    largest = max(each.compressions[some].max() for each, some in shown)
    scale = _COMPRESSED * _SPRING / largest if largest > 0 else 1.0
    forces = np.concatenate([each.forces[some[1:]] for each, some in shown])
    strongest, least = float(forces.max()), min(0.0, float(forces.min()))
    with drawing(7.6, 5.0 + 0.4 * min(len(motion.collision.masses), 20)) as figure:
        figure.dpi = _DPI
        panels = _set_up(figure, motion, 1.08 * least, 1.08 * strongest)
        moving = [zip(*each.at(instants), strict=True) for each in histories]
        canvas = FigureCanvasAgg(figure)
        canvas.draw()
        still = canvas.copy_from_bbox(figure.bbox)
        for instant, *states in zip(instants, *moving, strict=True):
            canvas.restore_region(still)
            for (scene, below), now in zip(panels, states, strict=True):
                across = {"transform": below.get_xaxis_transform(), "color": "black", "linewidth": 0.9}
                _draw(scene, *_moving(motion, scale, strongest, now))
                _draw(below, Line2D([instant, instant], [0, 1], **across))
            yield np.asarray(canvas.buffer_rgba())[..., :3].copy()


def _draw(ax: Any, *artists: Artist) -> None:
    """Draw artists into axes, which do not keep them."""
    for artist in artists:
        ax.add_artist(artist)
        ax.draw_artist(artist)
        artist.remove()


def _set_up(figure: Figure, motion: Motion, least: float, most: float) -> list[tuple[Any, Any]]:
    """Draw all that does not move; by solver the axes of its scene, and of its forces, which have these limits."""
    c, last, panels = motion.collision, motion.instants[-1], []
    radii, at_rest = _at_rest(c)
    limits = (-0.12 if c.table else -_FALL, at_rest[0] + radii[0] + _RISE)
    figure.set_layout_engine("none")
    high = figure.get_figheight()
    sides = {"left": 0.08, "right": 0.98, "top": 1 - 0.58 / high, "bottom": 1 / high, "hspace": 0.08}
    grid = figure.add_gridspec(2, len(motion.histories), height_ratios=(high - 2.6, 1), **sides)
    for column, (name, history) in enumerate(motion.histories.items()):
        scene = figure.add_subplot(grid[0, column])
        scene.set_title(named(name), pad=8)
        scene.set(xlim=(-1.25, 1.25), ylim=limits, aspect="equal")
        scene.axis("off")
        if c.table:
            scene.fill_between([-1.25, 1.25], -0.12, 0, color="0.55", linewidth=0)
        below = figure.add_subplot(grid[1, column])
        for i, color in enumerate(motion.colors, 1):
            label = f"contact {i}, with the table" if i == len(c.masses) else f"contact {i}"
            below.plot(history.between, history.forces[:, i - 1], color=color, label=label, linewidth=1.3)
        time = "time / sqrt(m1/k1) (-)" if c.exponent == 1 else "time (-)"
        below.set(xlim=(0, last), ylim=(least, most), xlabel=time)
        below.tick_params(labelleft=column == 0)
        panels.append((scene, below))
    figure.axes[1].set_ylabel("force (-)")
    lines = figure.axes[1].get_legend_handles_labels()
    if len(motion.colors) <= 6:
        figure.legend(*lines, loc="lower center", bbox_to_anchor=(0.53, 0.17 / high), ncols=6, fontsize=8)
    figure.suptitle(motion.what, fontsize=10)
    figure.text(0.01, 0.07 / high, f"{_CLOCK} Compressions are enlarged.", fontsize=7, color="0.3")
    return panels


def write_animation(motion: Motion, path: Path) -> None:
    """Write an animation as GIF or a page that needs nothing else, as the suffix of the file says."""
    pictures = list(frames_of(motion))
    # One palette, that of the first and the middle one: in these are all colours.
    both = np.vstack([pictures[0], pictures[len(pictures) // 2]])
    palette = Image.fromarray(both).quantize(_COLORS, Image.Quantize.MAXCOVERAGE)  # white stays white
    first, *others = (
        Image.fromarray(each).quantize(palette=palette, dither=Image.Dither.NONE) for each in pictures
    )
    with replacing(path) as temporary:
        if path.suffix == ".gif":
            first.save(temporary, "GIF", save_all=True, append_images=others, duration=1000 / RATE, loop=0)
            return
        shown = []
        for picture in (first, *others):
            picture.save(file := BytesIO(), "PNG", optimize=True)
            shown.append(base64.b64encode(file.getvalue()).decode("ascii"))
        player = render("player.html.j2", title=motion.title(), pictures=shown, pause=1000 // RATE)
        temporary.write_text(page_of(motion.title(), [player, motion.caption()]), encoding="utf-8")
