"""How the commands print: progress, tables and lines, on a terminal or in a log."""

from __future__ import annotations

import errno
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import timedelta
from typing import Any

from rich.console import Console, Group
from rich.live import Live
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn
from rich.table import Table as RichTable
from rich.text import Text

from impact_xval.compliant_baselines.answers import visible
from impact_xval.experiments.presentation.looks import BLACK, look
from impact_xval.experiments.presentation.pages import Table, blocks_of, phrase, render
from impact_xval.experiments.tables.numbers import number

#: What is said before kernels are compiled.
COMPILING = "compiling the kernels, once for each installation: half a minute or more"

#: Gives law, solver, number of cells and median D of solvers.
MedianRows = Callable[[], list[tuple[str, str, int, float]]]

#: Columns of a page that is not a terminal.
_WIDTH = 150
#: Seconds of work after which a log has a line, however little was done, and between two looks at whether it has.
_SAY, _LOOK = 20.0, 1.0
#: What an error of a console calls it.
_STDOUT = "standard output"
#: Medians stand for at least so many times what it took to find them, but for the line of a tenth.
_STAND = 100


def show(console: Console, markdown: str) -> None:
    """Print Markdown: a line a paragraph, and tables with their captions between empty lines."""
    for each in _renderables(markdown):
        if isinstance(each, RichTable):
            console.print(each)
        else:
            print_line(console, each)


def _renderables(markdown: str) -> Iterator[Any]:
    """Turn Markdown into tables, and the lines between them as text."""
    last = None
    for block in blocks_of(markdown):
        if last is not None and Table in (type(block), type(last)):
            yield ""
        if isinstance(block, Table):
            if block.caption:
                yield block.caption
            table = RichTable(box=None, pad_edge=False)
            for title, right in zip(block.header, block.numeric, strict=True):
                table.add_column(Text(title), justify="right" if right else "left")
            for row in block.rows:
                table.add_row(*(_cell(*cell) for cell in zip(block.header, row, strict=True)))
            yield table
        else:
            yield block.text
        last = block


def _cell(title: str, text: str) -> Text:
    """Write a cell of a table; a solver has the colour that it has in figures, the model, black there, none."""
    color = look(text).color if title == "solver" else BLACK
    return Text(text, style="" if color == BLACK else color)


@contextmanager
def show_progress(
    console: Console, unit: str = "cells", medians: MedianRows = lambda: []
) -> Iterator[Callable[[int, int, str], None]]:
    """Show progress: a bar and the medians so far on a terminal, otherwise a line for every tenth and after `_SAY` s.

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
        left = phrase("progress.md.j2", "to_come", pace.done, pace.total, pace.left)
        bar.update(task, left=left, elapsed=str(elapsed))
        rows = [(*names, number(median)) for *names, median in medians()]
        page = _renderables(render("medians.md.j2", rows=rows))
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
    start, said, pace = time.perf_counter(), -1, _Pace()
    last, pause, lock, ended = start, _SAY, threading.Lock(), threading.Event()

    broken: list[OSError] = []

    def on_log(done: int, total: int, line: str) -> None:
        nonlocal said, last, pause
        if broken:
            raise broken[0]
        with lock:
            now = time.perf_counter()
            if total:
                pace.report(done, total)
            if line:
                last = now
                print_line(console, line)
            elif total and (10 * done // total > said or (done < total and now - last > pause)):
                said, last = 10 * done // total, now
                facts = {"unit": unit, "seconds": now - start, "left": pace.left, "rows": medians()}
                pause = max(_SAY, _STAND * (time.perf_counter() - now))
                print_line(console, phrase("progress.md.j2", "tenth", done, total, **facts))
            elif now - last > pause:
                last = now
                print_line(console, phrase("progress.md.j2", "before_or_after", total, unit, now - start))

    def beat() -> None:
        try:
            while not ended.wait(_LOOK):
                on_log(pace.done, pace.total, "")
        except OSError as error:  # which ends the work when it next says something
            broken.append(error)

    beating = threading.Thread(target=beat, daemon=True)
    beating.start()
    try:
        yield on_log
    finally:
        ended.set()
        beating.join()


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
