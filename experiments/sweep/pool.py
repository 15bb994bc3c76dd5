"""Pools that do the work of a sweep: threads of this process or of a Dask cluster, each with processes of its own.

What is submitted is called as ``function(slot, *arguments)``, in a thread that has the slot to itself. No result
depends on where that is, nor on how many there are.
"""

from __future__ import annotations

import os
import queue
import threading
import uuid
from collections import Counter
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import (
    FIRST_COMPLETED,
    CancelledError,
    Executor,
    Future,
    ThreadPoolExecutor,
    as_completed,
    wait,
)
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import Any, Generic, ParamSpec, Protocol, TypeVar, TypeVarTuple, cast

from impact_xval.compliant_baselines.registry import is_ours, origins
from impact_xval.experiments.config.errors import InterruptedRunError, UserError
from impact_xval.experiments.config.experiment import REFERENCE
from impact_xval.experiments.sweep.process import ClosedError, FaultError, Worker

_Answer = TypeVar("_Answer")
_Task = TypeVar("_Task")
_Context = TypeVar("_Context")
_Arguments = TypeVarTuple("_Arguments")
_Parameters = ParamSpec("_Parameters")

#: Seconds for a process to be made ready, kernels to be compiled among it; and seconds that a plug-in has for that.
TO_PREPARE, TO_STATE = 900.0, 60.0
#: Seconds to wait for a scheduler to answer.
_TO_CONNECT = 10


class Slot(Generic[_Context]):
    """A `Worker` a distribution: one for our solvers and one for those of each plug-in, which costs its own cells only.

    One more for each of the `interpreters` of other environments; `worker_of` gives it.

    Without `isolate` all is called in this process: to look into solvers with a debugger, and for quick tests.
    """

    def __init__(
        self,
        context: _Context,
        log: Path | None = None,
        *,
        isolate: bool = True,
        interpreters: Sequence[Path] = (),
    ) -> None:
        self.context, self.isolate = context, isolate
        self._origins = origins()
        self._workers = {origin: Worker(context, log) for origin in self._origins.values()}
        self._elsewhere = {python: Worker(context, log, python) for python in interpreters}
        self._deaths: Counter[str] = Counter()
        #: What its solvers have said, once they were asked (`chunk.solver_versions`).
        self.versions: dict[str, str] = {}

    def start(self) -> None:
        """Start the process of our solvers, while the caller goes on."""
        if self.isolate:
            self._worker(None).start()

    def call(
        self,
        solver: str | None,
        function: Callable[[_Context, *_Arguments], _Answer],
        *arguments: *_Arguments,
        timeout: float,
    ) -> _Answer:
        """Return ``function(context, *arguments)`` of the process of a solver, or of ours; as `Worker.call`."""
        if not self.isolate:
            return function(self.context, *arguments)
        return self._worker(solver).call(function, *arguments, timeout=timeout)

    def prepare(
        self, solver: str, function: Callable[[_Context, *_Arguments], bool], *arguments: *_Arguments
    ) -> None:
        """Call for a solver, once in each process; not where two have died of it: then its cells are to say so.

        A process in which it is True, for kernels were compiled there, is replaced by one that reads them (`warm`).
        """
        worker, replaced = self._worker(solver), False
        limit = TO_PREPARE if is_ours(solver) else TO_STATE
        while solver not in worker.ready and self._deaths[solver] < 2:
            try:
                compiled = self.call(solver, function, *arguments, timeout=limit)
            except FaultError:
                self._deaths[solver] += 1
                continue
            if compiled and not replaced:
                worker.end()
                replaced = True  # once: a cache that cannot be written is none for the next process either
            else:
                worker.ready.add(solver)

    def compile(self, function: Callable[[_Context, *_Arguments], object], *arguments: *_Arguments) -> None:
        """Have kernels compiled by a process of ours, which is replaced then; where it dies, cells are to say so."""
        with suppress(FaultError):
            self.call(None, function, *arguments, timeout=TO_PREPARE)
        self._worker(None).end()

    def close(self) -> None:
        """End all processes, whatever they do; safe from any thread, and at any time."""
        for worker in (*self._workers.values(), *self._elsewhere.values()):
            worker.close()

    def worker_of(self, python: Path) -> Worker[_Context]:
        """Return the worker of one of the interpreters."""
        return self._elsewhere[python]

    def _worker(self, solver: str | None) -> Worker[_Context]:
        return self._workers[self._origins[solver or REFERENCE]]


