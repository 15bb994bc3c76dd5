"""Dense maps over the plane of k2/k1 and m2/m1: where each cause of divergence matters that needs no engine.

Every cell of the plane is solved at all corners between the model and kelvin-voigt in the scenario asked for, exactly,
and split as `measures.ladder` splits an engine: the causes are means over their six orders. A map is made block by
block, so that its memory does not grow with its size.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from impact_xval.compliant_baselines.contract.registry import KELVIN_VOIGT
from impact_xval.compliant_baselines.contract.state_transition import model_paths
from impact_xval.compliant_baselines.references.batch import ReferenceBatch
from impact_xval.experiments.measures.corners import FREE, WEIGHTLESS, gather, laws_of, solvers
from impact_xval.experiments.measures.ladder import FROZEN, GRAVITY, LAW, Floats, split, weights_of_two
from impact_xval.experiments.tables.streams import replacing
from impact_xval.model import Cutoff, solve_batch
from impact_xval.model.kinetic import kinetic_norm

#: Cells written together.
_BLOCK = 25_000

#: Cells solved together at first, and seconds below which twice as many are next, else half: where ratios are far
#: from 1, one may take seconds.
_FIRST, _SHORT = 1, 2.0

#: What `paths` says of a cell: which references pass through the states of the model.
ALIKE, FROZEN_PARTS, LAW_PARTS, NO_PATH = 0, 1, 2, 3
PATHS = (
    "all three alike",
    "bistiffness leaves the model's path: frozen positions",
    "kelvin-voigt alone leaves it: dissipation law",
    "not told: a closed-form limit ended a path",
)

PLANE_CAUSES = (FROZEN, LAW, GRAVITY)

_FIELDS = (
    ("stiffness_ratio", pa.float64(), "k2/k1"),
    ("mass_ratio", pa.float64(), "m2/m1"),
    ("gravity_number", pa.float64(), "g/(|v0| omega1), omega1 = sqrt(k1 (1/m1 + 1/m2)); 0 without gravity"),
    *(
        (f"{name}_{v}", pa.float64(), f"final velocity of {ball} per |v0|, {label}")
        for name, label in (
            ("model", "the state-transition model"),
            ("liu_zhao_brogliato", "the impact law of Liu, Zhao and Brogliato"),
            ("bistiffness", "bistiffness without gravity"),
            ("kelvin_voigt", "kelvin-voigt without gravity"),
            ("scenario", "kelvin-voigt in the scenario of the map"),
        )
        for v, ball in (("v1", "B1"), ("v2", "B2"))
    ),
    *(
        (
            f"{cause.name}_norm",
            pa.float64(),
            f"kinetic norm of {cause.phrase}, mean over the six orders of the causes (Shapley value)",
        )
        for cause in PLANE_CAUSES
    ),
    ("repeats_norm", pa.float64(), "kinetic norm of the law of Liu, Zhao and Brogliato minus the model"),
    ("velocity_divergence", pa.float64(), "D of kelvin-voigt in the scenario from the model"),
    (
        "dominant",
        pa.int8(),
        "cause with the largest share: 0 frozen positions, 1 dissipation law, 2 gravity; -1 none",
    ),
    ("paths", pa.int8(), "; ".join(f"{code} {text}" for code, text in enumerate(PATHS))),
    ("grazing_margin", pa.float64(), "grazing margin of the model; small beside a jump"),
    ("failed", pa.bool_(), "whether one of the solvers has no result"),
)
PLANE_SCHEMA = pa.schema(
    [pa.field(name, kind, metadata={"unit": "-", "meaning": meaning}) for name, kind, meaning in _FIELDS]
)

#: Columns that figures are drawn from.
DRAWN = (
    "frozen_positions_norm",
    "dissipation_law_norm",
    "gravity_norm",
    "repeats_norm",
    "dominant",
    "paths",
    "failed",
)


@dataclass(frozen=True, slots=True)
class Plane:
    """What a map shows.

    Attributes
    ----------
    e1, e2 : float
        Coefficients of restitution.
    stiffness_ratio, mass_ratio : tuple of float
        Least and largest k2/k1 and m2/m1; both axes are logarithmic.
    side : int
        Cells along each side.
    gravity : float
        g/(abs(v0) sqrt(k1/m1)); 0 for an impact.
    stiffness_ratio_cutoff : float or "exact"
        Of the model.
    """

    e1: float
    e2: float
    stiffness_ratio: tuple[float, float]
    mass_ratio: tuple[float, float]
    side: int
    gravity: float
    stiffness_ratio_cutoff: Cutoff

    def axes(self) -> tuple[Floats, Floats]:
        """Values of k2/k1 and m2/m1."""
        return np.geomspace(*self.stiffness_ratio, self.side), np.geomspace(*self.mass_ratio, self.side)


def write_plane(
    plane: Plane, path: Path, progress: Callable[[int, int, str], None] = lambda done, total, line: None
) -> dict[str, NDArray]:
    """Solve a map and write it as Parquet, one row a cell, k2/k1 varying fastest.

    Parameters
    ----------
    plane : Plane
    path : Path
        The file; written under another name and renamed.
    progress : callable
        Told how many cells are done, of how many.

    Returns
    -------
    dict of ndarray, shape (side, side)
        The columns `DRAWN`; rows are m2/m1, columns k2/k1.
    """
    kappa, mu = plane.axes()
    cells, together = plane.side**2, _FIRST
    block = max(1, _BLOCK // plane.side) * plane.side
    drawn: dict[str, list[NDArray]] = {name: [] for name in DRAWN}
    with (
        replacing(path) as temporary,
        pq.ParquetWriter(temporary, PLANE_SCHEMA, compression="zstd") as writer,
    ):
        for first in range(0, cells, block):
            done, end, tables = first, min(first + block, cells), []
            while done < end:
                start, some = time.monotonic(), np.arange(done, min(done + together, end))
                tables.append(_solve(plane, kappa[some % plane.side], mu[some // plane.side]))
                quick = time.monotonic() - start < _SHORT
                together = min(2 * together, block) if quick else max(1, together // 2)
                done += len(some)
                progress(done, cells, "")
            table = pa.concat_tables(tables).combine_chunks()
            writer.write_table(table)
            for name, pieces in drawn.items():
                pieces.append(table[name].to_numpy().reshape(-1, plane.side))
    return {name: np.concatenate(pieces) for name, pieces in drawn.items()}


def _solve(plane: Plane, kappa: Floats, mu: Floats) -> pa.Table:
    """Solve cells and measure the differences between their outcomes."""
    cells = kappa, mu, np.full(kappa.shape, plane.e1), np.full(kappa.shape, plane.e2)
    cutoff = plane.stiffness_ratio_cutoff
    number = plane.gravity / np.sqrt(1 + 1 / mu)
    model = solve_batch(*cells, stiffness_ratio_cutoff=cutoff)
    repeats = solve_batch(*cells, stiffness_ratio_cutoff=cutoff, impact_law="liu-zhao-brogliato")
    laws = laws_of(KELVIN_VOIGT, KELVIN_VOIGT)
    batches = {index: solve(*cells, gravity) for index, solve, gravity in solvers(number, laws)}
    corners = gather(np.column_stack([model.v1, model.v2]), batches.items(), laws)
    stiff, dashpot = batches[FREE, 0, WEIGHTLESS], batches[FREE, 1, WEIGHTLESS]
    outcomes = {
        "model": corners.model,
        "liu_zhao_brogliato": np.column_stack([repeats.v1, repeats.v2]),
        "bistiffness": corners.velocities[FREE, 0, WEIGHTLESS],
        "kelvin_voigt": corners.velocities[FREE, 1, WEIGHTLESS],
        "scenario": corners.asked,
    }
    columns = {
        "stiffness_ratio": kappa,
        "mass_ratio": mu,
        "gravity_number": number,
        **{f"{name}_v{i + 1}": v[:, i] for name, v in outcomes.items() for i in range(2)},
    }
    parts = split(weights_of_two(mu), corners, np.full_like(corners.asked, np.nan), corners.asked)
    away = outcomes["liu_zhao_brogliato"] - corners.model
    failed = (corners.reason != "") | np.isnan(corners.model).any(axis=1) | np.isnan(away).any(axis=1)
    columns |= {f"{cause.name}_norm": parts.norms[parts.contributions.index(cause)] for cause in PLANE_CAUSES}
    columns |= {
        "repeats_norm": kinetic_norm(mu, away[:, 0], away[:, 1]),
        "velocity_divergence": parts.divergence,
        "dominant": np.where(failed, -1, parts.dominant()),
        "paths": _compare_paths(model_paths(*cells, cutoff), model.status == "ok", stiff, dashpot),
        "grazing_margin": model.grazing_margin,
        "failed": failed,
    }
    return pa.table(
        {name: pa.array(columns[name], PLANE_SCHEMA.field(name).type) for name in PLANE_SCHEMA.names}
    )


def _compare_paths(
    model: tuple[NDArray[np.uint64], NDArray[np.int64]],
    followed: NDArray[np.bool_],
    stiff: ReferenceBatch,
    dashpot: ReferenceBatch,
) -> NDArray[np.int8]:
    """Say which paths are alike: of the same length, with the same last 32 states."""
    sequence, n_states = model

    def alike(other: ReferenceBatch) -> NDArray[np.bool_]:
        return (other.sequence == sequence) & (other.n_states == n_states)

    told = followed & (n_states > 0) & (stiff.status == "ok") & (dashpot.status == "ok")
    parts = np.where(~alike(stiff), FROZEN_PARTS, np.where(alike(dashpot), ALIKE, LAW_PARTS))
    return np.where(told, parts, NO_PATH).astype(np.int8)
