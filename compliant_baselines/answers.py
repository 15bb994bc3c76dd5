"""Calling a solver, whatever it does: what leaves it is one legal outcome for each collision.

Every command and every sweep calls solvers by `answer`, columns of N balls by `answer_columns`, those of other
distributions and those of this project alike. An exception, a wrong number of outcomes, or an outcome that is not what
`model.collision.Outcome` says become outcomes with the status ``crashed`` and a reason. What is legal is said once, in
`validated`. What a solver changes of its
process is put back (`undisturbed`); what no process survives is for `experiments.sweep.sandbox`.
"""

from __future__ import annotations

import contextlib
import copy
import math
import os
import pathlib
import signal
import sys
from collections.abc import Iterator, Mapping, Sequence
from numbers import Integral, Real
from typing import Any

import numpy as np
from numpy.typing import NDArray

from impact_xval.compliant_baselines.solver import Settings, Solver, no_columns
from impact_xval.compliant_baselines.visible import visible
from impact_xval.model.collision import (
    RESULT_STATUSES,
    STATES,
    STATUSES,
    Collision,
    Outcome,
    Outcomes,
    Path,
)

#: Characters of a sentence of a solver that are kept.
LONGEST = 1000

#: Whole numbers up to here are exact as floating-point numbers, and so are those of every table.
_WHOLE = 2**53


class IllegalOutcomeError(ValueError):
    """An outcome is not what the contract says; the message holds the field, what was found and what is legal."""


def answer(solver: Solver, collisions: Sequence[Collision], settings: Settings) -> list[Outcome]:
    """Call a solver, and turn whatever goes wrong into outcomes with a status and a reason.

    Parameters
    ----------
    solver : Solver
    collisions : sequence of Collision
    settings : Settings

    Returns
    -------
    list of Outcome
        One for each collision, in order; all of them legal.
    """
    return _answers(solver, "solve_many", collisions, (settings,))


def answer_columns(solver: Solver, columns: Sequence[Collision], settings: Settings) -> list[Outcome]:
    """Call a solver for columns of N balls, as `answer` for collisions; one that solves none refuses them.

    Parameters
    ----------
    solver : Solver
    columns : sequence of Collision
    settings : Settings

    Returns
    -------
    list of Outcome
        One for each column, in order; all of them legal.
    """
    if not callable(getattr(type(solver), "solve_columns", None)):
        reason = no_columns(solver.name)
        return [Outcome.failure(solver.name, column, "unrepresentable", reason) for column in columns]
    return _answers(solver, "solve_columns", columns, (settings,))


def _answers(
    solver: Solver, method: str, problems: Sequence[Collision], more: tuple[Any, ...]
) -> list[Outcome]:
    """Call a method of a solver with problems and more, and make legal outcomes of what it gives."""
    reason = why_unavailable(solver)
    if reason is not None:
        return [Outcome.failure(solver.name, problem, "unavailable", reason) for problem in problems]
    given = list(map(copy.copy, problems))
    try:
        with undisturbed():
            outcomes = getattr(solver, method)(given[:], *more)
            if not isinstance(outcomes, (list, tuple, Outcomes)):
                raise TypeError(f"{method} gave {type(outcomes).__name__}; legal: list or Outcomes")
        if len(outcomes) != len(problems):
            raise RuntimeError(f"{len(outcomes)} outcomes for {len(problems)} collisions")
    except BaseException as error:  # a solver's bug must not end the sweep
        raise_ctrl_c(error)
        if len(problems) == 1:
            return [Outcome.failure(solver.name, problems[0], "crashed", said(error))]
        return [found for one in problems for found in _answers(solver, method, [one], more)]
    answered = zip(outcomes, given, problems, strict=True)
    return [_legal_or_crashed(solver.name, *each) for each in answered]


def why_unavailable(solver: Solver) -> str | None:
    """Return why a solver cannot run here, in a line; None if it can."""
    try:
        with undisturbed():
            reason = solver.unavailable()
    except BaseException as error:
        raise_ctrl_c(error)
        return f"asked whether it is available, {solver.name!r} failed: {said(error)}"
    if reason is None or isinstance(reason, str):
        return reason if reason is None else one_line(reason)
    return f"unavailable() gave {type(reason).__name__}; legal: text or None"


def stated_version(solver: Solver) -> str:
    """Return the version a solver states, in a line; ``""`` if it cannot."""
    try:
        with undisturbed():
            stated = solver.version()
    except BaseException as error:
        raise_ctrl_c(error)
        return ""
    return one_line(stated) if isinstance(stated, str) else ""


