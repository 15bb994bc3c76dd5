"""Animation of one collision in slow motion: balls, contacts and forces by the model and by other solvers.

An animation needs outcomes with paths. The option ``--plot`` of `solve` calls this module for ``.gif`` and ``.html``
files.

Balls on a table are drawn upright, with the panels of the solvers side by side. Balls in a line without a table are
drawn lying, with one panel below the other. Ball 1 is then on the left, and moves to the right at first.
"""

from __future__ import annotations

import base64
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from io import BytesIO
from itertools import starmap
from pathlib import Path
from typing import NamedTuple, TypeVar

import numpy as np
from matplotlib import colormaps
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle
from matplotlib.text import Text
from matplotlib.typing import ColorType
from numpy.typing import NDArray
from PIL import Image

from impact_xval.compliant_baselines.registry import kind_of
from impact_xval.experiments.config.arrangements import ChainSetup
from impact_xval.experiments.config.experiment import REFERENCE, Config
from impact_xval.experiments.presentation.html import render_page, render_template
from impact_xval.experiments.presentation.pictures.curves import describe_ratios
from impact_xval.experiments.presentation.pictures.history import (
    Floats,
    History,
    instant_of_tail,
    make_history,
)
from impact_xval.experiments.presentation.style import styled_figure
from impact_xval.experiments.presentation.words import describe_chain, display_name
from impact_xval.experiments.tables.numbers import join_words, number
from impact_xval.experiments.tables.parquet import replacing
from impact_xval.model.collision import Collision
from impact_xval.model.outcome import Outcome
from impact_xval.model.status import RESULT_STATUSES

#: Picture of shape (height, width, 3).
Pixels = NDArray[np.uint8]

#: Contact states of two balls on a table. The number of a state is its index plus 1.
_STATES = ("S1: both contacts active", "S2: ball on table", "S3: ball on ball", "S4: no contact active")

#: Largest number of solvers that are shown beside the model.
MOST = 6

#: Sentence on the time of the model, which is stated in impulses.
_CLOCK = "The model has no time of its own. The time shown is the time that its forces would need for its impulses."

#: Number of frames of a collision, and frames per second.
FRAMES, RATE = 100, 10
#: Pixels per inch of a frame.
_DPI = 100
#: Number of colours of a frame.
_COLORS = 128

#: Colours of contacts 1 and 2 of two balls. Each colour is also that of the state in which only this contact is active.
CONTACT_COLORS = ("#D55E00", "#0072B2")
#: Colours of the balls, which alternate, and of springs without force.
_BALLS, _IDLE = ("#B0B0B0", "#D0D0D0"), "0.75"

#: Natural length of a spring in a scene, and the fraction of this length by which the largest compression shortens the
#: spring.
_SPRING, _COMPRESSED = 0.6, 0.8
#: Largest and smallest radius of a ball, room above the balls, and room for balls to move away without a table.
_RADIUS, _SMALL, _RISE, _FALL = 0.45, 0.16, 0.7, 1.4
#: Length of the arrow that stands for the speed abs(v0), and length of the bar that stands for the largest force.
_ARROW, _BAR = 0.7, 0.75
#: Points of a drawn spring: position across the spring, and height above its lower end, divided by its length.
_ZIGZAG = (
    np.array([0, 0, 1, -1, 1, -1, 1, -1, 0, 0]) * 0.12,
    np.array([0, 0.1, 0.17, 0.3, 0.43, 0.57, 0.7, 0.83, 0.9, 1]),
)


#: Horizontal or vertical coordinate of a point, or coordinates of the points of a line.
_Coordinate = TypeVar("_Coordinate", float, Floats)


class Moment(NamedTuple):
    """State of the balls and contacts of a history at one instant."""

    #: Heights and velocities of the balls, shape (N,).
    heights: Floats
    velocities: Floats
    #: Force of each contact, and whether the contact is active, shape (C,).
    forces: Floats
    acting: NDArray[np.bool_]


