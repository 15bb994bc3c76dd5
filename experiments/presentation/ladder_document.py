"""The ladders of a run as tables and sentences."""

from __future__ import annotations

import numpy as np

from impact_xval.experiments.config.axes import AXES
from impact_xval.experiments.measures.ladder import CANCEL, cancelling
from impact_xval.experiments.measures.ladder_summary import (
    BAND,
    BANDS,
    Frame,
    LadderSummary,
)
from impact_xval.experiments.measures.ladder_table import NO_LIMIT
from impact_xval.experiments.measures.rungs import CAUSES, RUNGS, Rung
from impact_xval.experiments.presentation.ladder_figures import present
from impact_xval.experiments.tables.document import (
    Block,
    Heading,
    Paragraph,
    Table,
)
from impact_xval.experiments.tables.numbers import number, percent

#: Longest table along an axis.
_ROWS = 40

#: What a reader has to know of every number here; in every caption.
SHARES = (
    "The share of a cause is the component of its difference of (v1, v2) along the whole difference, in the kinetic "
    "norm, over D: signed, and 100 % in sum. Over a region: summed over cells, over the sum of D. Frozen positions, "
    "dissipation law and gravity are three switches between the model and the law of the engine; each is the mean over "
    "the six orders of turning them on, and in brackets stand the least and the largest share by these orders. Where "
    f"one share is above {100 * CANCEL[1]:g} % and another below {100 * CANCEL[0]:g} %, two large causes cancel."
)


def ladder_section(ladder: LadderSummary) -> list[Block]:
    """Arrange what the divergence is made of; nothing where no engine has a result."""
    if not ladder.solvers:
        return []
    return [
        Heading("Why they diverge"),
        Paragraph(
            "Between the model and what an engine was asked for one thing is changed at a time, in every order, and "
            "the mean differences sum to the engine's divergence exactly, in every cell: "
            + "; ".join(_meaning(rung) for rung in present(ladder))
            + ". All but what begins or ends with the engine is computed without one."
        ),
        share_table(ladder),
        norm_table(ladder),
        *(axis_share_table(ladder, axis) for axis in AXES),
        *([alternatives_table(ladder)] if len(ladder.alternatives) else []),
    ]


def ladder_findings(ladder: LadderSummary) -> list[str]:
    """Say in plain words which cause carries most, by engine and by region."""
    return [_finding(ladder, solver) for solver in ladder.solvers] + _what_if(ladder)


def _meaning(rung: Rung) -> str:
    if rung in CAUSES:
        return f"{rung.label}, from {rung.before} to {rung.after}"
    return f"{rung.label}, {rung.after} minus {rung.before}"


def _label(name: str) -> str:
    return next(rung.label for rung in RUNGS if rung.name == name)


def _finding(ladder: LadderSummary, solver: str) -> str:
    whole = ladder.region(solver)
    ordered = whole.share.sort_values(ascending=False)
    parts = [f"{share_text(whole, str(name))} {_label(str(name))}" for name in ordered.index]
    bands = []
    for edge, band in BANDS.items():
        region = ladder.region(solver, BAND, edge)
        if len(region):
            name = str(region.share.idxmax())
            bands.append(f"{_label(name)}, {share_text(region, name)}, at {band}")
    where = f" The largest cause is {'; '.join(bands)}." if len(bands) > 1 else ""
    agreed = whole.agreed.iloc[0]
    same = f" In {percent(agreed)} of the cells it is the same by all six orders." if agreed < 1 else ""
    detour = float((whole["mean"] * whole.n).sum() / whole.n.max() / whole.total.iloc[0])
    against = (
        f" The causes are {number(detour, 2)} times as long as their sum: in part they cancel."
        if detour > 1.2
        else ""
    )
    doubt = whole.doubt.iloc[0]
    known = (
        f" Its limit of small steps is known to {number(doubt, 2)} (median): mapping and time step are told apart to "
        "within that."
        if not np.isnan(doubt)
        else ""
    )
    return f"Of {solver}'s mean D of {number(whole.total.iloc[0])}: {'; '.join(parts)}.{where}{same}{against}{known}"


def _what_if(ladder: LadderSummary) -> list[str]:
    table = ladder.alternatives
    whole = table[np.isnan(table.value.astype(float))].set_index("law")
    if len(whole) < 2:
        return []
    best = str(whole["median"].idxmin())
    listed = ", ".join(f"{law} {number(row['median'])}" for law, row in whole.iterrows())
    return [
        f"What if the contacts lost energy by another law? Without an engine and without gravity the median D from "
        f"the model is: {listed}. The smallest is that of {best}."
    ]


