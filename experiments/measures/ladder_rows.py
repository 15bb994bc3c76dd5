"""Ladders of engines as columns of their rows: why each diverges from the model, of two balls and of N."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from impact_xval.compliant_baselines.registry import law_of
from impact_xval.compliant_baselines.solver import kinds
from impact_xval.experiments.config.cells import Block
from impact_xval.experiments.config.experiment import REFERENCE, Config
from impact_xval.experiments.measures.corners import Corners, Texts, corner_names, corners
from impact_xval.experiments.measures.ladder import CAUSES, NOTHING, Floats, Split, cancelling, split
from impact_xval.model.collision import RESULT_STATUSES

#: Status of an engine's result that changes with its step: it has a ladder, which no statistic counts.
UNCONVERGED = "unconverged"

#: Why the last two contributions are one.
NO_LIMIT = "no certified limit dt -> 0 for this cell"

#: Least width of a range, and least share beside the largest, that a sentence mentions.
_WIDE, _MENTIONED = 0.005, 0.02

#: Nothing, in the place of a text.
_NONE = np.array(None, dtype=object)

Columns = dict[str, np.ndarray]


def ladders(
    config: Config, block: Block, model: pa.Table, engines: Mapping[str, pa.Table]
) -> dict[str, Columns]:
    """Make the ladders of engines: columns of the table ``ladder``, NaN or None where there is no ladder.

    `model` and `engines` are rows, one a cell.
    """
    columns: dict[str, Columns] = {name: {} for name in engines}
    pair = config.column is None
    for places, collisions in kinds(block.collisions) if engines else ():
        some, speed = model.take(places), np.abs(collisions.velocities).max(axis=1, keepdims=True)
        gravity = np.full(len(places), config.gravity if config.scenario == "drop" else 0.0)
        balls = range(1, 1 + collisions.masses.shape[1])
        reference = of_balls(some, "v{}", balls) / speed
        moving = np.where(collisions.velocities != 0, collisions.masses, 0.0).sum(axis=1, keepdims=True)
        # The corners know nothing of engines: once a law.
        laws = {name: law_of(name) or "" for name in engines}
        known = {law: corners(reference, collisions, gravity, law, pair=pair) for law in set(laws.values())}
        for name, rows in engines.items():
            engine, here = rows.take(places), known[laws[name]]
            velocities = of_balls(engine, "v{}", balls, (*RESULT_STATUSES, UNCONVERGED)) / speed
            limit = of_balls(engine, "v{}_limit", balls)  # one that did not converge is none
            ladder = split(collisions.masses / moving, here, limit, velocities)
            found = _said(name, some, engine, here, ladder)
            ok = ~np.isnan(ladder.divergence) & np.isin(found["status"].tolist(), ("ok", UNCONVERGED))
            found |= _dominant(name, ladder, ok)
            found |= {key: np.where(ok, x, np.nan) for key, x in _parts(here, ladder).items()}
            for key, values in found.items():
                scatter(columns[name], key, values, places, len(block))
    return columns


def scatter(columns: Columns, key: str, values: np.ndarray, places: np.ndarray, n: int) -> None:
    """Put values in their places of a column of length n, which holds NaN or None elsewhere."""
    nothing = np.nan if values.dtype.kind == "f" else None
    columns.setdefault(key, np.full(n, nothing, values.dtype))[places] = values


def of_balls(rows: pa.Table, pattern: str, balls: range, statuses: Sequence[str] = RESULT_STATUSES) -> Floats:
    """Return columns of every ball in their unit, shape (n, N); NaN where the status is none of these."""
    there = np.isin(rows["status"].to_pylist(), statuses)
    columns = [_numbers(rows, pattern.format(i)) for i in balls]
    return np.where(there[:, None], np.column_stack(columns), np.nan)


def _numbers(table: pa.Table, name: str) -> Floats:
    return table[name].to_numpy(zero_copy_only=False).astype(float)


def _texts(table: pa.Table, name: str) -> Texts:
    return np.array(table[name].to_pylist(), dtype=object)


def _said(name: str, model: pa.Table, engine: pa.Table, here: Corners, ladder: Split) -> Columns:
    """Columns of what is known whether or not there is a ladder: the first outcome that is missing, marks, errors."""
    status, of_model = _texts(engine, "status"), _texts(model, "status")
    why = [f"{name}: {reason or x}" for reason, x in zip(_texts(engine, "reason"), status, strict=True)]
    joined = ~np.isnan(ladder.norms[-1])  # mapping and time step are one contribution, the last
    missing = [*(~np.isin(x.tolist(), RESULT_STATUSES) for x in (status, of_model)), here.reason != ""]
    of_corner = np.array([reason.rpartition(" ")[2] for reason in here.reason], dtype=object)
    reasons = [np.array(why, dtype=object), f"{REFERENCE}: " + of_model, here.reason]
    marks = zip(_texts(engine, "marked"), here.mark, strict=True)
    return {
        "status": np.select(missing, [status, of_model, of_corner], "ok"),
        "reason": np.select(missing, reasons, np.where(joined, NO_LIMIT, _NONE)),
        "marked": np.array(["; ".join(filter(None, pair)) for pair in marks], dtype=object),
        "model_grazing_margin": _numbers(model, "grazing_margin"),
        "limit_error": _numbers(engine, "limit_error"),
    }


def _dominant(name: str, ladder: Split, ok: NDArray[np.bool_]) -> Columns:
    """Columns of what carries most of each divergence."""
    first, agreed = np.where(ok, ladder.dominant(), -1), ladder.agreed()
    names = np.array([*(c.name for c in ladder.contributions), None], dtype=object)
    columns, sentences = (ladder.shares, ladder.norms, *ladder.ranges), np.full(len(ok), None, dtype=object)
    for i in np.flatnonzero(ok):
        numbers = zip(*(x[:, i].tolist() for x in columns), strict=True)
        parts = [Part(c.phrase, *row) for c, row in zip(ladder.contributions, numbers, strict=True)]
        found = [part for part in parts if not np.isnan(part.norm)]
        sentences[i] = sentence(name, float(ladder.divergence[i]), found, bool(agreed[i]))
    return {
        "velocity_divergence": np.where(ok, ladder.divergence, np.nan),
        "dominant": names[first],
        "dominant_by_every_order": np.where(first >= 0, agreed.astype(object), _NONE),
        "sentence": sentences,
    }


def _parts(here: Corners, ladder: Split) -> Columns:
    """Columns of contributions and corners."""
    columns: Columns = {f"dv{i}": x for i, x in enumerate(ladder.total.T, 1)}
    shares, (low, high) = ladder.shares, ladder.ranges
    for i, c in enumerate(ladder.contributions):
        columns |= {f"{c.name}_dv{j}": x for j, x in enumerate(ladder.vectors[i].T, 1)}
        columns |= {f"{c.name}_norm": ladder.norms[i], f"{c.name}_share": shares[i]}
        if c in CAUSES:
            columns |= {f"{c.name}_share_low": low[i], f"{c.name}_share_high": high[i]}
    for index, name in corner_names(gravity=here.gravity).items():
        columns |= {f"{name}_v{j}": x for j, x in enumerate(here.velocities[index].T, 1)}
        columns[f"{name}_along"] = np.where(ladder.divergence == 0, 0.0, ladder.corners[index])
    return columns


class Part(NamedTuple):
    """A contribution in a sentence: its phrase, share and norm, and its least and largest share by the orders."""

    phrase: str
    share: float
    norm: float
    low: float
    high: float

    @property
    def percent(self) -> str:
        """The share, with its range where that can be seen."""
        text = f"{100 * self.share:.3g} %"
        return f"{text}, by order {between(self.low, self.high)}" if self.high - self.low >= _WIDE else text


def between(low: float, high: float) -> str:
    """Write a range of shares, in per cent."""
    return f"{100 * low:.3g} to {100 * high:.3g} %"


def sentence(solver: str, divergence: float, parts: Sequence[Part], agreed: bool = True) -> str:
    """Write in words which contribution carries most of a divergence; whether the same by every order, is `agreed`."""
    if divergence < NOTHING:
        return f"{solver} ends where the model does (D = {divergence:.1g}): there is nothing to split."
    pair = cancelling([part.share for part in parts])
    if pair is not None:
        one, two = (f"{parts[i].phrase} (norm {parts[i].norm:.3g})" for i in pair)
        return f"{solver} ends D = {divergence:.3g} from the model, where two large causes cancel: {one} and {two}."
    first, *others = sorted(parts, key=lambda part: -part.share)
    sure = first.low if np.isfinite(first.low) else first.share
    how_much = "most of it" if sure > 0.5 else "the largest part of it"
    how_much += "" if agreed else " (another by another order)"
    text = (
        f"{solver} ends D = {divergence:.3g} from the model, {how_much} by {first.phrase} "
        f"({first.percent}, norm {first.norm:.3g})"
    )
    other = max(others, key=lambda part: abs(part.share))
    if other.share <= -_MENTIONED:
        return f"{text}, taken back in part by {other.phrase} ({other.percent}, norm {other.norm:.3g})."
    if other.share >= _MENTIONED:
        return f"{text}, then by {other.phrase} ({other.percent})."
    return f"{text}."