class SolverAxes(NamedTuple):
    """The two axes of one solver: its scene, and the forces of its contacts over time."""

    scene: Axes
    forces: Axes


@dataclass(frozen=True, slots=True, eq=False)
class SlowMotion:
    """A collision to be animated, with its description `what` and its histories by solver, the model first.

    `left_out` has, for each requested solver that is not shown, the reason why it is not shown.
    """

    collision: Collision
    what: str
    histories: dict[str, History]
    left_out: dict[str, str]

    @classmethod
    def of(
        cls, collision: Collision, outcomes: Mapping[str, Outcome], config: Config, chain: ChainSetup | None
    ) -> SlowMotion:
        """Return the animation of the model and at most `MOST` other solvers, in the order of the outcomes.

        `config` holds the settings that the outcomes were solved with. `chain` is the arrangement of the balls if the
        collision is a chain. A ValueError is raised if no solver other than the model has a path in finite time.
        """
        drop, histories, left_out = config.scenario == "drop", {}, {}
        for name in sorted(outcomes, key=lambda name: name != REFERENCE):
            outcome = outcomes[name]
            weight = config.gravity if drop and name != REFERENCE else 0.0
            if outcome.status not in RESULT_STATUSES:
                left_out[name] = outcome.status
                continue
            history = None if outcome.path is None else make_history(collision, outcome.path, weight)
            if history is None:
                left_out[name] = "no path in finite time"
            elif len(histories.keys() - {REFERENCE}) == MOST:
                left_out[name] = f"at most {MOST} solvers are shown"
            else:
                histories[name] = history
        if not histories.keys() - {REFERENCE}:
            reasons = ", ".join(f"{name}: {reason}" for name, reason in left_out.items())
            raise ValueError(
                "needs a second solver, beside the model, whose path takes a finite time"
                + (f" ({reasons})" if reasons else "")
                + "; legal: such a collision, or FILE.png"
            )
        what = (
            describe_chain(chain)
            if chain is not None
            else f"{describe_ratios(collision)}, scenario {config.scenario}"
        )
        what += "; the model has no gravity" if drop and REFERENCE in histories else ""
        return cls(collision, what, histories, left_out)

    @property
    def lies(self) -> bool:
        """Whether the balls are drawn lying in a row, because there is no table."""
        return not self.collision.table

    @property
    def rigid(self) -> list[str]:
        """Solvers with rigid contacts, whose forces last one time step and exceed the scale of other solvers' forces.

        The list is empty if all solvers have rigid contacts.
        """
        rigid = [name for name in self.histories if kind_of(name) == "rigid"]
        return rigid if len(rigid) < len(self.histories) else []

    @property
    def clock(self) -> str:
        """Sentence on the time of the model; empty if the model is not shown."""
        return _CLOCK if REFERENCE in self.histories else ""

    @property
    def instants(self) -> Floats:
        """Instants of the frames.

        For each solver there is an instant from which on only a fraction `TAIL` of the impulses has still to pass. The
        last frame is a little later than the latest of these instants.
        """
        ends = (
            instant_of_tail(history.time, history.impulses.sum(axis=1)) for history in self.histories.values()
        )
        return np.linspace(0.0, 1.12 * max(ends), FRAMES)

    @property
    def colors(self) -> Sequence[ColorType]:
        """Colours of the contacts."""
        count = len(self.collision.stiffnesses)
        if count <= 2:
            return list(CONTACT_COLORS[:count])
        return list(colormaps["viridis"](np.linspace(0, 0.92, count)))

    def title(self) -> str:
        """Return the title of the animation, which names the solvers."""
        return f"One collision in slow motion: {join_words(map(display_name, self.histories))}"

    def caption(self) -> str:
        """Return the caption, which explains what the animation shows, and the time of the model."""
        seconds = self.instants[-1] * self.collision.units.time
        c, slower = self.collision, number(FRAMES / RATE / seconds, 2)
        unit = "N/m" if c.exponent == 1 else f"N/m^{number(c.exponent)}"
        model = (
            " The model's heights are computed from its velocities. Its balls may still overlap when a contact has "
            "ended, because the model assumes that balls do not move during the collision (frozen positions)."
        )
        cut = (
            f" Forces of {join_words(map(display_name, self.rigid))} last one time step, and are cut off."
            if self.rigid
            else ""
        )
        missing = join_words(f"{display_name(name)} ({why})" for name, why in self.left_out.items())
        heights, first = ("places", "on the left") if self.lies else ("heights", "on top")
        return (
            f"{self.title()}: {self.what}. It is {slower} times slower than the collision at m1 = "
            f"{number(c.masses[0])} kg and k1 = {number(c.stiffnesses[0])} {unit}. Balls and springs show {heights}, "
            f"with enlarged compressions. A grey spring carries no force. Arrows are velocities. Bars are forces of "
            f"the contacts, with contact 1 {first}. The curves {'on the right' if self.lies else 'below'} are these "
            f"forces over time. {self.clock}{model if self.clock else ''}{cut}"
            + (f" Not shown: {missing}." if missing else "")
        ).replace("  ", " ")


