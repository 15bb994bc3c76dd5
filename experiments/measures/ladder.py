"""Split of the difference of final velocities between an engine and the model into contributions (docs/ladder.md).

Three contributions are called causes: frozen positions, the dissipation law, and gravity. They lead from the model to
the exact solution of the law that the engine was asked for. Each cause is a switch, and the exact solutions for all
combinations of the switches (`corners`) are known without an engine. Three switches can be turned on in six orders. The
contribution of a cause is the change that its switch makes, as a mean over the six orders (the Shapley value). Chains
of N balls have no gravity. They have two causes and two orders. The other contributions are effects of the engine. They
lead from the exact solution of the law to the engine, and have one order. All contributions of a cell sum to engine
minus model, up to rounding.

The norms of the contributions do not sum to the norm of the whole difference. But the components of the contributions
along the whole difference do: they sum to D, the kinetic norm of the whole difference. The share of a contribution is
its component divided by D. For many cells the share is the sum of the components divided by the sum of D. A share
depends on the order in which the causes are taken. The range of a share goes from its least to its largest value over
all orders of the causes.

The worker processes of a sweep call `ladders` for every chunk of cells.
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

#: Least divergence D of an engine from the model that is split into contributions. The exact solvers are accurate to
#: about this number, so that a smaller D is not known.
NOTHING = 1e-9

#: Largest share that rounding alone can make: 1e-16 of a velocity over the least divergence that is split.
_ROUNDING_OF_SHARES = 1e-16 / NOTHING

#: Two contributions cancel if the smallest share of all is below the first number and the largest share is above the
#: second number. The norms of both contributions are then larger than D, and one norm is more than twice as large as D.
CANCEL = (-1.0, 2.0)

#: Status of an engine whose result still changes with the time step. The divergence of such a result is split into
#: contributions too, but no statistic counts it.
UNCONVERGED = "unconverged"

#: Reason in the table ``ladder`` why one contribution holds both the effect of the engine's mapping and the effect of
#: its time step. Only the limit of the engine at a time step of zero can separate the two effects, and here this limit
#: is not known.
NO_LIMIT = "no certified limit dt -> 0 for this cell"

#: Least width of the range of a share for which a sentence states this range. The range goes over all orders in which
#: the causes can be taken.
_WIDE = 0.005

#: Least absolute value of the share of a second contribution for which a sentence names this contribution.
_MENTIONED = 0.02

#: None as an array. `numpy.where` takes it for elements without a text, and then returns an array of objects.
_NONE = np.array(None, dtype=object)


@dataclass(frozen=True, slots=True)
class Contribution:
    """Description of one contribution to an engine's divergence from the model.

    The contribution is a cause, such as gravity, or an effect of the engine, such as its time step.
    """

    name: str
    label: str
    #: Words that follow "comes from" in a sentence about an engine.
    phrase: str
    #: Colour in figures, from Paul Tol's muted palette. No solver has one of these colours.
    color: str
    #: For a cause, `before` says what the switch means when it is off, and `after` what it means when it is on. For an
    #: effect of the engine, `before` and `after` name two outcomes. The contribution is their difference, `after` minus
    #: `before`.
    before: str
    after: str
    #: Whether the contribution is a cause. A cause is computed from exact solutions, without an engine, as a mean over
    #: all orders in which the causes can be taken.
    is_cause: bool = False
    #: Whether the contribution exists only in runs whose scenario may have gravity.
    needs_gravity: bool = False


_ENGINE_LAW = "the exact solution of the engine's own contact law, in the scenario of the run"
_LIMIT = "the engine, extrapolated to a time step of zero"
_RUN = "the engine at the time step of the run"

#: All contributions in their order. The causes come first, in the order of the switches of `corners`. A cell has either
#: the last contribution or the two contributions before the last.
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
    """Return the contributions that a cell may have, in the order of `CONTRIBUTIONS`.

    The contribution of gravity is among them only if `gravity` is true.
    """
    return tuple(c for c in CONTRIBUTIONS if gravity or not c.needs_gravity)


def changes_by_order(corners: Floats) -> Floats:
    """Return the change that each switch makes, for each of the six orders in which three switches can be turned on.

    `corners` are the solutions for all combinations of the switches, of shape (2, 2, g, ...). The first three indices
    are 0 or 1, for each switch off or on. The result is of shape (6, g + 1, ...): one row for each order and one column
    for each switch. With gravity g is 2. Without gravity g is 1, and there are only two orders, each of which the
    result holds three times. The changes of one order sum to the solution with all switches on minus the solution with
    all switches off.
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
    """Return the indices of two shares of opposite sign that nearly cancel, the larger share first.

    The result is None if no two shares fulfil the condition of `CANCEL`.
    """
    numbers = np.nan_to_num(np.asarray(shares, dtype=float))
    high, low = int(numbers.argmax()), int(numbers.argmin())
    cancel = numbers[high] > CANCEL[1] and numbers[low] < CANCEL[0]
    return (high, low) if cancel else None


