"""The command ``impact-xval``.

Exit codes: 0 done, 2 what the user asked for is wrong (one line on standard error), 1 anything else.
Everything heavy is imported inside the commands, so that help and usage errors come at once.
"""

from __future__ import annotations

import io
import sys
from collections.abc import Sequence
from importlib.metadata import version
from typing import Annotated, Any

import typer

from impact_xval.experiments.commands import calibrate, collisions, doctor, hypothesis, runs, solvers
from impact_xval.experiments.commands.contact import contact
from impact_xval.experiments.commands.ladder import ladder
from impact_xval.experiments.commands.map import draw_map
from impact_xval.experiments.commands.supervision import last_word
from impact_xval.experiments.config.errors import UserError

app = typer.Typer(
    help="Cross-validate physics engines against the state-transition model of simultaneous impacts.",
    add_completion=False,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
)


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
    runs.search,
    runs.status,
    collisions.solve,
    collisions.cradle,
    hypothesis.hypothesis,
    calibrate.calibrate,
    collisions.export_scene,
    contact,
    doctor.doctor,
    solvers.solvers,
    solvers.conform,
    runs.table,
    runs.figures,
    runs.report,
    ladder,
):
    app.command()(command)
app.command("map")(draw_map)

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
    # typer may carry its own copy of click: the class of usage errors is reached through typer alone.
    usage_error: Any = typer.BadParameter.__base__
    try:
        result = command.main(
            list(sys.argv[1:] if arguments is None else arguments),
            prog_name="impact-xval",
            standalone_mode=False,
        )
    except usage_error as error:
        return _fail(f"{error.format_message()} Try 'impact-xval --help'.", 2)
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
