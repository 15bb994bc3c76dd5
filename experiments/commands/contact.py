"""Command ``impact-xval contact``: prints the parameters of a contact for a scene of an engine, and tests them.

The options describe contacts of two or three bodies. The command turns them into pairs of bodies (`SingleImpact`). Then
it drops bodies in the engine with the printed parameters. From these drops it finds the largest time step, or, if the
user gives a step, the stiffest contacts.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from impact_xval.experiments.commands.options import (
    Numbers,
    command_with_numbers,
    numbers_parser,
    option,
    parse_number,
    word_parser,
)
from impact_xval.experiments.config.errors import UserError

if TYPE_CHECKING:
    from impact_xval.compliant_baselines.single_contact import SingleImpact, VerifiedContact
    from impact_xval.compliant_baselines.three_bodies import Strike
    from impact_xval.experiments.presentation.document import Block
    from impact_xval.model.materials import MaterialContact

#: Options that take one number for each contact, or a single number for all contacts.
_QUANTITIES = ("restitution", "damping", "damping_ratio", "stiffness", "duration", "sink")

#: Engines whose largest time step is found by dropping bodies in them.
_STEPPED = ("mujoco", "pybullet", "drake")

#: All names that `targets.target_names` returns: engines, and then ways to write a contact for them. They are repeated
#: here, because that module is too slow to import for a help text.
ENGINES = (
    *_STEPPED,
    *("newton", "lammps", "liggghts", "exudyn", "physx", "sapien", "bullet", "pymunk", "dart", "rapier"),
    *(f"newton-{name}" for name in ("semi-implicit", "featherstone", "vbd", "mujoco", "xpbd", "kamino")),
    *("lammps-granular", "lammps-pull", "lammps-gran-hooke", "liggghts-stiffness", "liggghts-hooke"),
    *("exudyn-linear", "exudyn-restitution", "physx-compliant", "physx-restitution"),
)

#: Default time step in s of drops in engines whose contacts have a restitution and no spring.
_RIGID_STEP = 1e-3

#: Class of the command ``contact``. In it the options for a contact take all numbers that are typed after them.
ContactCommand = command_with_numbers(
    "--masses", "--solref", "--solimp", *(f"--{name.replace('_', '-')}" for name in _QUANTITIES)
)


#: Parsers for the values of the options that take several numbers.
_ONE_OR_TWO, _MASSES = numbers_parser(1, 2), numbers_parser(2, 3)
_SOLREF, _SOLIMP = numbers_parser(2, 2), numbers_parser(1, 5)


def contact_command(
    engine: str = option(
        "NAME",
        f"{', '.join(ENGINES[:13])}; or a way to write a contact, such as newton-xpbd.",
        word_parser(*ENGINES),
        ...,
    ),
    masses: Numbers | None = option(
        "KG KG [KG]",
        "Masses of A and B, or of A, B and C from the top down. inf: a fixed body, such as the floor.",
        _MASSES,
    ),
    restitution: Numbers | None = option(
        "E [E]", "Restitution, 1e-4 to 1; by default of the materials.", _ONE_OR_TWO
    ),
    damping: Numbers | None = option("C [C]", "Damping in N s/m, in place of a restitution.", _ONE_OR_TWO),
    damping_ratio: Numbers | None = option(
        "Z [Z]", "Damping ratio, 0 to 50, in place of a restitution.", _ONE_OR_TWO
    ),
    stiffness: Numbers | None = option("K [K]", "Stiffness in N/m.", _ONE_OR_TWO),
    duration: Numbers | None = option("S [S]", "Duration in s, in place of a stiffness.", _ONE_OR_TWO),
    sink: Numbers | None = option("M [M]", "Depth at rest in m, in place of a stiffness.", _ONE_OR_TWO),
    step: float | None = option(
        "S",
        "Time step, in place of a stiffness. You get the stiffest contact that this step allows.",
        parse_number,
    ),
    tolerance: float = option("X", "Allowed relative error of restitution and duration.", parse_number, 0.01),
    solref: Numbers | None = option("A B", "MuJoCo's two numbers, in place of damping and spring.", _SOLREF),
    solimp: Numbers | None = option("D ...", "MuJoCo's one to five numbers, with --solref.", _SOLIMP),
    material: list[str] | None = option(
        "NAME", "steel, glass, brass, rubber or ping-pong. Give it twice for two materials."
    ),
    radius: list[float] | None = option(
        "M",
        "Radius of a ball of the material. Give it twice for two balls; one ball meets a flat.",
        parse_number,
    ),
    speed: float = option("M/S", "Speed of approach, from 1e-9 to 1e9.", parse_number, 1.0),
) -> None:
    """Print the parameters of a contact, to paste into a scene.

    Give one number for the damping and one for the spring, or give materials. You get the parameters to paste, the
    depths, the largest usable time step, and the results of test drops. The search for a step can take minutes.

    With three masses A strikes B, which is at rest on C. Give two numbers after an option: for A on B and B on C. You
    also get the impact of all three at once. PyBullet, DART and Pymunk multiply the restitutions of the two bodies.

    Example: impact-xval contact --engine mujoco --masses 0.45 3 inf --restitution 0.8 0.6 --step 2e-3
    """
    from impact_xval.compliant_baselines import SolverError, get_solver
    from impact_xval.compliant_baselines.engines.engine import Engine
    from impact_xval.compliant_baselines.single_contact import verify_contacts, verify_stiffest
    from impact_xval.experiments.presentation.contacts import contact_blocks, describe_linearised
    from impact_xval.experiments.presentation.terminal import (
        error_line,
        make_console,
        print_blocks,
        report_waiting,
    )
    from impact_xval.experiments.presentation.words import describe_restitution_product

    values = (restitution, damping, damping_ratio, stiffness, duration, sink)
    is_stepped = engine in _STEPPED
    asked = {name: given for name, given in zip(_QUANTITIES, values, strict=True) if given is not None}
    try:
        _require_legal(step, tolerance, solref, solimp)
        if not is_stepped and step is None and _needs_no_spring(engine, asked):
            step = _RIGID_STEP
        touch = None
        if material or radius:
            beside = {"masses": masses, "solref": solref, "step": step}
            pair, touch = _body_pair_of_materials(material or (), radius or (), asked, beside, speed)
            pairs = [pair]
        elif solref is not None:
            pairs = [_body_pair_of_solref(engine, masses, solref, solimp or (), asked, step, speed)]
        else:
            pairs = _body_pairs_of_numbers(masses, asked, step, tolerance, speed)
        if not is_stepped:
            with report_waiting(f"running the text in {engine}"):
                blocks = _target_blocks(engine, pairs, step)
            if touch is not None:
                blocks = [*describe_linearised(touch, speed), *blocks]
            print_blocks(make_console(), blocks)
            return
        solver = get_solver(engine)
        assert isinstance(solver, Engine)
        error_line(f"trying steps in {engine} ...")
        with report_waiting(f"trying steps in {engine}"):
            if step is None:
                verified = verify_contacts(solver, pairs, tolerance)
            else:
                verified = verify_stiffest(solver, pairs, step, tolerance)
            blocks = contact_blocks(solver, verified, touch, tolerance, step)
            if masses is not None and len(masses) == 3:
                blocks += _impact_of_three(engine, masses, verified)
    except SolverError as error:
        raise UserError(f"--engine {engine}: {error.status}: {error.reason}") from None
    except ValueError as error:
        raise UserError(f"--{error}".replace("damping_ratio", "damping-ratio")) from None
    product = describe_restitution_product([engine], pairs[0].motion.restitution)
    print_blocks(
        make_console(), [*blocks, *([f"To write a restitution instead: {product}"] if product else [])]
    )


def _needs_no_spring(engine: str, asked: Mapping[str, Numbers]) -> bool:
    """Return whether the user gives no spring and the engine needs no spring.

    An engine needs no spring if its contacts have a restitution instead.
    """
    from impact_xval.compliant_baselines.targets import targets_for

    has_spring = any(name in asked for name in ("stiffness", "duration", "sink"))
    return not has_spring and all(target.kind == "restitution" for target in targets_for(engine))


def _target_blocks(engine: str, pairs: Sequence[SingleImpact], step: float | None) -> list[Block]:
    """Return the text to paste for all targets of an engine.

    A target is one way to write a contact for the engine. `pairs` holds one pair of bodies, or two pairs for three
    bodies.
    """
    from impact_xval.compliant_baselines.targets import targets_for
    from impact_xval.experiments.presentation.targets import describe_targets

    blocks: list[Block] = []
    for name, pair in zip(("A on B:", "B on C:"), pairs, strict=False):
        if len(pairs) > 1:
            blocks.append(name)
        blocks += describe_targets(targets_for(engine), pair, step)
    return blocks


def _require_legal(
    step: float | None, tolerance: float, solref: Numbers | None, solimp: Numbers | None
) -> None:
    """Raise a ValueError if the step or the tolerance is illegal, or if solimp is given without solref."""
    from impact_xval.compliant_baselines.single_contact import LEGAL_STEP, LEGAL_TOLERANCE

    for legal, value in ((LEGAL_STEP, step), (LEGAL_TOLERANCE, tolerance)):
        if value is not None and not legal.includes(value):
            raise ValueError(f"{legal.name} = {value!r}; legal: {legal.text}")
    if solimp is not None and solref is None:
        raise ValueError("solimp: given alone; legal: beside solref")


def _refuse_numbers_beside(given: Mapping[str, object], decisive: str) -> None:
    """Raise a ValueError if an option gives a number that another given option already decides.

    `given` has the values of options by name, None for options that were not given.
    """
    for name, value in given.items():
        if value is not None:
            text = " ".join(f"{number:g}" for number in value) if isinstance(value, tuple) else f"{value:g}"
            raise ValueError(
                f"{name} = {text}: given beside {decisive}, which decides it; legal: one of both"
            )


def _body_pair_of_materials(
    materials: Sequence[str],
    radii: Sequence[float],
    asked: Mapping[str, Numbers],
    beside: Mapping[str, object],
    speed: float,
) -> tuple[SingleImpact, MaterialContact]:
    """Return two bodies of given materials as a pair with a linear contact, and their material contact.

    The linear contact stands for the material contact, whose force may not be linear.
    """
    from impact_xval.compliant_baselines.single_contact import make_pair

    others = {name: values for name, values in asked.items() if name != "restitution"}
    _refuse_numbers_beside({**beside, **others}, "materials or radii")
    e = None
    if "restitution" in asked:
        (e,) = _numbers_of("restitution", asked["restitution"], 1)
    pair, touch = make_pair(None, e, None, None, speed, materials, radii)
    assert touch is not None
    return pair, touch


def _body_pair_of_solref(
    engine: str,
    masses: Numbers | None,
    solref: Numbers,
    solimp: Sequence[float],
    asked: Mapping[str, Numbers],
    step: float | None,
    speed: float,
) -> SingleImpact:
    """Return two bodies whose contact has given values of MuJoCo's solref and solimp."""
    from impact_xval.compliant_baselines.single_contact import SingleImpact
    from impact_xval.compliant_baselines.solref import read_solref

    _refuse_numbers_beside({**asked, "step": step}, "solref")
    if engine != "mujoco":
        raise ValueError(f"solref: numbers of MuJoCo beside --engine {engine}; legal: --engine mujoco")
    if masses is None or len(masses) != 2:
        raise ValueError(f"masses: {len(masses or ())} given; legal: two beside solref")
    return SingleImpact((masses[0], masses[1]), speed=speed, solref=read_solref(solref, solimp))


