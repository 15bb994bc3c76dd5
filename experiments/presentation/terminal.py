"""How the commands print: progress, tables and lines, on a terminal or in a log."""

from __future__ import annotations

import errno
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from datetime import timedelta
from typing import Any

from markupsafe import Markup
from rich.console import Console, Group
from rich.live import Live
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn
from rich.table import Table as RichTable
from rich.text import Text

from impact_xval.compliant_baselines.answers import visible
from impact_xval.experiments.presentation.document import Block, Figure, Section, Table
from impact_xval.experiments.presentation.looks import BLACK, FIXED
from impact_xval.experiments.tables.numbers import number

#: What is said before kernels are compiled.
COMPILING = "compiling the kernels, once for each installation: half a minute or more"

MEDIANS = ("law", "solver", "cells", "median D")

#: Gives law, solver, number of cells and median D of solvers.
MedianRows = Callable[[], list[tuple[str, str, int, float]]]

#: Columns of a page that is not a terminal.
_WIDTH = 150
#: Seconds of work after which standard error has a line.
_SAY = 20.0
#: What an error of a console calls it.
_STDOUT = "standard output"
#: Above a bar medians stand for at least so many times what it took to find them.
_STAND = 100


def show(console: Console, blocks: Iterable[Block]) -> None:
    """Print a document: a line a paragraph, and tables with their captions between empty lines."""
    for each in _renderables(blocks):
        if isinstance(each, RichTable):
            console.print(each)
        else:
            print_line(console, each)


def _renderables(blocks: Iterable[Block]) -> Iterator[Any]:
    """Turn blocks into tables, and the lines between them as text; pictures are for pages."""
    last = None
    for block in blocks:
        if isinstance(block, Figure | Markup) or (isinstance(block, Table) and not block.rows):
            continue
        if last is not None and Table in (type(block), type(last)):
            yield ""
        if isinstance(block, Section):
            yield block.title
            yield from _renderables(block.blocks)
        elif isinstance(block, Table):
            if block.caption:
                yield str(block.caption)
            yield _table(block)
        else:
            yield str(block)
        last = block


def _table(block: Table) -> RichTable:
    """Lay out a table; a solver has the colour that it has in figures, the model, black there, none."""
    table = RichTable(box=None, pad_edge=False)
    for place, title in enumerate(block.header):
        table.add_column(Text(visible(str(title))), justify="left" if place < block.text else "right")
    for row in block.rows:
        colors = [
            FIXED.get(str(cell), (BLACK,))[0] if title == "solver" else BLACK
            for title, cell in zip(block.header, row, strict=True)
        ]
        table.add_row(
            *(
                Text(visible(str(cell)), "" if color == BLACK else color)
                for color, cell in zip(colors, row, strict=True)
            )
        )
    return table


@contextmanager
def show_progress(
    console: Console, unit: str = "cells", medians: MedianRows = lambda: []
) -> Iterator[Callable[[int, int, str], None]]:
    """Show progress: a bar and the medians so far on a terminal, otherwise a line for every tenth.

    Parameters
    ----------
    console : Console
    unit : str
        What is counted.
    medians : callable
        Gives law, solver, number of cells and median D of every solver that has any.

    Yields
    ------
    callable
        To be given how many are done, of how many, and a line worth saying; from any thread.
    """
    with (_bar if console.is_terminal and not console.is_dumb_terminal else _log)(
        console, unit, medians
    ) as progress:
        yield progress


class _Pace:
    """How fast work goes, from how much was done when: what comes before the first report is not counted."""

    def __init__(self) -> None:
        self.done = self.total = self._before = 0
        self._since: float | None = None
        self._latest = 0.0

    def report(self, done: int, total: int) -> None:
        """Take how many are done, of how many."""
        now = time.perf_counter()
        if self._since is None:
            self._since, self._before = now, done
        if done > self.done:
            self._latest = now
        self.done, self.total = done, total

    @property
    def left(self) -> timedelta | None:
        """Time left at the rate of all so far; None where nothing has been done yet, or that has passed already."""
        if self._since is None or self.done <= self._before:
            return None
        each = (self._latest - self._since) / (self.done - self._before)
        seconds = (self.total - self.done) * each - (time.perf_counter() - self._latest)
        return timedelta(seconds=round(seconds)) if seconds >= 1 else None


