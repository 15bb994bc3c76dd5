"""Work on the folder of a run by other processes, while this one goes on."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from typing import Any

from impact_xval.experiments.config.errors import UserError
from impact_xval.experiments.measures.summary import load_divergence
from impact_xval.experiments.presentation.page.cells import packed_cells
from impact_xval.experiments.presentation.page.tiles import Tiles, tiles_of
from impact_xval.experiments.sweep.designs import cells_of_run
from impact_xval.experiments.sweep.examination import traps_note
from impact_xval.experiments.sweep.executors import in_this_process, open_executor
from impact_xval.experiments.sweep.sandbox import TO_PREPARE, FaultError, Sandbox, in_halves
from impact_xval.experiments.tables.store import RunFolder

#: Waits for an answer, and gives it.
Wait = Callable[[], Any]


@dataclass(frozen=True, slots=True)
class Apart:
    """Waits for what other processes do for the page of a run of two balls.

    Attributes
    ----------
    opened : Wait
        Lays out the map whose tiles open, and collects what they open.
    traps : Wait
        Examines scenes: engines are imported, and may crash.
    figures : Wait, optional
        Draws those that need no summary (`figures.draw_unsummarised`); None where nobody does.
    """

    opened: Wait
    traps: Wait
    figures: Wait | None = None


@contextmanager
def begun(folder: RunFolder, executor: Any = None, *, figures: bool = False) -> Iterator[Apart | None]:
    """Begin all that needs no summary; nothing is, of a run of columns.

    Parameters
    ----------
    folder : RunFolder
    executor : optional
        The one that has solved the run: its processes have imported and compiled what most of this needs. By default,
        and where they are on other machines, a process is started.
    figures : bool
        Whether those that need no summary are drawn.
    """
    if folder.config().column is not None:
        yield None
        return
    with workers_apart(folder, executor) as begin:
        yield Apart(begin(_opened), begin(_traps), begin(_figures) if figures else None)


@contextmanager
def workers_apart(
    folder: RunFolder, executor: Any = None
) -> Iterator[Callable[[Callable[[RunFolder], Any]], Wait]]:
    """Give what has a process call a function with the folder, and returns what waits for its answer.

    The functions are at the top level of modules. What waits raises an `OSError` or a `UserError` of the function, and
    a `FaultError` where the process died of it twice.
    """
    with ExitStack() as stack:
        if executor is None or not in_this_process(executor):
            executor = stack.enter_context(open_executor(folder, _ready, 1))

        def begin(work: Callable[[RunFolder], Any]) -> Wait:
            answer = executor.submit(_call, folder, work)

            def wait() -> Any:
                found = answer.result()
                if isinstance(found, Exception):
                    raise found
                return found

            return wait

        yield begin


def _ready(context: Any) -> None:
    """Prepare for nothing: each function has imported what it needs."""


def _call(sandbox: Sandbox, folder: RunFolder, work: Callable[[RunFolder], Any]) -> Any:
    def call(_: slice) -> Any:
        return sandbox.call(_answer, folder, work, timeout=TO_PREPARE)

    def lost(_: slice, fault: FaultError) -> Exception:
        return fault

    return in_halves(call, 1, lost)[0]


def _answer(context: Any, folder: RunFolder, work: Callable[[RunFolder], Any]) -> Any:
    try:
        return work(folder)
    except (OSError, UserError) as error:
        return error


def _opened(folder: RunFolder) -> tuple[Tiles, str]:
    tiles = tiles_of(load_divergence(folder, folder.config()))
    return tiles, packed_cells(folder, tiles.cells)


def _traps(folder: RunFolder) -> dict[str, Any]:
    config = folder.config()
    return traps_note(config, cells_of_run(folder, config))


def _figures(folder: RunFolder) -> dict[str, str]:
    # Imported by who draws: the others go on without matplotlib.
    from impact_xval.experiments.presentation.figures import draw_unsummarised

    return draw_unsummarised(folder)
