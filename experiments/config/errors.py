"""The exceptions whose messages are meant for the user, and what is wrong with a file or a table, in one line.

The line names the file, the field, the value and what is legal, which is the description of the field. Tables may be
nested, and may come in lists.
"""

from __future__ import annotations

import difflib
import tomllib
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar, get_args

from impact_xval.errors import ImpactXvalError

if TYPE_CHECKING:
    from pydantic import BaseModel

#: Names a field by the keys, and the positions in lists, that lead to it.
FieldName = Callable[[Sequence[str | int]], str]

_Model = TypeVar("_Model", bound="BaseModel")


class _OneLineError(ImpactXvalError):
    def __init__(self, message: str) -> None:
        from impact_xval.compliant_baselines.answers import visible  # its room imports numpy

        super().__init__(visible(" ".join(str(message).split())))


class UserError(_OneLineError, ValueError):
    """A wrong request of the user; the command line prints the message in one line and ends with exit code 2."""


class InterruptedRunError(_OneLineError):
    """The run was stopped before its end; what is done is kept."""


def read_toml(path: Path | str) -> dict[str, Any]:
    """Read a TOML file; a `UserError` says why it cannot be read."""
    try:
        return tomllib.loads(Path(path).read_text(encoding="utf-8"))
    except OSError as error:
        raise UserError(f"{path}: cannot be read: {error.strerror}; legal: a TOML file") from None
    except UnicodeDecodeError as error:
        raise UserError(f"{path}: not UTF-8 (byte {error.start}); legal: a TOML file in UTF-8") from None
    except ValueError as error:
        raise UserError(f"{path}: not TOML: {error}") from None


def dotted(parts: Sequence[str | int]) -> str:
    """Name a field as ``grid.e1``, an entry of a list by its index: ``solvers.0``."""
    return ".".join(map(str, parts))


def validated(
    model: type[_Model], data: dict[str, Any], where: str, name: FieldName = dotted, context: Any = None
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


def _one_line(problem: Any, model: type[BaseModel], name: FieldName) -> str:
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
            return f"{field}{': ' if inside else ' = '}{problem['ctx']['error']}".removeprefix(": ")
    return f"{field} = {value}; legal: {legal}" if location else f"{value}: {problem['msg']}"


def _fields(annotation: Any) -> dict[str, Any]:
    """Return the fields of a table, optional, in a list or neither; none of anything else."""
    tables = [each for each in (annotation, *get_args(annotation)) if hasattr(each, "model_fields")]
    return tables[0].model_fields if tables else {}


def hint(word: str, known: Sequence[str]) -> str:
    """Ask in brackets whether a known word was meant; empty if none is like it."""
    close = difflib.get_close_matches(word.lower(), known, n=1)
    return f" (did you mean {close[0]!r}?)" if close else ""


def shorten(value: object, limit: int = 60) -> str:
    """Write a value as Python does, cut at a length."""
    text = repr(value)
    return text if len(text) <= limit else text[: limit - 3] + "..."
