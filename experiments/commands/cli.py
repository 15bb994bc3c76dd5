"""The command ``impact-xval``.

Exit codes: 0 done, 2 what the user asked for is wrong (one line on standard error), 1 anything else.
Everything heavy is imported inside the commands, so that help and usage errors come at once.
"""

from __future__ import annotations

import io
import sys
from collections.abc import Iterable, Sequence
from importlib.metadata import version
from itertools import takewhile
from typing import Annotated, Any

import typer
import typer.core

from impact_xval.experiments.commands import collisions, doctor, hypothesis, runs, solvers
from impact_xval.experiments.commands.contact import contact
from impact_xval.experiments.commands.explore import explore
from impact_xval.experiments.commands.ladder import ladder
from impact_xval.experiments.commands.pictures.animate import animate
from impact_xval.experiments.commands.supervision import last_word
from impact_xval.experiments.config.errors import UserError

PROGRAM = "impact-xval"

app = typer.Typer(
    help="Cross-validate physics engines against the state-transition model of simultaneous impacts.",
    add_completion=False,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},  # commands inherit it
)


# typer may carry its own copy of click: the class of usage errors is reached through typer alone.
_UsageError: Any = typer.BadParameter.__base__


class _Command(typer.core.TyperCommand):
    """A command that takes no option for a value of another, and is named by every usage error."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Parse what was typed, unless an option has fewer values than it takes."""
        problem = too_few_values(self.params, args)
        if problem:
            raise typer.BadParameter(problem, ctx=ctx)
        try:
            return super().parse_args(ctx, args)
        except _UsageError as error:
            error.ctx = error.ctx or ctx  # click leaves it out where an option has no value
            raise


def too_few_values(parameters: Iterable[Any], arguments: Sequence[str]) -> str | None:
    """Say which option is followed by another option before it has all of its values.

    The parser would take that option for a value, and say that it is missing.

    Parameters
    ----------
    parameters : iterable of click.Parameter
        Of a command.
    arguments : sequence of str
        As typed after the command.

    Returns
    -------
    str or None
        A line with the option, its values and their number; None if each option has its values.
    """
    counts = {name: each.nargs for each in parameters for name in each.opts if name.startswith("-")}
    for place, argument in enumerate(arguments):
        if argument == "--":
            break
        name, equals, first = argument.partition("=")
        count = counts.get(name, 0)
        following = arguments[place + 1 : place + 1 + count - bool(equals)]
        values = [first] * bool(equals) + list(
            takewhile(lambda each: each.partition("=")[0] not in counts, following)
        )
        if 1 < count != len(values):
            return f"{name} = {' '.join(values)!r:.60}; legal: {count} values"
    return None


@app.callback(invoke_without_command=True)
def _root(
    context: typer.Context,
    show_version: Annotated[bool, typer.Option("--version", help="Print the version and end.")] = False,
) -> None:
    if show_version:
        typer.echo(f"impact-xval {version('impact-xval')}")
    elif context.invoked_subcommand is None:
        typer.echo(context.get_help())


# In the order of the help.
for command in (
    runs.run,
    runs.status,
    collisions.solve,
    collisions.cradle,
    animate,
    explore,
    hypothesis.hypothesis,
    collisions.export_scene,
    contact,
    doctor.doctor,
    solvers.solvers,
    solvers.conform,
    runs.table,
    runs.figures,
    runs.report,
    runs.compare_runs,
    ladder,
):
    app.command(cls=_Command)(command)

#: What typer makes of Ctrl-C in a command.
_CTRL_C = 130


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line.

    Parameters
    ----------
    arguments : sequence of str, optional
        By default those of the process.

    Returns
    -------
    int
        The exit code.
    """
    if isinstance(sys.stdout, io.TextIOWrapper) and sys.stdout.errors == "strict":
        sys.stdout.reconfigure(errors="backslashreplace")  # a name that a terminal cannot show ends no run
    command = typer.main.get_command(app)
    try:
        result = command.main(
            list(sys.argv[1:] if arguments is None else arguments),
            prog_name=PROGRAM,
            standalone_mode=False,
        )
    except _UsageError as error:
        where = error.ctx.command_path if error.ctx is not None else PROGRAM
        message = error.format_message().removeprefix("Invalid value: ").rstrip(".")
        return _fail(f"{message}. Try '{where} --help'.", 2)
    except UserError as error:
        return _fail(str(error), 2)
    except (typer.Abort, KeyboardInterrupt):
        return _fail("interrupted", 1)
    except BrokenPipeError:
        return 1
    except OSError as error:
        return _fail(f"{error.filename or 'writing'}: {error.strerror or error}", 1)
    if result == _CTRL_C:
        return _fail("interrupted", 1)
    return result if isinstance(result, int) else 0


def _fail(message: str, code: int) -> int:
    last_word(str(UserError(message)))
    return code
