"""The workers of a Dask cluster as an executor: each of their threads has a sandbox beside it.

A worker of Dask never runs a solver itself, so an engine that crashes or hangs does not take it along, and
what is recorded of such a cell is the same as on one machine. A worker that dies all the same (its machine
is gone, its job ran out of time) costs nothing either: Dask gives its chunks to others. Workers need this
project installed in the same versions, but none of the run's files: parts are written by the main process.
"""

from __future__ import annotations

import logging
import multiprocessing
import signal
import time
import uuid
from collections.abc import Callable, Iterator
from concurrent.futures import CancelledError, Executor, Future, ThreadPoolExecutor, wait
from contextlib import contextmanager
from multiprocessing import resource_tracker
from typing import Any

from dask import config as dask_config
from distributed import Client, LocalCluster, get_worker
from distributed.comm.core import CommClosedError
from distributed.diagnostics.plugin import WorkerPlugin
from distributed.scheduler import KilledWorker

from impact_xval.experiments.config.errors import InterruptedRunError, UserError
from impact_xval.experiments.sweep.sandbox import Sandbox, SandboxExecutor

#: Stands for a cluster on this machine in place of an address; no other machine reaches it.
LOCAL = "local"
_LOOPBACK = "127.0.0.1"
_LOCAL_SETTINGS = {
    "distributed.scheduler.allowed-failures": 20,
    "distributed.scheduler.http.routes": [],
    "distributed.worker.http.routes": [],
}

#: Seconds to wait for a scheduler to answer, and between two lines that say that no worker has come yet.
_ANSWER = 10
_WAIT = 30
#: Seconds for a cluster of our own to start, and for a start that is not wanted any more to be through.
_START = 120
_END = 10
#: Seconds for which the number of workers is taken as known.
_KNOWN = 5.0


class SandboxPlugin(WorkerPlugin):
    """Gives every thread of a worker a sandbox, while a run goes on."""

    executor: SandboxExecutor

    def __init__(self, name: str, make_sandbox: Callable[[], Sandbox]) -> None:
        self.name = name
        self._make_sandbox = make_sandbox

    def setup(self, worker: Any) -> None:
        """Start the sandboxes, without keeping the worker waiting."""
        self.executor = SandboxExecutor(self._make_sandbox, worker.state.nthreads)

    def teardown(self, worker: Any) -> None:
        """End the processes, whatever they do."""
        self.executor.shutdown(wait=False, cancel_futures=True)


def _on_worker(name: str, function: Callable[..., Any], *arguments: Any) -> Any:
    plugin: Any = get_worker().plugins[name]
    return plugin.executor.submit(function, *arguments).result()


class DaskExecutor(Executor):
    """Submitted calls go to the workers of a cluster, as ``function(sandbox, *arguments)``."""

    def __init__(self, client: Any, name: str) -> None:
        self._client, self._name = client, name
        self._executor = client.get_executor(pure=False)
        self._workers, self._counted = 0, 0.0

    @property
    def workers(self) -> int:
        """How many calls are worked on at once; a cluster may grow and shrink."""
        if not self._workers or time.monotonic() - self._counted >= _KNOWN:
            self._workers = sum(self._client.nthreads().values())
            self._counted = time.monotonic()
        return self._workers

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Submit ``fn(sandbox, *args)``."""
        return self._executor.submit(_on_worker, self._name, fn, *args, **kwargs)

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Take back what is not done."""
        self._executor.shutdown(wait=wait and not cancel_futures)


