"""Worker processes in which solvers run, so that a solver that crashes or hangs cannot end the run.

`Worker` starts a process as ``python -c`` and exchanges pickles with it over a pair of sockets; the process runs
`serve`. `in_halves` and `retry_once` repeat calls whose process died. `pool` and `chunk` use this module.

A worker process is not a `multiprocessing.Process`, for two reasons. A Dask worker is a daemon, which may not start
such a process. And such a process would import the caller's main script again.

Numerical libraries have one thread in each worker process. Instead, several processes solve cells at the same time.
Also, no result may depend on the number of threads of a library.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import pickle
import signal
import subprocess
import sys
import threading
import traceback
from collections.abc import Callable
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from pathlib import Path
from typing import TYPE_CHECKING, Generic, TypeVar, TypeVarTuple

if TYPE_CHECKING:  # the package `model` imports NumPy, which this module starts without
    from impact_xval.model.status import Status

_Piece = TypeVar("_Piece")
_Answer = TypeVar("_Answer")
_Context = TypeVar("_Context")
_Arguments = TypeVarTuple("_Arguments")

_THREADS = (
    "NUMBA_NUM_THREADS",
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "MKL_NUM_THREADS",
    "ARROW_NUM_THREADS",
)
#: Environment variable that keeps MuJoCo from looking for a window system. The search for a window system takes a third
#: of the time to import MuJoCo. It also starts a process, which prints a traceback if the importing process is ended.
NO_WINDOW = {"MUJOCO_GL": "disable"}
#: File of the package `impact_xval` that runs here.
_PROJECT = Path(__file__).parents[2] / "__init__.py"
#: Code by which the interpreter of another environment imports the package `impact_xval` that runs here. The folder
#: around the package is not added to the interpreter's search path, because the packages in this folder have other
#: versions.
_IMPORT_PROJECT = (
    "import importlib.util as u, sys; s = u.spec_from_file_location('impact_xval', {!r}); "
    "sys.modules['impact_xval'] = m = u.module_from_spec(s); s.loader.exec_module(m)"
)
#: Score of a worker process for the case that memory runs out. Linux first ends the process with the highest score.
#: With this score it ends a worker process, and not the main process.
_OOM_SCORE = "600"
#: Seconds that a process gets to exit by itself after its socket has closed. If it exits by itself, its exit code tells
#: why it ended.
_TO_EXIT = 10.0
#: Option of Linux's `prctl`: sets the signal that a process gets when the thread that started it ends.
_PR_SET_PDEATHSIG = 1


class FaultError(Exception):
    """Error for a worker process that died or did not answer in time; the same fault always gives the same reason."""

    def __init__(self, status: Status, reason: str) -> None:
        super().__init__(reason)
        self.status: Status = status
        self.reason = reason


class ClosedError(Exception):
    """Error for a call to a worker that is closed before or during the call."""


class WorkerError(Exception):
    """Error for an unexpected exception in a worker process, which is a bug. The text is the traceback there."""


class Worker(Generic[_Context]):
    """Worker process that answers one caller at a time.

    The process is started at the first call, and again at the first call after a fault.

    Parameters
    ----------
    context
        First argument of every function that the process calls. The context is sent only once to each process.
    log : Path, optional
        File to which the standard error of the process is appended.
    python : Path, optional
        Interpreter of another environment with the same version of Python. The process imports this project from its
        present place, and all other packages from the other environment. So the environment need not be made again when
        the code of the project changes.

    On Linux the process ends with the thread that started it. That thread must live as long as the worker.
    """

    def __init__(self, context: _Context, log: Path | None = None, python: Path | None = None) -> None:
        self.context, self._log, self._python = context, log, python
        #: Names of the solvers for which the present process is ready. The caller adds these names. For a new process
        #: there are none.
        self.ready: set[str] = set()
        self._lock, self._closed = threading.Lock(), False
        self._running: tuple[subprocess.Popen[bytes], Connection] | None = None

    def start(self) -> tuple[subprocess.Popen[bytes], Connection]:
        """Start the process if there is none; return the process and this end of its pair of sockets.

        The process imports the modules that the context needs while the caller goes on.
        """
        with self._lock:
            if self._closed:
                raise ClosedError
            if self._running is None:
                self._running = _start_process(self._log, self._python)
                with contextlib.suppress(OSError):  # the process has ended, which the next call will find out
                    self._running[1].send(self.context)
            return self._running

    def call(
        self,
        function: Callable[[_Context, *_Arguments], _Answer],
        *arguments: *_Arguments,
        timeout: float,
    ) -> _Answer:
        """Return ``function(context, *arguments)``, computed in the process.

        Parameters
        ----------
        function : callable
            A function at the top level of a module.
        timeout : float
            Seconds after which the process is killed.

        Raises
        ------
        FaultError
            If the process dies or does not answer in time.
        WorkerError
            If the function raises an exception.
        ClosedError
            If the worker is closed.
        """
        process, pipe = self.start()
        try:
            pipe.send((function, arguments))
            if pipe.poll(timeout):
                done, value = pipe.recv()
                if done:
                    return value
                raise WorkerError(value)
            fault = FaultError("timeout", f"no answer within {timeout:g} s; its process was ended")
        except (EOFError, OSError):
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(_TO_EXIT)
            fault = FaultError("crashed", f"its process died: {_describe_exit(_end_process(process))}")
        self.end()
        raise ClosedError if self._closed else fault

    def end(self) -> None:
        """End the process; the next call starts another process.

        Only the thread that makes the calls may call this method.
        """
        if self._running is not None:
            process, pipe = self._running
            _end_process(process)
            pipe.close()
            self.ready.clear()
            self._running = None

    def close(self) -> None:
        """End the process for good, even during a call. Any thread may call this method at any time."""
        with self._lock:
            self._closed = True
            if self._running is not None:
                _end_process(self._running[0])


def in_halves(
    call: Callable[[slice], _Piece], n: int, failure: Callable[[slice, FaultError], _Piece]
) -> list[_Piece]:
    """Call a function for n cells, and return its answers in order, one for each range of cells that succeeded.

    The first call is for all cells at once. If the process dies or hangs, the range of cells is split into halves, down
    to single cells. A call for a single cell is tried again after a crash (`retry_once`). If the single cell fails
    again, `failure` returns the answer in place of the call.
    """

    def pieces(start: int, stop: int) -> list[_Piece]:
        place = slice(start, stop)
        if stop - start <= 1:
            return [retry_once(lambda: call(place), lambda fault: failure(place, fault))]
        try:
            return [call(place)]
        except FaultError:
            middle = (start + stop) // 2
            return [*pieces(start, middle), *pieces(middle, stop)]

    return pieces(0, n)


def retry_once(call: Callable[[], _Answer], on_failure: Callable[[FaultError], _Answer]) -> _Answer:
    """Return the answer of a call, which is made a second time if its process crashes.

    A first crash may be an accident: memory was full, or somebody ended the process. After a second crash, or if one of
    the calls takes too long, `on_failure` returns the answer in place of the call.
    """
    try:
        return call()
    except FaultError as fault:
        if fault.status == "timeout":
            return on_failure(fault)
    try:
        return call()
    except FaultError as fault:
        return on_failure(fault)


def _start_process(log: Path | None, python: Path | None) -> tuple[subprocess.Popen[bytes], Connection]:
    """Start a process that runs `serve`; return it and the caller's end of its pair of sockets."""
    ours, theirs = Pipe()
    serving = f"from {__name__} import serve; serve({theirs.fileno()}, {os.getpid()})"
    environment = NO_WINDOW | os.environ | dict.fromkeys(_THREADS, "1")
    if python is None:
        given: list[object] = [*sys.path]
        # Entries of the search path that are no texts are left out, because imports ignore them.
        places = [place for place in given if isinstance(place, str)]
        command = [sys.executable, "-c", f"import sys; sys.path[:] = {places!r}; {serving}"]
    else:
        # The option -I ignores the caller's PYTHONPATH. Packages on it would hide the versions in the environment.
        command = [str(python), "-I", "-c", f"{_IMPORT_PROJECT.format(str(_PROJECT))}; {serving}"]
        # The other environment has its own cache. Its version of Numba may differ, and would overwrite the kernels in
        # our cache.
        environment["NUMBA_CACHE_DIR"] = str(python.parents[1] / "kernels")
    with theirs, (log or Path(os.devnull)).open("ab") as said:
        process = subprocess.Popen(
            command,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,  # some engines print messages to standard output
            stderr=said,
            env=environment,
            pass_fds=[theirs.fileno()],
            start_new_session=True,
        )
    return process, ours


