"""How numbers and lists are written for a reader."""

from __future__ import annotations

import math
from collections.abc import Iterable

#: A D, or a difference of energies, below this is the rounding of the solvers, and no finding.
ROUNDING = 1e-12


def number(value: float, digits: int = 3) -> str:
    """Write a number for a reader; a dash where there is none."""
    if value is None or math.isnan(value):
        return "-"
    return f"{float(f'{value:.{digits}g}'):g}"


def short(value: float, digits: int = 3) -> str:
    """Write a number in few letters: large powers of ten as such, a dash for none, ``never`` for infinity."""
    if math.isinf(value):
        return "never"
    if value >= 1e4 and math.isclose(value, 10 ** round(math.log10(value)), rel_tol=1e-9):
        return f"1e{round(math.log10(value))}"
    return number(value, digits)


def percent(share: float) -> str:
    """Write a share as a percentage; a dash where there is none."""
    return "-" if math.isnan(share) else f"{round(100 * share, 1) + 0.0:.1f} %"


def rounded(divergence: float) -> str:
    """Write a D for a sentence."""
    return "0 to rounding" if 0 <= divergence < ROUNDING else number(divergence)


def counted(n: int, unit: str) -> str:
    """Write a number of things, whose name is given in the plural: 1 cell, 2 cells."""
    return f"{n} {unit.removesuffix('s') if n == 1 else unit}"


def listed(words: Iterable[str]) -> str:
    """Join words as a list in a sentence."""
    words = list(words)
    return " and ".join([", ".join(words[:-1]), words[-1]] if len(words) > 1 else words)
