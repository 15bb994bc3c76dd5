"""A process of its own for the solvers: what crashes it, or hangs in it, costs an answer and nothing else.

The process is started as ``python -c`` with the path of modules of this one, and spoken to through pipes
(pickles, from and to a process we started ourselves; none is ever read from a disk or a network). A request has
a number, and its answer that number and the digest of what was requested: an answer to anything else, which a
process that a solver forked may write at any time, ends the process. Its threads of numerical libraries are one
each: collisions are shared out to processes, and no number may depend on how many threads there are.
What it writes to standard error appears on its caller's, its control characters made visible.

Beside it stands a guard, forked before any solver is imported, and nobody's child. When the process has ended, or its
caller has, the guard ends what is left: all in the session of the sandbox and, on Linux, all that inherited its
environment. A process that a solver starts in a session of its own and with another environment outlives it, and may
hold the pipes: nobody waits for their end, but for an answer, the end of the sandbox, and a time.

Not `multiprocessing`, nor a pool made of it (pebble 5.2 was tried): its processes cannot be started by a
daemon, which is what a worker of Dask is; they import the caller's main script again, which breaks one without
``if __name__ == "__main__"``; and one that hangs outlives a parent that is killed.
"""

from __future__ import annotations

import collections
import contextlib
import hashlib
import io
import itertools
import math
import os
import pickle
import queue
import select
import signal
import subprocess
import sys
import threading
import time
import traceback
import uuid
from collections.abc import Callable, Set
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import IO, Any, Literal, TypeVar

_Piece = TypeVar("_Piece")
_Answer = TypeVar("_Answer")

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
#: Seconds for a process to be made ready: what it needs is imported, and compiled once an installation.
TO_PREPARE = 900.0
#: Linux ends the process with the highest score first when memory runs out: the sandbox, not the main process.
_OOM_SCORE = "600"
#: Seconds for a process that gave no answer to end by itself, since its exit code is of interest: one that has closed
#: its pipe, as its end does, and one that may go on.
_TO_EXIT, _GRACE = 10.0, 1.0
#: Seconds between two looks at whether sandbox and caller are there and at work.
_LOOK = 0.1
#: Seconds between two looks from which on this process was halted meanwhile, or the machine.
_HALTED = 1.0
#: Of a process's standard error, the characters shown as they come and the lines kept for its end; a longer line is
#: taken as several.
_SHOWN, _LAST, _LINE = 65536, 20, 4096
#: Bytes of an answer, and those of it that are read at once.
_LARGEST, _PIECE = 4 << 30, 1 << 20
#: Variable of the environment by which all that a sandbox started is found.
_MARK = "IMPACT_XVAL_SANDBOX"


class FaultError(Exception):
    """The process died, or did not answer in time.

    Attributes
    ----------
    status : {"crashed", "timeout"}
    reason : str
        One sentence; the same whenever the same happens.
    """

    def __init__(self, status: Literal["crashed", "timeout"], reason: str) -> None:
        super().__init__(reason)
        self.status: Literal["crashed", "timeout"] = status
        self.reason = reason


class ClosedError(Exception):
    """The sandbox was closed while it worked, or before."""


class SandboxError(Exception):
    """An exception in the sandbox that nobody expected: a bug, with the traceback of the other process."""


