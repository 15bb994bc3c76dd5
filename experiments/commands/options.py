"""Options that several commands share, and the reading of what is typed for any of them.

An error is one line that names the option, the value and the legal range: of a collision a configuration judges them,
of other options a parser. Nothing heavy is imported, so that help comes at once.
"""

from __future__ import annotations

import inspect
import json
import math
import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from impact_xval.experiments.config.errors import UserError

if TYPE_CHECKING:
    from impact_xval.experiments.config.arrangements import Arranged
    from impact_xval.experiments.config.experiment import Config
    from impact_xval.model import Collision

#: What decides an impact.
RATIOS = ("stiffness_ratio", "mass_ratio", "e1", "e2")
#: Of a ratio the quantity in SI units that may be given instead, and that which it is divided by.
_IN_SI = {"stiffness_ratio": ("k2", "k1"), "mass_ratio": ("m2", "m1")}
#: What a column of N balls has beside its arrangement; its first mass and stiffness are m1 and k1.
_COUNTS = "balls", "strike"
OF_COLUMN = (*_COUNTS, "e", "exponent", "gap", "mass_taper", "stiffness_taper")
_OF_TWO = (*RATIOS, "m2", "k2", "gravity")


def number(text: str) -> float:
    """Read a number; infinities and NaN are judged where it is used."""
    try:
        return float(text)
    except ValueError:
        raise typer.BadParameter(f"{text!r:.60}; legal: a number") from None


def whole(low: int, high: int) -> Callable[[str], int]:
    """Return a parser of whole numbers in a range."""

    def read(text: str) -> int:
        if not re.fullmatch(r"-?\d{1,18}", text) or not low <= int(text) <= high:
            raise typer.BadParameter(f"{text!r:.60}; legal: a whole number from {low} to {high}")
        return int(text)

    return read


def path(text: str) -> Path:
    """Read a path; what is there is for the command to judge."""
    # pathlib takes the empty text, a variable of the shell that is not set, for ".".
    if not text or not text.isprintable():
        raise typer.BadParameter(f"{text!r:.60}; legal: a path")
    return Path(text)


def share(text: str) -> tuple[int, int]:
    """Read ``I/N`` of --shard: number of a shard, from 1, and how many there are."""
    found = re.fullmatch(r"(\d{1,5})/(\d{1,5})", text)
    if found is None or not 1 <= int(found[1]) <= int(found[2]):
        raise UserError(f"--shard = {text!r:.60}; legal: I/N, I from 1 to N, such as 1/4")
    return int(found[1]), int(found[2])


def print_json(value: Any) -> None:
    """Print strict JSON, which has no infinity and no NaN: null stands there."""
    plain = json.loads(json.dumps(value), parse_constant=lambda _: None)
    typer.echo(json.dumps(plain, indent=2))


def known_solvers(solvers: list[str] | None) -> list[str]:
    """Check the names of solvers, and add the model, as a run does; without any, those that a run has by default.

    The model comes last where it was not asked for.
    """
    from impact_xval.compliant_baselines.registry import solver_names
    from impact_xval.experiments.config.experiment import REFERENCE, solvers_problem

    names = solvers or list(solver_names())
    problem = solvers_problem(names)
    if problem:
        raise UserError(f"--solver {problem}")
    return names if REFERENCE in names else [*names, REFERENCE]


def asked(parameters: Mapping[str, Any]) -> tuple[Collision, Arranged | None, Config]:
    """Make a collision of what is typed for one: two balls by ratios or in SI units, or a column of N.

    Parameters are those of `ONE`, typed as options or in an address, None where nothing was. The configuration says how
    the collision is solved. A `UserError` names the option that is illegal.
    """
    given = {key: value for key, value in parameters.items() if value is not None}
    for key in given:
        if key not in ONE:
            raise UserError(f"{key!r:.60} is no parameter; legal: {', '.join(ONE)}")
    column = "arrangement" in given or "balls" in given
    for key in _OF_TWO if column else OF_COLUMN:
        if key in given:
            why = "of two balls on a table" if column else "of N balls, with --arrangement"
            raise UserError(f"{_option(key)} = {given[key]!r:.60}; legal: none here, it is {why}")
    plain = {key: _number_or_text(value) for key, value in given.items()}
    return _column(plain) if column else _two_balls(plain)


def _two_balls(plain: dict[str, Any]) -> tuple[Collision, None, Config]:
    from impact_xval.experiments.config.cells import collision_of
    from impact_xval.experiments.config.experiment import parse_config

    for ratio, (upper, lower) in _IN_SI.items():
        if upper in plain:
            if ratio in plain:
                raise UserError(f"{_option(ratio)} and --{upper} are given; legal: one of both")
            if lower not in plain:
                raise UserError(f"--{upper} without --{lower}; legal: both, or {_option(ratio)}")
            over, under = plain.pop(upper), plain[lower]
            for key, value, limits in ((upper, over, (0, math.inf)), (lower, under, ())):
                if isinstance(value, str) or not (0 < value < math.inf or value in limits):
                    raise UserError(f"--{key} = {value!r:.60}; legal: a number > 0")
            plain[ratio] = over / under
    missing = [_option(key) for key in RATIOS if key not in plain]
    if missing:
        raise UserError(
            f"{', '.join(missing)} missing; legal: k2/k1 and m2/m1, or --m1 --m2 --k1 --k2, with --e1 and --e2"
        )
    cell = {key: plain.pop(key) for key in RATIOS}
    # The built-in grid may leave double precision where the cell does not.
    data = {"scenario": "impact", "figure_cell": cell, "grid": {key: [1.0] for key in cell}} | plain
    config = parse_config(data, where="", name=_named)
    return collision_of(config, config.figure_cell), None, config


