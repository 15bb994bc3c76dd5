"""Measured collisions: how a file holds them, and what of it can be true.

Ball 1 falls on ball 2, which rests on a table; up is positive. A row is a collision, and the unit of a column
stands in its header. What is impossible is said row by row, and such rows are left out; what concerns the file as a
whole ends it.
"""

from __future__ import annotations

import csv
import math
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from impact_xval.experiments.config.config_errors import hint, short
from impact_xval.experiments.config.errors import UserError
from impact_xval.experiments.fit.laws import STIFFNESS_BOX, Floats
from impact_xval.experiments.measures.aggregates import Frame
from impact_xval.experiments.tables.files import open_regular

#: Of a fall, in m/s^2, for data given by heights.
GRAVITY = 9.81

#: Standard errors by which a measured value may be impossible.
_BEYOND = 3.0

#: Squares of these, and their ratios, are far from the ends of double precision.
_POSITIVE = (1e-30, 1e30, "a number from 1e-30 to 1e30")
_ANY = (-1e30, 1e30, "a number from -1e30 to 1e30")
_HEIGHT = (0.0, 1e30, "a number from 0 to 1e30")
#: Columns by name: unit, least and greatest value, and how to say so.
_COLUMNS: dict[str, tuple[str, float, float, str]] = {
    "m1": ("kg", *_POSITIVE),
    "m2": ("kg", *_POSITIVE),
    "v1_before": ("m/s", -_POSITIVE[1], -_POSITIVE[0], "a number from -1e30 to -1e-30: ball 1 falls"),
    "v2_before": ("m/s", 0.0, 0.0, "0: ball 2 rests on the table"),
    "v1_after": ("m/s", *_ANY),
    "v2_after": ("m/s", *_ANY),
    "sd_v1_after": ("m/s", *_POSITIVE),
    "sd_v2_after": ("m/s", *_POSITIVE),
    "drop_height": ("m", *_POSITIVE),
    "rebound1_height": ("m", *_HEIGHT),
    "rebound2_height": ("m", *_HEIGHT),
    "sd_drop_height": ("m", *_POSITIVE),
    "sd_rebound1_height": ("m", *_POSITIVE),
    "sd_rebound2_height": ("m", *_POSITIVE),
    "k1": ("N/m", *_POSITIVE),
    "k2": ("N/m", *_POSITIVE),
    "e1": ("", 0.0, 1.0, "from 0 to 1"),
    "e2": ("", 0.0, 1.0, "from 0 to 1"),
}
_TEXTS = ("trial", "group")
_MASSES = ("m1", "m2")
_VELOCITIES = ("v1_before", "v1_after", "v2_after", "sd_v1_after", "sd_v2_after")
_HEIGHTS = ("drop_height", "rebound1_height", "sd_rebound1_height")
_OF_HEIGHTS = (*_HEIGHTS, "rebound2_height", "sd_drop_height", "sd_rebound2_height")
_KNOWN = ("k1", "k2", "e1", "e2")
#: m2/m1 that the laws are solved for.
_RATIOS = (1e-3, 1e3)
_STIFF = f"k2/k1 from 1e{STIFFNESS_BOX[0]:g} to 1e{STIFFNESS_BOX[1]:g}"


def header(name: str) -> str:
    """Write the header of a column, with its unit."""
    unit = _COLUMNS[name][0] if name in _COLUMNS else ""
    return f"{name} [{unit}]" if unit else name


@dataclass(frozen=True, slots=True, eq=False)
class Trials:
    r"""Collisions that can be fitted; velocities and standard errors are per \|v1 before\|.

    Attributes
    ----------
    rows : ndarray of int, shape (T,)
        Rows of the file, from 1, without its header.
    names, groups : list of str
        Of each trial; a group is left out at once by cross-validation.
    m1, m2 : ndarray, shape (T,)
        In kg.
    speed : ndarray, shape (T,)
        Of ball 1 before, in m/s.
    v1, v2, sd1, sd2 : ndarray, shape (T,)
        After, and their standard errors, which are infinite where nothing was measured.
    known : mapping
        Parameters of the laws that need not be fitted, by name (`laws.Law`).
    stiffness : float
        k1 in N/m, or NaN.
    problems : tuple of str
        A line for every value that is impossible; their rows are left out.
    left_out : int
        Rows that are.
    ignored : tuple of str
        Columns that mean nothing here.
    heights : bool
        Whether velocities are those of heights.
    """

    rows: np.ndarray
    names: list[str]
    groups: list[str]
    m1: Floats
    m2: Floats
    speed: Floats
    v1: Floats
    v2: Floats
    sd1: Floats
    sd2: Floats
    known: Mapping[str, float]
    stiffness: float
    problems: tuple[str, ...] = ()
    left_out: int = 0
    ignored: tuple[str, ...] = ()
    heights: bool = False

    @property
    def mass_ratio(self) -> Floats:
        """m2/m1, shape (T,)."""
        return self.m2 / self.m1

    def chosen(self, places: np.ndarray) -> Trials:
        """Give some of them."""
        columns = ("rows", "m1", "m2", "speed", "v1", "v2", "sd1", "sd2")
        texts = {"names": [self.names[i] for i in places], "groups": [self.groups[i] for i in places]}
        return replace(self, **{name: getattr(self, name)[places] for name in columns}, **texts)

    @property
    def measured(self) -> int:
        """Velocities that were measured."""
        return int(np.isfinite(self.sd1).sum() + np.isfinite(self.sd2).sum())


