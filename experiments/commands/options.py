"""Options that several commands share, and parsers of option values.

An illegal value is reported in one line that names the option, the value and the legal values. The validation of a
configuration checks the options of a collision. The parsers of this module check all other options. Slow modules are
not imported, so that help texts appear at once. The modules with the commands use this module.
"""

from __future__ import annotations

import inspect
import json
import re
from collections.abc import Callable, Iterable, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperCommand, TyperOption

from impact_xval.experiments.config.collision_options import PARAMETERS
from impact_xval.experiments.config.errors import UserError
from impact_xval.experiments.config.graph_options import (
    GRAPH_PARAMETERS,
    OPTIONS_OF,
    SOLVED_BY,
    describe_options,
)


def parse_number(text: str) -> float:
    """Return a text as a number.

    Infinity and NaN are accepted here. The command that uses the number checks for them.
    """
    try:
        return float(text)
    except ValueError:
        raise typer.BadParameter(f"{text!r:.60}; legal: a number") from None


class Numbers(tuple[float, ...]):
    """All numbers that were typed after one option."""


def numbers_parser(fewest: int, most: int) -> Callable[[str], Numbers]:
    """Return a parser of texts that hold `fewest` to `most` numbers, separated by spaces.

    `command_with_numbers` joins all words after an option to such a text.
    """
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
    """Return a class of commands in which the given options take all words that follow, up to the next option.

    These words are joined to one text, which is the value of the option and is read by `numbers_parser`. A negative
    number counts as a word and not as an option.
    """

    class CommandWithNumbers(TyperCommand):
        def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
            return super().parse_args(ctx, join_numbers(args, names))

    return CommandWithNumbers


class GraphHelpCommand(TyperCommand):
    """Command whose help shows the options of a collision, or with ``--graph NAME`` those of this contact graph."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Read the command line. The help is printed meanwhile, so what it shows is decided here."""
        words = " ".join(args).replace("--graph=", "--graph ").split()
        graph = next((word for before, word in pairwise(words) if before == "--graph"), "")
        has_options = graph in OPTIONS_OF
        shown = {"graph", *SOLVED_BY, *(OPTIONS_OF[graph] if has_options else PARAMETERS)}
        for parameter in self.params:
            if isinstance(parameter, TyperOption) and parameter.name in PARAMETERS | GRAPH_PARAMETERS:
                parameter.hidden = parameter.name not in shown
        self.epilog = f"\b\n{describe_options(graph)}" if has_options else None
        return super().parse_args(ctx, args)


def join_numbers(words: Sequence[str], names: Sequence[str]) -> list[str]:
    """Return the words of a command line, with the words after each of the given options joined to one word.

    Only the words up to the next option are joined.
    """
    joined: list[str] = []
    is_gathering = False  # True if the last word of `joined` is the value of one of the given options
    for i, word in enumerate(words):
        if is_gathering and not _is_option(word):
            joined[-1] = f"{joined[-1]} {word}"
            continue
        is_gathering = i > 0 and words[i - 1] in names and not _is_option(word)
        joined.append(word)
    return joined


def _is_option(word: str) -> bool:
    """Return whether a word is an option; a negative number is not."""
    try:
        float(word)
    except ValueError:
        return word.startswith("-")
    return False


def whole_number_parser(low: int, high: int) -> Callable[[str], int]:
    """Return a parser of whole numbers from `low` to `high`."""

    def read(text: str) -> int:
        if not re.fullmatch(r"-?\d{1,18}", text) or not low <= int(text) <= high:
            raise typer.BadParameter(f"{text!r:.60}; legal: a whole number from {low} to {high}")
        return int(text)

    return read


def parse_path(text: str) -> Path:
    """Return a text as a path. The command that uses the path checks whether the path exists."""
    # pathlib would read an empty text as ".". An empty text comes, for example, from a shell variable that is not set.
    if not text or not text.isprintable():
        raise typer.BadParameter(f"{text!r:.60}; legal: a path")
    return Path(text)


