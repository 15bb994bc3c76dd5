"""Answers of every practice and of the exact laws, each of them in a process of its own.

An engine that dies, hangs or answers what is no number costs the answers that it fails to give. No number depends on
what ran before: a process runs one practice. What has been answered is kept, a file a practice, for a board that was
stopped.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

from pydantic import BaseModel

from impact_xval.compliant_baselines import get_solver
from impact_xval.compliant_baselines.contract.solver import Settings
from impact_xval.compliant_baselines.practical.practice import Simulated
from impact_xval.compliant_baselines.practical.practices import get_practice
from impact_xval.experiments.scoreboard.cases import MOST_STEPS, USUAL, VARIATIONS, Case, cases
from impact_xval.experiments.sweep.sandbox import TO_PREPARE, FaultError, Sandbox, in_halves
from impact_xval.experiments.tables.files import is_regular
from impact_xval.experiments.tables.store import write_text
from impact_xval.model.collision import RESULT_STATUSES

#: Exact laws beside the engines, the model first.
LAWS = (
    "state-transition",
    "bistiffness",
    "kelvin-voigt",
    "compression-dashpot",
    "newton",
    "poisson",
    "sequential-top",
    "sequential-bottom",
    "generalised-reflection",
)
#: Under what the laws are kept together; no practice has that name.
EXACT = "exact laws"

#: Seconds that one case in one arrangement may take.
LONGEST = 60.0


@dataclass(frozen=True, slots=True)
class Entrant:
    """Who answers: a practice, or an exact law.

    Attributes
    ----------
    name, settings : str
    engine : str
        Where it comes from; `EXACT` for a law.
    version, precision : str
    law : str
        Exact solver of what it is asked for; empty for none.
    missing : str
        Why it cannot run here; empty if it can.
    status : str
        Of its answers if it cannot: one that is installed and dies as it is loaded is not `unavailable`.
    """

    name: str
    engine: str = ""
    settings: str = ""
    version: str = ""
    precision: str = "float64"
    law: str = ""
    missing: str = ""
    status: str = "unavailable"


@dataclass(frozen=True, slots=True)
class Answer:
    """What an entrant answered to one case in one arrangement.

    Attributes
    ----------
    name, case, arrangement : str
    e : float
    velocities : tuple of float
        In m/s, ball 1 first; empty without an answer.
    step : float
        In s; 0 of a law.
    steps : int
    seconds : float
        Of the engine's stepping.
    status, reason : str
    """

    name: str
    case: str
    e: float
    arrangement: str
    velocities: tuple[float, ...] = ()
    step: float = 0.0
    steps: int = 0
    seconds: float = 0.0
    status: str = "ok"
    reason: str = ""


@dataclass(frozen=True, slots=True)
class Part:
    """All that one process found: the entrants, and their answers."""

    entrants: tuple[Entrant, ...]
    answers: tuple[Answer, ...]


class _Kept(BaseModel, strict=True):
    """A part as it is kept, and what it is of."""

    identity: str
    part: Part


def play(
    names: Sequence[str],
    parts: Path,
    workers: int,
    progress: Callable[[int, int, str], None] = lambda done, total, line: None,
    find: Callable[[str], Any] = get_practice,
) -> list[Part]:
    """Have practices, and the exact laws, answer every case.

    Parameters
    ----------
    names : sequence of str
        Of practices.
    parts : Path
        Folder where what has been answered is kept, and taken from if versions and cases are those of now.
    workers : int
        Processes at a time; no answer depends on it.
    progress : callable
        Given how many are done, of how many, and a line.
    find : callable
        Finds a practice by its name; at the top level of a module.

    Returns
    -------
    list of Part
        The laws first, then the practices in their order.
    """
    all_names, done = [EXACT, *names], dict[str, Part]()
    with _sandboxes() as made, ThreadPoolExecutor(workers) as pool:
        try:
            # The last ones first: they take the longest.
            futures = {pool.submit(_kept, name, parts, made, find): name for name in reversed(all_names)}
            progress(0, len(all_names), "")
            for future in as_completed(futures):
                done[futures[future]] = future.result()
                progress(len(done), len(all_names), "")
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            for sandbox in list(made):
                sandbox.close()
            raise
    return [done[name] for name in all_names]


@contextmanager
def _sandboxes() -> Iterator[list[Sandbox]]:
    """Give a list whose sandboxes are closed at the end."""
    made: list[Sandbox] = []
    try:
        yield made
    finally:
        for sandbox in list(made):
            sandbox.close()


def _kept(name: str, parts: Path, made: list[Sandbox], find: Callable[[str], Any]) -> Part:
    """Take the answers that were kept, or have them given, and keep them."""
    sandbox = Sandbox(None, _ready)
    made.append(sandbox)
    path = parts / f"{name.replace(' ', '-')}.json"
    if name == EXACT:
        entrants = tuple(Entrant(law, EXACT, version=version("impact-xval"), law=law) for law in LAWS)
    else:
        try:
            entrants = (sandbox.call(_presented, name, find, timeout=TO_PREPARE),)
        except FaultError as fault:
            missing = f"it cannot be loaded: {fault.reason}"
            entrants = (replace(_described(find(name)), missing=missing, status=fault.status),)
    identity = _identity(entrants)
    part = _read(path, identity, entrants)
    if part is None:
        answers = _laws(sandbox) if name == EXACT else _practice(sandbox, entrants[0], find)
        part = Part(entrants, tuple(answers))
        write_text(path, _Kept(identity=identity, part=part).model_dump_json())
    sandbox.close()
    made.remove(sandbox)
    return part


def _ready(context: None) -> None:
    """Prepare for nothing: the first call imports the engine."""


def _presented(context: None, name: str, find: Callable[[str], Any]) -> Entrant:
    """Load an engine, and run it once: what is compiled at first use is no step's time."""
    practice = find(name)
    missing = practice.unavailable() or ""
    if not missing:
        practice.simulate(next(cases()).column)
    return replace(_described(practice), missing=missing)


