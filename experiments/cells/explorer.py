"""The explorer: a page, served to this machine alone, whose chart and table follow its sliders.

Exact solvers and engines run in separate processes: no crash or long run of an engine delays a slider.
"""

from __future__ import annotations

import contextlib
import json
import socket
import sys
import threading
import time
from collections.abc import Callable, Sequence
from concurrent.futures import CancelledError
from functools import cache, lru_cache
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from urllib.parse import parse_qsl

from bokeh.core.types import ID
from bokeh.embed import json_item

from impact_xval.compliant_baselines import get_solver, solver_names
from impact_xval.compliant_baselines.registry import is_engine, sort_by_law
from impact_xval.experiments.cells.compared import SolverComparison
from impact_xval.experiments.config.collision_options import parse_collision
from impact_xval.experiments.config.errors import UserError
from impact_xval.experiments.presentation.document import Table
from impact_xval.experiments.presentation.html import render_blocks, render_page, render_template
from impact_xval.experiments.presentation.page.charts import bokeh_script, curves_chart, velocities_chart
from impact_xval.experiments.presentation.page.opened import impulse_curve
from impact_xval.experiments.sweep.one import SolversApart, open_solvers_apart
from impact_xval.experiments.sweep.process import ClosedError
from impact_xval.model.outcome import Outcome

#: Points of a line of a chart, by coordinate: ``x`` and ``y``.
ChartSource = dict[str, Sequence[float]]

#: Solvers that run by the button, and solvers that follow the sliders.
ENGINES = tuple(filter(is_engine, solver_names()))
EXACT = tuple(name for name in solver_names() if name not in ENGINES)


class ExplorerCells:
    """Solves the cells that pages ask for; processes begin when they are first needed, and `ending` ends them."""

    def __init__(self, ending: contextlib.ExitStack) -> None:
        self._ending = ending
        self._processes: dict[bool, SolversApart] = {}
        self._locks = {engines: threading.Lock() for engines in (False, True)}
        self._starting, self.closed = threading.Lock(), False
        # The table is asked for again as each of the engines ends.
        self._solve_cached = lru_cache(64)(self._solve)

    def answer(self, query: str) -> dict[str, object]:
        """Return what a page shows of an address, options of `solve` and ``solver`` for every engine.

        That is ``problem``, one line; or ``results``, HTML, and ``data`` of the charts.
        """
        given = parse_qsl(query, keep_blank_values=True)
        typed = (("cell_timeout", "60"), *((key, value) for key, value in given if key != "solver"))
        try:
            collision, chain, _ = parse_collision(dict(typed))
        except ValueError as error:
            return {"problem": str(error)}
        outcomes = self._solve(typed, EXACT)
        for key, name in given:
            if key == "solver" and name in ENGINES:
                outcomes |= self._solve_cached(typed, (name,))
        versions = {
            name: version for apart in self._processes.values() for name, version in apart.versions.items()
        }
        compared = SolverComparison(collision, outcomes, chain, versions)
        blocks = compared.blocks()
        if compared.is_chain:  # its table counts states
            rows = [(name, " ".join(outcome.states)) for name, outcome in outcomes.items() if outcome.states]
            blocks.append(Table(["solver", "contacts that act"], rows, text=2))
        return {"results": render_blocks(blocks), "data": _chart_sources(compared)}

    def _solve(self, typed: tuple[tuple[str, str], ...], names: tuple[str, ...]) -> dict[str, Outcome]:
        """Solve a cell by engines or by exact solvers, after the earlier cells of the same sort."""
        collision, chain, config = parse_collision(dict(typed))
        engines, points = names != EXACT, None if chain is None else 0
        with self._locks[engines]:
            with self._starting:
                if self.closed:
                    raise ClosedError
                if engines not in self._processes:
                    began = open_solvers_apart(ENGINES if engines else EXACT)
                    self._processes[engines] = self._ending.enter_context(began)
            return self._processes[engines].solve(
                collision, config, names, get_solver, lambda _: None, points
            )

    def close(self) -> None:
        """Start no more processes; the running ones end with the block."""
        with self._starting:
            self.closed = True


