"""Convergence estimates of a run: how far each engine is from its limit dt -> 0, and how well that is known.

Where the exact solver of the law an engine was asked for is part of the run, its limits are held against it: the
same contacts, solved by other means. An engine with the naive mapping runs other contacts than it was asked for: its
limit is its own, and is held against nothing.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow.compute as pc
import pyarrow.parquet as pq

from impact_xval.compliant_baselines.solver import MappingName
from impact_xval.experiments.measures.laws import exact_for
from impact_xval.experiments.tables.parquet import selected
from impact_xval.model.collision import RESULT_STATUSES

#: An estimate is honest where the true error is at most this many times as large.
HONEST = 3.0

#: A pandas DataFrame or Series; annotations are too wide to check code against.
Frame = Any

_KNOWN = ("status", "marked", "v0", "limit_error", "limit_distance", "order", "regularisation")


def convergence_estimates(
    path: Path, solvers: list[str], mapping: MappingName = "calibrated", *, marked: bool = True
) -> Frame:
    """Compute a row for every solver with convergence estimates, from the table of cells.

    Columns: ``solver``; ``asked``, the exact solver of the law it was asked for, "" without one; ``n``
    limits, ``converged`` of them; ``order``, the median; ``error_median``, ``error_p95``, ``error_max``,
    estimated errors of the converged; ``regularisation``, the largest of the converged; ``step_median``, ``step_p95``,
    ``step_max``, their distances from the velocities at the step; and, NaN where `asked` is not in the run,
    ``asked_median``, ``asked_p95``, ``asked_max``, distances of the `held` converged limits from it, and ``within`` and
    ``honest``, the shares of them that are at most the estimate, and `HONEST` times that. Everything per abs(v0), the
    largest of all balls. Without `marked` the rows that are count in nothing.
    """
    limits = [name for name in pq.read_schema(path).names if re.fullmatch(r"v\d+_limit", name)]
    columns = ["solver", *_KNOWN, *limits, *(name.removesuffix("_limit") for name in limits)]
    rows = []
    for name in solvers:
        found = selected(path, columns, (pc.field("solver") == name) & pc.field("v1_limit").is_valid())
        if not len(found):
            continue
        table = found.to_pandas(split_blocks=True, self_destruct=True)
        table = table if marked else table[table.marked.isna()]
        good = table[table.status.isin(RESULT_STATUSES)]
        away = [(good[x.removesuffix("_limit")] / good.v0.abs() - good[x]).abs() for x in limits]
        error = good.limit_distance.dropna()
        stated = good.limit_error.loc[error.index]
        row: dict[str, Any] = {"solver": name, "asked": exact_for(name, mapping)}
        row |= {"n": len(table), "converged": len(good), "order": table.order.median()}
        row |= {"regularisation": good.regularisation.max(), **_cuts("error", good.limit_error)}
        row |= _cuts("step", pd.concat(away, axis=1).max(axis=1)) | _cuts("asked", error)
        row |= {"held": len(error), "within": (error <= stated).mean()}
        rows.append(row | {"honest": (error <= HONEST * stated).mean()})
    return pd.DataFrame(rows)


def _cuts(name: str, values: Frame) -> dict[str, float]:
    cuts = (values.median(), values.quantile(0.95), values.max()) if len(values) else (np.nan,) * 3
    return {f"{name}_{cut}": float(value) for cut, value in zip(("median", "p95", "max"), cuts, strict=True)}
