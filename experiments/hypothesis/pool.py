"""Handing work to processes: engines are not thread-safe, and a step of theirs is Python's."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from typing import Any


@contextlib.contextmanager
def pool(workers: int) -> Iterator[Callable[..., Future[Any]]]:
    """Give a function that hands work to other processes, or, for one worker, does it at once."""
    if workers == 1:

        def at_once(function: Callable[..., Any], *arguments: Any) -> Future[Any]:
            future: Future[Any] = Future()
            future.set_result(function(*arguments))
            return future

        yield at_once
        return
    # Spawned, not forked: engines and compiled code hold threads and handles that do not survive a fork.
    executor = ProcessPoolExecutor(
        workers, mp_context=multiprocessing.get_context("spawn"), initializer=_start_worker
    )
    before = set(multiprocessing.active_children())
    try:
        yield executor.submit
    except BaseException:
        for child in set(multiprocessing.active_children()) - before:
            child.terminate()
        executor.shutdown(wait=True, cancel_futures=True)
        raise
    executor.shutdown()


def _start_worker() -> None:
    """Leave Ctrl-C to the main process, and end when it is gone."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = multiprocessing.parent_process()
    if parent is not None:
        threading.Thread(target=lambda: (parent.join(), os._exit(1)), daemon=True).start()
