"""A document of headings, paragraphs and tables, written as Markdown or LaTeX.

The text of blocks is plain; each writer escapes it for its format.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

_LATEX = {
    "\\": r"\textbackslash{}",
    "{": r"\{",
    "}": r"\}",
    "$": r"\$",
    "&": r"\&",
    "#": r"\#",
    "_": r"\_",
    "%": r"\%",
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    "<": r"\textless{}",
    ">": r"\textgreater{}",
    "|": r"\textbar{}",
    '"': r"\textquotedbl{}",
    "[": "{[}",
    "]": "{]}",
}

_PREAMBLE = r"""% Needs pdflatex (or lualatex, xelatex) and the packages below. To put one table into a
% paper, copy from \begin{longtable} to \end{longtable}; it needs booktabs and longtable.
\documentclass{article}
\usepackage[T1]{fontenc}
\usepackage[utf8]{inputenc}
\usepackage[margin=20mm]{geometry}
\usepackage{booktabs}
\usepackage{longtable}
"""


@dataclass(frozen=True, slots=True)
class Heading:
    """A heading; level 1 is the title."""

    text: str
    level: int = 2


@dataclass(frozen=True, slots=True)
class Paragraph:
    """A paragraph of plain text."""

    text: str


@dataclass(frozen=True, slots=True)
class Table:
    """A table with a caption that stands alone; columns of numbers are aligned right.

    Attributes
    ----------
    caption : str
    header : sequence of str
    rows : sequence of sequence of str
    text_columns : int
        The first columns, which hold text.
    detail : bool
        Whether only the long formats carry it (Markdown, HTML), not a page of LaTeX or a terminal.
    """

    caption: str
    header: Sequence[str]
    rows: Sequence[Sequence[str]]
    text_columns: int = 1
    detail: bool = False


Block = Heading | Paragraph | Table


def escape_markdown(text: str) -> str:
    """Escape text so that Markdown shows it as it is."""
    text = text.replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;")
    return re.sub(r"([\\`*_{}\[\]#|~])", r"\\\1", text)


def escape_latex(text: str) -> str:
    """Escape text so that LaTeX shows it as it is; letters pdflatex does not know become code points."""
    return "".join(_LATEX.get(letter) or _known_to_latex(letter) for letter in text)


def _known_to_latex(letter: str) -> str:
    if letter.isascii() or (letter.isalpha() and ord(letter) < 256):
        return letter
    return f"{{[}}U+{ord(letter):04X}{{]}}"


def to_markdown(blocks: Sequence[Block]) -> str:
    """Write blocks as Markdown with pipe tables."""
    parts: list[str] = []
    for block in blocks:
        match block:
            case Heading(text, level):
                parts.append(f"{'#' * level} {escape_markdown(text)}")
            case Paragraph(text):
                parts.append(escape_markdown(text))
            case Table(caption, header, rows, text_columns):
                rule = ["---"] * text_columns + ["--:"] * (len(header) - text_columns)
                lines = [map(escape_markdown, header), rule, *(map(escape_markdown, row) for row in rows)]
                parts.append(f"**{escape_markdown(caption)}**")
                parts.append("\n".join(f"| {' | '.join(line)} |" for line in lines))
    return "\n\n".join(parts) + "\n"


def to_latex(blocks: Sequence[Block]) -> str:
    """Write blocks as a LaTeX document with booktabs tables."""
    parts: list[str] = []
    for block in blocks:
        match block:
            case Heading(text, level):
                command = "section*" if level == 1 else "subsection*"
                parts.append(f"\\{command}{{{escape_latex(text)}}}")
            case Paragraph(text):
                parts.append(escape_latex(text))
            case Table(detail=False):
                parts.append(_latex_table(block))
    body = "\n\n".join(parts)
    return f"{_PREAMBLE}\\begin{{document}}\n\n{body}\n\n\\end{{document}}\n"


def _latex_table(table: Table) -> str:
    def line(cells: Sequence[str]) -> str:
        return " & ".join(map(escape_latex, cells)) + r" \\"

    numbers = len(table.header) - table.text_columns
    return "\n".join(
        [
            f"\\begin{{longtable}}{{{'l' * table.text_columns}{'r' * numbers}}}",
            f"\\caption{{{escape_latex(table.caption)}}} \\\\",
            r"\toprule",
            line(table.header),
            r"\midrule",
            r"\endfirsthead",
            r"\toprule",
            line(table.header),
            r"\midrule",
            r"\endhead",
            r"\bottomrule",
            r"\endfoot",
            *map(line, table.rows),
            r"\end{longtable}",
        ]
    )