def _at_rest(c: Collision) -> tuple[Floats, Floats]:
    """Return the radii of the balls in a scene, and the heights of their centres when all springs are unloaded."""
    masses = np.array(c.masses)
    radii = np.maximum(_RADIUS * (masses / masses.max()) ** (1 / 3), _SMALL)
    springs = np.full(len(masses), _SPRING)
    if not c.table:  # the last ball has no contact below it
        springs[-1] = 0.0
    return radii, np.cumsum((springs + 2 * radii)[::-1])[::-1] - radii


def _moving_artists(
    motion: SlowMotion, scale: float, strongest: float, letters: float, now: Moment
) -> Iterator[Artist]:
    """Yield the moving parts of a solver's scene: springs, balls, bars of force, arrows of velocity, and the state.

    `letters` is the height of the names of the balls in points.
    """
    radii, at_rest = _at_rest(motion.collision)
    middles, top = at_rest + scale * now.heights, at_rest[0] + radii[0] + _RISE
    # Heights of the tops of the bodies below the contacts, the table last.
    tops = np.append(middles + radii, 0.0)[1:]
    ends = list(zip(tops, np.minimum(middles - radii, tops + _SPRING), strict=True))
    contacts = list(
        zip(ends, motion.colors, now.acting, now.forces, strict=False)
    )  # without a table the last ball has no contact below it

    def place(across: _Coordinate, up: _Coordinate) -> tuple[_Coordinate, _Coordinate]:
        """Return the place where a point is drawn; if balls are drawn lying, the top is on the left."""
        return (-up, across) if motion.lies else (across, up)

    for (low, high), color, acts, _ in contacts:
        zigzag = place(_ZIGZAG[0], low + (high - low) * _ZIGZAG[1])
        yield Line2D(*zigzag, linewidth=1.6, color=color if acts else _IDLE)
    for i, (y, radius) in enumerate(zip(middles, radii, strict=True)):
        yield Circle(place(0, y), radius, facecolor=_BALLS[i % 2], edgecolor="black")
        yield Text(*place(0, y), f"B{i + 1}", ha="center", va="center", fontsize=letters)
    for (low, high), color, _, force in contacts:
        length = _BAR * min(max(force, 0.0) / strongest, 1.0)
        bar = place(np.array([0.28, 0.28 + length]), np.full(2, 0.5 * (low + high)))
        yield Line2D(*bar, color=color, linewidth=6, solid_capstyle="butt")
    for y, radius, v in zip(middles, radii, now.velocities, strict=True):
        if abs(v) > 1e-3:
            upward, downward = ("<", ">") if motion.lies else ("^", "v")
            arrow = place(np.full(2, -radius - 0.15), np.array([y, y + _ARROW * v]))
            head = upward if v > 0 else downward
            yield Line2D(*arrow, color="black", linewidth=1.4, marker=head, markersize=6, markevery=[1])
    if motion.collision.falls_on_resting:
        state = _STATES[3 - now.acting @ np.array([1, 2])]
        yield Text(-1.25, top, state, fontsize=9.5, va="top", fontweight="bold", clip_on=False)


