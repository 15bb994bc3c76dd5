"""The part of the scoreboard for collisions of balls in a plane, which are contact graphs.

`collect_plane_answers` asks engines and exact laws for the outcome of each case in `plane_cases`. `judge_plane_answers`
compares the answers of engines with those of the exact laws. `write_plane` writes the answers into a file, and returns
the section about them for the page. Needs pandas. Each solver answers the cases in a process of its own.
"""

from __future__ import annotations

import contextlib
import json
from collections.abc import Callable, Sequence
from concurrent.futures import as_completed
from hashlib import sha256
from importlib.metadata import version
from pathlib import Path

import numpy as np
import pandas as pd

from impact_xval.compliant_baselines.engines.engine import Engine
from impact_xval.compliant_baselines.registry import exact_law_names, get_solver, is_engine
from impact_xval.experiments.config.errors import InterruptedRunError
from impact_xval.experiments.measures.divergence import (
    distance_from_mirror_image,
    masses_and_starts_of_graphs,
    norms,
)
from impact_xval.experiments.presentation.document import Section, Table
from impact_xval.experiments.scoreboard.cases import SETTINGS
from impact_xval.experiments.scoreboard.page import EXPLAINED, display_engine
from impact_xval.experiments.scoreboard.plane_cases import PLANE_CASES, PLANE_SETUPS, answer_plane_case
from impact_xval.experiments.sweep.pool import TO_PREPARE, Slot, open_pool
from impact_xval.experiments.sweep.process import FaultError
from impact_xval.experiments.tables.folder import new_folder, write_text
from impact_xval.experiments.tables.frames import Frame, Record
from impact_xval.experiments.tables.numbers import number
from impact_xval.experiments.tables.parquet import replacing

#: Name of the file with the answers to the cases in a plane, in the folder of a scoreboard.
PLANE_ANSWERS = "plane.parquet"

TITLE = "In a plane"

#: Columns of velocities in m/s: the components x and z of at most seven balls.
VELOCITIES = [f"v{ball}{axis}" for ball in range(1, 8) for axis in "xz"]

#: Columns of the table of answers; the docstring of `collect_plane_answers` explains them.
PLANE_COLUMNS = ["solver", "version", "case", "e", "status", "reason", *VELOCITIES]

#: Time in s after which a solver's answer to one case is given up.
_LONGEST = 120.0

#: A law can be the nearest law of an engine only if it answers at least this share of the cases that the engine
#: answers.
_LEAST_ANSWERED = 0.9

#: The nearest law of an engine has the least largest distance D, over all cases, from the engine's answers. Laws whose
#: largest D is larger by at most this number are also listed as nearest.
_AS_NEAR = 1e-6

CAPTION = (
    "The table shows, for each case, the largest D between the engine and its nearest law, over all e. The nearest "
    "law is the exact law with the smallest largest D over all cases. Only laws that solve nine tenths of the cases "
    f"that the engine solves count. The engine follows its nearest law if no D exceeds {EXPLAINED}. Bernoulli: a ball "
    "falls between two others, 30 degrees to either side. Corner: a ball meets two walls whose normals enclose the "
    "angle. Bridge: a ball falls on two balls that rest on a table. Rack: a cue ball strikes 3 or 6 balls. All "
    "stiffnesses are equal. A law that solves one contact after the other takes the contacts in the order of their "
    "numbers, and an engine may take another order. Asymmetry: the largest difference between the velocity of a body "
    "and the mirrored velocity of its mirror image in bernoulli, bridge and racks, divided by |v0|. Exact solutions "
    "have no asymmetry. Springs and dashpots cannot give e = 0, so their engines have no answer there."
)


def list_plane_entrants(names: Sequence[str]) -> list[str]:
    """Return the given solvers that take part: exact laws, and engines that can compute collisions in a plane."""
    entrants: list[str] = []
    for name in names:
        solver = get_solver(name)
        if isinstance(solver, Engine) and not solver.knows_planes:
            continue
        if name in exact_law_names() or isinstance(solver, Engine):
            entrants.append(name)
    return entrants


def list_stored_in_plane(names: Sequence[str], root: Path) -> list[str]:
    """Return the solvers whose answers `collect_plane_answers` would read from the folder `root`."""
    return [
        name for name in names if _answers_path(root / "answers", name, get_solver(name).version()).exists()
    ]


def collect_plane_answers(
    names: Sequence[str], root: Path, workers: int, progress: Callable[..., None]
) -> pd.DataFrame:
    """Let every solver answer every case in a plane, and return the answers as a table.

    Each solver runs in its own process. Answers are kept in files in the folder of the scoreboard, so that an
    interrupted command can continue. The table has one row per answer, with the columns solver, version, case, e,
    status, reason, and the velocities v1x, v1z, v2x, ... in m/s.
    """
    folder = root / "answers"
    if not folder.is_dir():
        new_folder(root)
        folder.mkdir()
    try:
        with open_pool(None, workers) as pool:
            futures = [pool.submit(_answer_or_read, name, folder) for name in names]
            for done, future in enumerate(as_completed(futures), 1):
                future.result()  # if one solver raises an error, the whole command ends
                progress(done * len(PLANE_CASES), len(futures) * len(PLANE_CASES), "")
    except KeyboardInterrupt:
        raise InterruptedRunError("interrupted; answers are kept; the same command continues") from None
    rows = [row for future in futures for row in future.result()]
    return pd.DataFrame(rows, columns=PLANE_COLUMNS)


