"""Pools of threads that do the work of a sweep, in this process or on a Dask cluster.

Each thread has a `Slot`, which holds worker processes that no other thread uses. A pool calls a submitted function as
``function(slot, *arguments)`` in one of its threads. No result depends on the machine or on the number of threads.

`open_pool` makes a pool, and `cluster` connects to Dask. `run`, `one` and `scoreboard.playing` use this module.
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

#: Time limits in seconds. `TO_PREPARE` is the limit for making a process ready for a solver of this project, including
#: the compilation of kernels. `TO_STATE` is the limit for making a process ready for a solver of a plug-in, and for
#: asking any solver for its version.
TO_PREPARE, TO_STATE = 900.0, 60.0
#: Seconds to wait for the answer of a Dask scheduler.
_TO_CONNECT = 10


class Slot(Generic[_Context]):
    """Worker processes that belong to one thread of a pool.

    One worker runs the solvers of this project. Each installed plug-in has another worker for its solvers. So if a
    plug-in crashes, only cells of this plug-in are lost. `interpreters` are the Python programs of other environments.
    Each of them has one more worker, which `worker_of` returns.

    If `isolate` is false, there are no worker processes, and every function is called in this process. This is meant
    for debugging solvers and for quick tests.
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
        #: Versions of the solvers by name; empty until `chunk.solver_versions` has asked the solvers.
        self.versions: dict[str, str] = {}

    def start(self) -> None:
        """Start the worker process of the project's solvers. The caller does not wait until it has started."""
        if self.isolate:
            self._worker(None).start()

    def call(
        self,
        solver: str | None,
        function: Callable[[_Context, *_Arguments], _Answer],
        *arguments: *_Arguments,
        timeout: float,
    ) -> _Answer:
        """Return ``function(context, *arguments)``, computed in the worker process of a solver (`Worker.call`).

        If no solver is given, the worker process of the project's solvers computes the value.
        """
        if not self.isolate:
            return function(self.context, *arguments)
        return self._worker(solver).call(function, *arguments, timeout=timeout)

    def prepare(
        self, solver: str, function: Callable[[_Context, *_Arguments], bool], *arguments: *_Arguments
    ) -> None:
        """Call a function that makes the solver's process ready, once in each process.

        The function returns whether it has compiled kernels (`chunk.warm`). If the function has compiled kernels, the
        process is replaced by another process, which reads these kernels from the cache. If two processes die in this
        call, the function is not called again for the solver. The solver's cells then fail in the same way, and their
        rows say so.
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
                replaced = True  # replace it only once: if the cache cannot be written, the next process compiles too
            else:
                worker.ready.add(solver)

    def compile(self, function: Callable[[_Context, *_Arguments], object], *arguments: *_Arguments) -> None:
        """Call a function that compiles kernels in the worker process of the project's solvers, and end that process.

        The next call starts a new process, which reads the kernels from the cache. If the process dies while it
        compiles, no error is raised here. The cells that need the kernels fail later, and their rows say so.
        """
        with suppress(FaultError):
            self.call(None, function, *arguments, timeout=TO_PREPARE)
        self._worker(None).end()

    def close(self) -> None:
        """End all worker processes for good, even during a call. Any thread may call this method at any time."""
        for worker in (*self._workers.values(), *self._elsewhere.values()):
            worker.close()

    def worker_of(self, python: Path) -> Worker[_Context]:
        """Return the worker of one of the interpreters that the slot was made with."""
        return self._elsewhere[python]

    def _worker(self, solver: str | None) -> Worker[_Context]:
        return self._workers[self._origins[solver or REFERENCE]]


class _AtOnce(Executor):
    """Executor that calls functions at once in the caller's thread. If a solver crashes, this process ends."""

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
    """Pool of threads in this process or on a cluster; each thread has its own `Slot` of worker processes."""

    @property
    def workers(self) -> int:
        """Number of threads that the pool has at this moment."""
        ...

    def submit(
        self, function: Callable[[Slot[_Context], *_Arguments], _Answer], *arguments: *_Arguments
    ) -> Future[_Answer]:
        """Have ``function(slot, *arguments)`` called by a thread of the pool; return the future of its result."""
        ...

    def here(
        self, function: Callable[[Slot[_Context], *_Arguments], _Answer], *arguments: *_Arguments
    ) -> Future[_Answer]:
        """Have ``function(slot, *arguments)`` called on this machine, even if the pool is a cluster."""
        ...

    def close(self, *, now: bool = False) -> None:
        """End the threads and their worker processes: with `now` at once, otherwise after their last calls."""
        ...


