"""A process of its own for solvers: what crashes it, or hangs in it, costs an answer and nothing else.

It is started as ``python -c``, and spoken to by pickles over a pair of sockets. Not by `multiprocessing.Process`: a
worker of Dask is a daemon, which may have no children of that kind, and the main script of the caller would be imported
again. Numerical libraries have one thread each there: collisions are shared out to processes, and no number may depend
on how many threads there are.
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

if TYPE_CHECKING:  # whose room imports numpy
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
#: By this MuJoCo looks for no window: that takes a third of its import, and a process that prints a traceback when the
#: one that imports it is ended.
NO_WINDOW = {"MUJOCO_GL": "disable"}
#: File of the package that runs here, and how another interpreter imports that one: its folder alone, since what is
#: installed beside it is of other versions.
_PROJECT = Path(__file__).parents[2] / "__init__.py"
_IMPORT_PROJECT = (
    "import importlib.util as u, sys; s = u.spec_from_file_location('impact_xval', {!r}); "
    "sys.modules['impact_xval'] = m = u.module_from_spec(s); s.loader.exec_module(m)"
)
#: Linux ends the process with the highest score first when memory runs out: a worker, not the main process.
_OOM_SCORE = "600"
#: Seconds for a process that has closed its end to exit by itself, since its exit code is of interest.
_TO_EXIT = 10.0
#: Of Linux: the signal that a process gets when the thread that started it is gone.
_PR_SET_PDEATHSIG = 1


class FaultError(Exception):
    """The process died, or did not answer in time; the reason is the same whenever the same happens."""

    def __init__(self, status: Status, reason: str) -> None:
        super().__init__(reason)
        self.status: Status = status
        self.reason = reason


class ClosedError(Exception):
    """The worker was closed while it worked, or before."""


class WorkerError(Exception):
    """An exception in the worker that nobody expected: a bug, with the traceback of the other process."""


class Worker(Generic[_Context]):
    """A process that works for one caller at a time; it is started when it is first needed, and after a fault.

    The context is sent once to each process, and handed to everything that is called there; standard error is appended
    to the log. On Linux it ends with the thread that started it, which must live as long.

    `python` is the interpreter of another environment, of the same version of Python: what is installed there is
    imported, and this project from where it runs here, so that the environment serves a changed checkout.
    """

    def __init__(self, context: _Context, log: Path | None = None, python: Path | None = None) -> None:
        self.context, self._log, self._python = context, log, python
        #: What the present process has been made ready for; of the caller, and empty in a new process.
        self.ready: set[str] = set()
        self._lock, self._closed = threading.Lock(), False
        self._running: tuple[subprocess.Popen[bytes], Connection] | None = None

    def start(self) -> tuple[subprocess.Popen[bytes], Connection]:
        """Start the process, if there is none; it imports what the context needs while the caller goes on."""
        with self._lock:
            if self._closed:
                raise ClosedError
            if self._running is None:
                self._running = _start_process(self._log, self._python)
                with contextlib.suppress(OSError):  # it is gone: noticed by who calls it
                    self._running[1].send(self.context)
            return self._running

    def call(
        self,
        function: Callable[[_Context, *_Arguments], _Answer],
        *arguments: *_Arguments,
        timeout: float,
    ) -> _Answer:
        """Return ``function(context, *arguments)`` of the process, which is killed after so many seconds."""
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
        """End the process, for whoever works with it: the next call starts another."""
        if self._running is not None:
            process, pipe = self._running
            _end_process(process)
            pipe.close()
            self.ready.clear()
            self._running = None

    def close(self) -> None:
        """End the process, whatever it does; safe from any thread, and at any time."""
        with self._lock:
            self._closed = True
            if self._running is not None:
                _end_process(self._running[0])


def in_halves(
    call: Callable[[slice], _Piece], n: int, failure: Callable[[slice, FaultError], _Piece]
) -> list[_Piece]:
    """Call for n cells at once, in halves where their process dies or hangs, and so on down to single cells.

    A cell that is left alone is called as by `retry_once`; `failure` returns what stands for its answer. The answers
    are in the order of the cells.
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
    """Return the answer of a call, which is tried again after a crash.

    A first crash may come from a full memory, or from an operator. After a second fault, or a first timeout,
    `on_failure` returns what stands for the answer.
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
    """Start a process that serves, and give our end of its sockets."""
    ours, theirs = Pipe()
    serving = f"from {__name__} import serve; serve({theirs.fileno()}, {os.getpid()})"
    environment = NO_WINDOW | os.environ | dict.fromkeys(_THREADS, "1")
    if python is None:
        given: list[object] = [*sys.path]
        places = [place for place in given if isinstance(place, str)]  # no import heeds another
        command = [sys.executable, "-c", f"import sys; sys.path[:] = {places!r}; {serving}"]
    else:
        # Isolated: PYTHONPATH of the caller would put other versions before those of the environment.
        command = [str(python), "-I", "-c", f"{_IMPORT_PROJECT.format(str(_PROJECT))}; {serving}"]
        # Another version of Numba would write over the kernels of the one here.
        environment["NUMBA_CACHE_DIR"] = str(python.parents[1] / "kernels")
    with theirs, (log or Path(os.devnull)).open("ab") as said:
        process = subprocess.Popen(
            command,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,  # engines print there
            stderr=said,
            env=environment,
            pass_fds=[theirs.fileno()],
            start_new_session=True,
        )
    return process, ours


def _end_process(process: subprocess.Popen[bytes]) -> int:
    """Kill a process and what it forked, if it has not ended; its exit code."""
    if process.poll() is None:
        with contextlib.suppress(OSError):  # it has ended meanwhile
            os.killpg(process.pid, signal.SIGKILL)
    return process.wait()


def _describe_exit(code: int) -> str:
    if code >= 0:
        return f"exit code {code}"
    known = {number.value: number.name for number in signal.Signals}
    name = known.get(-code, f"signal {-code}")
    return f"{name} (out of memory, or killed)" if name == "SIGKILL" else name


def serve(handle: int, parent: int) -> None:
    """Work for the process at the other end of a socket until it is gone; the life of a worker."""
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
        if os.getppid() != parent:  # it was gone before
            return
        Path("/proc/self/oom_score_adj").write_text(_OOM_SCORE)
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the main process's to answer
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