class Sandbox:
    """A process that works for one caller at a time; it is started when it is first needed, and after a fault.

    Parameters
    ----------
    context : object
        Sent once to each process, and handed to everything that is called there.
    prepare : callable
        Called in each new process before anything else, as ``prepare(context)``; imports and compiled code
        belong there, since the time limit of a call does not cover it. If the process dies of it, the next
        starts without.
    prepare_timeout : float
        Seconds after which a process that is not ready is taken as hanging.
    readable : set of (str, str), optional
        Module and name of all that an answer may be made of beside plain values, where the process is not trusted: an
        answer with anything else is none, and an exception is a fault. By default anything.
    """

    def __init__(
        self,
        context: Any,
        prepare: Callable[..., Any],
        prepare_timeout: float = TO_PREPARE,
        *,
        readable: Set[tuple[str, str]] | None = None,
    ) -> None:
        self.context, self._prepare, self._prepare_timeout = context, prepare, prepare_timeout
        self._readable = readable
        self._process: _Process | None = None
        self._working = threading.Lock()
        self._requests = itertools.count()
        self._closed = False
        #: What `prepare` returned; None before the first start, and where it failed.
        self.prepared: Any = None

    def start(self) -> None:
        """Start the process, if there is none, and wait until it is prepared.

        Raises
        ------
        ClosedError
        SandboxError
        """
        if self._process is not None:
            return
        process = self._launch()
        try:
            self.prepared = self._answer(process, self._prepare, (), self._prepare_timeout)
        except FaultError:
            self._launch()
        except SandboxError:  # of no use, and the next call is to fail of the same
            self._process = None
            process.end()
            raise

    def call(self, function: Callable[..., Any], *arguments: Any, timeout: float) -> Any:
        """Return ``function(context, *arguments)`` of the sandbox.

        Parameters
        ----------
        function : callable
            At the top level of a module.
        arguments
            What can be pickled.
        timeout : float
            Seconds after which the process counts as hanging and is killed.

        Raises
        ------
        FaultError
            If the process died or hung.
        ClosedError
        SandboxError
        """
        self.start()
        assert self._process is not None
        return self._answer(self._process, function, arguments, timeout)

    def close(self) -> None:
        """End the process, whatever it does; safe from any thread, and at any time."""
        self._closed = True
        process = self._process
        if process is not None:
            process.kill()
            with self._working:  # whoever works with it notices
                process.end()

    def _launch(self) -> _Process:
        if self._closed:
            raise ClosedError
        places = [place for place in sys.path if isinstance(place, str)]  # no import heeds another
        code = f"import sys; sys.path[:] = {places!r}; from {__name__} import serve; serve({os.getpid()})"
        self._process = process = _Process(code)
        with self._working:
            if self._closed:  # by another thread meanwhile, which may not have seen this process
                process.end()
                raise ClosedError
            process.send(pickle.dumps(self.context), time.monotonic() + self._prepare_timeout)
        return process

    def _answer(
        self, process: _Process, function: Callable[..., Any], arguments: tuple, timeout: float
    ) -> Any:
        until = time.monotonic() + timeout
        asked, number = pickle.dumps((function, arguments)), next(self._requests)
        with self._working:
            if self._closed:
                raise ClosedError
            try:
                process.send((number, asked), until)
                done, value = process.answer_to(number, asked, self._readable)
            except TimeoutError:
                fault = FaultError("timeout", f"no answer within {timeout:g} s; its process was ended")
            except _NoAnswerError as error:
                fault = FaultError("crashed", process.cause(error.grace) or str(error))
            except BaseException:  # Ctrl-C: its answer may come later, and is to nothing then
                self._process = None
                process.end()
                raise
            else:
                if done:
                    return value
                if self._readable is None:
                    raise SandboxError(value)
                # Its interpreter may not be what it was.
                fault = FaultError("crashed", f"in its process: {last_line(str(value))}")
            self._process = None
            process.end()
        raise ClosedError if self._closed else fault


class SandboxExecutor(ThreadPoolExecutor):
    """Threads of this process, each submitted call with one of as many sandboxes; all are started at once."""

    def __init__(self, make_sandbox: Callable[[], Sandbox], workers: int) -> None:
        super().__init__(workers, thread_name_prefix="sandbox")
        self._sandboxes = [make_sandbox() for _ in range(workers)]
        self._unused: queue.SimpleQueue[Sandbox] = queue.SimpleQueue()
        for sandbox in self._sandboxes:
            self._unused.put(sandbox)
        for _ in self._sandboxes:
            self.submit(Sandbox.start)  # while the caller still plans

    @property
    def workers(self) -> int:
        """How many calls are worked on at once."""
        return len(self._sandboxes)

    def submit(self, fn: Callable[..., _Answer], /, *args: Any, **kwargs: Any) -> Future[_Answer]:
        """Submit ``fn(sandbox, *args)``."""
        return super().submit(self._run, fn, *args, **kwargs)

    def _run(self, fn: Callable[..., _Answer], *args: Any, **kwargs: Any) -> _Answer:
        sandbox = self._unused.get()
        try:
            return fn(sandbox, *args, **kwargs)
        finally:
            self._unused.put(sandbox)

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """End the threads; with `cancel_futures`, the sandboxes at once and whatever they work on."""
        if not cancel_futures:
            super().shutdown(wait=wait)
        for sandbox in self._sandboxes:
            sandbox.close()
        super().shutdown(wait=wait, cancel_futures=cancel_futures)


