"""Conversion of a document to one self-contained HTML page, which loads no other files.

The module needs the templates of this package. `report` and other modules that write pages call this module.
"""

from __future__ import annotations

import base64
from collections.abc import Callable, Sequence
from pathlib import Path

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from impact_xval.experiments.presentation.document import Block, Piece, Section, Value
from impact_xval.experiments.presentation.words import GRAPHS_IN_WORDS, display_name
from impact_xval.experiments.tables.numbers import join_words, number

_ENVIRONMENT = Environment(
    loader=PackageLoader("impact_xval.experiments.presentation"),
    autoescape=True,
    undefined=StrictUndefined,
    trim_blocks=True,
    lstrip_blocks=True,
)
_ENVIRONMENT.policies["json.dumps_kwargs"] = {}  # keep the order of keys
_ENVIRONMENT.globals["Value"] = Value
_ENVIRONMENT.filters |= {"kind": lambda block: type(block).__name__}
_ENVIRONMENT.filters |= {"number": number, "join_words": join_words, "named": display_name}
_ENVIRONMENT.filters["in_words"] = GRAPHS_IN_WORDS.__getitem__


def render_page(title: str, blocks: Sequence[Block], folder: Path | None = None) -> str:
    """Return a document as an HTML page that contains the figures of the document, which are read from `folder`.

    A table of contents precedes the first section if there are more than two sections.
    """

    def picture(name: str) -> str:
        assert folder is not None
        data = base64.b64encode((folder / f"{name}.svg").read_bytes()).decode("ascii")
        return f"data:image/svg+xml;base64,{data}"

    sections = [block for block in blocks if isinstance(block, Section)]
    return render_template("page.html.j2", title=title, blocks=blocks, sections=sections, picture=picture)


def render_blocks(blocks: Sequence[Block]) -> Markup:
    """Return blocks without figures as a piece of HTML."""
    module = _ENVIRONMENT.get_template("blocks.html.j2").make_module({"picture": None})
    show: Callable[[Block], Markup] = vars(module)["show"]  # the macro `show` of the template
    return Markup("").join(map(show, blocks))


def render_template(name: str, /, **facts: object) -> Piece:
    """Return an HTML template that is filled with values, which are escaped."""
    return Piece(_ENVIRONMENT.get_template(name).render(facts))