def validated(outcome: Any, collision: Collision) -> Outcome:
    """Return an outcome in plain values, if it is what `Outcome` says.

    Numbers of numpy become those of Python, arrays of a path 64 bits wide, texts a line.

    Parameters
    ----------
    outcome : object
        As it left a solver.
    collision : Collision
        What it is an outcome of.

    Raises
    ------
    IllegalOutcomeError
        If it is not.
    """
    if not isinstance(outcome, Outcome):
        raise IllegalOutcomeError(f"the outcome is of type {type(outcome).__name__}; legal: Outcome")
    status, margin, path = _text("status", outcome.status), outcome.grazing_margin, outcome.path
    if status not in STATUSES:
        raise IllegalOutcomeError(f"status = {status!r}; legal: {', '.join(STATUSES)}")
    balls, contacts = len(collision.masses), len(collision.stiffnesses)
    plain = Outcome(
        solver=_text("solver", outcome.solver),
        velocities=_numbers("velocities", outcome.velocities, balls),
        impulses=_numbers("impulses", outcome.impulses, contacts),
        states=_states(outcome.states, balls == 2 and collision.table, contacts),
        status=status,
        reason=_text("reason", outcome.reason),
        grazing_margin=None if margin is None else float(_number("grazing_margin", margin)),
        marked=_text("marked", outcome.marked),
        n_events=_whole("n_events", outcome.n_events),
        diagnostics=_diagnostics(outcome.diagnostics),
        path=None if path is None else _path(path, balls, contacts),
    )
    numbers = (*plain.velocities, *plain.impulses)
    if plain.status in RESULT_STATUSES and not all(map(math.isfinite, numbers)):
        raise IllegalOutcomeError(f"status {plain.status}, but velocities, impulses = {numbers}")
    if all(map(math.isfinite, plain.velocities)) and not _has_energy(plain, collision):
        raise IllegalOutcomeError(f"velocities = {plain.velocities} m/s: their energy overflows")
    return plain


@contextlib.contextmanager
def undisturbed() -> Iterator[None]:
    """Put back what a solver changes of its process, so that the next one finds it as it was.

    That is the path of modules, the working directory and what the standard streams are connected to. A process that
    the solver forked, and that comes out of it too, ends here.
    """
    process, modules, places = os.getpid(), sys.path, sys.path[:]
    folder, streams = None, {}
    with contextlib.suppress(OSError):
        folder = pathlib.Path.cwd()
    for stream in range(3):
        with contextlib.suppress(OSError):
            streams[stream] = os.dup(stream)
    try:
        yield
    finally:
        if os.getpid() != process:
            os._exit(0)
        modules[:], sys.path = places, modules
        with contextlib.suppress(OSError):
            if folder is not None:
                os.chdir(folder)
        for stream, kept in streams.items():
            with contextlib.suppress(OSError):
                os.dup2(kept, stream)
                os.close(kept)


def said(error: BaseException) -> str:
    """Return what an exception says, in a line."""
    try:
        text = str(error)
    except Exception:
        text = "without a message"
    return one_line(" ".join(f"{type(error).__name__}: {text}".split()))


def one_line(text: str) -> str:
    """Return a text as tables, terminals and pages can show it: one line of printable characters, not too long."""
    text = str.__str__(text)  # of a class of the solver's own, no method is trusted
    if not text.isprintable():
        text = " ".join(visible(text[: 2 * LONGEST]).split())
    return text if len(text) <= LONGEST else f"{text[: LONGEST - 3]}..."


def raise_ctrl_c(error: BaseException) -> None:
    """Raise what is no fault of a solver: Ctrl-C, where it reaches this process."""
    if isinstance(error, KeyboardInterrupt) and signal.getsignal(signal.SIGINT) is not signal.SIG_IGN:
        raise error


def _legal_or_crashed(name: str, outcome: Any, given: Collision, problem: Collision) -> Outcome:
    try:
        if given != problem:
            raise IllegalOutcomeError(f"it changed the collision it was given to {given!r}")
        return validated(outcome, problem)
    except IllegalOutcomeError as error:
        return Outcome.failure(name, problem, "crashed", one_line(str(error)))
    except BaseException as error:  # a property that raises, a number that cannot be converted
        raise_ctrl_c(error)
        return Outcome.failure(name, problem, "crashed", f"reading its outcome: {said(error)}")