def _answer_or_read(slot: Slot[None], name: str, folder: Path) -> list[Record]:
    """Return a solver's answers to all cases: from its file of earlier answers, or else from its process."""
    installed = get_solver(name).version()
    path = _answers_path(folder, name, installed)
    if path.exists():
        return json.loads(path.read_text(encoding="utf-8"))
    rows: list[Record] = []
    with contextlib.suppress(FaultError):  # the call of each case below returns the error as its reason
        slot.call(name, answer_plane_case, name, *next(iter(PLANE_CASES)), timeout=TO_PREPARE)
    for case, e in PLANE_CASES:
        try:
            status, reason, velocities = slot.call(name, answer_plane_case, name, case, e, timeout=_LONGEST)
        except FaultError as fault:
            status, reason, velocities = fault.status, fault.reason, ()
        row = {"solver": name, "version": installed, "case": case, "e": e, "status": status, "reason": reason}
        rows.append(row | dict(zip(VELOCITIES, velocities, strict=False)))
    write_text(path, json.dumps(rows, indent=1))
    return rows


def _answers_path(folder: Path, name: str, installed: str) -> Path:
    """Return the path of the file with a solver's answers.

    Its name contains a hash of the versions, the cases and the settings. So answers from other versions are not read.
    """
    identifying = version("impact-xval"), installed, PLANE_SETUPS, list(PLANE_CASES), str(SETTINGS)
    identity = sha256(json.dumps(identifying).encode()).hexdigest()[:12]
    return folder / f"plane-{name.replace(':', '-')}-{identity}.json"


def judge_plane_answers(answers: Frame) -> Frame:
    """Return the answers with columns for the distance from each exact law and for the asymmetry.

    The column ``D_LAW`` has the kinetic norm of the difference from the law's velocities, as a share of the norm at the
    start. It is NaN where the solver or the law has no answer. ``asymmetry`` is the largest difference, over abs(v0),
    between a velocity and the mirrored velocity of the body's mirror image. It is NaN where a scene has no mirror
    symmetry.
    """
    velocities = answers[VELOCITIES].to_numpy(float)
    cases = [PLANE_CASES[case] for case in zip(answers.case, answers.e, strict=True)]
    masses, starts = masses_and_starts_of_graphs([case.collision for case in cases], len(VELOCITIES))
    of_case = pd.DataFrame(velocities, index=pd.MultiIndex.from_frame(answers[["solver", "case", "e"]]))
    judged = answers.copy()
    for law in exact_law_names():
        same_case = pd.MultiIndex.from_frame(answers.assign(solver=law)[["solver", "case", "e"]])
        difference = velocities - of_case.reindex(same_case).to_numpy()
        # Columns of balls that a case does not have are NaN. If there is no answer, the first column is NaN too.
        known = ~np.isnan(difference[:, 0])
        judged[f"D_{law}"] = np.where(known, norms(masses, difference, starts), np.nan)
    judged["asymmetry"] = [
        np.nan
        if case.mirror is None
        else distance_from_mirror_image(row.reshape(-1, 2)[: len(case.mirror.images)], case.mirror)
        for case, row in zip(cases, velocities, strict=True)
    ]
    return judged


def plane_table(judged: Frame) -> Table:
    """Return the table with one row per engine: its nearest law, the distances from it, and its asymmetry.

    For each case the table has the largest D over all restitutions e. D is the distance of the engine's velocities from
    those of the nearest law (`judge_plane_answers`). The asymmetry is the largest one of all cases.
    """
    rows: list[tuple[str, ...]] = []
    laws = exact_law_names()
    for name, own in judged[judged.solver.map(is_engine)].groupby("solver", sort=False):
        answered = int(own.v1x.notna().sum())
        count = f"{answered} of {len(own)}"
        distances = own[[f"D_{law}" for law in laws]]
        is_candidate = (distances.count() >= max(1, _LEAST_ANSWERED * answered)).to_numpy()
        if not is_candidate.any():
            nothing = ["-"] * len(PLANE_SETUPS)
            rows.append((display_engine(str(name)), own.version.iloc[0], "no answer", *nothing, "-", count))
            continue
        largest = distances.max().where(is_candidate)
        nearest = [str(name) for name in largest.index[largest <= largest.min() + _AS_NEAR]]
        column, words = nearest[0], ", ".join(name.removeprefix("D_") for name in nearest)
        by_case = own.groupby("case")[column].max().reindex(list(PLANE_SETUPS))
        rows.append(
            (
                display_engine(str(name)),
                own.version.iloc[0],
                words if largest[column] <= EXPLAINED else f"no exact law (nearest: {words})",
                *(_short(d) for d in by_case),
                _short(own.asymmetry.max(), 1e-5),
                count,
            )
        )
    return Table(
        ("engine", "release", "nearest law", *PLANE_SETUPS, "asymmetry", "answers"), rows, CAPTION, text=3
    )


def _short(value: float, least: float = 1e-4) -> str:
    """Return a number as a text with two digits, or a text such as ``< 1e-4`` if it is below `least`; ``-`` for NaN."""
    if np.isnan(value):
        return "-"
    return f"< {least:.0e}".replace("e-0", "e-") if value < least else number(value, 2)


def write_plane(answers: Frame, root: Path) -> Section:
    """Write the answers in a plane into the folder of a scoreboard, and return the section about them for its page."""
    with replacing(root / PLANE_ANSWERS) as temporary:
        answers.to_parquet(temporary, index=False, compression="zstd")
    return Section(TITLE, [plane_table(judge_plane_answers(answers))])