def _chart_sources(compared: SolverComparison) -> dict[str, ChartSource]:
    """Return the data of the charts' sources; the sources of a solver with nothing to draw are empty."""
    collision, kinds = compared.problem, ("balls", "curve", "end")
    data: dict[str, ChartSource] = {
        f"{kind} {name}": {"x": [], "y": []} for name in (*EXACT, *ENGINES) for kind in kinds
    }
    if compared.is_chain:
        for name, velocities in compared.scaled_velocities.items():
            data[f"balls {name}"] = {"x": [*range(1, 1 + len(velocities))], "y": velocities}
        return data
    reach, mass = 0.0, collision.mass_ratio
    for name, outcome in compared.outcomes.items():
        if (curve := impulse_curve(collision, outcome)) is not None:
            data[f"curve {name}"] = {"x": curve[0], "y": curve[1]}
            data[f"end {name}"] = {"x": curve[0][-1:], "y": curve[1][-1:]}
            reach = max(reach, *curve[0], *curve[1])
    data["line l1"] = {"x": [mass / (1 + mass), (reach + mass) / (1 + mass)], "y": [0, reach]}
    data["line l2"] = {"x": [0, reach], "y": [0, reach]}
    return data


@cache
def explorer_page() -> str:
    """Return the page as HTML; its script then asks for cells."""
    solvers = sort_by_law([*EXACT, *ENGINES])
    charts = {"curves": curves_chart(solvers), "velocities": velocities_chart(solvers)}
    items = [json_item(chart, ID(name)) for name, chart in charts.items()]
    form = render_template("explore.html.j2", charts=items, engines=ENGINES, bokeh=bokeh_script())
    return render_page("One collision, as it moves", [form])


class _Server(ThreadingHTTPServer):
    """The server of the page, one thread per request."""

    #: Threads are joined: one that imported while the interpreter ended aborted it ("exception not rethrown").
    daemon_threads = False
    cells: ExplorerCells

    def handle_error(
        self, request: socket.socket | tuple[bytes, socket.socket], client_address: object
    ) -> None:
        """Ignore the errors of a closed page and of a cell that Ctrl-C ended."""
        if not (self.cells.closed or isinstance(sys.exc_info()[1], OSError | ClosedError | CancelledError)):
            super().handle_error(request, client_address)


class _Request(BaseHTTPRequestHandler):
    """One request of a browser: for the page, or for a cell."""

    #: Seconds until a silent connection is closed: browsers open connections in advance.
    timeout = 5

    def do_GET(self) -> None:
        """Answer with the page, or with the results of a cell."""
        path, _, query = self.path.partition("?")
        kind, text = "text/plain", ""  # such as the icon, which browsers ask for
        if path == "/":
            kind, text = "text/html", explorer_page()
        elif path == "/solved":
            assert isinstance(self.server, _Server)
            kind, text = "application/json", json.dumps(self.server.cells.answer(query))
        self.send_response(200)
        self.send_header("Content-Type", f"{kind}; charset=utf-8")
        self.end_headers()
        self.wfile.write(text.encode())

    def log_message(self, format: str, *args: object) -> None:
        """Write nothing: the terminal is for the address alone."""


def explore(port: int, announce: Callable[[str], object]) -> None:
    """Serve the page to this machine alone until interrupted, and then end all processes and threads.

    `announce` is called with the address of the page. Port 0 stands for any free port.
    """
    with contextlib.ExitStack() as ending:
        cells = ExplorerCells(ending)
        try:
            server = ending.enter_context(_Server(("127.0.0.1", port), _Request))
        except OSError as error:
            raise UserError(f"--port = {port}: {error.strerror}; legal: a free one (0: any)") from None
        server.cells = cells
        # Not in the main thread, which receives Ctrl-C: it could come while the thread of a request is started.
        threading.Thread(target=server.serve_forever, daemon=True).start()
        try:
            announce(f"http://127.0.0.1:{server.server_port}/")
            with contextlib.suppress(KeyboardInterrupt):
                while (
                    True
                ):  # in short pieces: a signal that came as a request's thread began was seen not to wake it
                    time.sleep(0.2)
        finally:
            cells.close()
            server.shutdown()