class Split(NamedTuple):
    """Split of an engine's divergence from the model into m contributions, in n cells of N balls.

    All velocities and differences of velocities are divided by abs(v0), the impact speed.
    """

    contributions: tuple[Contribution, ...]
    #: Difference of final velocities, engine minus model, shape (n, N). D is the kinetic norm of this difference, shape
    #: (n,).
    total: Floats
    divergence: Floats
    #: Contributions, shape (m, n, N), and their kinetic norms, shape (m, n). Both are NaN for a contribution that a
    #: cell does not have.
    vectors: Floats
    norms: Floats
    #: Components of the contributions along `total`, shape (m, n); and these components for each single order of the
    #: causes, shape (6, m, n). Both are NaN where D is 0.
    along: Floats
    orders: Floats
    #: Shares, which are `along` divided by D, shape (m, n), and the least and the largest share over all orders of the
    #: causes, each of shape (m, n). All three are NaN where D is below `NOTHING`.
    shares: Floats
    ranges: tuple[Floats, Floats]
    #: For each exact solution, the component along `total` of its difference from the model, shape (2, 2, g, n). The
    #: first three indices say which switches are on.
    corners: Floats

    def dominant(self) -> NDArray[np.intp]:
        """Return the index of the contribution with the largest share in each cell; -1 where D is below `NOTHING`."""
        return np.where(self.divergence >= NOTHING, _index_of_largest(self.along), -1)

    def same_by_every_order(self) -> NDArray[np.bool_]:
        """Return whether the same contribution has the largest share in every order of the causes, shape (n,)."""
        return (_index_of_largest(self.orders) == self.dominant()).all(axis=0)


def _index_of_largest(along: Floats) -> NDArray[np.intp]:
    return np.argmax(np.where(np.isnan(along), -np.inf, along), axis=-2)


def split(weights: Floats, corners: Corners, limit: Floats, engine: Floats) -> Split:
    """Split the difference of an engine from the model into contributions.

    All arrays are of shape (n, N), for n cells of N balls. Velocities are divided by abs(v0).

    Parameters
    ----------
    weights : array
        Masses, divided by the total mass of the balls that move at first.
    corners : Corners
        Exact solutions for all combinations of the causes' switches.
    limit : array
        Final velocities of the engine in the limit of a time step of zero; NaN where the limit is not known.
    engine : array
        Final velocities of the engine at its time step; NaN where it has no result.
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
    of_engine = along[n_causes:]  # effects of the engine do not depend on the order of the causes
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
    """Return the kinetic norm of velocity differences over the last axis, with `weights` as masses."""
    return np.sqrt((weights * differences**2).sum(axis=-1))


def ladders(
    config: Config, block: CellBlock, model: Comparison, engines: Mapping[str, Comparison]
) -> dict[str, ColumnArrays]:
    """Split the divergence of every engine in a block of n cells into contributions.

    Return the columns of the table ``ladder``, by engine and by name of the column, each of shape (n,). If a solution
    is missing in a cell, the divergence cannot be split there, and the columns hold NaN or None.
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
            limit = engine.results.limits()[places, :balls]  # no value where the engine did not converge
            ladder = split(collisions.masses / moving, of_law, limit, velocities)
            always = _status_columns(name, model, engine, places, of_law, ladder)
            ok = ~np.isnan(ladder.divergence) & np.isin(always["status"].tolist(), ("ok", UNCONVERGED))
            for key, values in (always | _split_columns(name, of_law, ladder, ok)).items():
                _put_into_column(columns[name], key, values, places, len(block))
    return columns


