"""Markdown as one self-contained page for a browser: contents, figures, tables with captions; no network.

A picture of the Markdown stands for a figure of a folder, which becomes part of the page, or for a piece of HTML by its
name; ``contents`` is the list of sections, which else comes before the first of them. Sections after a line across the
page are folded.
"""

from __future__ import annotations

import base64
import re
from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path

from markdown_it.token import Token
from markupsafe import Markup

from impact_xval.experiments.presentation.pages import caption_of, parser, plain_text, render

#: Cells of a table with more letters than this are wrapped.
_LONG = 60

#: Tables with more rows than this can be sorted and filtered.
_MANY = 12


def html_of(
    markdown: str,
    title: str,
    pictures: Path | None = None,
    pieces: Mapping[str, Markup] | None = None,
    scripts: Markup | None = None,
) -> str:
    """Turn Markdown into one self-contained HTML page.

    Parameters
    ----------
    markdown : str
        Without HTML: tags in it are shown as text.
    title : str
        Of the page.
    pictures : Path, optional
        The folder that addresses of pictures begin in; the pictures become part of the page, their texts captions.
    pieces : mapping, optional
        HTML that stands in the place of a picture of that address.
    scripts : Markup, optional
        Put at the end of the page.
    """
    tokens = parser().parse(markdown)
    contents = render_markup("contents.html.j2", headings=_name_sections(tokens))
    _fold_sections(tokens)
    if "](contents)" not in markdown:
        first = next((at for at, token in enumerate(tokens) if token.tag == "h2"), len(tokens))
        tokens.insert(first, Token("html_block", "", 0, content=str(contents)))
    pieces = {"contents": contents, **(pieces or {})}
    figures = 0
    for at, token in enumerate(tokens):
        if token.type == "inline" and (image := _image(token)) is not None:
            address = str(image.attrs["src"])
            figures += address not in pieces
            piece = pieces[address] if address in pieces else _figure(tokens, at, pictures, figures)
            _put(tokens[at - 1 : at + 2], piece)
        if token.type == "table_open":
            _caption_into_table(tokens, at)
        if token.type == "inline" and len(token.content) > _LONG and tokens[at - 1].type == "td_open":
            tokens[at - 1].attrSet("class", "long")
    renderer = parser()
    body = renderer.renderer.render(tokens, renderer.options, {})
    # markdown-it has escaped it
    return render("page.html.j2", title=title, body=Markup(body), scripts=scripts or "")


def render_markup(name: str, /, **facts: object) -> Markup:
    """Fill a template of HTML, which escapes what it is given."""
    return Markup(render(name, **facts))


def _name_sections(tokens: Sequence[Token]) -> list[tuple[str, str]]:
    """Give every heading below the title a name of its own; return text and name of those of the second level."""
    found: list[tuple[str, str]] = []
    names: set[str] = set()
    for token, inline in pairwise(tokens):
        if token.type == "heading_open" and token.tag != "h1":
            text = plain_text(inline)
            name = re.sub(r"[^a-z0-9]+", "-", text.lower()).strip("-") or "section"
            while name in names:
                name += "-"
            names.add(name)
            token.attrSet("id", name)
            if token.tag == "h2":
                found.append((text, name))
    return found


def _image(token: Token) -> Token | None:
    """Return the picture that a paragraph consists of, if it does."""
    children = token.children or []
    return children[0] if len(children) == 1 and children[0].type == "image" else None


def _figure(tokens: Sequence[Token], at: int, pictures: Path | None, place: int) -> Markup:
    """Make a figure of a picture; its caption is a paragraph below that begins with its number, or else its text."""
    (image,) = tokens[at].children or []
    path = Path(str(image.attrs["src"]))
    if pictures is None:
        raise ValueError(f"there is no folder of pictures for {path}")
    caption = Markup.escape(plain_text(image))
    below = tokens[at + 3].children if at + 3 < len(tokens) and tokens[at + 3].type == "inline" else []
    if plain_text(tokens[at + 3] if below else image).startswith(f"Figure {place}."):
        renderer = parser()
        caption = Markup(renderer.renderer.render([tokens[at + 3]], renderer.options, {}))
        _put(tokens[at + 2 : at + 5], "")
    else:
        caption = Markup("<b>Figure {}.</b> {}").format(place, caption)
    data = base64.b64encode((pictures / path).read_bytes()).decode("ascii")
    words = path.stem.replace("-", " ")
    return render_markup("figure.html.j2", data=data, name=path.stem, words=words, caption=caption)


def _fold_sections(tokens: list[Token]) -> None:
    """Fold the sections of the second level that come after a line across the page."""
    folding = inside = False
    for token in tokens:
        if token.type == "hr":
            folding, token.type, token.hidden = True, "html_block", True
        elif folding and token.tag == "h2":
            if token.type == "heading_open":
                text = f'<details class="section"><summary><h2 id="{token.attrs["id"]}">'
                token.content, inside = "</details>\n" * inside + text, True
            else:
                token.content = "</h2></summary>\n"
            token.type = "html_block"
    if inside:
        tokens.append(Token("html_block", "", 0, content="</details>\n"))


def _put(tokens: Sequence[Token], piece: str) -> None:
    """Put HTML in the place of a paragraph."""
    for token in tokens:
        token.type, token.children, token.content = "html_block", None, ""
    tokens[0].content = str(piece)  # no Markup, which would escape what an older markdown-it adds it to


def _caption_into_table(tokens: list[Token], at: int) -> None:
    """Move the caption before the table at a place into it; fold the table of a detail."""
    caption = caption_of(tokens, at)
    end = at + next(i for i, token in enumerate(tokens[at:]) if token.type == "table_close")
    many = sum(token.type == "tr_open" for token in tokens[at:end]) > _MANY + 1
    table = '<table class="many">' if many else "<table>"
    before, after = (
        f'<div class="wide" tabindex="0" role="region" aria-label="table">{table}',
        "</table></div>",
    )
    if caption is not None:
        text, detail = caption
        _put(tokens[at - 3 : at], "")
        text = Markup.escape(text)
        if detail:
            before, after = f"<details><summary>{text}</summary>{before}", f"{after}</details>"
        else:
            before += f"<caption>{text}</caption>\n"
    tokens[at] = Token("html_block", "", 0, content=before)
    tokens[end] = Token("html_block", "", 0, content=f"{after}\n")
