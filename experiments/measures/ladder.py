"""Why an engine diverges from the model: the difference of final velocities, split into its causes (docs/ladder.md).

The three causes stand between the model and the law that the engine was asked for in its scenario: switches, all
combinations of which (`corners`) are known without an engine. A cause is the mean of what its switch changes over the
six orders in which they can be turned on (its Shapley value); chains of N balls know no gravity, and have two. The
last two contributions, from that law to the engine, have one order. All sum to engine minus model, to rounding.

Norms do not add, components along the total do: their sum is D. A share is one of them over D; over many cells it is
sum(along)/sum(D), its range that of this quotient over the orders.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import permutations
from typing import NamedTuple

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from impact_xval.compliant_baselines.registry import law_of
from impact_xval.compliant_baselines.solver import group_by_layout
from impact_xval.experiments.config.cells import Block
from impact_xval.experiments.config.experiment import REFERENCE, Config
from impact_xval.experiments.measures.corners import Corners, Texts, corner_names, corners
from impact_xval.model.arrays import Floats
from impact_xval.model.status import RESULT_STATUSES

#: D below which there is nothing to split: the accuracy of the references.
NOTHING = 1e-9

#: Two large causes cancel where one share is below the first and another above the second: each is then longer than D,
#: and the larger more than twice as long.
CANCEL = (-1.0, 2.0)

#: Status of an engine's result that changes with its step: it has a ladder, which no statistic counts.
UNCONVERGED = "unconverged"

#: Why the last two contributions are one.
NO_LIMIT = "no certified limit dt -> 0 for this cell"

#: Least width of a range, and least share beside the largest, that a sentence mentions.
_WIDE, _MENTIONED = 0.005, 0.02

#: Nothing, in the place of a text.
_NONE = np.array(None, dtype=object)

Columns = dict[str, np.ndarray]


class Contribution(NamedTuple):
    """One part of a divergence."""

    name: str
    label: str
    #: In a sentence about an engine, after "by".
    phrase: str
    #: Of Tol's muted palette, which shares none with solvers.
    color: str
    #: Of a cause the positions of its switch (`corners`); else two outcomes, of which it is the difference.
    before: str
    after: str


_NAMES = (
    ("frozen_positions", "frozen positions", "frozen positions", "#332288"),
    ("dissipation_law", "dissipation law", "the dissipation law", "#DDCC77"),
    ("gravity", "gravity", "gravity", "#88CCEE"),
    ("mapping", "regularisation and mapping", "its regularisation and mapping", "#AA4499"),
    ("discretisation", "time step", "its time step", "#999933"),
    ("engine", "mapping and time step", "its mapping and time step, not separated", "#117733"),
)
_ASKED = "kelvin-voigt in the scenario of the run"
_LIMIT = "the engine in the limit dt -> 0"
_RUN = "the engine at the step it was run with"
_ENDS = (
    ("contacts that return when their bodies approach", "contacts that return when their gap has closed"),
    ("energetic restitution", "the law the engine was asked for (spring and dashpot, kelvin-voigt)"),
    ("no gravity", "gravity as in the scenario of the run, B2 in static equilibrium"),
    (_ASKED, _LIMIT),
    (_LIMIT, _RUN),
    (_ASKED, _RUN),
)

#: All, in their order; a cell has either the last one or the two before it. Where one says kelvin-voigt, an engine of
#: another law has its own.
CONTRIBUTIONS = tuple(Contribution(*names, *ends) for names, ends in zip(_NAMES, _ENDS, strict=True))

#: Those that need no engine, in the order of `by_order`: averages over the orders in which they can be made.
CAUSES = CONTRIBUTIONS[:3]


def contributions_of(*, gravity: bool) -> tuple[Contribution, ...]:
    """Return the contributions in their order; `gravity` is whether there may be any."""
    return tuple(c for c in CONTRIBUTIONS if gravity or c.name != "gravity")


def by_order(corners: Floats) -> Floats:
    """Turn the three switches of corners on in each of their six orders, and say what every step changes.

    From shape (2, 2, g, ...) to (6, g + 1, ...), by order and cause; g is 1 without gravity, and each of the two orders
    there three times. Each order sums to the last corner minus the first.
    """
    found = []
    for order in permutations(range(3)):
        at, steps = [0, 0, 0], {}
        for switch in order:
            if corners.shape[switch] > 1:
                before = corners[tuple(at)]
                at[switch] = 1
                steps[switch] = corners[tuple(at)] - before
        found.append([steps[switch] for switch in sorted(steps)])
    return np.array(found)


def cancelling(shares: Sequence[float]) -> tuple[int, int] | None:
    """Return which two of these shares are of large causes that cancel, the larger first; None if none are."""
    found = np.nan_to_num(np.asarray(shares, dtype=float))
    high, low = int(found.argmax()), int(found.argmin())
    return (high, low) if found[high] > CANCEL[1] and found[low] < CANCEL[0] else None


class Split(NamedTuple):
    """The m contributions to the divergence of n cells of N balls, as differences of velocities per abs(v0)."""

    contributions: tuple[Contribution, ...]
    #: Engine minus model, shape (n, N), and D, its kinetic norm, shape (n,).
    total: Floats
    divergence: Floats
    #: Contributions, shape (m, n, N), and their kinetic norms, shape (m, n); NaN for one that a cell does not have.
    vectors: Floats
    norms: Floats
    #: Their components along the total, shape (m, n), and these by each order of the causes, shape (6, m, n); NaN where
    #: D is 0.
    along: Floats
    orders: Floats
    #: `along` over D, and the least and largest of `orders` over D, shape (m, n); NaN where there is nothing to split.
    shares: Floats
    ranges: tuple[Floats, Floats]
    #: Component of each corner minus the model along the total, shape (2, 2, g, n).
    corners: Floats

    def dominant(self) -> NDArray[np.intp]:
        """Index of the largest share in each cell; -1 where there is nothing to split."""
        return np.where(self.divergence >= NOTHING, _largest(self.along), -1)

    def agreed(self) -> NDArray[np.bool_]:
        """Whether the same contribution has the largest share by all orders."""
        return (_largest(self.orders) == self.dominant()).all(axis=0)


def _largest(along: Floats) -> NDArray[np.intp]:
    return np.argmax(np.where(np.isnan(along), -np.inf, along), axis=-2)


def split(weights: Floats, corners: Corners, limit: Floats, engine: Floats) -> Split:
    """Split the difference of an engine from the model into contributions.

    Weights are masses over that of what moves at first; `limit` and `engine` final velocities per abs(v0), in the limit
    dt -> 0 and at the engine's step, NaN where there are none. All are of shape (n, N).
    """
    known = ~np.isnan(limit).any(axis=1, keepdims=True)
    mapping, step = (np.where(known, x, np.nan) for x in (limit - corners.asked, engine - limit))
    joined = np.where(known, np.nan, engine - corners.asked)
    causes, total = by_order(corners.velocities), engine - corners.model
    vectors = np.concatenate([causes.mean(axis=0), [mapping, step, joined]])
    divergence = _norm(weights, total)

    def component(differences: Floats) -> Floats:
        with np.errstate(invalid="ignore", divide="ignore"):
            return (weights * differences * total).sum(axis=-1) / divergence

    along, of_causes = component(vectors), component(causes)
    rest = along[of_causes.shape[1] :]  # the same by every order
    orders = np.concatenate([of_causes, np.broadcast_to(rest, (len(of_causes), *rest.shape))], axis=1)
    divided = np.where(divergence >= NOTHING, divergence, np.nan)
    shares = orders / divided
    return Split(
        contributions=contributions_of(gravity=corners.gravity),
        total=total,
        divergence=divergence,
        vectors=vectors,
        norms=_norm(weights, vectors),
        along=along,
        orders=orders,
        shares=along / divided,
        ranges=(shares.min(axis=0), shares.max(axis=0)),
        corners=component(corners.velocities - corners.model),
    )


def _norm(weights: Floats, differences: Floats) -> Floats:
    """Kinetic norm."""
    return np.sqrt((weights * differences**2).sum(axis=-1))


def ladders(
    config: Config, block: Block, model: pa.Table, engines: Mapping[str, pa.Table]
) -> dict[str, Columns]:
    """Make the ladders of engines: columns of the table ``ladder``, NaN or None where there is no ladder.

    `model` and `engines` are rows, one a cell.
    """
    columns: dict[str, Columns] = {name: {} for name in engines}
    pair = config.chain is None
    for places, collisions in group_by_layout(block.collisions) if engines else ():
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
            for key, values in (found | _split_columns(name, here, ladder, ok)).items():
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


def _split_columns(name: str, here: Corners, ladder: Split, ok: NDArray[np.bool_]) -> Columns:
    """Columns of corners and contributions, and of what carries most of each divergence; nothing where not `ok`."""
    shares, norms, (low, high) = ladder.shares, ladder.norms, ladder.ranges
    numbers = {"velocity_divergence": ladder.divergence} | _by_ball("dv", ladder.total)
    for i, c in enumerate(ladder.contributions):
        numbers |= _by_ball(f"{c.name}_dv", ladder.vectors[i])
        numbers |= {f"{c.name}_norm": norms[i], f"{c.name}_share": shares[i]}
        if c in CAUSES:
            numbers |= {f"{c.name}_share_low": low[i], f"{c.name}_share_high": high[i]}
    for index, corner in corner_names(gravity=here.gravity).items():
        numbers |= _by_ball(f"{corner}_v", here.velocities[index])
        numbers[f"{corner}_along"] = np.where(ladder.divergence == 0, 0.0, ladder.corners[index])
    first, agreed, sentences = np.where(ok, ladder.dominant(), -1), ladder.agreed(), np.full(len(ok), _NONE)
    for i in np.flatnonzero(ok):
        rows = zip(*(x[:, i].tolist() for x in (shares, norms, low, high)), strict=True)
        parts = [Part(c.phrase, *row) for c, row in zip(ladder.contributions, rows, strict=True)]
        found = [part for part in parts if not np.isnan(part.norm)]
        sentences[i] = sentence(name, float(ladder.divergence[i]), found, bool(agreed[i]))
    return {key: np.where(ok, x, np.nan) for key, x in numbers.items()} | {
        "dominant": np.array([*(c.name for c in ladder.contributions), None], dtype=object)[first],
        "dominant_by_every_order": np.where(first >= 0, agreed.astype(object), _NONE),
        "sentence": sentences,
    }


def _by_ball(name: str, velocities: Floats) -> Columns:
    return {f"{name}{i}": x for i, x in enumerate(velocities.T, 1)}


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
