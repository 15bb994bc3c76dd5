"""The explorer: a page of this machine whose charts follow its sliders, served by Bokeh.

What moves in a page is a query, as in its address; the server reads it, has the cell solved and sends charts and a
table back. Solvers run in processes apart, the exact ones beside the engines, so that no crash or long run of one
holds the page up; of queries that come while one is worked on only the last one is answered.
"""

from __future__ import annotations

import contextlib
import ipaddress
import json
import logging
import socket
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import Any

from bokeh.application import Application
from bokeh.application.handlers.function import FunctionHandler
from bokeh.document import Document
from bokeh.events import DocumentReady
from bokeh.models import ColumnDataSource, CustomJS
from bokeh.server.server import BaseServer
from bokeh.server.tornado import BokehTornado
from bokeh.server.util import bind_sockets
from tornado.httpserver import HTTPServer
from tornado.ioloop import IOLoop

from impact_xval.compliant_baselines import get_solver, solver_names
from impact_xval.compliant_baselines.registry import is_engine
from impact_xval.experiments.cells.asked import CONTROLS, Asked, asked
from impact_xval.experiments.cells.compared import Compared
from impact_xval.experiments.cells.figures import Charts, compression_lines, drawn, lines_of
from impact_xval.experiments.config.errors import UserError
from impact_xval.experiments.config.experiment import REFERENCE
from impact_xval.experiments.measures.laws import in_order_of_laws
from impact_xval.experiments.presentation.html import render, template
from impact_xval.experiments.presentation.terminal import COMPILING
from impact_xval.experiments.sweep.one import SolversApart, solvers_apart
from impact_xval.experiments.tables.numbers import listed

#: Solved at every move, and on request.
EXACT = tuple(name for name in solver_names() if not is_engine(name))
#: Points of the path of a column, enough to draw its forces.
_POINTS = 1000


class Solvers:
    """Solvers for all pages of a server: one at work for what moves, and one for what is asked for by its button."""

    def __init__(self) -> None:
        self._open = contextlib.ExitStack()
        self._apart: dict[tuple[bool, bool], SolversApart] = {}
        self._threads = {engines: ThreadPoolExecutor(1) for engines in (False, True)}
        self._lock = threading.Lock()

    def start(self) -> None:
        """Start what the page asks for first, before it does."""
        self.submit(False, lambda: self._solvers(engines=False, columns=False))

    def submit(self, engines: bool, function: Callable[[], object]) -> None:
        """Call a function once those before it are done."""
        self._threads[engines].submit(function)

    def solve(self, cell: Asked, names: Sequence[str], say: Callable[[str], None]) -> dict[str, Any]:
        """Solve a cell by solvers of one sort; outcomes by solver, with the paths that are drawn.

        Parameters
        ----------
        cell : Asked
        names : sequence of str
            All of `EXACT`, or engines.
        say : callable
            Given a line about what is waited for; empty once kernels are about to be compiled.
        """
        apart = self._solvers(
            engines=any(name not in EXACT for name in names), columns=cell.arranged is not None
        )
        problem = cell.problem, cell.config
        if cell.arranged is None:
            return apart.solve(*problem, names, get_solver, say)
        solved = {}
        for name in names:  # of the model alone forces are shown
            points = _POINTS if name == REFERENCE else 0
            solved |= apart.solve(*problem, [name], get_solver, say, points)
        return solved

    def _solvers(self, *, engines: bool, columns: bool) -> SolversApart:
        """Return solvers of a sort, started when they are first needed."""
        with self._lock:
            if (engines, columns) not in self._apart:
                names = engine_names() if engines else EXACT
                self._apart[engines, columns] = self._open.enter_context(
                    solvers_apart(names, columns=columns)
                )
            return self._apart[engines, columns]

    def close(self) -> None:
        """End all at once, and whatever they work on."""
        for threads in self._threads.values():
            threads.shutdown(wait=False, cancel_futures=True)
        with contextlib.suppress(KeyboardInterrupt):
            self._open.__exit__(KeyboardInterrupt, KeyboardInterrupt(), None)


def engine_names() -> tuple[str, ...]:
    """Name the engines that the button runs."""
    return tuple(name for name in solver_names() if name not in EXACT)


