"""``impact-xval contact``: contacts of two or three bodies, as an engine wants them, and what the engine makes of them.

What was typed becomes pairs of bodies. Drops of the text for the engine find the largest step, or for a given step the
stiffest contacts. Blocks show all of it.
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
    from impact_xval.compliant_baselines.single_contact import Pair, VerifiedContact
    from impact_xval.compliant_baselines.three_bodies import Strike
    from impact_xval.experiments.presentation.document import Block
    from impact_xval.model.materials import MaterialContact

#: Quantities with one number for each contact, or one for both.
_QUANTITIES = ("restitution", "damping", "damping_ratio", "stiffness", "duration", "sink")

#: Engines whose largest step is looked for by drops.
_STEPPED = ("mujoco", "pybullet", "drake")

#: All names of `targets.target_names`, which is too heavy to import for a help text: engines, then their targets.
ENGINES = (
    *_STEPPED,
    *("newton", "lammps", "liggghts", "exudyn", "physx", "sapien", "bullet", "pymunk", "dart", "rapier"),
    *(f"newton-{name}" for name in ("semi-implicit", "featherstone", "vbd", "mujoco", "xpbd", "kamino")),
    *("lammps-granular", "lammps-pull", "lammps-gran-hooke", "liggghts-stiffness", "liggghts-hooke"),
    *("exudyn-linear", "exudyn-restitution", "physx-compliant", "physx-restitution"),
)

#: Time step in s of drops in engines that take a restitution, if neither a step nor a spring is given.
_RIGID_STEP = 1e-3

#: The class of this command: these options take as many numbers as are typed.
ContactCommand = command_with_numbers(
    "--masses", "--solref", "--solimp", *(f"--{name.replace('_', '-')}" for name in _QUANTITIES)
)


#: Parsers of one number for each contact, and of the options with more.
_ONE_OR_TWO, _MASSES = numbers_parser(1, 2), numbers_parser(2, 3)
_SOLREF, _SOLIMP = numbers_parser(2, 2), numbers_parser(1, 5)


def contact_command(
    engine: str = option(
        "NAME",
        f"{', '.join(ENGINES[:13])}; or one way to write a contact, such as newton-xpbd.",
        word_parser(*ENGINES),
        ...,
    ),
    masses: Numbers | None = option(
        "KG KG [KG]",
        "Of A and B, or of A, B and C from the top down. inf: a fixed body, such as the floor.",
        _MASSES,
    ),
    restitution: Numbers | None = option(
        "E [E]", "From 1e-4 to 1. The default is that of the materials.", _ONE_OR_TWO
    ),
    damping: Numbers | None = option("C [C]", "In N s/m; instead of a restitution.", _ONE_OR_TWO),
    damping_ratio: Numbers | None = option("Z [Z]", "From 0 to 50; instead of a restitution.", _ONE_OR_TWO),
    stiffness: Numbers | None = option("K [K]", "In N/m.", _ONE_OR_TWO),
    duration: Numbers | None = option("S [S]", "In s; instead of a stiffness.", _ONE_OR_TWO),
    sink: Numbers | None = option("M [M]", "Depth at rest in m; instead of a stiffness.", _ONE_OR_TWO),
    step: float | None = option(
        "S",
        "Time step of the simulation; instead of a stiffness. You get the stiffest good contact.",
        parse_number,
    ),
    tolerance: float = option("X", "Allowed relative error of e and duration.", parse_number, 0.01),
    solref: Numbers | None = option("A B", "MuJoCo's two numbers; instead of all above.", _SOLREF),
    solimp: Numbers | None = option("D ...", "Up to five numbers, beside --solref.", _SOLIMP),
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
    """Print what to paste into a scene for a contact.

    Give one number for the damping and one for the spring, or materials. You get the text, the depths, the largest
    good step, and what drops with this text gave. The search for a step can take minutes.

    With three masses A strikes B, which is at rest on C. Give two numbers of a kind: for A on B, and for B on C. You
    also get the impact of all three at once. PyBullet, DART and Pymunk multiply the restitutions of the two bodies.

    Example: impact-xval contact --engine mujoco --masses 0.45 3 inf --restitution 0.8 0.6 --step 2e-3
    """
    from impact_xval.compliant_baselines import SolverError, get_solver
    from impact_xval.compliant_baselines.engines.engine import Engine
    from impact_xval.compliant_baselines.single_contact import verify_contacts, verify_stiffest
    from impact_xval.experiments.presentation.contacts import contact_blocks
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
    """Return whether a contact is given without a spring for an engine whose targets all take a restitution."""
    from impact_xval.compliant_baselines.targets import targets_for

    has_spring = any(name in asked for name in ("stiffness", "duration", "sink"))
    return not has_spring and all(target.kind == "restitution" for target in targets_for(engine))


def _target_blocks(engine: str, pairs: Sequence[Pair], step: float | None) -> list[Block]:
    """Return the text of all targets of an engine, for one contact or for two of three bodies."""
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
    """Raise a ValueError if a step or a tolerance is illegal, or if there is a solimp without a solref."""
    from impact_xval.compliant_baselines.single_contact import LEGAL_STEP, LEGAL_TOLERANCE

    for legal, value in ((LEGAL_STEP, step), (LEGAL_TOLERANCE, tolerance)):
        if value is not None and not legal.includes(value):
            raise ValueError(f"{legal.name} = {value!r}; legal: {legal.text}")
    if solimp is not None and solref is None:
        raise ValueError("solimp: given alone; legal: beside solref")


def _refuse_numbers_beside(given: Mapping[str, object], decisive: str) -> None:
    """Raise a ValueError if a number is given beside the option that decides it."""
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
) -> tuple[Pair, MaterialContact]:
    """Return the pair of two bodies of materials, and their contact before it is linearised."""
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
) -> Pair:
    """Return the pair that has MuJoCo's own numbers."""
    from impact_xval.compliant_baselines.single_contact import Pair
    from impact_xval.compliant_baselines.solref import read_solref

    _refuse_numbers_beside({**asked, "step": step}, "solref")
    if engine != "mujoco":
        raise ValueError(f"solref: numbers of MuJoCo beside --engine {engine}; legal: --engine mujoco")
    if masses is None or len(masses) != 2:
        raise ValueError(f"masses: {len(masses or ())} given; legal: two beside solref")
    return Pair((masses[0], masses[1]), speed=speed, solref=read_solref(solref, solimp))