def _put_into_column(columns: ColumnArrays, key: str, values: np.ndarray, places: np.ndarray, n: int) -> None:
    """Put values into a column at the given places; the column `key` is made first if it does not exist.

    A new column has length n. It holds NaN or None at all other places.
    """
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
    """Return the columns that every row has, even if its divergence cannot be split.

    The columns are the status; the reason, which names the first missing outcome; the text that says which jump is near
    and marks the row; the grazing margin of the model; and the error of the engine's limit.
    """
    status, reason = engine.results.status[places], engine.results.reason[places]
    of_model = model.results.status[places]
    of_engine = np.array(
        [f"{name}: {text or word}" for text, word in zip(reason, status, strict=True)], dtype=object
    )
    of_corner = np.array([text.rpartition(" ")[2] for text in corners.reason], dtype=object)
    # If several outcomes are missing, the reason names the first missing outcome in this order: engine, model, exact
    # solutions.
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
    """Return the columns with the numbers of a split divergence, its largest contribution, and its sentence.

    The columns hold NaN or None in rows whose status is not `ok`.
    """
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
        "dominant": names[dominant],  # index -1 picks the last entry, None
        "dominant_by_every_order": np.where(dominant >= 0, agreed.astype(object), _NONE),
        "sentence": sentences,
    }


def _parts_of_row(ladder: Split, row: int) -> list[SentencePart]:
    """Return the contributions that the cell of a row has, with the numbers that a sentence states."""
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
    """Words and numbers of one contribution for the sentence about a cell.

    The contribution is a part of an engine's divergence D from the model, and `share` is its component along the whole
    difference divided by D. The share of a cause depends on the order in which the causes are taken. `low` and `high`
    are the least and the largest share over all orders. `norm` is the kinetic norm of the contribution.
    """

    phrase: str
    share: float
    norm: float
    low: float
    high: float

    @property
    def depends_on_order(self) -> bool:
        """True if the range of the share over all orders of the causes is wide enough to be shown."""
        return self.high - self.low >= _WIDE

    @property
    def percent(self) -> str:
        """Text of the share, followed by its range if the share depends on the order of the causes."""
        text = f"{100 * self.share:.3g} %"
        return f"{text} ({format_share_range(self.low, self.high)})" if self.depends_on_order else text


def format_share_range(low: float, high: float) -> str:
    """Write a range of shares in per cent, such as ``67.9 to 69.4 %``. A share that is only rounding becomes 0."""
    first, last = (0.0 if abs(share) <= _ROUNDING_OF_SHARES else 100 * share for share in (low, high))
    return f"{first:.3g} to {last:.3g} %"


def sentence(solver: str, divergence: float, parts: Sequence[SentencePart], agreed: bool = True) -> str:
    """Return the sentences that name the largest contributions to a divergence.

    `agreed` is true if the same contribution is the largest in every order of the causes.
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
    shown = [first]
    if second.share <= -_MENTIONED:
        text += f" A part of it is undone by {second.phrase}: {second.percent}."
        shown.append(second)
    elif second.share >= _MENTIONED:
        text += f" The next largest cause is {second.phrase}: {second.percent}."
        shown.append(second)
    if any(part.depends_on_order for part in shown):
        text += " Brackets: range over all orders in which causes can be switched on."
    return text
