"""Where the work of a sweep is done: executors in the sense of `concurrent.futures`, each with sandboxes.

What is submitted is called as ``function(sandbox, *arguments)``, in a thread that has the sandbox to itself.
There are two: processes on this machine (`SandboxExecutor`), and the workers of a Dask cluster
(`sweep.dask_cluster`). No result depends on which, nor on how many. `in_this_process` tells
whether the threads of one are those of this process.
"""

from __future__ import annotations

import functools
import os
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Executor, Future, as_completed, wait
from contextlib import contextmanager
from typing import Any, TypeVar

from impact_xval.experiments.config.errors import UserError
from impact_xval.experiments.sweep.sandbox import Sandbox, SandboxExecutor

_Answer = TypeVar("_Answer")


class _InThisProcess:
    """What a sandbox is to its callers, without a process: a crash of a solver is a crash of the caller."""

    prepared = None

    def __init__(self, context: Any) -> None:
        self.context = context

    def start(self) -> None:
        """There is nothing to start."""

    def call(self, function: Callable[..., Any], *arguments: Any, timeout: float) -> Any:
        return function(self.context, *arguments)


class DirectExecutor(Executor):
    """Work at once and in this process: for looking into solvers with a debugger, and for quick tests."""

    workers = 1

    def __init__(self, context: Any) -> None:
        self._sandbox = _InThisProcess(context)

    def submit(self, fn: Callable[..., _Answer], /, *args: Any, **kwargs: Any) -> Future[_Answer]:
        """Call ``fn(sandbox, *args)``."""
        future: Future[_Answer] = Future()
        try:
            future.set_result(fn(self._sandbox, *args, **kwargs))
        except Exception as error:
            future.set_exception(error)
        return future


@contextmanager
def open_executor(
    context: Any,
    prepare: Callable[[Any], Any],
    workers: int,
    *,
    scheduler: str | None = None,
    isolate: bool = True,
    say: Callable[[str], None] = lambda line: None,
) -> Iterator[Any]:
    """Give an executor; all it started is gone when the block ends, at once if by an exception.

    Parameters
    ----------
    context, prepare
        Of every `Sandbox`.
    workers : int
        Processes on this machine.
    scheduler : str or None
        Address of a Dask scheduler; None for processes without Dask.
    isolate : bool
        False for `DirectExecutor`.
    say : callable
        Given a line about a cluster.
    """
    if not isolate:
        yield DirectExecutor(context)
        return
    make_sandbox = functools.partial(Sandbox, context, prepare)
    if scheduler is not None:
        try:
            from impact_xval.experiments.sweep.dask_cluster import dask_executor
        except ImportError as error:
            raise UserError(
                f"--scheduler {scheduler}: needs Dask ({error}); run pip install 'impact-xval[cluster]'"
            ) from None
        with dask_executor(make_sandbox, scheduler, say) as executor:
            yield executor
        return
    executor = SandboxExecutor(make_sandbox, workers)
    try:
        yield executor
    except BaseException:
        executor.shutdown(cancel_futures=True)
        raise
    executor.shutdown()


def in_this_process(executor: Any) -> bool:
    """Whether the threads of an executor are those of this process: they can be given what cannot be pickled."""
    return isinstance(executor, (DirectExecutor, SandboxExecutor))


def in_flight(
    submit: Callable[[Any], Future[_Answer]], tasks: Iterable[Any], capacity: Callable[[], int]
) -> Iterator[_Answer]:
    """Yield answers as they come, with a bounded number of tasks handed out.

    Parameters
    ----------
    submit : callable
        Hands out a task.
    tasks : iterable
        Made one by one, when they are handed out.
    capacity : callable
        How many may be handed out at once; called again and again, since a cluster may grow.
    """
    pending: set[Future[_Answer]] = set()
    for task in tasks:
        pending.add(submit(task))
        if len(pending) >= capacity():
            finished, pending = wait(pending, return_when=FIRST_COMPLETED)
            yield from (future.result() for future in finished)
    yield from (future.result() for future in as_completed(pending))


def available_cores() -> int:
    """Cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
