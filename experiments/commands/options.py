"""Options that several commands share, spelt once, and the reading of what is typed for any of them.

A number stays text until a configuration judges it, or is read here: either way an error is one line that names the
option, the value and the legal range. Nothing heavy is imported, so that help comes at once.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from impact_xval.experiments.config.errors import UserError

if TYPE_CHECKING:
    from impact_xval.experiments.config.arrangements import Arranged
    from impact_xval.experiments.config.experiment import Config

#: What decides an impact, what else a collision has, and a key of a configuration that its option spells otherwise.
RATIOS = ("stiffness_ratio", "mass_ratio", "e1", "e2")
_SCALES = ("scenario", "gravity", "m1", "k1", "v0", "step_fraction", "mapping", "cell_timeout")
_SPELT = {"stiffness_ratio_cutoff": "--cutoff"}

#: What a column is made of beside its arrangement, and what else decides how it is solved.
_COUNTS = ("balls", "strike")
_OF_COLUMN = ("e", "exponent", "gap", "m", "mass_taper", "k", "stiffness_taper", "v0")
_OF_SOLVING = ("v0", "step_fraction", "mapping", "cell_timeout")


def _option(location: Sequence[str | int]) -> str:
    """Name the option of a key; values that are not legal together are named by what is said of them."""
    key = str(location[-1]) if location else ""
    return _SPELT.get(key, "--" + key.replace("_", "-")) if key else ""


def number_or_text(text: str) -> float | str:
    """Read a number; a text that is none stays as it is, for a configuration to refuse."""
    try:
        return float(text)
    except ValueError:
        return text


def whole_or_text(text: str) -> int | str:
    """Read a whole number; a text that is none stays as it is, for a configuration to refuse."""
    try:
        return int(text)
    except ValueError:
        return text


def number(option: str, text: str) -> float:
    """Read a number, infinity included.

    Raises
    ------
    UserError
        If it is none.
    """
    value = number_or_text(text)
    if isinstance(value, str) or math.isnan(value):
        raise UserError(f"{option} = {text!r:.60}; legal: a number")
    return value


def whole(option: str, text: str, low: int, high: int) -> int:
    """Read a whole number.

    Raises
    ------
    UserError
        If it is none, or out of range.
    """
    try:
        value = int(text)
    except ValueError:
        value = low - 1
    if not low <= value <= high:
        raise UserError(f"{option} = {text!r:.60}; legal: a whole number from {low} to {high}")
    return value


def path(name: str) -> Callable[[str], Path]:
    """Return a parser of paths; whether something is there, and what, is for the command to judge.

    Parameters
    ----------
    name : str
        Of the option or argument, for its errors.
    """

    def read(text: str) -> Path:
        try:
            str(text).encode()  # Parquet files are opened by names in UTF-8
            if str(text):  # pathlib takes the empty text, a variable of the shell that is not set, for "."
                Path(text).stat()
                return Path(text)
            problem = "the empty text"
        except (FileNotFoundError, NotADirectoryError):
            return Path(text)
        except OSError as error:  # too long, or behind a closed door
            problem = str(error.strerror)
        except UnicodeEncodeError:
            problem = "not UTF-8"
        except ValueError as error:
            problem = str(error)
        raise UserError(f"{name} = {text!r:.60}: {problem}; legal: a path")

    return read


def file_to_write(option: str, file: Path, suffixes: Sequence[str]) -> None:
    """Check that a file may be written, before anything is computed.

    Raises
    ------
    UserError
        If its suffix is none of these, it is a folder, or its folder is not there.
    """
    if file.suffix not in suffixes:
        raise UserError(f"{option} {file}: legal: a file that ends in {', '.join(suffixes)}")
    if file.is_dir():
        raise UserError(f"{option} {file}: is a folder; legal: a file")
    if not file.parent.is_dir():
        raise UserError(
            f"{option} {file}: {file.parent} is no folder; legal: a file in a folder that is there"
        )


def typed(parameters: Mapping[str, Any]) -> dict[str, str]:
    """Pick what was typed of a collision from the parameters of a command, by key of a configuration and ratio."""
    given = {key: parameters.get(key) for key in (*RATIOS, *_SCALES)}
    given["stiffness_ratio_cutoff"] = parameters.get("cutoff")
    return {key: value for key, value in given.items() if isinstance(value, str)}


def one_cell(parameters: Mapping[str, Any]) -> Config:
    """Make a configuration of what is typed for one collision.

    Parameters
    ----------
    parameters : mapping
        Of the command, as typer has read them; a ratio that is not a text among them is 1.

    Raises
    ------
    UserError
        If anything is illegal; it names the option.
    """
    from impact_xval.experiments.config.experiment import parse_config

    data: dict[str, Any] = {key: number_or_text(text) for key, text in typed(parameters).items()}
    cell = {key: data.pop(key, 1.0) for key in RATIOS}
    data |= {"name": "collision", "figure_cell": cell, "grid": {key: [1.0] for key in cell}}

    config = parse_config(data, where="", name=_option)
    if "gravity" in data and config.scenario == "impact":
        raise UserError(
            f"--gravity = {data['gravity']!r} with --scenario impact, which has no gravity; legal: --scenario drop"
        )
    return config


def one_column(parameters: Mapping[str, Any]) -> tuple[Arranged, Config]:
    """Make an arrangement of what is typed for one column, and a configuration of how it is solved.

    Parameters
    ----------
    parameters : mapping
        Of the command, as typer has read them.

    Raises
    ------
    UserError
        If anything is illegal; it names the option.
    """
    from impact_xval.experiments.config.arrangements import Arranged
    from impact_xval.experiments.config.errors import validated
    from impact_xval.experiments.config.experiment import parse_config

    data: dict[str, Any] = {key: number_or_text(parameters[key]) for key in _OF_COLUMN}
    counts = {key: parameters[key] for key in _COUNTS if parameters[key] is not None}
    data |= {key: whole_or_text(text) for key, text in counts.items()}
    data["arrangement"] = parameters["arrangement"]
    arranged = validated(Arranged, data, "", _option)
    data = {key: number_or_text(parameters[key]) for key in _OF_SOLVING}
    return arranged, parse_config({"scenario": "impact"} | data, where="", name=_option)


def config_file(what: str) -> Any:
    """Return the argument that names a file of TOML."""
    return typer.Argument(metavar="[CONFIG.toml]", parser=path("CONFIG.toml"), help=what)


def folder_to_write(which: str) -> Any:
    """Return the option that names the folder to write."""
    return typer.Option(metavar="DIR", parser=path("--out"), help=f"Folder to write; {which}.")


def _workers(text: str) -> int:
    return whole("--workers", text, 1, 4096)


Folder = Annotated[Path, typer.Argument(metavar="DIR", parser=path("DIR"), help="Folder of a finished run.")]
Workers = Annotated[
    int | None,
    typer.Option(metavar="N", parser=_workers, help="Processes; by default one for every core."),
]
Scheduler = Annotated[
    str | None,
    typer.Option(
        metavar="ADDRESS",
        help="Compute on a Dask cluster: the address of its scheduler.",
    ),
]
Resume = Annotated[bool, typer.Option("--resume", help="Changes nothing: a run is continued anyway.")]
JsonObject = Annotated[bool, typer.Option("--json", help="Print a JSON object.")]

# Of one collision; type and default are the command's.
STIFFNESS_RATIO: Any = typer.Option(metavar="R", help="k2/k1, from 0 to inf.")
MASS_RATIO: Any = typer.Option(metavar="R", help="m2/m1, greater than 0.")
E1: Any = typer.Option(metavar="E", help="Restitution of ball on ball, from 0 to 1.")
E2: Any = typer.Option(metavar="E", help="Restitution of ball on table, from 0 to 1.")
SCENARIO: Any = typer.Option(metavar="NAME", help="'impact' (no gravity) or 'drop'.")
GRAVITY: Any = typer.Option(metavar="G", help="In m/s^2, for a drop only; by default 9.81.")
M1: Any = typer.Option(metavar="KG", help="Mass of the upper ball.")
K1: Any = typer.Option(metavar="N/M", help="Stiffness of ball on ball.")
V0: Any = typer.Option(metavar="M/S", help="Velocity of what falls or strikes, less than 0.")
STEP_FRACTION: Any = typer.Option(
    metavar="X", help="Time step over the period of the fastest contact, at most 0.1."
)
SOLVER: Any = typer.Option(
    metavar="NAME", help="A solver; may be repeated, the model is added. By default all."
)
JSON_LIST: Any = typer.Option("--json", help="Print a JSON list, an object a solver.")
CELL_TIMEOUT: Any = typer.Option(metavar="S", help="Seconds after which a solver is ended.")
MAPPING: Any = typer.Option(metavar="NAME", help="'calibrated' or 'naive'.")
CUTOFF: Any = typer.Option(
    metavar="X",
    help="Stiffness ratio beyond which the model takes a limit (the supplement: 1e5; inf: never), or "
    "'exact': as soon as it no longer matters.",
)

# Of one column.
ARRANGEMENT: Any = typer.Option(
    metavar="NAME",
    help="'cradle'; 'chain' (one strikes a row), 'drop' (one falls on a stack that rests on a table) or 'stack' "
    "(all fall together onto a table).",
)
BALLS: Any = typer.Option(metavar="N", help="Number of balls, at most 1000.")
STRIKE: Any = typer.Option(metavar="J", help="Balls of a cradle that strike the others; by default 1.")
E: Any = typer.Option(metavar="E", help="Restitution of every contact, from 0 to 1.")
EXPONENT: Any = typer.Option(metavar="P", help="Of the springs' forces k delta^p, from 1 to 3; 1.5: Hertz.")
GAP: Any = typer.Option(metavar="M", help="Gap of every contact but the one that is struck.")
M: Any = typer.Option(metavar="KG", help="Mass of the first ball.")
MASS_TAPER: Any = typer.Option(metavar="R", help="Mass of every next ball over that of the one before.")
K: Any = typer.Option(metavar="N/M^P", help="Stiffness of the first contact.")
STIFFNESS_TAPER: Any = typer.Option(
    metavar="R", help="Stiffness of every next contact over that of the one before."
)