class Page:
    """One open page.

    Parameters
    ----------
    document : Document
        Filled in.
    solvers : Solvers
    """

    def __init__(self, document: Document, solvers: Solvers) -> None:
        self._document, self._solvers, self._charts = document, solvers, Charts()
        self._cell: Asked | None = None
        self._query, self._scheme, self._outcomes = "", "light", {}
        #: What the page sends, and what it is sent.
        self._asked = ColumnDataSource({"query": [], "scheme": []}, name="asked")
        self._engines = ColumnDataSource({"query": []}, name="engines")
        self._answer = ColumnDataSource(
            {"query": [], "html": [], "legend": [], "charts": [], "said": [], "problem": []}, name="answer"
        )
        self._asked.on_change("data", lambda attr, old, new: self._move())
        self._engines.on_change("data", lambda attr, old, new: self._run_engines())
        for chart in self._charts.all:
            document.add_root(chart)
        self._charts.curves.tags = [self._asked, self._engines, self._answer]
        document.js_on_event(DocumentReady, CustomJS(code="explore()"))
        document.template = template("explore.html.j2")
        document.template_variables["controls"] = CONTROLS
        document.title = "impact-xval explore"

    def _move(self) -> None:
        """Solve what is asked for now."""
        data: Any = self._asked.data
        self._query, scheme = str(data["query"][0]), str(data["scheme"][0])
        if scheme != self._scheme:
            self._scheme = scheme
            self._charts.paint(scheme)
        try:
            cell = asked(self._query)
            cell.problem  # noqa: B018 - which says what is illegal together
        except (UserError, ValueError) as error:
            self._cell = None
            self._send(problem=str(error))
            return
        if cell != self._cell:
            self._outcomes = {}
        self._cell = cell
        self._solvers.submit(False, partial(self._solve, cell, self._query))

    def _run_engines(self) -> None:
        """Have the engines solve what is asked for now, one after the other."""
        cell, query = self._cell, self._query
        if cell is not None:
            for name in engine_names():
                self._solvers.submit(True, partial(self._solve, cell, query, name))
            self._send(said=f"{listed(engine_names())} have been started")

    def _solve(self, cell: Asked, query: str, engine: str = "") -> None:
        """Solve a cell, in a thread, unless the page asks for another one by now."""
        if cell is not self._cell:
            return

        def say(line: str) -> None:
            self._next(partial(self._send, said=line or COMPILING))

        if engine:
            say(f"{engine} is running")
        try:
            outcomes = self._solvers.solve(cell, [engine] if engine else EXACT, say)
        except Exception as error:  # the solvers are gone, or have a bug: the page is to say so
            self._next(partial(self._send, problem=f"{type(error).__name__}: {error}"))
            return
        last = engine in ("", engine_names()[-1])
        self._next(partial(self._show, cell, query, outcomes, last))

    def _show(self, cell: Asked, query: str, outcomes: dict[str, Any], last: bool) -> None:
        """Add outcomes of a cell to the page, unless it asks for another one by now."""
        if cell is not self._cell:
            return
        self._outcomes |= outcomes
        if not set(EXACT) <= set(self._outcomes):
            return
        order = [*EXACT, *(name for name in engine_names() if name in self._outcomes)]
        compared = Compared(cell.problem, {name: self._outcomes[name] for name in order}, cell.arranged)
        lines = lines_of(in_order_of_laws(order), self._scheme)
        legend = lines if cell.arranged is not None else lines | compression_lines(self._scheme)
        self._send(
            query=query,
            html=compared.fragment(lines, paths=True),
            legend=render("lines.html.j2", legend=legend),
            charts=json.dumps(drawn(compared, self._scheme)._asdict()),
            said="" if last else None,
        )

    def _send(self, **words: str | None) -> None:
        """Send words to the page: what is None stays as it is, and so does what is left out, but for what is said."""
        sent: Any = dict(self._answer.data)
        new = {"said": "", "problem": ""} | words
        self._answer.data = sent | {key: [value] for key, value in new.items() if value is not None}

    def _next(self, function: Callable[[], None]) -> None:
        """Call a function once nothing else changes the document; not where its page is closed."""
        with contextlib.suppress(Exception):
            self._document.add_next_tick_callback(function)


@contextlib.contextmanager
def explorer(address: str, port: int) -> Iterator[tuple[str, Callable[[], None]]]:
    """Open the server; it, and all that it started, is gone when the block ends.

    Parameters
    ----------
    address : str
        Of this machine, which it listens at.
    port : int
        0 for any that is free.

    Yields
    ------
    str, callable
        Where the page is; serves until it is interrupted.

    Raises
    ------
    UserError
        If it cannot listen there.
    """
    try:
        sockets, port = bind_sockets(address, port)
    except socket.gaierror as error:
        raise UserError(
            f"--address = {address!r:.60}: {error.strerror}; legal: an address of this machine"
        ) from None
    except (OSError, UnicodeError) as error:
        reason = getattr(error, "strerror", None) or error
        raise UserError(
            f"--address = {address!r:.60}, --port = {port}: {reason}; legal: an address of this machine, and a port "
            "that is free (0: any)"
        ) from None
    solvers = Solvers()
    application = Application(FunctionHandler(partial(_open_page, solvers)))
    where = f"http://{_in_address(_reached(address))}:{port}/"
    origins = [f"{_in_address(name)}:{port}" for name in _names(address)]
    # Of a page that was closed meanwhile each message would have a line.
    logging.getLogger("bokeh").setLevel(logging.ERROR)
    loop = IOLoop.current()
    tornado = BokehTornado({"/": application}, extra_websocket_origins=origins, absolute_url=where)
    http = HTTPServer(tornado)
    http.add_sockets(sockets)
    server = BaseServer(loop, tornado, http)
    server.start()

    def serve() -> None:
        solvers.start()
        loop.start()

    try:
        yield where, serve
    finally:
        solvers.close()
        server.stop(wait=False)


def _open_page(solvers: Solvers, document: Document) -> None:
    Page(document, solvers)


def _names(address: str) -> set[str]:
    """Names by which a page of a server at an address may be reached: no page of another server may speak to it."""
    names = {address, "localhost", "127.0.0.1"}
    with contextlib.suppress(ValueError):
        if ipaddress.ip_address(address).is_unspecified:
            host = socket.gethostname()
            names |= {host, socket.getfqdn()}
            with contextlib.suppress(OSError):
                names |= {str(info[4][0]) for info in socket.getaddrinfo(host, None)}
    return names


def _reached(address: str) -> str:
    """Return an address that a browser on this machine opens."""
    with contextlib.suppress(ValueError):
        if ipaddress.ip_address(address).is_unspecified:
            return "localhost"
    return address


def _in_address(host: str) -> str:
    return f"[{host}]" if ":" in host else host
