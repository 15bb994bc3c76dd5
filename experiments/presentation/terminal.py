"""How the commands print: progress, tables and lines, on a terminal or in a log."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.table import Table as RichTable
from rich.text import Text

from impact_xval.compliant_baselines.contract.visible import visible
from impact_xval.experiments.presentation.pages import Table, blocks_of

#: Columns of a page that is not a terminal.
_WIDTH = 150
#: Seconds of work after which a log has a line, however little was done.
_SAY = 20.0


def show(console: Console, markdown: str) -> None:
    """Print Markdown: a line a paragraph, and tables with their captions between empty lines."""
    last = None
    for block in blocks_of(markdown):
        if last is not None and Table in (type(block), type(last)):
            print_line(console, "")
        if isinstance(block, Table):
            if block.caption:
                print_line(console, block.caption)
            table = RichTable(box=None, pad_edge=False)
            for title, right in zip(block.header, block.numeric, strict=True):
                table.add_column(Text(title), justify="right" if right else "left")
            for row in block.rows:
                table.add_row(*map(Text, row))
            console.print(table)
        else:
            print_line(console, block.text)
        last = block


@contextmanager
def show_progress(console: Console, unit: str = "cells") -> Iterator[Callable[[int, int, str], None]]:
    """Show progress: a bar on a terminal, otherwise a line for every tenth of the work, and after `_SAY` seconds."""
    if console.is_terminal:
        columns = (
            TextColumn(unit),
            BarColumn(),
            MofNCompleteColumn(),
            TimeElapsedColumn(),
            TimeRemainingColumn(),
        )
        with Progress(*columns, console=console) as bar:
            task = bar.add_task(unit, total=None)

            def on_bar(done: int, total: int, line: str) -> None:
                if line:
                    bar.console.print(visible(line), markup=False, highlight=False)
                if total:
                    bar.update(task, completed=done, total=total)

            yield on_bar
        return
    start, said, last = time.perf_counter(), -1, 0.0

    def on_log(done: int, total: int, line: str) -> None:
        nonlocal said, last
        seconds = time.perf_counter() - start
        if line:
            print_line(console, line)
        elif total and (10 * done // total > said or seconds - last > _SAY):
            said, last = 10 * done // total, seconds
            print_line(console, f"{done} of {total} {unit} after {seconds:.0f} s")

    yield on_log


def make_console() -> Console:
    """Return the console of standard output; a log gets wide lines."""
    console = Console()
    return console if console.is_terminal else Console(width=_WIDTH)


def print_line(console: Console, text: str) -> None:
    """Print a line as it is, but for what a terminal would obey; in a log it is never broken."""
    console.print(visible(text), markup=False, highlight=False, soft_wrap=not console.is_terminal)


def error_line(text: str) -> None:
    """Print a line on standard error."""
    Console(stderr=True).print(f"impact-xval: {visible(text)}", markup=False, highlight=False, soft_wrap=True)
