"""Functions that write numbers and lists of words as text for a reader."""

from __future__ import annotations

import math
from collections.abc import Iterable


def number(value: float | None, digits: int = 3) -> str:
    """Write a number in `digits` significant digits; a dash for None and NaN."""
    if value is None or math.isnan(value):
        return "-"
    return f"{float(f'{value:.{digits}g}'):g}"


def compact_number(value: float, digits: int = 3) -> str:
    """Write a number in few letters: 10000 as ``1e4``, NaN as a dash, infinity as ``never``."""
    if math.isinf(value):
        return "never"
    if value >= 1e4 and math.isclose(value, 10 ** round(math.log10(value)), rel_tol=1e-9):
        return f"1e{round(math.log10(value))}"
    return number(value, digits)


def percent(share: float) -> str:
    """Write a share, such as 0.25, as a percentage, ``25.0 %``; a dash for NaN."""
    return "-" if math.isnan(share) else f"{round(100 * share, 1) + 0.0:.1f} %"


def join_words(words: Iterable[str]) -> str:
    """Join words as an enumeration in a sentence, such as ``a, b and c``."""
    words = list(words)
    return " and ".join([", ".join(words[:-1]), words[-1]] if len(words) > 1 else words)
