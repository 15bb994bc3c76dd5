"""What a process needs before its first cell: solvers imported, kernels compiled, outside of every limit of a cell.

A kernel is compiled by one process of an installation; others wait for its lock, and read it from the cache then.
"""

from __future__ import annotations

import contextlib
import gc
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from filelock import FileLock
from numba.core import event

from impact_xval.compliant_baselines.answers import answer, stated_version, why_unavailable
from impact_xval.compliant_baselines.engines.stepping import scan
from impact_xval.compliant_baselines.registry import is_engine, is_ours
from impact_xval.experiments.config.cells import Block, experiment_cells
from impact_xval.experiments.config.experiment import REFERENCE, parse_config
from impact_xval.experiments.measures.hausdorff import distances
from impact_xval.experiments.sweep.pool import TO_STATE, Slot
from impact_xval.experiments.sweep.process import in_halves
from impact_xval.experiments.sweep.rows import Experiment, Resolve, settings_of, solve_by
from impact_xval.model.chain.kernel import follow_chains
from impact_xval.model.compiled import cache_folder, is_compiled
from impact_xval.model.pair.kernel import collide_all

#: In the order in which they are locked.
_KERNELS: tuple[Any, ...] = (collide_all, distances, follow_chains, scan)


def warm(_: object, resolve: Resolve, name: str, pair: bool) -> bool:
    """Solve ordinary cells by a solver, of two balls or columns, so that all is imported and compiled; whether any was.

    Such a process may differ in a last bit from those that read the kernels. The parts of a kernel are weak symbols of
    it: where they have just been compiled alone, these are linked, and they were optimised in other surroundings.
    """
    experiment, blocks = _usual(resolve, pair)
    with event.install_recorder("numba:compile") as compiled, _compiling(*kernels_of(name, pair=pair)):
        for block in blocks:
            solve_by(experiment, name, block, {})
    return bool(compiled.buffer)


def compile_own(_: object, resolve: Resolve, names: Sequence[str], pair: bool) -> None:
    """Have each solver solve cells by itself, so that another process can compile the kernels of others meanwhile.

    With the model, distances of nothing are measured, for all others need them.
    """
    experiment, blocks = _usual(resolve, pair)
    alone = replace(settings_of(experiment.config), mark=False)
    own = {kernels_of(name, pair=pair)[0] for name in names}
    with _compiling(*own, *([distances] if collide_all in own else [])):
        for name in names:
            for block in blocks:
                answer(resolve(name), block.collisions, alone)
        if collide_all in own:
            distances(np.empty((0, 2)), np.empty((0, 2)), np.zeros(1, int), np.zeros(1, int))


def _usual(resolve: Resolve, pair: bool) -> tuple[Experiment, list[Block]]:
    """Return an experiment of cells that any solver does at once, one of them and two.

    A column of an array is contiguous where that has one row only, and numba compiles for either.
    """
    grid = {"stiffness_ratio": [1.0, 2.0], "mass_ratio": [2.0], "e1": [0.9], "e2": [0.7]}
    column = {"arrangement": "cradle", "balls": [2], "e": [0.8, 0.9]}
    usual = parse_config({"grid": grid} if pair else {"column": column})
    cells = experiment_cells(usual)
    return Experiment(usual, resolve), [cells.block(range(n)) for n in (1, 2)]


@contextlib.contextmanager
def _compiling(*kernels: Any) -> Iterator[None]:
    """Hold the locks of kernels that are not compiled yet, in one order everywhere."""
    with contextlib.ExitStack() as held:
        for kernel in _KERNELS:
            if kernel in kernels and not is_compiled(kernel):
                held.enter_context(FileLock(cache_folder(kernel) / "compiling.lock"))
                held.callback(gc.enable)
                gc.disable()  # looking for garbage takes up to a tenth of the time of compiling
        yield


def kernels_of(name: str, *, pair: bool) -> list[Any]:
    """Kernels that rows of a solver need, its own first: references, and marks of engines, follow chains."""
    model = collide_all if pair else follow_chains
    if not is_ours(name):
        return [model, distances] if pair else [model]
    own = [scan] if is_engine(name) else []
    if not pair:
        return [*own, model]
    return [model] if name == REFERENCE else [*own, follow_chains, distances, model]


def are_compiled(name: str, *, pair: bool) -> bool:
    """Whether the kernels that rows of a solver need are in the cache."""
    return all(map(is_compiled, kernels_of(name, pair=pair)))


def stated(slot: Slot, resolve: Resolve, name: str) -> tuple[str, str | None]:
    """Ask a solver for its version, and why it cannot run; both in its own process."""
    return in_halves(
        lambda _: slot.call(name, _stated, resolve, name, timeout=TO_STATE),
        1,
        lambda _, fault: ("", f"asked what it is, it gave no answer: {fault.reason}"),
    )[0]


def _stated(_: object, resolve: Resolve, name: str) -> tuple[str, str | None]:
    solver = resolve(name)
    return stated_version(solver), why_unavailable(solver)
