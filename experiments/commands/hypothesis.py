"""What `impact-xval hypothesis` does, and what it prints."""

from __future__ import annotations

import time
from pathlib import Path

from rich.table import Table as RichTable
from rich.text import Text

from impact_xval.experiments.hypothesis.config import load
from impact_xval.experiments.hypothesis.page import summary, write_all
from impact_xval.experiments.hypothesis.run import Results, run_hypothesis
from impact_xval.experiments.presentation.pages import phrase
from impact_xval.experiments.presentation.terminal import make_console, print_line, show_progress
from impact_xval.experiments.tables.folders import new_folder

DEFAULT_FOLDER = Path("runs") / "hypothesis"

#: The template of what is said of verdicts.
WORDS = "hypothesis_words.md.j2"


def run_command(path: Path | None, out: Path | None, workers: int | None) -> None:
    """Test the hypothesis and write everything a test writes."""
    start = time.perf_counter()
    config = load(path)
    root = out if out is not None else DEFAULT_FOLDER
    new_folder(root)
    console = make_console()
    with show_progress(console) as progress:
        results = run_hypothesis(config, workers=workers, progress=progress)
    page = write_all(results, root, time.perf_counter() - start)
    print_line(console, "")
    console.print(_verdicts(results))
    print_line(console, "")
    print_line(console, phrase("table.md.j2", "laws_with_laws"))
    print_line(console, phrase(WORDS, "abstract", summary(results)))
    print_line(console, f"{time.perf_counter() - start:.0f} s; the page is {page}")


def _verdicts(results: Results) -> RichTable:
    """One row a limit and solver, grouped by law."""
    shown = RichTable("limit", "law", "solver", "verdict", box=None, pad_edge=False)
    for found in results.verdicts:
        verdict = phrase(WORDS, "verdict", found)
        shown.add_row(*map(Text, (found.case.key, found.law, found.solver, verdict)))
    return shown
