"""The workers of a Dask cluster as an executor: each of their threads has a sandbox beside it.

A worker of Dask never runs a solver itself, so an engine that crashes or hangs does not take it along, and
what is recorded of such a cell is the same as on one machine. A worker that dies all the same (its machine
is gone, its job ran out of time) costs nothing either: Dask gives its chunks to others. Workers need this
project installed in the same versions, but none of the run's files: parts are written by the main process.
"""

from __future__ import annotations

import time
import uuid
from collections.abc import Callable, Iterator
from concurrent.futures import CancelledError, Executor, Future
from contextlib import contextmanager
from typing import Any

from distributed import Client, get_worker
from distributed.comm.core import CommClosedError
from distributed.diagnostics.plugin import WorkerPlugin
from distributed.scheduler import KilledWorker

from impact_xval.experiments.config.errors import InterruptedRunError, UserError
from impact_xval.experiments.sweep.sandbox import Sandbox, SandboxExecutor

#: Seconds to wait for a scheduler to answer, and between two lines that say that no worker has come yet.
_ANSWER = 10
_WAIT = 30
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
    make_sandbox: Callable[[], Sandbox], scheduler: str, say: Callable[[str], None]
) -> Iterator[DaskExecutor]:
    """Work on a Dask cluster.

    Parameters
    ----------
    make_sandbox : callable
        Can be pickled.
    scheduler : str
        The address of a scheduler, such as ``tcp://host:8786``.
    say : callable
        Given a line about the cluster.

    Raises
    ------
    UserError
        If no scheduler answers there.
    InterruptedRunError
        If the cluster is lost.
    """
    with _client(scheduler) as client:
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
def _client(scheduler: str) -> Iterator[Any]:  # a Client; its calls are annotated as coroutines
    try:
        client = Client(scheduler, timeout=_ANSWER)
    except (OSError, TimeoutError, ValueError, TypeError) as error:
        detail = _short(error) or type(error).__name__
        raise UserError(
            f"--scheduler {scheduler}: no Dask scheduler answers there ({detail}); legal: an "
            "address such as tcp://host:8786 or, with certificates, tls://host:8786"
        ) from None
    try:
        yield client
    finally:
        client.close(timeout=2)


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