def _text(name: str, value: Any) -> Any:
    if not isinstance(value, str):
        raise IllegalOutcomeError(f"{name} is of type {type(value).__name__}; legal: text")
    return one_line(value)


def _number(name: str, value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, Real):
        raise IllegalOutcomeError(f"{name} is of type {type(value).__name__}; legal: a number")
    if type(value) is int and abs(value) <= _WHOLE:
        return value
    try:
        return float(value)
    except OverflowError:
        raise IllegalOutcomeError(f"{name} leaves double precision") from None


def _whole(name: str, value: Any) -> int:
    if isinstance(value, bool) or not isinstance(value, Integral):
        raise IllegalOutcomeError(f"{name} is of type {type(value).__name__}; legal: a whole number")
    whole = int(value)
    if not 0 <= whole <= _WHOLE:
        raise IllegalOutcomeError(f"{name} is less than 0 or more than 2^53")
    return whole


def _states(states: Any, paper: bool, contacts: int) -> tuple[str, ...]:
    if not isinstance(states, (tuple, list)) or not all(isinstance(state, str) for state in states):
        raise IllegalOutcomeError("states; legal: a tuple of text")
    acting = {contact for state in set(states) for contact in state.split("+")} - {"-"}
    legal = set(STATES[1:]) if paper else set(map(str, range(1, contacts + 1)))
    if not acting <= legal:
        named = ", ".join(STATES[1:]) if paper else f"sets of contacts such as '1+2', '-', of 1 to {contacts}"
        raise IllegalOutcomeError(f"states = {', '.join(sorted(set(states)))}; legal: {named}")
    return tuple(map(str.__str__, states))


def _numbers(name: str, values: Any, length: int) -> tuple[float, ...]:
    if not isinstance(values, (tuple, list, np.ndarray)) or len(values) != length:
        raise IllegalOutcomeError(f"{name}; legal: a tuple of {length} numbers")
    return tuple(float(_number(f"{name}[{i}]", value)) for i, value in enumerate(values, 1))


def _path(path: Any, balls: int, contacts: int) -> Path:
    if not isinstance(path, Path):
        raise IllegalOutcomeError(f"path is of type {type(path).__name__}; legal: Path or None")
    arrays = {
        name: _array(name, getattr(path, name)) for name in ("time", "velocities", "impulses", "forces")
    }
    acting, points = np.asarray(path.acting), arrays["time"].size
    wide = {"time": (), "velocities": (balls,), "impulses": (contacts,), "forces": (contacts,)}
    legal = {name: (points, *rest) for name, rest in wide.items()}
    if {name: array.shape for name, array in arrays.items()} != legal or not points:
        raise IllegalOutcomeError(
            f"path; legal: arrays of n >= 1 rows, {balls} velocities, {contacts} forces"
        )
    if acting.dtype != bool or acting.shape != legal["forces"]:
        raise IllegalOutcomeError(f"path.acting; legal: truth values, {contacts} a row")
    if not all(np.isfinite(arrays[name]).all() for name in ("velocities", "impulses")):
        raise IllegalOutcomeError("path holds a number that is not finite")
    return Path(**arrays, acting=acting)


def _diagnostics(diagnostics: Any) -> dict[str, Any]:
    if not isinstance(diagnostics, Mapping):
        raise IllegalOutcomeError(f"diagnostics is of type {type(diagnostics).__name__}; legal: a mapping")
    plain: dict[str, Any] = {}
    for name, value in diagnostics.items():
        if not isinstance(name, str) or not name.isprintable():
            raise IllegalOutcomeError("diagnostics: a key; legal: printable text")
        plain[str.__str__(name)] = None if value is None else _number(f"diagnostics[{name!r}]", value)
    n_steps = plain.get("n_steps")
    if n_steps is not None and not (0 <= n_steps <= _WHOLE and n_steps == int(n_steps)):
        raise IllegalOutcomeError(
            f"diagnostics['n_steps'] = {n_steps!r}; legal: a whole number from 0 to 2^53"
        )
    return plain


def _array(name: str, values: Any) -> NDArray[Any]:
    array = np.asarray(values)
    if array.dtype.kind not in "iuf":
        raise IllegalOutcomeError(f"path.{name} has dtype {array.dtype}; legal: float64")
    return array.astype(np.float64, copy=False)


def _has_energy(outcome: Any, problem: Any) -> bool:
    try:
        return math.isfinite(outcome.retained_energy(problem))
    except OverflowError:
        return False
