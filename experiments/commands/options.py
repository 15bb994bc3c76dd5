"""Options that several commands share, and parsers of their values.

An error is one line that names the option, the value and the legal range: of a collision a configuration judges them,
of other options a parser. Nothing heavy is imported, so that help comes at once.
"""

from __future__ import annotations

import inspect
import json
import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperCommand

from impact_xval.experiments.config.collision_options import PARAMETERS
from impact_xval.experiments.config.errors import UserError
from impact_xval.experiments.config.graph_options import GRAPH_PARAMETERS


def parse_number(text: str) -> float:
    """Read a number; the command that uses it checks for infinity and NaN."""
    try:
        return float(text)
    except ValueError:
        raise typer.BadParameter(f"{text!r:.60}; legal: a number") from None


class Numbers(tuple[float, ...]):
    """Numbers of one option, as many as were typed after it."""


def numbers_parser(fewest: int, most: int) -> Callable[[str], Numbers]:
    """Return a parser of that many numbers, separated by blanks; see `command_with_numbers`."""
    count = {(1, 2): "one or two numbers", (2, 2): "two numbers", (2, 3): "two or three numbers"}.get(
        (fewest, most), f"{fewest} to {most} numbers"
    )

    def read(text: str) -> Numbers:
        try:
            numbers = Numbers(map(float, text.split()))
        except ValueError:
            raise typer.BadParameter(f"{text!r:.60}; legal: {count}") from None
        if not fewest <= len(numbers) <= most:
            raise typer.BadParameter(f"{text!r:.60}; legal: {count}")
        return numbers

    return read


def command_with_numbers(*names: str) -> type[TyperCommand]:
    """Return a class of commands whose options of these names take all that follows up to the next option.

    The words are joined to one value, which `numbers_parser` reads. A negative number is no option.
    """

    class CommandWithNumbers(TyperCommand):
        def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
            return super().parse_args(ctx, join_numbers(args, names))

    return CommandWithNumbers


def join_numbers(words: Sequence[str], names: Sequence[str]) -> list[str]:
    """Join the words after each option of these names to one word, up to the next option."""
    joined: list[str] = []
    is_gathering = False  # the last word of `joined` is the value of such an option
    for i, word in enumerate(words):
        if is_gathering and not _is_option(word):
            joined[-1] = f"{joined[-1]} {word}"
            continue
        is_gathering = i > 0 and words[i - 1] in names and not _is_option(word)
        joined.append(word)
    return joined


def _is_option(word: str) -> bool:
    """Tell whether a word is an option and not a negative number."""
    try:
        float(word)
    except ValueError:
        return word.startswith("-")
    return False


def whole_number_parser(low: int, high: int) -> Callable[[str], int]:
    """Return a parser of whole numbers in a range."""

    def read(text: str) -> int:
        if not re.fullmatch(r"-?\d{1,18}", text) or not low <= int(text) <= high:
            raise typer.BadParameter(f"{text!r:.60}; legal: a whole number from {low} to {high}")
        return int(text)

    return read


def parse_path(text: str) -> Path:
    """Read a path; the command that uses it checks what is there."""
    # pathlib takes the empty text, a variable of the shell that is not set, for ".".
    if not text or not text.isprintable():
        raise typer.BadParameter(f"{text!r:.60}; legal: a path")
    return Path(text)


def word_parser(*words: str) -> Callable[[str], str]:
    """Return a parser that accepts these words only."""

    def read(text: str) -> str:
        if text not in words:
            raise typer.BadParameter(f"{text!r:.60}; legal: {', '.join(words)}")
        return text

    return read


def parse_shard(text: str) -> tuple[int, int]:
    """Read ``I/N`` of --shard: number of a shard, from 1, and how many there are."""
    parts = re.fullmatch(r"(\d{1,5})/(\d{1,5})", text)
    if parts is None or not 1 <= int(parts[1]) <= int(parts[2]):
        raise UserError(f"--shard = {text!r:.60}; legal: I/N, I from 1 to N, such as 1/4")
    return int(parts[1]), int(parts[2])


def print_json(value: object) -> None:
    """Print strict JSON, with null for infinity and NaN."""
    plain = json.loads(json.dumps(value), parse_constant=lambda _: None)
    typer.echo(json.dumps(plain, indent=2))


def known_solvers(solvers: list[str] | None) -> list[str]:
    """Check the names of solvers and append the model if it is missing; without names, return the default solvers."""
    from impact_xval.compliant_baselines.registry import solver_names
    from impact_xval.experiments.config.experiment import REFERENCE, solvers_problem

    names = solvers or list(solver_names())
    problem = solvers_problem(names)
    if problem:
        raise UserError(f"--solver {problem}")
    return names if REFERENCE in names else [*names, REFERENCE]


def option(
    metavar: str, help_text: str, parser: Callable[[str], object] | None = None, default: object = None
) -> Any:
    """Return an option with a value; `...` as its default makes it required."""
    return typer.Option(default, metavar=metavar, help=help_text, parser=parser)


def argument(
    metavar: str, help_text: str, parser: Callable[[str], object] | None = None, default: object = ...
) -> Any:
    """Return an argument, required without a default."""
    return typer.Argument(default, metavar=metavar, help=help_text, parser=parser)


def flag_option(name: str, help_text: str) -> Any:
    """Return an option without a value."""
    return typer.Option(False, name, help=help_text)


Workers = Annotated[
    int | None,
    typer.Option(metavar="N", parser=whole_number_parser(1, 4096), help="Processes; by default one a core."),
]
Json = Annotated[bool, typer.Option("--json", help="Print JSON.")]

Solvers = Annotated[
    list[str] | None,
    typer.Option("--solver", metavar="NAME", help="A solver; may be repeated, the model is added."),
]


def with_collision_options(
    *without: str, graphs: bool = False
) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Return a decorator that replaces the keywords of a command by the options of one collision.

    The options named in `without` are skipped. With `graphs` those of contact graphs follow. Of these the help has
    --graph alone, for the others depend on the graph (docs/graphs.md).
    """

    def add(command: Callable[..., None]) -> Callable[..., None]:
        signature = inspect.signature(command, eval_str=True)
        of_command = [p for p in signature.parameters.values() if p.kind != p.VAR_KEYWORD]
        shared = {
            name: Annotated[str | None, typer.Option(metavar=metavar, help=help_text)]
            for name, (metavar, help_text) in PARAMETERS.items()
            if name not in without
        }
        for name, (metavar, help_text) in GRAPH_PARAMETERS.items() if graphs else ():
            hidden = name != "graph"
            given = typer.Option(metavar=metavar, help=help_text, hidden=hidden)
            shared[name] = Annotated[str | None, given]
        typed = [
            inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=None, annotation=annotation)
            for name, annotation in shared.items()
        ]
        parameters = sorted([*typed, *of_command], key=lambda p: p.kind)  # arguments come before options
        command.__signature__ = signature.replace(parameters=parameters)  # type: ignore[attr-defined]
        command.__annotations__ |= shared
        return command

    return add