def _column(plain: dict[str, Any]) -> tuple[Collision, Arranged, Config]:
    from impact_xval.experiments.config.experiment import parse_config

    setup = {key: plain.pop(key) for key in (*OF_COLUMN, "arrangement", "v0") if key in plain}
    setup |= {key[0]: plain.pop(key) for key in ("m1", "k1") if key in plain}
    for key in _COUNTS:
        if isinstance(value := setup.get(key), float) and value.is_integer():
            setup[key] = int(value)
    config = parse_config({"column": {}, "figure_column": setup} | plain, where="", name=_named)
    return config.figure_column.column(), config.figure_column, config


def _number_or_text(text: str) -> float | str:
    """Read a number; a text that is none stays as it is, for the configuration to refuse."""
    try:
        return float(text)
    except ValueError:
        return text


def _named(location: Sequence[str | int]) -> str:
    """Name the option of a key; values that are not legal together are named by what is said of them."""
    key = str(location[-1]) if location else "figure_column"
    return "" if key == "figure_column" else _option({"m": "m1", "k": "k1"}.get(key, key))


def _option(key: str) -> str:
    return "--" + key.replace("_", "-")


def option(metavar: str, what: str, parser: Callable[[str], Any] | None = None, default: Any = None) -> Any:
    """Return an option with a value; `...` as its default makes it required."""
    return typer.Option(default, metavar=metavar, help=what, parser=parser)


def argument(metavar: str, what: str, parser: Callable[[str], Any] | None = None, default: Any = ...) -> Any:
    """Return an argument, required without a default."""
    return typer.Argument(default, metavar=metavar, help=what, parser=parser)


def flag(name: str, what: str) -> Any:
    """Return an option without a value."""
    return typer.Option(False, name, help=what)


Workers = Annotated[
    int | None,
    typer.Option(metavar="N", parser=whole(1, 4096), help="Processes; by default one a core."),
]
Json = Annotated[bool, typer.Option("--json", help="Print JSON.")]

#: What is typed of one collision, or column, and of how it is solved.
ONE: dict[str, Any] = {
    name: Annotated[str | None, typer.Option(metavar=metavar, help=help)]
    for name, metavar, help in (
        ("stiffness_ratio", "R", "k2/k1, from 0 to inf."),
        ("mass_ratio", "R", "m2/m1, greater than 0."),
        ("e1", "E", "Restitution of ball on ball, 0 to 1."),
        ("e2", "E", "Restitution of ball on table, 0 to 1."),
        ("m1", "KG", "Mass of the first ball; by default 1."),
        ("m2", "KG", "Mass of the lower ball, for --mass-ratio."),
        ("k1", "N/M", "Stiffness of the first contact; by default 1e8."),
        ("k2", "N/M", "Stiffness of ball on table, for --stiffness-ratio."),
        ("v0", "M/S", "Velocity of what falls or strikes; by default -1."),
        ("scenario", "NAME", "'impact' (by default; no gravity) or 'drop'."),
        ("gravity", "G", "Of a drop, in m/s^2; by default 9.81."),
        ("arrangement", "NAME", "N balls: 'chain', 'cradle', 'drop' or 'stack'."),
        ("balls", "N", "Number of balls; by default 5."),
        ("strike", "J", "Balls of a cradle that strike; by default 1."),
        ("e", "E", "Restitution of every contact; by default 0.95."),
        ("exponent", "P", "Of forces k delta^p, 1 to 3; 1.5 is Hertz's."),
        ("gap", "M", "Of every contact but the one that is struck."),
        ("mass_taper", "R", "Mass of each next ball over the one before."),
        ("stiffness_taper", "R", "Stiffness of each next contact over the one before."),
        ("step_fraction", "X", "Time step over the shortest contact period."),
        ("cell_timeout", "S", "Seconds that a solver has; by default 300."),
    )
}
Solvers = Annotated[
    list[str] | None,
    typer.Option("--solver", metavar="NAME", help="A solver; may be repeated, the model is added."),
]


def of_one_collision(*without: str) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Give a command the options `ONE`, before its own, in the place of its keywords."""

    def add(command: Callable[..., None]) -> Callable[..., None]:
        signature = inspect.signature(command, eval_str=True)
        own = [each for each in signature.parameters.values() if each.kind != each.VAR_KEYWORD]
        shared = [
            inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=None, annotation=annotation)
            for name, annotation in ONE.items()
            if name not in without
        ]
        parameters = sorted([*shared, *own], key=lambda each: each.kind)  # arguments come before options
        command.__signature__ = signature.replace(parameters=parameters)  # type: ignore[attr-defined]
        command.__annotations__ |= {each.name: each.annotation for each in shared}
        return command

    return add
