"""Outcomes of one solver as arrays, and measures of how far they diverge from the outcomes of the model.

The measures have no dimension. The worker processes of a sweep call this module for every chunk of cells, and
`impact-xval solve` calls it for a single collision.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import zip_longest

import numpy as np
from numpy.typing import NDArray

from impact_xval.compliant_baselines.registry import exact_solver_for
from impact_xval.compliant_baselines.states import comparable_states
from impact_xval.experiments.config.cells import ColumnArrays
from impact_xval.experiments.config.experiment import REFERENCE
from impact_xval.experiments.config.graphs import GRAPH_AXES, GRAPH_SPECS, Mirror
from impact_xval.model.arrays import Floats
from impact_xval.model.collision import Collision
from impact_xval.model.collisions import Collisions
from impact_xval.model.graph.collision import GraphCollision
from impact_xval.model.graph.collision_outcome import GraphCollisionOutcome
from impact_xval.model.kinetic import kinetic_norm
from impact_xval.model.outcome import Outcome
from impact_xval.model.outcomes import Outcomes
from impact_xval.model.path import Paths
from impact_xval.model.status import RESULT_STATUSES

Texts = NDArray[np.object_]

#: Names of the diagnostics that solvers give in m/s. In tables and JSON they are divided by abs(v0), the impact speed.
_VELOCITY = re.compile(r"v\d+[xz]?_limit|limit_error|velocity_error|regularisation|rest_speed")


@dataclass(frozen=True, slots=True, eq=False)
class ImpulseCurves:
    """Impulse curves of n pairs of balls, stored one after another in one array.

    An impulse curve is the path of the impulses of the pair's two contacts in their plane. If the outcome of a pair
    holds no path, its curve has no points.
    """

    #: Places in `impulses`, shape (n + 1,). Curve i has the points from offsets[i] up to, but without, offsets[i + 1].
    offsets: NDArray[np.int64]
    #: Impulses that the two contacts have transmitted so far, in N s, shape (number of points, 2).
    impulses: Floats

    def __getitem__(self, place: slice) -> ImpulseCurves:
        curves = range(len(self.offsets) - 1)[place]
        offsets = self.offsets[curves.start : curves.stop + 1]
        return ImpulseCurves(offsets - offsets[0], self.impulses[offsets[0] : offsets[-1]])

    @classmethod
    def concatenate(cls, pieces: Sequence[ImpulseCurves]) -> ImpulseCurves:
        """Return one object with the curves of several objects, in the order of these objects."""
        lengths = np.concatenate([np.diff(piece.offsets) for piece in pieces])
        return cls(np.append(0, np.cumsum(lengths)), np.concatenate([piece.impulses for piece in pieces]))


@dataclass(frozen=True, slots=True, eq=False)
class SolverResults:
    """Outcomes of one solver in n cells of at most N balls, as arrays.

    An element is NaN where a cell has fewer than N balls, or where the solver gives no value. In contact graphs N is
    the number of components of velocity, x and z of each body, and `components` holds their names.
    """

    #: Final velocities in m/s, shape (n, N).
    velocities: Floats
    #: Total impulses in N s, shape (n, number of contacts).
    impulses: Floats
    status: Texts
    reason: Texts
    mark: Texts
    differences: Texts
    #: State sequences of pairs of balls as the solver gives them; empty texts for chains and graphs.
    states: list[str]
    #: State sequences of pairs as they are compared, without states of very short duration; empty for chains and
    #: graphs.
    compared: list[str]
    n_states: NDArray[np.int64]
    n_events: NDArray[np.int64]
    margin: Floats
    #: Diagnostics by name, each of shape (n,). Diagnostics that are velocities are divided by the impact speed abs(v0).
    #: Diagnostics that are times are in s.
    diagnostics: dict[str, Floats]
    #: Impulse curves of pairs of balls. None for chains and graphs, and in a `Comparison`, which does not keep them.
    curves: ImpulseCurves | None
    #: Names of the components of velocity in contact graphs, such as 1x and 1z; empty for balls in a line.
    components: tuple[str, ...] = ()

    @property
    def has_result(self) -> NDArray[np.bool_]:
        """Mask of the cells in which the solver has a result, shape (n,)."""
        return np.isin(self.status.astype(str), RESULT_STATUSES)

    @property
    def has_numbers(self) -> NDArray[np.bool_]:
        """Mask of the cells whose numbers go into the tables, shape (n,).

        These are the cells with a result, and the cells in which the solver gives numbers although it did not converge
        or ran out of time.
        """
        unfinished = (self.status == "unconverged") | (self.status == "timeout")
        return (self.has_result | unfinished) & ~np.isnan(self.velocities[:, 0])

    def velocities_of(self, statuses: Sequence[str] = RESULT_STATUSES) -> Floats:
        """Return the final velocities in m/s, shape (n, N). They are NaN in cells whose status is not in `statuses`."""
        kept = np.isin(self.status.astype(str), statuses) & self.has_numbers
        return np.where(kept[:, None], self.velocities, np.nan)

    def limits(self) -> Floats:
        """Return the final velocities of an engine in the limit of a time step of zero, per abs(v0), shape (n, N).

        They are NaN in cells that have no result or no such limit.
        """
        names = self.components or range(1, 1 + self.velocities.shape[1])
        limits = np.column_stack([self.diagnostic(f"v{i}_limit") for i in names])
        return np.where(self.has_result[:, None], limits, np.nan)

    def diagnostic(self, name: str) -> Floats:
        """Return the diagnostic of this name in every cell, shape (n,); NaN where an outcome does not state it."""
        return self.diagnostics.get(name, np.full(len(self.status), np.nan))

    def __len__(self) -> int:
        return len(self.status)

    def __getitem__(self, place: slice) -> SolverResults:
        if range(len(self))[place] == range(len(self)):
            return self
        return SolverResults(
            velocities=self.velocities[place],
            impulses=self.impulses[place],
            status=self.status[place],
            reason=self.reason[place],
            mark=self.mark[place],
            differences=self.differences[place],
            states=self.states[place],
            compared=self.compared[place],
            n_states=self.n_states[place],
            n_events=self.n_events[place],
            margin=self.margin[place],
            diagnostics={name: x[place] for name, x in self.diagnostics.items()},
            curves=None if self.curves is None else self.curves[place],
            components=self.components,
        )

    @classmethod
    def concatenate(cls, pieces: Sequence[SolverResults]) -> SolverResults:
        """Return one object with the results of several objects, in the order of these objects."""
        if len(pieces) == 1:
            return pieces[0]
        names = dict.fromkeys(name for piece in pieces for name in piece.diagnostics)
        curves = [piece.curves for piece in pieces if piece.curves is not None]
        return cls(
            velocities=np.concatenate([piece.velocities for piece in pieces]),
            impulses=np.concatenate([piece.impulses for piece in pieces]),
            status=np.concatenate([piece.status for piece in pieces]),
            reason=np.concatenate([piece.reason for piece in pieces]),
            mark=np.concatenate([piece.mark for piece in pieces]),
            differences=np.concatenate([piece.differences for piece in pieces]),
            states=[text for piece in pieces for text in piece.states],
            compared=[text for piece in pieces for text in piece.compared],
            n_states=np.concatenate([piece.n_states for piece in pieces]),
            n_events=np.concatenate([piece.n_events for piece in pieces]),
            margin=np.concatenate([piece.margin for piece in pieces]),
            diagnostics={
                name: np.concatenate([piece.diagnostic(name) for piece in pieces]) for name in names
            },
            curves=ImpulseCurves.concatenate(curves) if curves else None,
            components=pieces[0].components,
        )


@dataclass(frozen=True, slots=True, eq=False)
class Comparison:
    """Results of one solver in n cells, and measures of their divergence from the results of the model."""

    #: The results. The impulse curves are dropped, because only the measures need them.
    results: SolverResults
    #: For each cell, a text that says why the cell is marked. Either a jump of the model's or of the solver's outcome
    #: is near, or a cut-off of the model decides the outcome. The text is empty where the cell is not marked.
    marked: Texts
    #: Measures by the names of their columns (`schema.MEASURES`); an empty mapping for the model itself.
    measures: ColumnArrays

    def __getitem__(self, place: slice) -> Comparison:
        measures = {name: values[place] for name, values in self.measures.items()}
        return Comparison(self.results[place], self.marked[place], measures)

    @classmethod
    def concatenate(cls, pieces: Sequence[Comparison]) -> Comparison:
        """Return one object with the comparisons of several objects, in the order of these objects."""
        if len(pieces) == 1:
            return pieces[0]
        return cls(
            results=SolverResults.concatenate([piece.results for piece in pieces]),
            marked=np.concatenate([piece.marked for piece in pieces]),
            measures={
                name: np.concatenate([piece.measures[name] for piece in pieces])
                for name in pieces[0].measures
            },
        )


def results_of(
    outcomes: Sequence[Outcome], speed: Floats, balls: int, contacts: int, shortest: Floats | None
) -> SolverResults:
    """Return the outcomes of a solver as arrays, with velocities among the diagnostics divided by abs(v0).

    Parameters
    ----------
    outcomes : sequence of Outcome
    speed : array, shape (n,)
        abs(v0) of each cell in m/s.
    balls, contacts : int
        Largest number of balls, and of contacts, that a cell has.
    shortest : array, shape (n,), or None
        Shortest time in s that a state of a pair must last to be compared. It is None if states are not compared. The
        result then has no impulse curves either.
    """
    if isinstance(outcomes, Outcomes):
        results = _results_of_arrays(outcomes, balls, contacts, with_states=shortest is not None)
        paths = outcomes.paths
    else:
        results = _results_of_list(outcomes, balls, contacts)
        paths = None
    diagnostics = {
        name: x / speed if _VELOCITY.fullmatch(name) else x for name, x in results.diagnostics.items()
    }
    results = replace(results, diagnostics=diagnostics)
    if shortest is None:
        return results
    if paths is None:
        single = [None] * len(speed) if isinstance(outcomes, Outcomes) else [o.path for o in outcomes]
        paths = Paths.of(single, balls, contacts)
    # Only a path tells how long each state lasts. If there is no path, all states of the solver are compared.
    held = zip(comparable_states(paths, shortest), results.states, strict=True)
    compared = [text or given for text, given in held]
    return replace(results, compared=compared, curves=ImpulseCurves(paths.offsets, paths.impulses))


def _results_of_arrays(outcomes: Outcomes, balls: int, contacts: int, *, with_states: bool) -> SolverResults:
    """Return the results of a batch of outcomes. The fields of the batch are arrays already."""
    n = len(outcomes)
    return SolverResults(
        velocities=_pad(outcomes.velocities, balls),
        impulses=_pad(outcomes.impulses, contacts),
        status=np.array(outcomes.statuses, dtype=object),
        reason=outcomes.reasons,
        mark=outcomes.marks,
        differences=np.full(n, "", dtype=object),
        states=outcomes.states.texts() if with_states and outcomes.states is not None else [""] * n,
        compared=[""] * n,
        n_states=outcomes.n_states,
        n_events=outcomes.n_events,
        margin=outcomes.grazing_margin,
        diagnostics=dict(outcomes.diagnostics),
        curves=None,
    )


def _results_of_list(outcomes: Sequence[Outcome], balls: int, contacts: int) -> SolverResults:
    """Return the results of a list of single outcomes. Each array of the results collects one field of all outcomes."""
    names = dict.fromkeys(name for outcome in outcomes for name in outcome.diagnostics)
    return SolverResults(
        velocities=_pad([outcome.velocities for outcome in outcomes], balls),
        impulses=_pad([outcome.impulses for outcome in outcomes], contacts),
        status=np.array([outcome.status for outcome in outcomes], dtype=object),
        reason=np.array([outcome.reason for outcome in outcomes], dtype=object),
        mark=np.array([outcome.mark for outcome in outcomes], dtype=object),
        differences=np.array([outcome.differences for outcome in outcomes], dtype=object),
        states=[" ".join(outcome.states) for outcome in outcomes],
        compared=[""] * len(outcomes),
        n_states=np.array([len(outcome.states) for outcome in outcomes], np.int64),
        n_events=np.array([outcome.n_events for outcome in outcomes], np.int64),
        margin=np.array([outcome.grazing_margin for outcome in outcomes], float),  # None becomes NaN
        diagnostics={
            name: np.array([outcome.diagnostics.get(name) for outcome in outcomes], float) for name in names
        },
        curves=None,
    )


def results_of_graphs(
    outcomes: Sequence[GraphCollisionOutcome], speed: Floats, components: tuple[str, ...]
) -> SolverResults:
    """Return the outcomes of contact graphs as arrays.

    Such outcomes have no impulses, states or paths.

    Parameters
    ----------
    outcomes : sequence of GraphCollisionOutcome
    speed : array, shape (n,)
        abs(v0) of each cell in m/s.
    components : tuple of str
        Names of the components of velocity, body after body, such as 1x, 1z, 2x, 2z.
    """
    n = len(outcomes)
    names = dict.fromkeys(name for outcome in outcomes for name in outcome.diagnostics)
    diagnostics = {
        name: np.array([outcome.diagnostics.get(name) for outcome in outcomes], float) for name in names
    }
    limits = _pad([_flattened(outcome.limit_velocities) for outcome in outcomes], len(components))
    if not np.isnan(limits).all():
        diagnostics |= {f"v{i}_limit": limit for i, limit in zip(components, limits.T, strict=True)}
    return SolverResults(
        velocities=_pad([_flattened(outcome.velocities) for outcome in outcomes], len(components)),
        impulses=np.empty((n, 0)),
        status=np.array([outcome.status for outcome in outcomes], dtype=object),
        reason=np.array([outcome.reason for outcome in outcomes], dtype=object),
        mark=np.array([outcome.mark for outcome in outcomes], dtype=object),
        differences=np.array([outcome.differences for outcome in outcomes], dtype=object),
        states=[""] * n,
        compared=[""] * n,
        n_states=np.zeros(n, np.int64),
        n_events=np.zeros(n, np.int64),
        margin=np.full(n, np.nan),
        diagnostics={name: x / speed if _VELOCITY.fullmatch(name) else x for name, x in diagnostics.items()},
        curves=None,
        components=components,
    )


def _flattened(velocities: Sequence[Sequence[float]]) -> list[float]:
    """Return one list with the components of the velocities of all bodies, body after body."""
    return [component for velocity in velocities for component in velocity]


def _pad(rows: Floats | Sequence[Sequence[float]], width: int) -> Floats:
    """Return rows of numbers as one array of `width` columns, with NaN at the end of shorter rows."""
    if isinstance(rows, np.ndarray) and rows.shape[1] == width:
        return rows
    padded = np.full((len(rows), width), np.nan)
    for row, values in zip(padded, rows, strict=True):
        row[: len(values)] = values
    return padded


def masses_and_starts(collisions: Sequence[Collision], balls: int) -> tuple[Floats, Floats]:
    """Return the masses in kg, and the velocities at first touch in m/s, of all balls of all cells.

    Both are of shape (n, `balls`), with NaN where a cell has fewer balls.
    """
    if isinstance(collisions, Collisions):
        return _pad(collisions.masses, balls), _pad(collisions.velocities, balls)
    masses, velocities = ([getattr(c, name) for c in collisions] for name in ("masses", "velocities"))
    return _pad(masses, balls), _pad(velocities, balls)


def masses_and_starts_of_graphs(collisions: Sequence[GraphCollision], width: int) -> tuple[Floats, Floats]:
    """Return, for contact graphs, the mass in kg and the initial velocity in m/s of every component of velocity.

    Both are of shape (n, width), with NaN where a graph has fewer components. The components x and z of a body have the
    same mass.
    """
    masses = [[mass for mass in c.masses for _ in c.velocities[0]] for c in collisions]
    return _pad(masses, width), _pad([_flattened(c.velocities) for c in collisions], width)


def norms(masses: Floats, differences: Floats, starts: Floats) -> Floats:
    """Return D, the kinetic norm of velocity differences over the kinetic norm of the initial velocities, shape (n,).

    The kinetic norm is the mass-weighted norm sqrt(sum m_i v_i^2). All arguments have the shape (n, N).
    """
    with np.errstate(over="ignore", invalid="ignore"):
        return kinetic_norm(masses, differences) / kinetic_norm(masses, starts)


def divergence(
    masses: Floats, starts: Floats, speed: Floats, model: SolverResults, other: SolverResults
) -> ColumnArrays:
    """Return every measure of how far a solver diverges from the model, by the name of its column, shape (n,).

    Differences are solver minus model. A measure is NaN or None in cells where the solver or the model has no result.

    Parameters
    ----------
    masses : array, shape (n, N)
        Masses in kg.
    starts : array, shape (n, N)
        Velocities at first touch in m/s.
    speed : array, shape (n,)
        abs(v0) in m/s.
    model, other : SolverResults
        Results of the model, and of the solver that is compared with it.
    """
    both = model.has_result & other.has_result
    absent = ~both
    dv = np.where(both[:, None], other.velocities - model.velocities, np.nan)
    di = np.where(both[:, None], other.impulses - model.impulses, np.nan)
    measures: ColumnArrays = {
        "velocity_divergence": np.where(absent, np.nan, norms(masses, dv, starts)),
        **{
            f"dv{i}": x / speed
            for i, x in zip(model.components or range(1, 1 + dv.shape[1]), dv.T, strict=True)
        },
        **{f"dimpulse{i}": x / (masses[:, 0] * speed) for i, x in enumerate(di.T, 1)},
        "largest_dv": np.max(np.abs(dv), axis=1, where=~np.isnan(dv), initial=0.0) / speed,
        "dretained_energy": retained_energy(masses, starts, other) - retained_energy(masses, starts, model),
    }
    measures["largest_dv"][absent] = measures["dretained_energy"][absent] = np.nan
    if model.curves is None or other.curves is None:
        return measures
    pairs = list(zip(model.compared, other.compared, strict=True))
    sequences = {texts: [text.split() for text in texts] for texts in set(pairs)}
    differences = {
        texts: (a == b, first_difference(a, b), edit_distance(a, b)) for texts, (a, b) in sequences.items()
    }
    states = [
        differences[texts] if is_result else (None,) * 3 for texts, is_result in zip(pairs, both, strict=True)
    ]
    names = "states_equal", "states_differ_at", "states_edit_distance"

    def scale(curves: ImpulseCurves) -> Floats:
        units = np.repeat(masses[:, 0] * speed, np.diff(curves.offsets))
        # The array is made contiguous: numba would compile `distances` a second time for another memory layout.
        return np.ascontiguousarray(curves.impulses / units[:, None])

    # Imported here, because importing numba takes longer than computing D of a single collision.
    from impact_xval.experiments.measures.hausdorff import distances

    apart = distances(scale(model.curves), scale(other.curves), model.curves.offsets, other.curves.offsets)
    measures |= zip(names, np.array(states, dtype=object).reshape(-1, 3).T, strict=True)
    return measures | {"impulse_curve_distance": np.where(both, apart, np.nan)}


def retained_energy(masses: Floats, starts: Floats, results: SolverResults) -> Floats:
    """Return the kinetic energy after the collision divided by the kinetic energy before it, shape (n,)."""
    return norms(masses, results.velocities, starts) ** 2


def retained_momentum(masses: Floats, starts: Floats, results: SolverResults) -> Floats:
    """Return the total momentum after the collision divided by the total momentum before it, shape (n,).

    The ratio is 1 if there is no table. It is negative if balls fall on a table and leave the table upwards.
    """
    weights = masses / np.nanmax(masses, axis=1, keepdims=True)
    with np.errstate(all="ignore"):  # the momentum before may be 0
        after, before = (np.nansum(weights * v, axis=1) for v in (results.velocities, starts))
        return np.where(np.isnan(results.velocities).all(axis=1), np.nan, after / before)


def retained_momentum_of_graphs(
    collisions: Sequence[GraphCollision], masses: Floats, starts: Floats, results: SolverResults
) -> Floats:
    """Return the retained momentum of contact graphs, shape (n,).

    The retained momentum is the component of the final momentum along the initial momentum, divided by the initial
    momentum. It is NaN where a fixed body, such as a table, takes momentum.
    """
    axes = len(collisions[0].velocities[0]) if len(collisions) else 1
    weights = masses / np.nanmax(masses, axis=1, keepdims=True)

    def momenta(velocities: Floats) -> Floats:
        return np.nansum((weights * velocities).reshape(len(masses), -1, axes), axis=1)

    before = momenta(starts)
    with np.errstate(all="ignore"):
        along = (momenta(results.velocities) * before).sum(axis=1) / (before**2).sum(axis=1)
    free = [all(contact.bodies[1] is not None for contact in c.contacts) for c in collisions]
    return np.where(free & results.has_numbers, along, np.nan)


def asymmetry(parameters: ColumnArrays, results: SolverResults) -> Floats:
    """Return how far the final velocities in contact graphs are from mirror symmetry, shape (n,).

    In a symmetric scene every body has a mirror image, which is another body or the body itself. The result is the
    largest difference between a body's velocity and the mirrored velocity of the body's mirror image, per abs(v0). It
    is NaN where the scene is not symmetric.

    Parameters
    ----------
    parameters : mapping of str to array, shape (n,)
        Parameters of the contact graphs by name.
    results : SolverResults
    """
    axes = [name for name in GRAPH_AXES if name != "graph"]
    numbers = zip(*(parameters[name].tolist() for name in axes), strict=True)
    found = np.full(len(results), np.nan)
    for i, (name, row) in enumerate(zip(parameters["graph"].tolist(), numbers, strict=True)):
        mirror = GRAPH_SPECS[name].mirror(dict(zip(axes, row, strict=True)))
        if mirror is not None:
            velocities = results.velocities[i].reshape(-1, 2)[: len(mirror.images)]
            found[i] = distance_from_mirror_image(velocities, mirror) / abs(parameters["v0"][i])
    return found


def distance_from_mirror_image(velocities: Floats, mirror: Mirror) -> float:
    """Return the largest difference between the velocity of a body and the mirrored velocity of its mirror image.

    Velocities in m/s are of shape (N, 2).
    """
    images = velocities[list(mirror.images)]
    images[:, mirror.coordinate] *= -1
    return float(np.abs(velocities - images).max())


def first_difference(a: Sequence[str], b: Sequence[str]) -> int | None:
    """Return the position, from 1, of the first state in which two sequences differ; None if they are equal."""
    pairs = enumerate(zip_longest(a, b), start=1)
    return next((position for position, (x, y) in pairs if x != y), None)


def edit_distance(a: Sequence[str], b: Sequence[str]) -> int:
    """Return the least number of insertions, deletions and substitutions that turn a into b (Levenshtein)."""
    row = list(range(len(b) + 1))
    for i, x in enumerate(a, start=1):
        diagonal, row[0] = row[0], i
        for j, y in enumerate(b, start=1):
            diagonal, row[j] = row[j], min(row[j] + 1, row[j - 1] + 1, diagonal + (x != y))
    return row[-1]


def measures_of(collision: Collision, outcomes: Mapping[str, Outcome]) -> dict[str, dict[str, float]]:
    """Return the measures of one collision's outcomes, by solver and by the name of the measure.

    The diagnostics that are velocities are among the measures. They are divided by abs(v0). A measure is NaN if a
    result that it needs is missing.
    """
    balls, contacts = len(collision.masses), len(collision.stiffnesses)
    masses, starts = masses_and_starts([collision], balls)
    speed = np.abs(starts).max(axis=1)
    measured: dict[str, dict[str, float]] = {}
    results = {
        name: results_of([outcome], speed, balls, contacts, None) for name, outcome in outcomes.items()
    }
    for name, result in results.items():
        model, exact = results.get(REFERENCE), results.get(exact_solver_for(name, "calibrated"))
        measures = {"retained_energy": retained_energy(masses, starts, result)}
        measures["retained_momentum"] = retained_momentum(masses, starts, result)
        if model is not None:
            measures |= divergence(masses, starts, speed, model, result)
        if exact is not None:
            limit = [result.diagnostic(f"v{i}_limit") for i in range(1, 1 + balls)]
            measures["limit_distance"] = np.abs(np.transpose(limit) - exact.velocities / speed).max(axis=1)
        absent = {key: [np.nan] for key in ("velocity_divergence", "limit_distance", "limit_error")}
        measured[name] = {key: float(x[0]) for key, x in (absent | result.diagnostics | measures).items()}
    return measured
