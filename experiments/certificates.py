"""What a run's convergence certificates say: how far each engine is from its limit, and how well that is known.

Where the exact Kelvin-Voigt contacts are part of the run, the certificates are held against them: they are what the
engines were asked for, solved by other means.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow.compute as pc

from experiments.divergence import COMPARABLE
from experiments.document import Block, Heading, Paragraph, Table
from experiments.streams import selected

#: The solver whose contacts the engines are asked for.
ASKED = "kelvin-voigt"

#: An estimate is honest where the true error is at most this many times as large.
HONEST = 3.0

#: A pandas DataFrame or Series; annotations are too wide to check code against.
Frame = Any


_ENDS = ("cell", "solver", "status", "v0", "v1", "v2")
_LIMIT = ("v1_limit", "v2_limit", "limit_error", "order", "regularisation")


def certificates(path: Path, solvers: list[str]) -> Frame:
    """Compute a row for every solver with certificates, from the table of cells.

    Columns: ``solver``; ``n`` certificates, ``converged`` of them; ``order``, the median; ``error_median``,
    ``error_p95``, ``error_max``, estimated errors of the converged; ``regularisation``, its largest; ``step_median``,
    ``step_p95``, ``step_max``, distances of the velocities at the step from the limit; and, NaN without `ASKED`,
    ``asked_median``, ``asked_p95``, ``asked_max``, distances of the converged limits from it, and ``honest``, the share
    of them that are at most `HONEST` times the estimate. Everything per abs(v0), the larger of both balls.
    """
    rows = []
    asked = _rows(path, _ENDS, (pc.field("solver") == ASKED) & pc.field("status").isin(list(COMPARABLE)))
    for name in solvers:
        found = _rows(path, _ENDS + _LIMIT, (pc.field("solver") == name) & pc.field("v1_limit").is_valid())
        if not len(found):
            continue
        good = found[found.status.isin(COMPARABLE)]
        speed = found.v0.abs()
        away = _larger(found.v1 / speed - found.v1_limit, found.v2 / speed - found.v2_limit)
        row: dict[str, Any] = {"solver": name, "n": len(found), "converged": len(good)}
        row |= {"order": found.order.median(), "regularisation": found.regularisation.max()}
        row |= _cuts("error", good.limit_error) | _cuts("step", away)
        truth = asked.reindex(good.index)
        speed = good.v0.abs()
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


def certificate_blocks(table: Frame) -> list[Block]:
    """Say and tabulate it; nothing for a run without certificates."""
    if not len(table):
        return []
    return [
        Heading("In the limit of small steps"),
        *(Paragraph(_sentence(row)) for row in table.itertuples()),
        _table(table),
    ]


def _text(value: float) -> str:
    return "-" if np.isnan(value) else f"{float(f'{value:.2g}'):g}"


def _sentence(row: Any) -> str:
    text = (
        f"{row.solver}: {row.converged} of {row.n} limits are converged. At the step that was run the velocities are "
        f"{_text(row.step_median)} |v0| from the limit in the median and {_text(row.step_max)} at most."
    )
    if row.regularisation > 0:
        text += (
            f" Its regularisation, which no step removes, moves them by up to {_text(row.regularisation)}."
        )
    if not np.isnan(row.honest):
        text += (
            f" The converged limits are {_text(row.asked_median)} (median) and at most {_text(row.asked_max)} from the "
            f"exact Kelvin-Voigt contacts that were asked for; that is within {HONEST:g} times the estimated error in "
            f"{100 * row.honest:.1f} % of the cells."
        )
    return text


def _table(table: Frame) -> Table:
    names = ("median", "p95", "max")
    rows = [
        (
            str(row["solver"]),
            f"{row['converged']} of {row['n']}",
            _text(row["order"]),
            *(
                " / ".join(_text(row[f"{kind}_{cut}"]) for cut in names)
                for kind in ("step", "error", "asked")
            ),
            _text(row["regularisation"]),
            "-" if np.isnan(row["honest"]) else f"{100 * row['honest']:.1f} %",
        )
        for _, row in table.iterrows()
    ]
    return Table(
        "Convergence certificates: velocities per |v0|, the larger of both balls, median / 95th percentile / maximum. "
        f"The last column is the share of limits within {HONEST:g} times the estimate of the Kelvin-Voigt contacts",
        (
            "solver",
            "converged",
            "order (median)",
            "step to limit",
            "estimated error",
            "limit to Kelvin-Voigt",
            "regularisation (max)",
            "honest",
        ),
        rows,
    )