class _AtOnce(Executor):
    """Calls in the caller's thread: a crash of a solver is one of the caller."""

    def submit(
        self, fn: Callable[_Parameters, _Answer], /, *args: _Parameters.args, **kwargs: _Parameters.kwargs
    ) -> Future[_Answer]:
        future: Future[_Answer] = Future()
        try:
            future.set_result(fn(*args, **kwargs))
        except Exception as error:
            future.set_exception(error)
        return future


class SlotPool(Protocol[_Context]):
    """Threads, here or of a cluster, each with a slot of its own."""

    @property
    def workers(self) -> int:
        """Number of threads now."""
        ...

    def submit(
        self, function: Callable[[Slot[_Context], *_Arguments], _Answer], *arguments: *_Arguments
    ) -> Future[_Answer]:
        """Have ``function(slot, *arguments)`` called."""
        ...

    def here(
        self, function: Callable[[Slot[_Context], *_Arguments], _Answer], *arguments: *_Arguments
    ) -> Future[_Answer]:
        """Have the same called on this machine, wherever all else is called."""
        ...

    def close(self, *, now: bool = False) -> None:
        """End threads and processes; `now` whatever they do."""
        ...


class Pool(Generic[_Context]):
    """Threads of this process, each with a slot; without `isolate` of the slots this thread."""

    def __init__(self, make_slot: Callable[[], Slot[_Context]], workers: int) -> None:
        self.workers = workers
        self._slots = [make_slot() for _ in range(workers)]
        self._threads = ThreadPoolExecutor(workers) if self._slots[0].isolate else _AtOnce()
        self._unused: queue.SimpleQueue[Slot[_Context]] = queue.SimpleQueue()
        for slot in self._slots:
            self._unused.put(slot)
            # By one of these threads: a process ends with its thread, and they live as long as the pool.
            self._threads.submit(slot.start)

    def submit(
        self, function: Callable[[Slot[_Context], *_Arguments], _Answer], *arguments: *_Arguments
    ) -> Future[_Answer]:
        """Have ``function(slot, *arguments)`` called."""
        return self._threads.submit(lambda: self._call(function, *arguments))

    def here(
        self, function: Callable[[Slot[_Context], *_Arguments], _Answer], *arguments: *_Arguments
    ) -> Future[_Answer]:
        """Have the same called: all threads are on this machine."""
        return self.submit(function, *arguments)

    def close(self, *, now: bool = False) -> None:
        """End threads and processes; `now` whatever they do."""
        self._threads.shutdown(wait=not now, cancel_futures=now)
        for slot in self._slots:
            slot.close()
        self._threads.shutdown()

    def _call(
        self, function: Callable[[Slot[_Context], *_Arguments], _Answer], *arguments: *_Arguments
    ) -> _Answer:
        slot = self._unused.get()
        try:
            return function(slot, *arguments)
        finally:
            self._unused.put(slot)


class _HasAddress(Protocol):
    """The scheduler of a cluster, of which only the address is used."""

    address: str


class ClusterClient(Protocol):
    """The part of a `distributed.Client` that is used here; its own annotations are those of coroutines."""

    scheduler: _HasAddress
    status: str

    def wait_for_workers(self, n_workers: int) -> None:
        """Wait until there are so many workers."""
        ...

    def get_executor(self, *, pure: bool) -> Executor:
        """Return an executor of the cluster; what is not `pure` is called every time."""
        ...

    def nthreads(self) -> Mapping[str, int]:
        """Return the number of threads of every worker."""
        ...

    def run(self, function: Callable[[str], None], run: str, *, on_error: str) -> object:
        """Call a function in every worker."""
        ...

    def close(self, timeout: float) -> None:
        """Leave the cluster."""
        ...