def read_trials(file: Path) -> Frame:
    """Read a table of trials as it is.

    Raises
    ------
    UserError
        If it cannot be read, or is none.
    """
    if file.suffix not in (".csv", ".parquet"):
        raise UserError(f"{file}: legal: a file that ends in .csv or .parquet")
    try:
        with open_regular(file) as stream:
            if file.suffix == ".parquet":
                return pd.read_parquet(stream)
            text = stream.read().decode("utf-8-sig")
    except OSError as error:
        raise UserError(f"{file}: cannot be read: {error.strerror or error}") from None
    except UnicodeDecodeError:
        raise UserError(f"{file}: not text in UTF-8; legal: a CSV file in UTF-8") from None
    except Exception as error:  # pyarrow has many
        raise UserError(f"{file}: not a Parquet file: {error}") from None
    try:
        return _table(csv.reader(StringIO(text, newline=""), strict=True))
    except (csv.Error, UserError) as error:
        raise UserError(f"{file}: not a table: {error}") from None


def _table(lines: Iterator[list[str]]) -> Frame:
    """Give the rows under the first line that is no comment; pandas would cut fields off that have no header."""
    filled = (line for line in lines if any(map(str.strip, line)))
    columns = next((line for line in filled if not _comment(line[0])), None)
    if columns is None:
        raise UserError("it has no header")
    if len(columns) == 1 and (separator := next((each for each in ";\t|" if each in columns[0]), None)):
        raise UserError(f"its columns are separated by {separator!r}; legal: ','")
    rows, n = list[list[str]](), len(columns)
    for at, line in enumerate(filled, 1):
        if not _comment(line[0]) and (len(line) < n or any(map(str.strip, line[n:]))):
            raise UserError(f"row {at}, fields = {len(line)}; legal: {n}, as its header")
        rows.append((line + [""] * n)[:n])
    return pd.DataFrame(rows, columns=columns, dtype=str)


def _comment(first: object) -> bool:
    return str(first).lstrip().startswith("#")


def trials_of(frame: Frame) -> Trials:
    """Check a table of trials, and scale it.

    Parameters
    ----------
    frame : DataFrame
        Columns as in `docs/measurements.md`, units in their headers.

    Raises
    ------
    UserError
        If a column is missing, or has another unit, or if no row is left.
    """
    columns, ignored = _named(frame)
    heights = "v1_after" not in columns and "rebound1_height" in columns
    missing = [name for name in (*_MASSES, *(_HEIGHTS if heights else _VELOCITIES)) if name not in columns]
    if missing:
        legal = ", ".join(map(header, (*_MASSES, *_VELOCITIES)))
        or_heights = ", ".join(map(header, _HEIGHTS))
        raise UserError(
            f"column {header(missing[0])!r}: missing; legal: {legal}; or, of heights, masses, {or_heights}"
        )
    if "rebound2_height" in columns and "sd_rebound2_height" not in columns:
        raise UserError(
            f"column {header('sd_rebound2_height')!r}: missing beside {header('rebound2_height')!r}"
        )
    for name in _VELOCITIES if heights else _OF_HEIGHTS:
        if name in columns and not frame[columns.pop(name)].map(_empty).all():
            raise UserError(
                f"column {header(name)!r}: beside {header('rebound1_height' if heights else 'v1_after')!r}; "
                "legal: velocities or heights, not both"
            )
    rows, problems = [], []
    for at, (_, values) in enumerate(frame.iterrows(), 1):
        row = {name: values[column] for name, column in columns.items()}
        found = list(_check(row, heights))
        if _comment(values.iloc[0]):
            found = [f"{short(values.iloc[0])}: begins with #, so it is a comment"]
        problems += [f"row {at}, {line}" for line in found]
        if not found:
            rows.append(
                (at, {name: _number(value) for name, value in row.items() if name not in _TEXTS}, row)
            )
    if not rows:
        lines = "; ".join(problems[:3]) or "it has no rows"
        raise NoTrialsError(f"nothing is left to fit: {lines}", problems)
    kept, known, stiffness, differing = _known(rows)
    problems += differing
    return _scaled(kept, known, stiffness, problems, len(frame) - len(kept), ignored, heights)