def in_halves(
    call: Callable[[slice], _Piece], n: int, failure: Callable[[slice, FaultError], _Piece]
) -> list[_Piece]:
    """Call for n cells at once, in halves where their process dies or hangs, and so on down to single cells.

    A cell is lost when its process died twice with this cell alone: one death may have been anybody's (a full memory,
    an operator), and costs nothing but time. One that hangs alone is lost: it has had the time that one may take.

    Parameters
    ----------
    call : callable
        Answers for some cells, by a call of a `Sandbox`.
    n : int
        Number of cells.
    failure : callable
        What stands for the answer for a cell that is lost, from its place and the last fault.

    Returns
    -------
    list
        What `call` and `failure` returned, in the order of the cells.
    """

    def pieces(start: int, stop: int, again: bool) -> list[_Piece]:
        place, middle = slice(start, stop), (start + stop) // 2
        try:
            return [call(place)]
        except FaultError as fault:
            if stop - start > 1:
                return [*pieces(start, middle, False), *pieces(middle, stop, False)]
            if again or fault.status == "timeout":
                return [failure(place, fault)]
        return pieces(start, stop, True)

    return pieces(0, n, False)


class _NoAnswerError(Exception):
    """What came from a sandbox, or that nothing did; with the seconds in which its process may end by itself."""

    def __init__(self, what: str, grace: float = _GRACE) -> None:
        super().__init__(what)
        self.grace = grace


class _Process:
    """A process that serves (`serve`), and our ends of its pipes: used while it lives, and until a time."""

    def __init__(self, code: str) -> None:
        self._process = subprocess.Popen(
            [sys.executable, "-c", code],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            bufsize=0,
            env=NO_WINDOW | os.environ | dict.fromkeys(_THREADS, "1") | {_MARK: _new_mark()},
            start_new_session=True,
        )
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self.requests, self.answers = self._process.stdin, self._process.stdout
        self._seen, self._until, self._left = 0.0, math.inf, 0
        os.set_blocking(self.requests.fileno(), False)
        threading.Thread(target=_pass_on, args=(self._process.stderr,), daemon=True).start()

    def send(self, value: Any, until: float) -> None:
        """Send a value, and have until a time for this and the answer; that it was not taken is noticed there."""
        left, self._seen, self._until = memoryview(pickle.dumps(value)), time.monotonic(), until
        with contextlib.suppress(OSError, EOFError):
            while left:
                self._await(self.requests, select.POLLOUT)
                left = left[self.requests.write(left) or 0 :]

    def answer_to(self, number: int, asked: bytes, readable: Set[tuple[str, str]] | None) -> tuple[bool, Any]:
        """Read the answer to a request: whether it was done, and the value or the traceback.

        Raises
        ------
        TimeoutError
        _NoAnswerError
        """
        self._left = _LARGEST
        try:
            answered, identity, done, value = _Reader(self, readable).load()
        except TimeoutError:
            raise
        except EOFError:
            raise _NoAnswerError("it closed its pipe", _TO_EXIT) from None
        except Exception as error:  # it is gone in mid-sentence, or another process wrote between
            raise _NoAnswerError(f"its answer cannot be read: {type(error).__name__}") from None
        if (answered, identity) != (number, _identity(asked)):
            raise _NoAnswerError("it gave the answer to another request; its process was ended")
        return done, value

    def read(self, n: int) -> bytes:
        """Read n bytes of its answer; less where it ends."""
        found = bytearray()
        self._left -= n
        if self._left < 0:
            raise OverflowError
        while len(found) < n:
            self._await(self.answers, select.POLLIN)
            if not (piece := self.answers.read(min(n - len(found), _PIECE))):
                break
            found += piece
        return bytes(found)

    def readline(self) -> bytes:
        """Read a line of its answer, which only one by another pickler has."""
        line = b""
        while not line.endswith(b"\n") and (byte := self.read(1)):
            line += byte
        return line

    def _await(self, pipe: IO[bytes], event: int) -> None:
        """Wait until a pipe can be used; `EOFError` when the process is over.

        Time in which this process was halted does not count: the answer may have come meanwhile.
        """
        ready = select.poll()
        ready.register(pipe, event)
        while self._seen < self._until:
            usable, now = ready.poll(1000 * _LOOK), time.monotonic()
            self._until += max(0.0, now - self._seen - _HALTED)
            self._seen = now
            if usable:
                return
            if self._is_over() and not ready.poll(0):
                raise EOFError
        raise TimeoutError

    def _is_over(self) -> bool:
        """Whether it has ended; its number stays its own, since it is not waited for. Halted, it is sent on."""
        if not hasattr(os, "waitid"):
            return self._process.poll() is not None
        try:
            state = os.waitid(os.P_PID, self._process.pid, os.WEXITED | os.WSTOPPED | os.WNOWAIT | os.WNOHANG)
        except ChildProcessError:  # another thread has waited for it
            return True
        if state is not None and state.si_code == os.CLD_STOPPED:
            os.kill(self._process.pid, signal.SIGCONT)
            return False
        return state is not None

    def cause(self, grace: float) -> str | None:
        """Give it time to end by itself; say of what it did."""
        until = time.monotonic() + grace
        while not (alone := self._is_over()) and time.monotonic() < until:
            time.sleep(_LOOK / 10)
        code = self.end()
        return f"its process died: {_cause(code)}" if alone else None

    def kill(self) -> None:
        """Kill it, if it has not ended, and all in its session: its guard may be gone."""
        if self._process.returncode is None:
            with contextlib.suppress(OSError):
                os.killpg(self._process.pid, signal.SIGKILL)
        self._process.kill()

    def end(self) -> int:
        """Kill it and put it away; its exit code."""
        self.kill()
        code = self._process.wait()
        for pipe in (self.requests, self.answers):
            with contextlib.suppress(OSError):
                pipe.close()
        return code


