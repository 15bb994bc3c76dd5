"""Changes between releases of an engine, found by comparing the answers of each version with the version before.

The command `impact-xval scoreboard` calls this module if it is asked for other versions of engines (option ``--with``).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import pandas as pd
from packaging.version import Version

from impact_xval.experiments.presentation.document import Block, Section, Table
from impact_xval.experiments.scoreboard.cases import CASE_SETUPS
from impact_xval.experiments.scoreboard.environments import NotInstalledError, solvers_by_distribution
from impact_xval.experiments.scoreboard.judging import list_moved_answers
from impact_xval.experiments.scoreboard.page import display_engine
from impact_xval.experiments.tables.folder import write_text
from impact_xval.experiments.tables.frames import Frame
from impact_xval.experiments.tables.numbers import join_words, number
from impact_xval.experiments.tables.parquet import replacing

#: Names of files in the folder of a scoreboard: the answers of all versions, and the answers that changed.
ANSWERS, MOVED = "releases.parquet", "releases.csv"

TITLE = "What releases changed"

#: Largest change of a velocity, over |v0|, that is ignored. The comparison of a scoreboard with an earlier scoreboard
#: ignores changes up to the same size.
TOLERANCE = 1e-6

CAPTION = (
    "Each row is a version, compared with the nearest version above that has answers. A number is the largest change "
    "of a velocity, over |v0|, among all e and all placements of a case. = : no change is larger than "
    f"{TOLERANCE:g}. ! : the status changed, or only one of the two versions has an answer. - : no answer, or no "
    "version before. * : the version has changed answers. “Moved” counts these answers, of all that the version was "
    "asked for."
)


@dataclass(frozen=True, slots=True)
class Release:
    """A version of an engine, compared with the version before."""

    solver: str
    version: str
    #: The last earlier version with answers; None for the first version with answers.
    before: str | None = None
    #: Answers that changed, from `judging.list_moved_answers`, and the number of answers that were compared.
    moved: Frame | None = None
    compared: int = 0
    #: Names of the cases that this version solves for at least one restitution e.
    answered: frozenset[str] = frozenset()
    #: Reason why this version has no answer at all; an empty text if the version has answers.
    reason: str = ""

    @property
    def differs(self) -> bool:
        """Whether at least one answer of this version differs from the version before."""
        return self.moved is not None and len(self.moved) > 0


def compare_releases(here: Frame, elsewhere: Frame) -> list[Release]:
    """Compare each version of every engine with the version before; return the comparisons by rising version.

    Parameters
    ----------
    here
        Answers of the engines in this installation. The version that is installed here is compared too.
    elsewhere
        Answers of the versions that the user asked for. If two environments hold the same version of an engine, the
        answers of the first count.
    """
    both = (elsewhere, here[here.solver.isin(elsewhere.solver) & (here.version != "")])
    answers = pd.concat([part.drop(columns="microseconds") for part in both], ignore_index=True)
    answers = answers.drop_duplicates(["solver", "version", "case", "e", "arrangement"])
    releases: list[Release] = []
    for solver, of_solver in answers.groupby("solver", sort=False):
        by_version = {str(version): rows for version, rows in of_solver.groupby("version")}
        before: str | None = None
        for version in sorted(by_version, key=Version):
            now = by_version[version]
            if now.v1.isna().all():
                releases.append(Release(str(solver), version, reason=now.reason.iloc[0]))
                continue
            if before is None:
                releases.append(Release(str(solver), version))
            else:
                changes = list_moved_answers(by_version[before], now, TOLERANCE)
                answered = frozenset(now.case[now.v1.notna()])
                releases.append(Release(str(solver), version, before, changes, len(now), answered))
            before = version
    return releases


def write_releases(
    releases: Sequence[Release], missing: Sequence[NotInstalledError], answers: Frame, root: Path
) -> Section:
    """Write the answers of all versions, and their changes, into a scoreboard's folder; return the page's section."""
    with replacing(root / ANSWERS) as temporary:
        answers.to_parquet(temporary, index=False, compression="zstd")
    changes = [
        release.moved.assign(solver=release.solver, before=release.before, version=release.version)
        for release in releases
        if release.moved is not None
    ]
    text = pd.concat(changes).to_csv(index=False, lineterminator="\n") if changes else ""
    write_text(root / MOVED, text)
    return Section(TITLE, [*describe_releases(releases), release_table(releases, missing)])


def describe_releases(releases: Sequence[Release]) -> list[Block]:
    """Return sentences that say which versions of each engine answer differently from the version before."""
    sentences: list[str] = []
    for distribution, names in solvers_by_distribution().items():
        same: list[str] = []
        of_engine = [release for release in releases if release.solver in names and not release.reason]
        for name in dict.fromkeys(release.solver for release in of_engine):
            own = [release for release in of_engine if release.solver == name]
            changes = [_change_in_words(release) for release in own if release.differs]
            if changes:
                sentences.append(f"{display_engine(name)}: {'; '.join(changes)}.")
            elif len(own) > 1:
                same.append(display_engine(name))
        if same:
            versions = join_words(dict.fromkeys(release.version for release in of_engine))
            sentences.append(
                f"{join_words(same)} answer{'s' * (len(same) == 1)} the same in {distribution} {versions}."
            )
    return [*sentences]


def _change_in_words(release: Release) -> str:
    """Return words that tell how many answers a release changed, and the largest change of a velocity."""
    assert release.moved is not None
    moved = f"{release.version} moved {len(release.moved)} of {release.compared} answers of {release.before}"
    if release.moved.change.isna().all():
        return f"{moved}, none of them with velocities from both versions"
    largest = release.moved.loc[release.moved.change.idxmax()]
    return (
        f"{moved}, the farthest by {number(largest.change, 2)} |v0| ({largest.case}, e = {number(largest.e)}, "
        f"{largest.arrangement})"
    )


def release_table(releases: Sequence[Release], missing: Sequence[NotInstalledError]) -> Table:
    """Return the table of releases, with one row per version and one column per case. Missing answers have a reason."""
    rows: list[tuple[str, ...]] = []
    nothing = ["-"] * len(CASE_SETUPS)
    for distribution, names in solvers_by_distribution().items():
        for release in (release for release in releases if release.solver in names):
            if release.reason:
                rows.append(
                    (
                        display_engine(release.solver),
                        release.version,
                        f"no answer: {release.reason}",
                        *nothing,
                    )
                )
            elif release.moved is None:
                rows.append((display_engine(release.solver), release.version, "the first", *nothing))
            else:
                count = f"{len(release.moved)} of {release.compared}"
                version = f"{release.version} *" if release.differs else release.version
                rows.append((display_engine(release.solver), version, count, *_largest_changes(release)))
        for error in (error for error in missing if error.distribution == distribution):
            rows.append((distribution, error.requirement, f"not installed: {error.reason}", *nothing))
    return Table(("engine", "version", "moved", *CASE_SETUPS), rows, CAPTION, text=3)


def _largest_changes(release: Release) -> list[str]:
    """Return, for each case, the table cell with the largest change of a velocity."""
    assert release.moved is not None
    cells: list[str] = []
    for case in CASE_SETUPS:
        changes = release.moved[release.moved.case == case]
        if changes.empty:
            cells.append("=" if case in release.answered else "-")
            continue
        largest = changes.change.max()
        parts = [number(largest, 2)] if largest > TOLERANCE else []
        another_status = (changes.status_before != changes.status_after).any()
        # If neither a velocity nor a status changed, only one of the two versions has velocities, because the other
        # version gave up in a flight. This case is shown like a change of status.
        cells.append(" ".join([*parts, "!"] if another_status or not parts else parts))
    return cells
