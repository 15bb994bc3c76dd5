"""``impact-xval contact``: one contact, as an engine wants it, and what the engine makes of it."""

from __future__ import annotations

from impact_xval.experiments.commands.options import number, one_of, option
from impact_xval.experiments.config.errors import UserError


def contact(
    engine: str = option(
        "NAME", "'mujoco', 'pybullet' or 'drake'.", one_of("mujoco", "pybullet", "drake"), ...
    ),
    masses: tuple[float, float] | None = option(
        "KG KG", "Of the two bodies, 1e-15 to 1e15; inf for a fixed one.", number
    ),
    restitution: float | None = option("E", "From 1e-4 to 1; by default that of the materials.", number),
    stiffness: float | None = option("N/M", "Of the contact.", number),
    duration: float | None = option("S", "Of the contact; instead of a stiffness.", number),
    material: list[str] | None = option(
        "NAME", "Instead of masses and stiffness: steel, glass, brass, rubber or ping-pong; twice for two."
    ),
    radius: list[float] | None = option(
        "M", "Of a ball of the material; twice for two balls, else the other is a flat.", number
    ),
    speed: float = option("M/S", "Speed of approach, 1e-9 to 1e9.", number, 1.0),
) -> None:
    """Print what to paste into a scene for a contact.

    And the largest step at which it means what it says. Beside what was asked stands what verifying drops gave.
    Where an engine takes a restitution instead, PyBullet, DART and Pymunk multiply those of the two bodies.

    Example: impact-xval contact --engine mujoco --masses 1 inf --restitution 0.7 --duration 1e-3

    Or, a steel ball on a steel flat: impact-xval contact --engine mujoco --material steel --radius 0.02 --speed 1
    """
    from impact_xval.compliant_baselines import SolverError, get_solver
    from impact_xval.compliant_baselines.engines.engine import Engine
    from impact_xval.compliant_baselines.single_contact import make_pair, measure_largest_step
    from impact_xval.experiments.presentation.contacts import contact_blocks
    from impact_xval.experiments.presentation.terminal import at_work, error_line, make_console, show
    from impact_xval.experiments.presentation.words import restitution_of_two

    try:
        numbers = masses, restitution, stiffness, duration, speed
        pair, touch = make_pair(*numbers, material or (), radius or ())
    except ValueError as error:
        raise UserError(f"--{error}") from None
    solver = get_solver(engine)
    assert isinstance(solver, Engine)
    error_line(f"trying steps in {engine} ...")
    try:
        with at_work(f"trying steps in {engine}"):
            blocks = contact_blocks(solver, pair, touch, *measure_largest_step(solver, pair))
    except SolverError as error:
        raise UserError(f"--engine {engine}: {error.status}: {error.reason}") from None
    product = restitution_of_two([engine], pair.restitution)
    show(make_console(), [*blocks, *([product] if product else [])])
