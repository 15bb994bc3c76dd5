"""``impact-xval hypothesis``: the limiting case put to the test."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Annotated

from impact_xval.experiments.commands.options import Workers, config_file, folder_to_write


def hypothesis(
    config: Annotated[Path | None, config_file("What to test; without it, the built-in design.")] = None,
    out: Annotated[Path | None, folder_to_write("by default runs/hypothesis")] = None,
    workers: Workers = None,
) -> None:
    """Test the supplement's hypothesis that an infinitely stiff pair acts as one body.

    Writes hypothesis.md (a page of what was found), its tables and its figures.
    """
    from rich.table import Table
    from rich.text import Text

    from impact_xval.experiments.hypothesis.cases import CASES
    from impact_xval.experiments.hypothesis.config import load
    from impact_xval.experiments.hypothesis.folder import write_all
    from impact_xval.experiments.hypothesis.prose import abstract
    from impact_xval.experiments.hypothesis.run import run_hypothesis
    from impact_xval.experiments.hypothesis.tables import verdict_text
    from impact_xval.experiments.measures.laws import LAWS_WITH_LAWS
    from impact_xval.experiments.presentation.terminal import make_console, print_line, show_progress
    from impact_xval.experiments.tables.folders import new_folder

    start = time.perf_counter()
    design = load(config)
    root = out if out is not None else Path("runs") / "hypothesis"
    new_folder(root)
    console = make_console()
    with show_progress(console) as progress:
        results = run_hypothesis(design, workers=workers, progress=progress)
    page = write_all(results, root, time.perf_counter() - start)
    verdicts = Table("limit", "law", "solver", "verdict", box=None, pad_edge=False)
    for case in CASES:
        for name in results.solvers:
            found = results.verdict(name, case.key)
            if found:
                verdicts.add_row(*map(Text, (case.key, found.law, name, verdict_text(found))))
    print_line(console, "")
    console.print(verdicts)
    print_line(console, "")
    for text in (LAWS_WITH_LAWS, abstract(results)):
        print_line(console, text)
    print_line(console, f"{time.perf_counter() - start:.0f} s; the page is {page}")