class Pool(Generic[_Context]):
    """Pool of threads in this process, each with a `Slot`.

    If the slots have no worker processes (`isolate` is false), the pool has no threads. Functions are then called in
    the caller's thread.
    """

    def __init__(self, make_slot: Callable[[], Slot[_Context]], workers: int) -> None:
        self.workers = workers
        self._slots = [make_slot() for _ in range(workers)]
        self._threads = ThreadPoolExecutor(workers) if self._slots[0].isolate else _AtOnce()
        self._unused: queue.SimpleQueue[Slot[_Context]] = queue.SimpleQueue()
        for slot in self._slots:
            self._unused.put(slot)
            # The process is started by a thread of the pool, because a process ends with the thread that started it.
            # The threads of the pool live as long as the pool.
            self._threads.submit(slot.start)

    def submit(
        self, function: Callable[[Slot[_Context], *_Arguments], _Answer], *arguments: *_Arguments
    ) -> Future[_Answer]:
        """Have ``function(slot, *arguments)`` called by a thread of the pool; return the future of its result."""
        return self._threads.submit(lambda: self._call(function, *arguments))

    def here(
        self, function: Callable[[Slot[_Context], *_Arguments], _Answer], *arguments: *_Arguments
    ) -> Future[_Answer]:
        """Call `submit`, because all threads of this pool are on this machine."""
        return self.submit(function, *arguments)

    def close(self, *, now: bool = False) -> None:
        """End the threads and their worker processes: with `now` at once, otherwise after their last calls."""
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
    """Scheduler of a Dask cluster. Only the address of the scheduler is used here."""

    address: str


class ClusterClient(Protocol):
    """The methods of a `distributed.Client` that are used here.

    Type checkers need this class, because Dask annotates the methods of its client as coroutines.
    """

    scheduler: _HasAddress
    status: str

    def wait_for_workers(self, n_workers: int) -> None:
        """Wait until the Dask cluster has at least `n_workers` workers."""
        ...

    def get_executor(self, *, pure: bool) -> Executor:
        """Return an executor of the cluster. If `pure` is false, results of equal calls are not reused."""
        ...

    def nthreads(self) -> Mapping[str, int]:
        """Return the number of threads of every worker of the Dask cluster."""
        ...

    def run(self, function: Callable[[str], None], run: str, *, on_error: str) -> object:
        """Call a function in every worker process of the Dask cluster."""
        ...

    def close(self, timeout: float) -> None:
        """Close the connection to the cluster."""
        ...


class _Dask(Generic[_Context]):
    """Pool of the threads of a Dask cluster's workers.

    The threads call solvers in worker processes of this project. So a solver that crashes never ends a worker of Dask.
    """

    def __init__(self, client: ClusterClient, context: _Context, say: Callable[[str], None]) -> None:
        self._client, self._run = client, uuid.uuid4().hex
        #: Makes a slot on a worker of the cluster. This `partial` can be pickled. A function that is defined inside a
        #: method could not be pickled.
        self._make_slot: Callable[[], Slot[_Context]] = partial(Slot, context)
        address = client.scheduler.address
        say(f"Dask cluster at {address}: {self.workers} worker threads")
        if not self.workers:
            say(f"waiting for a worker; start some: dask worker {address} --nthreads 1")
        client.wait_for_workers(1)
        self._executor, self._local = client.get_executor(pure=False), Pool(lambda: Slot(context), 1)

    @property
    def workers(self) -> int:
        """Number of worker threads at this moment; a cluster may grow and shrink."""
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
        if self._client.status == "running":  # otherwise the cluster has ended
            self._client.run(_end_on_worker, self._run, on_error="ignore")


#: Slots in a worker process of Dask, by the id of a run and then by thread. When a run is over, None stands in place of
#: its slots. The threads live as long as the process.
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
    """Yield a pool of threads in this process, or, if there is a client, a pool of threads on a Dask cluster.

    When the `with` block ends, the pool ends its threads and worker processes. It waits for their last calls, unless
    the block ends by an error.

    Parameters
    ----------
    context, log, isolate, interpreters
        Arguments of every `Slot` in this process. Slots on a cluster get only the context.
    workers : int
        Number of threads in this process. The number of threads on a cluster is the cluster's own.
    client : ClusterClient, optional
        Client of a Dask cluster.
    say : callable
        Function that is called with lines about the cluster, which the user should read.
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
    """Yield a client of the Dask cluster at the address of its scheduler; yield None if there is no address.

    Raises
    ------
    UserError
        If Dask is not installed, or no scheduler answers at the address.
    InterruptedRunError
        If the cluster is lost during the block.
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
    """Submit tasks and yield their answers in the order in which they arrive.

    At most `capacity()` tasks are submitted at a time and wait for their answers. The next task is taken from the
    iterable only when it can be submitted.
    """
    pending: set[Future[_Answer]] = set()
    for task in tasks:
        pending.add(submit(task))
        if len(pending) >= capacity():
            finished, pending = wait(pending, return_when=FIRST_COMPLETED)
            yield from (future.result() for future in finished)
    yield from (future.result() for future in as_completed(pending))


def available_cores() -> int:
    """Return the number of processor cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