def _pass_on(said: io.RawIOBase) -> None:
    """Write what a process says to our standard error, as nothing a terminal obeys: the beginning, and the end."""
    from impact_xval.compliant_baselines.answers import visible  # most processes say nothing

    left, last = _SHOWN, collections.deque[str](maxlen=_LAST)
    with io.TextIOWrapper(io.BufferedReader(said), "utf-8", "backslashreplace", newline="\n") as lines:
        while line := lines.readline(_LINE):
            if left > 0 and not _write(visible(line)):
                left = 0
            if left <= 0:
                last.append(line)
            left -= len(line)
    if last:
        _write(f"\n... {-left} characters more, of which the last are:\n{visible(''.join(last))}\n")


def _write(text: str) -> bool:
    """Write to standard error, if it takes that soon: no solver is to wait for whoever reads it."""
    said, taken = text.encode(), select.poll()
    taken.register(2, select.POLLOUT)
    with contextlib.suppress(OSError):  # unbuffered: no lock is held when the interpreter ends
        for start in range(0, len(said), select.PIPE_BUF):
            if not taken.poll(1000 * _LOOK):
                return False
            os.write(2, said[start : start + select.PIPE_BUF])
    return True


class _Reader(pickle.Unpickler):
    """Reads plain values, and what is named beside them; by default anything."""

    def __init__(self, process: _Process, readable: Set[tuple[str, str]] | None) -> None:
        super().__init__(process)
        self._readable = readable

    def find_class(self, module_name: str, global_name: str, /) -> Any:
        if self._readable is not None and (module_name, global_name) not in self._readable:
            raise pickle.UnpicklingError(f"{module_name}.{global_name} is no part of an answer")
        return super().find_class(module_name, global_name)


def last_line(said: str) -> str:
    """Return what a traceback ends with, as a line that can be shown."""
    from impact_xval.compliant_baselines.answers import one_line  # most processes never need it

    return one_line(said.strip().rpartition("\n")[2])


def _identity(asked: bytes) -> str:
    """Identity of what is requested: function, solver and cells, and all else that it is called with."""
    return hashlib.sha256(asked).hexdigest()


def _cause(code: int) -> str:
    if code >= 0:
        return f"exit code {code}"
    known = {number.value: number.name for number in signal.Signals}
    name = known.get(-code, f"signal {-code}")
    return f"{name} (out of memory, or killed)" if name == "SIGKILL" else name