class _Dask(Generic[_Context]):
    """The threads of a cluster's workers. None of them runs a solver, so that Dask never sees a crash."""

    def __init__(self, client: ClusterClient, context: _Context, say: Callable[[str], None]) -> None:
        self._client, self._run = client, uuid.uuid4().hex
        #: No function within this one: it is sent to the workers.
        self._make_slot: Callable[[], Slot[_Context]] = partial(Slot, context)
        address = client.scheduler.address
        say(f"Dask cluster at {address}: {self.workers} worker threads")
        if not self.workers:
            say(f"waiting for a worker; start some: dask worker {address} --nthreads 1")
        client.wait_for_workers(1)
        self._executor, self._local = client.get_executor(pure=False), Pool(lambda: Slot(context), 1)

    @property
    def workers(self) -> int:
        """Number of worker threads now: a cluster may grow and shrink."""
        return sum(self._client.nthreads().values())

    def submit(
        self, function: Callable[[Slot[_Context], *_Arguments], _Answer], *arguments: *_Arguments
    ) -> Future[_Answer]:
        return self._executor.submit(_on_worker, self._run, self._make_slot, function, *arguments)

    def here(
        self, function: Callable[[Slot[_Context], *_Arguments], _Answer], *arguments: *_Arguments
    ) -> Future[_Answer]:
        return self._local.submit(function, *arguments)

    def close(self, *, now: bool = False) -> None:
        self._local.close(now=now)
        self._executor.shutdown(wait=False)
        if self._client.status == "running":  # else it is gone
            self._client.run(_end_on_worker, self._run, on_error="ignore")


#: In a worker of Dask: by run the slots of its threads, which live as long as it; None of a run that is over.
_slots: dict[str, dict[int, Slot[Any]] | None] = {}
_lock = threading.Lock()


def _on_worker(
    run: str,
    make_slot: Callable[[], Slot[_Context]],
    function: Callable[[Slot[_Context], *_Arguments], _Answer],
    *arguments: *_Arguments,
) -> _Answer:
    thread = threading.get_ident()
    with _lock:
        slots = _slots.setdefault(run, {})
        if slots is None:
            raise ClosedError
        if thread not in slots:
            slots[thread] = make_slot()
    return function(slots[thread], *arguments)


def _end_on_worker(run: str) -> None:
    with _lock:
        slots, _slots[run] = _slots.get(run), None
    for slot in (slots or {}).values():
        slot.close()


@contextmanager
def open_pool(
    context: _Context,
    workers: int,
    *,
    client: ClusterClient | None = None,
    isolate: bool = True,
    say: Callable[[str], None] = lambda line: None,
    log: Path | None = None,
    interpreters: Sequence[Path] = (),
) -> Generator[SlotPool[_Context]]:
    """Give a pool, here or of a Dask cluster; all it started is gone when the block ends, at once if by an error.

    `context`, `log`, `isolate` and `interpreters` are of every `Slot`; those of a cluster have the context alone.
    """
    pool: SlotPool[_Context]
    if client is None:

        def make_slot() -> Slot[_Context]:
            return Slot(context, log, isolate=isolate, interpreters=interpreters)

        pool = Pool(make_slot, workers if isolate else 1)
    else:
        pool = _Dask(client, context, say)
    try:
        yield pool
    except BaseException:
        pool.close(now=True)
        raise
    pool.close()


@contextmanager
def cluster(scheduler: str | None) -> Generator[ClusterClient | None]:
    """Give a client of a Dask cluster, None without a scheduler.

    One that does not answer is a UserError, a cluster that is lost an InterruptedRunError.
    """
    if scheduler is None:
        yield None
        return
    try:
        from distributed import Client
        from distributed.comm.core import CommClosedError
        from distributed.scheduler import KilledWorker
    except ImportError as error:
        raise UserError(
            f"--scheduler {scheduler}: needs Dask ({error}); run pip install 'impact-xval[cluster]'"
        ) from None
    try:
        client = cast(ClusterClient, Client(scheduler, timeout=_TO_CONNECT))
    except (OSError, TimeoutError, ValueError, TypeError) as error:
        raise UserError(
            f"--scheduler {scheduler}: no Dask scheduler answers there ({_short(error)}); legal: an "
            "address such as tcp://host:8786 or, with certificates, tls://host:8786"
        ) from None
    try:
        yield client
    except KilledWorker as error:
        raise InterruptedRunError(f"too many workers of the cluster died: {_short(error)}") from None
    except (CancelledError, CommClosedError) as error:
        raise InterruptedRunError(f"the Dask cluster at {scheduler} is gone: {_short(error)}") from None
    finally:
        client.close(timeout=2)


def _short(error: BaseException) -> str:
    return f"{error!s:.200}" or type(error).__name__


def answers_in_flight(
    submit: Callable[[_Task], Future[_Answer]], tasks: Iterable[_Task], capacity: Callable[[], int]
) -> Iterator[_Answer]:
    """Yield answers as they come, with so many tasks handed out at once; each is made when it is."""
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
