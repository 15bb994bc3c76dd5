"""``impact-xval contact``: one contact, as an engine wants it, and what the engine makes of it."""

from __future__ import annotations

from impact_xval.experiments.commands.options import option, parse_number, word_parser
from impact_xval.experiments.config.errors import UserError


def contact_command(
    engine: str = option(
        "NAME", "'mujoco', 'pybullet' or 'drake'.", word_parser("mujoco", "pybullet", "drake"), ...
    ),
    masses: tuple[float, float] | None = option(
        "KG KG", "Of the two bodies, 1e-15 to 1e15; inf for a fixed one.", parse_number
    ),
    restitution: float | None = option(
        "E", "From 1e-4 to 1; by default that of the materials.", parse_number
    ),
    stiffness: float | None = option("N/M", "Of the contact.", parse_number),
    duration: float | None = option("S", "Of the contact; instead of a stiffness.", parse_number),
    material: list[str] | None = option(
        "NAME", "Instead of masses and stiffness: steel, glass, brass, rubber or ping-pong; twice for two."
    ),
    radius: list[float] | None = option(
        "M", "Of a ball of the material; twice for two balls, else the other is a flat.", parse_number
    ),
    speed: float = option("M/S", "Speed of approach, 1e-9 to 1e9.", parse_number, 1.0),
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
    from impact_xval.experiments.presentation.terminal import (
        error_line,
        make_console,
        print_blocks,
        report_waiting,
    )
    from impact_xval.experiments.presentation.words import describe_restitution_product

    try:
        numbers = masses, restitution, stiffness, duration, speed
        pair, touch = make_pair(*numbers, material or (), radius or ())
    except ValueError as error:
        raise UserError(f"--{error}") from None
    solver = get_solver(engine)
    assert isinstance(solver, Engine)
    error_line(f"trying steps in {engine} ...")
    try:
        with report_waiting(f"trying steps in {engine}"):
            blocks = contact_blocks(solver, pair, touch, *measure_largest_step(solver, pair))
    except SolverError as error:
        raise UserError(f"--engine {engine}: {error.status}: {error.reason}") from None
    product = describe_restitution_product([engine], pair.restitution)
    print_blocks(make_console(), [*blocks, *([product] if product else [])])