def word_parser(*words: str) -> Callable[[str], str]:
    """Return a parser that accepts only the given words."""

    def read(text: str) -> str:
        if text not in words:
            raise typer.BadParameter(f"{text!r:.60}; legal: {', '.join(words)}")
        return text

    return read


def parse_shard(text: str) -> tuple[int, int]:
    """Return the two numbers I and N of a text ``I/N``, the value of the option --shard.

    I is the number of a shard, counted from 1, and N is the number of shards.
    """
    parts = re.fullmatch(r"(\d{1,5})/(\d{1,5})", text)
    if parts is None or not 1 <= int(parts[1]) <= int(parts[2]):
        raise UserError(f"--shard = {text!r:.60}; legal: I/N, I from 1 to N, such as 1/4")
    return int(parts[1]), int(parts[2])


def print_json(value: object) -> None:
    """Print a value as strict JSON, with null for infinity and NaN."""
    plain = json.loads(json.dumps(value), parse_constant=lambda _: None)
    typer.echo(json.dumps(plain, indent=2))


def known_solvers(solvers: list[str] | None) -> list[str]:
    """Return the names of solvers, with the model appended if it is missing.

    If no names are given, the default solvers are returned.

    A UserError is raised if there is no solver with one of the names.
    """
    from impact_xval.compliant_baselines.registry import solver_names
    from impact_xval.experiments.config.experiment import REFERENCE, solvers_problem

    names = solvers or list(solver_names())
    problem = solvers_problem(names)
    if problem:
        raise UserError(f"--solver {problem}")
    return names if REFERENCE in names else [*names, REFERENCE]


def stop_if_unavailable(solvers: list[str] | None, statuses: Iterable[tuple[str, str]]) -> None:
    """End the command with exit code 1 if every solver that --solver names is unavailable.

    Parameters
    ----------
    solvers
        The solvers that --solver names, or None.
    statuses
        Names of solvers, each with the status of an outcome.
    """
    from impact_xval.experiments.presentation.terminal import error_line

    available = {name for name, status in statuses if status != "unavailable"}
    if solvers and available.isdisjoint(solvers):
        error_line(f"nothing was compared, because these solvers are unavailable: {', '.join(solvers)}")
        raise typer.Exit(1)


def option(
    metavar: str, help_text: str, parser: Callable[[str], object] | None = None, default: object = None
) -> Any:
    """Return an option that takes a value; with `...` as its default the option is required."""
    return typer.Option(default, metavar=metavar, help=help_text, parser=parser)


def argument(
    metavar: str, help_text: str, parser: Callable[[str], object] | None = None, default: object = ...
) -> Any:
    """Return an argument; without a default it is required."""
    return typer.Argument(default, metavar=metavar, help=help_text, parser=parser)


def flag_option(name: str, help_text: str) -> Any:
    """Return an option that takes no value and is False unless it is typed."""
    return typer.Option(False, name, help=help_text)


Workers = Annotated[
    int | None,
    typer.Option(
        metavar="N", parser=whole_number_parser(1, 4096), help="Number of processes; by default one per core."
    ),
]
Json = Annotated[bool, typer.Option("--json", help="Print the results as JSON.")]

Solvers = Annotated[
    list[str] | None,
    typer.Option("--solver", metavar="NAME", help="Solver to use; may be repeated. The model is added."),
]


def with_collision_options(
    *without: str, graphs: bool = False
) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Return a decorator that gives a command the options of one collision, in place of its ``**`` parameter.

    Options in `without` are skipped. With `graphs` the command also gets the options of contact graphs. Its class is
    then `GraphHelpCommand`.
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
            shared[name] = Annotated[str | None, typer.Option(metavar=metavar, help=help_text)]
        typed = [
            inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=None, annotation=annotation)
            for name, annotation in shared.items()
        ]
        parameters = sorted([*typed, *of_command], key=lambda p: p.kind)  # arguments come before options
        command.__signature__ = signature.replace(parameters=parameters)  # type: ignore[attr-defined]
        command.__annotations__ |= shared
        return command

    return add
