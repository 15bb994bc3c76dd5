"""What a run's summary shows, taken apart."""

from impact_xval.experiments.presentation.pages import Paragraph, Table, blocks_of, render
from impact_xval.experiments.presentation.summary_page import summary_facts


def blocks(summary):
    """Return the headings, paragraphs and tables of ``summary.md``."""
    return list(blocks_of(render("summary.md.j2", **summary_facts(summary))))


def paragraphs(summary):
    """Return its paragraphs, as text."""
    return [block.text for block in blocks(summary) if isinstance(block, Paragraph)]


def tables(summary):
    """Return its tables."""
    return [block for block in blocks(summary) if isinstance(block, Table)]
