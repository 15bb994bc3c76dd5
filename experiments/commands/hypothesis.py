"""What `impact-xval hypothesis` does, and what it prints."""

from __future__ import annotations

import time
from pathlib import Path

from rich.table import Table as RichTable
from rich.text import Text

from impact_xval.experiments.hypothesis.cases import CASES
from impact_xval.experiments.hypothesis.config import load
from impact_xval.experiments.hypothesis.folder import write_all
from impact_xval.experiments.hypothesis.prose import abstract
from impact_xval.experiments.hypothesis.run import Results, run_hypothesis
from impact_xval.experiments.hypothesis.tables import verdict_text
from impact_xval.experiments.measures.laws import LAWS_WITH_LAWS
from impact_xval.experiments.presentation.terminal import make_console, print_line, show_progress
from impact_xval.experiments.tables.folders import new_folder

DEFAULT_FOLDER = Path("runs") / "hypothesis"


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
    for text in (LAWS_WITH_LAWS, abstract(results)):
        print_line(console, text)
    print_line(console, f"{time.perf_counter() - start:.0f} s; the page is {page}")


def _verdicts(results: Results) -> RichTable:
    """One row a limit and solver, grouped by law."""
    shown = RichTable(box=None, pad_edge=False)
    for title in ("limit", "law", "solver", "verdict"):
        shown.add_column(title)
    for case in CASES:
        for name in results.solvers:
            found = results.verdict(name, case.key)
            if found:
                shown.add_row(*map(Text, (case.key, found.law, name, verdict_text(found))))
    return shown