def _end_process(process: subprocess.Popen[bytes]) -> int:
    """Kill a process and its children if the process still runs; return the exit code of the process."""
    if process.poll() is None:
        with contextlib.suppress(OSError):  # the process has ended meanwhile
            os.killpg(process.pid, signal.SIGKILL)
    return process.wait()


def _describe_exit(code: int) -> str:
    if code >= 0:
        return f"exit code {code}"
    known = {number.value: number.name for number in signal.Signals}
    name = known.get(-code, f"signal {-code}")
    return f"{name} (out of memory, or killed)" if name == "SIGKILL" else name


def serve(handle: int, parent: int) -> None:
    """Call functions for the process at the other end of a socket until that process closes it or ends.

    The code of a worker process runs this function. `handle` is the number of the socket's file, `parent` the id of the
    process that started this process.
    """
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
        if os.getppid() != parent:  # the parent ended before prctl was called
            return
        Path("/proc/self/oom_score_adj").write_text(_OOM_SCORE)
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches all processes; the main process handles it
    os.set_inheritable(handle, False)
    with Connection(handle) as pipe, contextlib.suppress(EOFError, ConnectionError):
        context = pipe.recv()
        while True:
            asked = pipe.recv_bytes()
            try:
                function, arguments = pickle.loads(asked)
                answer = pickle.dumps((True, function(context, *arguments)))
            except Exception:
                answer = pickle.dumps((False, traceback.format_exc()))
            pipe.send_bytes(answer)
