"""The difference of final velocities between an engine and the model, split into its causes (docs/ladder.md).

The three causes stand between the model and the law that the engine was asked for in its scenario: switches, all
combinations of which (`corners`) are known without an engine. A cause is the mean of what its switch changes over the
six orders in which they can be turned on (its Shapley value); chains of N balls know no gravity, and have two. The
last two contributions, from that law to the engine, have one order. All sum to engine minus model, to rounding.

Norms do not add, components along the total do: their sum is D. A share is one of them over D; over many cells it is
sum(along)/sum(D), its range that of this quotient over the orders.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import permutations
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from impact_xval.compliant_baselines.registry import law_name_of
from impact_xval.compliant_baselines.solver import group_by_layout
from impact_xval.experiments.config.cells import CellBlock, ColumnArrays
from impact_xval.experiments.config.experiment import REFERENCE, Config
from impact_xval.experiments.measures.corners import Corners, corner_names, corners
from impact_xval.experiments.measures.divergence import Comparison
from impact_xval.model.arrays import Floats
from impact_xval.model.status import RESULT_STATUSES

#: D below which there is nothing to split: the accuracy of the references.
NOTHING = 1e-9

#: Two causes cancel where the least share is below the first number and the largest above the second: both causes are
#: then longer than D, and the larger one more than twice as long.
CANCEL = (-1.0, 2.0)

#: Status of an engine's result that still changes with its step: the result has a ladder, which no statistic counts.
UNCONVERGED = "unconverged"

#: Reason why mapping and time step are one contribution.
NO_LIMIT = "no certified limit dt -> 0 for this cell"

#: Least width of a range of shares that a sentence mentions.
_WIDE = 0.005

#: Least share, of the second contribution of a sentence, that the sentence mentions.
_MENTIONED = 0.02

#: Array that holds no text; `numpy.where` makes objects of it.
_NONE = np.array(None, dtype=object)


@dataclass(frozen=True, slots=True)
class Contribution:
    """Contribution of one cause, or of the engine, to a divergence."""

    name: str
    label: str
    #: Words for a sentence about an engine, after "comes from".
    phrase: str
    #: Colour of Tol's muted palette, which shares none with solvers.
    color: str
    #: Of a cause the two positions of its switch (`corners`); else the two outcomes that are subtracted.
    before: str
    after: str
    #: Whether the contribution is known without an engine: the mean over the orders in which switches are turned on.
    is_cause: bool = False
    #: Whether the contribution exists only where a scenario may have gravity.
    needs_gravity: bool = False


_ENGINE_LAW = "the exact solution of the engine's own contact law, in the scenario of the run"
_LIMIT = "the engine, extrapolated to a time step of zero"
_RUN = "the engine at the time step of the run"

#: All contributions in their order, the causes first and in the order of the switches of `corners`. A cell has either
#: the last contribution or the two before it.
CONTRIBUTIONS = (
    Contribution(
        name="frozen_positions",
        label="frozen positions",
        phrase="frozen positions (bodies do not move during the collision in the model)",
        color="#332288",
        before="a contact acts again as soon as its bodies approach",
        after="a contact acts again when the gap between its bodies has closed",
        is_cause=True,
    ),
    Contribution(
        name="dissipation_law",
        label="dissipation law",
        phrase="the dissipation law (contacts lose energy in another way than in the model)",
        color="#DDCC77",
        before="energetic restitution, the model's law",
        after="the engine's own contact law (in most engines springs with dashpots)",
        is_cause=True,
    ),
    Contribution(
        name="gravity",
        label="gravity",
        phrase="gravity (which the model leaves out)",
        color="#88CCEE",
        before="no gravity",
        after="gravity of the scenario, with B2 in static equilibrium at the start",
        is_cause=True,
        needs_gravity=True,
    ),
    Contribution(
        name="mapping",
        label="regularisation and mapping",
        phrase="its regularisation and mapping (how it softens contacts and takes parameters)",
        color="#AA4499",
        before=_ENGINE_LAW,
        after=_LIMIT,
    ),
    Contribution(
        name="discretisation",
        label="time step",
        phrase="its time step",
        color="#999933",
        before=_LIMIT,
        after=_RUN,
    ),
    Contribution(
        name="engine",
        label="mapping and time step",
        phrase="its mapping and time step together",
        color="#117733",
        before=_ENGINE_LAW,
        after=_RUN,
    ),
)

#: The causes, in the order of the switches of `corners`.
CAUSES = tuple(contribution for contribution in CONTRIBUTIONS if contribution.is_cause)


def contributions_of(*, gravity: bool) -> tuple[Contribution, ...]:
    """Return the contributions that a cell may have, in their order; `gravity`: whether one may be gravity."""
    return tuple(c for c in CONTRIBUTIONS if gravity or not c.needs_gravity)


def changes_by_order(corners: Floats) -> Floats:
    """Return what each switch changes, for each of the six orders in which the three switches can be turned on.

    `corners` has shape (2, 2, g, ...), by position of each switch; the result has shape (6, g + 1, ...), by order and
    switch. Without gravity g is 1, and the result has each of the two orders three times. The changes of an order sum
    to the last corner minus the first.
    """
    changes: list[list[Floats]] = []
    for order in permutations(range(3)):
        index = [0, 0, 0]
        change_of_switch: dict[int, Floats] = {}
        for switch in order:
            if corners.shape[switch] > 1:
                before = corners[tuple(index)]
                index[switch] = 1
                change_of_switch[switch] = corners[tuple(index)] - before
        changes.append([change_of_switch[switch] for switch in sorted(change_of_switch)])
    return np.array(changes)


def cancelling_pair(shares: Sequence[float]) -> tuple[int, int] | None:
    """Return the positions of two large shares that cancel, the larger share first; None where none cancel."""
    numbers = np.nan_to_num(np.asarray(shares, dtype=float))
    high, low = int(numbers.argmax()), int(numbers.argmin())
    cancel = numbers[high] > CANCEL[1] and numbers[low] < CANCEL[0]
    return (high, low) if cancel else None


class Split(NamedTuple):
    """Contributions to the divergence of n cells of N balls; m contributions, differences of velocities per abs(v0)."""

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
        """Return the index of the largest share in each cell; -1 where there is nothing to split."""
        return np.where(self.divergence >= NOTHING, _index_of_largest(self.along), -1)

    def same_by_every_order(self) -> NDArray[np.bool_]:
        """Return whether the same contribution has the largest share by all orders, shape (n,)."""
        return (_index_of_largest(self.orders) == self.dominant()).all(axis=0)


def _index_of_largest(along: Floats) -> NDArray[np.intp]:
    return np.argmax(np.where(np.isnan(along), -np.inf, along), axis=-2)


def split(weights: Floats, corners: Corners, limit: Floats, engine: Floats) -> Split:
    """Split the difference of an engine from the model into contributions.

    Weights are masses over that of what moves at first; `limit` and `engine` final velocities per abs(v0), in the limit
    dt -> 0 and at the engine's step, NaN where there are none. All are of shape (n, N).
    """
    has_limit = ~np.isnan(limit).any(axis=1, keepdims=True)
    mapping = np.where(has_limit, limit - corners.engine_law, np.nan)
    time_step = np.where(has_limit, engine - limit, np.nan)
    mapping_and_step = np.where(has_limit, np.nan, engine - corners.engine_law)
    causes = changes_by_order(corners.velocities)
    total = engine - corners.model
    vectors = np.concatenate([causes.mean(axis=0), [mapping, time_step, mapping_and_step]])
    divergence = _norm(weights, total)

    def component(differences: Floats) -> Floats:
        with np.errstate(invalid="ignore", divide="ignore"):
            return (weights * differences * total).sum(axis=-1) / divergence

    along, of_causes = component(vectors), component(causes)
    n_orders, n_causes = of_causes.shape[:2]
    of_engine = along[n_causes:]  # the same by every order
    orders = np.concatenate([of_causes, np.broadcast_to(of_engine, (n_orders, *of_engine.shape))], axis=1)
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
    """Return the kinetic norm of differences of velocities over the last axis."""
    return np.sqrt((weights * differences**2).sum(axis=-1))


def ladders(
    config: Config, block: CellBlock, model: Comparison, engines: Mapping[str, Comparison]
) -> dict[str, ColumnArrays]:
    """Make the ladders of engines in cells: by engine the columns of the table ``ladder``, shape (n,).

    A column holds NaN or None where there is no ladder.
    """
    columns: dict[str, ColumnArrays] = {name: {} for name in engines}
    if not engines:
        return columns
    pair = config.kind == "pair"
    laws = {name: law_name_of(name) or "" for name in engines}
    for places, collisions in group_by_layout(block.collisions):
        n, balls = collisions.masses.shape
        speed = np.abs(collisions.velocities).max(axis=1, keepdims=True)
        gravity = np.full(n, config.gravity if config.scenario == "drop" else 0.0)
        of_model = model.results.velocities_of()[places, :balls] / speed
        moving = np.where(collisions.velocities != 0, collisions.masses, 0.0).sum(axis=1, keepdims=True)
        # The corners depend on the law alone, not on the engine.
        corners_of_law = {
            law: corners(of_model, collisions, gravity, law, pair=pair) for law in set(laws.values())
        }
        for name, engine in engines.items():
            of_law = corners_of_law[laws[name]]
            velocities = engine.results.velocities_of((*RESULT_STATUSES, UNCONVERGED))[places, :balls] / speed
            limit = engine.results.limits()[places, :balls]  # none where the engine did not converge
            ladder = split(collisions.masses / moving, of_law, limit, velocities)
            always = _status_columns(name, model, engine, places, of_law, ladder)
            ok = ~np.isnan(ladder.divergence) & np.isin(always["status"].tolist(), ("ok", UNCONVERGED))
            for key, values in (always | _split_columns(name, of_law, ladder, ok)).items():
                _put_into_column(columns[name], key, values, places, len(block))
    return columns


def _put_into_column(columns: ColumnArrays, key: str, values: np.ndarray, places: np.ndarray, n: int) -> None:
    """Put values in their places of a column of length n, which holds NaN or None elsewhere."""
    nothing = np.nan if values.dtype.kind == "f" else None
    columns.setdefault(key, np.full(n, nothing, values.dtype))[places] = values


def _status_columns(
    name: str,
    model: Comparison,
    engine: Comparison,
    places: NDArray[np.intp],
    corners: Corners,
    ladder: Split,
) -> ColumnArrays:
    """Return the columns that a row has with or without a ladder: the first outcome that is missing, marks, errors."""
    status, reason = engine.results.status[places], engine.results.reason[places]
    of_model = model.results.status[places]
    of_engine = np.array(
        [f"{name}: {text or word}" for text, word in zip(reason, status, strict=True)], dtype=object
    )
    of_corner = np.array([text.rpartition(" ")[2] for text in corners.reason], dtype=object)
    # In the order in which a missing outcome is told: of the engine, the model, a corner.
    missing = [
        ~np.isin(status.tolist(), RESULT_STATUSES),
        ~np.isin(of_model.tolist(), RESULT_STATUSES),
        corners.reason != "",
    ]
    mapping_with_step = ~np.isnan(ladder.norms[-1])
    reasons = [of_engine, f"{REFERENCE}: " + of_model, corners.reason]
    marks = zip(engine.marked[places], corners.mark, strict=True)
    return {
        "status": np.select(missing, [status, of_model, of_corner], "ok"),
        "reason": np.select(missing, reasons, np.where(mapping_with_step, NO_LIMIT, _NONE)),
        "marked": np.array(["; ".join(filter(None, pair)) for pair in marks], dtype=object),
        "model_grazing_margin": model.results.margin[places],
        "limit_error": engine.results.diagnostic("limit_error")[places],
    }


def _split_columns(name: str, corners: Corners, ladder: Split, ok: NDArray[np.bool_]) -> ColumnArrays:
    """Return the columns of corners and contributions, and of the largest contribution; nothing where not `ok`."""
    low, high = ladder.ranges
    numbers = {"velocity_divergence": ladder.divergence} | _by_ball("dv", ladder.total)
    for i, contribution in enumerate(ladder.contributions):
        prefix = contribution.name
        numbers |= _by_ball(f"{prefix}_dv", ladder.vectors[i])
        numbers[f"{prefix}_norm"] = ladder.norms[i]
        numbers[f"{prefix}_share"] = ladder.shares[i]
        if contribution.is_cause:
            numbers[f"{prefix}_share_low"] = low[i]
            numbers[f"{prefix}_share_high"] = high[i]
    for index, corner in corner_names(gravity=corners.gravity).items():
        numbers |= _by_ball(f"{corner}_v", corners.velocities[index])
        numbers[f"{corner}_along"] = np.where(ladder.divergence == 0, 0.0, ladder.corners[index])
    dominant = np.where(ok, ladder.dominant(), -1)
    agreed = ladder.same_by_every_order()
    names = np.array([*(contribution.name for contribution in ladder.contributions), None], dtype=object)
    sentences = np.full(len(ok), _NONE)
    for row in np.flatnonzero(ok).tolist():
        parts = _parts_of_row(ladder, row)
        sentences[row] = sentence(name, float(ladder.divergence[row]), parts, bool(agreed[row]))
    return {key: np.where(ok, x, np.nan) for key, x in numbers.items()} | {
        "dominant": names[dominant],  # -1: the last entry, None
        "dominant_by_every_order": np.where(dominant >= 0, agreed.astype(object), _NONE),
        "sentence": sentences,
    }


def _parts_of_row(ladder: Split, row: int) -> list[SentencePart]:
    """Return the contributions that a cell has, as a sentence needs them."""
    low, high = ladder.ranges
    return [
        SentencePart(
            phrase=contribution.phrase,
            share=float(ladder.shares[i, row]),
            norm=float(ladder.norms[i, row]),
            low=float(low[i, row]),
            high=float(high[i, row]),
        )
        for i, contribution in enumerate(ladder.contributions)
        if not np.isnan(ladder.norms[i, row])
    ]


def _by_ball(name: str, velocities: Floats) -> ColumnArrays:
    return {f"{name}{i}": x for i, x in enumerate(velocities.T, 1)}


class SentencePart(NamedTuple):
    """A contribution in a sentence: its phrase, share and norm, and its least and largest share by the orders."""

    phrase: str
    share: float
    norm: float
    low: float
    high: float

    @property
    def percent(self) -> str:
        """Text of the share, followed by its range over the orders of the causes if the range is wide."""
        text = f"{100 * self.share:.3g} %"
        return (
            f"{text} ({format_share_range(self.low, self.high)})" if self.high - self.low >= _WIDE else text
        )


def format_share_range(low: float, high: float) -> str:
    """Write a range of shares in per cent."""
    return f"{100 * low:.3g} to {100 * high:.3g} %"


def sentence(solver: str, divergence: float, parts: Sequence[SentencePart], agreed: bool = True) -> str:
    """Return the sentences that name the largest contributions to a divergence.

    `agreed` says that the same contribution is the largest for every order of the causes.
    """
    if divergence < NOTHING:
        return f"{solver} ends where the model does (D = {divergence:.1g}), so there is no difference to explain."
    pair = cancelling_pair([part.share for part in parts])
    if pair is not None:
        larger, smaller = (f"{parts[i].phrase}, of size {parts[i].norm:.3g}" for i in pair)
        return (
            f"{solver} ends D = {divergence:.3g} from the model. Two larger causes nearly cancel: {larger}, and "
            f"{smaller} (sizes are measured like D)."
        )
    first, *rest = sorted(parts, key=lambda part: -part.share)
    sure = first.low if np.isfinite(first.low) else first.share
    how_much = "Most of it" if sure > 0.5 else "The largest part of it"
    text = f"{solver} ends D = {divergence:.3g} from the model. {how_much} comes from {first.phrase}: {first.percent}."
    if not agreed:
        text += " In another order of the causes, another cause is the largest."
    second = max(rest, key=lambda part: abs(part.share))
    shown = [first.percent]
    if second.share <= -_MENTIONED:
        text += f" A part of it is undone by {second.phrase}: {second.percent}."
        shown.append(second.percent)
    elif second.share >= _MENTIONED:
        text += f" The next largest cause is {second.phrase}: {second.percent}."
        shown.append(second.percent)
    if any("(" in percent for percent in shown):
        text += " Brackets: range over all orders in which causes can be switched on."
    return text
