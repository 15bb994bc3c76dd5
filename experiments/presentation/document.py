"""A document: paragraphs, tables, figures and sections. A page, a terminal and a notebook show the same ones."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from string import Formatter
from typing import Any

from markupsafe import Markup

from impact_xval.experiments.tables.numbers import number, percent


@dataclass(frozen=True, slots=True)
class Value:
    """A number of a run in a sentence; on a page one sees by pointing at it which value of the tables it is.

    Attributes
    ----------
    value : float
    key : str
        What it is, as in ``summary.csv``, or how it follows from the tables: ``mujoco velocity_divergence median``.
    digits : int
        Significant digits shown; 0 for a percentage.
    """

    value: float
    key: str
    digits: int = 3

    def __str__(self) -> str:
        return number(self.value, self.digits) if self.digits else percent(self.value)

    def __html__(self) -> str:
        return Markup('<data value="{}" title="{}">{}</data>').format(
            repr(float(self.value)), self.key, str(self)
        )


@dataclass(frozen=True, slots=True)
class Text:
    """A paragraph of text and values."""

    parts: tuple[Any, ...]

    def __str__(self) -> str:
        return "".join(map(str, self.parts))

    def __html__(self) -> str:
        return Markup("").join(self.parts)


@dataclass(frozen=True, slots=True)
class Table:
    """A table: `header` and `rows`, of which the first `text` columns are aligned left, the others right."""

    header: Sequence[str]
    rows: Sequence[Sequence[Any]]
    caption: Any = ""
    text: int = 1


@dataclass(frozen=True, slots=True)
class Figure:
    """A figure of the run's folder, with its caption."""

    name: str
    caption: str


@dataclass(frozen=True, slots=True)
class Section:
    """A part of a document with a title; a `folded` one opens on demand, and one `beside` stands beside its picture."""

    title: str
    blocks: Sequence[Block]
    folded: bool = False
    beside: bool = False

    @property
    def name(self) -> str:
        """The section's name in an address."""
        return "-".join("".join(c if c.isalnum() else " " for c in self.title.lower()).split())


#: Markup is a piece of HTML, for a page alone.
Block = str | Text | Table | Figure | Section | Markup


def say(template: str, **values: Any) -> Text:
    """Fill the named fields of a sentence; values keep what they are."""
    parts: list[Any] = []
    for text, name, _, _ in Formatter().parse(template):
        parts += [text] if name is None else [text, values[name]]
    return Text(tuple(part if isinstance(part, Value | Text | Markup) else str(part) for part in parts))


def together(sentences: Iterable[Any]) -> Text:
    """Join sentences into a paragraph."""
    parts: list[Any] = []
    for sentence in sentences:
        parts += [" ", sentence] if parts else [sentence]
    return Text(tuple(parts))