def _body_pairs_of_numbers(
    masses: Numbers | None,
    asked: Mapping[str, Numbers],
    step: float | None,
    tolerance: float,
    speed: float,
) -> list[Pair]:
    """Return the pairs of bodies that numbers ask for; a step gives them the shortest duration that it could carry."""
    from impact_xval.compliant_baselines.asked_contact import SPRING_NAMES, AskedContact
    from impact_xval.compliant_baselines.single_contact import Pair, bodies_of_contacts

    if masses is None:
        raise ValueError("masses: not given; legal: two or three numbers, or --material and --radius")
    springs = [name for name in ("stiffness", "duration", "sink") if name in asked]
    if step is not None and springs:
        raise ValueError(
            f"step = {step!r} beside {springs[0]}: each decides the other; legal: one of {SPRING_NAMES}"
        )
    contacts = bodies_of_contacts(masses)
    columns = {name: _numbers_of(name, values, len(contacts)) for name, values in asked.items()}
    if step is not None:
        columns["duration"] = [step / tolerance] * len(contacts)
    pairs: list[Pair] = []
    for i, (two, load) in enumerate(contacts):
        quantities = {name: numbers[i] for name, numbers in columns.items()}
        pairs.append(Pair.of(two, AskedContact(**quantities), speed, load))
    return pairs


def _impact_of_three(
    engine: str, masses: Sequence[float], verified: Sequence[VerifiedContact]
) -> list[Block]:
    """Return what the impact of all three bodies at once gives: by the model, by the engine's law and by the engine."""
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
    """Return one number for each contact; a single number is that of all contacts."""
    if len(values) > contacts:
        text = " ".join(f"{value:g}" for value in values)
        raise ValueError(f"{name} = {text}: two numbers for one contact; legal: one, or three --masses")
    return list(values) * contacts if len(values) == 1 else list(values)
