"""Convergence estimates of a run: how far each engine is from its limit dt -> 0, and how well that is known.

Where the exact solver of the law an engine was asked for is part of the run, its limits are held against it: the
same contacts, solved by other means. An engine with the naive mapping runs other contacts than it was asked for: its
limit is its own, and is held against nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow.compute as pc

from impact_xval.compliant_baselines.registry import is_naive, law_of
from impact_xval.compliant_baselines.solver import MappingName
from impact_xval.experiments.tables.streams import selected
from impact_xval.model.collision import RESULT_STATUSES

#: An estimate is honest where the true error is at most this many times as large.
HONEST = 3.0

#: A pandas DataFrame or Series; annotations are too wide to check code against.
Frame = Any


_ENDS = ("cell", "solver", "status", "v0", "v1", "v2")
_LIMIT = ("v1_limit", "v2_limit", "limit_error", "order", "regularisation")


def convergence_estimates(path: Path, solvers: list[str], mapping: MappingName = "calibrated") -> Frame:
    """Compute a row for every solver with convergence estimates, from the table of cells.

    Columns: ``solver``; ``asked``, the exact solver of the law it was asked for, "" without one; ``n``
    limits, ``converged`` of them; ``order``, the median; ``error_median``, ``error_p95``, ``error_max``,
    estimated errors of the converged; ``regularisation``, the largest of the converged; ``step_median``, ``step_p95``,
    ``step_max``, their distances from the velocities at the step; and, NaN where `asked` is not in the run,
    ``asked_median``, ``asked_p95``, ``asked_max``, distances of the converged limits from it, and ``honest``, the share
    of them that are at most `HONEST` times the estimate. Everything per abs(v0), the larger of both balls.
    """
    rows, exact = [], {}
    for name in solvers:
        found = _rows(path, _ENDS + _LIMIT, (pc.field("solver") == name) & pc.field("v1_limit").is_valid())
        if not len(found):
            continue
        good = found[found.status.isin(RESULT_STATUSES)]
        speed = good.v0.abs()
        away = _larger(good.v1 / speed - good.v1_limit, good.v2 / speed - good.v2_limit)
        asked = "" if mapping == "naive" or is_naive(name) else law_of(name) or ""
        row: dict[str, Any] = {"solver": name, "asked": asked, "n": len(found), "converged": len(good)}
        row |= {"order": found.order.median(), "regularisation": good.regularisation.max()}
        row |= _cuts("error", good.limit_error) | _cuts("step", away)
        if asked not in exact:
            answered = (pc.field("solver") == asked) & pc.field("status").isin(list(RESULT_STATUSES))
            exact[asked] = _rows(path, _ENDS, answered)
        truth = exact[asked].reindex(good.index)
        error = _larger(good.v1_limit - truth.v1 / speed, good.v2_limit - truth.v2 / speed).dropna()
        honest = error <= HONEST * good.limit_error.loc[error.index]
        row |= _cuts("asked", error) | {"honest": honest.mean() if len(error) else np.nan}
        rows.append(row)
    return pd.DataFrame(rows)


def _rows(path: Path, columns: Sequence[str], keep: pc.Expression) -> Frame:
    return selected(path, columns, keep).to_pandas(split_blocks=True, self_destruct=True).set_index("cell")


def _larger(first: Frame, second: Frame) -> Frame:
    return pd.concat([first.abs(), second.abs()], axis=1).max(axis=1, skipna=False)


def _cuts(name: str, values: Frame) -> dict[str, float]:
    cuts = (values.median(), values.quantile(0.95), values.max()) if len(values) else (np.nan,) * 3
    return {f"{name}_{cut}": float(value) for cut, value in zip(("median", "p95", "max"), cuts, strict=True)}
