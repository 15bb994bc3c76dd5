"""Values as JSON can hold them, and back: an infinity is the text ``"inf"``."""

from __future__ import annotations

import math
from typing import Any

#: Keys whose text is a text, whatever it says.
_TEXTS = ("name", "cells", "solvers", "solver")


def revive(value: object, key: str = "") -> Any:
    """Undo `plain_values`."""
    if isinstance(value, dict):
        return {name: revive(entry, name) for name, entry in value.items()}
    if isinstance(value, list):
        return [revive(entry, key) for entry in value]
    return math.inf if value == "inf" and key not in _TEXTS else value


def plain_values(value: Any) -> Any:
    """Make plain JSON values."""
    if isinstance(value, dict):
        return {key: plain_values(entry) for key, entry in value.items()}
    if isinstance(value, list):
        return [plain_values(entry) for entry in value]
    if isinstance(value, float) and math.isinf(value):
        return "inf"
    return value