def draw_frames(motion: SlowMotion) -> Iterator[Pixels]:
    """Yield the frames of an animation, each of shape (height, width, 3).

    Each solver has a scene, and the forces of its contacts over time below or beside it. What does not move is drawn
    only once.
    """
    instants, histories = motion.instants, motion.histories.values()
    visible = {name: (history, history.time <= instants[-1]) for name, history in motion.histories.items()}
    largest = max(history.compressions[is_visible].max() for history, is_visible in visible.values())
    scale = _COMPRESSED * _SPRING / largest if largest > 0 else 1.0
    soft = [
        history.forces[is_visible[1:]]
        for name, (history, is_visible) in visible.items()
        if name not in motion.rigid
    ]
    forces = np.concatenate(soft)
    strongest, least = float(forces.max()), min(0.0, float(forces.min()))
    width, height = _frame_size(motion)
    with styled_figure(width, height) as figure:
        figure.dpi = _DPI
        panels = _set_up(figure, motion, 1.08 * least, 1.08 * strongest)
        moving = [starmap(Moment, zip(*history.at(instants), strict=True)) for history in histories]
        canvas = FigureCanvasAgg(figure)
        canvas.draw()
        unit = panels[0].scene.transData.transform([(0, 0), (1, 0)])[:, 0]
        radius = float(np.diff(unit)[0]) * _at_rest(motion.collision)[0].min() * 72 / _DPI
        letters = min(9.0, radius)
        still = canvas.copy_from_bbox(figure.bbox)
        for instant, *states in zip(instants, *moving, strict=True):
            canvas.restore_region(still)
            for (scene, below), now in zip(panels, states, strict=True):
                hand = Line2D([instant, instant], [0, 1], color="black", linewidth=0.9)
                hand.set_transform(below.get_xaxis_transform())
                _draw(scene, *_moving_artists(motion, scale, strongest, letters, now))
                _draw(below, hand)
            yield np.asarray(canvas.buffer_rgba())[..., :3].copy()


def _draw(ax: Axes, *artists: Artist) -> None:
    """Draw artists into axes, and remove them from the axes again."""
    for artist in artists:
        ax.add_artist(artist)
        ax.draw_artist(artist)
        artist.remove()


def _frame_size(motion: SlowMotion) -> tuple[float, float]:
    """Return the width and the height of a frame in inches."""
    balls, solvers = min(len(motion.collision.masses), 20), len(motion.histories)
    if motion.lies:
        return 8.5 + 0.35 * balls, 1.6 + 1.7 * solvers
    return max(7.6, 2.7 * solvers), 5.0 + 0.4 * balls


