"""Documents of paragraphs, tables, figures and sections, which a page, a terminal and a notebook can all show.

The module needs only the functions that format numbers. All modules that make or show text call this module.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from markupsafe import Markup, escape

from impact_xval.experiments.tables.numbers import number, percent


@dataclass(frozen=True, slots=True)
class Value:
    """A number of a run in a sentence. On a page its tooltip says where the number comes from.

    `key` is the text of the tooltip. It names a place in ``summary.csv``, such as ``mujoco velocity_divergence
    median``, or says how the number was derived. `digits` is the number of significant digits shown. If `digits` is 0,
    the number is shown as a percentage.
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
    """A piece of HTML for pages only.

    `Markup` that is no `Piece` is a paragraph, which a terminal shows without its tags.
    """


@dataclass(frozen=True, slots=True)
class Table:
    """A table with a header and rows. Its first `text` columns are aligned left, all other columns right."""

    header: Sequence[str]
    rows: Sequence[Sequence[object]]
    caption: str = ""
    text: int = 1


@dataclass(frozen=True, slots=True)
class Figure:
    """A figure in the folder of a run, by name, with its caption."""

    name: str
    caption: str


@dataclass(frozen=True, slots=True)
class Section:
    """A titled part of a document.

    If `folded` is true, the section is closed until a reader opens it. If `beside` is true, the text of the section
    stands beside its figure.
    """

    title: str
    blocks: Sequence[Block]
    folded: bool = False
    beside: bool = False

    @property
    def name(self) -> str:
        """Name of the section in the address of a page."""
        return "-".join("".join(c if c.isalnum() else " " for c in self.title.lower()).split())


#: Type of a block of a document. A block that is a plain `str` is a paragraph.
Block = str | Table | Figure | Section


def fill_sentence(template: str, **values: object) -> Markup:
    """Return a sentence whose named fields are filled. Text is escaped, and a `Value` keeps its tooltip."""
    return escape(template).format(**values)