def _body_pairs_of_numbers(
    masses: Numbers | None,
    asked: Mapping[str, Numbers],
    step: float | None,
    tolerance: float,
    speed: float,
) -> list[SingleImpact]:
    """Return the pairs of bodies whose contacts have the given quantities: one pair, or two pairs for three bodies.

    If a time step is given, the duration of a contact is step / tolerance. This is the shortest duration that the step
    could resolve.
    """
    from impact_xval.compliant_baselines.asked_contact import SPRING_NAMES, AskedContact
    from impact_xval.compliant_baselines.single_contact import SingleImpact, bodies_of_contacts

    if masses is None:
        raise ValueError("masses: not given; legal: two or three numbers, or --material and --radius")
    springs = [name for name in ("stiffness", "duration", "sink") if name in asked]
    if step is not None and springs:
        raise ValueError(
            f"step = {step!r} beside {springs[0]}: each follows from the other; legal: one of {SPRING_NAMES}"
        )
    contacts = bodies_of_contacts(masses)
    columns = {name: _numbers_of(name, values, len(contacts)) for name, values in asked.items()}
    if step is not None:
        columns["duration"] = [step / tolerance] * len(contacts)
    pairs: list[SingleImpact] = []
    for i, (two, load) in enumerate(contacts):
        quantities = {name: numbers[i] for name, numbers in columns.items()}
        pairs.append(SingleImpact.of(two, AskedContact(**quantities), speed, load))
    return pairs


def _impact_of_three(
    engine: str, masses: Sequence[float], verified: Sequence[VerifiedContact]
) -> list[Block]:
    """Return blocks about the impact of three bodies at once, by the model, the engine's law and the engine."""
    from impact_xval.compliant_baselines import SolverError
    from impact_xval.compliant_baselines.three_bodies import solve_exactly, strike
    from impact_xval.experiments.presentation.contacts import impact_blocks

    pairs, step = [contact.pair for contact in verified], verified[0].drops.step
    runs: list[Strike | str] = []
    for h, thorough in ((step, True), (step / 10, False)):
        try:
            runs.append(strike(engine, masses, pairs, h, thorough=thorough))
        except SolverError as error:
            runs.append(f"{error.status}: {error.reason}")
    return impact_blocks(engine, masses, pairs, solve_exactly(engine, masses, pairs), runs)


def _numbers_of(name: str, values: Sequence[float], contacts: int) -> list[float]:
    """Return one number for each contact; a single number is used for all contacts."""
    if len(values) > contacts:
        text = " ".join(f"{value:g}" for value in values)
        raise ValueError(f"{name} = {text}: two numbers for one contact; legal: one, or three --masses")
    return list(values) * contacts if len(values) == 1 else list(values)