def _set_up(figure: Figure, motion: SlowMotion, least: float, most: float) -> list[SolverAxes]:
    """Draw everything that does not move, and return the axes of each solver.

    The axes of forces reach from `least` to `most`.
    """
    c, last = motion.collision, motion.instants[-1]
    figure.set_layout_engine("none")
    high, count = figure.get_figheight(), len(motion.histories)
    sides = {"right": 0.98, "top": 1 - 0.58 / high, "bottom": 1 / high}
    if motion.lies:
        grid = figure.add_gridspec(
            count, 2, width_ratios=(2.2, 1), left=0.01, hspace=0.3, wspace=0.12, **sides
        )
        panels = [
            SolverAxes(*(figure.add_subplot(grid[row, side]) for side in (0, 1))) for row in range(count)
        ]
    else:
        ratios = (high - 2.6, 1)
        grid = figure.add_gridspec(2, count, height_ratios=ratios, left=0.08, hspace=0.08, **sides)
        panels = [
            SolverAxes(*(figure.add_subplot(grid[row, side]) for row in (0, 1))) for side in range(count)
        ]
    time = "time / sqrt(m1/k1) (-)" if c.exponent == 1 else "time (-)"
    for number_of, ((scene, below), (name, history)) in enumerate(
        zip(panels, motion.histories.items(), strict=True)
    ):
        scene.set_title(display_name(name), pad=8 if count <= 3 else 4, fontsize=None if count <= 3 else 9)
        _set_scene(scene, motion)
        for i, color in enumerate(motion.colors, 1):
            label = f"contact {i}, with the table" if i == len(c.masses) else f"contact {i}"
            below.plot(history.middles, history.forces[:, i - 1], color=color, label=label, linewidth=1.3)
        below.set(xlim=(0, last), ylim=(least, most))
        if motion.lies:
            below.set_ylabel("force (-)")
            below.tick_params(labelbottom=number_of == count - 1)
        else:
            below.tick_params(labelleft=number_of == 0)
        if not motion.lies or number_of == count - 1:
            below.set_xlabel(time)
    if not motion.lies:
        panels[0].forces.set_ylabel("force (-)")
    lines = panels[0].forces.get_legend_handles_labels()
    if len(motion.colors) <= 6:
        figure.legend(*lines, loc="lower center", bbox_to_anchor=(0.53, 0.17 / high), ncols=6, fontsize=8)
    figure.suptitle(motion.what, fontsize=10)
    remarks = [motion.clock, "Compressions are enlarged."]
    if motion.left_out:
        remarks.append(f"Not shown: {join_words(map(display_name, motion.left_out))}.")
    figure.text(0.01, 0.07 / high, " ".join(filter(None, remarks)), fontsize=7, color="0.3")
    return panels


def _set_scene(scene: Axes, motion: SlowMotion) -> None:
    """Set the limits of the axes of a scene, and draw the table if the collision has one."""
    radii, at_rest = _at_rest(motion.collision)
    top = at_rest[0] + radii[0] + _RISE
    if motion.lies:
        scene.set(xlim=(-top, _FALL), ylim=(-0.9, 1.1), aspect="equal")
    else:
        scene.set(xlim=(-1.25, 1.25), ylim=(-0.12, top), aspect="equal")
        scene.fill_between([-1.25, 1.25], -0.12, 0, color="0.55", linewidth=0)
    scene.axis("off")


def write_animation(motion: SlowMotion, path: Path) -> None:
    """Write an animation as a GIF if the suffix of its path is ``.gif``, otherwise as a self-contained page."""
    pictures = list(draw_frames(motion))
    # One palette serves all frames. The first and the middle frame together have all colours.
    both = np.vstack([pictures[0], pictures[len(pictures) // 2]])
    palette = Image.fromarray(both).quantize(_COLORS, Image.Quantize.MAXCOVERAGE)  # white stays white
    first, *rest = (
        Image.fromarray(frame).quantize(palette=palette, dither=Image.Dither.NONE) for frame in pictures
    )
    with replacing(path) as temporary:
        if path.suffix == ".gif":
            first.save(temporary, "GIF", save_all=True, append_images=rest, duration=1000 / RATE, loop=0)
            return
        encoded = []
        for picture in (first, *rest):
            picture.save(file := BytesIO(), "PNG", optimize=True)
            encoded.append(base64.b64encode(file.getvalue()).decode("ascii"))
        player = render_template("player.html.j2", title=motion.title(), pictures=encoded, pause=1000 // RATE)
        temporary.write_text(render_page(motion.title(), [player, motion.caption()]), encoding="utf-8")
