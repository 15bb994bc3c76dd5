"""How numbers are written for a reader."""

from __future__ import annotations

import math


def number(value: float, digits: int = 3) -> str:
    """Write a number for a reader; a dash where there is none."""
    if value is None or math.isnan(value):
        return "-"
    return f"{float(f'{value:.{digits}g}'):g}"


def percent(share: float) -> str:
    """Write a share as a percentage; a dash where there is none."""
    return "-" if math.isnan(share) else f"{round(100 * share, 1) + 0.0:.1f} %"