@contextmanager
def dask_executor(
    make_sandbox: Callable[[], Sandbox], scheduler: str, workers: int, say: Callable[[str], None]
) -> Iterator[DaskExecutor]:
    """Work on a Dask cluster.

    Parameters
    ----------
    make_sandbox : callable
        Can be pickled.
    scheduler : str
        The address of a scheduler, such as ``tcp://host:8786``, or `LOCAL` for a cluster on this machine.
    workers : int
        Processes of a local cluster.
    say : callable
        Given a line about the cluster.

    Raises
    ------
    UserError
        If no scheduler answers there.
    InterruptedRunError
        If the cluster is lost.
    """
    with _client(scheduler, workers) as client:
        name = f"impact-xval-{uuid.uuid4().hex[:8]}"
        executor = DaskExecutor(client, name)
        try:
            client.register_plugin(SandboxPlugin(name, make_sandbox))
            say(f"Dask cluster at {client.scheduler.address}: {executor.workers} worker threads")
            while not executor.workers:
                _wait_for_worker(client, say)
            yield executor
        except KilledWorker as error:
            raise InterruptedRunError(f"too many workers of the cluster died: {_short(error)}") from None
        except (CancelledError, CommClosedError) as error:
            raise InterruptedRunError(
                f"the Dask cluster at {scheduler} is gone: {_short(error) or 'its scheduler does not answer'}"
            ) from None
        finally:
            executor.shutdown(wait=False, cancel_futures=True)
            _forget(client, name)


@contextmanager
def _client(scheduler: str, workers: int) -> Iterator[Any]:  # a Client; its calls are annotated as coroutines
    if scheduler == LOCAL:
        with _local_client(workers) as client:
            yield client
        return
    try:
        client = Client(scheduler, timeout=_ANSWER)
    except (OSError, TimeoutError, ValueError, TypeError) as error:
        detail = _short(error) or type(error).__name__
        raise UserError(
            f"--scheduler {scheduler}: no Dask scheduler answers there ({detail}); legal: '{LOCAL}', or an "
            "address such as tcp://host:8786 or, with certificates, tls://host:8786"
        ) from None
    try:
        yield client
    finally:
        client.close(timeout=2)


@contextmanager
def _local_client(workers: int) -> Iterator[Any]:
    """Start a cluster on this machine, in a thread: its start is not to be interrupted, and its end is ours."""
    with dask_config.set(_LOCAL_SETTINGS), ThreadPoolExecutor(1, initializer=_block_signals) as thread:
        start = thread.submit(_start, workers)
        try:
            yield _started(start)
        finally:
            while not wait([start], _END).done:  # the run is interrupted, or a worker hangs
                for worker in multiprocessing.active_children():
                    worker.kill()
            if start.exception() is None:
                client = start.result()
                client.close()
                client.cluster.close()


def _started(start: Future[Any]) -> Any:
    try:
        return start.result(_START)
    except TimeoutError:
        why = f"it has not answered for {_START} s"
    except Exception as error:  # a worker died, whatever Dask makes of that
        why = _short(error)
    raise InterruptedRunError(f"no Dask cluster has started: {why}") from None


def _start(workers: int) -> Any:
    return Client(
        LocalCluster(
            host=_LOOPBACK,
            n_workers=workers,
            threads_per_worker=1,
            # Dask has a server of pages in any case: here on loopback, on any port, and without a page.
            dashboard_address=f"{_LOOPBACK}:0",
            scheduler_kwargs={"dashboard": False},
            silence_logs=logging.CRITICAL,  # among errors are those of its end
        )
    )


def _block_signals() -> None:
    """Have what this thread starts leave the signals to a whole process group (Ctrl-C) to this process."""
    if hasattr(signal, "pthread_sigmask"):
        ends = signal.SIGINT, signal.SIGTERM, signal.SIGHUP
        signal.pthread_sigmask(signal.SIG_BLOCK, ends)
        resource_tracker.ensure_running()  # which unblocks two of them
        signal.pthread_sigmask(signal.SIG_BLOCK, ends)


def _wait_for_worker(client: Any, say: Callable[[str], None]) -> None:
    try:
        client.wait_for_workers(1, timeout=_WAIT)
    except TimeoutError:
        say(f"no worker has come yet; start some: dask worker {client.scheduler.address} --nthreads 1")


def _forget(client: Any, name: str) -> None:
    """End the sandboxes on the workers; a cluster that is gone needs none of it."""
    try:
        client.sync(client.unregister_worker_plugin, name, callback_timeout=3)
    except Exception:  # whatever it is: the run itself is over
        return


def _short(error: BaseException) -> str:
    return " ".join(str(error).split())[:200]
