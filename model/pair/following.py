"""Functions that call the kernel of two balls in threads, and return velocities alone, or also states or paths.

All results are in units of m1, k1 and abs(v0).

Needs `pair.kernel`. Used by `model.solving`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from impact_xval.model.arrays import Floats, Records
from impact_xval.model.compiled import STATE_ROWS, run_in_threads
from impact_xval.model.pair.kernel import collide_all
from impact_xval.model.pair.record import PATH_POINT, RESULT, PairLogs, PairOptions, PairRatios

#: Number of collisions that a thread follows in one call of the kernel.
SHARE = 8192

#: Number of points per collision for which the log of the motion has room at first.
POINT_ROWS = 512

_NO_PATH = np.empty(0, PATH_POINT).view(np.recarray)
_NO_STATES = np.empty((0, 1), np.uint64)


class PairResult(NamedTuple):
    """Result of the kernel of two balls for n collisions."""

    #: Final velocities v1 and v2, divided by abs(v0), shape (n, 2); NaN where there is no result.
    velocities: Floats
    #: Records of `pair.record.RESULT`, shape (n,).
    records: Records


def _empty_result(n: int) -> PairResult:
    return PairResult(np.empty((n, 2)), np.empty(n, RESULT).view(np.recarray))


def follow_pairs(cells: PairRatios, options: PairOptions) -> PairResult:
    """Follow collisions to their ends, and return velocities and records without states and paths."""
    result = _empty_result(len(cells.kappa))

    def follow_share(share: slice, _log: NDArray[np.uint64]) -> int:
        logs = PairLogs(_NO_PATH, _NO_STATES)
        collide_all(cells.take(share), options, logs, result.velocities[share], result.records[share])
        return 0

    run_in_threads(
        follow_share, len(cells.kappa), share=SHARE, log_rows=0, row_shape=(1,), log_type=np.dtype(np.uint64)
    )
    return result


def follow_with_states(cells: PairRatios, options: PairOptions) -> tuple[PairResult, NDArray[np.uint64]]:
    """Follow collisions to their ends. Also return the sets of active contacts of all states, as in `PairLogs.sets`."""
    result = _empty_result(len(cells.kappa))

    def follow_share(share: slice, log: NDArray[np.uint64]) -> int:
        logs = PairLogs(_NO_PATH, log)
        collide_all(cells.take(share), options, logs, result.velocities[share], result.records[share])
        return int(result.records.n_states[share].sum())

    sets = run_in_threads(
        follow_share,
        len(cells.kappa),
        share=SHARE,
        log_rows=STATE_ROWS,
        row_shape=(1,),
        log_type=np.dtype(np.uint64),
    )
    return result, sets


def follow_with_paths(cells: PairRatios, options: PairOptions) -> tuple[PairResult, Records]:
    """Follow collisions to their ends. Also return the points of their motion, as records of `PATH_POINT`."""
    result = _empty_result(len(cells.kappa))

    def follow_share(share: slice, log: NDArray[np.void]) -> int:
        logs = PairLogs(log.view(np.recarray), _NO_STATES)
        collide_all(cells.take(share), options, logs, result.velocities[share], result.records[share])
        return int(result.records.n_points[share].sum())

    points = run_in_threads(
        follow_share, len(cells.kappa), share=SHARE, log_rows=POINT_ROWS, row_shape=(), log_type=PATH_POINT
    )
    return result, points.view(np.recarray)
