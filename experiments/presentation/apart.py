"""Work on the folder of a run by a process of its own, while this one goes on."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from impact_xval.experiments.config.errors import UserError
from impact_xval.experiments.sweep.pool import TO_PREPARE, Slot, open_pool
from impact_xval.experiments.sweep.process import FaultError, in_halves
from impact_xval.experiments.tables.folder import RunFolder

#: Waits for an answer, and gives it.
Wait = Callable[[], Any]


@contextmanager
def process_apart(folder: RunFolder) -> Iterator[Callable[[Callable[[RunFolder], Any]], Wait]]:
    """Give what has a process call a function with the folder, and returns what waits for its answer.

    The functions are at the top level of modules, and called one after the other. What waits raises an `OSError` or
    a `UserError` of the function, and a `FaultError` where the process died of it twice.
    """
    with open_pool(folder, 1) as pool:

        def begin(work: Callable[[RunFolder], Any]) -> Wait:
            answer = pool.submit(_call, work)

            def wait() -> Any:
                found = answer.result()
                if isinstance(found, Exception):
                    raise found
                return found

            return wait

        yield begin


def _call(slot: Slot, work: Callable[[RunFolder], Any]) -> Any:
    def call(_: slice) -> Any:
        return slot.call(None, _answer, work, timeout=TO_PREPARE)

    def lost(_: slice, fault: FaultError) -> Exception:
        return fault

    return in_halves(call, 1, lost)[0]


def _answer(folder: RunFolder, work: Callable[[RunFolder], Any]) -> Any:
    try:
        return work(folder)
    except (OSError, UserError) as error:
        return error
