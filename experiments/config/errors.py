"""The exceptions whose messages are meant for the user, and what is wrong with a file or a table, in one line.

The line names the file, the field, the value and what is legal, which is the description of the field. Tables may be
nested, and may come in lists.
"""

from __future__ import annotations

import difflib
import tomllib
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, TypeGuard, TypeVar, get_args

from impact_xval.errors import ImpactXvalError

if TYPE_CHECKING:
    from pydantic import BaseModel
    from pydantic.fields import FieldInfo
    from pydantic_core import ErrorDetails

#: Names a field by the keys, and the positions in lists, that lead to it.
FieldName = Callable[[Sequence[str | int]], str]

#: A table of a TOML file; its values are texts, numbers, truth values, lists and tables.
TomlTable = dict[str, object]

_Model = TypeVar("_Model", bound="BaseModel")


class _OneLineError(ImpactXvalError):
    def __init__(self, message: str) -> None:
        from impact_xval.compliant_baselines.answers import escape_invisible  # its room imports numpy

        super().__init__(escape_invisible(" ".join(str(message).split())))


class UserError(_OneLineError, ValueError):
    """A wrong request of the user; the command line prints the message in one line and ends with exit code 2."""


class InterruptedRunError(_OneLineError):
    """The run was stopped before its end; what is done is kept."""


def is_table(value: object) -> TypeGuard[TomlTable]:
    """Return whether a value of a TOML file is a table."""
    return isinstance(value, dict)


def is_list(value: object) -> TypeGuard[list[object]]:
    """Return whether a value of a TOML file is a list."""
    return isinstance(value, list)


def read_toml(path: Path | str) -> TomlTable:
    """Read a TOML file; a `UserError` says why it cannot be read."""
    try:
        return tomllib.loads(Path(path).read_text(encoding="utf-8"))
    except OSError as error:
        raise UserError(f"{path}: cannot be read: {error.strerror}; legal: a TOML file") from None
    except UnicodeDecodeError as error:
        raise UserError(f"{path}: not UTF-8 (byte {error.start}); legal: a TOML file in UTF-8") from None
    except ValueError as error:
        raise UserError(f"{path}: not TOML: {error}") from None


def dotted_name(parts: Sequence[str | int]) -> str:
    """Name a field as ``grid.e1``, an entry of a list by its index: ``solvers.0``."""
    return ".".join(map(str, parts))


def validate(
    model: type[_Model],
    data: Mapping[str, object],
    where: str,
    name: FieldName = dotted_name,
    context: str | None = None,
) -> _Model:
    """Validate plain values; a `UserError` tells the first mistake and counts the others.

    The line begins with `where`, if it is not empty, and names fields by `name`; what is legal is their description.
    The context is for validators of the model.
    """
    from pydantic import ValidationError  # the commands that read no table start without it

    try:
        return model.model_validate(data, context=context)
    except ValidationError as error:
        first, *others = error.errors(include_url=False)
        more = f" (and {len(others)} more)" if others else ""
        raise UserError(f"{where}: {_one_line(first, model, name)}{more}".removeprefix(": ")) from None


def _one_line(problem: ErrorDetails, model: type[BaseModel], name: FieldName) -> str:
    """Turn one of pydantic's findings into ``field = value; legal: range``."""
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
            # What a validator of ours says begins with the value, unless it is of a table as a whole.
            said = problem.get("ctx", {}).get("error")
            return f"{field}{': ' if inside else ' = '}{said}".removeprefix(": ")
        case _:
            pass
    return f"{field} = {value}; legal: {legal}" if location else f"{value}: {problem['msg']}"


def _fields(annotation: object) -> dict[str, FieldInfo]:
    """Return the fields of a table, optional, in a list or neither; none of anything else."""
    from pydantic import BaseModel

    for part in (annotation, *get_args(annotation)):
        if isinstance(part, type) and issubclass(part, BaseModel):
            return part.model_fields
    return {}


def hint(word: str, known: Sequence[str]) -> str:
    """Ask in brackets whether a known word was meant; empty if none is like it."""
    close = difflib.get_close_matches(word.lower(), known, n=1)
    return f" (did you mean {close[0]!r}?)" if close else ""


def shorten(value: object, limit: int = 60) -> str:
    """Write a value as Python does, cut at a length."""
    text = repr(value)
    return text if len(text) <= limit else text[: limit - 3] + "..."
