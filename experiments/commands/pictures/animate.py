"""``impact-xval animate``: one collision in slow motion, the model beside another solver."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from impact_xval.experiments.commands.options import (
    CELL_TIMEOUT,
    CUTOFF,
    E1,
    E2,
    GRAVITY,
    K1,
    M1,
    MAPPING,
    MASS_RATIO,
    SCENARIO,
    STEP_FRACTION,
    STIFFNESS_RATIO,
    V0,
    file_to_write,
    one_cell,
    path,
)
from impact_xval.experiments.config.errors import UserError

if TYPE_CHECKING:
    from impact_xval.experiments.presentation.pictures.history import History
    from impact_xval.model import Collision, Outcome

#: Who is shown beside the model where nobody is asked for: the first one that is installed.
_BESIDE = ("mujoco", "kelvin-voigt")


def animate(
    context: typer.Context,
    stiffness_ratio: Annotated[str, STIFFNESS_RATIO] = "1",
    mass_ratio: Annotated[str, MASS_RATIO] = "1.1547005383792517",
    e1: Annotated[str, E1] = "0.9",
    e2: Annotated[str, E2] = "0.7",
    solver: Annotated[
        str | None,
        typer.Option(
            metavar="NAME", help="Who is shown beside the model; by default mujoco, without it kelvin-voigt."
        ),
    ] = None,
    out: Annotated[
        Path,
        typer.Option(
            metavar="FILE",
            parser=path("--out"),
            help="File to write: .gif, .html (a page that needs nothing else) or .mp4 (by ffmpeg).",
        ),
    ] = Path("collision.gif"),
    scenario: Annotated[str, SCENARIO] = "impact",
    gravity: Annotated[str | None, GRAVITY] = None,
    m1: Annotated[str, M1] = "1",
    k1: Annotated[str, K1] = "1e8",
    v0: Annotated[str, V0] = "-1",
    step_fraction: Annotated[str, STEP_FRACTION] = "1e-3",
    mapping: Annotated[str, MAPPING] = "calibrated",
    cutoff: Annotated[str, CUTOFF] = "exact",
    cell_timeout: Annotated[str, CELL_TIMEOUT] = "300",
) -> None:
    """Show one collision in slow motion: balls, contacts and forces of the model beside those of another solver.

    Without ratios it is the collision of the figures of the built-in run. The model has no time of its own: its clock
    is the time in which its contact forces pass on its impulses.
    """
    file_to_write("--out", out, (".gif", ".html", ".mp4"))
    from impact_xval.experiments.commands.collisions import known_solvers, say
    from impact_xval.experiments.sweep.one import solvers_apart

    names = known_solvers([solver] if solver else list(_BESIDE[:1]))
    if len(names) < 2:
        raise UserError(f"--solver = {solver!r}; legal: another solver than the model, which is beside it")
    with solvers_apart(names) as apart:
        from impact_xval.compliant_baselines.registry import get_solver
        from impact_xval.experiments.config.cells import collision_of
        from impact_xval.experiments.config.experiment import REFERENCE

        config = one_cell(context.params)
        collision = collision_of(config, config.figure_cell)
        solved = apart.solve(collision, config, names, get_solver, say)
        if solver is None and solved[_BESIDE[0]].status == "unavailable":
            names = [_BESIDE[1], REFERENCE]
            solved |= apart.solve(collision, config, names[:1], get_solver, say)
    from impact_xval.experiments.presentation.pictures.motion import Motion, has_ffmpeg, write_animation
    from impact_xval.experiments.presentation.terminal import at_work, make_console, print_line

    if out.suffix == ".mp4" and not has_ffmpeg():
        raise UserError(
            f"--out {out}: ffmpeg is not found; legal: a file that ends in .gif or .html, or install it"
        )
    weight = config.gravity if config.scenario == "drop" else 0.0
    beside = next(name for name in names if name != REFERENCE)
    histories = {
        name: _history(name, collision, solved[name], gravity)
        for name, gravity in ((REFERENCE, 0.0), (beside, weight))
    }
    motion = Motion(collision, config.scenario, histories)
    with at_work("drawing the motion"):
        write_animation(motion, out)
    print_line(make_console(), f"{out}: {motion.caption()}")


def _history(name: str, collision: Collision, outcome: Outcome, gravity: float) -> History:
    """Return the history of an outcome; one line where it has none."""
    from impact_xval.experiments.presentation.pictures.history import history_of
    from impact_xval.model.collision import RESULT_STATUSES

    if outcome.status not in RESULT_STATUSES:
        raise UserError(
            f"{name}: {outcome.status}: {outcome.reason}; legal: a collision and a solver with a result"
        )
    if outcome.path is None:
        raise UserError(f"--solver = {name!r}: gives no path of a collision; legal: a solver that does")
    history = history_of(collision, outcome.path, gravity)
    if history is None:
        raise UserError(
            f"--stiffness-ratio = {collision.stiffness_ratio!r}: {name} ends after no finite time, and has no clock; "
            "legal: a finite number > 0"
        )
    return history
