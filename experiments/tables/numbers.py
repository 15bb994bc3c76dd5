"""Functions that write numbers and lists for a reader."""

from __future__ import annotations

import math
from collections.abc import Iterable


def number(value: float | None, digits: int = 3) -> str:
    """Write a number for a reader; a dash where there is none."""
    if value is None or math.isnan(value):
        return "-"
    return f"{float(f'{value:.{digits}g}'):g}"


def compact_number(value: float, digits: int = 3) -> str:
    """Write a number in few letters: large powers of ten as such, a dash for none, ``never`` for infinity."""
    if math.isinf(value):
        return "never"
    if value >= 1e4 and math.isclose(value, 10 ** round(math.log10(value)), rel_tol=1e-9):
        return f"1e{round(math.log10(value))}"
    return number(value, digits)


def percent(share: float) -> str:
    """Write a share as a percentage; a dash where there is none."""
    return "-" if math.isnan(share) else f"{round(100 * share, 1) + 0.0:.1f} %"


def join_words(words: Iterable[str]) -> str:
    """Join words as a list in a sentence."""
    words = list(words)
    return " and ".join([", ".join(words[:-1]), words[-1]] if len(words) > 1 else words)