class NoTrialsError(UserError):
    """No row can be fitted.

    Attributes
    ----------
    problems : tuple of str
        A line for each value that is impossible.
    """

    def __init__(self, message: str, problems: list[str]) -> None:
        super().__init__(message)
        self.problems = tuple(problems)


def _named(frame: Frame) -> tuple[dict[str, Any], tuple[str, ...]]:
    """Find the columns by name: header of each, and those that mean nothing."""
    columns: dict[str, Any] = {}
    ignored: list[str] = []
    for column in frame.columns:
        name = str(column).partition("[")[0].strip()
        if name not in _COLUMNS and name not in _TEXTS:
            ignored.append(f"{str(column)!r:.60}{hint(name, [*_COLUMNS, *_TEXTS])}")
        elif str(column).replace(" ", "") != header(name).replace(" ", ""):
            raise UserError(f"column {str(column)!r:.60}: another unit; legal: {header(name)!r}")
        elif name in columns:
            raise UserError(f"column {str(column)!r:.60}: there twice; legal: once")
        else:
            columns[name] = column
    return columns, tuple(ignored)


def _number(value: object) -> float:
    """Return a value as a number; NaN where it is none."""
    try:
        return float(str(value).replace("_", "none"))  # Python takes 0_1 for 1
    except ValueError:
        return math.nan


def _empty(value: object) -> bool:
    return str(value).strip().lower() in ("", "nan", "none", "<na>")


def _check(row: Mapping[str, object], heights: bool) -> Iterator[str]:
    """Say what is impossible in a row: column, value and legal range."""
    optional = {"sd_drop_height", "rebound2_height", "sd_rebound2_height", *_KNOWN, *_TEXTS, "v2_before"}
    wrong = False
    for name, value in row.items():
        if name in _TEXTS:
            continue
        empty = _empty(value)
        if empty and name in optional:
            continue
        _, low, high, legal = _COLUMNS[name]
        if empty or not low <= _number(value) <= high:
            wrong = True
            yield f"{header(name)} = {'missing' if empty else short(value)}; legal: {legal}"
    if wrong:
        return
    numbers = {name: _number(value) for name, value in row.items() if name not in _TEXTS}
    second = numbers.get("rebound2_height", math.nan) if heights else math.nan
    if not math.isnan(second) and math.isnan(numbers["sd_rebound2_height"]):
        yield f"{header('sd_rebound2_height')} = missing; legal: {_POSITIVE[2]}"
        return
    ratio = numbers["m2"] / numbers["m1"]
    if not _RATIOS[0] <= ratio <= _RATIOS[1]:
        yield f"{header('m2')} = {numbers['m2']:g}; legal: m2/m1 from {_RATIOS[0]:g} to {_RATIOS[1]:g}"
        return
    stiff = numbers.get("k2", math.nan) / numbers.get("k1", math.nan)
    if not (math.isnan(stiff) or abs(math.log10(stiff)) <= STIFFNESS_BOX[1]):
        yield f"{header('k2')} = {numbers['k2']:g}; legal: {_STIFF}"
        return
    speed, v1, v2, sd1, sd2 = _velocities(numbers, heights)
    yield from _impossible(speed, v1, v2, sd1, sd2, ratio, heights)


def _impossible(
    speed: float, v1: float, v2: float, sd1: float, sd2: float, ratio: float, heights: bool
) -> Iterator[str]:
    """Say what no collision can do, beyond three standard errors; energies are over m1/2."""
    first = "velocity of " + header("rebound1_height") if heights else header("v1_after")
    second = header("v2_after")
    there = math.isfinite(sd2)
    if there and v2 < -_BEYOND * sd2:
        yield f"{second} = {v2:g}; legal: at least {-_BEYOND * sd2:.3g}, 3 standard errors into the table"
    if there and v1 - v2 < -_BEYOND * math.hypot(sd1, sd2):
        least = v2 - _BEYOND * math.hypot(sd1, sd2)
        yield f"{first} = {v1:g} m/s; legal: at least {least:.4g}, 3 standard errors through ball 2"
    energy = v1 * v1 + (ratio * v2 * v2 if there else 0.0)
    error = 2 * math.hypot(v1 * sd1, ratio * v2 * sd2 if there else 0.0)
    if energy > speed * speed + _BEYOND * error:
        yield (
            f"{first} = {v1:g} m/s: {energy / speed**2:.3g} of the energy before; "
            f"legal: at most {1 + _BEYOND * error / speed**2:.3g}, 3 standard errors above 1"
        )


