"""Exceptions whose messages are meant for the user, and the validation of TOML files with messages of one line.

A message names the file, the field, its value and the legal values. The legal values come from the description of the
field in its pydantic model. A TOML file may have tables inside tables and tables in lists.

The modules that read files and options call `read_toml` and `validate`; the command line prints the exceptions.
"""

from __future__ import annotations

import difflib
import tomllib
from collections.abc import Callable, Mapping, Sequence
from decimal import Decimal
from pathlib import Path
from typing import TYPE_CHECKING, TypeGuard, TypeVar, get_args

from impact_xval.errors import ImpactXvalError

if TYPE_CHECKING:
    from pydantic import BaseModel
    from pydantic.fields import FieldInfo
    from pydantic_core import ErrorDetails

#: Function that returns the name of a field. Its argument is the sequence of keys and of positions in lists that leads
#: to the field.
FieldName = Callable[[Sequence[str | int]], str]

#: A table of a TOML file; its values are texts, numbers, truth values, lists and tables.
TomlTable = dict[str, object]

#: Largest depth to which tables and lists of a TOML file may be nested. No file that is legal needs ten levels.
_DEEPEST = 20
_LEGAL_DEPTH = f"tables and lists in at most {_DEEPEST} levels"

_Model = TypeVar("_Model", bound="BaseModel")


class _OneLineError(ImpactXvalError):
    def __init__(self, message: str) -> None:
        from impact_xval.compliant_baselines.answers import escape_invisible  # the package imports NumPy

        super().__init__(escape_invisible(" ".join(str(message).split())))


class UserError(_OneLineError, ValueError):
    """Error for a wrong request of the user. The command line prints its message in one line; the exit code is 2."""


class InterruptedRunError(_OneLineError):
    """Error for a run that is stopped before its end. Results that are already written are kept."""


def is_table(value: object) -> TypeGuard[TomlTable]:
    """Return whether a value of a TOML file is a table."""
    return isinstance(value, dict)


def is_list(value: object) -> TypeGuard[list[object]]:
    """Return whether a value of a TOML file is a list."""
    return isinstance(value, list)


def read_toml(path: Path | str) -> TomlTable:
    """Read a TOML file, which may begin with a byte order mark; a `UserError` says why it cannot be read."""
    try:
        table = tomllib.loads(Path(path).read_text(encoding="utf-8-sig"))
    except OSError as error:
        raise UserError(f"{path}: cannot be read: {error.strerror}; legal: a TOML file") from None
    except UnicodeDecodeError as error:
        raise UserError(f"{path}: not UTF-8 (byte {error.start}); legal: a TOML file in UTF-8") from None
    except RecursionError:
        raise UserError(f"{path}: nested too deeply; legal: {_LEGAL_DEPTH}") from None
    except ValueError as error:
        raise UserError(f"{path}: not TOML: {error}") from None
    _check_depth_and_integers(table, str(path), [])
    return table


def _check_depth_and_integers(value: object, path: str, parts: list[str | int]) -> None:
    """Raise a `UserError` if a value of a TOML file is nested too deeply, or holds an integer of more than 64 bits.

    `parts` are the keys, and the positions in lists, that lead to the value. NumPy has no such integers, and Python
    cannot turn the largest of them into floats.
    """
    if len(parts) > _DEEPEST:
        raise UserError(f"{path}: {dotted_name(parts)} is nested too deeply; legal: {_LEGAL_DEPTH}")
    if isinstance(value, int) and not -(2**63) <= value < 2**63:
        legal = "an integer of 64 bits, or a number with a point or an exponent, up to 1.7e308"
        raise UserError(f"{path}: {dotted_name(parts)} = {Decimal(value):.3e}; legal: {legal}")
    if is_table(value) or is_list(value):
        for key, item in value.items() if is_table(value) else enumerate(value):
            _check_depth_and_integers(item, path, [*parts, key])


def dotted_name(parts: Sequence[str | int]) -> str:
    """Return the name of a field with dots, such as ``grid.e1``, or ``solvers.0`` for the first entry of a list."""
    return ".".join(map(str, parts))


def validate(
    model: type[_Model],
    data: Mapping[str, object],
    where: str,
    name: FieldName = dotted_name,
    context: str | None = None,
) -> _Model:
    """Return the pydantic model of a TOML table; a `UserError` tells the first mistake and counts the others.

    Parameters
    ----------
    model : type of BaseModel
        Model of the table. The descriptions of its fields say what is legal.
    data : mapping of str to object
        Values by key, as a TOML file has them.
    where : str
        Beginning of the message, such as the path of the file; may be empty.
    name : callable
        Returns the name of a field in the message.
    context : str, optional
        Validation context, which validators of the model may read.
    """
    from pydantic import ValidationError  # imported here: commands that read no table start faster without it

    try:
        return model.model_validate(data, context=context)
    except ValidationError as error:
        first, *others = error.errors(include_url=False)
        more = f" (and {len(others)} more)" if others else ""
        raise UserError(f"{where}: {_one_line(first, model, name)}{more}".removeprefix(": ")) from None


def _one_line(problem: ErrorDetails, model: type[BaseModel], name: FieldName) -> str:
    """Return an error of pydantic as one line, ``field = value; legal: range``."""
    location, field, value = problem["loc"], name(problem["loc"]), shorten(problem["input"])
    legal, inside = "", model.model_fields
    for key in location:
        if key in inside:
            legal = inside[key].description or ""
            inside = _fields(inside[key].annotation)
    match problem["type"]:
        case "extra_forbidden":
            key = str(location[-1])
            tables = [name for name, each in inside.items() if key in _fields(each.annotation)]
            where = (
                "above every [table]" if key in model.model_fields else f"in [{tables[0]}]" if tables else ""
            )
            belongs = f" (it belongs {where})" if where else hint(key, [*inside])
            return f"{field} = {value}: unknown key{belongs}; legal: {', '.join(inside)}"
        case "missing":
            return f"{field} is missing; legal: {legal}"
        case "value_error":
            # Messages of this project's validators about a single value begin with the value. Messages about a whole
            # table do not.
            said = problem.get("ctx", {}).get("error")
            return f"{field}{': ' if inside else ' = '}{said}".removeprefix(": ")
        case _:
            pass
    return f"{field} = {value}; legal: {legal}" if location else f"{value}: {problem['msg']}"


def _fields(annotation: object) -> dict[str, FieldInfo]:
    """Return the fields of the table that an annotation names.

    The annotation may also be of an optional table or of a list of tables.

    If the annotation names no table, the result is empty.
    """
    from pydantic import BaseModel

    for part in (annotation, *get_args(annotation)):
        if isinstance(part, type) and issubclass(part, BaseModel):
            return part.model_fields
    return {}


def hint(word: str, known: Sequence[str]) -> str:
    """Return a question in parentheses that asks whether a similar known word was meant; empty without such a word."""
    close = difflib.get_close_matches(word.lower(), known, n=1)
    return f" (did you mean {close[0]!r}?)" if close else ""


def shorten(value: object, limit: int = 60) -> str:
    """Return the `repr` of a value, cut to at most `limit` characters."""
    text = repr(value)
    return text if len(text) <= limit else text[: limit - 3] + "..."
