"""A document: paragraphs, tables, figures and sections. A page, a terminal and a notebook show the same ones."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from markupsafe import Markup, escape

from impact_xval.experiments.tables.numbers import number, percent


@dataclass(frozen=True, slots=True)
class Value:
    """A number of a run in a sentence; on a page one sees by pointing at it which value of the tables it is.

    `key` says so, as in ``summary.csv``, or how it follows from the tables: ``mujoco velocity_divergence median``.
    `digits` are the significant ones shown; 0 for a percentage.
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


class Piece(Markup):
    """A piece of HTML, for a page alone; other `Markup` is a paragraph, whose tags a terminal leaves out."""


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


#: A text is a paragraph.
Block = str | Table | Figure | Section


def fill_sentence(template: str, **values: Any) -> Markup:
    """Fill the named fields of a sentence; values keep what they are."""
    return escape(template).format(**values)
