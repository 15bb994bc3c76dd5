"""Pages: words from templates, facts from Python; Markdown is the one form from which all others are made.

`render` fills a template with facts. A ``.md.j2`` template is Markdown: whatever it shows of a variable is escaped, so
that text of a user can be nothing but text. `page.html` turns the result into a page for a browser, `latex_of` into
one for print, `blocks_of` into pieces for a terminal. Tables come from the macro of ``table.md.j2``: a paragraph in
bold, the caption, and below it a table; of a caption in italics the table is a detail, which HTML folds away and LaTeX
leaves out.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import pairwise, takewhile
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined, pass_context
from jinja2.runtime import Context
from markdown_it import MarkdownIt
from markdown_it.token import Token
from markupsafe import Markup

from impact_xval.compliant_baselines.answers import visible
from impact_xval.experiments.measures.laws import by_law
from impact_xval.experiments.tables.numbers import listed, number, percent, short

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


@dataclass(frozen=True, slots=True)
class Heading:
    """A heading; level 1 is the title."""

    text: str
    level: int


@dataclass(frozen=True, slots=True)
class Paragraph:
    """A paragraph, or an item of a list, as plain text."""

    text: str


@dataclass(frozen=True, slots=True)
class Table:
    """A table of plain text with its caption; `numeric` columns are aligned right."""

    caption: str
    header: Sequence[str]
    rows: Sequence[Sequence[str]]
    numeric: Sequence[bool]
    detail: bool


Block = Heading | Paragraph | Table


def escape_markdown(text: str) -> str:
    """Escape text so that Markdown shows it as it is, on one line."""
    text = visible(re.sub(r"\s*[\r\n]\s*", " ", text))
    text = text.replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;")
    return re.sub(r"([\\`*_{}\[\]#|~])", r"\\\1", text)


def escape_latex(text: str) -> str:
    """Escape text so that LaTeX shows it as it is; letters pdflatex does not know become code points."""

    def known(letter: str) -> bool:
        return letter.isascii() or (letter.isalpha() and ord(letter) < 256)

    return "".join(
        _LATEX.get(letter, letter) if known(letter) else f"{{[}}U+{ord(letter):04X}{{]}}" for letter in text
    )


@cache
def _environment() -> Environment:
    environment = Environment(
        loader=PackageLoader("impact_xval.experiments.presentation"),
        autoescape=lambda name: name is not None and not name.endswith(".txt.j2"),
        undefined=StrictUndefined,
        finalize=_escaped,
        keep_trailing_newline=True,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.policies["json.dumps_kwargs"] = {}  # in the order in which they were written
    environment.filters |= {"number": number, "short": short, "percent": percent}
    environment.filters |= {"listed": listed, "by_law": by_law}
    return environment


@pass_context
def _escaped(context: Context, value: Any) -> Any:
    """Escape what a Markdown template shows of a variable, but for what macros have written."""
    if isinstance(value, str) and not isinstance(value, Markup) and str(context.name).endswith(".md.j2"):
        return Markup(escape_markdown(value))
    return value


def render(name: str, /, **facts: Any) -> str:
    """Fill a template with facts.

    Parameters
    ----------
    name : str
        A file in ``templates/``: ``.md.j2`` gives Markdown, a line a paragraph; ``.html.j2`` HTML; ``.txt.j2`` text.
    **facts
        What the template shows; filters `number`, `short`, `percent`, `listed` and `by_law` are at hand.
    """
    text = _environment().get_template(name).render(facts)
    return _one_line_a_paragraph(text) if name.endswith(".md.j2") else text


def phrase(name: str, macro: str, *facts: Any, **named: Any) -> str:
    """Return what a macro of a Markdown template says, as plain text on one line."""
    said = getattr(_environment().get_template(name).module, macro)(*facts, **named)
    return " ".join(plain_text(token) for token in parser().parse(str(said)) if token.type == "inline")


def _one_line_a_paragraph(text: str) -> str:
    """Join the lines of paragraphs and items, and leave one empty line between blocks."""
    blocks = []
    for block in re.split(r"\n\s*\n", text.strip()):
        if block.lstrip().startswith(("- ", "1. ")):
            blocks.append(re.sub(r"\s*\n(?!- |\d+\. )\s*", " ", block))
        else:
            blocks.append(block if block.startswith(("|", "```")) else re.sub(r"\s*\n\s*", " ", block))
    return "\n\n".join(blocks) + "\n"


@cache
def parser() -> MarkdownIt:
    """Return what takes Markdown apart: with tables, without HTML."""
    return MarkdownIt("commonmark", {"html": False}).enable("table")


def plain_text(inline: Token) -> str:
    """Return the text of an inline token without its marks."""
    return "".join(" " if t.type == "softbreak" else t.content for t in inline.children or [])


def caption_of(tokens: Sequence[Token], at: int) -> tuple[str, bool] | None:
    """Return the caption of the table that begins at a place, and whether it is a detail; None without one."""
    if at < 3 or tokens[at - 3].type != "paragraph_open":
        return None
    # markdown-it leaves texts of no letters beside marks
    kinds = [child.type for child in tokens[at - 2].children or [] if child.content or child.tag]
    for mark, detail in (("strong", False), ("em", True)):
        if (kinds[0], kinds[-1]) == (f"{mark}_open", f"{mark}_close"):
            return plain_text(tokens[at - 2]), detail
    return None


def blocks_of(markdown: str) -> Iterator[Block]:
    """Take Markdown apart: headings, paragraphs and tables, as plain text, in their order."""
    tokens = parser().parse(markdown)
    captions = {at - 2: caption_of(tokens, at) for at, t in enumerate(tokens) if t.type == "table_open"}
    for at, token in enumerate(tokens):
        if token.type == "table_open":
            inside = list(takewhile(lambda t: t.type != "table_close", tokens[at:]))
            yield _table(inside, *(captions[at - 2] or ("", False)))
        elif token.type == "inline" and tokens[at - 1].type == "heading_open":
            yield Heading(plain_text(token), int(tokens[at - 1].tag[1:]))
        elif token.type == "inline" and tokens[at - 1].type == "paragraph_open" and not captions.get(at):
            yield Paragraph(plain_text(token))


def _table(tokens: Sequence[Token], caption: str, detail: bool) -> Table:
    rows: list[list[str]] = []
    numeric: list[bool] = []
    for before, token in pairwise(tokens):
        if before.type == "tr_open":
            rows.append([])
        if token.type == "inline":
            rows[-1].append(plain_text(token))
            if before.type == "th_open":
                numeric.append("right" in str(before.attrs.get("style")))
    return Table(caption, rows[0], rows[1:], numeric, detail)


def latex_of(markdown: str, details: bool = False) -> str:
    """Turn headings, paragraphs and tables of Markdown into a LaTeX document with booktabs tables.

    Parameters
    ----------
    markdown : str
    details : bool
        Whether tables that are details are part of it.
    """
    parts: list[str] = []
    for block in blocks_of(markdown):
        match block:
            case Heading(text, level):
                parts.append(f"\\{'section' if level == 1 else 'subsection'}*{{{escape_latex(text)}}}\n")
            case Paragraph(text):
                parts.append(f"{escape_latex(text)}\n")
            case Table(detail=detail) if details or not detail:
                parts.append(_latex_table(block))
    return render("document.tex.txt.j2", body="\n".join(parts))


def _latex_table(table: Table) -> str:
    import pandas as pd

    shown = pd.DataFrame([[escape_latex(cell) for cell in row] for row in table.rows])
    header = [escape_latex(title) for title in table.header]
    style = shown.style
    style.hide(axis="index")
    style.format_index(lambda column: header[column], axis="columns")
    return style.to_latex(
        environment="longtable",
        hrules=True,
        column_format="".join("r" if right else "l" for right in table.numeric),
        caption=escape_latex(table.caption),
    )
