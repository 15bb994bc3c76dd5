"""Output of the commands on a terminal or in a log: progress, tables and lines.

The module needs the Python library `rich`. All commands print through this module.
"""

from __future__ import annotations

import errno
import threading
import time
from collections.abc import Callable, Generator, Iterable
from contextlib import contextmanager, nullcontext
from datetime import timedelta
from typing import Any

from markupsafe import Markup
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

from impact_xval.compliant_baselines.answers import escape_invisible
from impact_xval.compliant_baselines.registry import solver_names
from impact_xval.experiments.config.experiment import REFERENCE
from impact_xval.experiments.presentation.document import Block, Table
from impact_xval.experiments.presentation.words import look_of

#: Message before kernels are compiled.
COMPILING = "compiling the kernels (numerical code) takes half a minute or more, once after each installation"

#: Width, in letters, of output that goes to a file or a pipe and not to a terminal.
_WIDTH = 150
#: Time in s between two messages on standard error while a command works.
_SAY = 20.0
#: Name of standard output in an error message.
_STDOUT = "standard output"


def print_blocks(console: Console, blocks: Iterable[Block]) -> None:
    """Print paragraphs as lines, and tables with their captions between empty lines."""
    last = None
    for block in blocks:
        if isinstance(block, Table) and not block.rows:
            continue
        if last is not None and Table in (type(block), type(last)):
            print_line(console, "")
        if isinstance(block, Table):
            if block.caption:
                print_line(console, block.caption)
            console.print(_rich_table(block))
        else:
            print_line(console, block.striptags() if isinstance(block, Markup) else str(block))
        last = block


def _rich_table(block: Table) -> RichTable:
    """Return a table of the library `rich`, in which names of solvers have the colours that they have in figures.

    The name of the model has no colour, because it is black in figures.
    """
    table, known = RichTable(box=None, pad_edge=False), {*solver_names(on_request=True)} - {REFERENCE}
    for place, title in enumerate(block.header):
        table.add_column(
            Text(escape_invisible(str(title))), justify="left" if place < block.text else "right"
        )
    for row in block.rows:
        cells = [Text(escape_invisible(str(cell))) for cell in row]
        for title, cell in zip(block.header, cells, strict=True):
            if title == "solver" and cell.plain in known:
                cell.stylize(look_of(cell.plain).color)
        table.add_row(*cells)
    return table


@contextmanager
def show_progress(console: Console) -> Generator[Callable[[int, int, str], None]]:
    """Show the progress of a run: a bar on a terminal, otherwise a line for every tenth of the cells.

    The `with` block gets a function that any thread may call. The arguments of the function are the number of cells
    that are done, the number of all cells, and a line to print.
    """
    live = console.is_terminal and not console.is_dumb_terminal
    counts = (BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), TimeRemainingColumn())
    slow = 3600  # in s; it is long, because one chunk of cells may take minutes
    bar = Progress(TextColumn("{task.description}"), *counts, console=console, speed_estimate_period=slow)
    bar.add_task("cells", total=None)
    (task,), said, lock = bar.tasks, -1, threading.Lock()

    def report(done: int, total: int, line: str) -> None:
        nonlocal said
        with lock:
            if total:
                description = "writing" if done == total else "cells"
                bar.update(task.id, completed=done, total=total, description=description)
                if not live and not line and 10 * done // total > said:
                    said = 10 * done // total
                    line = f"{done} of {total} cells after {task.elapsed:.0f} s"
                    if left := task.time_remaining:
                        line += f", {timedelta(seconds=left)} left at this rate"
            if line:
                print_line(console, line)

    with bar if live else nullcontext():
        yield report
        bar.live.transient = True  # the bar disappears, because the summary that is printed next says more


class _Console(Console):
    """A console that raises an `OSError` with the name of standard output if it cannot write."""

    def print(self, *objects: object, **options: Any) -> None:
        """Print objects. Raise `BrokenPipeError` if nobody reads the output, instead of ending the process."""
        try:
            super().print(*objects, **options)
        except SystemExit:
            raise BrokenPipeError(errno.EPIPE, "its reader has ended", _STDOUT) from None
        except OSError as error:
            error.filename = error.filename or _STDOUT
            raise


@contextmanager
def report_waiting(activity: str) -> Generator[None]:
    """Print every `_SAY` seconds on standard error how long the `with` block has taken."""
    start, ended = time.perf_counter(), threading.Event()

    def say() -> None:
        while not ended.wait(_SAY):
            error_line(f"{activity} has taken {time.perf_counter() - start:.0f} s")

    saying = threading.Thread(target=say, daemon=True)
    saying.start()
    try:
        yield
    finally:
        ended.set()
        saying.join()


def make_console() -> Console:
    """Return the console of standard output, with wide lines if the output is not a terminal."""
    console = _Console()
    return console if console.is_terminal else _Console(width=_WIDTH)


def print_line(console: Console, text: str) -> None:
    """Print a line without control characters. Only a terminal wraps the line."""
    console.print(escape_invisible(text), markup=False, highlight=False, soft_wrap=not console.is_terminal)


def error_line(text: str) -> None:
    """Print a line on standard error, after the name of the program."""
    Console(stderr=True).print(
        f"impact-xval: {escape_invisible(text)}", markup=False, highlight=False, soft_wrap=True
    )


def say_waiting(line: str) -> None:
    """Print on standard error what the program waits for. An empty line stands for the compilation of kernels."""
    error_line(line or COMPILING)