def serve(caller: int) -> None:
    """Work for the process at the other end of standard input, until it is gone; the life of a sandbox."""
    if hasattr(signal, "pthread_sigmask"):  # a cluster starts its processes with signals blocked
        signal.pthread_sigmask(signal.SIG_SETMASK, [])
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the main process's to answer
    signal.signal(signal.SIGCHLD, signal.SIG_DFL)  # where it is ignored, a solver learns no exit code
    with contextlib.suppress(OSError):
        Path("/proc/self/oom_score_adj").write_text(_OOM_SCORE)
    _post_guard(caller)
    requests, answers, null = os.dup(0), os.dup(1), os.open(os.devnull, os.O_RDWR)
    os.dup2(null, 0)  # what a solver starts reads no requests
    os.dup2(null, 1)  # engines print there
    if hasattr(os, "register_at_fork"):  # nor does what it forks, and its answers go nowhere
        os.register_at_fork(after_in_child=lambda: [os.dup2(null, end) for end in (requests, answers)])
    with (
        os.fdopen(requests, "rb") as received,
        os.fdopen(answers, "wb") as out,
        contextlib.suppress(EOFError, OSError, pickle.UnpicklingError),  # the caller is gone, in mid-sentence
    ):
        sent, context = pickle.load(received), None
        while True:
            number, asked = pickle.load(received)
            try:
                if sent is not None:
                    context, sent = pickle.loads(sent), None
                function, arguments = pickle.loads(asked)
                answer = pickle.dumps((number, _identity(asked), True, function(context, *arguments)))
            except Exception:
                answer = pickle.dumps((number, _identity(asked), False, traceback.format_exc()))
            out.write(answer)
            out.flush()


def _post_guard(caller: int) -> None:
    """Have a process end what is left when this one or its caller is gone.

    It is nobody's child here: a solver that looks for its own, or waits for any, does not find it.
    """
    sandbox = os.getpid()
    ends = select.poll()
    ends.register(0, 0)  # reads nothing: reports that the other end of the pipe is closed
    with contextlib.suppress(AttributeError, OSError):  # of Linux, since 5.3
        for process in (sandbox, caller):  # what the caller forked may hold that end
            ends.register(os.pidfd_open(process), select.POLLIN)
    between = os.fork()
    if between:
        with contextlib.suppress(ChildProcessError):  # our caller has its children waited for
            os.waitpid(between, 0)
        return
    try:
        os.setsid()
        if os.fork() == 0:
            os.closerange(1, 3)  # the caller reads until nobody holds the other end
            _guard(sandbox, ends)
    finally:
        os._exit(0)


def _guard(sandbox: int, ends: select.poll) -> None:
    """Wait until a sandbox or its caller is gone, then end the sandbox and all that it started."""
    while _exists(sandbox) and not ends.poll(1000 * _LOOK):
        pass
    with contextlib.suppress(OSError):  # none is left
        os.killpg(sandbox, signal.SIGKILL)
    mark = f"{_MARK}={os.environ[_MARK]}".encode()
    while left := [process for process in _others() if _has(process, mark)]:
        for process in left:
            with contextlib.suppress(ProcessLookupError):
                os.kill(process, signal.SIGKILL)
        time.sleep(_LOOK)


def _exists(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    return True


def _others() -> list[int]:
    """Other processes of this machine; none where there is no /proc."""
    return [int(path.name) for path in Path("/proc").glob("[0-9]*") if path.name != str(os.getpid())]


def _has(process: int, mark: bytes) -> bool:
    """Whether the environment of a process has a mark, or one below it; not of one that is gone, or another user's."""
    try:
        environment = Path(f"/proc/{process}/environ").read_bytes()
    except OSError:
        return False
    return any(each == mark or each.startswith(mark + b"/") for each in environment.split(b"\0"))


def is_sandbox() -> bool:
    """Whether this process is a sandbox, or was started in one."""
    return _MARK in os.environ


def _new_mark() -> str:
    """Mark a sandbox; one that is started in another has that one's mark before its own."""
    return "/".join([*filter(None, [os.environ.get(_MARK)]), uuid.uuid4().hex])
