"""``impact-xval hypothesis``: the limiting case put to the test."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from impact_xval.experiments.commands.options import Workers, config_file, folder_to_write

if TYPE_CHECKING:
    from rich.table import Table

    from impact_xval.experiments.hypothesis.run import Results

#: The template of what is printed of verdicts.
WORDS = "hypothesis_words.md.j2"


def hypothesis(
    config: Annotated[Path | None, config_file("What to test; without it, the built-in design.")] = None,
    out: Annotated[Path | None, folder_to_write("by default runs/hypothesis")] = None,
    workers: Workers = None,
) -> None:
    """Test the supplement's hypothesis that an infinitely stiff pair acts as one body.

    Writes hypothesis.md (a page of what was found), its tables and its figures.
    """
    from impact_xval.experiments.hypothesis.config import load
    from impact_xval.experiments.hypothesis.page import summary, write_all
    from impact_xval.experiments.hypothesis.run import run_hypothesis
    from impact_xval.experiments.presentation.pages import phrase
    from impact_xval.experiments.presentation.terminal import make_console, print_line, show_progress
    from impact_xval.experiments.tables.folder import new_folder

    start = time.perf_counter()
    design = load(config)
    root = out if out is not None else Path("runs") / "hypothesis"
    new_folder(root)
    console = make_console()
    with show_progress(console) as progress:
        results = run_hypothesis(design, workers=workers, progress=progress)
    page = write_all(results, root, time.perf_counter() - start)
    print_line(console, "")
    console.print(verdict_table(results))
    print_line(console, "")
    print_line(console, phrase("table.md.j2", "laws_with_laws"))
    print_line(console, phrase(WORDS, "abstract", summary(results)))
    print_line(console, f"{time.perf_counter() - start:.0f} s; the page is {page}")


def verdict_table(results: Results) -> Table:
    """One row a limit and solver, grouped by law."""
    from rich.table import Table
    from rich.text import Text

    from impact_xval.experiments.presentation.pages import phrase

    shown = Table("limit", "law", "solver", "verdict", box=None, pad_edge=False)
    for found in results.verdicts:
        verdict = phrase(WORDS, "verdict", found)
        shown.add_row(*map(Text, (found.case.key, found.law, found.solver, verdict)))
    return shown