@contextmanager
def _bar(console: Console, unit: str, medians: MedianRows) -> Iterator[Callable[[int, int, str], None]]:
    bar = Progress(
        TextColumn(unit),
        BarColumn(),
        MofNCompleteColumn(),
        # rich's own stops with the last cell
        TextColumn("{task.fields[elapsed]}", style="progress.elapsed"),
        TextColumn("{task.fields[left]}"),
        console=console,
    )
    task, pace, start = bar.add_task(unit, total=None, left="", elapsed=""), _Pace(), time.perf_counter()
    medians = _seldom(medians)

    def shown() -> Group:
        elapsed = timedelta(seconds=int(time.perf_counter() - start))
        left = "writing" if 0 < pace.total == pace.done else f"{pace.left} left" if pace.left else ""
        bar.update(task, left=left, elapsed=str(elapsed))
        rows = [(*names, number(median)) for *names, median in medians()]
        page = _renderables([Table(MEDIANS, rows, "Divergence from the model so far", text=2)])
        return Group(*(Text(each) if isinstance(each, str) else each for each in page), bar)

    with Live(get_renderable=shown, console=console) as live:

        def on_bar(done: int, total: int, line: str) -> None:
            if line:
                live.console.print(visible(line), markup=False, highlight=False)
            if total:
                pace.report(done, total)
                bar.update(task, completed=done, total=total)

        yield on_bar
        live.transient = True  # what follows says it better


def _seldom(medians: MedianRows) -> MedianRows:
    """Have medians found for a hundredth of the time at most: those of millions of cells take a while."""
    rows, until = [], 0.0

    def last() -> list[tuple[str, str, int, float]]:
        nonlocal rows, until
        start = time.perf_counter()
        if start >= until:
            rows = medians()
            now = time.perf_counter()
            until = now + _STAND * (now - start)
        return rows

    return last


@contextmanager
def _log(console: Console, unit: str, medians: MedianRows) -> Iterator[Callable[[int, int, str], None]]:
    start, said, pace, lock = time.perf_counter(), -1, _Pace(), threading.Lock()

    def on_log(done: int, total: int, line: str) -> None:
        nonlocal said
        with lock:
            if line:
                print_line(console, line)
            elif total:
                pace.report(done, total)
                if 10 * done // total > said:
                    said, seconds = 10 * done // total, time.perf_counter() - start
                    print_line(console, _progress(done, total, unit, seconds, pace.left, medians()))

    yield on_log


def _progress(done: int, total: int, unit: str, seconds: float, left: timedelta | None, rows: list) -> str:
    """Write the line of a log: how much is done, and the medians so far."""
    line = f"{done} of {total} {unit} after {seconds:.0f} s"
    if left is not None:
        line += f", {left} left at this rate"
    medians = ", ".join(f"{solver} {number(median)} (of {n})" for _, solver, n, median in rows)
    return f"{line}; median D so far: {medians}" if medians else line


class _Console(Console):
    """A console that cannot be written to as any other file: an `OSError` that names it."""

    def print(self, *objects: Any, **options: Any) -> None:
        """Print; rich ends the process where nobody reads any more."""
        try:
            super().print(*objects, **options)
        except SystemExit:
            raise BrokenPipeError(errno.EPIPE, "nobody reads it any more", _STDOUT) from None
        except OSError as error:
            error.filename = error.filename or _STDOUT
            raise


@contextmanager
def at_work(what: str) -> Iterator[None]:
    """Say every `_SAY` s on standard error what is waited for."""
    start, ended = time.perf_counter(), threading.Event()

    def say() -> None:
        while not ended.wait(_SAY):
            error_line(f"{what} has taken {time.perf_counter() - start:.0f} s")

    saying = threading.Thread(target=say, daemon=True)
    saying.start()
    try:
        yield
    finally:
        ended.set()
        saying.join()


def make_console() -> Console:
    """Return the console of standard output; a log gets wide lines."""
    console = _Console()
    return console if console.is_terminal else _Console(width=_WIDTH)


def print_line(console: Console, text: str) -> None:
    """Print a line as it is, but for what a terminal would obey; in a log it is never broken."""
    console.print(visible(text), markup=False, highlight=False, soft_wrap=not console.is_terminal)


def error_line(text: str) -> None:
    """Print a line on standard error."""
    Console(stderr=True).print(f"impact-xval: {visible(text)}", markup=False, highlight=False, soft_wrap=True)


def say_waiting(line: str) -> None:
    """Say what is waited for, on standard error; kernels that are compiled have the empty line."""
    error_line(line or COMPILING)
