"""The part of the scoreboard in a plane: contact graphs, solved by engines and by exact laws.

The command ``impact-xval scoreboard`` calls `collect_plane_answers`, which runs the solvers, and `write_plane`, which
stores their answers and returns the section of the page.
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

#: Name of the file in the folder of a scoreboard that holds the answers in a plane.
PLANE_ANSWERS = "plane.parquet"

TITLE = "In a plane"

#: Columns of the velocities along x and z in m/s. The largest graph, a rack of 6 and a cue ball, has seven balls.
VELOCITIES = [f"v{ball}{axis}" for ball in range(1, 8) for axis in "xz"]

#: Columns of answers, as `collect_plane_answers` describes them.
PLANE_COLUMNS = ["solver", "version", "case", "e", "status", "reason", *VELOCITIES]

#: Time limit in s of one case.
_LONGEST = 120.0

#: A law can be the nearest law of an engine only if it solves at least this fraction of the cases that the engine
#: solves.
_LEAST_ANSWERED = 0.9

#: If the largest D of two laws differ by no more than this number, both laws are named as nearest.
_AS_NEAR = 1e-6

CAPTION = (
    "The table shows, for each case, the largest D between the engine and its nearest law, over all e. The nearest law "
    "is the exact law with the smallest largest D over all cases. Only laws that solve nine tenths of the engine's "
    f"cases count. The engine follows its nearest law if no D exceeds {EXPLAINED}. Bernoulli: a ball falls between two "
    "others, 30 degrees to either side. Corner: a ball meets two walls whose normals enclose the angle. Bridge: a ball "
    "falls on two balls that rest on a table. Rack: a cue ball strikes 3 or 6 balls. All stiffnesses are equal. A law "
    "that solves one contact after the other takes the contacts in the order of their numbers, and an engine may take "
    "another order. Asymmetry: the largest difference between the velocity of a body and the mirrored velocity of its "
    "mirror image in bernoulli, bridge and racks, divided by |v0|. Exact solutions have no asymmetry. Springs and "
    "dashpots cannot give e = 0, so their engines have no answer there."
)


def list_plane_entrants(names: Sequence[str]) -> list[str]:
    """Return the given solvers that are exact laws, or engines that solve balls in a plane."""
    entrants: list[str] = []
    for name in names:
        solver = get_solver(name)
        if isinstance(solver, Engine) and not solver.knows_planes:
            continue
        if name in exact_law_names() or isinstance(solver, Engine):
            entrants.append(name)
    return entrants


def collect_plane_answers(
    names: Sequence[str], root: Path, workers: int, progress: Callable[..., None]
) -> pd.DataFrame:
    """Return the answers of solvers to every case in a plane. Each solver runs in its own process.

    The table has one row per answer, with the columns solver, version, case, e, status, reason, and the velocities v1x,
    v1z, v2x, ... in m/s. The answers are also stored in the folder `root`, so that an interrupted command can continue.
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
    """Return the answers of a solver, which are read from its file or, if there is no file, computed and stored.

    The name of the file contains a hash of the versions, the cases and the settings.
    """
    installed = get_solver(name).version()
    identifying = version("impact-xval"), installed, PLANE_SETUPS, list(PLANE_CASES), str(SETTINGS)
    identity = sha256(json.dumps(identifying).encode()).hexdigest()[:12]
    path = folder / f"plane-{name.replace(':', '-')}-{identity}.json"
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


def judge_plane_answers(answers: Frame) -> Frame:
    """Return the answers with the columns ``D_LAW``, D from each exact law, and ``asymmetry``.

    The asymmetry is NaN in scenes that have no mirror image.
    """
    velocities = answers[VELOCITIES].to_numpy(float)
    cases = [PLANE_CASES[case] for case in zip(answers.case, answers.e, strict=True)]
    masses, starts = masses_and_starts_of_graphs([case.collision for case in cases], len(VELOCITIES))
    of_case = pd.DataFrame(velocities, index=pd.MultiIndex.from_frame(answers[["solver", "case", "e"]]))
    judged = answers.copy()
    for law in exact_law_names():
        same_case = pd.MultiIndex.from_frame(answers.assign(solver=law)[["solver", "case", "e"]])
        difference = velocities - of_case.reindex(same_case).to_numpy()
        # The columns of balls that a case does not have are NaN. In a case without an answer v1x is NaN too.
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
    """Return a table with one row per engine: nearest law, largest D from this law in each case, largest asymmetry."""
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
    """Format a number with two digits; a number below `least` is written as ``"< least"``, and NaN as ``"-"``."""
    if np.isnan(value):
        return "-"
    return f"< {least:.0e}".replace("e-0", "e-") if value < least else number(value, 2)


def write_plane(answers: Frame, root: Path) -> Section:
    """Write the answers in a plane into the folder of a scoreboard, and return the section of its page."""
    with replacing(root / PLANE_ANSWERS) as temporary:
        answers.to_parquet(temporary, index=False, compression="zstd")
    return Section(TITLE, [plane_table(judge_plane_answers(answers))])