def share_text(region: Frame, name: str) -> str:
    """Write the share of a rung of a region with its range; of two large causes that cancel, that they do."""
    if name not in region.index:
        return "-"
    row = region.loc[name]
    pair = cancelling(region.share)
    if pair is not None and name in region.index[list(pair)]:
        return f"cancels (norm {number(row['mean'])})"
    share, low, high = percent(row.share), percent(row.low), percent(row.high)
    return share if low == high else f"{share} ({low.removesuffix(' %')} to {high.removesuffix(' %')})"


def _shares(region: Frame, rungs: list[Rung]) -> list[str]:
    return [share_text(region, rung.name) for rung in rungs]


def share_table(ladder: LadderSummary) -> Table:
    """Tabulate the share of every rung by engine and by band of k2/k1."""
    rungs, rows = present(ladder), []
    for solver in ladder.solvers:
        for axis, value, label in (("all", np.nan, "all"), *((BAND, e, text) for e, text in BANDS.items())):
            region = ladder.region(solver, axis, value)
            if len(region):
                mean = number(region.total.iloc[0])
                rows.append((solver, label, str(int(region.n.max())), mean, *_shares(region, rungs)))
    joined = "engine" in {rung.name for rung in rungs}
    note = f" Mapping and time step are one cause where there is {NO_LIMIT.removesuffix(' for this cell')}."
    return Table(
        f"What the mean D of each engine is made of. {SHARES}{note if joined else ''}",
        ("engine", "region", "cells", "mean D", *(rung.label for rung in rungs)),
        rows,
        text_columns=2,
    )


def norm_table(ladder: LadderSummary) -> Table:
    """Tabulate how large each rung is by itself."""
    rows = []
    for solver in ladder.solvers:
        for name, row in ladder.region(solver).iterrows():
            numbers = (number(row[cut]) for cut in ("mean", "median", "p95", "max"))
            rows.append((solver, _label(str(name)), str(int(row.n)), *numbers, percent(row.dominant)))
    return Table(
        "How large each cause is by itself: kinetic norm of its difference of (v1, v2), per |v0|. Norms do not add; "
        "causes may oppose each other. Last column: cells in which the cause has the largest share.",
        ("engine", "cause", "cells", "mean", "median", "95th percentile", "maximum", "largest in"),
        rows,
        text_columns=2,
    )


def axis_share_table(ladder: LadderSummary, axis: str) -> Table:
    """Tabulate the shares along one axis of the grid."""
    rungs, rows = present(ladder), []
    here = ladder.statistics[ladder.statistics.axis == axis]
    values = sorted(set(here.value))
    step = -(-len(values) // _ROWS)
    for solver in ladder.solvers:
        for value in values[::step]:
            region = ladder.region(solver, axis, value)
            if len(region):
                mean = number(region.total.iloc[0])
                rows.append((solver, number(value), mean, *_shares(region, rungs)))
    note = f" {len(values[::step])} of {len(values)} values; all are in summary.csv." if step > 1 else ""
    return Table(
        f"What the mean D is made of, by {AXES[axis]}. {SHARES}{note}",
        ("engine", AXES[axis], "mean D", *(rung.label for rung in rungs)),
        rows,
        text_columns=1,
        detail=axis != "stiffness_ratio",
    )


def alternatives_table(ladder: LadderSummary) -> Table:
    """Tabulate what other laws would do."""
    rows = []
    for row in ladder.alternatives.itertuples():
        region = BANDS.get(row.value, "all")
        cells = (
            str(row.n),
            number(row.median),
            number(row.p95),
            number(row.dissipation),
            percent(row.closer),
        )
        rows.append((row.law, region, *cells))
    return Table(
        "What if the contacts lost energy by another law: D from the model of each law, exact and without gravity; the "
        "norm of its difference from bistiffness, which is what its own dissipation adds; and the cells in which it is "
        "closer to the model than kelvin-voigt.",
        ("law", "region", "cells", "D, median", "95th percentile", "dissipation, median", "closer"),
        rows,
        text_columns=2,
    )


def csv_rows(ladder: LadderSummary) -> Frame:
    """Return the statistics in the columns of ``summary.csv``: a share, its range and a norm, by rung and region."""
    table = ladder.statistics.assign(cells="regular")
    frames = [table.assign(measure="norm_" + table.rung)]
    for measure, statistic in (("share", "share"), ("share_low", "low"), ("share_high", "high")):
        shares = table.assign(measure=f"{measure}_" + table.rung, mean=table[statistic])
        shares[["median", "p95", "max"]] = np.nan
        frames.append(shares)
    left_out = ["rung", "total", "share", "low", "high", "dominant", "agreed", "doubt"]
    return [frame.drop(columns=left_out) for frame in frames]
