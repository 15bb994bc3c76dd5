"""A process of its own for the solvers: what crashes it, or hangs in it, costs an answer and nothing else.

The process is started as ``python -c`` with the path of modules of this one, and spoken to through pipes
(pickles, from and to a process we started ourselves; none is ever read from a disk or a network). Not
`multiprocessing`: its processes cannot be started by a daemon, which is what a worker of Dask is, and they
import the caller's main script again. Its threads of numerical libraries are one each: collisions are shared
out to processes, and no number may depend on how many threads there are.
"""

from __future__ import annotations

import contextlib
import os
import pickle
import queue
import signal
import subprocess
import sys
import threading
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import Any, BinaryIO, Literal

#: Called by work in the sandbox, with a word for what comes next; the patience of the caller starts anew.
Beat = Callable[[str], None]

_THREADS = (
    "NUMBA_NUM_THREADS",
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "MKL_NUM_THREADS",
    "ARROW_NUM_THREADS",
)
#: Linux ends the process with the highest score first when memory runs out: the sandbox, not the main process.
_OOM_SCORE = "600"


class FaultError(Exception):
    """The process died, or did not answer in time.

    Attributes
    ----------
    status : {"crashed", "timeout"}
    at : str
        The last word it said before (`Beat`), "" if none.
    reason : str
        One sentence; the same whenever the same happens.
    """

    def __init__(self, status: Literal["crashed", "timeout"], at: str, reason: str) -> None:
        super().__init__(reason)
        self.status: Literal["crashed", "timeout"] = status
        self.at, self.reason = at, reason


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
        Called in each new process before anything else, as ``prepare(context, beat=beat)``; imports and
        compiled code belong there, since the patience of a call does not cover it. If the process dies of it,
        the next starts without.
    prepare_patience : float
        Seconds after which a process that is not ready is taken as hanging.
    """

    def __init__(self, context: Any, prepare: Callable[..., Any], prepare_patience: float = 900.0) -> None:
        self._context, self._prepare, self._prepare_patience = context, prepare, prepare_patience
        self._process: subprocess.Popen[bytes] | None = None
        self._messages: queue.SimpleQueue[tuple[str, Any] | None] = queue.SimpleQueue()
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
        self._launch()
        try:
            self.prepared = self._ask(self._prepare, (), self._prepare_patience)
        except FaultError:
            self._launch()

    def call(self, function: Callable[..., Any], *arguments: Any, patience: float) -> Any:
        """Return ``function(context, *arguments, beat=beat)`` of the sandbox.

        Parameters
        ----------
        function : callable
            At the top level of a module.
        arguments
            What can be pickled.
        patience : float
            Seconds of silence (no beat and no answer) after which the process counts as hanging and is killed.

        Raises
        ------
        FaultError
            If the process died or hung.
        ClosedError
        SandboxError
        """
        self.start()
        return self._ask(function, arguments, patience)

    def close(self) -> None:
        """End the process, whatever it does; safe from any thread, and at any time."""
        self._closed = True
        process = self._process
        if process is not None:
            _kill(process)

    def _launch(self) -> None:
        if self._closed:
            raise ClosedError
        code = f"import sys; sys.path[:] = {sys.path!r}; from {__name__} import serve; serve()"
        self._messages = queue.SimpleQueue()
        self._process = process = subprocess.Popen(
            [sys.executable, "-c", code],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            env=os.environ | dict.fromkeys(_THREADS, "1"),
        )
        assert process.stdout is not None
        reader = threading.Thread(target=_read, args=(process.stdout, self._messages), daemon=True)
        reader.start()
        if self._closed:  # closed by another thread meanwhile, which may not have seen this process
            process.kill()
        self._send(self._context)

    def _send(self, value: Any) -> None:
        assert self._process is not None
        assert self._process.stdin is not None
        with contextlib.suppress(BrokenPipeError, ValueError):  # a death is noticed by whoever reads
            pickle.dump(pickle.dumps(value), self._process.stdin)
            self._process.stdin.flush()

    def _ask(self, function: Callable[..., Any], arguments: tuple, patience: float) -> Any:
        if self._closed:
            raise ClosedError
        self._send((function, arguments, patience))
        at = ""
        while True:
            try:
                message = self._messages.get(timeout=patience)
            except queue.Empty:
                self._end(grace=0.0)
                raise FaultError(
                    "timeout", at, f"no answer within {patience:g} s; its process was ended"
                ) from None
            if message is None:
                code = self._end(
                    grace=1.0
                )  # it closed its pipe: it is about to die, and of what is of interest
                raise FaultError("crashed", at, f"its process died: {_cause(code)}")
            kind, value = message
            if kind == "at":
                at = value
            elif kind == "error":
                raise SandboxError(value)
            else:
                return value

    def _end(self, grace: float) -> int:
        """End the process, unless it ends by itself in time, and return its exit code."""
        process = self._process
        assert process is not None
        if self._closed:
            raise ClosedError
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(grace)
        self._process = None
        return _kill(process)


def _kill(process: subprocess.Popen[bytes]) -> int:
    process.kill()
    code = process.wait()
    if process.stdin is not None:
        with contextlib.suppress(OSError):
            process.stdin.close()
    return code


def _read(pipe: BinaryIO, messages: queue.SimpleQueue[tuple[str, Any] | None]) -> None:
    """Pass on what the process says, and None when it is gone, however it went."""
    with pipe, contextlib.suppress(Exception):
        while True:
            messages.put(pickle.load(pipe))
    messages.put(None)


def _cause(code: int) -> str:
    if code >= 0:
        return f"exit code {code}"
    try:
        name = signal.Signals(-code).name
    except ValueError:
        name = f"signal {-code}"
    return f"{name} (out of memory, or killed)" if name == "SIGKILL" else name


def serve() -> None:
    """Work for the process at the other end of standard input, until it is gone; the life of a sandbox."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the main process's to answer
    with contextlib.suppress(OSError):
        Path("/proc/self/oom_score_adj").write_text(_OOM_SCORE)
    out = os.fdopen(os.dup(1), "wb")
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # engines print there

    def say(kind: str, value: Any) -> None:
        pickle.dump((kind, value), out)
        out.flush()

    inbox: queue.SimpleQueue[bytes] = queue.SimpleQueue()
    threading.Thread(target=_listen, args=(inbox,), daemon=True).start()
    context: Any = None
    first = True
    while True:
        blob = inbox.get()
        try:
            if first:
                context, first = pickle.loads(blob), False
                continue
            function, arguments, patience = pickle.loads(blob)

            def beat(word: str, patience: float = patience) -> None:
                _watch(patience)
                say("at", word)

            _watch(patience)
            answer = function(context, *arguments, beat=beat)
        except Exception:
            say("error", traceback.format_exc())
        except SystemExit as end:  # at once: an orderly end would wait for the thread that listens
            os._exit(end.code if isinstance(end.code, int) else 1)
        else:
            say("done", answer)
        _watch(0)


def _listen(inbox: queue.SimpleQueue[bytes]) -> None:
    """Pass on what is asked; end the process when the asker is gone (killed, it tells nobody)."""
    with contextlib.suppress(Exception):
        while True:
            inbox.put(pickle.load(sys.stdin.buffer))
    os._exit(1)


def _watch(patience: float) -> None:
    """End this process long after its caller should have: even one that hangs in C, its caller dead, ends."""
    if hasattr(signal, "setitimer"):
        signal.setitimer(signal.ITIMER_REAL, 2 * patience + 60 if patience else 0)
