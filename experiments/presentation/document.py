"""A document: paragraphs, tables, figures and sections. A page, a terminal and a notebook show the same ones."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from markupsafe import Markup, escape

from impact_xval.experiments.tables.numbers import number, percent


@dataclass(frozen=True, slots=True)
class Value:
    """A number of a run in a sentence; on a page its tooltip says which value of the tables it is.

    `key` is that text: the place in ``summary.csv``, such as ``mujoco velocity_divergence median``, or a derivation.
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
    """A piece of HTML for pages only. Other `Markup` is a paragraph; a terminal shows it without tags."""


@dataclass(frozen=True, slots=True)
class Table:
    """A table with a header and rows; the first `text` columns are aligned left, all other columns right."""

    header: Sequence[str]
    rows: Sequence[Sequence[object]]
    caption: str = ""
    text: int = 1


@dataclass(frozen=True, slots=True)
class Figure:
    """A figure of the run's folder, with its caption."""

    name: str
    caption: str


@dataclass(frozen=True, slots=True)
class Section:
    """A titled part of a document; if `folded`, it opens on demand; if `beside`, its text is beside its picture."""

    title: str
    blocks: Sequence[Block]
    folded: bool = False
    beside: bool = False

    @property
    def name(self) -> str:
        """The section's name in an address."""
        return "-".join("".join(c if c.isalnum() else " " for c in self.title.lower()).split())


#: A block of a document; a text is a paragraph.
Block = str | Table | Figure | Section


def fill_sentence(template: str, **values: object) -> Markup:
    """Fill the named fields of a sentence; text is escaped, and a `Value` keeps its tooltip."""
    return escape(template).format(**values)