def _velocities(row: Mapping[str, float], heights: bool) -> tuple[float, float, float, float, float]:
    """Give speed before, velocities after and their standard errors, in m/s.

    Of heights, v = sqrt(2 g h), and its standard error is g sd_h/v, at most sqrt(2 g sd_h), which is that of a ball
    that stays down. That of the height of drop acts on v1 per speed of impact, and is added in quadrature.
    """
    if not heights:
        return -row["v1_before"], row["v1_after"], row["v2_after"], row["sd_v1_after"], row["sd_v2_after"]
    speed, v1 = (math.sqrt(2 * GRAVITY * row[name]) for name in ("drop_height", "rebound1_height"))
    of_drop = row.get("sd_drop_height", math.nan)
    share = 0.0 if math.isnan(of_drop) else GRAVITY * of_drop / speed**2
    sd1 = math.hypot(_of_height(v1, row["sd_rebound1_height"]), v1 * share)
    second = row.get("rebound2_height", math.nan)
    if math.isnan(second):
        return speed, v1, 0.0, sd1, math.inf
    v2 = math.sqrt(2 * GRAVITY * second)
    return speed, v1, v2, sd1, math.hypot(_of_height(v2, row["sd_rebound2_height"]), v2 * share)


def _of_height(v: float, sd: float) -> float:
    most = math.sqrt(2 * GRAVITY * sd)
    return GRAVITY * sd / v if v * most > GRAVITY * sd else most


_Row = tuple[int, dict[str, float], Mapping[str, object]]


def _known(rows: list[_Row]) -> tuple[list[_Row], dict[str, float], float, list[str]]:
    """Find what is known of the contacts, which all trials share; rows that say otherwise are left out."""
    known = {}
    for name in _KNOWN:
        said = Counter(v for _, r, _ in rows if not math.isnan(v := r.get(name, math.nan)))
        known[name] = said.most_common(1)[0][0] if said else math.nan
    kept, lines = [], []
    for at, row, texts in rows:
        differing = [
            name
            for name in _KNOWN
            if row.get(name, math.nan) != known[name] and not math.isnan(row.get(name, math.nan))
        ]
        lines += [
            f"row {at}, {header(name)} = {row[name]:g}; legal: {known[name]:g}, as most rows have: all trials of a "
            "file share their contacts"
            for name in differing
        ]
        if not differing:
            kept.append((at, row, texts))
    fixed = {name: known[name] for name in ("e1", "e2") if not math.isnan(known[name])}
    if not math.isnan(known["k1"] + known["k2"]):
        fixed["log_k"] = math.log10(known["k2"] / known["k1"])
        if not STIFFNESS_BOX[0] <= fixed["log_k"] <= STIFFNESS_BOX[1]:  # each in rows of its own
            raise UserError(
                f"{header('k2')} = {known['k2']:g}, {header('k1')} = {known['k1']:g}; legal: {_STIFF}"
            )
    return kept, fixed, known["k1"], lines


def _scaled(
    rows: list[_Row],
    known: dict[str, float],
    stiffness: float,
    problems: list[str],
    left_out: int,
    ignored: tuple[str, ...],
    heights: bool,
) -> Trials:
    found = np.array([_velocities(row, heights) for _, row, _ in rows])
    speed = found[:, 0]
    m1, m2 = (np.array([row[name] for _, row, _ in rows]) for name in _MASSES)
    names = [_text(texts.get("trial"), f"row {at}") for at, _, texts in rows]
    groups = [
        _text(texts.get("group"), f"m1 = {a:g} kg, m2 = {b:g} kg")
        for (_, _, texts), a, b in zip(rows, m1, m2, strict=True)
    ]
    return Trials(
        np.array([at for at, _, _ in rows]),
        names,
        groups,
        m1,
        m2,
        speed,
        *(found[:, 1:] / speed[:, None]).T,
        known=known,
        stiffness=stiffness,
        problems=tuple(problems),
        left_out=left_out,
        ignored=ignored,
        heights=heights,
    )


def _text(value: object, otherwise: str) -> str:
    text = "" if value is None or value is pd.NA else str(value).strip()
    return otherwise if text in ("", "nan") else text