def _described(practice: Any) -> Entrant:
    said = practice.name, practice.engine, practice.settings, practice.version(), practice.precision
    return Entrant(*said, practice.law)


def _practice(sandbox: Sandbox, entrant: Entrant, find: Callable[[str], Any]) -> Iterator[Answer]:
    """Give the answers of a practice to all cases in all arrangements."""
    names = tuple(VARIATIONS)
    for case in cases():
        if entrant.missing:
            for arrangement in names:
                answer = Answer(entrant.name, case.name, case.e, arrangement)
                yield replace(answer, status=entrant.status, reason=entrant.missing)
            continue

        def ask(place: slice, case: Case = case) -> list[Answer]:
            some = names[place]
            return sandbox.call(_answered, entrant.name, find, case, some, timeout=LONGEST * len(some))

        def lost(place: slice, fault: FaultError, case: Case = case) -> list[Answer]:
            (arrangement,) = names[place]
            return [
                Answer(entrant.name, case.name, case.e, arrangement, status=fault.status, reason=fault.reason)
            ]

        for piece in in_halves(ask, len(names), lost):
            yield from piece


def _answered(
    context: None, name: str, find: Callable[[str], Any], case: Case, arrangements: Iterable[str]
) -> list[Answer]:
    practice = find(name)
    usual = replace(practice.usual(case.column), max_steps=MOST_STEPS)
    found = []
    for arrangement in arrangements:
        asked = VARIATIONS[arrangement](usual)
        run: Simulated = practice.simulate(case.column, asked)
        velocities = run.velocities if run.status == "ok" else ()
        told = asked.step, run.steps, run.seconds, run.status, run.reason
        found.append(Answer(name, case.name, case.e, arrangement, velocities, *told))
    return found


def _laws(sandbox: Sandbox) -> list[Answer]:
    return sandbox.call(_exact, timeout=TO_PREPARE)


def _exact(context: None) -> list[Answer]:
    """Give the answers of the exact laws."""
    asked, found = list(cases()), []
    for law in LAWS:
        outcomes = get_solver(law).solve_columns([case.column for case in asked], Settings())
        for case, outcome in zip(asked, outcomes, strict=True):
            there = outcome.status in RESULT_STATUSES
            velocities = tuple(map(float, outcome.velocities)) if there else ()
            status, reason = outcome.status, outcome.reason
            found.append(Answer(law, case.name, case.e, USUAL, velocities, status=status, reason=reason))
    return found


def _identity(entrants: Iterable[Entrant]) -> str:
    """Tell answers apart that other code, engines or cases gave."""
    asked = [[asdict(case) for case in cases()], list(VARIATIONS), MOST_STEPS]
    text = json.dumps([version("impact-xval"), [asdict(each) for each in entrants], asked], sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:32]


def _read(path: Path, identity: str, entrants: Iterable[Entrant]) -> Part | None:
    """Read answers that were kept; None where there are none of these, or not all of them."""
    try:
        kept = _Kept.model_validate_json(path.read_bytes()) if is_regular(path) else None
    except (OSError, ValueError):
        return None
    if kept is None or kept.identity != identity:
        return None
    found = [(each.name, each.case, each.e, each.arrangement) for each in kept.part.answers]
    asked = [
        (entrant.name, case.name, case.e, arrangement)
        for entrant in entrants
        for case in cases()
        for arrangement in ([USUAL] if entrant.engine == EXACT else VARIATIONS)
    ]
    return kept.part if sorted(found) == sorted(asked) else None
