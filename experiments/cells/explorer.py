"""Server of the explorer, a page in a browser whose chart and table follow its sliders.

The page shows one collision or chain by every solver, and only this machine can open it. Exact solvers and engines run
in separate worker processes, so that an engine that crashes or runs for long does not delay the sliders. The command
``explore`` calls `explore`.
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
from impact_xval.experiments.presentation.words import describe_scenario
from impact_xval.experiments.sweep.one import SolversApart, open_solvers_apart
from impact_xval.experiments.sweep.process import ClosedError
from impact_xval.model.outcome import Outcome

#: Coordinates of the points of one line in a chart, under the keys ``x`` and ``y``.
ChartSource = dict[str, Sequence[float]]

#: Solvers that run when the button is pressed (`ENGINES`), and solvers that follow the sliders (`EXACT`).
ENGINES = tuple(filter(is_engine, solver_names()))
EXACT = tuple(name for name in solver_names() if name not in ENGINES)


class ExplorerCells:
    """Solutions of the collisions that pages in a browser request from the explorer.

    Worker processes are started when they are first needed. They are ended when the stack `ending` is closed.
    """

    def __init__(self, ending: contextlib.ExitStack) -> None:
        self._ending = ending
        self._processes: dict[bool, SolversApart] = {}
        self._locks = {engines: threading.Lock() for engines in (False, True)}
        self._starting, self.closed = threading.Lock(), False
        # Outcomes of engines are kept, because the page requests the whole table again whenever an engine has finished.
        self._solve_cached = lru_cache(64)(self._solve)

    def answer(self, query: str) -> dict[str, object]:
        """Return what the page shows for the parameters in its address.

        The parameters are the options of the command ``solve``, and ``solver`` for every engine that shall run. The
        result has ``results``, the tables as HTML, and ``data``, the coordinates of all lines of the charts. If a
        parameter is illegal, the result has only ``problem``, one line that says what is legal.
        """
        given = parse_qsl(query, keep_blank_values=True)
        typed = (("cell_timeout", "60"), *((key, value) for key, value in given if key != "solver"))
        try:
            collision, chain, config = parse_collision(dict(typed))
        except ValueError as error:
            return {"problem": str(error)}
        outcomes = self._solve(typed, EXACT)
        for key, name in given:
            if key == "solver" and name in ENGINES:
                outcomes |= self._solve_cached(typed, (name,))
        versions = {
            name: version for apart in self._processes.values() for name, version in apart.versions.items()
        }
        compared = SolverComparison(collision, outcomes, chain, versions, describe_scenario(config))
        blocks = compared.blocks()
        if compared.is_chain:  # the table of a chain has only the number of states
            rows = [(name, " ".join(outcome.states)) for name, outcome in outcomes.items() if outcome.states]
            blocks.append(Table(["solver", "contacts that act"], rows, text=2))
        return {"results": render_blocks(blocks), "data": _chart_sources(compared)}

    def _solve(self, typed: tuple[tuple[str, str], ...], names: tuple[str, ...]) -> dict[str, Outcome]:
        """Solve a collision by engines or by exact solvers, and return the outcomes by name.

        At any time at most one collision is solved by engines, and at most one by exact solvers. A later request waits
        until the earlier request is answered.
        """
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
        """Start no worker processes from now on. The stack `ending` ends the processes that are running."""
        with self._starting:
            self.closed = True


def _chart_sources(compared: SolverComparison) -> dict[str, ChartSource]:
    """Return the coordinates of all lines of the charts by name; a solver with nothing to draw has empty lines."""
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
    """Return the page as HTML. The script in it requests the results of a collision from this server."""
    solvers = sort_by_law([*EXACT, *ENGINES])
    charts = {"curves": curves_chart(solvers), "velocities": velocities_chart(solvers)}
    items = [json_item(chart, ID(name)) for name, chart in charts.items()]
    form = render_template("explore.html.j2", charts=items, engines=ENGINES, bokeh=bokeh_script())
    return render_page("One collision, as it moves", [form])


class _Server(ThreadingHTTPServer):
    """The server of the page, one thread per request."""

    #: With False the server waits for the threads of its requests before it ends. Otherwise a thread may still be
    #: importing a module when the interpreter ends. Then the process aborts ("exception not rethrown").
    daemon_threads = False
    cells: ExplorerCells

    def handle_error(
        self, request: socket.socket | tuple[bytes, socket.socket], client_address: object
    ) -> None:
        """Ignore errors that come from a page that was closed, or from a solution that Ctrl-C ended."""
        if not (self.cells.closed or isinstance(sys.exc_info()[1], OSError | ClosedError | CancelledError)):
            super().handle_error(request, client_address)


class _Request(BaseHTTPRequestHandler):
    """One request of a browser, for the page or for the results of a collision."""

    #: Seconds after which a connection without a request is closed. Browsers open connections before they need them.
    timeout = 5

    def do_GET(self) -> None:
        """Answer with the page, or with the results of a collision."""
        path, _, query = self.path.partition("?")
        kind, text = "text/plain", ""  # answer to a request for anything else, such as the icon of the page
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
        """Print nothing: the terminal shows the address of the page only."""


def explore(port: int, announce: Callable[[str], object]) -> None:
    """Serve the page to this machine until Ctrl-C, and then end all worker processes and threads.

    Parameters
    ----------
    port : int
        Port on this machine; 0 stands for any free port.
    announce : callable
        Called with the address of the page when the server has started.
    """
    with contextlib.ExitStack() as ending:
        cells = ExplorerCells(ending)
        try:
            server = ending.enter_context(_Server(("127.0.0.1", port), _Request))
        except OSError as error:
            raise UserError(
                f"--port = {port}: {error.strerror}; legal: a free port, or 0 for any free port"
            ) from None
        server.cells = cells
        # The server runs in a second thread. Ctrl-C interrupts the main thread. It must not interrupt a thread that is
        # just starting the thread of a request.
        threading.Thread(target=server.serve_forever, daemon=True).start()
        try:
            announce(f"http://127.0.0.1:{server.server_port}/")
            with contextlib.suppress(KeyboardInterrupt):
                # The sleeps are short. A long sleep was not ended by a signal that came while the thread of a request
                # was started.
                while True:
                    time.sleep(0.2)
        finally:
            cells.close()
            server.shutdown()
